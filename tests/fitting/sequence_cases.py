"""Beating ellipsoids seen in slices, every slice shifted in its plane."""

import numpy as np

from ostiform.fitting import PhaseTarget, SliceContours
from ostiform.fitting.linear import State, placed_points
from ostiform.fitting.types import IDENTITY


def drawn_cycle(prior, rng, times):
    """Return a cycle (T, P, 3) of the prior, its smooth field included."""
    root = np.linalg.cholesky(np.linalg.inv(prior.precision))
    modes = prior.mean + (root @ rng.normal(size=len(root))).reshape(prior.mean.shape)
    n_field = 3 * prior.space.field.shape[1]
    deviations = np.sqrt(prior.field_variances)[:, None]
    field = deviations * rng.normal(size=(len(deviations), n_field))
    shapes = []
    for phi in prior.design(times):
        state = State(IDENTITY, np.concatenate([phi @ modes, phi[: len(field)] @ field]))
        shapes.append(placed_points(prior.space, state)[: len(prior.space.model.mean)])
    return np.stack(shapes)


def section(points, faces, normal, height):
    """Return where a plane cuts the edges of a surface, in order round their middle (n, 3)."""
    values = points @ normal - height
    edges = np.unique(
        np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], 2).reshape(-1, 2)), axis=0
    )
    low, high = values[edges].T
    crossing = low * high < 0.0
    share = (low / (low - high))[crossing, None]
    a, b = edges[crossing].T
    found = points[a] + share * (points[b] - points[a])
    if len(found) < 3:
        return np.zeros((0, 3))
    first = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    offset = found - found.mean(axis=0)
    order = np.argsort(np.arctan2(offset @ np.cross(normal, first), offset @ first))
    return found[np.append(order, order[0])]


def sliced_phases(prior, shapes, times, rng, slices=8, noise=0.4, shift=2.0, long_axes=True):
    """Return phases of curves in a stack of slices and along the axis, and the true shifts."""
    faces = prior.space.model.mesh.faces
    low, high = shapes[..., 2].min(), shapes[..., 2].max()
    heights = low + (np.arange(slices) + 0.5) * (high - low) / slices
    planes = {f"sa {k + 1}": (np.array([0.0, 0.0, 1.0]), z) for k, z in enumerate(heights)}
    if long_axes:
        planes |= {
            "la 1": (np.array([1.0, 0.0, 0.0]), 0.0),
            "la 2": (np.array([0.0, 1.0, 0.0]), 0.0),
        }
    shifts = {}
    for name, (normal, _) in planes.items():
        move = rng.normal(scale=shift, size=3)
        shifts[name] = move - (move @ normal) * normal
    phases = []
    for number, (time, shape) in enumerate(zip(times, shapes, strict=True)):
        items = []
        for name, (normal, height) in planes.items():
            curve = section(shape, faces, normal, height)
            if len(curve) < 6:
                continue
            wobble = rng.normal(scale=noise, size=curve.shape)
            wobble -= np.outer(wobble @ normal, normal)
            items.append(SliceContours(name, (curve + wobble + shifts[name],)))
        phases.append(PhaseTarget(float(time), tuple(items), f"{number:02d}"))
    return phases, shifts
