"""Opening closed surfaces: caps marked by a cell array are deleted, and name what they leave."""

from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from ostiform.arrays import IntArray
from ostiform.errors import InputError, TopologyError
from ostiform.values import Axes, value


@value
class Opened:
    """A surface whose caps were deleted.

    Attributes
    ----------
    faces : (F, 3) int64
        The faces that remain, in their order.
    rims : mapping of str to (n,) int64
        The vertices of the rim that each cap leaves, ascending (not in order along the rim).
    """

    faces: Annotated[IntArray, Axes("F", 3)]
    rims: Mapping[str, Annotated[IntArray, Axes(None)]]


def opened_by_value(faces: IntArray, values: NDArray[Any], caps: Mapping[str, float]) -> Opened:
    """Delete the faces of every cap and return the vertices of the rims they leave.

    Parameters
    ----------
    faces : (F, 3) int64
    values : (F,) array
        The cell array that marks the caps.
    caps : mapping of str to number
        The value of each cap's faces, by the name of the opening it becomes.

    Raises
    ------
    InputError
        If the array has not one number per face, or no face has the value of a cap.
    TopologyError
        If two caps touch, so that they would leave one opening, or nothing remains.
    """
    if values.shape != (len(faces),):
        raise InputError(
            f"expected one value per triangle to open by, found an array of shape {values.shape} "
            f"for {len(faces)} triangles"
        )
    present = np.unique(values)
    for name, wanted in caps.items():
        if wanted not in present:
            shown = ", ".join(f"{v:g}" for v in present[:12])
            raise InputError(
                f"expected triangles of value {wanted:g} for the opening {name}, found the values "
                f"{shown}{' and others' if len(present) > 12 else ''}"
            )
    is_wall = ~np.isin(values, list(caps.values()))
    if not is_wall.any():
        raise TopologyError("expected a wall beside the caps, found that every triangle is a cap")
    wall = faces[is_wall]
    cap_vertices = {name: np.unique(faces[values == value]) for name, value in caps.items()}
    names = tuple(caps)
    for k, name in enumerate(names):
        for other in names[k + 1 :]:
            common = np.intersect1d(cap_vertices[name], cap_vertices[other])
            if len(common):
                raise TopologyError(
                    f"expected caps that do not touch, found {name} and {other} with "
                    f"{len(common)} vertices in common"
                )
    used_by_wall = np.unique(wall)
    return Opened(
        faces=wall,
        rims={name: np.intersect1d(cap_vertices[name], used_by_wall) for name in names},
    )
