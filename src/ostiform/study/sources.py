"""The meshes of a shape's parts, from whatever its files are, and where they are to be cut."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.errors import InputError, TopologyError
from ostiform.study.joined import parted_mesh
from ostiform.study.label_parts import label_meshes
from ostiform.study.labelmaps import is_label_map
from ostiform.study.markups import (
    DEFAULT_REACH_MM,
    Cut,
    Markups,
    plane_cut,
    read_markups,
)
from ostiform.study.parts import (
    MIRROR,
    check_frame,
    connected_mesh,
    face_values,
    internal_factors,
)
from ostiform.study.settings import PlaneSettings, StudySettings
from ostiform.study.study import ShapeEntry
from ostiform.surface import (
    RawMesh,
    face_areas,
    placed_vertices,
    read_mesh,
    split_ostium_name,
    without_islands,
    without_unreferenced,
)


@dataclass(frozen=True, slots=True, eq=False)
class PartSources:
    """The meshes of a shape's parts, and where they are open or to be opened.

    Attributes
    ----------
    meshes : mapping of str to RawMesh
        By part, in mm and LPS.
    cuts : mapping of str to mapping of str to Cut
        By part and ostium, those that are still to be made.
    rims : mapping of str to (n, 3) float64
        By full ostium name, of openings that the sources name.
    """

    meshes: Mapping[str, RawMesh]
    cuts: Mapping[str, Mapping[str, Cut]]
    rims: Mapping[str, FloatArray]


def part_meshes(
    settings: StudySettings, entry: ShapeEntry, cuts: Mapping[str, Mapping[str, Cut]]
) -> PartSources:
    """Return the mesh of every part of a shape as its files hold it, in millimetres and LPS.

    Parameters
    ----------
    settings : StudySettings
    entry : ShapeEntry
    cuts : mapping of str to mapping of str to Cut
        By part and ostium.

    Raises
    ------
    InputError
        If a file is missing, damaged, of another frame, or does not hold its part.
    """
    for part in settings.parts:
        if part not in entry.files:
            raise InputError(f"expected a file for the part {part}, found none")
    volumes = [part for part in settings.parts if is_label_map(entry.files[part])]
    if volumes and len(volumes) < len(settings.parts):
        raise InputError(
            "expected meshes or label maps for all parts, found both: extract the surfaces first"
        )
    rims: Mapping[str, FloatArray] = {}
    if volumes:
        full = {f"{part}.{o}": cut for part, own in cuts.items() for o, cut in own.items()}
        made = label_meshes(settings, entry.files, full, entry.frame)
        meshes, rims = dict(made.meshes), made.rims
    elif settings.shapes.split:
        meshes = _split_mesh(settings, entry)
    elif settings.shapes.joined:
        meshes = _joined_mesh(settings, entry, cuts)
    else:
        meshes = {part: file_mesh(settings, part, entry) for part in settings.parts}
    divided = volumes or settings.shapes.split or settings.shapes.joined
    at_seams = {name for seam in settings.seam_pairs for name in (seam.first, seam.second)}
    left = {
        part: {o: cut for o, cut in own.items() if not (divided and f"{part}.{o}" in at_seams)}
        for part, own in cuts.items()
    }
    return PartSources(meshes, left, rims)


def data_beside(path: Path) -> tuple[Path, ...]:
    """Return the files of its name in which a mesh or image keeps points or voxels."""
    endings = {".elem": (".pts",), ".mhd": (".raw", ".zraw"), ".nhdr": (".raw", ".raw.gz")}
    found = (path.with_suffix(ending) for ending in endings.get(path.suffix.lower(), ()))
    return tuple(item for item in found if item.is_file())


def shape_markups(settings: StudySettings, entry: ShapeEntry) -> Markups:
    """Return what the Markups files of a shape hold, cuts by their full ostium names.

    Raises
    ------
    InputError
        If a file cannot be read, a cut has the name of no ostium, or two have one.
    """
    cuts: dict[str, Cut] = {}
    points: dict[str, FloatArray] = {}
    for path in entry.cuts:
        short = [full.partition(".")[2] for full in settings.ostium_names]
        found = read_markups(path, (*settings.ostium_names, *short))
        for name, cut in found.cuts.items():
            owners = _owners(settings, name)
            if not owners:
                raise InputError(
                    f"{path}: expected cuts named by an ostium "
                    f'({", ".join(settings.ostium_names)}), found "{name}": rename the markup or '
                    "its file"
                )
            if owners[0] in cuts:
                raise InputError(f"{path}: expected one cut for {owners[0]}, found two")
            cuts.update(dict.fromkeys(owners, cut))
        if doubled := sorted(points.keys() & found.points.keys()):
            raise InputError(f"{path}: expected every point once, found {doubled[0]} twice")
        points.update(found.points)
    return Markups(cuts, points)


def _owners(settings: StudySettings, name: str) -> list[str]:
    return [full for full in settings.ostium_names if name in (full, full.partition(".")[2])]


def part_cuts(
    settings: StudySettings, entry: ShapeEntry, markups: Markups
) -> dict[str, dict[str, Cut]]:
    """Return the cuts of every part by ostium: of the shape itself, its subject, or all shapes.

    Those of all shapes hold for one that is reflected after it was.
    """
    own = {
        **settings.cuts.shapes.get(entry.id.subject, {}),
        **settings.cuts.shapes.get(str(entry.id), {}),
    }
    factors = internal_factors(settings)
    shared = factors * MIRROR if entry.reflect else factors
    cuts = {name: _plane(plane, shared) for name, plane in settings.cuts.planes.items()}
    cuts.update({name: _plane(plane, factors) for name, plane in own.items()})
    cuts.update(markups.cuts)
    by_part: dict[str, dict[str, Cut]] = {part: {} for part in settings.parts}
    for name, cut in cuts.items():
        part, ostium = split_ostium_name(name)
        by_part[part][ostium] = cut
    return by_part


def stated_points(
    settings: StudySettings, entry: ShapeEntry, markups: Markups
) -> dict[str, FloatArray]:
    """Return the rough points of a shape's own by full ostium name, mm in LPS.

    Those of the study come before those of its Markups files. In these a point is named by an
    ostium in full or, where just one part has it, by the ostium alone; other points are none.
    """
    points = {}
    for name, point in markups.points.items():
        owners = _owners(settings, name)
        if len(owners) == 1:
            points[owners[0]] = point
    factors = internal_factors(settings)
    for key in (entry.id.subject, str(entry.id)):
        stated = settings.ostia.shapes.get(key, {})
        points.update({name: factors * np.array(point) for name, point in stated.items()})
    return points


def _plane(plane: PlaneSettings, factors: FloatArray) -> Cut:
    scale = abs(float(factors[0]))
    reach = DEFAULT_REACH_MM if plane.reach is None else scale * plane.reach
    return plane_cut(factors * np.array(plane.center), factors * np.array(plane.normal), reach)


def file_mesh(settings: StudySettings, part: str, entry: ShapeEntry) -> RawMesh:
    """Return the mesh in the file of a part, in mm and LPS. Errors are those of `part_meshes`."""
    try:
        mesh = read_mesh(entry.files[part])
        check_frame(settings, mesh)
        return replace(mesh, vertices=placed_vertices(mesh, settings.units, settings.frame))
    except InputError as error:
        where = "" if str(entry.files[part]) in str(error) else f" ({entry.files[part]})"
        raise InputError(f"{part}{where}: {error}") from None


def _joined_mesh(
    settings: StudySettings, entry: ShapeEntry, cuts: Mapping[str, Mapping[str, Cut]]
) -> dict[str, RawMesh]:
    """Return the parts of one mesh that the cuts at the seams tell apart."""
    first = settings.part_names[0]
    file = entry.files[first]
    mesh = file_mesh(settings, first, entry)
    full = {f"{part}.{o}": cut for part, own in cuts.items() for o, cut in own.items()}
    try:
        return parted_mesh(settings, mesh, connected_mesh(mesh), full)
    except (InputError, TopologyError) as error:
        raise type(error)(f"{file}: {error}") from None


def _split_mesh(settings: StudySettings, entry: ShapeEntry) -> dict[str, RawMesh]:
    """Return the parts of one mesh that a label of its cells or points tells apart."""
    parts = settings.part_names
    file = entry.files[parts[0]]
    mesh = file_mesh(settings, parts[0], entry)
    array = str(settings.shapes.split["array"])
    values = _majority(mesh, array) if array not in mesh.cell_data else None
    try:
        own = face_values(mesh, array, "shapes.split") if values is None else values
    except InputError as error:
        raise InputError(f"{file}: {error}") from None
    owner = np.full(len(mesh.faces), -1, dtype=np.int64)
    for k, part in enumerate(parts):
        owner[np.isin(own, np.ravel(settings.shapes.split[part]))] = k
        if not (owner == k).any():
            shown = ", ".join(f"{v:g}" for v in np.unique(own)[:12])
            raise InputError(
                f"{file}: expected triangles of value {settings.shapes.split[part]} in {array} for "
                f"the part {part}, found the values {shown}: check shapes.split"
            )
    used = np.flatnonzero(owner >= 0)
    owner[used] = without_islands(
        mesh.faces[used], owner[used], face_areas(mesh.vertices, mesh.faces[used])
    )
    return {part: _part_of(mesh, owner == k) for k, part in enumerate(parts)}


def _majority(mesh: RawMesh, array: str) -> FloatArray | None:
    """Return the value (F,) of a point array that most corners of a face have."""
    values = mesh.point_data.get(array)
    if values is None or values.ndim != 1 or values.dtype.kind not in "iufb":
        return None
    # The middle of three values is that of at least two corners where two agree.
    middle: FloatArray = np.sort(values[mesh.faces].astype(np.float64), axis=1)[:, 1]
    return middle


def _part_of(mesh: RawMesh, chosen: FloatArray) -> RawMesh:
    rows = np.flatnonzero(chosen)
    kept, faces = without_unreferenced(mesh.faces[rows], len(mesh.vertices))
    point_data: Mapping[str, FloatArray] = {n: v[kept] for n, v in mesh.point_data.items()}
    return RawMesh(
        mesh.vertices[kept],
        faces,
        point_data,
        {name: values[rows] for name, values in mesh.cell_data.items()},
        mesh.space,
        mesh.notes,
    )
