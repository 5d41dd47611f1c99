"""Populations whose maps are spoiled on purpose: every rim turned by its own random angle.

About every circle the sphere is turned as a whole, fading out half way to the nearest other
circle. That is a homeomorphism, so what is spoiled is only where corresponding points lie.
"""

from dataclasses import replace

import numpy as np

from benchmarks.cases import Case
from ostiform.arrays import FloatArray
from ostiform.correspondence import sampler
from ostiform.domain import Circle, Sphere
from ostiform.embedding import Embedding, placed_curves
from ostiform.surface import count_flipped, sphere_locator

RIGID = 0.3
"""Share of the way from a circle to the end of its turning over which nothing fades."""

REDUCTION = 0.8
"""Factor on the angles of a shape as long as a triangle of its mesh is turned over."""

WIDEST = 0.7
"""Radians from a circle at which its turning ends at the latest."""


def with_poor_start(case: Case, degrees: float) -> Case:
    """Return the case with every rim of every shape turned by up to so many degrees.

    The angles of a shape are reduced together until no triangle of its mesh is turned over.
    """
    spheres = {sphere.name: sphere for sphere in case.domain.spheres}
    generator = np.random.default_rng([case.name.seed, 20])
    embeddings = tuple(
        tuple(_turned(one, spheres[one.component.name], degrees, generator) for one in of_shape)
        for of_shape in case.embeddings
    )
    samplers = tuple(sampler(of_shape, case.domain) for of_shape in embeddings)
    return replace(case, embeddings=embeddings, samplers=samplers)


def _turned(
    embedding: Embedding, sphere: Sphere, degrees: float, generator: np.random.Generator
) -> Embedding:
    circles = tuple(sphere.curves.values())
    angles = np.radians(generator.uniform(-degrees, degrees, size=len(circles)))
    while True:
        directions = turned_directions(embedding.directions, circles, angles)
        if not count_flipped(directions, embedding.component.faces):
            return replace(
                embedding,
                locator=sphere_locator(directions, embedding.component.faces),
                curves=placed_curves(embedding.component, sphere, directions),
            )
        angles = REDUCTION * angles


def turned_directions(
    directions: FloatArray, circles: tuple[Circle, ...], angles: FloatArray
) -> FloatArray:
    """Return unit vectors (n, 3) turned about each of several circles by its angle, radians."""
    moved = np.array(directions)
    for index, (circle, angle) in enumerate(zip(circles, angles, strict=True)):
        center = np.asarray(circle.center)
        gaps = [
            abs(np.arccos(np.clip(center @ other.center, -1.0, 1.0)) - circle.radius) - other.radius
            for place, other in enumerate(circles)
            if place != index
        ]
        width = min([WIDEST, *(0.5 * gap for gap in gaps)])  # type: ignore[type-var]
        away = np.arccos(np.clip(directions @ center, -1.0, 1.0)) - circle.radius
        share = np.clip((np.abs(away) / width - RIGID) / (1.0 - RIGID), 0.0, 1.0)
        turn = angle * (1.0 - share**3 * (10.0 - 15.0 * share + 6.0 * share**2))
        across = np.cross(center, directions)
        along = (directions @ center)[:, None] * center
        turned = along + np.cos(turn)[:, None] * (directions - along)
        turned += np.sin(turn)[:, None] * across
        chosen = share < 1.0
        moved[chosen] = turned[chosen]
    lengths = np.linalg.norm(moved, axis=1, keepdims=True)
    unit: FloatArray = moved / lengths
    return unit
