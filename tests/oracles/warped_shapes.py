"""Shapes on a sphere with circles, whose maps are wrong by known warps.

A shape is ``S_i(u) = g_i(psi_i(u))``: g_i carries material points of the sphere to space, psi_i is
a diffeomorphism that keeps every circle. Shape i is in true correspondence where template point u
sits at direction ``psi_i^-1(u)``, that is ``psi_i(phi_i(u)) = u``.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull

from ostiform.arrays import FloatArray, IntArray
from ostiform.correspondence.fields import (
    FieldBasis,
    bump_fields,
    circle_table,
    flow,
    join_fields,
    twist_fields,
)
from ostiform.correspondence.sampling import ShapeSampler, sampler
from ostiform.domain import BaseDomain, Circle, Sphere, Template, TemplateLevel
from ostiform.embedding import Certificate, Distortion, Embedding, placed_curves
from ostiform.study import ShapeId
from ostiform.surface import Component, Seam, sphere_locator
from ostiform.surface.sphere import spherical_fibonacci

SEAM = Seam("A.neck", "B.neck")


def one_part_domain() -> BaseDomain:
    """Three rims on one part."""
    rims = {
        "A.top": Circle(np.array([0.0, 0.0, 1.0]), np.radians(20.0)),
        "A.left": Circle(np.array([1.0, 0.3, -0.6]), np.radians(8.0)),
        "A.right": Circle(np.array([-0.8, 0.7, -0.4]), np.radians(6.0)),
    }
    return BaseDomain((Sphere("A", ("A",), rims, {}, "A.top"),))


def two_part_domain() -> BaseDomain:
    """Two parts joined at the equator, with one and two rims."""
    rims = {
        "A.low": Circle(np.array([0.5, 0.2, -0.8]), np.radians(10.0)),
        "B.left": Circle(np.array([0.7, 0.0, 0.7]), np.radians(6.0)),
        "B.right": Circle(np.array([-0.6, 0.5, 0.6]), np.radians(5.0)),
    }
    seams = {SEAM: Circle(np.array([0.0, 0.0, 1.0]), np.pi / 2.0)}
    return BaseDomain((Sphere("A+B", ("A", "B"), rims, seams, "A.neck"),))


def triangulated(domain: BaseDomain, count: int) -> Template:
    """Triangulate the one sphere of a domain with about `count` points, circles respected."""
    sphere = domain.spheres[0]
    spacing = np.sqrt(4.0 * np.pi / count * 2.0 / np.sqrt(3.0))
    free = spherical_fibonacci(count)
    on_curves, labels = [], []
    for number, circle in enumerate(sphere.curves.values()):
        n = max(12, round(2.0 * np.pi * np.sin(circle.radius) / spacing))
        on_curves.append(circle.points(2.0 * np.pi * np.arange(n) / n))
        labels.append(np.full(n, number))
        away = np.arccos(np.clip(free @ circle.center, -1.0, 1.0)) - circle.radius
        is_seam = number >= len(sphere.rims)
        free = free[np.abs(away) > 0.5 * spacing if is_seam else away > 0.5 * spacing]
    points = np.concatenate([free, *on_curves])
    curve = np.concatenate([np.full(len(free), -1), *labels])
    faces = ConvexHull(points).simplices.astype(np.int64)
    a, b, c = (points[faces[:, k]] for k in range(3))
    turned = np.einsum("fk,fk->f", a, np.cross(b, c)) < 0
    faces[turned] = faces[turned][:, ::-1]
    closing = (
        (curve[faces] == curve[faces[:, :1]]).all(axis=1)
        & (curve[faces[:, 0]] >= 0)
        & (curve[faces[:, 0]] < len(sphere.rims))
    )
    faces = faces[~closing]
    upper = points[faces].mean(axis=1)[:, 2] > 0.0
    face_part = upper.astype(np.int64) if sphere.seams else np.zeros(len(faces), np.int64)
    part = np.zeros(len(points), np.int64)
    if sphere.seams:
        part = ((points[:, 2] > 0.0) & (curve < len(sphere.rims))).astype(np.int64)
    loops = {name: np.flatnonzero(curve == number)[::-1] for number, name in enumerate(sphere.rims)}
    return Template(
        points=points,
        sphere=np.zeros(len(points), np.int64),
        part=part,
        faces=faces,
        face_part=face_part,
        parts=sphere.parts,
        curve=curve,
        curves=tuple(sphere.curves),
        loops=loops,
    )


def with_level(template: Template, domain: BaseDomain, count: int) -> Template:
    """Give a template one coarser level of about `count` of its own points."""
    from dataclasses import replace

    from scipy.spatial import cKDTree

    coarse = triangulated(domain, count)
    index = np.full(len(coarse.points), -1)
    for curve in np.unique(coarse.curve):
        mine, theirs = (
            np.flatnonzero(template.curve == curve),
            np.flatnonzero(coarse.curve == curve),
        )
        nearest = cKDTree(template.points[mine]).query(coarse.points[theirs])[1]
        index[theirs] = mine[nearest]
    if len(np.unique(index)) != len(index):
        raise ValueError("the coarse level is too fine for its template")
    return replace(template, levels=(TemplateLevel(index, coarse.faces, coarse.face_part),))


def embedded(
    domain: BaseDomain, mesh: Template, positions: FloatArray, directions: FloatArray
) -> Embedding:
    """Wrap a mapped mesh as the embedding of the one component of a domain."""
    sphere = domain.spheres[0]
    number = {name: row for row, name in enumerate(mesh.curves)}
    component = Component(
        name=sphere.name,
        parts=sphere.parts,
        vertices=positions,
        faces=mesh.faces,
        face_part=mesh.face_part,
        rims={name: np.flatnonzero(mesh.curve == number[name])[::-1] for name in sphere.rims},
        seams={seam: np.flatnonzero(mesh.curve == number[seam.first]) for seam in sphere.seams},
    )
    certificate = Certificate(0, 0, 0.0, 0.0, (), {}, ())
    distortion = Distortion(1.0, 1.0, 1.0, 1.0, 1.0, {}, {})
    locator = sphere_locator(directions, component.faces)
    curves = placed_curves(component, sphere, directions)
    return Embedding(component, locator, curves, certificate, distortion, (), "barrier", 0.0)


@dataclass(frozen=True)
class WarpedFamily:
    """Shapes with their true correspondence."""

    domain: BaseDomain
    samplers: tuple[ShapeSampler, ...]
    ids: tuple[ShapeId, ...]
    surfaces: tuple[Callable[[FloatArray], FloatArray], ...]  # g_i
    materials: tuple[Callable[[Template, FloatArray], FloatArray], ...]  # psi_i

    def error(self, template: Template, directions: FloatArray, weights: FloatArray) -> float:
        """Return the mean distance (mm) over ordered pairs to the true correspondence."""
        materials = np.stack(
            [
                material(template, own)
                for material, own in zip(self.materials, directions, strict=True)
            ]
        )
        count = len(materials)
        errors = [
            weights
            @ np.linalg.norm(
                self.surfaces[j](materials[i]) - self.surfaces[j](materials[j]), axis=1
            )
            for i in range(count)
            for j in range(count)
            if i != j
        ]
        return float(np.mean(errors))


def warped_family(
    domain: BaseDomain,
    count: int,
    rng: np.random.Generator,
    *,
    n_vertices: int = 1500,
    warp: float = 0.25,
    twist: float = 0.25,
    phases: int = 1,
) -> WarpedFamily:
    """Make shapes with two modes of variation whose maps are warped at random.

    Parameters
    ----------
    domain : BaseDomain
    count : int
    rng : numpy.random.Generator
    n_vertices : int
    warp, twist : float
        Size in radians of the random interior warps and of the turns of the rims.
    phases : int
        Shapes per subject.
    """
    mesh = triangulated(domain, n_vertices)
    circles = circle_table(domain, mesh)
    samplers, surfaces, materials = [], [], []
    for _ in range(count):
        surface = _ellipsoid_with_bump(rng.normal(size=2))
        basis, coefficients = _random_warp(circles, rng, warp, twist)
        material = _material(basis, coefficients)
        positions = surface(material(mesh, mesh.points))
        samplers.append(sampler([embedded(domain, mesh, positions, mesh.points)], domain))
        surfaces.append(surface)
        materials.append(material)
    ids = tuple(
        ShapeId(f"s{number // phases}", str(number % phases), (number % phases) / phases)
        for number in range(count)
    )
    return WarpedFamily(domain, tuple(samplers), ids, tuple(surfaces), tuple(materials))


def _ellipsoid_with_bump(scores: FloatArray) -> Callable[[FloatArray], FloatArray]:
    """Return g of a smooth, asymmetric body of about 25 mm with two modes of variation."""

    def surface(u: FloatArray) -> FloatArray:
        axes = np.array([22.0, 27.0, 33.0]) * np.exp([0.06 * scores[0], -0.03 * scores[0], 0.0])
        bump = 6.0 * np.exp(4.0 * (u @ np.array([0.6, 0.0, 0.8]) - 1.0))
        dent = (5.0 + 2.5 * scores[1]) * np.exp(6.0 * (u @ np.array([-0.36, -0.8, 0.48]) - 1.0))
        ripple = 2.0 * np.exp(8.0 * (u @ np.array([0.0, -0.6, -0.8]) - 1.0))
        positions: FloatArray = u * axes + (bump - dent + ripple)[:, None] * u
        return positions

    return surface


def _random_warp(
    circles: FloatArray, rng: np.random.Generator, warp: float, twist: float
) -> tuple[FieldBasis, FloatArray]:
    centers = spherical_fibonacci(12)
    sphere, control = np.zeros(len(centers), np.int64), np.arange(len(centers))
    bases = [bump_fields(circles, sphere, centers, np.full(len(centers), 1.0), control)]
    sizes = [np.full(2 * len(centers), warp)]
    for row in range(len(circles)):
        bases.append(twist_fields(circles, row, np.zeros(1), 0.5, np.zeros(1, np.int64)))
        sizes.append(np.full(1, twist))
    basis = join_fields(bases, circles)
    return basis, np.concatenate(sizes) * rng.uniform(-1.0, 1.0, len(basis))


def _material(
    basis: FieldBasis, coefficients: FloatArray
) -> Callable[[Template, FloatArray], FloatArray]:
    def material(template: Template, directions: FloatArray) -> FloatArray:
        return flow(basis, template, directions, coefficients, steps=24)

    return material


def indices(values: FloatArray) -> IntArray:
    return np.asarray(values, dtype=np.int64)
