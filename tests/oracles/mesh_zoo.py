"""One mesh per flaw that people's meshes have, each as the fourth shape of a study of four.

The sound shape is a sphere of 40 mm with three openings: a mitral one below and two veins above.
Every specimen writes its files into a folder and says what must come of it: "usable" (as it is),
"repaired" (with a word of the sentence that says so), or "refused" (with a word of the message).
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyvista as pv

from ostiform.surface import boundary_loops, write_surface
from tests.oracles.holed_spheres import holed_sphere, torus

RADIUS_MM = 40.0
MITRAL = ((0.0, 0.0, -1.0), 0.6, 40)
RIGHT = ((0.7, 0.0, 0.7), 0.25, 18)
LEFT = ((-0.6, 0.1, 0.8), 0.2, 16)
STUDY = """
schema = 1
[parts.LA]
ostia = ["mitral", "RPV", "LPV"]
[shapes]
pattern = "{subject}_LA.*"
[ostia.points]
"LA.mitral" = [0, 0, -33]
"LA.RPV" = [27, 0, 27]
"LA.LPV" = [-24, 4, 31]
"""


@dataclass(frozen=True)
class Specimen:
    """A flaw, and what must come of it."""

    flaw: str
    make: Callable[[Path], None]
    outcome: str
    word: str


def sound(n_points=700):
    vertices, faces = holed_sphere(n_points, [MITRAL, RIGHT, LEFT])
    return RADIUS_MM * vertices, faces


def study_of(specimen: Specimen, folder: Path) -> Path:
    """Write three sound shapes and the specimen, and return the study file."""
    vertices, faces = sound()
    folder.mkdir(parents=True, exist_ok=True)
    for k, scale in enumerate((0.97, 1.0, 1.03), start=1):
        write_surface(folder / f"sound{k}_LA.vtp", scale * vertices, faces)
    (folder / "study.toml").write_text(STUDY, encoding="utf-8")
    specimen.make(folder)
    return folder / "study.toml"


def _mesh(change, n_points=700):
    def make(folder):
        vertices, faces = change(*sound(n_points))
        write_surface(folder / "bad_LA.vtp", vertices, faces)

    return make


def _bytes(content, name="bad_LA.vtp"):
    def make(folder):
        (folder / name).write_bytes(content(folder) if callable(content) else content)

    return make


def _saved(name, change=lambda mesh: mesh, **options):
    def make(folder):
        vertices, faces = sound()
        change(pv.PolyData.from_regular_faces(vertices, faces)).save(folder / name, **options)

    return make


def _middle(vertices, direction=(0.0, 1.0, 0.1)):
    return int(np.argmax(vertices @ np.asarray(direction)))


def _fin(vertices, faces, height):
    a, b, _ = faces[0]
    tip = vertices[[a, b]].mean(axis=0) * (1.0 + height / RADIUS_MM)
    return np.vstack([vertices, tip]), np.vstack([faces, [[a, b, len(vertices)]]])


def _bow_tie(vertices, faces):
    # A second sheet, a small closed tetrahedron, hangs on a vertex.
    v = _middle(vertices)
    tips = vertices[v] + np.array([[3.0, 3, 0], [-3, 3, 0], [0, 3, 3]])
    n = len(vertices)
    extra = [[v, n, n + 1], [v, n + 1, n + 2], [v, n + 2, n], [n, n + 2, n + 1]]
    return np.vstack([vertices, tips]), np.vstack([faces, extra])


def _big_membrane(vertices, faces):
    # A wall right through the cavity, from rim to rim of one cut.
    ring = np.unique(faces[np.abs(vertices[faces][:, :, 1]).max(axis=1) < 6.0])
    ring = ring[vertices[ring, 2] > -30]
    edges = {tuple(sorted(e)) for f in faces for e in zip(f, np.roll(f, 1), strict=True)}
    centre = len(vertices)
    chain = [e for e in edges if set(e) <= set(ring.tolist())][:60]
    extra = [[a, b, centre] for a, b in chain]
    return np.vstack([vertices, [[0.0, 0, 0]]]), np.vstack([faces, extra])


def _flipped_some(vertices, faces):
    turned = faces.copy()
    turned[::7] = turned[::7][:, [0, 2, 1]]
    return vertices, turned


def _with_slivers(vertices, faces):
    # The midpoint of an edge belongs to one of its two faces only, by a triangle without area.
    a, b, c = faces[_inner_face(vertices, faces)]
    m = len(vertices)
    split = np.delete(faces, _inner_face(vertices, faces), axis=0)
    middle = vertices[[a, b]].mean(axis=0)
    extra = [[a, m, c], [m, b, c], [a, b, m]]
    return np.vstack([vertices, middle]), np.vstack([split, extra])


def _inner_face(vertices, faces):
    return int(np.argmax(vertices[faces].mean(axis=1)[:, 1]))


def _second(scale, offset):
    def change(vertices, faces):
        other, second = holed_sphere(100, [])
        return (
            np.vstack([vertices, scale * other + offset]),
            np.vstack([faces, second + len(vertices)]),
        )

    return change


def _closed(vertices, faces):
    vertices, faces = holed_sphere(700, [])
    return RADIUS_MM * vertices, faces


def _extra_hole(radius, count):
    def change(vertices, faces):
        hole = ((0.0, 1.0, 0.1), radius, count)
        vertices, faces = holed_sphere(700, [MITRAL, RIGHT, LEFT, hole])
        return RADIUS_MM * vertices, faces

    return change


def _missing_opening(vertices, faces):
    vertices, faces = holed_sphere(700, [MITRAL, RIGHT])
    return RADIUS_MM * vertices, faces


def _six_edge_nick(vertices, faces):
    v = _middle(vertices)
    return vertices, faces[~(faces == v).any(axis=1)]


def _touching_openings(vertices, faces):
    loops = boundary_loops(faces)
    rim = set(max(loops, key=lambda k: vertices[k, 0].mean()).tolist())
    on_rims = {int(v) for loop in loops for v in loop}
    # An inner vertex of whose ring just one vertex lies on the rim: its faces are cut out.
    for v in range(len(vertices)):
        if v in on_rims:
            continue
        around = {int(w) for f in faces[(faces == v).any(axis=1)] for w in f} - {v}
        if len(around & rim) == 1 and not around & (on_rims - rim):
            return vertices, faces[~(faces == v).any(axis=1)]
    raise AssertionError


def _touching_vein(vertices, faces):
    """The left vein is widened until it touches the right one in one vertex."""
    loops = sorted(boundary_loops(faces), key=len)
    left, right = loops[0], loops[1]
    merged = faces.copy()
    here = vertices[left][np.argmax(vertices[left, 0])]
    there = right[np.argmin(np.linalg.norm(vertices[right] - here, axis=1))]
    mine = left[np.argmax(vertices[left, 0])]
    merged[merged == mine] = there
    return vertices, merged


def _chord(vertices, faces):
    loop = max(boundary_loops(faces), key=len)
    a, b = loop[:2]
    # A triangle stands on a rim edge, which so becomes an inner edge between two rim vertices.
    tip = vertices[[a, b]].mean(axis=0) - [0.0, 0.0, 3.0]
    return np.vstack([vertices, tip]), np.vstack([faces, [[b, a, len(vertices)]]])


def _self_crossing(vertices, faces):
    v = _middle(vertices)
    moved = vertices.copy()
    moved[v] = -1.04 * vertices[v]
    return moved, faces


def _soup(vertices, faces):
    return vertices[faces].reshape(-1, 3), np.arange(faces.size).reshape(-1, 3)


def _nan(folder):
    text = _ascii_vtk(folder).decode()
    head, _, rest = text.partition("double\n")
    words = rest.split(" ", 1)
    return f"{head}double\nnan {words[1]}".encode()


def _ascii_vtk(folder):
    vertices, faces = sound()
    rows = ["# vtk DataFile Version 3.0", "by hand", "ASCII", "DATASET POLYDATA"]
    rows += [f"POINTS {len(vertices)} double"] + [" ".join(map(str, p)) for p in vertices.tolist()]
    rows += [f"POLYGONS {len(faces)} {4 * len(faces)}"]
    rows += [f"3 {a} {b} {c}" for a, b, c in faces.tolist()]
    return "\n".join(rows).encode()


def _truncated(folder):
    write_surface(folder / "whole.vtp", *sound())
    content = (folder / "whole.vtp").read_bytes()
    (folder / "whole.vtp").unlink()
    return content[: len(content) // 2]


def _big_endian_ply(folder):
    vertices, faces = sound()
    head = (
        "ply\nformat binary_big_endian 1.0\n"
        f"element vertex {len(vertices)}\nproperty double x\nproperty double y\n"
        f"property double z\nelement face {len(faces)}\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    cells = np.zeros(len(faces), dtype=[("n", "u1"), ("corners", ">i4", 3)])
    cells["n"], cells["corners"] = 3, faces
    return head.encode() + vertices.astype(">f8").tobytes() + cells.tobytes()


def _quads():
    n, m = 24, 13
    turn = 2 * np.pi * np.arange(n) / n
    fall = np.linspace(0.5, np.pi - 0.5, m)
    points = RADIUS_MM * np.array(
        [[np.sin(f) * np.cos(t), np.sin(f) * np.sin(t), np.cos(f)] for f in fall for t in turn]
    )
    rows = [f"v {x} {y} {z}" for x, y, z in points.tolist()]
    for i in range(m - 1):
        for j in range(n):
            a, b = i * n + j, i * n + (j + 1) % n
            rows.append(f"f {a + 1} {a + n + 1} {b + n + 1} {b + 1}")
    return "\n".join(rows).encode()


def _two_open_quads(folder):
    (folder / "bad_LA.obj").write_bytes(_quads())
    text = (folder / "study.toml").read_text(encoding="utf-8")
    text = text.replace('"mitral", "RPV", "LPV"', '"mitral", "RPV"')
    text = text.replace('"LA.LPV" = [-24, 4, 31]\n', "")
    (folder / "study.toml").write_text(text, encoding="utf-8")
    for k, scale in enumerate((0.97, 1.0, 1.03), start=1):
        vertices, faces = holed_sphere(700, [((0, 0, -1), 0.5, 40), ((0, 0, 1), 0.5, 40)])
        write_surface(folder / f"sound{k}_LA.vtp", RADIUS_MM * scale * vertices, faces)


def _missing_phase(folder):
    vertices, faces = sound()
    for subject in ("a", "b"):
        for phase in ("0", "1", "2"):
            if (subject, phase) != ("b", "1"):
                write_surface(folder / f"{subject}_{phase}_LA.vtp", vertices, faces)
    for k in (1, 2, 3):
        (folder / f"sound{k}_LA.vtp").unlink()
    text = (folder / "study.toml").read_text(encoding="utf-8")
    text = text.replace("{subject}_LA.*", "{subject}_{phase}_LA.vtp")
    (folder / "study.toml").write_text(text, encoding="utf-8")


def _duplicated(folder):
    write_surface(folder / "bad_LA.vtp", *sound())
    (folder / "bad_LA.vtk").write_bytes(_ascii_vtk(folder))


def _into(name):
    def make(folder):
        write_surface(folder / f"{name}_LA.vtp", *sound())

    return make


def _with_handles(count):
    """Join pairs of small holes by tubes through the cavity."""

    def change(vertices, faces):
        ends = [((0.0, 1.0, 0.1), (0.9, 0.3, -0.1)), ((0.0, -1.0, 0.1), (-0.9, -0.3, -0.1))]
        holes = [(end, 0.15, 12) for pair in ends[:count] for end in pair]
        vertices, faces = holed_sphere(900, [MITRAL, RIGHT, LEFT, *holes])
        loops = boundary_loops(faces)
        centers = np.array([vertices[loop].mean(axis=0) for loop in loops])
        tubes = []
        for pair in ends[:count]:
            one, two = (
                loops[int(np.argmax(centers @ (np.array(e) / np.linalg.norm(e))))] for e in pair
            )
            a, b = one[::-1], two
            for i in range(12):
                j = (i + 1) % 12
                tubes += [[a[i], a[j], b[i]], [a[j], b[j], b[i]]]
        return RADIUS_MM * vertices, np.vstack([faces, tubes])

    return change


def _thin(vertices, faces):
    # A vertex is moved almost onto the far edge of one of its triangles.
    v = _middle(vertices)
    a, b = (int(w) for w in faces[(faces == v).any(axis=1)][0] if w != v)
    moved = vertices.copy()
    moved[v] = 0.5 * (vertices[a] + vertices[b]) + 1e-3 * (vertices[v] - vertices[a])
    return moved, faces


def _infinite(folder):
    return _nan(folder).replace(b"double\nnan ", b"double\ninf ")


def _little_endian_ply(folder):
    vertices, faces = sound()
    mesh = pv.PolyData.from_regular_faces(vertices, faces)
    mesh.save(folder / "x.ply", binary=True)
    content = (folder / "x.ply").read_bytes()
    (folder / "x.ply").unlink()
    return content


def _deep(folder):
    below = "/".join(["deep" * 20] * 3)
    (folder / below).mkdir(parents=True)
    for path in folder.glob("*.vtp"):
        path.rename(folder / below / path.name)
    write_surface(folder / below / "bad_LA.vtp", *sound())
    text = (folder / "study.toml").read_text(encoding="utf-8")
    text = text.replace("[shapes]", f'[shapes]\nfolder = "{below}"')
    (folder / "study.toml").write_text(text, encoding="utf-8")


def _duplicated_phase(folder):
    _missing_phase(folder)
    for name in ("a_0_LA.vtk", "a_0_LA.vtp"):
        (folder / name).write_bytes(_ascii_vtk(folder))
    text = (folder / "study.toml").read_text(encoding="utf-8")
    text = text.replace("{subject}_{phase}_LA.vtp", "{subject}_{phase}_LA.*")
    (folder / "study.toml").write_text(text, encoding="utf-8")


def _isolated(vertices, faces):
    return np.vstack([vertices, 100.0 * np.eye(3)]), faces


def _doubled(vertices, faces):
    return vertices, np.vstack([faces, faces[5:9], faces[20:22][:, [1, 0, 2]]])


ZOO = (
    Specimen("sound mesh", _mesh(lambda v, f: (v, f)), "usable", ""),
    Specimen(
        "non-manifold edge (small fin)",
        _mesh(lambda v, f: _fin(v, f, 2.0)),
        "repaired",
        "extra sheet",
    ),
    Specimen("non-manifold edges (large wall)", _mesh(_big_membrane), "refused", "three or more"),
    Specimen("bow-tie vertex (second sheet)", _mesh(_bow_tie), "repaired", "touches itself"),
    Specimen("duplicate vertices (soup)", _mesh(_soup), "repaired", "merged"),
    Specimen("duplicate vertices (STL)", _saved("bad_LA.stl"), "usable", ""),
    Specimen("duplicate faces", _mesh(_doubled), "repaired", "dropped 6 repeated"),
    Specimen("inconsistent orientation", _mesh(_flipped_some), "repaired", "to agree"),
    Specimen(
        "inside-out surface", _mesh(lambda v, f: (v, f[:, [0, 2, 1]])), "repaired", "inside-out"
    ),
    Specimen(
        "degenerate triangle",
        _mesh(lambda v, f: (v, np.vstack([f, [[3, 3, 4]]]))),
        "repaired",
        "degenerate",
    ),
    Specimen("triangle without area", _mesh(_with_slivers), "repaired", "without area"),
    Specimen("sliver triangle", _mesh(_thin), "usable", ""),
    Specimen("isolated vertices", _mesh(_isolated), "repaired", "3 vertices of no triangle"),
    Specimen("small second component", _mesh(_second(2.0, 60.0)), "repaired", "stray piece"),
    Specimen("large second component", _mesh(_second(30.0, 90.0)), "refused", "one connected"),
    Specimen(
        "genus 1",
        _mesh(lambda v, f: (20 * torus(40, 20)[0], torus(40, 20)[1])),
        "refused",
        "1 handle",
    ),
    Specimen("handle on an open surface", _mesh(_with_handles(1)), "refused", "mm round one at"),
    Specimen("genus 2", _mesh(_with_handles(2)), "refused", "2 handles"),
    Specimen("closed where open was expected", _mesh(_closed), "refused", "expected 3 openings"),
    Specimen(
        "tiny spurious loop (six edges)", _mesh(_six_edge_nick, 3000), "repaired", "tiny hole"
    ),
    Specimen("one opening too many", _mesh(_extra_hole(0.2, 14)), "refused", "found 4"),
    Specimen("one opening missing", _mesh(_missing_opening), "refused", "found 2"),
    Specimen("nick that touches an opening", _mesh(_touching_openings, 3000), "repaired", "parted"),
    Specimen("two openings sharing a vertex", _mesh(_touching_vein), "repaired", "touches itself"),
    Specimen("edge joining two rim vertices", _mesh(_chord), "repaired", "join two vertices"),
    Specimen("self-intersection", _mesh(_self_crossing), "repaired", "pass through each other"),
    Specimen("NaN coordinate", _bytes(_nan, "bad_LA.vtk"), "refused", "NaN"),
    Specimen("infinite coordinate", _bytes(_infinite, "bad_LA.vtk"), "refused", "infinite"),
    Specimen("empty file", _bytes(b""), "refused", "empty file"),
    Specimen("truncated file", _bytes(_truncated), "refused", "expected"),
    Specimen(
        "wrong extension (PLY named VTP)", _bytes(_big_endian_ply), "refused", "expected an XML"
    ),
    Specimen("unknown extension", _bytes(b"x", "bad_LA.xyz"), "refused", "ending in"),
    Specimen(
        "point cloud without faces",
        _saved("bad_LA.ply", lambda m: pv.PolyData(m.points)),
        "refused",
        "no triangle|element face",
    ),
    Specimen("quadrilaterals", _two_open_quads, "repaired", "into triangles"),
    Specimen("ASCII file", _bytes(_ascii_vtk, "bad_LA.vtk"), "usable", ""),
    Specimen("binary, big-endian file", _bytes(_big_endian_ply, "bad_LA.ply"), "usable", ""),
    Specimen("binary, little-endian file", _bytes(_little_endian_ply, "bad_LA.ply"), "usable", ""),
    Specimen("metres among millimetres", _mesh(lambda v, f: (v / 1000.0, f)), "refused", "units"),
    Specimen("missing phase", _missing_phase, "repaired", "phase 1"),
    Specimen("duplicated subject", _duplicated, "refused", "expected one file"),
    Specimen("duplicated phase", _duplicated_phase, "refused", "expected one file"),
    Specimen("very long path", _deep, "usable", ""),
    Specimen("non-ASCII name", _into("Þórdís 心房"), "usable", ""),
    Specimen("very long name", _into("x" * 200), "usable", ""),
    Specimen("name with spaces", _into("a  b c"), "usable", ""),
)
