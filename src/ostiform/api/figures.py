"""The figures of the report as Matplotlib figures, to be changed, shown or saved.

Each function takes the `Results` of a build (all stages but the report are enough), or a model,
and returns a `matplotlib.figure.Figure` of print size. Nothing is written.
"""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ostiform.api.results import Results
from ostiform.arrays import FloatArray
from ostiform.artifacts import load
from ostiform.correspondence import KINDS
from ostiform.domain import BaseDomain, domain_from_json
from ostiform.errors import InputError
from ostiform.evaluation import MapRecords, compare, part_volumes, volume_curves
from ostiform.model import ShapeModel
from ostiform.pipeline import (
    INTERVALS,
    MAPS,
    Store,
    shown_map,
    slug,
    state_view,
)
from ostiform.report import (
    Section,
    convergence_figure,
    evidence_section,
    maps_section,
    modes_figure,
    scores_figure,
    shapes_figure,
    volumes_figure,
)


def evidence(results: Results) -> Figure:
    """Draw variance, left-out residue and specificity of the three models (HY Fig. 4).

    Bands are 95 % intervals over subjects; for the specificity they are the sampling error.
    """
    evaluations = {str(kind): results.evaluated(kind) for kind in KINDS}
    widths = Store(results.folder).read_json(INTERVALS)["cumulative_variance_half_width_mm2"]
    section = evidence_section(
        evaluations,
        [compare(evaluations["optimal"], evaluations[kind]) for kind in KINDS[:-1]],
        {},
        {kind: np.array(half) for kind, half in widths.items()},
    )
    return _picture(section, "evidence")


def mode(
    model: ShapeModel, index: int, deviations: tuple[float, ...] = (-3.0, -2.0, 0.0, 2.0, 3.0)
) -> Figure:
    """Draw the mean displaced along one mode, seen from two sides (HY Fig. 3).

    Parameters
    ----------
    model : ShapeModel
    index : int
        From 0.
    deviations : tuple of float
        In standard deviations; 0 is the mean.

    Raises
    ------
    InputError
        If the model has no such mode.
    """
    if not 0 <= index < len(model.modes):
        raise InputError(
            f"mode of a model: expected an index from 0 to {len(model.modes) - 1}, found {index}"
        )
    return modes_figure(model, index, deviations)


def shapes(model: ShapeModel, points: FloatArray, titles: tuple[str, ...]) -> Figure:
    """Draw shapes of a model side by side, from the front.

    Parameters
    ----------
    model : ShapeModel
        Gives the triangles and the view.
    points : (n, P, 3) float64, mm
        For example of `ShapeModel.sample`.
    titles : tuple of str, n

    Raises
    ------
    InputError
        If there is not one title for each shape of the model's points.
    """
    given = np.asarray(points, dtype=np.float64)
    if given.shape != (len(titles), len(model.mean), 3) or not titles:
        raise InputError(
            f"shapes to draw: expected ({len(titles)}, {len(model.mean)}, 3) coordinates for "
            f"{len(titles)} titles, found {given.shape}"
        )
    return shapes_figure(model, given, titles)


def scores(results: Results) -> Figure:
    """Draw the scores of the first two modes, each subject joined through its phases."""
    stored = results.stored()
    model = stored.model
    standard = stored.scores / np.sqrt(np.maximum(model.variances, np.finfo(float).tiny))
    return scores_figure(
        standard,
        [id.subject for id in stored.ids],
        np.array([id.time for id in stored.ids]),
        model.variances / model.total_variance,
    )


def volumes(results: Results) -> Figure:
    """Draw the volume of every part over the cycle, one line per subject.

    Raises
    ------
    InputError
        If no subject has several phases.
    """
    correspondence, model = results.correspondence, results.model
    curves = volume_curves(correspondence.ids, part_volumes(correspondence.points, model.mesh))
    if not curves:
        raise InputError(
            f"{results.folder}: expected a subject with several phases, found one phase each; "
            "a volume curve needs motion"
        )
    return volumes_figure(curves)


def convergence(results: Results) -> Figure:
    """Draw the objective of the correspondence against time by level, and its terms apart.

    Raises
    ------
    InputError
        If the correspondence was made with level 1 alone.
    """
    finer = [record for record in _facts(results)["history"] if record["level"] > 1]
    if not finer:
        raise InputError(
            f"{results.folder}: expected levels finer than the first, found level 1 only; "
            "set correspondence.levels to 2 or more"
        )
    return convergence_figure(finer)


def maps(results: Results, shape: str | None = None, part: str | None = None) -> Figure:
    """Draw the map of one part to the sphere step by step, in the stereographic plane (HY Fig. 2).

    Parameters
    ----------
    results : Results
    shape : str, optional
        ``SUBJECT/PHASE``; default the first shape.
    part : str, optional
        Default the part with the most openings.

    Raises
    ------
    InputError
        If there is no such shape or part.
    """
    return _maps(results, "maps", shape, part)


def paper_maps(results: Results, shape: str | None = None, part: str | None = None) -> Figure:
    """Draw the states of the paper's own chain, folds marked; parameters and errors as `maps`."""
    return _maps(results, "maps-paper", shape, part)


def distortion(results: Results) -> Figure:
    """Draw how much the maps of all shapes distort angles and areas."""
    return _maps(results, "distortion", None, None)


def _maps(results: Results, name: str, shape: str | None, part: str | None) -> Figure:
    store, domain = Store(results.folder), _domain(results)
    ids = {str(id): id for id in results.stored().ids}
    wanted = next(iter(ids)) if shape is None else shape
    if wanted not in ids:
        raise InputError(
            f"shape to draw: expected one of {', '.join(ids)}, found {wanted}; "
            "shapes that were left out have no map"
        )
    parts = [own for sphere in domain.spheres for own in sphere.parts]
    if part is not None and part not in parts:
        raise InputError(f"part to draw: expected one of {', '.join(parts)}, found {part}")
    chain = shown_map(store, slug(ids[wanted]), part, domain)
    view = state_view(wanted, chain, part, domain, _facts(results))
    return _picture(maps_section(load(store.path(MAPS), MapRecords), view), name)


def _facts(results: Results) -> Any:
    return Store(results.folder).read_json("correspondence.json")


def _domain(results: Results) -> BaseDomain:
    return domain_from_json(Store(results.folder).read_json("domain.json"))


def _picture(section: Section, name: str) -> Figure:
    return next(picture.figure for picture in section.pictures if picture.name == name)
