"""The left heart of the demonstration population: its material anatomy, subjects and motion.

Material coordinates are millimetres, LPS in the sense of x left, y posterior, z along the long
axis: the mitral annulus lies near z = 0, the apex of the LV near z = -88, the LA above. The
mitral contour is the seam of the two parts; with two rims on the LV side and five on the LA side
they have six contours, where the paper, with LV and LA apart, counts five on the atrium.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ostiform.arrays import FloatArray, frozen_mapping
from ostiform.demo.deformation import Deformation
from ostiform.demo.implicit import Anatomy, Cut, Ellipsoid, Tube
from ostiform.demo.spacemaps import Affine, Axial, Bumps, SpaceMap, TubeWarp

_BLEND_MM = 2.0
_LONGEST_BEND_MM = 4.5
"""A quarter of the distance over which a vessel's warp falls off: space is never folded."""
_AXIS_POINT = (1.0, -2.0)
_ANATOMICAL_TURN = np.asarray(
    Rotation.from_euler("xyz", [35.0, -35.0, 20.0], degrees=True).as_matrix()
)
"""Long axis of the LV to the left, anterior and inferior, as in the chest."""
_LA_CENTER = np.array([4.0, 17.0, 23.5])


@dataclass(frozen=True, slots=True, eq=False)
class _Vessel:
    """A vessel of the material anatomy: where it leaves, its direction and size, mm."""

    base: tuple[float, float, float]
    direction: tuple[float, float, float]
    radius: float
    length: float


_VESSELS: Mapping[str, _Vessel] = frozen_mapping(
    {
        "LV.aortic": _Vessel((-4.0, -15.0, -6.0), (-0.28, -0.52, 0.81), 11.3, 15.0),
        "LA.RSPV": _Vessel((-14.0, 12.0, 32.5), (-0.82, 0.0, 0.57), 7.0, 14.0),
        "LA.RIPV": _Vessel((-15.0, 23.0, 18.5), (-0.86, 0.47, -0.2), 6.0, 12.0),
        "LA.LSPV": _Vessel((20.0, 19.0, 34.5), (0.72, 0.3, 0.63), 6.5, 14.0),
        "LA.LIPV": _Vessel((21.0, 27.0, 17.5), (0.8, 0.57, -0.18), 5.0, 11.0),
    }
)
"""`base` lies at the wall of the chamber; `length` is from there to the cut."""


def left_heart() -> Anatomy:
    """Return the material anatomy: LV with outflow tract, LA with four veins and an appendage."""
    primitives: list[Ellipsoid | Tube] = [
        _ellipsoid((0.0, -3.0, -40.0), (24.0, 23.5, 47.0)),
        _ellipsoid((0.0, -1.0, -22.0), (23.0, 24.5, 22.0)),
        _ellipsoid(tuple(_LA_CENTER), (23.0, 18.0, 18.5)),
        _ellipsoid((-3.0, 20.0, 28.5), (18.0, 15.0, 15.0)),
        Tube(np.array([3.0, 6.0, -16.0]), np.array([4.0, 14.0, 15.0]), 13.5, 13.5),
        _ellipsoid((24.0, 2.0, 22.5), (9.5, 6.5, 7.5), about_z=-0.7),
    ]
    cuts = [
        Cut(
            "LV.mitral",
            "LA.mitral",
            np.array([3.3, 9.5, 0.0]),
            np.array([0.05, 0.3, 0.95]),
            21.0,
            np.array([1.0, 0.0, 0.0]),
            saddle_mm=-3.0,
        )
    ]
    for name, vessel in _VESSELS.items():
        base, direction = np.array(vessel.base), _unit(vessel.direction)
        primitives.append(
            Tube(
                base - 1.6 * vessel.radius * direction,
                base + (vessel.length + 0.8 * vessel.radius) * direction,
                vessel.radius,
                vessel.radius * 0.95,
            )
        )
        across = np.cross(direction, (0.0, 0.0, 1.0))
        end = base + vessel.length * direction
        cuts.append(Cut(name, None, end, direction, 1.9 * vessel.radius, across))
    seeds = {"LV": np.array([0.0, -3.0, -87.0]), "LA": np.array([3.0, 19.0, 43.5])}
    return Anatomy(tuple(primitives), _BLEND_MM, tuple(cuts), seeds)


@dataclass(frozen=True, slots=True, eq=False)
class HeartSubject:
    """One heart: how it differs from the material anatomy, and how it beats.

    Attributes
    ----------
    anatomy_maps : tuple of SpaceMap
        From material coordinates to this subject's end of diastole.
    pose : Affine
        From there to the world: position, orientation and size.
    systole_end : float
        Time of the smallest LV, as a fraction of the cycle.
    atrial_start : float
        Time at which the atrium contracts.
    contraction, shortening_mm, torsion_rad, filling : float
        Amplitudes: logarithmic narrowing of the LV, descent of the annulus, turn of the apex
        against the base, logarithmic widening of the LA.
    """

    anatomy_maps: tuple[SpaceMap, ...]
    pose: Affine
    systole_end: float
    atrial_start: float
    contraction: float
    shortening_mm: float
    torsion_rad: float
    filling: float

    def deformation(self, time: float) -> Deformation:
        """Return the map from material to world coordinates at a time in [0, 1)."""
        return Deformation((*self.anatomy_maps, self._motion(time), self.pose))

    def _motion(self, time: float) -> Axial:
        squeeze = self._activity(time, lag=0.0, early_share=0.72)
        twist = self._activity((time + 0.02) % 1.0, lag=0.0, early_share=0.9)
        fill = self._activity(time, lag=0.03, early_share=0.5)
        #                   apex                        annulus            roof
        knots = np.array([-100.0, -70.0, -40.0, -15.0, 2.0, 16.0, 30.0, 46.0, 70.0])
        descent = np.array([-0.08, 0.16, 0.48, 0.82, 1.0, 0.72, 0.38, 0.05, 0.0])
        narrow = np.array([0.8, 1.0, 1.0, 0.8, 0.25, 0.0, 0.0, 0.0, 0.0])
        widen = np.array([0.0, 0.0, 0.0, 0.0, 0.2, 0.9, 1.0, 0.8, 0.3])
        turn = np.array([0.75, 0.62, 0.25, -0.1, -0.25, -0.15, -0.05, 0.0, 0.0])
        displacement = np.zeros((len(knots), 3))
        displacement[:, 2] = -self.shortening_mm * squeeze * descent
        log_scale = self.filling * fill * widen - self.contraction * squeeze * narrow
        return Axial(
            np.array(_AXIS_POINT),
            knots,
            displacement,
            np.column_stack([log_scale, log_scale]),
            self.torsion_rad * twist * turn,
        )

    def _activity(self, time: float, lag: float, early_share: float) -> float:
        # 0 at the end of diastole, 1 at the end of systole, back in an early and an atrial step.
        shares = [
            time / (self.systole_end + lag),
            (time - self.systole_end - lag - 0.02) / 0.22,
            (time - self.atrial_start) / (1.0 - self.atrial_start),
        ]
        rise, early, late = _smooth(np.array(shares))
        return float(rise - early_share * early - (1.0 - early_share) * late)


def random_heart_subject(rng: np.random.Generator) -> HeartSubject:
    """Return a subject drawn at random: sizes, shapes of the walls, vessels, pose and motion."""
    turn = _rotation_vector(_bounded(rng, 0.08, 3))
    size = np.exp(_bounded(rng, 0.04, 1)[0])
    return HeartSubject(
        anatomy_maps=(*_vessel_maps(rng), _wall_map(rng), _size_map(rng)),
        pose=Affine(size * turn @ _ANATOMICAL_TURN, _bounded(rng, 4.0, 3)),
        systole_end=float(rng.uniform(0.32, 0.40)),
        atrial_start=float(rng.uniform(0.76, 0.84)),
        contraction=float(rng.uniform(0.37, 0.46)),
        shortening_mm=float(rng.uniform(11.0, 16.0)),
        torsion_rad=float(rng.uniform(0.16, 0.30)),
        filling=float(rng.uniform(0.12, 0.18)),
    )


def _vessel_maps(rng: np.random.Generator) -> tuple[TubeWarp, ...]:
    maps = []
    for name, vessel in _VESSELS.items():
        direction = _unit(vessel.direction)
        vein = name.startswith("LA")
        radii = rng.uniform(1.2, 3.8) if vein else rng.uniform(1.0, 1.6)
        lengthening = radii * vessel.radius - vessel.length
        bend = _bounded(rng, 2.2, 3)
        bend = bend - (bend @ direction) * direction
        bend *= min(1.0, _LONGEST_BEND_MM / max(float(np.linalg.norm(bend)), 1e-12))
        inner = 1.3 * vessel.radius
        maps.append(
            TubeWarp(
                np.array(vessel.base),
                direction,
                vessel.length,
                inner,
                inner + 17.0,
                lengthening * direction + bend,
                float(_bounded(rng, 0.06, 1)[0]),
            )
        )
    return tuple(maps)


def _wall_map(rng: np.random.Generator) -> Bumps:
    ventricle = np.array([[0, 18, -30], [21, -3, -45], [-21, -3, -40], [0, -22, -55], [2, 0, -84]])
    atrium = np.array([[4, 34, 26], [4, 18, 42], [-17, 8, 20], [24, 2, 22], [10, 2, 28]])
    centers = np.concatenate([ventricle, atrium]).astype(np.float64)
    radii = np.repeat([32.0, 24.0], [len(ventricle), len(atrium)])
    return Bumps(centers, radii, _bounded(rng, 1.8, centers.shape))


def _size_map(rng: np.random.Generator) -> Axial:
    knots = np.array([-100.0, -70.0, -40.0, -12.0, 4.0, 18.0, 30.0, 46.0, 70.0])
    below, above = np.minimum(knots, 0.0) / -90.0, np.maximum(knots, 0.0) / 45.0
    ventricle = _smooth(-(knots + 4.0) / 36.0)
    atrium = _smooth((knots - 4.0) / 22.0)
    length, height, width, oval, breadth, flat = _bounded(
        rng, [4.0, 2.0, 0.06, 0.04, 0.06, 0.05], 6
    )
    bend = _bounded(rng, 2.5, 2)
    lean = _bounded(rng, 2.0, 2)
    displacement = np.column_stack(
        [
            bend[0] * below**2 + lean[0] * above,
            bend[1] * below**2 + lean[1] * above,
            height * np.minimum(above, 1.2) - length * below,
        ]
    )
    log_scale = np.column_stack(
        [
            (width + oval) * ventricle + (breadth + flat) * atrium,
            (width - oval) * ventricle + (breadth - flat) * atrium,
        ]
    )
    turn = float(_bounded(rng, 0.06, 1)[0]) * (atrium - ventricle)
    return Axial(np.array(_AXIS_POINT), knots, displacement, log_scale, turn)


def _bounded(
    rng: np.random.Generator, deviation: float | list[float], size: int | tuple[int, ...]
) -> FloatArray:
    # Normal numbers folded back at two standard deviations: no subject is an outlier by chance.
    raw: FloatArray = rng.normal(size=size)
    return np.asarray(deviation) * np.where(np.abs(raw) > 2.0, 4.0 / raw, raw)


def _smooth(u: FloatArray) -> FloatArray:
    u = np.clip(u, 0.0, 1.0)
    rise: FloatArray = u**3 * (10.0 + u * (6.0 * u - 15.0))
    return rise


def _rotation_vector(vector: FloatArray) -> FloatArray:
    return np.asarray(Rotation.from_rotvec(vector).as_matrix())


def _ellipsoid(
    center: tuple[float, ...], semi_axes: tuple[float, ...], about_z: float = 0.0
) -> Ellipsoid:
    cos, sin = np.cos(about_z), np.sin(about_z)
    frame = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return Ellipsoid(np.array(center), np.array(semi_axes), frame)


def _unit(vector: tuple[float, float, float]) -> FloatArray:
    array: FloatArray = np.array(vector)
    unit: FloatArray = array / np.linalg.norm(array)
    return unit
