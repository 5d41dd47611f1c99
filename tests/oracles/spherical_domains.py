"""Components whose map to the sphere is known: domains of circles on the sphere, and a tube."""

import numpy as np
from scipy.spatial import ConvexHull

from ostiform.domain import Circle, Sphere
from ostiform.surface import Component, Seam, spherical_fibonacci

SEAM = Seam("LV.mitral", "LA.mitral")


def direction(polar_degrees, azimuth_degrees):
    polar, azimuth = np.radians([polar_degrees, azimuth_degrees])
    return np.array(
        [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)]
    )


def circle(polar_degrees, azimuth_degrees, radius_degrees):
    return Circle(direction(polar_degrees, azimuth_degrees), np.radians(radius_degrees))


def domain_of_circles(rims, seam=None, count=1500, pole=None):
    """Delaunay mesh of the unit sphere without the inside of circles; the identity embeds it.

    The mesh is the convex hull of a Fibonacci lattice and points on every circle; a circle is
    planar, so the hull contains its polygon, which is removed. Returns the component (vertices in
    mm = unit vectors), its sphere and the directions of the identity.
    """
    spacing = np.sqrt(8.0 * np.pi / np.sqrt(3.0) / count)
    points = spherical_fibonacci(count)
    curves = {**rims, **({} if seam is None else {SEAM.first: seam})}
    for name, border in curves.items():
        polar = np.arccos(np.clip(points @ border.center, -1.0, 1.0))
        keep = np.abs(polar - border.radius) > 0.6 * spacing
        if name in rims:
            keep &= polar > border.radius
        points = points[keep]
    blocks, loops = [points], {}
    total = len(points)
    for name, border in curves.items():
        n = max(8, int(np.ceil(2.0 * np.pi * np.sin(border.radius) / spacing)))
        sign = -1.0 if name in rims else 1.0
        blocks.append(border.points(border.phase + sign * 2.0 * np.pi * np.arange(n) / n))
        loops[name] = total + np.arange(n)
        total += n
    vertices = np.concatenate(blocks)
    faces = ConvexHull(vertices).simplices.astype(np.int64)
    corners = vertices[faces]
    inward = np.einsum("fa,fa->f", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) < 0.0
    faces[inward] = faces[inward][:, ::-1]
    for name in rims:
        faces = faces[~np.isin(faces, loops[name]).all(axis=1)]
    middle = vertices[faces].mean(axis=1)
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    parts = tuple(dict.fromkeys(name.split(".")[0] for name in rims)) or ("A",)
    face_part = np.zeros(len(faces), dtype=np.int64)
    seams, seam_loops = {}, {}
    if seam is not None:
        parts = (SEAM.first.split(".")[0], SEAM.second.split(".")[0])
        face_part = (np.arccos(middle @ seam.center) < seam.radius).astype(np.int64)
        seams, seam_loops = {SEAM: seam}, {SEAM: loops[SEAM.first]}
    component = Component(
        "+".join(parts),
        parts,
        vertices,
        faces,
        face_part,
        {name: loops[name] for name in rims},
        seam_loops,
    )
    sphere = Sphere(component.name, parts, rims, seams, pole)
    return component, sphere, component.vertices


def left_atrium(count=1500):
    """One part with a wide opening round the north pole and three narrow ones."""
    rims = {
        "A.mitral": circle(0, 0, 30),
        "A.a": circle(120, 0, 6),
        "A.b": circle(110, 110, 6),
        "A.c": circle(130, 230, 6),
    }
    return domain_of_circles(rims, count=count, pole="A.mitral")


def left_heart(count=2500):
    """Two parts joined at the equator, with two openings north of it and one south."""
    rims = {
        "LV.aortic": circle(125, 0, 12),
        "LA.a": circle(45, 20, 5),
        "LA.b": circle(40, 200, 5),
    }
    return domain_of_circles(rims, seam=circle(0, 0, 90), count=count, pole="LV.mitral")


def tube(length, radius, ring, end, edges_around=48):
    """A cylinder whose wide ring and narrow end go to circles about the south pole.

    The ring (angular radius `ring`) encloses the domain, the end (`end`) is its hole; both small,
    so that the sphere is nearly flat there. The phases map the tube's generators to straight
    lines: its azimuth a goes to -a. Returns component and sphere.
    """
    rows = max(4, int(np.ceil(length / (2.0 * np.pi * radius / edges_around)))) + 1
    angles = 2.0 * np.pi * np.arange(edges_around) / edges_around
    shifted = angles[None, :] + np.pi / edges_around * np.arange(rows)[:, None]
    heights = np.linspace(0.0, length, rows)[:, None] + 0.0 * shifted
    vertices = np.stack(
        [radius * np.cos(shifted), radius * np.sin(shifted), heights], axis=2
    ).reshape(-1, 3)
    index = np.arange(rows * edges_around).reshape(rows, edges_around)
    low, high = index[:-1], index[1:]
    faces = np.concatenate(
        [
            np.stack([low, np.roll(low, -1, 1), high], axis=2).reshape(-1, 3),
            np.stack([np.roll(low, -1, 1), np.roll(high, -1, 1), high], axis=2).reshape(-1, 3),
        ]
    )
    rims = {"T.ring": index[0], "T.end": index[-1][::-1]}
    component = Component("T", ("T",), vertices, faces, np.zeros(len(faces), np.int64), rims, {})
    circles = {
        "T.ring": Circle(np.array([0.0, 0.0, 1.0]), np.pi - ring),
        "T.end": Circle(np.array([0.0, 0.0, -1.0]), end, float(shifted[-1, -1])),
    }
    return component, Sphere("T", ("T",), circles, {}, "T.ring")
