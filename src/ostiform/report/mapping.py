"""What a report says about the maps to the sphere (HY Fig. 2)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.domain import Sphere, stereographic_view
from ostiform.embedding import Embedding, EmbeddingState
from ostiform.evaluation import MapRecord, MapRecords, SeamKink
from ostiform.report.distortions import distortion_figure, seam_figure
from ostiform.report.html import Picture, Section, Table
from ostiform.report.maps import MapPanel, map_figure
from ostiform.surface import Seam, exact_orientations

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

PAPER_NAMES = STATE_NAMES | {"tutte": "initial (Tutte)", "harmonic": "harmonic descent"}

INNERMOST = 0.8
"""An opening lies inside the disc of radius 1 if all of it is within this radius."""

ZOOM_MARGIN = 1.5
"""Side of the enlarged square over the extent of the openings."""

NO_POINTS = np.empty((0, 2))


@dataclass(frozen=True, slots=True, eq=False)
class StateView:
    """A chain of states of one part of one shape, to be drawn.

    Attributes
    ----------
    label : str
        Of the shape.
    embedding : Embedding
    sphere : Sphere
    part : str
    paper : tuple of EmbeddingState
        The states of the paper's chain on the same mesh; none on a closed surface.
    interior, boundary : (C, 3) float64
        Control points on the sphere, inside and on openings and seams.
    """

    label: str
    embedding: Embedding
    sphere: Sphere
    part: str
    paper: tuple[EmbeddingState, ...]
    interior: FloatArray
    boundary: FloatArray


def maps_section(maps: MapRecords, view: StateView) -> Section:
    """Return the maps of one part step by step, and the quality of all maps.

    Parameters
    ----------
    maps : MapRecords
    view : StateView
        What is drawn.
    """
    shapes, kinks = maps.shapes, maps.kinks
    steps = _panels(view, view.embedding.states, STATE_NAMES)
    used = _panels(view, view.embedding.states[-1:], {}, "conformal, as used")
    paper = [*_panels(view, view.paper, PAPER_NAMES), *used, _control_panel(view, used[0])]
    zoom = _around_openings(used[0])
    enlarged = "" if zoom is None else " The lower row enlarges the dashed square."
    seams = [_seam_picture(shapes, kinks)] if kinks else []
    return Section(
        "maps",
        "Maps to the sphere",
        (
            f"Part {view.part} of shape {view.label} in the stereographic plane (compare Fig. 2 of "
            "the paper). Orange triangles are turned over; blue lines are openings and seams."
            f"{enlarged}",
            f"{_paper_text(view)}Beside it the map that is used and the control points of the "
            "correspondence.",
        ),
        (
            Picture(
                "maps-paper",
                map_figure(paper, zoom),
                f"{'The states of the paper chain, t' if view.paper else 'T'}he map that is used, "
                "and the control points: dots inside, white squares on openings and seams.",
                "Flattened meshes, one per state; the number of triangles turned over is above "
                "each. The last one shows the control points.",
                is_vector=False,
            ),
            Picture(
                "maps",
                map_figure(steps, zoom),
                f"The map that is used, step by step (method: {view.embedding.method}); "
                f"{len(steps[0].faces)} triangles.",
                "Flattened meshes, one per step; the number of triangles turned over is above "
                "each.",
                is_vector=False,
            ),
            _distortion_picture(shapes),
            *seams,
        ),
        (_quality_table(shapes), *_seam_tables(shapes, kinks)),
    )


def _paper_text(view: StateView) -> str:
    if not view.paper:
        return "A closed surface has no opening from which the paper's own chain could project it. "
    final = view.paper[-1]
    ratio = max(view.embedding.distortion.circle_ratio.values(), default=1.0)
    folded = (
        f"ends with {final.flipped} triangles turned over"
        if final.flipped
        else "ends without a fold"
    )
    return (
        "First the paper's own chain on this mesh (fixed circles, untangling by the least area, "
        f"smoothing, harmonic descent): it {folded}. The widest circle has {ratio:.1f} times the "
        "radius its opening gets in the conformal map of the surface with filled holes; beyond "
        "about 2 the harmonic map is folded at its minimum, however good the start. "
    )


def _panels(
    view: StateView,
    states: Sequence[EmbeddingState],
    names: Mapping[str, str],
    otherwise: str | None = None,
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
    for state in states:
        directions = _away_from_pole(np.asarray(state.directions, dtype=np.float64))
        panels.append(
            MapPanel(
                names.get(state.name, otherwise or state.name),
                stereographic_view(view.sphere, view.part, directions[used]),
                local[faces],
                exact_orientations(directions, faces) <= 0,
                tuple(curves),
                NO_POINTS,
                NO_POINTS,
            )
        )
    return panels


def _control_panel(view: StateView, panel: MapPanel) -> MapPanel:
    """The map with the control points of its part."""
    return replace(
        panel,
        title="control points",
        controls=_seen_controls(view, view.interior),
        boundary_controls=_seen_controls(view, view.boundary),
        says_flips=False,
    )


def _seen_controls(view: StateView, controls: FloatArray) -> FloatArray:
    if not len(controls):
        return NO_POINTS
    seen = stereographic_view(view.sphere, view.part, controls)
    on_part: FloatArray = seen[np.linalg.norm(seen, axis=1) < 1.0 + 1e-6, :2]
    return on_part


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


def _distortion_picture(shapes: Sequence[MapRecord]) -> Picture:
    columns = list(zip(*(shape.components for shape in shapes), strict=True))
    return Picture(
        "distortion",
        distortion_figure(
            [np.array([record.angles for record in column]) for column in columns],
            [np.array([record.areas for record in column]) for column in columns],
            [column[0].name for column in columns],
        ),
        "Angle and area distortion over the surface, mean over the shapes; the band holds 90 % of "
        "the shapes. Both are 1 without distortion; the first and last bins hold what lies beyond.",
        "Two histograms: ratio of the singular values of the map, and area share of the sphere "
        "over area share of the surface.",
    )


def _seam_picture(shapes: Sequence[MapRecord], kinks: Mapping[Seam, SeamKink]) -> Picture:
    jumps, floors, both = {}, {}, {}
    for seam, number in _seams_of(shapes).items():
        records = [shape.components[number] for shape in shapes]
        name = f"{seam.first} = {seam.second}"
        jumps[name] = np.array([record.jumps[seam] for record in records])
        measured = [record.distortion.seam_jump[seam] for record in records]
        floors[name] = float(np.mean([jump.floor_mean for jump in measured]))
        both[name] = (np.array([jump.kink for jump in measured]), kinks[seam].kink)
    return Picture(
        "seams",
        seam_figure(jumps, floors, both),
        "The kink across the seams. Left: relative jump of the derivative across the seam, over "
        "the length of the seam, mean over the shapes with the band that holds 90 % of them; the "
        "dashed line is the jump beside the seam, which the meshes cause. Right: ratio of the "
        "derivatives on the two sides, one dot per shape, the bar their mean; the model is smooth "
        "(G1) across the seam where the dots agree.",
        "A histogram of the jump along the seam, and dots of the mean kink of every shape as "
        "mapped and after the warps.",
    )


def _seams_of(shapes: Sequence[MapRecord]) -> dict[Seam, int]:
    """The seams, with the number of the component that each is in."""
    return {
        seam: number
        for number, record in enumerate(shapes[0].components)
        for seam in record.distortion.seam_jump
    }


def _quality_table(shapes: Sequence[MapRecord]) -> Table:
    rows = []
    for shape in shapes:
        for record in shape.components:
            certificate, distortion = record.certificate, record.distortion
            twist = max((abs(angle) for angle in certificate.twist.values()), default=0.0)
            rows.append(
                (
                    distortion.angle_mean,
                    (
                        shape.label,
                        record.name,
                        str(record.vertices),
                        f"{certificate.flipped} + {certificate.degenerate}",
                        f"{distortion.angle_mean:.2f}",
                        f"{distortion.angle_p99:.1f}",
                        f"{distortion.area_p01:.2f} to {distortion.area_p99:.2f}",
                        f"{np.degrees(twist):.0f}",
                        f"{max(distortion.circle_ratio.values(), default=1.0):.1f}",
                        f"{record.seconds:.2f}",
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
        texts=(1,),
    )


def _seam_tables(shapes: Sequence[MapRecord], kinks: Mapping[Seam, SeamKink]) -> list[Table]:
    rows = []
    for seam, number in _seams_of(shapes).items():
        jumps = [shape.components[number].distortion.seam_jump[seam] for shape in shapes]
        means = np.array([jump.mean for jump in jumps])
        rows.append(
            (
                f"{seam.first} = {seam.second}",
                f"{means.mean():.3f} (sd {means.std():.3f}, worst {means.max():.3f})",
                f"{np.mean([jump.p95 for jump in jumps]):.3f}",
                f"{np.mean([jump.floor_mean for jump in jumps]):.3f}",
                f"{np.std([jump.kink for jump in jumps]):.4f} / {kinks[seam].kink.std():.4f}",
                f"{np.degrees(np.std([jump.shear for jump in jumps])):.2f} / "
                f"{np.degrees(kinks[seam].shear.std()):.2f}",
            )
        )
    if not rows:
        return []
    return [
        Table(
            "Continuity of the tangent across seams: relative jump of the co-normal derivative",
            (
                "seam",
                "jump, mean over shapes",
                "95 % along the seam",
                "floor of the meshes",
                "sd of the kink between shapes, mapped / warped",
                "sd of the shear (deg), mapped / warped",
            ),
            tuple(rows),
        )
    ]
