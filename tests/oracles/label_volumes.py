"""Label maps of shapes whose surface is known, sampled at voxel centres in any pose."""

import numpy as np
from scipy.spatial.transform import Rotation


def posed_grid(spacing, extent, rng, turned=True):
    """Return the shape (I, J, K) and affine (4, 4) of a grid about a random centre, and that."""
    spacing = np.asarray(spacing, float)
    axes = Rotation.random(rng=rng).as_matrix() if turned else np.eye(3)
    center = rng.uniform(-30, 30, 3)
    size = np.ceil(extent / spacing).astype(int)
    affine = np.eye(4)
    affine[:3, :3] = axes * spacing
    affine[:3, 3] = center - affine[:3, :3] @ ((size - 1) / 2 + rng.uniform(-0.5, 0.5, 3))
    return tuple(size), affine, center


def voxel_centers(size, affine):
    index = np.stack(np.meshgrid(*map(np.arange, size), indexing="ij"), -1).reshape(-1, 3)
    return index @ affine[:3, :3].T + affine[:3, 3]


def ellipsoid_distance(points, axes):
    """Distance (n,) of points from the surface of an ellipsoid about the origin (bisection)."""
    points, squares = np.abs(points), np.asarray(axes) ** 2
    low, high = np.full(len(points), 1e-9 - squares.min()), np.full(len(points), 1e5)
    for _ in range(100):
        middle = 0.5 * (low + high)
        outside = ((axes * points / (middle[:, None] + squares)) ** 2).sum(axis=1) > 1
        low, high = np.where(outside, middle, low), np.where(outside, high, middle)
    nearest = squares * points / (middle[:, None] + squares)
    return np.linalg.norm(nearest - points, axis=1)
