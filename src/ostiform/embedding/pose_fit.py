"""Rotations of a map that agree best with the shape in its aligned pose."""

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.surface import vertex_areas


def posed_moments(
    vertices: FloatArray, faces: IntArray, directions: FloatArray, pose: FloatArray
) -> FloatArray:
    """Return ``sum_v w_v y_v x_v^T`` (3, 3), x the map, y the centred position in the pose.

    Parameters
    ----------
    vertices : (V, 3) float64, mm
    faces : (F, 3) int64
    directions : (V, 3) float64
    pose : (4, 4) float64
        Input to aligned coordinates.

    Returns
    -------
    moments : (3, 3) float64
        With the weights w the area shares of the vertices.
    """
    weights = vertex_areas(vertices, faces)
    weights = weights / weights.sum()  # (V,)
    posed = vertices @ pose[:3, :3].T
    posed = posed - weights @ posed
    moments: FloatArray = posed.T @ (weights[:, None] * directions)
    return moments


def best_turn(moments: FloatArray) -> FloatArray:
    """Return the rotation (3, 3) about z that maximises ``sum w y . R x``."""
    angle = np.arctan2(moments[1, 0] - moments[0, 1], moments[0, 0] + moments[1, 1])
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def best_rotation(moments: FloatArray) -> FloatArray:
    """Return the rotation (3, 3) that maximises ``sum w y . R x`` (Kabsch 1976)."""
    left, _, right = np.linalg.svd(moments)
    sign = np.sign(np.linalg.det(left @ right))
    rotation: FloatArray = left @ np.diag([1.0, 1.0, sign]) @ right
    return rotation
