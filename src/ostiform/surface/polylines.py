"""Curves and points of VTK files, which the mesh readers leave out."""

from pathlib import Path

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.errors import InputError
from ostiform.surface.legacy_vtk import legacy_vtk_lines
from ostiform.surface.xml_vtk import xml_vtk_lines

_READERS = {".vtp": xml_vtk_lines, ".vtk": legacy_vtk_lines}


def read_polylines(path: Path) -> tuple[FloatArray, tuple[IntArray, ...], str | None]:
    """Return the points (n, 3) of a VTP or legacy VTK file, its polylines, and its stated frame.

    Polylines are vertex indices in order; a file of points alone has none. Units are the file's.

    Raises
    ------
    InputError
        If the file is missing, damaged or of another kind, or holds no points.
    """
    suffix = path.suffix.lower()
    if suffix not in _READERS:
        raise InputError(
            f"{path}: expected a .vtp or .vtk file of curves, found {suffix or 'none'}"
        )
    try:
        points, offsets, corners, space = _READERS[suffix](path.read_bytes())
    except OSError as error:
        raise InputError(f"{path}: expected a file of curves, found {error.strerror}") from None
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except (ValueError, OverflowError) as error:
        raise InputError(
            f"{path}: expected numbers where the format has them, found other text ({error})"
        ) from None
    if not len(points):
        raise InputError(f"{path}: expected points, found none")
    if (np.diff(offsets) < 0).any() or offsets[0] != 0 or offsets[-1] != len(corners):
        raise InputError(f"{path}: expected a complete list of curves, found a damaged one")
    if len(corners) and (corners.min() < 0 or corners.max() >= len(points)):
        raise InputError(
            f"{path}: expected indices from 0 to {len(points) - 1} in the curves, found "
            f"{int(corners.min())} to {int(corners.max())}"
        )
    curves = tuple(np.split(corners, offsets[1:-1])) if len(corners) else ()
    return points, curves, space
