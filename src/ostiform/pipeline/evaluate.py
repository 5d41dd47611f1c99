"""Stage 5: the evidence (HY 2.4, 3): compactness, generalisation, specificity, coverage, truth.

Artifacts: ``folds/N.json`` (residues of the shapes left out of one fold),
``KIND/evaluation.json``, ``evaluation.csv`` and ``comparison.json``. While the sweeps of a fold go
on, where they stand is in ``unfinished/``.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import overload

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.correspondence import (
    KINDS,
    Correspondence,
    CorrespondenceSettings,
    Kind,
    build_shared_metric,
    corresponded,
    place,
)
from ostiform.demo import material_coordinates, read_truth, true_positions
from ostiform.evaluation import (
    MEASURES,
    Evaluation,
    Fold,
    FoldResidues,
    Generalisation,
    OriginalMesh,
    PlacedFold,
    Residues,
    TruthDistance,
    compare,
    cross_validated,
    cross_validation_folds,
    distance_to_truth,
    evaluate_model,
    fold_residues,
    read_evaluation,
    signs_of_collapse,
    write_comparisons,
    write_evaluation,
    write_evaluation_table,
)
from ostiform.execution import Workers
from ostiform.model import mesh_of_template, read_correspondence, read_model
from ostiform.pipeline.correspond import Corresponded, correspondence_settings
from ostiform.pipeline.embed import Embedded
from ostiform.pipeline.events import Note, Progress, Warn
from ostiform.pipeline.landmarks import stated_marks
from ostiform.pipeline.prepare import Prepared
from ostiform.pipeline.prepared import read_shape, shape_artifact
from ostiform.pipeline.run import Ready, Run
from ostiform.pipeline.store import Store, file_hash, key_of
from ostiform.pipeline.stored_shapes import StoredShapes, stored_shapes
from ostiform.pipeline.unfinished import Unfinished
from ostiform.study import Study

COMPARISON = "comparison.json"
TABLE = "evaluation.csv"
FEWEST_SHAPES = 4
"""With fewer, a model without one of them has too little left to be judged."""

SURVEYED = 6
"""Training shapes of a fold, at equal intervals, that its points are relaxed to cover."""


def evaluate_models(
    run: Run, prepared: Prepared, embedded: Embedded, corresponded: Corresponded
) -> tuple[str, ...]:
    """Evaluate the three models of a run, leaving subjects out, and compare them.

    Returns
    -------
    collapsed : tuple of str
        One clause per model that has collapsed: what was expected and what was found.
    """
    _made(run, prepared, embedded, corresponded)
    collapsed = _collapsed(run.store)
    for clause in collapsed:
        run.on_event(Warn(clause))
    return collapsed


def _made(run: Run, prepared: Prepared, embedded: Embedded, corresponded: Corresponded) -> None:
    settings = run.study.settings.evaluation
    truth_key = (
        None if settings.truth is None else file_hash(run.study.path.parent / settings.truth)
    )
    key = key_of(
        "evaluation",
        corresponded.key,
        settings.model_dump(mode="json", exclude={"collapse"}),
        run.study.settings.seed,
        truth_key,
    )
    artifacts = [*(f"{kind}/evaluation.json" for kind in KINDS), COMPARISON, TABLE]
    if all(run.store.is_current(name, key) for name in artifacts):
        return
    residues = _left_out(run, prepared, embedded, corresponded)
    tasks = [
        _KindTask(
            run.store, run.study, kind, embedded.ready, corresponded.l_cut, residues.get(kind)
        )
        for kind in KINDS
    ]
    found: dict[int, Evaluation] = {}
    for outcome in run.workers.each(_evaluated, tasks):
        found[outcome.index] = outcome.result
    evaluations = [found[index] for index in range(len(KINDS))]
    for evaluation in evaluations:
        with run.store.writing(f"{evaluation.kind}/evaluation.json", key) as path:
            write_evaluation(path, evaluation)
    with run.store.writing(TABLE, key) as path:
        write_evaluation_table(path, evaluations)
    comparisons = [compare(evaluations[-1], other) for other in evaluations[:-1]]
    with run.store.writing(COMPARISON, key) as path:
        write_comparisons(path, comparisons)


def _collapsed(store: Store) -> tuple[str, ...]:
    start, *optimised = (read_evaluation(store.path(f"{kind}/evaluation.json")) for kind in KINDS)
    found = ((model.kind, signs_of_collapse(model, start)) for model in optimised)
    return tuple(
        f"the {kind} model has collapsed: expected {' and '.join(signs)}"
        for kind, signs in found
        if signs
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Originals(Sequence[OriginalMesh]):
    """The surfaces of all shapes as they were read, each taken from disk when asked for."""

    store: Store
    shapes: tuple[Ready, ...]

    def __len__(self) -> int:
        return len(self.shapes)

    @overload
    def __getitem__(self, index: int) -> OriginalMesh: ...

    @overload
    def __getitem__(self, index: slice) -> "_Originals": ...

    def __getitem__(self, index: int | slice) -> "OriginalMesh | _Originals":
        if isinstance(index, slice):
            return _Originals(self.store, self.shapes[index])
        return original_mesh(self.store, self.shapes[index])


def original_mesh(store: Store, shape: Ready) -> OriginalMesh:
    """Return all parts of a shape as it was read, in one mesh."""
    parts = read_shape(store.path(shape_artifact(shape.name))).parts.values()
    offsets = np.cumsum([0, *(len(part.vertices) for part in parts)])
    return OriginalMesh(
        np.vstack([part.vertices for part in parts]),
        np.vstack([part.faces + o for part, o in zip(parts, offsets[:-1], strict=True)]),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _FoldTask:
    store: Store
    fold: Fold
    number: int
    key: str
    shapes: tuple[Ready, ...]
    poses: FloatArray
    settings: CorrespondenceSettings
    mode_counts: tuple[int, ...]
    stored: StoredShapes


def _left_out(
    run: Run, prepared: Prepared, embedded: Embedded, corresponded: Corresponded
) -> Mapping[str, Generalisation]:
    shapes = embedded.ready
    if len(shapes) < FEWEST_SHAPES:
        run.on_event(Note(f"generalisation: not measured, {len(shapes)} shapes are too few"))
        return {}
    settings = run.study.settings.evaluation
    if settings.folds == 0:
        run.on_event(Note("generalisation: not measured, the study asks for no folds"))
        return {}
    folds = cross_validation_folds([shape.id for shape in shapes], settings.folds)
    mode_counts = folds.mode_counts(settings.modes)
    marks = stated_marks(run.study, [shape.id for shape in shapes])
    # A fold is the work of one process, which takes its shapes from disk one after the other.
    stored = replace(stored_shapes(run, shapes, prepared.domain, marks), workers=Workers(1))
    tasks = [
        _FoldTask(
            run.store,
            fold,
            number,
            key_of("fold", corresponded.key, [fold.label, fold.train, fold.test], mode_counts),
            shapes,
            prepared.poses[list(embedded.index)],
            correspondence_settings(run.study),
            mode_counts,
            stored,
        )
        for number, fold in enumerate(folds.folds, start=1)
    ]
    results: list[FoldResidues | None] = [None] * len(tasks)
    run.on_event(Progress("evaluate", 0, len(tasks)))
    for done, outcome in enumerate(run.workers.each(_fold, tasks), start=1):
        results[outcome.index] = outcome.result
        run.on_event(Progress("evaluate", done, len(tasks), tasks[outcome.index].fold.label))
    return cross_validated(folds, [item for item in results if item is not None], mode_counts)


def _fold(task: _FoldTask) -> FoldResidues:
    artifact = f"folds/{task.number}.json"
    if not task.store.is_current(artifact, task.key):
        originals = [original_mesh(task.store, task.shapes[index]) for index in task.fold.test]
        residues = fold_residues(
            task.fold, lambda fold: _placed(task, fold), originals, task.mode_counts
        )
        facts = {
            kind: [{name: getattr(item, name).tolist() for name in MEASURES} for item in items]
            for kind, items in residues.items()
        }
        task.store.write_json(artifact, task.key, facts)
    _unfinished(task).remove()
    stored = task.store.read_json(artifact)
    return {
        kind: tuple(Residues(*(np.array(item[name]) for name in MEASURES)) for item in items)
        for kind, items in stored.items()
    }


def _unfinished(task: _FoldTask) -> Unfinished:
    return Unfinished(task.store, f"fold-{task.number}", task.key)


def _placed(task: _FoldTask, fold: Fold) -> Iterator[tuple[str, PlacedFold]]:
    """Build the three models without a fold's shapes, one by one, and place these in them."""
    training = task.stored.chosen(fold.train)
    ids = [task.shapes[index].id for index in fold.train]
    poses = task.poses[list(fold.train)]
    shared_metric = build_shared_metric(training, ids, task.stored.domain, poses, task.settings)
    unfinished = _unfinished(task)
    left_out = task.stored.chosen(fold.test)
    of_test = [task.shapes[index].id for index in fold.test]
    for model in corresponded(
        training,
        ids,
        shared_metric,
        task.settings,
        resumed=unfinished.checkpoints(),
        save=unfinished.save,
        surveyed=SURVEYED,
    ):
        result = place(left_out, of_test, model.frozen)
        yield (
            model.kind,
            PlacedFold(
                model.correspondence.aligned,
                model.correspondence.weights,
                mesh_of_template(model.correspondence.template),
                result.points,
                result.transforms,
            ),
        )


@dataclass(frozen=True, slots=True, eq=False)
class _KindTask:
    store: Store
    study: Study
    kind: Kind
    shapes: tuple[Ready, ...]
    l_cut: float
    generalisation: Generalisation | None


def _evaluated(task: _KindTask) -> Evaluation:
    correspondence = read_correspondence(task.store.path(f"{task.kind}/correspondence.h5"))
    return evaluate_model(
        task.kind,
        read_model(task.store.path(f"{task.kind}/model.h5")).model,
        (correspondence, read_correspondence(task.store.path("conformal/correspondence.h5"))),
        _Originals(task.store, task.shapes),
        task.l_cut,
        task.study.settings.seed,
        task.generalisation,
        _truth_distance(task.study, correspondence),
        samples=task.study.settings.evaluation.specificity_samples,
    )


def _truth_distance(study: Study, correspondence: Correspondence) -> TruthDistance | None:
    stated = study.settings.evaluation.truth
    if stated is None:
        return None
    truth = read_truth(study.path.parent / stated)
    return distance_to_truth(
        correspondence,
        lambda shape, part, points: material_coordinates(truth, shape, part, points),
        lambda shape, part, material: true_positions(truth, shape, part, material),
    )
