"""Cuts through a mesh under construction: the cut's curve becomes a chain of its edges."""

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.demo.implicit import Anatomy
from ostiform.demo.relaxation import Sheet, project_to_curves
from ostiform.surface import edge_faces

_SNAP_SHARE = 0.3
"""Vertices within this share of the mean edge of a cut are moved onto it."""


def split_along(sheet: Sheet, anatomy: Anatomy, index: int, edge_mm: float) -> Sheet:
    """Return the sheet with the curve of a cut among its edges.

    Parameters
    ----------
    sheet : Sheet
        Its `side` holds one bit per cut made.
    anatomy : Anatomy
    index : int
        Of the cut.
    edge_mm : float
        Mean edge length, mm.

    Returns
    -------
    Sheet
        Vertices of the curve carry `index`; of the faces that touch it, those beyond the cut
        have bit `index` of their `side` set.
    """
    cut = anatomy.cuts[index]
    reached = cut.reaches(sheet.material)
    height = np.where(reached, cut.height(sheet.material)[0], np.nan)
    with np.errstate(invalid="ignore"):
        snapped = np.abs(height) < _SNAP_SHARE * edge_mm
    for _ in range(4):
        # A face with three vertices on the curve would belong to neither side.
        full = snapped[sheet.faces].all(axis=1)
        if not full.any():
            break
        corners = sheet.faces[full]
        farthest = np.abs(height[corners]).argmax(axis=1)
        snapped[corners[np.arange(len(corners)), farthest]] = False
    side = np.where(snapped, 0.0, np.sign(height))  # nan where the cut does not act

    low, high = _extremes(side, sheet.faces)
    known = np.isfinite(side[sheet.faces]).all(axis=1)
    crossing = known & (low < 0.0) & (high > 0.0)
    new_points, new_faces, parents = _split_faces(
        sheet.material, sheet.faces[crossing], side, height
    )
    material = np.concatenate([sheet.material, new_points])
    faces = np.concatenate([sheet.faces[~crossing], new_faces])
    bits = np.concatenate([sheet.side[~crossing], sheet.side[crossing][parents]])

    side = np.concatenate([side, np.zeros(len(new_points))])
    touching = (side[faces] == 0.0).any(axis=1)
    beyond = touching & (_extremes(side, faces)[1] > 0.0)
    edges, sides = edge_faces(faces[touching])
    divides = (sides[:, 1] >= 0) & np.diff(beyond[touching][sides], axis=1).ravel()
    # A vertex moved towards the cut without neighbours on both sides is not on the curve.
    onto = np.unique(edges[divides & (side[edges] == 0.0).all(axis=1)])
    curve = np.concatenate([sheet.curve, np.full(len(new_points), -1, dtype=np.int64)])
    curve[onto] = index
    material[onto] = project_to_curves(anatomy, material[onto], curve[onto])
    return Sheet(material, faces, curve, np.where(beyond, bits | (1 << index), bits))


def _extremes(side: FloatArray, faces: IntArray) -> tuple[FloatArray, FloatArray]:
    # Least and greatest side of each face's corners, 0 where the cut reaches none.
    values = side[faces]
    values[np.isnan(values).all(axis=1)] = 0.0
    return np.nanmin(values, axis=1), np.nanmax(values, axis=1)


def _split_faces(
    points: FloatArray, faces: IntArray, side: FloatArray, height: FloatArray
) -> tuple[FloatArray, IntArray, IntArray]:
    # Points where edges cross the cut, the pieces of the crossed faces, and each piece's parent.
    edges: dict[tuple[int, int], int] = {}
    new_points: list[FloatArray] = []
    new_faces: list[tuple[int, int, int]] = []
    parents: list[int] = []

    def crossing(i: int, j: int) -> int:
        key = (min(i, j), max(i, j))
        if key not in edges:
            edges[key] = len(points) + len(new_points)
            share = height[key[0]] / (height[key[0]] - height[key[1]])
            new_points.append(points[key[0]] + share * (points[key[1]] - points[key[0]]))
        return edges[key]

    def position(i: int) -> FloatArray:
        return points[i] if i < len(points) else new_points[i - len(points)]

    for parent, face in enumerate(faces.tolist()):
        signs = [side[v] for v in face]
        if 0.0 in signs:
            first = signs.index(0.0)
            a, b, c = face[first], face[(first + 1) % 3], face[(first + 2) % 3]
            m = crossing(b, c)
            pieces = [(a, b, m), (a, m, c)]
        else:
            lone = next(k for k in range(3) if signs.count(signs[k]) == 1)
            a, b, c = face[lone], face[(lone + 1) % 3], face[(lone + 2) % 3]
            p, q = crossing(a, b), crossing(a, c)
            pieces = [(a, p, q)]
            if np.linalg.norm(position(p) - points[c]) < np.linalg.norm(position(q) - points[b]):
                pieces += [(p, b, c), (p, c, q)]
            else:
                pieces += [(p, b, q), (q, b, c)]
        new_faces += pieces
        parents += [parent] * len(pieces)
    return (
        np.array(new_points).reshape(-1, 3),
        np.array(new_faces, dtype=np.int64).reshape(-1, 3),
        np.array(parents, dtype=np.int64),
    )
