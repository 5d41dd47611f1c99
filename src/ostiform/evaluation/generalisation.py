"""How well a model fits shapes that it was not built from (HY 2.4, Fig. 4 right; design 6)."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.errors import InputError
from ostiform.evaluation.distances import ComparedSurface, compared_surface, distances_from
from ostiform.evaluation.folds import Division, Fold, Folds
from ostiform.model import ModelMesh, ShapeModel, fit_model, project, reconstruct
from ostiform.values import Axes, value

MODE_COUNTS = tuple(range(11))
"""Numbers of modes at which residues are reported; 0 is the distance to the mean."""

MEASURES = ("point", "surface_mean", "surface_p95", "surface_max")


@value
class OriginalMesh:
    """The surface of a shape as it came, all parts together, in input coordinates.

    Attributes
    ----------
    vertices : (V, 3) float64, mm
    faces : (F, 3) int64
    """

    vertices: Annotated[FloatArray, Axes("V", 3)]
    faces: Annotated[IntArray, Axes("F", 3)]


@dataclass(frozen=True, slots=True, eq=False)
class PlacedFold:
    """One kind of model built without some shapes, and where it places the points on those.

    Attributes
    ----------
    aligned : (N, P, 3) float64, mm
        The training shapes.
    weights : (P,) float64
        Area shares of the training population, sum 1.
    mesh : ModelMesh
    points : (n, P, 3) float64, mm
        The left-out shapes in correspondence, in their input coordinates.
    transforms : (n, 4, 4) float64
        From input coordinates to the training frame (column vectors).
    """

    aligned: FloatArray
    weights: FloatArray
    mesh: ModelMesh
    points: FloatArray
    transforms: FloatArray


@value
class Residues:
    """What a model leaves of one shape, for several numbers of modes; mm in input coordinates.

    Attributes
    ----------
    point : (M,) float64
        Weighted RMS distance of the reconstruction from the shape's own corresponding points.
    surface_mean, surface_p95, surface_max : (M,) float64
        Distance between the reconstruction and the original mesh, both ways.
    """

    point: Annotated[FloatArray, Axes("M")]
    surface_mean: Annotated[FloatArray, Axes("M")]
    surface_p95: Annotated[FloatArray, Axes("M")]
    surface_max: Annotated[FloatArray, Axes("M")]


FoldResidues = Mapping[str, Sequence[Residues]]
"""Residues of a fold's test shapes, in the order of `Fold.test`, by the kind of model."""


@value
class Generalisation:
    """Residues of every shape under a model built without it.

    Attributes
    ----------
    division : Division
        What was left out together.
    mode_counts : (M,) int64
    point, surface_mean, surface_p95, surface_max : (N, M) float64, mm
        As in `Residues`, shapes in study order.
    """

    division: Division
    mode_counts: Annotated[IntArray, Axes("M")]
    point: Annotated[FloatArray, Axes("N", "M")]
    surface_mean: Annotated[FloatArray, Axes("N", "M")]
    surface_p95: Annotated[FloatArray, Axes("N", "M")]
    surface_max: Annotated[FloatArray, Axes("N", "M")]


def shape_residues(
    model: ShapeModel,
    points: FloatArray,
    transform: FloatArray,
    original: ComparedSurface,
    mode_counts: Sequence[int] = MODE_COUNTS,
) -> Residues:
    """Return what the first m modes of a model leave of a shape that it was not built from.

    The shape is projected on the modes in the model's frame; the reconstruction is carried back
    to input coordinates and compared there, so that residues are millimetres of the input even
    where the alignment scales. A number of modes beyond the model's takes all that there are.

    Parameters
    ----------
    model : ShapeModel
    points : (P, 3) float64, mm
        The shape in correspondence, in its input coordinates.
    transform : (4, 4) float64
        From input coordinates to the model's frame (column vectors).
    original : ComparedSurface
        The shape's surface as it came.
    mode_counts : sequence of int
    """
    linear, translation = transform[:3, :3], transform[:3, 3]
    scores = project(model, points @ linear.T + translation)  # (K,)
    used = np.minimum(np.asarray(mode_counts), len(scores))
    levels, level = np.unique(used, return_inverse=True)
    kept = np.arange(len(scores)) < levels[:, None]  # (L, K)
    aligned = reconstruct(model, kept * scores)  # (L, P, 3)
    reconstructions: FloatArray = (aligned - translation) @ np.linalg.inv(linear).T  # (L, P, 3)
    squared = ((reconstructions - points) ** 2).sum(axis=2)  # (L, P)
    distances = distances_from(original, reconstructions, model.mesh.faces)
    return Residues(
        point=np.sqrt(squared @ model.weights)[level],
        surface_mean=np.array([distance.mean for distance in distances])[level],
        surface_p95=np.array([distance.p95 for distance in distances])[level],
        surface_max=np.array([distance.maximum for distance in distances])[level],
    )


def fold_residues(
    fold: Fold,
    place: Callable[[Fold], Iterable[tuple[str, PlacedFold]]],
    originals: Sequence[OriginalMesh],
    mode_counts: Sequence[int] = MODE_COUNTS,
) -> FoldResidues:
    """Return the residues of a fold's test shapes under every kind of model built without them.

    Pure and importable by name, so that folds can run in different processes.

    Parameters
    ----------
    fold : Fold
    place : callable
        Builds the models from ``fold.train`` and places ``fold.test``, with the kind of model: one
        after the other, so that no two need be held.
    originals : sequence of OriginalMesh
        Of the test shapes, in the order of ``fold.test``.
    mode_counts : sequence of int

    Raises
    ------
    InputError
        If `place` or `originals` do not hold one item per test shape.
    """
    residues = {}
    surfaces = [compared_surface(original.vertices, original.faces) for original in originals]
    for kind, placed in place(fold):
        if not len(placed.points) == len(placed.transforms) == len(originals) == len(fold.test):
            raise InputError(
                f"fold {fold.label}: expected {len(fold.test)} placed shapes with their original "
                f"meshes, found {len(placed.points)} and {len(originals)}"
            )
        model = fit_model(placed.aligned, placed.weights, placed.mesh)
        residues[kind] = tuple(
            shape_residues(model, points, transform, original, mode_counts)
            for points, transform, original in zip(
                placed.points, placed.transforms, surfaces, strict=True
            )
        )
    return residues


def cross_validated(
    folds: Folds,
    results: Iterable[FoldResidues],
    mode_counts: Sequence[int] = MODE_COUNTS,
) -> Mapping[str, Generalisation]:
    """Gather the residues of all folds, by kind of model, shapes in study order.

    Parameters
    ----------
    folds : Folds
    results : iterable of FoldResidues
        One per fold, in the order of the folds; whatever ran them (a loop, processes) may be
        the iterable.
    mode_counts : sequence of int
        Those the residues were computed for.

    Raises
    ------
    InputError
        If there are more or fewer results than folds, or kinds are missing in some.
    """
    collected: dict[str, dict[int, Residues]] = {}
    gathered = list(results)
    if len(gathered) != len(folds.folds):
        raise InputError(
            f"cross-validation: expected the results of {len(folds.folds)} folds, "
            f"found {len(gathered)}"
        )
    for fold, result in zip(folds.folds, gathered, strict=True):
        for kind, residues in result.items():
            collected.setdefault(kind, {}).update(zip(fold.test, residues, strict=True))
    for kind, by_shape in collected.items():
        if len(by_shape) != folds.count:
            raise InputError(
                f"cross-validation of the {kind} model: expected residues of {folds.count} "
                f"shapes, found {len(by_shape)}"
            )
    return {
        kind: Generalisation(
            folds.division,
            np.asarray(mode_counts),
            *(
                np.stack([getattr(by_shape[index], name) for index in range(folds.count)])
                for name in MEASURES
            ),
        )
        for kind, by_shape in collected.items()
    }
