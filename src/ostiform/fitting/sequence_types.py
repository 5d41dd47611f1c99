"""Phases of one beating shape to fit to, and what such a fit returns."""

from collections.abc import Mapping
from typing import Annotated, TypeAlias

from ostiform.arrays import FloatArray
from ostiform.errors import InputError
from ostiform.fitting.settings import PoseKnowledge
from ostiform.fitting.types import FitStatus, Pose, Target, Typicality
from ostiform.surface import SurfaceDistance
from ostiform.values import AtLeast, Axes, value


@value
class SliceContours:
    """What is drawn in one slice of one phase: curves in a plane.

    Attributes
    ----------
    slice : str
        The slice's name; curves of all phases with the same name were taken in one breath-hold and
        share its shift.
    curves : tuple of (n, 3) float64, mm
        Polylines; a closed one ends where it starts.
    part : str or None
        The part of the model that they lie on, where that is known.
    opening : str or None
        The opening of the model on whose rim they lie, by its full name.
    is_outline : bool
        Whether they go round a body (of a label): across an opening they lie on its flat cap, not
        on the wall.
    """

    slice: str
    curves: tuple[Annotated[FloatArray, Axes(None, 3)], ...]
    part: str | None = None
    opening: str | None = None
    is_outline: bool = False

    def __post_init__(self) -> None:
        """Refuse curves without points."""
        if not sum(len(curve) for curve in self.curves):
            raise InputError(f"slice {self.slice}: expected points, found none")


PhaseItem: TypeAlias = Target | SliceContours


@value
class PhaseTarget:
    """Everything that is known of one phase.

    Attributes
    ----------
    time : float
        Fraction of the cycle.
    targets : tuple of Target or SliceContours
        At least one, in one frame for all phases.
    name : str
        For messages and files.
    """

    time: float
    targets: tuple[PhaseItem, ...]
    name: str

    def __post_init__(self) -> None:
        """Refuse a phase without data."""
        if not self.targets:
            raise InputError(f"phase {self.name}: expected something to fit to, found nothing")


@value(eq=True)
class SequenceSettings:
    """How a fit to all phases works.

    Attributes
    ----------
    pose : {"near", "known", "unknown"}
        As in `FitSettings`; of all phases together.
    noise_mm : float or None
        Standard deviation of each coordinate of the data; None estimates it.
    shift_sd_mm : float
        Standard deviation of a slice's shift along each axis of its plane (half of it
        through the plane); 0 for none. The default is about what is published for breath-holds
        (1.8 mm of misalignment on average).
    """

    pose: PoseKnowledge = "near"
    noise_mm: float | None = None
    shift_sd_mm: Annotated[float, AtLeast(0)] = 2.0


@value
class SliceShift:
    """How far a slice was found to be displaced in its plane.

    Attributes
    ----------
    slice : str
    normal : (3,) float64
        Of the plane, in the frame of the data.
    shift : (3,) float64, mm
        In the plane; what was seen is where it is plus this.
    through : float, mm
        Along the normal.
    sd : float, mm
        Standard deviation along an axis of the plane, root mean square of both.
    residue : float, mm
        Median distance of its curves from the fitted surface, the shift taken off.
    """

    slice: str
    normal: Annotated[FloatArray, Axes(3)]
    shift: Annotated[FloatArray, Axes(3)]
    through: float
    sd: float
    residue: float


@value
class SequenceFit:
    """A beating model fitted to all phases of a shape: the posterior of its whole cycle.

    Attributes
    ----------
    times : (T,) float64
        Of the given phases, fractions of the cycle.
    names : (T,) tuple of str
    points : (T, P, 3) float64, mm
        Posterior mean at those times, in the frame of the data.
    normal_sd, point_sd : (T, P) float64, mm
        Standard deviation along the surface normal, and root mean square over the coordinates.
    pose : Pose
        From the model's frame to the data's, one for all phases.
    pose_sd : (3,) float64
        Of rotation (degrees), translation (mm) and scale.
    coefficients : (H, C) float64
        Of the prior's temporal and spatial functions (`SequencePrior`).
    root : (U, D) float64
        Columns whose outer products sum to the covariance of all unknowns: coefficients by rows,
        then pose, then shifts.
    scores : (K,) float64, mm
        Of the mean shape over the cycle, in the model's modes.
    shifts : tuple of SliceShift
    residues : mapping of str to SurfaceDistance
        From the data of each phase to the fitted surface, mm, shifts taken off.
    noise_mm : mapping of str to float
        By kind of data.
    outlier_share : float
    typicality : Typicality
    status : FitStatus
    iterations : int
    notes : tuple of str
        What is worth saying about pose, slices and phases, one sentence each.
    """

    times: Annotated[FloatArray, Axes("T")]
    names: Annotated[tuple[str, ...], Axes("T")]
    points: Annotated[FloatArray, Axes("T", "P", 3)]
    normal_sd: Annotated[FloatArray, Axes("T", "P")]
    point_sd: Annotated[FloatArray, Axes("T", "P")]
    pose: Pose
    pose_sd: Annotated[FloatArray, Axes(3)]
    coefficients: Annotated[FloatArray, Axes(None, None)]
    root: Annotated[FloatArray, Axes(None, None)]
    scores: Annotated[FloatArray, Axes(None)]
    shifts: tuple[SliceShift, ...]
    residues: Mapping[str, SurfaceDistance]
    noise_mm: Mapping[str, float]
    outlier_share: float
    typicality: Typicality
    status: FitStatus
    iterations: int
    notes: tuple[str, ...] = ()
