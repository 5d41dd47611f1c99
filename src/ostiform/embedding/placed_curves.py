"""Where the rims and seams of a mapped component lie on their circles."""

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.domain import Sphere, tangent_frame
from ostiform.embedding.types import PlacedCurve
from ostiform.errors import InputError
from ostiform.surface import Component, curve_positions


def placed_curves(
    component: Component, sphere: Sphere, directions: FloatArray
) -> dict[str, PlacedCurve]:
    """Return the curves of a component on their circles, by the names of `Sphere.curves`.

    Parameters
    ----------
    component : Component
    sphere : Sphere
    directions : (V, 3) float64
        Of its vertices on the sphere.

    Raises
    ------
    InputError
        If the component lacks one of its sphere's rims or seams, or a curve does not run once
        round its circle.
    """
    loops = {**component.rims, **{seam.first: loop for seam, loop in component.seams.items()}}
    curves = {}
    for name, circle in sphere.curves.items():
        if name not in loops:
            raise InputError(
                f"component {component.name}: expected the opening or seam {name} of its sphere, "
                f"found {', '.join(loops) or 'no opening'}"
            )
        loop = loops[name]
        angles = circle.angles(directions[loop])
        positions, sign = curve_positions(angles)
        curves[name] = PlacedCurve(
            first_angle=float(angles[0]),
            sign=sign,
            positions=positions,
            loop=np.append(loop, loop[0]),
            frame=np.stack([*tangent_frame(circle.center), circle.center]),
        )
    return curves
