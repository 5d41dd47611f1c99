"""A results folder from a correspondence that was made elsewhere.

Artifacts: ``model.h5``, ``correspondence.h5`` and, where there are triangles, ``evaluation.json``,
all three also in ``optimal/`` where the results of a build have them; ``scores.csv``,
``volumes.csv``, ``clinical.csv``, ``meshes/mean.vtp``, ``fields.bin`` and ``fields/`` (see
`pipeline.carried_fields`) and ``adopted.json`` (from what, and what was concluded).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ostiform.arrays import IntArray
from ostiform.correspondence import align, cut_off_eigenvalue, description_length
from ostiform.errors import InputError, TopologyError
from ostiform.evaluation import (
    MODE_COUNTS,
    Evaluation,
    Fold,
    Generalisation,
    OriginalMesh,
    PlacedFold,
    cross_validated,
    cross_validation_folds,
    fold_residues,
    model_compactness,
    model_specificity,
    part_volumes,
    shape_coverage,
    write_evaluation,
)
from ostiform.exchange import OrderedShapes
from ostiform.model import (
    CorrespondedShapes,
    ShapeModel,
    analysed,
    write_corresponded_shapes,
    write_mean,
)
from ostiform.pipeline.adopt_sources import SourceSettings, read_source
from ostiform.pipeline.carried_fields import Fields, write_fields
from ostiform.pipeline.covariates import write_covariates
from ostiform.pipeline.events import Note, OnEvent, Progress, Warn
from ostiform.pipeline.results import Writer, copy_artifact, result_files, write_all
from ostiform.pipeline.store import Store, key_of
from ostiform.study import AlignmentMode, ShapeId, other_sizes
from ostiform.surface import face_areas, face_normals, median_edge_length, vertex_areas

NOISE_OVER_EDGE = 0.2
"""Noise per coordinate of a surface whose noise is not stated, over its median edge (design 5)."""
FEWEST_SHAPES = 4
SEED = 0
LEAST_VOLUME = 0.005
"""Share of area^1.5 (0.094 for a sphere) below which the sign of a volume says nothing."""
ALIKE, TURNED_AWAY = 30.0, 90.0
"""Degrees: shapes of one frame are turned less; by more where points are in an order turned in
parameter space (by 180 degrees about an axis, as of spherical harmonics)."""
MOST_FOLDED = 0.02
"""Share of the area whose triangles may turn against the mean's without being told."""


@dataclass(frozen=True, slots=True)
class Adopted:
    """What was made of a source.

    Attributes
    ----------
    output : Path
    shapes, points, modes : int
    notes : tuple of str
    """

    output: Path
    shapes: int
    points: int
    modes: int
    notes: tuple[str, ...]

    def as_json(self) -> dict[str, Any]:
        """Return the summary as plain values."""
        return {
            "output": str(self.output),
            "shapes": self.shapes,
            "points": self.points,
            "modes": self.modes,
            "notes": list(self.notes),
        }


def adopt_shapes(
    source: Path,
    output: Path,
    settings: SourceSettings,
    alignment: AlignmentMode = "rigid",
    per: Literal["subject", "shape"] | None = None,
    on_event: OnEvent | None = None,
) -> Adopted:
    """Build a results folder from shapes that correspond already.

    The shapes are aligned, weighted by their mean area shares and analysed; subjects are left out
    in turn as in a build (the correspondence itself was made with all of them, so its residues
    flatter).

    Parameters
    ----------
    source : Path
        See `read_source`.
    output : Path
        Folder for the results; made if missing.
    settings : SourceSettings
    alignment : {"rigid", "similarity", "none"}
    per : {"subject", "shape"}, optional
        What one transform belongs to; by default the subject if any has several phases.
    on_event : callable, optional
        Takes the events of the run.

    Raises
    ------
    OstiformError
        If the source cannot be used or an artifact cannot be written.
    """
    watch: OnEvent = on_event or (lambda _: None)
    if output.exists() and not output.is_dir():
        raise InputError(f"{output}: expected a folder for the results, found a file")
    watch(Progress("read", 0, 1))
    found = read_source(source, settings)
    watch(Progress("read", 1, 1))
    _refuse_other_sizes(found)
    _refuse_mirrored(found)
    shapes = corresponded(found, alignment, _groups(found.ids, per))
    stored = analysed(shapes)
    notes = [*found.notes, *_folds(shapes), *_turns(shapes)]
    store = Store(output)
    key = key_of("adopted", str(source), alignment, [str(id) for id in found.ids])
    files: dict[str, Writer] = {
        "correspondence.h5": partial(write_corresponded_shapes, shapes=shapes),
        **result_files(stored, shapes),
    }
    for name, write in files.items():
        try:
            write_all(store, key, {name: write})
        except (InputError, TopologyError) as error:  # a part that cannot be closed
            notes.append(f"{name}: not measured, {error}")
    for name in ("correspondence.h5", "model.h5"):
        copy_artifact(store, name, f"optimal/{name}", key)
    write_covariates(store, found.ids, found.covariates)
    write_fields(store, key, found.ids, found.fields)
    if len(shapes.mesh.faces):
        notes += _write_surfaces(store, key, shapes, stored.model, found.fields, watch)
    else:
        notes.append("evaluation, volumes and meshes: not made, the points have no triangles")
    for note in notes:
        watch(Note(note))
    facts = {
        "source": str(source.resolve()),
        "alignment": alignment,
        "shapes": [[id.subject, id.phase, id.time] for id in shapes.ids],
        "notes": notes,
    }
    store.write_json("failed.json", key, [])
    store.write_json("adopted.json", key, facts)
    return Adopted(
        output, len(shapes.ids), shapes.points.shape[1], len(stored.model.modes), tuple(notes)
    )


def _refuse_other_sizes(found: OrderedShapes) -> None:
    """Refuse shapes in other units than the others."""
    sizes = [float(np.linalg.norm(np.ptp(points, axis=0))) for points in found.points]
    for k, (usual, ratio) in other_sizes(sizes).items():
        raise InputError(
            f"{found.ids[k]}: expected about {usual:.3g} mm across as the other shapes are, found "
            f"{sizes[k]:.3g} mm, {ratio:,.0f} times {'less' if sizes[k] < usual else 'more'}: its "
            "file is in other units, convert it"
        )


def _refuse_mirrored(found: OrderedShapes) -> None:
    """Refuse shapes of which some are inside out: their order mirrors that of the others."""
    for part, volumes in part_volumes(found.points, found.mesh).items():
        faces = found.mesh.faces[found.mesh.face_part == found.mesh.parts.index(part)]
        areas = np.array([face_areas(points, faces).sum() for points in found.points])
        relative = volumes / np.maximum(areas, 1e-300) ** 1.5
        if relative.min() > -LEAST_VOLUME or relative.max() < LEAST_VOLUME:
            continue
        wrong = relative * np.sign(np.median(relative)) < 0.0
        names = ", ".join(
            str(id) for id, is_wrong in zip(found.ids, wrong, strict=True) if is_wrong
        )
        raise InputError(
            f"{part}: expected the triangles of all shapes to face alike, found {int(wrong.sum())} "
            f"of {len(wrong)} inside out ({names}): their points are in a mirrored order, or the "
            "shapes are mirrored; leave them out or correct them where they were made"
        )


def _folds(shapes: CorrespondedShapes) -> list[str]:
    """Return which shapes have much area that is folded against the mean."""
    faces = shapes.mesh.faces
    if not len(faces):
        return []
    mean = face_normals(shapes.aligned.mean(axis=0), faces)
    notes = []
    for id, points in zip(shapes.ids, shapes.aligned, strict=True):
        against = (face_normals(points, faces) * mean).sum(axis=1) < 0.0
        area = face_areas(points, faces)
        share = float(area[against].sum() / area.sum())
        if share > MOST_FOLDED:
            notes.append(f"{id}: {100.0 * share:.0f} % of the area is folded against the mean")
    return notes


def _turns(shapes: CorrespondedShapes) -> list[str]:
    """Return which shapes were turned far from how the others of one frame lie in their files."""
    linear = shapes.transforms[:, :3, :3]
    rotations = linear / np.cbrt(np.linalg.det(linear))[:, None, None]
    traces = np.einsum("nij,mij->nm", rotations, rotations)
    angles = np.degrees(np.arccos(np.clip(0.5 * (traces - 1.0), -1.0, 1.0)))  # (N, N)
    own = angles[np.median(angles, axis=1).argmin()]
    far = own > TURNED_AWAY
    if not far.any() or (own < ALIKE).mean() <= 0.5 or (far | (own < ALIKE)).sum() < len(own):
        return []
    named = ", ".join(str(id) for id, is_far in zip(shapes.ids, far, strict=True) if is_far)
    return [
        f"{named}: turned by {own[far].min():.0f} degrees or more to lie on the others, which lie "
        "alike in their files: the order of their points may be turned against the others'"
    ]


def corresponded(
    found: OrderedShapes, alignment: AlignmentMode, groups: IntArray
) -> CorrespondedShapes:
    """Return shapes aligned and weighted by their mean area shares (equally without triangles)."""
    count = found.points.shape[1]
    weights = np.full(count, 1.0 / count)
    if len(found.mesh.faces):
        areas = np.stack([vertex_areas(points, found.mesh.faces) for points in found.points])
        weights = (areas / areas.sum(axis=1, keepdims=True)).mean(axis=0)
        if (weights <= 0.0).any():
            raise InputError(
                "meshes: expected every vertex to belong to a triangle, found vertex "
                f"{int(weights.argmin())} without area: remove such vertices from all files"
            )
        weights /= weights.sum()
    aligned = align(found.points, weights, alignment, groups)
    return CorrespondedShapes(
        ids=found.ids,
        points=found.points,
        aligned=aligned.aligned,
        transforms=aligned.transforms,
        weights=weights,
        mesh=found.mesh,
    )


def _groups(ids: Sequence[ShapeId], per: Literal["subject", "shape"] | None) -> IntArray:
    names = [id.subject for id in ids]
    if per is None:
        per = "subject" if len(set(names)) < len(names) else "shape"
    if per == "shape":
        return np.arange(len(ids))
    order = list(dict.fromkeys(names))
    return np.array([order.index(name) for name in names], dtype=np.int64)


def _write_surfaces(
    store: Store,
    key: str,
    shapes: CorrespondedShapes,
    model: ShapeModel,
    fields: Fields,
    on_event: OnEvent,
) -> list[str]:
    """Write what needs triangles, and return what could not be made."""
    notes = []
    with store.writing("meshes/mean.vtp", key) as path:
        write_mean(path, model, fields)
    evaluation = _evaluation(shapes, model)
    if evaluation.generalisation is None:
        notes.append(f"generalisation: not measured, {len(shapes.ids)} shapes are too few")
    with store.writing("evaluation.json", key) as path:
        write_evaluation(path, evaluation)
    copy_artifact(store, "evaluation.json", "optimal/evaluation.json", key)
    worst = min(item.smallest_share for item in evaluation.coverage)
    if worst <= 0.0:
        on_event(Warn("some vertices have no area on some shapes"))
    return notes


def _evaluation(shapes: CorrespondedShapes, model: ShapeModel) -> Evaluation:
    faces = shapes.mesh.faces
    noise = NOISE_OVER_EDGE * float(
        np.median([median_edge_length(points, faces) for points in shapes.points])
    )
    l_cut = cut_off_eigenvalue(noise, len(shapes.ids), shapes.points.shape[1])
    originals = [OriginalMesh(points, faces) for points in shapes.points]
    return Evaluation(
        kind="optimal",
        ids=shapes.ids,
        compactness=model_compactness(model),
        description_length=description_length(shapes.aligned, model.weights, l_cut),
        l_cut=l_cut,
        specificity=model_specificity(model, shapes.aligned, np.random.default_rng(SEED)),
        coverage=tuple(
            shape_coverage(original, points, points, faces)
            for original, points in zip(originals, shapes.points, strict=True)
        ),
        generalisation=_generalisation(shapes, originals),
        truth=None,
    )


def _generalisation(
    shapes: CorrespondedShapes, originals: Sequence[OriginalMesh]
) -> Generalisation | None:
    if len(shapes.ids) < FEWEST_SHAPES:
        return None
    folds = cross_validation_folds(shapes.ids)

    def placed(fold: Fold) -> Iterator[tuple[str, PlacedFold]]:
        train, test = list(fold.train), list(fold.test)
        yield (
            "optimal",
            PlacedFold(
                aligned=shapes.aligned[train],
                weights=shapes.weights,
                mesh=shapes.mesh,
                points=shapes.points[test],
                transforms=shapes.transforms[test],
            ),
        )

    mode_counts = folds.mode_counts(MODE_COUNTS[-1])
    residues = [
        fold_residues(fold, placed, [originals[index] for index in fold.test], mode_counts)
        for fold in folds.folds
    ]
    return cross_validated(folds, residues, mode_counts)["optimal"]
