"""What a report says about the maps to the sphere (HY Fig. 2), and about the run itself."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.domain import Sphere, stereographic_view
from ostiform.embedding import Embedding, EmbeddingState
from ostiform.report.html import Picture, Section, Table
from ostiform.report.maps import MapPanel, distortion_figure, map_figure
from ostiform.surface import exact_orientations

__all__ = ["ShapeMaps", "StateView", "maps_section", "run_section"]

STATE_NAMES = {
    "tutte": "Tutte",
    "opened": "opened",
    "untangled": "untangled",
    "arc-length": "arc length",
    "smoothed": "smoothed",
    "harmonic": "harmonic",
    "conformal": "conformal",
    "equator": "seam on its circle",
    "joint": "parts together",
    "start": "filled holes",
}

INNERMOST = 0.8
"""An opening lies inside the disc of radius 1 if all of it is within this radius."""

ZOOM_MARGIN = 1.5
"""Side of the enlarged square over the extent of the openings."""


@dataclass(frozen=True, slots=True, eq=False)
class ShapeMaps:
    """The maps of one shape, one per component.

    Attributes
    ----------
    label : str
    embeddings : tuple of Embedding
    """

    label: str
    embeddings: tuple[Embedding, ...]


@dataclass(frozen=True, slots=True, eq=False)
class StateView:
    """A chain of states of one part of one shape, to be drawn.

    Attributes
    ----------
    embedding : Embedding
    sphere : Sphere
    part : str
    paper : tuple of EmbeddingState
        The states of the paper's chain on the same mesh.
    controls : (C, 3) float64
        Control points on the sphere.
    """

    embedding: Embedding
    sphere: Sphere
    part: str
    paper: tuple[EmbeddingState, ...]
    controls: FloatArray


def maps_section(shapes: Sequence[ShapeMaps], view: StateView, label: str) -> Section:
    """Return the maps of one part step by step, and the quality of all maps.

    Parameters
    ----------
    shapes : sequence of ShapeMaps
    view : StateView
        Of the shape that is drawn.
    label : str
        Of that shape.
    """
    panels = _panels(view, view.embedding.states, with_controls=True)
    zoom = _around_openings(panels[-1])
    ours = map_figure(panels, zoom)
    paper = map_figure(_panels(view, view.paper, with_controls=False), zoom)
    final = view.paper[-1]
    ratio = max(view.embedding.distortion.circle_ratio.values(), default=1.0)
    folded = (
        f"it ends with {final.flipped} triangles turned over"
        if final.flipped
        else "it ends without a fold"
    )
    return Section(
        "maps",
        "Maps to the sphere",
        (
            f"Part {view.part} of shape {label} in the stereographic plane, step by step (compare "
            "Fig. 2 of the paper). Orange triangles are turned over; blue lines are openings and "
            "seams; dots are the control points of the correspondence. The lower row enlarges the "
            "dashed square around the openings.",
            "The paper's own chain (fixed circles, untangling by the least area, smoothing, "
            f"harmonic descent) on the same mesh is shown below: {folded}. The widest circle has "
            f"{ratio:.1f} times the radius its opening gets in the conformal map of the surface "
            "with filled holes; beyond about 2 the harmonic map is folded at its minimum, "
            "however good the start.",
        ),
        (
            Picture(
                "maps",
                ours,
                f"The map that is used, step by step (method: {view.embedding.method}); "
                f"{len(panels[0].faces)} triangles.",
                "Flattened meshes, one per step; the number of triangles turned over is above "
                "each.",
                is_vector=False,
            ),
            Picture(
                "maps-paper",
                paper,
                "The paper's chain on the same mesh.",
                "Flattened meshes, one per step; the number of triangles turned over is above "
                "each.",
                is_vector=False,
            ),
            _distortion_picture(shapes),
        ),
        (_quality_table(shapes), *_seam_tables(shapes)),
    )


def run_section(facts: Mapping[str, str], notes: Sequence[tuple[str, str]]) -> Section:
    """Return what was run: versions, settings, hashes; and what was repaired or left out.

    Parameters
    ----------
    facts : mapping of str to str
        Names that begin with ``settings:`` or ``circle`` go into tables of their own.
    notes : sequence of (str, str)
        Shape, and what was repaired or why it was left out.
    """
    groups: dict[str, dict[str, str]] = {
        "Versions and inputs": {},
        "Settings": {},
        "Circles of the base domain": {},
    }
    for name, value in facts.items():
        kind, _, rest = name.partition(" ")
        if kind == "settings:":
            groups["Settings"][rest] = value
        elif kind == "circle":
            groups["Circles of the base domain"][rest] = value
        else:
            groups["Versions and inputs"][name] = value
    tables = [
        Table(title, ("name", "value"), tuple(group.items()))
        for title, group in groups.items()
        if group
    ]
    if notes:
        tables.append(Table("Repairs and shapes left out", ("shape", "what"), tuple(notes)))
    return Section("run", "What was run", (), (), tuple(tables))


def _panels(
    view: StateView, states: Sequence[EmbeddingState], with_controls: bool
) -> list[MapPanel]:
    component = view.embedding.component
    own = component.face_part == component.parts.index(view.part)
    faces = component.faces[own]
    used = np.unique(faces)
    local = np.full(len(component.vertices), -1, dtype=np.int64)
    local[used] = np.arange(len(used))
    curves = [
        local[curve]
        for curve in (*component.rims.values(), *component.seams.values())
        if (local[curve] >= 0).all()
    ]
    panels = []
    for number, state in enumerate(states):
        directions = _away_from_pole(np.asarray(state.directions, dtype=np.float64))
        is_last = with_controls and number == len(states) - 1
        controls = view.controls if is_last else np.empty((0, 3))
        seen = stereographic_view(view.sphere, view.part, controls) if len(controls) else controls
        near = np.linalg.norm(seen, axis=1) < 1.0 + 1e-6 if len(seen) else np.empty(0, bool)
        panels.append(
            MapPanel(
                STATE_NAMES.get(state.name, state.name),
                stereographic_view(view.sphere, view.part, directions[used]),
                local[faces],
                exact_orientations(directions, faces) <= 0,
                tuple(curves),
                seen[near, :2] if len(seen) else np.empty((0, 2)),
            )
        )
    return panels


def _around_openings(panel: MapPanel) -> FloatArray | None:
    """Centre and half side of a square around the openings inside the disc; None without any."""
    inner = [
        panel.points[curve]
        for curve in panel.curves
        if np.linalg.norm(panel.points[curve], axis=1).max() < INNERMOST
    ]
    if not inner:
        return None
    seen = np.vstack(inner)
    low, high = seen.min(axis=0), seen.max(axis=0)
    half = ZOOM_MARGIN * 0.5 * float((high - low).max())
    return None if half > INNERMOST else np.array([*(0.5 * (low + high)), half])


def _away_from_pole(directions: FloatArray) -> FloatArray:
    """Unit vectors in double precision, none exactly at a centre of projection."""
    moved = directions + 1e-9
    away: FloatArray = moved / np.linalg.norm(moved, axis=1)[:, None]
    return away


def _distortion_picture(shapes: Sequence[ShapeMaps]) -> Picture:
    names = [embedding.component.name for embedding in shapes[0].embeddings]
    columns = list(zip(*(shape.embeddings for shape in shapes), strict=True))
    return Picture(
        "distortion",
        distortion_figure(
            [np.array([e.distortion.angle_median for e in column]) for column in columns],
            [
                np.array([[e.distortion.area_p01, e.distortion.area_p99] for e in column])
                for column in columns
            ],
            names,
        ),
        "Angle and area distortion of the maps of all shapes; both are 1 without distortion.",
        "A histogram of the median angle distortion and the range of area distortion per shape.",
    )


def _quality_table(shapes: Sequence[ShapeMaps]) -> Table:
    rows = []
    for shape in shapes:
        for embedding in shape.embeddings:
            certificate, distortion = embedding.certificate, embedding.distortion
            twist = max((abs(angle) for angle in certificate.twist.values()), default=0.0)
            rows.append(
                (
                    distortion.angle_mean,
                    (
                        shape.label,
                        embedding.component.name,
                        str(len(embedding.component.vertices)),
                        f"{certificate.flipped} + {certificate.degenerate}",
                        f"{distortion.angle_mean:.2f}",
                        f"{distortion.angle_p99:.1f}",
                        f"{distortion.area_p01:.2f} to {distortion.area_p99:.2f}",
                        f"{np.degrees(twist):.0f}",
                        f"{max(distortion.circle_ratio.values(), default=1.0):.1f}",
                        f"{embedding.seconds:.2f}",
                    ),
                )
            )
    rows.sort(key=lambda row: -row[0])
    return Table(
        "Every map, the most distorted first",
        (
            "shape",
            "component",
            "vertices",
            "turned over + degenerate",
            "angle, mean",
            "angle, 99 %",
            "sphere / surface area, 1 to 99 %",
            "largest twist (deg)",
            "widest circle / conformal",
            "time (s)",
        ),
        tuple(row for _, row in rows),
    )


def _seam_tables(shapes: Sequence[ShapeMaps]) -> list[Table]:
    seams = [
        (number, seam)
        for number, embedding in enumerate(shapes[0].embeddings)
        for seam in embedding.distortion.seam_jump
    ]
    if not seams:
        return []
    rows = []
    for number, seam in seams:
        jumps = [shape.embeddings[number].distortion.seam_jump[seam] for shape in shapes]
        means = np.array([jump.mean for jump in jumps])
        rows.append(
            (
                f"{seam.first} = {seam.second}",
                f"{means.mean():.3f} (sd {means.std():.3f}, worst {means.max():.3f})",
                f"{np.mean([jump.p95 for jump in jumps]):.3f}",
                f"{np.mean([jump.floor_mean for jump in jumps]):.3f}",
                f"{np.std([jump.kink for jump in jumps]):.4f}",
                f"{np.degrees(np.std([jump.shear for jump in jumps])):.2f}",
            )
        )
    return [
        Table(
            "Continuity of the tangent across seams: relative jump of the co-normal derivative",
            (
                "seam",
                "jump, mean over shapes",
                "95 % along the seam",
                "floor of the mesh",
                "sd of the kink between shapes",
                "sd of the shear (deg)",
            ),
            tuple(rows),
        )
    ]
