"""HY's first map: rims on their circles, the rest spread by Tutte's method (HY 2.1, Fig. 2a).

Every boundary loop is put on its circle by arc length, and every other vertex at the mean of its
neighbours in the stereographic plane, each part in its own plane as on HY's two spheres. With more
than one circle the domain is not convex, Tutte's theorem does not hold, and the map is folded
round the openings ("mesh folding is inevitable", HY 2.1): 20 to 32 % of the triangles of an atrium
with long veins. It is the start of the paper's chain, not of the default method, which fills the
holes first.
"""

from collections.abc import Mapping
from typing import Annotated

import numpy as np
from scipy.sparse.linalg import splu

from ostiform.arrays import BoolArray, FloatArray, IntArray
from ostiform.domain import Circle, Sphere, tangent_frame
from ostiform.errors import InputError
from ostiform.surface import (
    Component,
    inverse_stereographic,
    rotation_between,
    split_ostium_name,
    stereographic,
    uniform_laplacian,
    without_unreferenced,
)
from ostiform.values import Axes, value


@value
class PlanarChart:
    """One part of a component in the stereographic plane of the opening that encloses it.

    Attributes
    ----------
    vertices : (n,) int64
        Indices into the component's vertices.
    faces : (m, 3) int64
        Indices into `vertices`; counter-clockwise in the plane when not folded.
    is_fixed : (n,) bool
        Vertices of rims and seams.
    points : (n, 2) float64
        Positions in the plane, in units of the sphere's radius.
    frame : (3, 3) float64
        Rotation that carries the direction of the stereographic pole to +z.
    """

    vertices: Annotated[IntArray, Axes("V")]
    faces: Annotated[IntArray, Axes("F", 3)]
    is_fixed: Annotated[BoolArray, Axes("V")]
    points: Annotated[FloatArray, Axes("V", 2)]
    frame: Annotated[FloatArray, Axes(3, 3)]


def fixed_circle_charts(
    component: Component, sphere: Sphere, rotations: Mapping[str, float] | None = None
) -> tuple[PlanarChart, ...]:
    """Return Tutte's map with every rim and seam fixed on its circle, one plane per part.

    Parameters
    ----------
    component : Component
    sphere : Sphere
        A part without seams is projected from the centre of the pole's circle (its first rim's
        where the pole is elsewhere), a part with a seam from the far side of the seam.
    rotations : mapping of str to float, optional
        Angle on its circle, in radians, of the first vertex of each rim and seam (a seam by the
        name of its first ostium); the phase of the circle by default.

    Returns
    -------
    charts : tuple of PlanarChart

    Raises
    ------
    InputError
        If a part has no opening to be projected from.
    """
    images = arc_length_images(component, sphere, rotations)
    fixed = np.concatenate([np.empty(0, np.int64), *(curve for curve, _ in images.values())])
    directions = np.zeros((len(component.vertices), 3))
    for curve, image in images.values():
        directions[curve] = image
    charts = []
    for number, part in enumerate(component.parts):
        used, faces = without_unreferenced(
            component.faces[component.face_part == number], len(component.vertices)
        )
        is_fixed = np.isin(used, fixed)
        frame = rotation_between(_pole(sphere, part), np.array([0.0, 0.0, 1.0]))
        points = np.zeros((len(used), 2))
        points[is_fixed] = _plane(directions[used[is_fixed]] @ frame.T)
        points[~is_fixed] = _neighbour_means(faces, is_fixed, points)
        charts.append(PlanarChart(used, faces, is_fixed, points, frame))
    return tuple(charts)


def on_sphere(charts: tuple[PlanarChart, ...], n_vertices: int) -> FloatArray:
    """Return the unit vectors (V, 3) of charts projected back to the sphere."""
    directions = np.zeros((n_vertices, 3))
    for chart in charts:
        zeta = chart.points[:, 0] - 1j * chart.points[:, 1]
        directions[chart.vertices] = inverse_stereographic(zeta) @ chart.frame
    return directions


def arc_length_images(
    component: Component, sphere: Sphere, rotations: Mapping[str, float] | None = None
) -> dict[str, tuple[IntArray, FloatArray]]:
    """Return every rim and seam with its place (n, 3) on its circle by arc length (HY 2.1).

    Parameters are those of `fixed_circle_charts`.

    Returns
    -------
    images : dict of str to ((n,) int64, (n, 3) float64)
        By full name of the rim, of a seam's first ostium: the vertices and their unit vectors.
    """
    images = {}
    for name, circle, curve, sign in _curves(component, sphere):
        start = circle.phase if rotations is None else rotations.get(name, circle.phase)
        share = _arc_length_shares(component.vertices, curve)
        images[name] = (curve, circle.points(start + sign * 2.0 * np.pi * share))
    return images


def natural_rotations(component: Component, sphere: Sphere, pose: FloatArray) -> dict[str, float]:
    """Return the rotation of every rim and seam that suits the shape best (design 2).

    The angle at which each vertex is seen along the opening's axis, less its arc-length angle,
    averaged over the loop.

    Parameters
    ----------
    component : Component
    sphere : Sphere
    pose : (3, 3) float64
        Rotation from the component's coordinates to the frame of its sphere.

    Returns
    -------
    rotations : dict of str to float
        Radians, as in `fixed_circle_charts`.
    """
    rotations = {}
    for name, circle, curve, sign in _curves(component, sphere):
        offsets = (component.vertices[curve] - component.vertices[curve].mean(axis=0)) @ pose.T
        # Twice the area vector of the loop: its axis, up the circle's axis whatever its direction.
        axis = sign * np.cross(offsets, np.roll(offsets, -1, axis=0)).sum(axis=0)
        if not np.linalg.norm(axis) > 0.0:
            rotations[name] = circle.phase
            continue
        seen = offsets @ rotation_between(axis, circle.center).T  # (n, 3)
        e1, e2 = tangent_frame(circle.center)
        angles = np.arctan2(seen @ e2, seen @ e1)
        arc = sign * 2.0 * np.pi * _arc_length_shares(component.vertices, curve)
        rotations[name] = float(np.angle(np.exp(1j * (angles - arc)).mean()))
    return rotations


def _curves(component: Component, sphere: Sphere) -> list[tuple[str, Circle, IntArray, float]]:
    """Name, circle, vertices and sense of every rim (clockwise, -1) and seam (+1)."""
    rims = [(name, sphere.rims[name], rim, -1.0) for name, rim in component.rims.items()]
    seams = [(s.first, sphere.seams[s], curve, 1.0) for s, curve in component.seams.items()]
    return rims + seams


def _arc_length_shares(vertices: FloatArray, curve: IntArray) -> FloatArray:
    """Arc length from the first vertex to each, over the curve's length, (n,)."""
    steps = np.linalg.norm(vertices[np.roll(curve, -1)] - vertices[curve], axis=1)
    # Two vertices in one place would share a point of the circle.
    steps = np.maximum(steps, 1e-3 * steps.mean())
    shares: FloatArray = np.concatenate([[0.0], np.cumsum(steps)[:-1]]) / steps.sum()
    return shares


def _pole(sphere: Sphere, part: str) -> FloatArray:
    """The direction of a part's stereographic pole: in an opening, outside the part."""
    for seam, circle in sphere.seams.items():
        if split_ostium_name(seam.first)[0] == part:
            return circle.center
        if split_ostium_name(seam.second)[0] == part:
            return -circle.center
    rims = [name for name in sphere.rims if split_ostium_name(name)[0] == part]
    if not rims:
        raise InputError(
            f"{part}: expected an opening to project the part from, found none; a closed surface "
            "has no stereographic plane of its own, embed it with the default method"
        )
    return sphere.rims[sphere.pole if sphere.pole in rims else rims[0]].center


def _plane(directions: FloatArray) -> FloatArray:
    """Stereographic projection (n, 2), mirrored so that outside stays counter-clockwise."""
    zeta = stereographic(directions)
    return np.stack([zeta.real, -zeta.imag], axis=1)


def _neighbour_means(faces: IntArray, is_fixed: BoolArray, points: FloatArray) -> FloatArray:
    """Solve for the free points (n_free, 2) that are the means of their neighbours."""
    free, fixed = np.flatnonzero(~is_fixed), np.flatnonzero(is_fixed)
    rows = uniform_laplacian(faces, len(points))[free]
    solver = splu(
        rows[:, free].tocsc(),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    means: FloatArray = solver.solve(-(rows[:, fixed] @ points[fixed]))
    return means
