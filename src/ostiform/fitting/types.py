"""What is fitted to, how, and what a fit returns."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import TypeAlias

import numpy as np

from ostiform.arrays import FloatArray, IntArray, frozen_floats, frozen_ints, frozen_mapping
from ostiform.errors import InputError
from ostiform.surface import SurfaceDistance


@dataclass(frozen=True, slots=True, eq=False)
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

    vertices: FloatArray
    faces: IntArray
    loops: Mapping[str, IntArray]
    part: str | None = None

    def __post_init__(self) -> None:
        """Check the arrays and make them read-only."""
        object.__setattr__(
            self, "vertices", frozen_floats(self.vertices, (None, 3), "vertices of a target")
        )
        object.__setattr__(self, "faces", frozen_ints(self.faces, (None, 3), "faces of a target"))
        if not len(self.faces):
            raise InputError("a surface to fit to: expected triangles, found none")
        if self.faces.min() < 0 or self.faces.max() >= len(self.vertices):
            raise InputError(
                f"faces of a target: expected indices from 0 to {len(self.vertices) - 1}, found "
                f"{int(self.faces.min())} to {int(self.faces.max())}"
            )
        object.__setattr__(
            self,
            "loops",
            frozen_mapping(
                {n: frozen_ints(loop, (None,), f"loop {n}") for n, loop in self.loops.items()}
            ),
        )


@dataclass(frozen=True, slots=True, eq=False)
class CloudTarget:
    """Points of a surface (n, 3) in mm, with noise, some of them outliers."""

    points: FloatArray
    part: str | None = None

    def __post_init__(self) -> None:
        """Check the array and make it read-only."""
        object.__setattr__(
            self, "points", frozen_floats(self.points, (None, 3), "points of a target")
        )
        if not len(self.points):
            raise InputError("a point cloud to fit to: expected points, found none")


@dataclass(frozen=True, slots=True, eq=False)
class ContourTarget:
    """Curves on a surface: polylines (n, 3) in mm, a closed one ends where it starts."""

    curves: tuple[FloatArray, ...]
    part: str | None = None

    def __post_init__(self) -> None:
        """Check the arrays and make them read-only."""
        curves = tuple(frozen_floats(c, (None, 3), "points of a contour") for c in self.curves)
        object.__setattr__(self, "curves", curves)
        if not sum(len(curve) for curve in curves):
            raise InputError("contours to fit to: expected points, found none")


@dataclass(frozen=True, slots=True, eq=False)
class LandmarkTarget:
    """Points with labels.

    Attributes
    ----------
    labels : (n,) tuple of str
        ``"17"``: the model's point 17. ``"LV.mitral"``: the centre of that opening.
        ``"LV.mitral-1"``, ``"LV.mitral-2"``, ...: points somewhere on its rim.
    positions : (n, 3) float64, mm
    """

    labels: tuple[str, ...]
    positions: FloatArray

    def __post_init__(self) -> None:
        """Check the array and make it read-only."""
        object.__setattr__(
            self,
            "positions",
            frozen_floats(self.positions, (len(self.labels), 3), "positions of landmarks"),
        )
        if not self.labels:
            raise InputError("landmarks to fit to: expected labelled points, found none")


Target: TypeAlias = SurfaceTarget | CloudTarget | ContourTarget | LandmarkTarget


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """A transform from the model's frame to the target's, ``y = scale R x + translation``."""

    scale: float
    rotation: FloatArray
    translation: FloatArray

    def __post_init__(self) -> None:
        """Check the arrays and make them read-only."""
        object.__setattr__(self, "rotation", frozen_floats(self.rotation, (3, 3), "rotation"))
        object.__setattr__(
            self, "translation", frozen_floats(self.translation, (3,), "translation")
        )

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


@dataclass(frozen=True, slots=True, eq=False)
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
    """

    points: FloatArray
    pose: Pose
    pose_sd: FloatArray
    scores: FloatArray
    score_covariance: FloatArray
    coefficient_covariance: FloatArray
    point_covariance: FloatArray
    point_sd: FloatArray
    normal_sd: FloatArray
    residue: FloatArray
    residues: Residue
    noise_mm: Mapping[str, float]
    outlier_share: float
    openings: Mapping[str, str]
    typicality: Typicality
    status: FitStatus
    iterations: int

    def __post_init__(self) -> None:
        """Check the arrays and make them read-only."""
        count, n_modes = len(self.points), len(self.scores)
        for name, shape in (
            ("points", (count, 3)),
            ("pose_sd", (3,)),
            ("scores", (n_modes,)),
            ("score_covariance", (n_modes, n_modes)),
            ("coefficient_covariance", (None, None)),
            ("point_covariance", (count, 3, 3)),
            ("point_sd", (count,)),
            ("normal_sd", (count,)),
        ):
            object.__setattr__(self, name, frozen_floats(getattr(self, name), shape, name))
        residue = np.array(self.residue, dtype=np.float64)
        residue.flags.writeable = False
        object.__setattr__(self, "residue", residue)
        object.__setattr__(self, "noise_mm", frozen_mapping(dict(self.noise_mm)))
        object.__setattr__(self, "openings", frozen_mapping(dict(self.openings)))


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
