"""Area-weighted principal component analysis (HY 2.3)."""

from dataclasses import replace

import numpy as np
from scipy.linalg import svd

from ostiform.arrays import FloatArray, frozen_floats
from ostiform.correspondence import streamed_spectrum
from ostiform.domain import Template
from ostiform.errors import InputError
from ostiform.model.algebra import check_weights, principal_modes, signed, weighted_size
from ostiform.model.corresponded import CorrespondedShapes
from ostiform.model.mesh import ModelMesh
from ostiform.model.types import ShapeModel, StoredModel

LARGEST_EXACT = 2000
"""Modes beyond which only the leading ones are computed."""

LEAST_SHARE = 1e-4
"""Of the total variance, that these have at least."""

CHUNK = 256


def fit_model(aligned: FloatArray, weights: FloatArray, mesh: ModelMesh) -> ShapeModel:
    """Return the weighted principal component analysis of shapes in correspondence.

    With ``Y = (X - mean) W^(1/2)`` the modes are ``Phi = W^(-1/2) U``, U the right singular
    vectors of Y, and the variances the eigenvalues of ``Y^T Y / (N - 1)`` (design 6; HY 2.3).

    Parameters
    ----------
    aligned : (N, P, 3) float64, mm
        N >= 2 aligned shapes.
    weights : (P,) float64
        Area share of each point, positive, sum 1.
    mesh : ModelMesh

    Returns
    -------
    ShapeModel
        At most N - 1 modes, those above rounding; no residual variance. Where both N - 1 and 3 P
        exceed 2,000, only the modes with at least 1e-4 of the total variance, the rest as
        residual variance: all modes would take hours and gigabytes.

    Raises
    ------
    InputError
        If there are fewer than two shapes, or the arrays do not fit each other.
    """
    shapes = frozen_floats(aligned, (None, len(mesh.part), 3), "aligned shapes")
    if len(shapes) < 2:
        raise InputError(f"a shape model: expected at least 2 shapes, found {len(shapes)}")
    mean = shapes.mean(axis=0)
    if min(len(shapes) - 1, mean.size) > LARGEST_EXACT:
        return _leading_model(shapes, weights, mesh)
    deviations = (shapes - mean) / np.sqrt(len(shapes) - 1.0)  # (N, P, 3)
    modes, variances = principal_modes(deviations, weights, weighted_size(mean, weights))
    return ShapeModel(
        mean=mean,
        modes=modes,
        variances=variances,
        weights=weights,
        mesh=mesh,
        residual_variance=0.0,
        sample_count=len(shapes),
    )


def analysed(shapes: CorrespondedShapes, template: Template | None = None) -> StoredModel:
    """Return the model of shapes in correspondence with their scores.

    Parameters
    ----------
    shapes : CorrespondedShapes
    template : Template, optional
        Where the correspondence is this program's.
    """
    model = fit_model(shapes.aligned, shapes.weights, shapes.mesh)
    return StoredModel(model, model.project(shapes.aligned), shapes.ids, template)


def _leading_model(shapes: FloatArray, weights: FloatArray, mesh: ModelMesh) -> ShapeModel:
    """Return the model of very many shapes, by `streamed_spectrum`."""
    given = frozen_floats(weights, (shapes.shape[1],), "weights")
    check_weights(given)
    mean = shapes.mean(axis=0)
    squared = sum(float((((shape - mean) ** 2).sum(axis=1) * given).sum()) for shape in shapes)
    total = squared / (len(shapes) - 1.0)
    found = streamed_spectrum(
        lambda: (shapes[first : first + CHUNK] for first in range(0, len(shapes), CHUNK)),
        given,
        LEAST_SHARE * total,
        np.random.default_rng(0),
    )
    modes = found.modes.reshape(-1, *mean.shape) / np.sqrt(given)[:, None]  # (K, P, 3)
    return ShapeModel(
        mean=mean,
        modes=signed(modes),
        variances=found.eigenvalues,
        weights=weights,
        mesh=mesh,
        residual_variance=found.rest,
        sample_count=len(shapes),
    )


def model_in_span(model: ShapeModel, rows: FloatArray, sample_count: int) -> ShapeModel:
    """Return the model of the covariance ``rows^T rows`` inside the span of a model's modes.

    Parameters
    ----------
    model : ShapeModel
        Gives the mean, the mesh and the point weights.
    rows : (R, K) float64, mm
        Deviations in the model's scores, scaled so that the covariance is the plain sum over them.
    sample_count : int
    """
    singular, directions = np.empty(0), np.empty((0, len(model.modes)))
    if rows.size:
        _, singular, directions = svd(rows, full_matrices=False)
        size = weighted_size(model.mean, model.weights)
        kept = singular > max(rows.shape) * np.finfo(np.float64).eps * max(singular[0], size)
        singular, directions = singular[kept], directions[kept]
    return replace(
        model,
        modes=signed(np.tensordot(directions, model.modes, axes=1)),
        variances=singular**2,
        residual_variance=0.0,
        sample_count=sample_count,
    )
