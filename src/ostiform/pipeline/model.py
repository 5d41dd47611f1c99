"""Stage 4: the results: the three models, the dynamic model, and what is measured on their shapes.

Artifacts: ``KIND/model.h5``; of the optimal model ``model.h5``, ``scores.csv``, ``volumes.csv``,
``clinical.csv``, ``surfaces.csv`` (sizes of the meshes as read) and VTP surfaces in ``meshes/``
(the mean, the first modes at -3, -2, 2 and 3 standard deviations, every shape in correspondence);
``dynamics.h5`` and ``dynamics.json``; ``fields.bin`` and ``fields/`` (see
`pipeline.carried_fields`); ``intervals.json`` (how sure the variances are), ``left-out.bin`` (where
on the surface the model errs), ``maps.bin`` and ``paper-chain.bin`` (the maps), ``covariates.csv``.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from ostiform.artifacts import save
from ostiform.correspondence import KINDS, Correspondence, Kind
from ostiform.evaluation import (
    cumulative_variance_error,
    gain_interval,
    left_out_point_residues,
    surface_sizes,
)
from ostiform.exchange import write_shape_values_csv
from ostiform.model import (
    ShapeModel,
    StoredModel,
    analysed,
    corresponded_shapes,
    mesh_of_template,
    read_correspondence,
    read_model,
    write_corresponded_shape,
    write_mean,
    write_mode,
    write_model,
)
from ostiform.pipeline.carried_fields import (
    FIELDS,
    Fields,
    carried_fields,
    field_tables,
    fields_key,
    read_fields,
    write_fields,
)
from ostiform.pipeline.correspond import Corresponded
from ostiform.pipeline.covariates import write_covariates
from ostiform.pipeline.dynamics import write_dynamics
from ostiform.pipeline.embed import Embedded
from ostiform.pipeline.events import Progress
from ostiform.pipeline.maps import write_maps
from ostiform.pipeline.prepare import Prepared
from ostiform.pipeline.prepared import read_shape, shape_artifact
from ostiform.pipeline.results import Writer, copy_artifact, result_files, write_missing
from ostiform.pipeline.run import Ready, Run
from ostiform.pipeline.store import Store, key_of, slug

MODES_AS_MESHES = 5
DEVIATIONS = (-3.0, -2.0, 2.0, 3.0)
INTERVALS = "intervals.json"
LEFT_OUT = "left-out.bin"
SURFACES = "surfaces.csv"
"""Sizes of the meshes as read, which the model samples."""


def model_shapes(
    run: Run, prepared: Prepared, embedded: Embedded, corresponded: Corresponded
) -> None:
    """Fit the models and write all that is a result, where it is not current."""
    store, key = run.store, key_of("model", corresponded.key)
    total = len(KINDS) + 2
    run.on_event(Progress("model", 0, total))
    models: dict[Kind, StoredModel] = {}
    for done, kind in enumerate(KINDS, start=1):
        models[kind] = _model(store, kind, key)
        run.on_event(Progress("model", done, total))
    if not store.is_current("model.h5", key):
        copy_artifact(store, "optimal/model.h5", "model.h5", key)
    stored, optimal = models["optimal"], _correspondence(store, "optimal")
    write_missing(store, key, result_files(stored, corresponded_shapes(optimal)))
    fields = _fields(run, embedded, optimal, corresponded.key)
    own = fields_key(run.study.settings, key) if fields else key
    write_missing(store, own, _mesh_files(stored.model, optimal, fields))
    write_missing(store, key, {SURFACES: partial(_write_surfaces, run=run, ready=embedded.ready)})
    write_dynamics(store, corresponded.key, stored, run.study.settings)
    run.on_event(Progress("model", len(KINDS) + 1, total))
    _write_intervals(store, key, models)
    _write_left_out(store, key, optimal, run.study.settings.evaluation.modes)
    write_maps(run, embedded.ready, prepared.domain, optimal, corresponded.key)
    entries = run.study.entries
    write_covariates(store, [e.id for e in entries], [e.covariates for e in entries])
    run.on_event(Progress("model", total, total))


def _write_surfaces(path: Path, run: Run, ready: Sequence[Ready]) -> None:
    rows: list[dict[str, float]] = [{}] * len(ready)
    for outcome in run.workers.each(_sizes, [shape.name for shape in ready], run.store):
        rows[outcome.index] = outcome.result
    columns = list(rows[0])
    values = np.array([[row[column] for column in columns] for row in rows])
    write_shape_values_csv(path, [shape.id for shape in ready], columns, values)


def _sizes(name: str, store: Store) -> dict[str, float]:
    return surface_sizes(read_shape(store.path(shape_artifact(name))).parts)


def _correspondence(store: Store, kind: Kind) -> Correspondence:
    return read_correspondence(store.path(f"{kind}/correspondence.h5"))


def _model(store: Store, kind: Kind, key: str) -> StoredModel:
    artifact = f"{kind}/model.h5"
    known = store.read_current(artifact, key, read_model)
    if known is None:
        correspondence = _correspondence(store, kind)
        known = analysed(corresponded_shapes(correspondence), correspondence.template)
        with store.writing(artifact, key) as path:
            write_model(path, known)
    return known


def _fields(run: Run, embedded: Embedded, optimal: Correspondence, key: str) -> Fields:
    """Carry the fields of the study to the corresponding points, and write them."""
    settings, store = run.study.settings, run.store
    own = fields_key(settings, key)
    known = store.read_current(FIELDS, own, lambda _: read_fields(store))
    if known is not None and all(
        store.is_current(name, own) for name in field_tables(optimal.ids, known)
    ):
        return known
    by_name = {slug(entry.id): entry for entry in run.study.entries}
    entries = [by_name[shape.name] for shape in embedded.ready]
    mesh = mesh_of_template(optimal.template)
    fields = carried_fields(settings, entries, optimal.points, mesh, run.workers)
    write_fields(store, own, optimal.ids, fields)
    return fields


def _mesh_files(
    model: ShapeModel, correspondence: Correspondence, fields: Fields
) -> dict[str, Writer]:
    return {
        "meshes/mean.vtp": partial(write_mean, model=model, fields=fields),
        **{
            f"meshes/mode{mode + 1}_{deviation:+.0f}sd.vtp": partial(
                write_mode, model=model, mode=mode, deviation=deviation
            )
            for mode in range(min(MODES_AS_MESHES, len(model.modes)))
            for deviation in DEVIATIONS
        },
        **{
            f"meshes/shapes/{slug(shape)}.vtp": partial(
                write_corresponded_shape, correspondence=correspondence, index=index, fields=fields
            )
            for index, shape in enumerate(correspondence.ids)
        },
    }


def _write_intervals(store: Store, key: str, models: Mapping[Kind, StoredModel]) -> None:
    """Write the jackknife over subjects of the variances, and of the optimal model's gains."""
    if store.is_current(INTERVALS, key):
        return
    optimal = models["optimal"]
    subjects = [id.subject for id in optimal.ids]
    gains = {
        kind: gain_interval(optimal.scores, models[kind].scores, subjects) for kind in KINDS[:-1]
    }
    facts = {
        "subjects": len(set(subjects)),
        "variance_gain": {
            kind: [gain.low, gain.high] for kind, gain in gains.items() if gain is not None
        },
        "cumulative_variance_half_width_mm2": {
            kind: cumulative_variance_error(stored.scores, subjects).tolist()
            for kind, stored in models.items()
        },
    }
    store.write_json(INTERVALS, key, facts)


def _write_left_out(store: Store, key: str, shapes: Correspondence, modes: int) -> None:
    """Write what is left of every point by a model without its shape, if there are enough."""
    own = key_of("left-out points", key, modes)
    if store.is_current(LEFT_OUT, own):
        return
    residues = left_out_point_residues(shapes.aligned, shapes.weights, shapes.ids, max(1, modes))
    if residues is None:
        store.remove(LEFT_OUT)
        return
    with store.writing(LEFT_OUT, own) as path:
        save(path, residues)
