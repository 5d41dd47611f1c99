"""The methods that `benchmarks.compare` sets against each other, each in a process of its own.

Every method brings the same template points onto the same surfaces. What it cost is measured in
its process after its kernels are compiled: processor time, wall time and the largest memory.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cases import Case, CaseName, in_new_process, loaded, peak_memory_mb
from benchmarks.peers import PEERS, medoid_shape, registered
from benchmarks.poor_starts import with_poor_start
from ostiform.arrays import FloatArray
from ostiform.correspondence import (
    KINDS,
    CorrespondenceSettings,
    Kind,
    SharedMetric,
    SweepRecord,
    correspond,
    place,
)
from ostiform.correspondence.alignment import align, align_to
from ostiform.evaluation import Division, Fold, Folds, PlacedFold, cross_validation_folds
from ostiform.model import mesh_of_template

OURS = KINDS
CONJUGATE_GRADIENT = "optimal, conjugate gradient"
METHODS = (*OURS, CONJUGATE_GRADIENT, *PEERS)
MOST_FOLDS = 4


@dataclass(frozen=True, slots=True)
class Task:
    """One run of a method, or of the three models of the paper at once.

    Attributes
    ----------
    cache : Path
    name : CaseName
    method : str
        ``"ours"`` for the three models, or one of `METHODS`.
    changes : tuple of (str, value)
        Settings of the correspondence other than the defaults.
    poor : float
        Largest angle by which rims are turned, degrees.
    with_folds : bool
        Whether to leave subjects out too.
    """

    cache: Path
    name: CaseName
    method: str
    changes: tuple[tuple[str, Any], ...] = ()
    poor: float = 0.0
    with_folds: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Placement:
    """Where a method put the template points, and what that cost.

    Attributes
    ----------
    method : str
    points : (N, P, 3) float64, mm
        In input coordinates, shapes in the order of the case.
    directions : (N, P, 3) float64 or None
        On the sphere, for methods that work there.
    cpu_s, wall_s, memory_mb : float
        From surfaces to points; the maps included where a method needs them.
    history : tuple of SweepRecord
    statuses : tuple of str
    folds : tuple of (Fold, PlacedFold)
        Empty where no subject was left out.
    """

    method: str
    points: FloatArray
    directions: FloatArray | None
    cpu_s: float
    wall_s: float
    memory_mb: float
    history: tuple[SweepRecord, ...] = ()
    statuses: tuple[str, ...] = ()
    folds: tuple[tuple[Fold, PlacedFold], ...] = ()


def placements(task: Task) -> tuple[Placement, ...]:
    """Return what a task placed, from a fresh process."""
    return in_new_process(_placements, task)


def prepared_case(task: Task) -> Case:
    """Return the population of a task as its methods get it: a poor start included."""
    case = loaded(task.cache, task.name)
    return with_poor_start(case, task.poor) if task.poor else case


def folds_of(case: Case) -> Folds:
    """Return the folds of whole subjects: one per subject, of many subjects four groups."""
    folds = cross_validation_folds(case.ids)
    if len(folds.folds) <= MOST_FOLDS:
        return folds
    every = range(len(case.ids))
    groups = [tuple(every[number::MOST_FOLDS]) for number in range(MOST_FOLDS)]
    return Folds(
        Division.SUBJECT_GROUPS,
        len(case.ids),
        tuple(
            Fold(f"group {number}", tuple(i for i in every if i not in group), group)
            for number, group in enumerate(groups, start=1)
        ),
    )


def _placements(task: Task) -> tuple[Placement, ...]:
    case = prepared_case(task)
    if task.method in PEERS:
        return (_peer(task, case),)
    settings = replace(case.settings, **dict(task.changes))
    if task.method == CONJUGATE_GRADIENT:
        settings = replace(settings, optimiser="conjugate-gradient")
    few = case.selected(range(min(3, len(case.ids))))
    correspond(few.samplers, few.ids, few.shared_metric(), replace(settings, sweeps=1))  # compile
    return _ours(task, case, settings)


def _ours(task: Task, case: Case, settings: CorrespondenceSettings) -> tuple[Placement, ...]:
    costs: dict[str, tuple[float, float, float]] = {}
    processor, wall = time.process_time(), time.monotonic()

    def spent() -> tuple[float, float, float]:
        return (
            time.process_time() - processor + case.costs["cpu_s"],
            time.monotonic() - wall + case.costs["wall_s"],
            max(peak_memory_mb(), case.costs["memory_mb"]),
        )

    def watch(record: SweepRecord) -> None:
        costs.setdefault("conformal", spent())  # known only after the first sweep: its seconds off
        costs["euclidean" if record.level == 1 else "optimal"] = spent()
        first.append(record)

    first: list[SweepRecord] = []
    shared = replace(case, settings=settings).shared_metric()
    trained = correspond(case.samplers, case.ids, shared, settings, watch)
    costs["conformal"] = tuple(
        max(value - cut, 0.0)
        for value, cut in zip(
            costs["conformal"], (first[0].seconds, first[0].seconds, 0.0), strict=True
        )
    )  # type: ignore[assignment]
    costs["optimal"] = spent()
    folds = _our_folds(task, case, settings) if task.with_folds else {}
    names: dict[Kind, str] = {kind: kind for kind in KINDS}
    if task.method == CONJUGATE_GRADIENT:
        names = {"optimal": CONJUGATE_GRADIENT}
    found = []
    for kind, method in names.items():
        item = trained[kind]
        found.append(
            Placement(
                method,
                item.correspondence.points,
                item.correspondence.directions,
                *costs[kind],
                item.history,
                tuple(status.name for status in item.statuses),
                tuple(folds.get(kind, ())),
            )
        )
    return tuple(found)


def _our_folds(
    task: Task, case: Case, settings: CorrespondenceSettings
) -> dict[str, list[tuple[Fold, PlacedFold]]]:
    """Build template, weights, warps and modes without a fold's subjects, then place these."""
    found: dict[str, list[tuple[Fold, PlacedFold]]] = {}
    for fold in folds_of(case).folds:
        training = case.selected(fold.train)
        trained = correspond(training.samplers, training.ids, training.shared_metric(), settings)
        for kind, model in trained.items():
            left_out = [case.samplers[index] for index in fold.test]
            placed = place(left_out, [case.ids[index] for index in fold.test], model.frozen)
            found.setdefault(kind, []).append(
                (
                    fold,
                    PlacedFold(
                        model.correspondence.aligned,
                        model.correspondence.weights,
                        mesh_of_template(model.correspondence.template),
                        placed.points,
                        placed.transforms,
                    ),
                )
            )
    return found


def _subjects(case: Case, test: Sequence[int], jointly: bool) -> list[list[int]]:
    labels = [case.ids[i].subject if jointly else i for i in test]
    return [
        [i for i, own in zip(test, labels, strict=True) if own == label]
        for label in dict.fromkeys(labels)
    ]


def _peer(task: Task, case: Case) -> Placement:
    shared = case.shared_metric()
    registered(task.method, case.selected([0, 1]), shared.template, 0)  # compile, load
    processor, wall = time.process_time(), time.monotonic()
    start = medoid_shape(case, shared, range(len(case.ids)))
    points = registered(task.method, case, shared.template, start)
    costs = time.process_time() - processor, time.monotonic() - wall, peak_memory_mb()
    folds = []
    known = {start: points}
    for fold in folds_of(case).folds if task.with_folds else ():
        source = medoid_shape(case, shared, fold.train)
        if source not in known:
            known[source] = registered(task.method, case, shared.template, source)
        folds.append((fold, _peer_fold(case, fold, known[source], shared)))
    return Placement(task.method, points, None, *costs, folds=tuple(folds))


def _peer_fold(case: Case, fold: Fold, points: FloatArray, shared: SharedMetric) -> PlacedFold:
    """Return a fold of a method that registers every shape alone to one of the training set."""
    train, test = list(fold.train), list(fold.test)
    labels = list(dict.fromkeys(case.ids[i].subject for i in train))
    groups = np.array([labels.index(case.ids[i].subject) for i in train])
    aligned = align(points[train], shared.weights, "rigid", groups).aligned
    mean = aligned.mean(axis=0)
    transforms = np.empty((len(test), 4, 4))
    for group in _subjects(case, test, True):
        rows = [test.index(i) for i in group]
        transforms[rows] = align_to(points[group], mean, shared.weights, "rigid")
    return PlacedFold(
        aligned,
        shared.weights,
        mesh_of_template(shared.template),
        points[test],
        transforms,
    )
