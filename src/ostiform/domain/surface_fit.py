"""Rigid fit of one surface to another without correspondence: iterated closest points.

Everything is stated relative to the surfaces themselves (samples by area, principal axes as
starting frames), so that moving an input rigidly moves the result with it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np
from scipy.spatial import KDTree

from ostiform.arrays import FloatArray
from ostiform.domain.procrustes import best_rotations
from ostiform.errors import InputError
from ostiform.surface import Surface

N_SAMPLES = 600
COARSE_POINTS = 75
COARSE_ITERATIONS = 6
MIDDLE_POINTS = 200
MIDDLE_ITERATIONS = 8
FINE_ITERATIONS = 30
REFLECTED_ITERATIONS = 2
N_REFINED = 3
N_ABOUT_AXIS = 24

# Length of a step, in radians or in radii, at which closest points no longer change hands.
SETTLED = 1e-10

# Share of the mean curvature of the fit added in every direction: what a surface of revolution
# leaves undetermined stays where it is.
RIDGE = 1e-6

# Longest step, radians or radii: closest points of a larger turn mean nothing.
LONGEST_STEP = 0.2


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceSample:
    """Points that each stand for the same area of a surface.

    Attributes
    ----------
    centroid : (3,) float64, mm
        Area centroid.
    points : (n, 3) float64, mm
        Relative to the centroid.
    normals : (n, 3) float64
        Outward unit normals of the faces the points lie on.
    frame : (3, 3) float64
        Principal axes in columns, longest first, right-handed.
    gyration : (3,) float64, mm
        Root mean square extent of the surface along the axes.
    tree : scipy.spatial.KDTree
        Over `points`.
    """

    centroid: FloatArray
    points: FloatArray
    normals: FloatArray
    frame: FloatArray
    gyration: FloatArray
    tree: KDTree

    @property
    def radius(self) -> float:
        """Root mean square distance of the surface from its centroid, mm."""
        return float(np.linalg.norm(self.gyration))


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceFit:
    """A rigid fit of one surface to another.

    Attributes
    ----------
    rotation : (3, 3) float64
    translation : (3,) float64, mm
    residual : float
        Root mean square distance of samples from the tangent planes at their closest points, in
        both directions, mm.
    reflected_residual : float
        The same for the best fit of the mirror image.
    """

    rotation: FloatArray
    translation: FloatArray
    residual: float
    reflected_residual: float


def sampled_surface(name: str, surfaces: Sequence[Surface]) -> SurfaceSample:
    """Return `N_SAMPLES` face centroids of surfaces taken at equal steps of cumulated area.

    Raises
    ------
    InputError
        If the surfaces have no area.
    """
    corners = np.concatenate([surface.vertices[surface.faces] for surface in surfaces])
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(across, axis=1)  # (F,), twice the areas
    total = areas.sum()
    if not total > 0:
        raise InputError(f"shape {name}: expected a surface of positive area, found none")
    centres = corners.mean(axis=1)  # (F, 3)
    centroid = areas @ centres / total
    centres = centres - centroid
    covariance = (centres * areas[:, None]).T @ centres / total
    variances, axes = np.linalg.eigh(covariance)
    frame = axes[:, ::-1].copy()
    frame[:, 2] *= np.linalg.det(frame)
    steps = (np.arange(N_SAMPLES) + 0.5) / N_SAMPLES * total
    taken = np.minimum(np.searchsorted(np.cumsum(areas), steps), len(areas) - 1)
    points = centres[taken]
    normals = across[taken] / areas[taken, None]
    gyration = np.sqrt(np.maximum(variances[::-1], 0.0))
    return SurfaceSample(centroid, points, normals, frame, gyration, KDTree(points))


def fitted_rotation(
    moving: SurfaceSample,
    fixed: SurfaceSample,
    axes: tuple[FloatArray, FloatArray] | None = None,
) -> SurfaceFit:
    """Fit one surface rigidly to another by iterated closest points.

    All starting rotations take a few steps with few points (point to point, Besl & McKay 1992);
    the best few are refined with more (point to tangent plane, Chen & Medioni 1992, closest
    points in both directions), and the best of these with all points.

    Parameters
    ----------
    moving, fixed : SurfaceSample
    axes : tuple of (3,) float64, optional
        A direction of the moving and of the fixed surface known to correspond: the starts are
        24 rotations about it. Without, the 24 proper ways to lay principal axes on each other.
    """
    starts = (
        fixed.frame @ _axis_permutations() @ moving.frame.T
        if axes is None
        else _turns_about(axes[0], moving.points, axes[1], fixed.points)
    )  # (24, 3, 3)
    rotation, shift, residual = _best_fit(
        moving.points, moving.normals, fixed, starts, FINE_ITERATIONS
    )
    translation = fixed.centroid + shift - rotation @ moving.centroid
    return SurfaceFit(rotation, translation, residual, _reflected_residual(moving, fixed, axes))


def reflection_ratio(moving: SurfaceSample, fixed: SurfaceSample, rotation: FloatArray) -> float:
    """Return the residual of the mirror image's best fit over that of a shape turned so.

    Parameters
    ----------
    moving, fixed : SurfaceSample
    rotation : (3, 3) float64
        About the centroids; refined by as many steps as the mirror image's.
    """
    steps = MIDDLE_ITERATIONS + REFLECTED_ITERATIONS
    start = rotation, np.zeros(3)
    _, _, own = _refined(moving.points, moving.normals, fixed, start, steps)
    mirrored = _reflected_residual(moving, fixed, None)
    if mirrored < own and own > SETTLED * fixed.radius:
        # The mirror image was turned freely: of a shape with a plane of symmetry that is a turn.
        starts = fixed.frame @ _axis_permutations() @ moving.frame.T
        turned = _best_fit(moving.points, moving.normals, fixed, starts, REFLECTED_ITERATIONS)[2]
        own = min(own, turned)
    return mirrored / max(own, SETTLED * fixed.radius)


def _reflected_residual(
    moving: SurfaceSample, fixed: SurfaceSample, axes: tuple[FloatArray, FloatArray] | None
) -> float:
    """Return the residual of the best fit of the mirror image."""
    # Across the plane of the two longest axes, which keeps the starts' frames.
    mirror = moving.frame @ np.diag([1.0, 1.0, -1.0]) @ moving.frame.T
    image = moving.points @ mirror
    starts = (
        fixed.frame @ _axis_permutations() @ moving.frame.T
        if axes is None
        else _turns_about(mirror @ axes[0], image, axes[1], fixed.points)
    )
    normals = moving.normals @ mirror
    return _best_fit(image, normals, fixed, starts, REFLECTED_ITERATIONS)[2]


def fit_at(moving: SurfaceSample, fixed: SurfaceSample, rotation: FloatArray) -> SurfaceFit:
    """Return how well one surface lies on another, turned by a rotation (3, 3) about its centroid.

    Of the mirror image nothing is said: its residual is infinite.
    """
    start = rotation, np.zeros(3)
    _, _, residual = _refined(moving.points, moving.normals, fixed, start, 0)
    translation = fixed.centroid - rotation @ moving.centroid
    return SurfaceFit(rotation, translation, residual, np.inf)


def _turns_about(
    own_axis: FloatArray, own_points: FloatArray, goal_axis: FloatArray, goal_points: FloatArray
) -> FloatArray:
    """Return rotations (24, 3, 3) that carry one axis to another, evenly spread about it."""
    angles = 2.0 * np.pi * np.arange(N_ABOUT_AXIS) / N_ABOUT_AXIS
    cos, sin = np.cos(angles), np.sin(angles)
    zero, one = np.zeros_like(angles), np.ones_like(angles)
    turns = np.array([[cos, -sin, zero], [sin, cos, zero], [zero, zero, one]])  # (3, 3, 24)
    own, goal = _frame_about(own_axis, own_points), _frame_about(goal_axis, goal_points)
    about: FloatArray = goal @ np.moveaxis(turns, 2, 0) @ own.T  # (24, 3, 3)
    return about


def _axis_permutations() -> FloatArray:
    """Return the 24 rotations (24, 3, 3) that carry the coordinate axes onto each other."""
    matrices = np.array(
        [
            np.eye(3)[list(order)] * np.array(signs)[:, None]
            for order in permutations(range(3))
            for signs in product((1.0, -1.0), repeat=3)
        ]
    )  # (48, 3, 3)
    proper: FloatArray = matrices[np.linalg.det(matrices) > 0]
    return proper


def _frame_about(axis: FloatArray, points: FloatArray) -> FloatArray:
    """Return a right-handed frame (3, 3): widest direction across the axis, second, axis."""
    across = points - np.outer(points @ axis, axis)
    _, vectors = np.linalg.eigh(across.T @ across)
    widest = vectors[:, 2] - (vectors[:, 2] @ axis) * axis
    widest = widest / np.linalg.norm(widest)
    return np.column_stack([widest, np.cross(axis, widest), axis])


def _best_fit(
    points: FloatArray,
    normals: FloatArray,
    fixed: SurfaceSample,
    rotations: FloatArray,
    fine_iterations: int,
) -> tuple[FloatArray, FloatArray, float]:
    few = points[:: N_SAMPLES // COARSE_POINTS]  # (n, 3)
    shifts = np.zeros((len(rotations), 3))
    for _ in range(COARSE_ITERATIONS):
        placed = few @ np.swapaxes(rotations, 1, 2) + shifts[:, None, :]  # (S, n, 3)
        _, nearest = fixed.tree.query(placed.reshape(-1, 3))
        targets = fixed.points[nearest].reshape(placed.shape)
        goals = targets.mean(axis=1)
        rotations, _ = best_rotations(
            np.einsum("ni,snj->sij", few - few.mean(axis=0), targets - goals[:, None, :])
        )
        shifts = goals - rotations @ few.mean(axis=0)
    placed = few @ np.swapaxes(rotations, 1, 2) + shifts[:, None, :]
    distances, _ = fixed.tree.query(placed.reshape(-1, 3))
    order = np.argsort((np.reshape(distances, placed.shape[:2]) ** 2).mean(axis=1), kind="stable")
    kept: list[int] = []
    for start in order:
        is_new = all(np.abs(rotations[start] - rotations[other]).max() > 0.2 for other in kept)
        if is_new and len(kept) < N_REFINED:
            kept.append(int(start))
    step = N_SAMPLES // MIDDLE_POINTS
    fits = [
        _refined(
            points[::step],
            normals[::step],
            fixed,
            (rotations[start], shifts[start]),
            MIDDLE_ITERATIONS,
        )
        for start in kept
    ]
    rotation, shift, _ = min(fits, key=lambda fit: fit[2])
    return _refined(points, normals, fixed, (rotation, shift), fine_iterations)


def _refined(
    points: FloatArray,
    normals: FloatArray,
    fixed: SurfaceSample,
    start: tuple[FloatArray, FloatArray],
    max_iterations: int,
) -> tuple[FloatArray, FloatArray, float]:
    """Return rotation, shift and residual after point-to-plane steps from a start."""
    own = KDTree(points)
    goals = fixed.points[:: len(fixed.points) // len(points)]
    rotation, shift = start
    radius = fixed.radius
    for iteration in range(max_iterations + 1):
        placed, turned = points @ rotation.T + shift, normals @ rotation.T
        _, ahead = fixed.tree.query(placed)
        _, back = own.query((goals - shift) @ rotation)
        sources = np.concatenate([placed, placed[back]])  # (2n, 3)
        targets = np.concatenate([fixed.points[ahead], goals])
        across = np.concatenate([fixed.normals[ahead], turned[back]])
        heights = np.einsum("ni,ni->n", across, sources - targets)
        residual = float(np.sqrt(np.mean(heights**2)))
        if iteration == max_iterations:
            break
        # d height = (x cross n) . turn + n . shift, lengths in radii.
        jacobian = np.concatenate([np.cross(sources, across) / radius, across], axis=1)
        normal_matrix = jacobian.T @ jacobian
        ridge = RIDGE * np.trace(normal_matrix) / 6.0 * np.eye(6)
        step = -np.linalg.solve(normal_matrix + ridge, jacobian.T @ heights) / radius
        longest = float(np.abs(step).max())
        step *= min(1.0, LONGEST_STEP / max(longest, LONGEST_STEP))
        turn = _rotation(step[:3])
        rotation, shift = turn @ rotation, turn @ shift + radius * step[3:]
        if longest <= SETTLED:
            break
    return rotation, shift, residual


def _rotation(vector: FloatArray) -> FloatArray:
    """Return the rotation matrix (3, 3) of a rotation vector, by Rodrigues' formula."""
    x, y, z = vector
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    angle = float(np.linalg.norm(vector))
    # np.sinc(t) is sin(pi t) / (pi t)
    sine, half = np.sinc(angle / np.pi), np.sinc(0.5 * angle / np.pi)
    rotation: FloatArray = np.eye(3) + sine * skew + 0.5 * half**2 * skew @ skew
    return rotation
