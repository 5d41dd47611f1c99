"""Unit spheres with circular holes, and their halves: surfaces whose topology is known."""

import numpy as np
from scipy.spatial import ConvexHull


def circle(center, radius, count, start=0.0):
    """Points (count, 3) on a circle of the unit sphere, counter-clockwise seen from outside."""
    center = np.asarray(center, float) / np.linalg.norm(center)
    helper = np.array([1.0, 0.0, 0.0]) if abs(center[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    e1 = np.cross(center, helper)
    e1 /= np.linalg.norm(e1)
    e2 = np.cross(center, e1)
    angle = start + 2.0 * np.pi * np.arange(count)[:, None] / count
    return np.cos(radius) * center + np.sin(radius) * (np.cos(angle) * e1 + np.sin(angle) * e2)


def sphere_with_circles(n_points, circles):
    """Convex hull of Fibonacci points and circles given as (center, radius, count).

    A circle is planar, so it is a facet of the hull (Qhull triangulates it): every circle is a
    cycle of edges. Returns vertices (V, 3), faces (F, 3) counter-clockwise seen from outside, and
    the vertex indices of each circle.
    """
    k = np.arange(n_points) + 0.5
    z = 1.0 - 2.0 * k / n_points
    turn = np.pi * (1.0 + np.sqrt(5.0)) * k
    points = np.c_[np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z]
    spacing = np.sqrt(4.0 * np.pi / n_points)
    loops = []
    for center, radius, count in circles:
        center = np.asarray(center, float) / np.linalg.norm(center)
        angle = np.arccos(np.clip(points @ center, -1, 1))
        points = points[np.abs(angle - radius) > 0.6 * spacing]
        loops.append(circle(center, radius, count))
    first = len(points) + np.cumsum([0] + [len(loop) for loop in loops])
    vertices = np.vstack([points, *loops])
    faces = ConvexHull(vertices).simplices.astype(np.int64)
    is_inward = np.linalg.det(vertices[faces]) < 0
    faces[is_inward] = faces[is_inward][:, [0, 2, 1]]
    return vertices, faces, [np.arange(a, b) for a, b in zip(first[:-1], first[1:], strict=True)]


def holed_sphere(n_points, holes, curves=()):
    """The sphere without the inside of the holes; `curves` are circles that stay inside it."""
    vertices, faces, _ = sphere_with_circles(n_points, [*holes, *curves])
    centroids = vertices[faces].mean(axis=1)
    centroids /= np.linalg.norm(centroids, axis=1, keepdims=True)
    outside = np.ones(len(faces), bool)
    for center, radius, _ in holes:
        center = np.asarray(center, float) / np.linalg.norm(center)
        outside &= np.arccos(np.clip(centroids @ center, -1, 1)) > radius
    return _compact(vertices, faces[outside])


def half_sphere(n_points, count, side, holes=()):
    """The half with z of the given sign, open at an equator of `count` edges; further holes."""
    vertices, faces = holed_sphere(n_points, holes, [((0.0, 0.0, 1.0), np.pi / 2, count)])
    keep = vertices[faces].mean(axis=1)[:, 2] * side > 0
    return _compact(vertices, faces[keep])


def torus(n_major, n_minor, radius=3.0, tube=1.0):
    """A closed torus (genus 1), vertices (V, 3) and faces (F, 3) counter-clockwise from outside."""
    u, v = np.meshgrid(np.arange(n_major), np.arange(n_minor), indexing="ij")
    a, b = 2 * np.pi * u.ravel() / n_major, 2 * np.pi * v.ravel() / n_minor
    ring = radius + tube * np.cos(b)
    vertices = np.c_[ring * np.cos(a), ring * np.sin(a), tube * np.sin(b)]

    def at(i, j):
        return ((i % n_major) * n_minor + j % n_minor).ravel()

    quads = at(u, v), at(u + 1, v), at(u + 1, v + 1), at(u, v + 1)
    faces = np.vstack([np.c_[quads[0], quads[1], quads[2]], np.c_[quads[0], quads[2], quads[3]]])
    return vertices, faces.astype(np.int64)


def _compact(vertices, faces):
    kept, index = np.unique(faces, return_inverse=True)
    return vertices[kept], index.reshape(-1, 3).astype(np.int64)
