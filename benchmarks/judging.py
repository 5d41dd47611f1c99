"""How `benchmarks.compare` judges points on surfaces: one set of functions for every method."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from benchmarks.cases import Case
from benchmarks.placements import Placement, folds_of
from ostiform.arrays import FloatArray
from ostiform.correspondence import Correspondence, SharedMetric
from ostiform.correspondence.alignment import Alignment, align
from ostiform.correspondence.sampling import pulled_back
from ostiform.correspondence.terms.description_length import description_length
from ostiform.demo.truth import material_coordinates, true_positions
from ostiform.domain.procrustes import transformed
from ostiform.evaluation import (
    cross_validated,
    distance_to_truth,
    divided_variance,
    fold_residues,
    surface_specificity,
)
from ostiform.model import fit_model, mesh_of_template
from ostiform.surface import closest_points, surface_tree
from ostiform.surface.operators import vertex_areas
from ostiform.surface.quantiles import weighted_quantile
from ostiform.surface.sphere import count_flipped

REFERENCES = 3
"""Shapes whose points the truth carries to all others, for the variance that the truth has."""

SEED = 1


@dataclass(frozen=True, slots=True)
class Verdict:
    """The numbers of one method on one population; NaN where one was not measured.

    Attributes
    ----------
    length, true_length : float
        Description length, and that of the truth at the same points.
    variance, true_variance : float, mm^2
    normal, tangential : float
        Variance across and along the surface, over the truth's at the same points; each fitted to
        its own mean.
    normal_posed : float
        As `normal`, both in the poses that fit the truth's points to their mean.
    error, error_95 : float, mm
        Distance to the true correspondence.
    coverage, coverage_95 : float, mm
        From a surface vertex to the sampled surface, largest and 95 % over area.
    nearest, nearest_95 : float, mm
        From a surface vertex to the nearest point.
    residue : float, mm
        Of left-out subjects, to the surface, both ways, over the numbers of modes from 1.
    specificity : float, mm
        Of random shapes, to the surface, both ways.
    rim, rim_mean : float, mm
        Distance of a rim point from its rim, largest and mean.
    turned : float
        Triangles of the template that are turned over on a shape's sphere, all shapes together.
    cpu_s, wall_s, memory_mb : float
    """

    length: float
    true_length: float
    variance: float
    true_variance: float
    normal: float
    tangential: float
    normal_posed: float
    error: float
    error_95: float
    coverage: float
    coverage_95: float
    nearest: float
    nearest_95: float
    residue: float
    specificity: float
    rim: float
    rim_mean: float
    turned: float
    cpu_s: float
    wall_s: float
    memory_mb: float


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """A method's verdict, its errors by part (mean, 95 %; mm), its residues by number of modes."""

    method: str
    verdict: Verdict
    parts: dict[str, tuple[float, float]]
    residues: tuple[float, ...]


def judged_once(
    cache: Path, case: Case, shared: SharedMetric, placement: Placement, is_full: bool
) -> Judged:
    """Return the verdict on a placement, from the cache if these very points were judged before.

    Costs are always the placement's own. Parameters as in `judged`.
    """
    asked = (case.name.folder, is_full, placement.method, [field.name for field in fields(Verdict)])
    digest = hashlib.sha256(repr(asked).encode())
    arrays = [case.poses, shared.template.points, shared.weights, placement.points]
    arrays += [] if placement.directions is None else [placement.directions]
    for fold, placed in placement.folds if is_full else ():
        digest.update(repr(fold).encode())
        arrays += [placed.aligned, placed.points, placed.transforms]
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    path = cache / "verdicts" / f"{digest.hexdigest()[:32]}.json"
    if not path.exists():
        path.parent.mkdir(exist_ok=True)
        item = judged(case, shared, placement, is_full)
        path.write_text(json.dumps(asdict(item)))
    stored = json.loads(path.read_text())
    verdict = Verdict(**stored["verdict"])
    costs = {name: getattr(placement, name) for name in ("cpu_s", "wall_s", "memory_mb")}
    parts = {part: tuple(pair) for part, pair in stored["parts"].items()}
    residues = tuple(stored["residues"])
    return Judged(placement.method, replace(verdict, **costs), parts, residues)


def judged(
    case: Case, shared: SharedMetric, placement: Placement, with_folds: bool = True
) -> Judged:
    """Return the verdict on a placement of a case's template points.

    Parameters
    ----------
    case : Case
    shared : SharedMetric
        Of the case: gives template, weights, alignment and l_cut to all methods.
    placement : Placement
    with_folds : bool
        Whether to measure generalisation (where the placement has folds) and specificity.
    """
    template, weights = shared.template, shared.weights
    alignment = align(placement.points, weights, shared.alignment, shared.groups)
    directions = placement.directions
    if directions is None:
        directions = _directions(case, shared, placement.points)
    correspondence = Correspondence(
        template=template,
        ids=case.ids,
        directions=directions,
        points=placement.points,
        aligned=alignment.aligned,
        transforms=alignment.transforms,
        weights=weights,
    )
    truth = distance_to_truth(
        correspondence,
        lambda shape, part, points: material_coordinates(case.truth, shape, part, points),
        lambda shape, part, material: true_positions(case.truth, shape, part, material),
    )
    own = divided_variance(alignment.aligned, weights, template.faces)
    true = _true_spread(case, shared, placement.points)
    residues = _residues(case, placement) if with_folds and placement.folds else ()
    surface, nearest = _coverage(case, shared, placement.points)
    rims = _rim_distances(case, shared, placement.points)
    verdict = Verdict(
        length=description_length(alignment.aligned, weights, shared.l_cut),
        true_length=true.length,
        variance=own.total,
        true_variance=true.normal + true.tangential,
        normal=own.normal / true.normal,
        tangential=own.tangential / true.tangential,
        normal_posed=true.posed_normal / true.normal,
        error=truth.mean,
        error_95=truth.p95,
        coverage=surface[0],
        coverage_95=surface[1],
        nearest=nearest[0],
        nearest_95=nearest[1],
        residue=float(np.mean(residues[1:])) if residues else np.nan,
        specificity=_specificity(case, shared, alignment) if with_folds else np.nan,
        rim=float(rims.max()),
        rim_mean=float(rims.mean()),
        turned=float(sum(count_flipped(one, template.faces) for one in directions)),
        cpu_s=placement.cpu_s,
        wall_s=placement.wall_s,
        memory_mb=placement.memory_mb,
    )
    return Judged(placement.method, verdict, dict(truth.parts), residues)


def summary(verdicts: Sequence[Verdict], kind: str) -> Verdict:
    """Return the median or the worst of several verdicts, number by number.

    The worst is the largest, of a ratio of variances the one furthest from 1.
    """
    found = {}
    for field in fields(Verdict):
        values = np.array([getattr(verdict, field.name) for verdict in verdicts])
        values = values[~np.isnan(values)] if not np.isnan(values).all() else values
        if kind == "median":
            found[field.name] = float(np.median(values))
        elif field.name in ("normal", "tangential", "normal_posed"):
            found[field.name] = float(values[np.abs(np.log(values)).argmax()])
        else:
            found[field.name] = float(values.max())
    return Verdict(**found)


def _directions(case: Case, shared: SharedMetric, points: FloatArray) -> FloatArray:
    """Return where points on the surfaces lie on the spheres; rim points anywhere on theirs."""
    sphere = shared.template.sphere
    found = np.empty_like(points)
    for shape, (own, directions) in enumerate(zip(points, found, strict=True)):
        for index, part in enumerate(case.samplers[shape].components):
            chosen = sphere == index
            tree = surface_tree(part.component.vertices, part.component.faces)
            directions[chosen] = pulled_back(tree, part.directions, own[chosen])
    return found


@dataclass(frozen=True, slots=True)
class _TrueSpread:
    """The truth at a method's points: description length, variances (mm^2).

    `posed_normal` is the normal variance of the method's own points in the truth's poses.
    """

    length: float
    normal: float
    tangential: float
    posed_normal: float


def _true_spread(case: Case, shared: SharedMetric, points: FloatArray) -> _TrueSpread:
    """Return what the truth has at a method's points; a mean over the shapes it starts from."""
    template, weights = shared.template, shared.weights
    found = []
    for index in np.unique(np.linspace(0, len(case.ids) - 1, REFERENCES).round().astype(int)):
        carried = np.empty_like(points)
        for part, name in enumerate(template.parts):
            chosen = np.flatnonzero(template.part == part)
            material = material_coordinates(
                case.truth, case.ids[index], name, points[index, chosen]
            )
            for target, shape in enumerate(case.ids):
                carried[target, chosen] = true_positions(case.truth, shape, name, material)
        fit = align(carried, weights, shared.alignment, shared.groups)
        divided = divided_variance(fit.aligned, weights, template.faces)
        posed = divided_variance(transformed(points, fit.transforms), weights, template.faces)
        length = description_length(fit.aligned, weights, shared.l_cut)
        found.append((length, divided.normal, divided.tangential, posed.normal))
    return _TrueSpread(*np.mean(found, axis=0).tolist())


def _coverage(
    case: Case, shared: SharedMetric, points: FloatArray
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the largest and the 95 % distance of surface vertices to the sampling, over shapes."""
    surface, nearest, areas = [], [], []
    for index, own in enumerate(points):
        original = case.original(index)
        used = vertex_areas(original.vertices, original.faces)
        tree = surface_tree(own, shared.template.faces)
        surface.append(closest_points(tree, original.vertices).distances)
        nearest.append(cKDTree(own).query(original.vertices)[0])
        areas.append(used / used.sum())
    return tuple(  # type: ignore[return-value]
        (
            float(max(one.max() for one in found)),
            weighted_quantile(np.concatenate(found), np.concatenate(areas), 0.95),
        )
        for found in (surface, nearest)
    )


def _rim_distances(case: Case, shared: SharedMetric, points: FloatArray) -> FloatArray:
    """Return the distance of every rim and seam point of every shape from its curve, mm."""
    template = shared.template
    found = []
    for shape, own in enumerate(points):
        for part in case.samplers[shape].components:
            for name, curve in part.curves.items():
                chosen = template.curve == template.curves.index(name)
                found.append(polyline_distances(own[chosen], part.component.vertices[curve.loop]))
    return np.concatenate(found)


def polyline_distances(points: FloatArray, polyline: FloatArray) -> FloatArray:
    start, along = polyline[:-1], np.diff(polyline, axis=0)  # (E, 3)
    squared = np.maximum((along**2).sum(axis=1), np.finfo(float).tiny)
    offsets = points[:, None] - start  # (n, E, 3)
    fraction = np.clip(np.einsum("nek,ek->ne", offsets, along) / squared, 0.0, 1.0)
    gaps = np.linalg.norm(offsets - fraction[..., None] * along, axis=2)
    distances: FloatArray = gaps.min(axis=1)
    return distances


def _residues(case: Case, placement: Placement) -> tuple[float, ...]:
    by_fold = dict(placement.folds)
    results = [
        fold_residues(
            fold,
            lambda asked: [(placement.method, by_fold[asked])],
            [case.original(index) for index in fold.test],
        )
        for fold in by_fold
    ]
    found = cross_validated(folds_of(case), results)[placement.method]
    return tuple(found.surface_mean.mean(axis=0).tolist())


def _specificity(case: Case, shared: SharedMetric, alignment: Alignment) -> float:
    model = fit_model(alignment.aligned, shared.weights, mesh_of_template(shared.template))
    originals = [case.original(index) for index in range(len(case.ids))]
    return surface_specificity(
        model,
        alignment.aligned,
        alignment.transforms,
        originals,
        np.random.default_rng(SEED),
    ).mean
