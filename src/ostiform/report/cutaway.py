"""Parts that lie round others (an epicardium round its ventricles) are drawn cut open."""

from collections.abc import Sequence

import igl
import numpy as np

from ostiform.arrays import BoolArray, FloatArray
from ostiform.model import ShapeModel
from ostiform.report.shading import View

INSIDE_SHARE = 0.8
"""Of a part's points that lie inside another, which is then drawn open before it."""


def enclosed_parts(model: ShapeModel) -> dict[int, tuple[int, ...]]:
    """Return, by the index of a part that lies round others on the mean shape, these parts.

    A point is inside where the winding number of the surface, open at its ostia, is above one half
    (Jacobson et al. 2013).
    """
    mesh = model.mesh
    found: dict[int, tuple[int, ...]] = {}
    parts = range(len(mesh.parts))
    for outer in parts:
        inner = [other for other in parts if other != outer and _lies_in(model, other, outer)]
        if inner:
            found[outer] = tuple(inner)
    return found


def _lies_in(model: ShapeModel, inner: int, outer: int) -> bool:
    points, own = (model.mean[model.mesh.part == index] for index in (inner, outer))
    if not len(points) or not len(own):
        return False
    middle = points.mean(axis=0)
    if (middle < own.min(axis=0)).any() or (middle > own.max(axis=0)).any():
        return False  # most pairs, at no cost
    faces = np.ascontiguousarray(model.mesh.faces[model.mesh.face_part == outer])
    inside = igl.winding_number(model.mean, faces, points) > 0.5
    return bool(inside.mean() > INSIDE_SHARE)


def drawn_faces(model: ShapeModel, views: Sequence[View]) -> list[BoolArray]:
    """Return which triangles (F,) of a model are drawn in each of several views.

    All, but for the half of a part round others that lies before the middle of these.
    """
    mesh, enclosed = model.mesh, enclosed_parts(model)
    shown = []
    for view in views:
        drawn = np.ones(len(mesh.faces), dtype=np.bool_)
        nearness: FloatArray = view.seen(model.mean)[:, 2]
        for outer, inner in enclosed.items():
            middle = nearness[np.isin(mesh.part, inner)].mean()
            drawn &= (mesh.face_part != outer) | (nearness[mesh.faces].mean(axis=1) < middle)
        shown.append(drawn)
    return shown
