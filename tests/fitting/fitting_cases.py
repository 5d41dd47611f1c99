"""A model of beating ellipsoids of two parts, and shapes that it has never seen."""

import numpy as np
from scipy.spatial.transform import Rotation

from ostiform.fitting import FitPrior, SurfaceTarget
from ostiform.model import StoredModel, fit_model, mesh_of_template, project
from tests.populations import population, two_part_template


def stored_ellipsoids(subjects=8, phases=4, seed=3):
    shapes = population(
        subjects, phases, np.random.default_rng(seed), two_part_template(rows=15, columns=24)
    )
    model = fit_model(shapes.aligned, shapes.weights, mesh_of_template(shapes.template))
    return StoredModel(model, project(model, shapes.aligned), shapes.ids, shapes.template)


def stored_lopsided():
    """Return the same with two bumps each, which no turn carries to their mirror image."""
    shapes = population(8, 4, np.random.default_rng(3), two_part_template(rows=15, columns=24))
    points = shapes.aligned
    directions = points / np.linalg.norm(points, axis=-1, keepdims=True)
    for place, size in (((0.8, 0.5, 0.33), 0.5), ((-0.5, 0.8, -0.3), 0.35)):
        along = directions @ np.array(place) / np.linalg.norm(place)
        points = points * (1.0 + size * np.exp(4.0 * (along - 1.0)))[..., None]
    model = fit_model(points, shapes.weights, mesh_of_template(shapes.template))
    return StoredModel(model, project(model, points), shapes.ids, shapes.template)


def drawn_shape(prior: FitPrior, rng: np.random.Generator):
    """Return a shape (P, 3) of the prior, its smooth leftover included."""
    modes = prior.modes @ rng.normal(size=prior.modes.shape[2])
    field = prior.field @ rng.normal(size=(prior.field.shape[1], 3))
    return (prior.mean + modes + field)[: len(prior.model.mean)]


def drawn_pose(rng: np.random.Generator, turn_deg: float):
    """Return a rotation by a given angle about a random axis, and a shift."""
    axis = rng.normal(size=3)
    turn = Rotation.from_rotvec(np.radians(turn_deg) * axis / np.linalg.norm(axis)).as_matrix()
    return turn, rng.normal(scale=80.0, size=3)


def surface_of(prior: FitPrior, points, faces=None):
    return SurfaceTarget(points, prior.model.mesh.faces if faces is None else faces, {})


def rms(points, truth):
    return float(np.sqrt(((points - truth) ** 2).sum(axis=1).mean()))
