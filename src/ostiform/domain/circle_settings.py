"""What a study fixes of the circles of its base domain."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.domain.checks import angle_between
from ostiform.domain.touching_spheres import SeamSide, circle_from_part_sphere
from ostiform.domain.types import NORTH, Circle
from ostiform.errors import InputError
from ostiform.surface import Seam, split_ostium_name


@dataclass(frozen=True, slots=True, eq=False)
class CircleSetting:
    """What a study fixes of one circle, on the component sphere; None is left to the layout.

    Attributes
    ----------
    center : (3,) float64 or None
        Any length but zero.
    radius_deg : float or None
    phase_deg : float or None
    frame : {"component", "part"}
        Which sphere the numbers are on: the component's, or the part's own of HY 2.1
        (`touching_spheres`, the seam 30 degrees about its north pole). A part without seam has
        the component's.
    """

    center: FloatArray | None = None
    radius_deg: float | None = None
    phase_deg: float | None = None
    frame: Literal["component", "part"] = "component"


def own_settings(
    settings: Mapping[str, CircleSetting],
    rims: Sequence[str],
    further: Sequence[Seam],
    equator: Seam | None,
) -> dict[str, CircleSetting]:
    """Return the settings of one component by curve name, after checking them one by one."""
    curve = {name: name for name in rims}
    for seam in further:
        curve |= {seam.first: seam.first, seam.second: seam.first}
    own: dict[str, CircleSetting] = {}
    for name, setting in settings.items():
        _check_setting(name, setting)
        if equator is not None and name in (equator.first, equator.second):
            _check_equator(name, setting)
        elif name in curve:
            if curve[name] in own:
                raise InputError(
                    f"circle {name}: expected one setting for the two sides of a seam, found two"
                )
            own[curve[name]] = _on_component(name, setting, equator)
    return own


def _on_component(name: str, setting: CircleSetting, equator: Seam | None) -> CircleSetting:
    """Return a setting of a part's own sphere as one of the component sphere."""
    if setting.frame == "component" or equator is None:
        return setting
    part = split_ostium_name(name)[0]
    sides: dict[str, SeamSide] = {
        split_ostium_name(equator.first)[0]: "first",
        split_ostium_name(equator.second)[0]: "second",
    }
    if part not in sides:
        raise InputError(
            f"circle {name}: expected a part beside the seam {equator.first} = {equator.second} "
            f'for frame = "part", found {part}: give it on the component sphere'
        )
    if setting.center is None or setting.radius_deg is None:
        raise InputError(
            f'circle {name}: expected a centre and a radius for frame = "part", found only one: '
            "give both"
        )
    circle = circle_from_part_sphere(
        Circle(
            np.asarray(setting.center, dtype=np.float64),
            float(np.radians(setting.radius_deg)),
            float(np.radians(setting.phase_deg or 0.0)),
        ),
        sides[part],
    )
    return CircleSetting(
        circle.center, float(np.degrees(circle.radius)), float(np.degrees(circle.phase))
    )


def _check_setting(name: str, setting: CircleSetting) -> None:
    if setting.center is not None:
        center = np.asarray(setting.center, dtype=np.float64)
        if center.shape != (3,) or not np.isfinite(center).all() or not np.linalg.norm(center) > 0:
            raise InputError(
                f"circle {name}: expected a centre of three finite numbers, not all zero, found "
                f"{np.array2string(center)}"
            )
    if setting.radius_deg is not None and not 0.0 < setting.radius_deg < 180.0:
        raise InputError(
            f"circle {name}: expected a radius between 0 and 180 degrees, found "
            f"{setting.radius_deg:g}"
        )
    if setting.phase_deg is not None and not np.isfinite(setting.phase_deg):
        raise InputError(f"circle {name}: expected a finite phase, found {setting.phase_deg}")


def _check_equator(name: str, setting: CircleSetting) -> None:
    is_north = setting.center is None or (
        angle_between(np.asarray(setting.center) / np.linalg.norm(setting.center), NORTH) < 1e-9
    )
    if not is_north or setting.radius_deg not in (None, 90.0):
        raise InputError(
            f"circle {name}: expected the seam at the pole to be the equator about (0, 0, 1), "
            "found another circle: leave its centre and radius out"
        )


def equator_phase(settings: Mapping[str, CircleSetting], seam: Seam) -> float:
    """Return the phase in radians that a study gives the equator, by either name; default 0."""
    for name in (seam.first, seam.second):
        if name in settings:
            return float(np.radians(settings[name].phase_deg or 0.0))
    return 0.0
