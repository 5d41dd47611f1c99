"""The common pose of a population, from what every shape has: its openings and its parts.

A rough rigid alignment before there is any correspondence: it makes directions comparable between
shapes (where the openings lie, how a map turns about its pole). Shapes whose landmarks do not
determine a rotation (none or one opening, openings on one line) are turned so that their surfaces
fit.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Annotated

import numpy as np

from ostiform.arrays import BoolArray, FloatArray
from ostiform.domain.procrustes import (
    best_rotations,
    homogeneous,
    superposed,
    weighted_norms,
)
from ostiform.domain.shared_frame import kept_to_shared_frame, kept_to_subjects
from ostiform.domain.surface_fit import (
    SurfaceSample,
    fit_at,
    fitted_rotation,
    reflection_ratio,
    sampled_surface,
)
from ostiform.errors import InputError
from ostiform.study import Shape, ShapeId
from ostiform.surface import Surface
from ostiform.values import Axes, value

# Second singular value of the landmarks over the shape's radius of gyration below which they lie
# on one line as far as a rotation about it is concerned: 3 degrees of error per 0.25 % of noise.
COLLINEAR_BELOW = 0.05

# A shape is reported as mirrored when its mirror image fits the reference better by this factor; by
# surfaces, by less where others fit worse mirrored: by half (on a logarithmic scale) of what is
# usual, more where landmarks say otherwise. Six atria of patients fit 1.2 to 2.1 times worse
# by their surfaces; mirrored, with the names that then fit best, 0.5 to 0.8 times.
MIRRORED_BELOW = 0.6
LEAST_ASYMMETRY = 1.2
AS_USUAL, AGAINST_LANDMARKS = 0.5, 0.75
FEWEST_TO_COMPARE = 4

# So many shapes, the first of each subject, are also compared by surfaces where landmarks give
# the pose: names that were given to a mirrored shape may make its landmarks fit.
MOST_COMPARED = 40

# Relative difference below which two shapes count as equally good references.
TIE = 1e-9

MAX_ITERATIONS = 1000


class PoseMethod(Enum):
    """What the rotations of a population rest on."""

    LANDMARKS = "the centroids of openings and parts"
    AXIS_AND_SURFACE = "the line through the landmarks, and the fit of the surfaces about it"
    SURFACE = "the fit of the surfaces"
    FILES = "the frame of the files"


@value
class PopulationPoses:
    """Rigid transforms of the shapes of a population to one frame.

    Attributes
    ----------
    transforms : (N, 4, 4) float64
        From each shape's input coordinates to the population's frame (column vectors), which is
        the input frame of the reference.
    mirrored : (N,) bool
        Whether the shape would fit the reference better as its mirror image, by its landmarks or
        by its surface, as clearly as others would fit worse.
    residuals : (N,) float64, mm
        Root mean square distance of each shape's landmarks from the reference's; of its surface
        samples where the landmarks do not determine the rotation.
    reference : int
        The medoid, the shape nearest to the mean.
    method : PoseMethod
    """

    transforms: Annotated[FloatArray, Axes("N", 4, 4)]
    mirrored: Annotated[BoolArray, Axes(None)]
    residuals: Annotated[FloatArray, Axes("N")]
    reference: int
    method: PoseMethod


@dataclass(frozen=True, slots=True, eq=False)
class PoseFeatures:
    """What the pose of a shape rests on: all that a population needs to know of it.

    Attributes
    ----------
    id : ShapeId
    landmarks : mapping of str to (3,) float64, mm
    sample : SurfaceSample
    """

    id: ShapeId
    landmarks: Mapping[str, FloatArray]
    sample: SurfaceSample


def pose_features(shape: Shape) -> PoseFeatures:
    """Return what the pose of a shape rests on.

    Raises
    ------
    InputError
        If the shape has no area.
    """
    sample = sampled_surface(str(shape.id), list(shape.parts.values()))
    return PoseFeatures(shape.id, landmarks(shape), sample)


def population_poses(shapes: Sequence[Shape], trusted: bool = False) -> PopulationPoses:
    """Return the rigid transforms that bring the shapes of a population into one frame.

    Weighted generalised Procrustes analysis of the landmarks (`landmarks`), then, if they lie in
    a point or on a line, a fit of the surfaces to the medoid's from 24 starting rotations; what
    the files share (one frame, or the phases of a subject one) is kept where the surfaces do not
    speak against it. The time grows linearly with the number of shapes, and their order does not
    matter. Where nothing is shared, moving one input rigidly changes only its own transform (and,
    if it is the reference, the common frame).

    Parameters
    ----------
    shapes : sequence of Shape
        With the same parts, openings and seams.
    trusted : bool
        Whether all files share a frame, as the user says: shapes are moved, not turned.

    Raises
    ------
    InputError
        If there is no shape, the shapes differ in parts or openings, or one has no area.
    """
    return poses_of_features([pose_features(shape) for shape in shapes], trusted)


def poses_of_features(shapes: Sequence[PoseFeatures], trusted: bool = False) -> PopulationPoses:
    """Return the poses of `population_poses` from the features of its shapes.

    Raises
    ------
    InputError
        If there is no shape, or the shapes differ in parts or openings.
    """
    if not shapes:
        raise InputError("population: expected at least one shape to pose, found none")
    names, positions = _all_landmarks(shapes)
    samples = [shape.sample for shape in shapes]
    weights = np.full(len(names), 1.0 / len(names))
    centroids = np.einsum("l,nli->ni", weights, positions)  # (N, 3)
    centred = positions - centroids[:, None, :]  # (N, L, 3)
    method = _method(centred, samples)
    posed = (
        _posed_by_landmarks(shapes, centred, centroids, weights)
        if method is PoseMethod.LANDMARKS
        else _posed_by_surfaces(shapes, samples, centred, method)
    )
    if not trusted:
        return posed
    fits = [fit_at(sample, samples[posed.reference], np.eye(3)) for sample in samples]
    return replace(
        posed,
        transforms=homogeneous([fit.rotation for fit in fits], [fit.translation for fit in fits]),
        residuals=np.array([fit.residual for fit in fits]),
        method=PoseMethod.FILES,
    )


def landmarks(shape: Shape) -> dict[str, FloatArray]:
    """Return the points (3,) in mm that every shape of a study has, by name.

    The length-weighted centroid of every opening's loop (``"LA.RSPV"``; a seam once, by the name
    of its first side) and the area centroid of every part (``"LA"``).
    """
    second_sides = {seam.second for seam in shape.seams}
    points = {name: _area_centroid(surface) for name, surface in shape.parts.items()}
    for part, surface in shape.parts.items():
        for ostium, loop in surface.loops.items():
            if f"{part}.{ostium}" not in second_sides:
                points[f"{part}.{ostium}"] = _loop_centroid(surface.vertices[loop])
    return points


def _all_landmarks(shapes: Sequence[PoseFeatures]) -> tuple[list[str], FloatArray]:
    found = [shape.landmarks for shape in shapes]
    names = sorted(found[0])
    for shape, points in zip(shapes, found, strict=True):
        different = sorted(set(points) ^ set(names))
        if different:
            raise InputError(
                f"shape {shape.id}: expected the parts and openings of {shapes[0].id}, found a "
                f"difference in {', '.join(different)}: give every shape the same openings"
            )
    return names, np.array([[points[name] for name in names] for points in found])


def _area_centroid(surface: Surface) -> FloatArray:
    corners = surface.vertices[surface.faces]  # (F, 3, 3)
    areas = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    if not areas.sum() > 0:
        raise InputError(
            f"surface: expected a positive area, found {areas.sum() / 2:g} in {len(areas)} faces"
        )
    centroid: FloatArray = areas @ corners.mean(axis=1) / areas.sum()
    return centroid


def _loop_centroid(loop: FloatArray) -> FloatArray:
    following = np.roll(loop, -1, axis=0)
    lengths = np.linalg.norm(following - loop, axis=1)
    if not lengths.sum() > 0:
        degenerate: FloatArray = loop.mean(axis=0)
        return degenerate
    centroid: FloatArray = lengths @ (0.5 * (loop + following)) / lengths.sum()
    return centroid


def _method(centred: FloatArray, samples: Sequence[SurfaceSample]) -> PoseMethod:
    spread = np.linalg.svd(centred, compute_uv=False)  # (N, min(L, 3))
    spread = np.pad(spread, ((0, 0), (0, 2))) / np.sqrt(centred.shape[1])
    radii = np.array([sample.radius for sample in samples])
    first, second = np.median(spread[:, :2] / radii[:, None], axis=0)
    if second >= COLLINEAR_BELOW:
        return PoseMethod.LANDMARKS
    return PoseMethod.AXIS_AND_SURFACE if first >= COLLINEAR_BELOW else PoseMethod.SURFACE


def _posed_by_landmarks(
    shapes: Sequence[PoseFeatures], centred: FloatArray, centroids: FloatArray, weights: FloatArray
) -> PopulationPoses:
    sizes = weighted_norms(centred, weights)  # (N,)
    superposition = superposed(
        centred,
        weights,
        np.ones(len(shapes)),
        sizes,
        start=_reference(shapes, np.abs(sizes - np.median(sizes)), sizes),
        scaling=False,
        max_iterations=MAX_ITERATIONS,
    )
    placed = centred @ np.swapaxes(superposition.rotations, 1, 2)  # (N, L, 3)
    distances = weighted_norms(placed - superposition.mean, weights)
    reference = _reference(shapes, distances, sizes)
    rotations = superposition.rotations[reference].T @ superposition.rotations  # (N, 3, 3)
    _, gains = best_rotations(
        np.swapaxes(centred * weights[:, None], 1, 2) @ centred[reference]
    )  # (N, 3)
    squares = sizes**2 + sizes[reference] ** 2
    proper = squares - 2.0 * gains.sum(axis=1)
    improper = squares - 2.0 * (gains @ np.array([1.0, 1.0, -1.0]))
    mirrored = (gains[:, 2] < 0) & (np.maximum(improper, 0.0) < MIRRORED_BELOW**2 * proper)
    compared = _compared(shapes, distances, reference)
    fixed = shapes[reference].sample
    surfaces = [reflection_ratio(shapes[k].sample, fixed, rotations[k]) for k in compared]
    by_surface = _mirror_images(np.array(surfaces), compared.index(reference), AGAINST_LANDMARKS)
    mirrored[compared] |= by_surface
    return PopulationPoses(
        transforms=_about(rotations, centroids, reference),
        mirrored=mirrored,
        residuals=weighted_norms(placed - placed[reference], weights),
        reference=reference,
        method=PoseMethod.LANDMARKS,
    )


def _posed_by_surfaces(
    shapes: Sequence[PoseFeatures],
    samples: Sequence[SurfaceSample],
    centred: FloatArray,
    method: PoseMethod,
) -> PopulationPoses:
    gyration = np.array([sample.gyration for sample in samples])  # (N, 3)
    radii = np.array([sample.radius for sample in samples])
    distances = np.linalg.norm(gyration - gyration.mean(axis=0), axis=1)
    reference = _reference(shapes, distances, radii)
    axes = _axes(centred) if method is PoseMethod.AXIS_AND_SURFACE else None
    fits = [
        fitted_rotation(
            sample,
            samples[reference],
            None if axes is None else (axes[index], axes[reference]),
        )
        for index, sample in enumerate(samples)
    ]
    ratios = np.array([fit.reflected_residual / max(fit.residual, TIE) for fit in fits])
    fits = kept_to_shared_frame(fits, samples, axes, reference)
    subjects = [shape.id.subject for shape in shapes]
    fits = kept_to_subjects(fits, samples, subjects, reference)
    rotations = np.array([fit.rotation for fit in fits])
    rotations[reference] = np.eye(3)
    transforms = homogeneous(rotations, [fit.translation for fit in fits])
    transforms[reference] = np.eye(4)
    residuals = np.array([fit.residual for fit in fits])
    residuals[reference] = 0.0
    mirrored = _mirror_images(ratios, reference)
    return PopulationPoses(transforms, mirrored, residuals, reference, method)


def _compared(shapes: Sequence[PoseFeatures], distances: FloatArray, reference: int) -> list[int]:
    """Return the shapes whose surfaces are compared: half the farthest ones, half any."""
    first: dict[str, int] = {shapes[reference].id.subject: reference}
    for index, shape in enumerate(shapes):
        first.setdefault(shape.id.subject, index)
    own = np.array(list(first.values()))
    order = own[np.argsort(-distances[own], kind="stable")]
    half = MOST_COMPARED // 2
    usual = order[half :: max(len(order[half:]) // half, 1)][:half]
    return sorted({reference, *order[:half].tolist(), *usual.tolist()})


def _mirror_images(ratios: FloatArray, reference: int, share: float = AS_USUAL) -> BoolArray:
    """Return which shapes (N,) are mirror images of most.

    Parameters
    ----------
    ratios : (N,) float64
        Residual of the mirror image's fit to the reference over the shape's own.
    reference : int
    share : float
        Of the logarithm of the usual ratio that a mirror image's must have.
    """
    others = np.maximum(np.delete(ratios, reference), TIE)
    limit = MIRRORED_BELOW
    if len(ratios) >= FEWEST_TO_COMPARE:
        asymmetry = float(np.median(np.maximum(others, 1.0 / others)))
        limit = asymmetry**-share if asymmetry >= LEAST_ASYMMETRY else limit
    mirrored: BoolArray = ratios < limit
    mirrored[reference] = False
    return ~mirrored if 2 * mirrored.sum() > len(ratios) else mirrored


def _axes(centred: FloatArray) -> FloatArray:
    """Return the direction (N, 3) of the line the landmarks lie on, the same way in all shapes."""
    _, _, vt = np.linalg.svd(centred, full_matrices=True)
    along = np.einsum("nli,ni->nl", centred, vt[:, 0])  # (N, L)
    leading = np.argmax(np.abs(along).mean(axis=0))
    signs = np.where(along[:, leading] < 0, -1.0, 1.0)
    axes: FloatArray = vt[:, 0] * signs[:, None]
    return axes


def _reference(shapes: Sequence[PoseFeatures], distances: FloatArray, sizes: FloatArray) -> int:
    """Return the shape of least distance; of several, the largest, then the first by name."""
    nearest = np.flatnonzero(distances <= distances.min() + TIE * sizes.mean())
    largest = nearest[sizes[nearest] >= sizes[nearest].max() * (1.0 - TIE)]
    return int(min(largest, key=lambda index: shapes[index].id))


def _about(rotations: FloatArray, centroids: FloatArray, reference: int) -> FloatArray:
    translations = centroids[reference] - np.einsum("nij,nj->ni", rotations, centroids)
    transforms = homogeneous(rotations, translations)
    transforms[reference] = np.eye(4)
    return transforms
