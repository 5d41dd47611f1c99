"""Area-weighted principal component analysis (HY 2.3) and the algebra of its models.

A model is a Gaussian distribution: projecting, sampling, truncating, restricting and conditioning
return points, scores or another model of the same kind, and change nothing.
"""

import numpy as np
from scipy.linalg import cho_factor, cho_solve, eigh, svd
from scipy.special import ndtr, ndtri

from ostiform.arrays import FloatArray, IntArray, frozen_floats, frozen_ints
from ostiform.correspondence import streamed_spectrum
from ostiform.errors import InputError
from ostiform.model.types import ModelMesh, ShapeModel, check_weights

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
        modes=_signed(modes),
        variances=found.eigenvalues,
        weights=weights,
        mesh=mesh,
        residual_variance=found.rest,
        sample_count=len(shapes),
    )


def principal_modes(
    deviations: FloatArray, weights: FloatArray, shape_length: float
) -> tuple[FloatArray, FloatArray]:
    """Return the modes and variances of the covariance ``sum_r d_r d_r^T``.

    Parameters
    ----------
    deviations : (R, P, 3) float64, mm
        Deviations from the mean, scaled so that the covariance is the plain sum over them.
    weights : (P,) float64
        Positive, sum 1.
    shape_length : float, mm
        Size of the shapes: directions whose standard deviation is below its rounding are dropped.

    Returns
    -------
    modes : (K, P, 3) float64
        Orthonormal under the weights; the sign is chosen so that the component of largest
        magnitude is positive.
    variances : (K,) float64, mm^2 per point
        Largest first.
    """
    given = frozen_floats(weights, (deviations.shape[1],), "weights")
    check_weights(given)
    roots = np.sqrt(given)[:, None]  # (P, 1)
    scaled = (deviations * roots).reshape(len(deviations), -1)  # (R, 3P)
    if not len(scaled):
        return np.empty((0, *deviations.shape[1:])), np.empty(0)
    _, singular, right = svd(scaled, full_matrices=False)
    rounding = max(scaled.shape) * np.finfo(np.float64).eps * max(singular[0], shape_length)
    kept = singular > rounding
    modes = right[kept].reshape(-1, *deviations.shape[1:]) / roots  # (K, P, 3)
    return _signed(modes), singular[kept] ** 2


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
    return ShapeModel(
        mean=model.mean,
        modes=_signed(np.tensordot(directions, model.modes, axes=1)),
        variances=singular**2,
        weights=model.weights,
        mesh=model.mesh,
        residual_variance=0.0,
        sample_count=sample_count,
    )


def weighted_size(shape: FloatArray, weights: FloatArray) -> float:
    """Return the weighted RMS distance of the points (P, 3) of a shape from their centroid, mm."""
    offsets = shape - weights @ shape  # (P, 3)
    return float(np.sqrt(weights @ (offsets**2).sum(axis=1)))


def project(model: ShapeModel, shapes: FloatArray) -> FloatArray:
    """Return the scores (..., K) in mm of shapes (..., P, 3) given in the model's frame.

    The projection is orthogonal under the point weights: ``b = Phi^T W (x - mean)``.
    """
    deviations = (np.asarray(shapes) - model.mean) * model.weights[:, None]  # (..., P, 3)
    scores: FloatArray = np.tensordot(deviations, model.modes, axes=([-2, -1], [1, 2]))
    return scores


def reconstruct(model: ShapeModel, scores: FloatArray) -> FloatArray:
    """Return the shapes (..., P, 3) in mm with given scores (..., M), M <= K; missing are zero.

    Raises
    ------
    InputError
        If there are more scores than modes.
    """
    given = np.asarray(scores, dtype=np.float64)
    if given.shape[-1] > len(model.modes):
        raise InputError(
            f"scores of a shape: expected at most {len(model.modes)}, one per mode, "
            f"found {given.shape[-1]}"
        )
    shapes: FloatArray = model.mean + np.tensordot(given, model.modes[: given.shape[-1]], axes=1)
    return shapes


def sample_scores(
    model: ShapeModel, count: int, rng: np.random.Generator, limit: float = np.inf
) -> FloatArray:
    """Return random scores (count, K) in mm, ``b_k ~ N(0, l_k)`` truncated at `limit` sd.

    The truncated normal is drawn by inverting its distribution function.
    """
    below = ndtr(-limit)
    uniform = rng.uniform(size=(count, len(model.modes)))
    standard = ndtri(below + uniform * (1.0 - 2.0 * below))  # (count, K)
    scores: FloatArray = standard * np.sqrt(model.variances)
    return scores


def sample_shapes(
    model: ShapeModel, count: int, rng: np.random.Generator, limit: float = np.inf
) -> FloatArray:
    """Return random shapes (count, P, 3) in mm; the residual variance is not added as noise."""
    return reconstruct(model, sample_scores(model, count, rng, limit))


def truncated(model: ShapeModel, n_modes: int) -> ShapeModel:
    """Return the model with its first modes only; what they leave joins the residual variance.

    Raises
    ------
    InputError
        If `n_modes` is negative or more than the model has.
    """
    if not 0 <= n_modes <= len(model.modes):
        raise InputError(
            f"a truncated model: expected from 0 to {len(model.modes)} modes, found {n_modes}"
        )
    return ShapeModel(
        mean=model.mean,
        modes=model.modes[:n_modes],
        variances=model.variances[:n_modes],
        weights=model.weights,
        mesh=model.mesh,
        residual_variance=model.residual_variance + float(model.variances[n_modes:].sum()),
        sample_count=model.sample_count,
    )


def marginal(model: ShapeModel, points: IntArray) -> ShapeModel:
    """Return the distribution of some of a model's points, whatever the others do.

    Triangles and openings are kept where all their points are; the weights are rescaled to sum 1
    and the modes made orthonormal under them. The residual variance stays as it is: it is the
    same noise at every point.

    Parameters
    ----------
    model : ShapeModel
    points : (Q,) int64
        Distinct point indices, in the order that the new model shall have.

    Raises
    ------
    InputError
        If a point is unknown or given twice, or none is given.
    """
    chosen = _checked_points(model, points)
    place = _places(len(model.mean), chosen)
    inside = (place[model.mesh.faces] >= 0).all(axis=1)  # (F,)
    mesh = ModelMesh(
        faces=place[model.mesh.faces[inside]],
        face_part=model.mesh.face_part[inside],
        part=model.mesh.part[chosen],
        parts=model.mesh.parts,
        loops={
            name: place[loop] for name, loop in model.mesh.loops.items() if (place[loop] >= 0).all()
        },
    )
    return _restricted(model, chosen, mesh)


def part_marginal(model: ShapeModel, part: str) -> ShapeModel:
    """Return the distribution of one part, the seam points that it shares included.

    Raises
    ------
    InputError
        If the model has no such part.
    """
    if part not in model.mesh.parts:
        raise InputError(
            f"part of a model: expected one of {', '.join(model.mesh.parts)}, found {part}"
        )
    inside = model.mesh.face_part == model.mesh.parts.index(part)
    chosen = np.unique(model.mesh.faces[inside])
    place = _places(len(model.mean), chosen)
    mesh = ModelMesh(
        faces=place[model.mesh.faces[inside]],
        face_part=np.zeros(int(inside.sum()), dtype=np.int64),
        part=np.zeros(len(chosen), dtype=np.int64),
        parts=(part,),
        loops={
            name: place[loop]
            for name, loop in model.mesh.loops.items()
            if name.startswith(f"{part}.")
        },
    )
    return _restricted(model, chosen, mesh)


def posterior(
    model: ShapeModel, points: IntArray, positions: FloatArray, noise_mm: FloatArray | float
) -> ShapeModel:
    """Return the distribution of the whole shape, given noisy positions of some of its points.

    Gaussian conditioning: with ``A`` the rows of ``Phi Lambda^(1/2)`` at the points and R the
    noise, the scores have covariance ``Lambda^(1/2) (I + A^T R^-1 A)^-1 Lambda^(1/2)``; being
    symmetric it is diagonalised inside the span of the modes, so the new modes stay orthonormal
    under the same weights. The model's residual variance counts as noise of the observation.

    Parameters
    ----------
    model : ShapeModel
    points : (Q,) int64
        The points seen; distinct.
    positions : (Q, 3) float64, mm
        Where they were seen, in the model's frame.
    noise_mm : float or (Q,) float64, mm
        Standard deviation of each coordinate of an observation.

    Raises
    ------
    InputError
        If a point is unknown or given twice, or the noise is not positive anywhere.
    """
    chosen = _checked_points(model, points)
    seen = frozen_floats(positions, (len(chosen), 3), "observed positions")
    noise = np.broadcast_to(np.asarray(noise_mm, dtype=np.float64), (len(chosen),))
    variance = noise**2 + model.residual_variance / 3.0  # (Q,) per coordinate
    if not (np.isfinite(variance).all() and (variance > 0.0).all() and (noise >= 0.0).all()):
        raise InputError(
            "noise of observed points: expected positive standard deviations in mm, "
            f"found values from {noise.min():.3g} to {noise.max():.3g}"
        )
    precision = np.repeat(1.0 / variance, 3)  # (3Q,)
    spread = np.sqrt(model.variances)
    design = (model.modes[:, chosen] * spread[:, None, None]).reshape(-1, seen.size)  # (K, 3Q)
    information = np.eye(len(spread)) + (design * precision) @ design.T  # (K, K)
    factor = cho_factor(information, lower=True)
    offset = (seen - model.mean[chosen]).ravel()
    scores = spread * cho_solve(factor, design @ (precision * offset))
    covariance = spread[:, None] * cho_solve(factor, np.diag(spread))
    variances, vectors = eigh(0.5 * (covariance + covariance.T))
    order = np.argsort(variances)[::-1]
    return ShapeModel(
        mean=reconstruct(model, scores),
        modes=np.tensordot(vectors[:, order].T, model.modes, axes=1),
        variances=np.maximum(variances[order], 0.0),
        weights=model.weights,
        mesh=model.mesh,
        residual_variance=model.residual_variance,
        sample_count=model.sample_count,
    )


def _signed(modes: FloatArray) -> FloatArray:
    """Return modes (K, P, 3) with the sign that makes their largest component positive."""
    flat = modes.reshape(len(modes), int(np.prod(modes.shape[1:])))
    largest = np.take_along_axis(flat, np.abs(flat).argmax(axis=1, keepdims=True), axis=1)
    signed: FloatArray = modes * np.sign(largest)[:, :, None]
    return signed


def _restricted(model: ShapeModel, points: IntArray, mesh: ModelMesh) -> ShapeModel:
    weights = model.weights[points] / model.weights[points].sum()
    spread = np.sqrt(model.variances)[:, None, None]
    modes, variances = principal_modes(
        model.modes[:, points] * spread, weights, weighted_size(model.mean[points], weights)
    )
    return ShapeModel(
        mean=model.mean[points],
        modes=modes,
        variances=variances,
        weights=weights,
        mesh=mesh,
        residual_variance=model.residual_variance,
        sample_count=model.sample_count,
    )


def _checked_points(model: ShapeModel, points: IntArray) -> IntArray:
    chosen = frozen_ints(points, (None,), "points of a model")
    count = len(model.mean)
    if not len(chosen) or chosen.min() < 0 or chosen.max() >= count:
        raise InputError(
            f"points of a model: expected indices from 0 to {count - 1}, found "
            + (f"{chosen.min()} to {chosen.max()}" if len(chosen) else "none")
        )
    if len(np.unique(chosen)) < len(chosen):
        values, counts = np.unique(chosen, return_counts=True)
        raise InputError(
            f"points of a model: expected distinct indices, found {values[counts > 1][0]} twice"
        )
    return chosen


def _places(count: int, chosen: IntArray) -> IntArray:
    place = np.full(count, -1, dtype=np.int64)
    place[chosen] = np.arange(len(chosen))
    return place
