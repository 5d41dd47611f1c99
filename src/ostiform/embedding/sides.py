"""Which faces of a component lie on either side of a seam."""

import numpy as np

from ostiform.arrays import BoolArray
from ostiform.errors import TopologyError
from ostiform.surface import Component, Seam, component_parts, split_ostium_name


def faces_inside(component: Component, seam: Seam) -> BoolArray:
    """Return which faces (F,) lie on the side of `Seam.second`, so inside the seam's circle.

    Raises
    ------
    TopologyError
        If the seam joins a part to itself, so that it has no sides.
    """
    first, second = (split_ostium_name(name)[0] for name in (seam.first, seam.second))
    others = [other for other in component.seams if other != seam]
    side = next(group for group in component_parts(component.parts, others) if second in group)
    if first in side:
        raise TopologyError(
            f"{component.name}: expected the seam {seam.first} = {seam.second} to separate the "
            f"component, found {first} on both sides; handles are not supported yet"
        )
    inside: BoolArray = np.isin(component.face_part, [component.parts.index(p) for p in side])
    return inside
