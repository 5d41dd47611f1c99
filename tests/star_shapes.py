"""Star-shaped surfaces r(u) u with circular openings, whose embedding is u itself."""

from collections.abc import Callable

import numpy as np

from ostiform.domain import BaseDomain, Circle, Sphere
from ostiform.domain.delaunay import graded_points, sizing_field
from ostiform.domain.template import face_parts
from ostiform.embedding import Certificate, Distortion, Embedding, placed_curves
from ostiform.surface import Component, Seam, sphere_locator


def unit(azimuth, elevation):
    return np.array(
        [
            np.cos(azimuth) * np.cos(elevation),
            np.sin(azimuth) * np.cos(elevation),
            np.sin(elevation),
        ]
    )


def heart_domain(vein_degrees=4.0):
    vein, aortic = np.radians(vein_degrees), np.radians(10.0)
    rims = {
        "LV.aortic": Circle(unit(0.3, -0.6), aortic),
        "LA.RSPV": Circle(unit(0.2, 0.9), vein),
        "LA.RIPV": Circle(unit(1.0, 0.6), vein),
        "LA.LSPV": Circle(unit(3.3, 0.9), vein),
        "LA.LIPV": Circle(unit(4.0, 0.6), vein),
    }
    seams = {Seam("LV.mitral", "LA.mitral"): Circle(unit(0.0, np.pi / 2), np.pi / 2)}
    return BaseDomain((Sphere("LV+LA", ("LV", "LA"), rims, seams, "LV.mitral"),))


def cup_domain():
    return BaseDomain(
        (Sphere("LV", ("LV",), {"LV.mitral": Circle(unit(0.0, np.pi / 2), 0.4)}, {}, "LV.mitral"),)
    )


def closed_domain():
    return BaseDomain((Sphere("X", ("X",), {}, {}, None),))


def two_sphere_domain():
    return BaseDomain((*cup_domain().spheres, *closed_domain().spheres))


def wavy(amplitude, phase=0.0) -> Callable:
    def radius(u):
        return 30.0 * (
            1.0
            + amplitude * (u[:, 0] * u[:, 1] + 0.5 * np.sin(3.0 * u[:, 2] + phase) + 0.3 * u[:, 0])
        )

    return radius


def star_embedding(sphere: Sphere, radius: Callable, n_vertices=3000, seed=1) -> Embedding:
    circles = list(sphere.curves.values())
    is_rim = [name in sphere.rims for name in sphere.curves]
    field, counts = sizing_field(circles, is_rim, [None] * len(circles), n_vertices, None, 24)
    mesh = graded_points(circles, is_rim, counts, n_vertices, field, 3, seed)
    u = mesh.points
    loops = {}
    for index, (name, circle) in enumerate(sphere.curves.items()):
        on = np.flatnonzero(mesh.curve == index)
        order = np.argsort(circle.angles(u[on]))
        loops[name] = on[order] if name not in sphere.rims else on[order][::-1]
    component = Component(
        name=sphere.name,
        parts=sphere.parts,
        vertices=radius(u)[:, None] * u,
        faces=mesh.faces,
        face_part=face_parts(sphere, u, mesh.faces),
        rims={name: loops[name] for name in sphere.rims},
        seams={seam: loops[seam.first] for seam in sphere.seams},
    )
    return Embedding(
        component=component,
        locator=sphere_locator(u, component.faces),
        curves=placed_curves(component, sphere, u),
        certificate=Certificate(0, 0, 0.0, 0.0, tuple(sphere.rims), {}, ()),
        distortion=Distortion(1.0, 1.0, 1.0, 1.0, 1.0, {}, {}),
        states=(),
        method="barrier",
        seconds=0.0,
    )
