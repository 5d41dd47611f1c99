"""Fitting a model to data it has never seen: poses, shape, posterior, residues."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from ostiform.arrays import FloatArray
from ostiform.errors import InputError
from ostiform.fitting.data import KINDS, Data, prepared_data, sparser
from ostiform.fitting.linear import State, placed_points
from ostiform.fitting.noise import STUDENT_DOF, independent_share
from ostiform.fitting.observations import model_surface, observations
from ostiform.fitting.posterior import posterior_of
from ostiform.fitting.prior import FitPrior
from ostiform.fitting.residues import measured_residues
from ostiform.fitting.rim_kinds import openings_left, with_openings_matched
from ostiform.fitting.settings import FitSettings
from ostiform.fitting.solver import Rules, Solution, solve
from ostiform.fitting.starts import starting_poses
from ostiform.fitting.target_size import check_landmarks, checked_size
from ostiform.fitting.types import FitStatus, ShapeFit, Target, reflected_target
from ostiform.fitting.typical import typicality

COARSE = Rules(use_field=False, gated=False, stride=8, most_iterations=5)
MIDDLE = Rules(use_field=False, gated=True, stride=2, most_iterations=6)
FINE = Rules(use_field=True, gated=True, stride=1, most_iterations=12)
COARSE_SAMPLES = 300
FINALISTS = 2
"""Poses that are fitted for longer before one is chosen."""

CLEARLY_NEARER = 0.75
"""Another pose or the mirror image must be nearer by this factor to be preferred or told."""

FAR = 0.4
"""Share of the expected distance beyond which another pose is tried: the field leaves less."""

SURFACE_EDGES, SAMPLED_EDGES = 0.25, 1.0
"""Share of the model's edge that data are expected to lie off its surface: for surfaces little,
for points and contours, whose noise is theirs, more."""


def fit_shape(
    prior: FitPrior, targets: Sequence[Target], settings: FitSettings | None = None
) -> ShapeFit:
    """Fit a model to surfaces, points, contours and landmarks of one shape.

    The posterior mean and covariance of shape and pose, given the data: Student-t noise of a scale
    estimated for each kind of data, the modes with their variances, and the leftover field, which
    stands for what new shapes have and the training shapes had not. Poses from several starts
    (`starting_poses`) are fitted with the modes alone and compared by their posterior density; the
    best is fitted in full. Where no opening comes to its own or the result is an outlier, any
    rotation is tried, and whether the mirror image fits better is told. Deterministic.

    Parameters
    ----------
    prior : FitPrior
        From `fit_prior`; serves any number of fits.
    targets : sequence of Target
        All of the same shape and in the same frame, mm.
    settings : FitSettings, optional

    Raises
    ------
    InputError
        If there is nothing to fit to, names are not the model's, or the data are of another size
        than the model (wrong units).
    TopologyError
        If a target surface is no consistently oriented manifold.
    """
    chosen = FitSettings() if settings is None else settings
    if not targets:
        raise InputError("a fit: expected at least one target, found none")
    data = prepared_data(prior, targets)
    ratio = checked_size(prior.model.mean, targets)
    check_landmarks(prior.mean, data.labelled)
    fit = _fitted(prior, data, ratio, chosen)
    if chosen.pose == "near" and _is_doubtful(prior, data, fit):
        turned = _fitted(prior, data, ratio, replace(chosen, pose="unknown"))
        if turned.residues.median < CLEARLY_NEARER * fit.residues.median:
            note = "turned further than expected: fitted again with an unknown pose"
            fit = replace(turned, notes=(note, *turned.notes))
    if chosen.scaling == "rigid" and not data.is_labelled_only and _is_doubtful(prior, data, fit):
        reflected = [reflected_target(target) for target in targets]
        other = _fitted(
            prior, prepared_data(prior, reflected), ratio, replace(chosen, pose="unknown")
        )
        if other.residues.median < CLEARLY_NEARER * fit.residues.median:
            note = (
                f"fits far better as its mirror image ({other.residues.median:.2f} mm instead of "
                f"{fit.residues.median:.2f}): check the side, the orientation and the frame of the "
                "data"
            )
            fit = replace(fit, notes=(*fit.notes, note))
    return fit


def _is_doubtful(prior: FitPrior, data: Data, fit: ShapeFit) -> bool:
    """Return whether a fit may be in a wrong pose: far off, or no opening came to its own."""
    is_far = fit.typicality.is_outlier or fit.residues.median > FAR * _expected(prior, data)
    loops = sum(len(surface.patch.loops) for surface in data.surfaces)
    named = sum(len(surface.rims) for surface in data.surfaces)
    has_openings = bool(loops) and not named
    return is_far or (has_openings and not fit.openings)


def _expected(prior: FitPrior, data: Data) -> float:
    """Return how far data are expected to lie off a fitted surface, mm."""
    share = SURFACE_EDGES if data.surfaces else SAMPLED_EDGES
    return float(np.hypot(prior.deviation, share * prior.edge))


def _fitted(prior: FitPrior, data: Data, ratio: float, chosen: FitSettings) -> ShapeFit:
    poses = starting_poses(prior, data, chosen, ratio)
    coarse = sparser(data, COARSE_SAMPLES)
    runs = [solve(prior, coarse, State(pose, np.zeros(0)), chosen, COARSE) for pose in poses]
    if len(runs) > 1:
        order = np.argsort(_costs(prior, coarse, runs), kind="stable")[:FINALISTS]
        runs = [solve(prior, coarse, runs[k].state, chosen, COARSE) for k in order]
    best = runs[int(np.argmin(_costs(prior, coarse, runs)))]
    data = _oriented(prior, data, best)
    middle = solve(prior, sparser(data, 2 * COARSE_SAMPLES), best.state, chosen, MIDDLE)
    data, openings = with_openings_matched(prior, data, placed_points(prior, middle.state))
    final = solve(prior, data, middle.state, chosen, FINE)
    # Rims that were out of reach of the modes alone may have come within it.
    data, later = with_openings_matched(prior, data, placed_points(prior, final.state))
    if later:
        openings = {**openings, **later}
        final = solve(prior, data, final.state, chosen, FINE)
    left = openings_left(prior, data, placed_points(prior, final.state))
    posterior = posterior_of(prior, data, final, chosen)
    points = placed_points(prior, final.state)[: len(prior.model.mean)]
    normals, residue, residues = measured_residues(prior, data, points)
    used = kinds_of(data)
    covariance = posterior.point_covariance
    return ShapeFit(
        points=points,
        pose=final.state.pose,
        pose_sd=posterior.pose_sd,
        scores=posterior.scores,
        score_covariance=posterior.score_covariance,
        coefficient_covariance=posterior.covariance[
            : len(final.state.coefficients), : len(final.state.coefficients)
        ],
        point_covariance=covariance,
        point_sd=np.sqrt(np.trace(covariance, axis1=1, axis2=2) / 3.0),
        normal_sd=np.sqrt(np.einsum("pi,pij,pj->p", normals, covariance, normals)),
        residue=residue,
        residues=residues,
        noise_mm={KINDS[kind]: float(final.noise[kind]) for kind in used},
        outlier_share=posterior.outlier_share,
        openings=openings,
        typicality=typicality(
            prior,
            final.state.coefficients,
            posterior.prior_covariance,
            posterior.energy,
            residues.median / _expected(prior, data),
        ),
        status=FitStatus.CONVERGED if final.has_settled else FitStatus.ITERATION_LIMIT,
        iterations=final.iterations,
        notes=left,
    )


def _costs(prior: FitPrior, data: Data, runs: Sequence[Solution]) -> FloatArray:
    """Return the negative logarithm of the posterior density of every run, up to a constant.

    All runs share one noise, that of the best; data count with their distance from the surface,
    the model's points only where the target has surface.
    """
    floor = float(np.hypot(prior.deviation, 0.5 * prior.edge))
    seen = []
    for run in runs:
        points = placed_points(prior, run.state)
        model = model_surface(prior, data, points)
        seen.append(observations(prior, data, model, gated=False, stride=COARSE.stride))
    noise = max(floor, min(float(np.median(item.distance)) for item in seen))
    costs = []
    for run, item in zip(runs, seen, strict=True):
        share = independent_share(prior, item)
        misfit = np.log1p((item.distance / noise) ** 2 / STUDENT_DOF)
        likelihood = 0.5 * (STUDENT_DOF + 1.0) * share * float((item.weight * misfit).sum())
        costs.append(likelihood + 0.5 * float((run.state.coefficients**2).sum()))
    return np.array(costs)


def _oriented(prior: FitPrior, data: Data, run: Solution) -> Data:
    """Return the data with every surface told whether its faces run the other way round."""
    model = model_surface(prior, data, placed_points(prior, run.state))
    surfaces = []
    for surface in data.surfaces:
        _, nearest = _nearest_vertices(model.points[: len(model.normals)], surface.samples)
        agree = np.einsum("ni,ni->n", model.normals[nearest], surface.sample_normals)
        surfaces.append(replace(surface, sign=1.0 if float(agree.sum()) >= 0.0 else -1.0))
    return replace(data, surfaces=tuple(surfaces))


def _nearest_vertices(points: FloatArray, queries: FloatArray) -> tuple[FloatArray, np.ndarray]:
    distance, index = cKDTree(points).query(queries)
    return np.asarray(distance), np.asarray(index)


def kinds_of(data: Data) -> list[int]:
    """Return the kinds of data that there are, as indices into `KINDS`."""
    kinds = {item.kind for item in data.point_sets}
    if data.surfaces:
        kinds.add(KINDS.index("surface"))
    if any(surface.rims for surface in data.surfaces):
        kinds.add(KINDS.index("rims"))
    if len(data.labelled.points) or data.labelled.on_rims:
        kinds.add(KINDS.index("landmarks"))
    return sorted(kinds)
