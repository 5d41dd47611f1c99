"""Whole-heart label maps of a population: one implicit heart, warped, with the noise of a network.

Numbers are those of TotalSegmentator's ``heartchambers_highres``, with pulmonary veins (8) and the
venae cavae (9, 10). In the frame of the heart z leads from the apex to the base.
"""

import nibabel
import numpy as np
from scipy import ndimage
from scipy.spatial.transform import Rotation

from tests.oracles.label_volumes import voxel_centers

LABELS = {
    "MYO": 1,
    "LA": 2,
    "LV": 3,
    "RA": 4,
    "RV": 5,
    "AO": 6,
    "PA": 7,
    "PV": 8,
    "SVC": 9,
    "IVC": 10,
}
LOW, HIGH = np.array([-50.0, -52.0, -90.0]), np.array([90.0, 52.0, 62.0])
VEINS = {
    "RSPV": (-0.45, -0.85, 0.45),
    "RIPV": (-0.85, -0.55, -0.15),
    "LSPV": (-0.45, 0.85, 0.45),
    "LIPV": (-0.85, 0.55, -0.15),
}


def _inside(points, center, semi_axes):
    return (((points - center) / semi_axes) ** 2).sum(axis=1) < 1.0


def _tube(points, start, direction, radius, length):
    way = np.asarray(direction) / np.linalg.norm(direction)
    along = (points - start) @ way
    across = np.linalg.norm(points - start - along[:, None] * way, axis=1)
    return (across < radius) & (along > 0.0) & (along < length)


def heart_labels(points):
    """Return the label (n,) of points (n, 3) in mm, in the frame of the heart."""
    z = points[:, 2]
    cavity = _inside(points, (0.0, 0.0, -30.0), (25.0, 25.0, 50.0))
    atrium = _inside(points, (-10.0, 0.0, 18.0), (24.0, 28.0, 24.0)) & (z >= 0.0)
    masks = {
        "IVC": _tube(points, (52.0, 16.0, 18.0), (0.3, 0.8, -0.25), 9.0, 40.0),
        "SVC": _tube(points, (52.0, 14.0, 18.0), (0.15, 0.2, 1.0), 8.0, 42.0),
        "PV": np.logical_or.reduce(
            [_tube(points, (-10.0, 0.0, 20.0), way, 6.0, 44.0) for way in VEINS.values()]
        ),
        "RV": _inside(points, (44.0, 0.0, -26.0), (28.0, 30.0, 42.0)) & (z < 0.0),
        "RA": _inside(points, (54.0, 13.0, 18.0), (22.0, 22.0, 22.0)) & (z >= 0.0),
        "MYO": _inside(points, (0.0, 0.0, -30.0), (34.0, 34.0, 59.0)) & (z < 1.0),
        "PA": _tube(points, (42.0, -19.0, 0.0), (-0.1, -0.05, 1.0), 9.5, 50.0),
        "LA": atrium,
        "AO": _tube(points, (13.0, 0.0, 0.0), (0.1, 0.0, 1.0), 10.5, 55.0),
        "LV": cavity & (z < 0.0),
    }
    label = np.zeros(len(points), dtype=np.int16)
    for name, mask in masks.items():
        label[mask] = LABELS[name]
    return label


def warp(seed, amplitude=5.0):
    """Return a smooth map of space: of a subject's points to those of the heart above."""
    rng = np.random.default_rng(seed)
    scales = 1.0 + 0.016 * amplitude * rng.uniform(-1.0, 1.0, 3)
    waves = rng.normal(size=(4, 3)) * (2.0 * np.pi / 160.0)
    ways = rng.normal(size=(4, 3)) * amplitude / 4.0
    phases = rng.uniform(0.0, 2.0 * np.pi, 4)

    def mapped(points):
        return points * scales + np.sin(points @ waves.T + phases) @ ways

    return mapped


def heart_map(seed, spacing, noise=True, turn=True, amplitude=5.0):
    """Return the labels (I, J, K) of one subject and the affine to mm in LPS."""
    rng = np.random.default_rng(1000 + seed)
    spacing = np.asarray(spacing, float)
    axes = Rotation.from_rotvec(rng.normal(size=3) * 0.15).as_matrix() if turn else np.eye(3)
    middle = 0.5 * (LOW + HIGH)
    extent = np.abs(axes.T) @ (HIGH - LOW)
    size = tuple(np.ceil(extent / spacing).astype(int).tolist())
    affine = np.eye(4)
    affine[:3, :3] = axes * spacing
    affine[:3, 3] = middle - affine[:3, :3] @ ((np.array(size) - 1) / 2)
    mapped = warp(seed, amplitude)
    points = voxel_centers(size, affine)
    labels = heart_labels(mapped(points)).reshape(size)
    return (with_noise(labels, spacing, rng) if noise else labels), affine


def with_noise(labels, spacing, rng):
    """Return labels with jitter of the borders, islands, holes and leaks of a few mm."""
    size = labels.shape
    shift = np.stack([ndimage.gaussian_filter(rng.normal(size=size), 1.5) for _ in range(3)])
    shift *= 0.9 / shift.std() / np.reshape(spacing, (3, 1, 1, 1))
    noisy = ndimage.map_coordinates(labels, np.indices(size) + shift, order=0, mode="nearest")
    for name in ("LV", "LA", "AO", "RV"):
        value = LABELS[name]
        for place in _some(noisy == 0, 2, rng):
            _ball(noisy, place, 2.2, spacing, value)  # an island
        for place in _some(noisy == value, 1, rng):
            _ball(noisy, place, 2.0, spacing, 0)  # a hole
        border = (noisy == value) & ndimage.binary_dilation(noisy == 0)
        for place in _some(border, 1, rng):
            _ball(noisy, place, 3.5, spacing, value)  # a leak
    return noisy


def _some(mask, count, rng):
    places = np.argwhere(mask)
    return places[rng.integers(0, len(places), count)]


def _ball(labels, center, radius, spacing, value):
    index = np.moveaxis(np.indices(labels.shape), 0, -1)
    labels[(((index - center) * spacing) ** 2).sum(axis=-1) <= radius**2] = value


def saved_map(path, labels, affine):
    """Write labels as NIfTI."""
    path.parent.mkdir(parents=True, exist_ok=True)
    in_ras = np.diag([-1.0, -1.0, 1.0, 1.0]) @ affine
    nibabel.save(nibabel.Nifti1Image(labels.astype(np.uint8), in_ras), path)
