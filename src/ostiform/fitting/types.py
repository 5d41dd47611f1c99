"""What is fitted to, how, and what a fit returns."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Annotated, TypeAlias

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.errors import InputError
from ostiform.study import MIRROR
from ostiform.surface import SurfaceDistance
from ostiform.values import Axes, IndexOf, value


@value
class SurfaceTarget:
    """A surface to fit to: open anywhere, parts of it may be missing.

    Attributes
    ----------
    vertices : (V, 3) float64, mm
    faces : (F, 3) int64
        Consistently oriented, either way.
    loops : mapping of str to (n,) int64
        Boundary loops that are openings of the model, by their full name there. The others are
        matched by geometry, or taken for cuts.
    part : str or None
        The part of the model that it is, where that is known.
    """

    vertices: Annotated[FloatArray, Axes("V", 3)]
    faces: Annotated[IntArray, Axes("F", 3), IndexOf("V")]
    loops: Mapping[str, Annotated[IntArray, Axes(None)]]
    part: str | None = None

    def __post_init__(self) -> None:
        """Refuse a surface without triangles."""
        if not len(self.faces):
            raise InputError("a surface to fit to: expected triangles, found none")


@value
class CloudTarget:
    """Points of a surface (n, 3) in mm, with noise, some of them outliers."""

    points: Annotated[FloatArray, Axes("n", 3)]
    part: str | None = None

    def __post_init__(self) -> None:
        """Refuse a cloud without points."""
        if not len(self.points):
            raise InputError("a point cloud to fit to: expected points, found none")


@value
class ContourTarget:
    """Curves on a surface: polylines (n, 3) in mm, a closed one ends where it starts."""

    curves: tuple[Annotated[FloatArray, Axes(None, 3)], ...]
    part: str | None = None

    def __post_init__(self) -> None:
        """Refuse curves without points."""
        if not sum(len(curve) for curve in self.curves):
            raise InputError("contours to fit to: expected points, found none")


@value
class LandmarkTarget:
    """Points with labels.

    Attributes
    ----------
    labels : (n,) tuple of str
        ``"17"``: the model's point 17. ``"LV.mitral"``: the centre of that opening.
        ``"LV.mitral-1"``, ``"LV.mitral-2"``, ...: points somewhere on its rim.
    positions : (n, 3) float64, mm
    """

    labels: Annotated[tuple[str, ...], Axes("n")]
    positions: Annotated[FloatArray, Axes("n", 3)]

    def __post_init__(self) -> None:
        """Refuse no landmarks at all."""
        if not self.labels:
            raise InputError("landmarks to fit to: expected labelled points, found none")


Target: TypeAlias = SurfaceTarget | CloudTarget | ContourTarget | LandmarkTarget


@value
class Pose:
    """A transform from the model's frame to the target's, ``y = scale R x + translation``."""

    scale: float
    rotation: Annotated[FloatArray, Axes(3, 3)]
    translation: Annotated[FloatArray, Axes(3)]

    @property
    def matrix(self) -> FloatArray:
        """As (4, 4) for column vectors."""
        matrix = np.eye(4)
        matrix[:3, :3] = self.scale * self.rotation
        matrix[:3, 3] = self.translation
        return matrix


IDENTITY = Pose(1.0, np.eye(3), np.zeros(3))


def placed(pose: Pose, points: FloatArray) -> FloatArray:
    """Return points (n, 3) of the model's frame in the target's frame."""
    moved: FloatArray = pose.scale * points @ pose.rotation.T + pose.translation
    return moved


class FitStatus(Enum):
    """How a fit ended."""

    CONVERGED = "the shape stopped moving"
    ITERATION_LIMIT = "the shape was still moving at the iteration limit"


@dataclass(frozen=True, slots=True)
class Residue:
    """How far data and fitted surface are apart, mm.

    Attributes
    ----------
    to_model : SurfaceDistance
        From the data to the fitted surface.
    median : float
        Of the same distances; outliers do not move it.
    to_target : SurfaceDistance or None
        From the fitted surface to the target where the target has surface; None where the target
        is no surface.
    covered : float
        Share of the fitted surface's area that has target surface opposite it.
    """

    to_model: SurfaceDistance
    median: float
    to_target: SurfaceDistance | None
    covered: float


@dataclass(frozen=True, slots=True)
class Typicality:
    """How typical of the model's population a fitted shape is.

    Attributes
    ----------
    mahalanobis : float
        Distance from the mean in standard deviations of the modes, as far as the data determine
        them.
    dof : float
        Degrees of freedom that the data determine; the squared distance has this mean in the
        population.
    percentile : float
        Share of the population's shapes that would be nearer to the mean, 0 to 1.
    leading_percentile : float
        The same in the leading modes alone, those of 90 % of the variance.
    leftover_ratio : float
        Energy beyond the modes relative to what left-out training shapes had.
    leftover_percentile : float
    is_outlier : bool
    reasons : tuple of str
        Why, one sentence each.
    """

    mahalanobis: float
    dof: float
    percentile: float
    leading_percentile: float
    leftover_ratio: float
    leftover_percentile: float
    is_outlier: bool
    reasons: tuple[str, ...]


@value
class ShapeFit:
    """A model fitted to a target: the posterior distribution of shape and pose.

    Attributes
    ----------
    points : (P, 3) float64, mm
        Posterior mean, in the target's frame.
    pose : Pose
        From the model's frame to the target's.
    pose_sd : (3,) float64
        Of rotation (degrees), translation (mm) and scale (share); zero where not estimated.
    scores : (K,) float64, mm
        Posterior mean in all modes of the model, of the shape in the model's frame; comparable
        with the training shapes' scores.
    score_covariance : (K, K) float64, mm^2
    coefficient_covariance : (C, C) float64
        Of the coefficients of the prior's modes and field (`FitPrior`), which holds what the
        scores do not: the shape beyond the modes.
    point_covariance : (P, 3, 3) float64, mm^2
        Of the points in the target's frame, the pose's uncertainty included.
    point_sd : (P,) float64, mm
        Root mean square over the three coordinates.
    normal_sd : (P,) float64, mm
        Along the surface normal.
    residue : (P,) float64, mm
        Signed distance from each point to the target where it has surface, positive outside; NaN
        elsewhere and where the target is no surface.
    residues : Residue
    noise_mm : mapping of str to float
        Estimated standard deviation of the data about the fitted shape, by kind of data.
    outlier_share : float
        Share of the data that lie further than three of those from the fitted shape.
    openings : mapping of str to str
        Loops of the target that were matched to an opening by geometry: loop, opening.
    typicality : Typicality
    status : FitStatus
    iterations : int
    notes : tuple of str
        What is worth saying about the pose and the openings, one sentence each.
    """

    points: Annotated[FloatArray, Axes("P", 3)]
    pose: Pose
    pose_sd: Annotated[FloatArray, Axes(3)]
    scores: Annotated[FloatArray, Axes("K")]
    score_covariance: Annotated[FloatArray, Axes("K", "K")]
    coefficient_covariance: Annotated[FloatArray, Axes(None, None)]
    point_covariance: Annotated[FloatArray, Axes("P", 3, 3)]
    point_sd: Annotated[FloatArray, Axes("P")]
    normal_sd: Annotated[FloatArray, Axes("P")]
    residue: Annotated[FloatArray, Axes(..., gaps=True)]
    residues: Residue
    noise_mm: Mapping[str, float]
    outlier_share: float
    openings: Mapping[str, str]
    typicality: Typicality
    status: FitStatus
    iterations: int
    notes: tuple[str, ...] = ()


def reflected_target(target: Target) -> Target:
    """Return the mirror image of a target, left for right, faces as before."""
    if isinstance(target, SurfaceTarget):
        return replace(target, vertices=target.vertices * MIRROR, faces=target.faces[:, ::-1])
    if isinstance(target, CloudTarget):
        return replace(target, points=target.points * MIRROR)
    if isinstance(target, ContourTarget):
        return replace(target, curves=tuple(curve * MIRROR for curve in target.curves))
    return replace(target, positions=target.positions * MIRROR)


def all_positions(targets: Sequence[Target]) -> FloatArray:
    """Return all points (n, 3) of some targets."""
    found = []
    for target in targets:
        if isinstance(target, SurfaceTarget):
            found.append(target.vertices[np.unique(target.faces)])
        elif isinstance(target, CloudTarget):
            found.append(target.points)
        elif isinstance(target, ContourTarget):
            found.extend(target.curves)
        else:
            found.append(target.positions)
    return np.concatenate(found)
