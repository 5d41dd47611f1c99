"""The certificate: evidence that a map to the sphere is an embedding (design 3, step 4).

Every triangle is positively oriented (exactly), and filling each hole with a cone over its rim
makes a map of a closed sphere whose triangle areas sum to 4 pi times its degree. Degree one and no
flip mean that every point of the domain is covered once. Position of the rims, side of the seams,
cyclic order of the holes and twist of the tubes make the map comparable with those of the other
shapes.
"""

from collections import Counter
from collections.abc import Sequence

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.domain import Circle, Sphere, tangent_frame
from ostiform.embedding.sides import faces_inside
from ostiform.embedding.twist import measured_twists
from ostiform.embedding.types import Certificate
from ostiform.errors import InputError
from ostiform.surface import (
    Component,
    Seam,
    exact_orientations,
    half_edges,
    spherical_areas,
    split_ostium_name,
)

# Radians, on a sphere of radius one: a thousandth of a per cent of the smallest circle allowed
# (2 degrees), a million times the round-off of a normalised vector.
CIRCLE_TOLERANCE = 1e-9
# Share of the domain: the defect is a multiple of 4 pi or round-off, nothing between.
AREA_TOLERANCE = 1e-6
# Twists of one tube differ by 2 pi between homotopy classes: a quarter of that is ample (design 3).
TWIST_TOLERANCE = 0.5 * np.pi


def certify(component: Component, sphere: Sphere, directions: FloatArray) -> Certificate:
    """Return the certificate of a map of a component to its sphere.

    Parameters
    ----------
    component : Component
    sphere : Sphere
        Its circles are those of the component's rims and seams.
    directions : (V, 3) float64
        Unit vectors.

    Returns
    -------
    certificate : Certificate
        Valid when `Certificate.problems` is empty. What can only be judged against other shapes
        (order of the holes, twist) is in `population_problems`.

    Raises
    ------
    InputError
        If the number of directions or the names of the circles do not match the component.
    """
    _check_names(component, sphere, directions)
    orientations = exact_orientations(directions, component.faces)
    flipped, degenerate = int((orientations < 0).sum()), int((orientations == 0).sum())
    area_defect = _area_defect(component, sphere, directions)
    errors = {
        name: _circle_error(circle, directions[curve])
        for name, circle, curve in _curves(component, sphere)
    }
    twist = measured_twists(component, sphere, directions)
    problems: list[str] = []
    if flipped or degenerate:
        problems.append(
            f"{component.name}: expected every triangle to be positively oriented on the sphere, "
            f"found {flipped} flipped and {degenerate} degenerate of {len(component.faces)}"
        )
    if area_defect > AREA_TOLERANCE:
        problems.append(
            f"{component.name}: expected the triangles to cover the domain once, found a total "
            f"area that differs from the domain's by {100.0 * area_defect:.3g} %"
        )
    problems += [
        f"{name}: expected its vertices on the circle to within {CIRCLE_TOLERANCE:g} rad, found "
        f"one {error:.3g} rad away"
        for name, error in errors.items()
        if error > CIRCLE_TOLERANCE
    ]
    problems += _direction_problems(component, sphere, directions)
    for seam in component.seams:
        problems += _side_problems(component, sphere, directions, seam)
    problems += [
        f"{name}: expected vertices beyond its tube, found none, so its twist is unknown"
        for name, angle in twist.items()
        if not np.isfinite(angle)
    ]
    return Certificate(
        flipped,
        degenerate,
        area_defect,
        max(errors.values(), default=0.0),
        _hole_order(component, sphere, directions),
        twist,
        tuple(problems),
    )


def population_problems(certificates: Sequence[Certificate]) -> tuple[tuple[str, ...], ...]:
    """Return what makes each map a different kind of map from the rest of the population.

    Parameters
    ----------
    certificates : sequence of Certificate
        Of the same component in every shape.

    Returns
    -------
    problems : tuple of tuple of str
        One tuple per certificate, one sentence per problem: an order of the holes about the pole
        that differs from the most frequent one, or a twist more than 90 degrees from the median
        over the shapes, that is another number of whole turns (a Dehn twist).
    """
    if not certificates:
        return ()
    orders = Counter(certificate.hole_order for certificate in certificates)
    usual_order = max(orders, key=lambda order: (orders[order], order))
    medians = {
        name: float(np.nanmedian([c.twist.get(name, np.nan) for c in certificates]))
        for name in certificates[0].twist
        if any(np.isfinite(c.twist.get(name, np.nan)) for c in certificates)
    }
    return tuple(_differences(c, usual_order, medians) for c in certificates)


def _differences(
    certificate: Certificate, usual_order: tuple[str, ...], medians: dict[str, float]
) -> tuple[str, ...]:
    problems = []
    if certificate.hole_order != usual_order:
        problems.append(
            f"expected the openings in the order {', '.join(usual_order)} about the pole as in "
            f"the other shapes, found {', '.join(certificate.hole_order)}"
        )
    for name, median in medians.items():
        angle = certificate.twist.get(name, float("nan"))
        if not abs(angle - median) <= TWIST_TOLERANCE:
            problems.append(
                f"{name}: expected its tube twisted within {np.degrees(TWIST_TOLERANCE):.0f} "
                f"degrees of the population's {np.degrees(median):.0f}, found "
                f"{np.degrees(angle):.0f}"
            )
    return tuple(problems)


def _check_names(component: Component, sphere: Sphere, directions: FloatArray) -> None:
    if directions.shape != (len(component.vertices), 3):
        raise InputError(
            f"{component.name}: expected directions of shape ({len(component.vertices)}, 3), "
            f"found {directions.shape}"
        )
    if set(component.rims) != set(sphere.rims) or set(component.seams) != set(sphere.seams):
        raise InputError(
            f"{component.name}: expected circles for the rims {', '.join(component.rims)} and "
            f"{len(component.seams)} seams, found circles for {', '.join(sphere.rims)} and "
            f"{len(sphere.seams)} seams"
        )


def _curves(component: Component, sphere: Sphere) -> list[tuple[str, Circle, IntArray]]:
    rims = [(name, sphere.rims[name], rim) for name, rim in component.rims.items()]
    seams = [(seam.first, sphere.seams[seam], c) for seam, c in component.seams.items()]
    return rims + seams


def _area_defect(component: Component, sphere: Sphere, directions: FloatArray) -> float:
    """Relative difference of the covered area from the sphere's less the rim polygons'."""
    covered = float(spherical_areas(directions, component.faces).sum())
    holes = sum(
        float(spherical_areas(*_cone(sphere.rims[name], directions, rim[::-1])).sum())
        for name, rim in component.rims.items()
    )
    domain = 4.0 * np.pi - holes
    return abs(covered - domain) / abs(domain)


def _cone(circle: Circle, directions: FloatArray, curve: IntArray) -> tuple[FloatArray, IntArray]:
    """Points and faces of the fan from a circle's centre over a curve, left side inward."""
    rank = np.arange(len(curve))
    faces = np.stack([np.full(len(curve), len(curve)), rank, np.roll(rank, -1)], axis=1)
    return np.concatenate([directions[curve], circle.center[None]]), faces


def _circle_error(circle: Circle, points: FloatArray) -> float:
    across = np.linalg.norm(np.cross(points, circle.center), axis=1)
    polar = np.arctan2(across, points @ circle.center)  # (n,)
    return float(np.abs(polar - circle.radius).max())


def _direction_problems(component: Component, sphere: Sphere, directions: FloatArray) -> list[str]:
    """Rims run clockwise about their centre, seams counter-clockwise, without turning back."""
    ordered = [(name, sphere.rims[name], rim[::-1]) for name, rim in component.rims.items()]
    ordered += [(s.first, sphere.seams[s], c) for s, c in component.seams.items()]
    problems = []
    for name, circle, curve in ordered:
        backward = int((exact_orientations(*_cone(circle, directions, curve)) <= 0).sum())
        if backward:
            problems.append(
                f"{name}: expected the curve to run once about its circle in the order of its "
                f"vertices, found {backward} of {len(curve)} edges that run backwards"
            )
    return problems


def _side_problems(
    component: Component, sphere: Sphere, directions: FloatArray, seam: Seam
) -> list[str]:
    """The second part lies on the seam's left, inside its circle, the first outside."""
    curve, circle = component.seams[seam], sphere.seams[seam]
    problems = []
    second_part = component.parts.index(split_ostium_name(seam.second)[0])
    n_vertices = len(component.vertices)
    along = curve * n_vertices + np.roll(curve, -1)
    directed = half_edges(component.faces)  # (3F, 2)
    keys = directed[:, 0] * n_vertices + directed[:, 1]
    on_left = np.isin(keys, along)
    owners = np.repeat(component.face_part, 3)[on_left]
    if int(on_left.sum()) != len(curve) or (owners != second_part).any():
        problems.append(
            f"{seam.first} = {seam.second}: expected {seam.second} on the left of every edge of "
            f"the seam, found it on {int((owners == second_part).sum())} of {len(curve)}"
        )
    # Straight triangles follow the polygon, which lies off a small circle by its sagitta.
    middle = directions[curve] + directions[np.roll(curve, -1)]
    middle = middle / np.linalg.norm(middle, axis=1, keepdims=True)
    slack = _circle_error(circle, middle) + CIRCLE_TOLERANCE
    polar = np.arccos(np.clip(directions @ circle.center, -1.0, 1.0))
    inside = faces_inside(component, seam)
    is_out = polar[component.faces[inside]] > circle.radius + slack
    is_in = polar[component.faces[~inside]] < circle.radius - slack
    wrong = int(is_out.any(axis=1).sum() + is_in.any(axis=1).sum())
    if wrong:
        problems.append(
            f"{seam.first} = {seam.second}: expected {seam.second} inside its circle and "
            f"{seam.first} outside, found {wrong} triangles that reach over it"
        )
    return problems


def _hole_order(component: Component, sphere: Sphere, directions: FloatArray) -> tuple[str, ...]:
    """Rims and further seams, counter-clockwise about the pole, from the first by name."""
    pole_center = np.array([0.0, 0.0, 1.0])
    azimuths: dict[str, float] = {}
    for name, circle, _ in _curves(component, sphere):
        seconds = {seam.second for seam in component.seams if seam.first == name}
        if sphere.pole == name or sphere.pole in seconds:
            pole_center = circle.center
            continue
        azimuths[name] = 0.0
    e1, e2 = tangent_frame(pole_center)
    for name, _, curve in _curves(component, sphere):
        if name in azimuths:
            image = directions[curve].mean(axis=0)  # (3,)
            azimuths[name] = float(np.arctan2(image @ e2, image @ e1))
    ordered = sorted(azimuths, key=lambda name: azimuths[name])
    if not ordered:
        return ()
    start = ordered.index(min(ordered))
    return tuple(ordered[start:] + ordered[:start])
