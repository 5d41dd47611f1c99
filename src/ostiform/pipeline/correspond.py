"""Stage 3: the template of the population and its three correspondences (HY 2.2, 2.3).

Artifacts: ``KIND/correspondence.h5`` for the conformal, minimum-Euclidean and optimal model,
``correspondence.h5`` and ``warps.h5`` (the optimal one's) and ``correspondence.json`` (how the run
went). While the sweeps go on, where they stand is kept in ``unfinished/``.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.correspondence import (
    KINDS,
    Correspondence,
    CorrespondenceSettings,
    LevelStatus,
    SweepRecord,
    TiedRim,
    TrainedCorrespondence,
    build_shared_metric,
    corresponded,
    distances_of_rims,
    tied_rims,
    with_shared_rims,
)
from ostiform.errors import InputError
from ostiform.model import write_correspondence, write_warps
from ostiform.pipeline.embed import Embedded
from ostiform.pipeline.events import Note, Progress, Warn
from ostiform.pipeline.landmarks import landmark_inputs, stated_marks
from ostiform.pipeline.prepare import Prepared
from ostiform.pipeline.results import copy_artifact
from ostiform.pipeline.run import Run
from ostiform.pipeline.store import key_of
from ostiform.pipeline.stored_shapes import stored_shapes
from ostiform.pipeline.unfinished import Unfinished
from ostiform.study import Study

FACTS = "correspondence.json"
WARPS = "warps.h5"
RIMS_APART = 0.02
"""Of their length: rims of a dozen points are up to 0.6 % off each other where they are one."""


@dataclass(frozen=True, slots=True)
class Corresponded:
    """The artifacts of the correspondence stage.

    Attributes
    ----------
    key : str
        Hash of everything they were made from.
    l_cut : float, mm^2
    noise_mm : float
    """

    key: str
    l_cut: float
    noise_mm: float


def correspond_shapes(run: Run, prepared: Prepared, embedded: Embedded) -> Corresponded:
    """Bring the embedded shapes into correspondence, three times.

    Raises
    ------
    InputError
        If there are fewer than two shapes.
    """
    if len(embedded.ready) < 2:
        raise InputError(
            f"correspondence: expected at least 2 usable shapes, found {len(embedded.ready)}; "
            "mend the shapes left out or add shapes (`ostiform embed` maps a single one)"
        )
    settings = correspondence_settings(run.study)
    ids = [shape.id for shape in embedded.ready]
    shared = run.study.settings.ostia.shared
    key = key_of(
        "correspondence",
        [shape.key for shape in embedded.ready],
        asdict(settings),
        *landmark_inputs(run.study, ids),
        *((shared,) if shared else ()),
    )
    unfinished = Unfinished(run.store, "correspondence", key)
    artifacts = [f"{kind}/correspondence.h5" for kind in KINDS]
    if not all(run.store.is_current(name, key) for name in [*artifacts, WARPS, FACTS]):
        marks = stated_marks(run.study, ids)
        shapes = stored_shapes(run, embedded.ready, prepared.domain, marks)
        poses = prepared.poses[list(embedded.index)]
        total = settings.levels * settings.sweeps
        run.on_event(Progress("correspond", 0, total))
        resumed = unfinished.checkpoints()
        if resumed:
            level, sweep = resumed[-1].level, resumed[-1].sweeps
            run.on_event(Note(f"correspond: goes on after level {level} sweep {sweep}"))

        def on_sweep(record: SweepRecord) -> None:
            done = (record.level - 1) * settings.sweeps + min(record.sweep, settings.sweeps)
            detail = f"level {record.level} sweep {record.sweep}: {record.objective:.5g}"
            run.on_event(Progress("correspond", min(done, total - 1), total, detail))

        shared_metric = build_shared_metric(shapes, ids, prepared.domain, poses, settings)
        for model in corresponded(
            shapes, ids, shared_metric, settings, on_sweep, resumed=resumed, save=unfinished.save
        ):
            found = model.correspondence
            tied = tied_rims(found.template, found.aligned.mean(axis=0), shared)
            with run.store.writing(f"{model.kind}/correspondence.h5", key) as path:
                write_correspondence(path, with_shared_rims(found, tied))
        for sentence in rims_apart(found, tied):  # of the last, the optimal model
            run.on_event(Warn(sentence))
        with run.store.writing(WARPS, key) as path:
            write_warps(path, model.frozen, model.warps)
        run.store.write_json(FACTS, key, _facts(model, settings))
        run.on_event(Progress("correspond", total, total))
    unfinished.remove()
    facts = run.store.read_json(FACTS)
    if facts["warning"]:
        run.on_event(Warn(facts["warning"]))
    if not run.store.is_current("correspondence.h5", key):
        copy_artifact(run.store, "optimal/correspondence.h5", "correspondence.h5", key)
    return Corresponded(key, facts["l_cut_mm2"], facts["noise_mm"])


def rims_apart(found: Correspondence, tied: Sequence[TiedRim]) -> tuple[str, ...]:
    """Return what to say of rims that are stated to be one curve and are not, in some shapes."""
    said = []
    for one in tied:
        distances = distances_of_rims(found.points, found.template, one)
        loops = found.points[:, found.template.loops[one.first]]
        sides = np.linalg.norm(np.roll(loops, -1, axis=1) - loops, axis=2)
        apart = distances > RIMS_APART * sides.sum(axis=1)
        if apart.any():
            worst = int(np.argmax(distances))
            said.append(
                f"ostia.shared: expected the rims of {one.first} and {one.second} to be one curve, "
                f"found them {distances[worst]:.1f} mm apart in {found.ids[worst]} and more than "
                f"{100 * RIMS_APART:.0f} % of their length in {int(apart.sum())} of {len(apart)} "
                "shapes: the second was moved onto the first"
            )
    return tuple(said)


def correspondence_settings(study: Study) -> CorrespondenceSettings:
    """Return the settings of the correspondence stage that a study states."""
    stated = study.settings.correspondence
    return CorrespondenceSettings(
        optimiser=stated.optimiser,
        levels=stated.levels,
        n_points=study.settings.template.points,
        noise_mm=stated.noise_mm,
        coherence=stated.coherence,
        batch=stated.batch,
        alignment=study.settings.alignment.mode,
        per=study.alignment_per,
        seed=stated.seed,
    )


def convergence_warning(statuses: Sequence[LevelStatus]) -> str:
    """Return which levels ended for another reason than their stopping rule; empty if none did."""
    stopped = [
        f"level {level}: {status.value}"
        for level, status in enumerate(statuses, start=1)
        if status is not LevelStatus.CONVERGED
    ]
    return f"correspondence did not converge ({'; '.join(stopped)})" if stopped else ""


def _facts(trained: TrainedCorrespondence, settings: CorrespondenceSettings) -> dict[str, Any]:
    return {
        "settings": asdict(settings),
        "l_cut_mm2": trained.shared_metric.l_cut,
        "noise_mm": trained.shared_metric.noise_mm,
        "statuses": [status.value for status in trained.statuses],
        "coherence": trained.coherence,
        "warning": convergence_warning(trained.statuses),
        "history": [asdict(record) for record in trained.history],
        "control_points": {
            "interior": _points(trained.interior),
            "boundary": _points(trained.boundary),
        },
    }


def _points(controls: Any) -> dict[str, Any]:
    if controls is None:
        return {"directions": [], "sphere": []}
    directions: FloatArray = controls.directions
    sphere = np.asarray(controls.sphere)
    return {"directions": directions.tolist(), "sphere": sphere.tolist()}
