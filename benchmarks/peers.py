"""Simple alternatives that a user might pick, from the template points of one shape.

Both register every shape to the medoid by itself: first a similarity transform by iterated
closest points (Besl and McKay 1992, to the surface), then either nothing more or coherent point
drift (Myronenko and Song 2010) by the package pycpd. The points are then moved to the closest
point of the surface, so that they are judged like points that lie on it.
"""

from collections.abc import Iterable

import numpy as np

from benchmarks.cases import Case
from ostiform.arrays import FloatArray
from ostiform.correspondence import SharedMetric, sample
from ostiform.correspondence.alignment import align, align_to
from ostiform.domain import Template
from ostiform.evaluation import OriginalMesh
from ostiform.surface import SurfaceTree, closest_points, surface_tree

NEAREST = "nearest point after ICP"
DRIFT = "coherent point drift"
PEERS = (NEAREST, DRIFT)

ICP_ROUNDS = 60
ICP_TOLERANCE = 1e-4
"""Of the size of the shape: a smaller step ends the iteration."""

CPD_ALPHA, CPD_BETA = 10.0, 2.0
"""Weight and width of the smoothness, for coordinates of unit variance: the best of ten tried."""

CPD_ROUNDS = 100
CPD_TARGETS = 1500
"""Vertices of a surface that the template points drift to; of more, so many are drawn."""


def medoid_shape(case: Case, shared: SharedMetric, among: Iterable[int]) -> int:
    """Return the shape nearest to the mean of some shapes in their conformal sampling."""
    chosen = list(among)
    template = shared.template
    points = np.stack([sample(case.samplers[i], template, template.points) for i in chosen])
    aligned = align(points, shared.weights, "rigid", shared.groups[chosen]).aligned
    squared = ((aligned - aligned.mean(axis=0)) ** 2).sum(axis=2) @ shared.weights
    return chosen[int(squared.argmin())]


def registered(method: str, case: Case, template: Template, start: int) -> FloatArray:
    """Return the template points (N, P, 3) on all shapes, in mm in their input coordinates."""
    source = sample(case.samplers[start], template, template.points)
    in_pose = _moved(source, case.poses[start])
    found = np.empty((len(case.ids), *source.shape))
    for index, pose in enumerate(case.poses):
        original = case.original(index)
        target = OriginalMesh(_moved(original.vertices, pose), original.faces)
        tree = surface_tree(target.vertices, target.faces)
        moved = _by_closest_points(in_pose, tree)
        if method == DRIFT:
            moved = _by_drift(moved, target.vertices)
        on_surface = closest_points(tree, moved).points
        found[index] = _moved(on_surface, np.linalg.inv(pose))
    found[start] = source
    return found


def _by_closest_points(source: FloatArray, tree: SurfaceTree) -> FloatArray:
    weights = np.full(len(source), 1.0 / len(source))
    size = np.sqrt(((source - source.mean(axis=0)) ** 2).sum(axis=1).mean())
    moved = source
    for _ in range(ICP_ROUNDS):
        nearest = closest_points(tree, moved).points
        transform = align_to(source[None], nearest, weights, "similarity")
        before, moved = moved, _moved(source, transform)
        if np.abs(moved - before).max() < ICP_TOLERANCE * size:
            break
    return moved


def _by_drift(source: FloatArray, target: FloatArray) -> FloatArray:
    from pycpd import DeformableRegistration  # only where it is asked for

    if len(target) > CPD_TARGETS:
        target = np.random.default_rng(0).choice(target, CPD_TARGETS, replace=False)
    centre, scale = target.mean(axis=0), target.std()
    drift = DeformableRegistration(
        X=(target - centre) / scale,
        Y=(source - centre) / scale,
        alpha=CPD_ALPHA,
        beta=CPD_BETA,
        max_iterations=CPD_ROUNDS,
        tolerance=1e-5,
    )
    moved, _ = drift.register()
    return moved * scale + centre


def _moved(points: FloatArray, transform: FloatArray) -> FloatArray:
    return points @ transform[:3, :3].T + transform[:3, 3]
