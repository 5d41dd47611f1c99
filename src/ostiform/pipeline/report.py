"""Stage 6: the report, rendered from artifacts only.

Artifacts: ``run.json`` (what was run), ``report.html``, the files of its figures in ``figures/``,
and the numbers behind two of them: ``volumes.csv`` (ml) and ``scores.csv`` (mm).
"""

import json
import platform
import sys
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path

import numpy as np

from ostiform import __version__
from ostiform.arrays import FloatArray
from ostiform.correspondence import KINDS
from ostiform.domain import BaseDomain, domain_from_json
from ostiform.errors import ArtifactError
from ostiform.evaluation import (
    Evaluation,
    GainInterval,
    compare,
    cumulative_variance_error,
    gain_interval,
    left_out_point_residues,
    part_volumes,
    read_evaluation,
)
from ostiform.exchange import write_scores_csv, write_volumes_csv
from ostiform.execution import Executor
from ostiform.model import (
    StoredModel,
    read_correspondence,
    read_model,
)
from ostiform.pipeline.animations import write_animations
from ostiform.pipeline.correspond import Corresponded
from ostiform.pipeline.covariates import write_covariates
from ostiform.pipeline.dynamics import write_dynamics
from ostiform.pipeline.embed import Embedded
from ostiform.pipeline.events import OnEvent, Progress
from ostiform.pipeline.prepare import Prepared
from ostiform.pipeline.prepared import read_shape, shape_artifact
from ostiform.pipeline.report_maps import map_records, state_view
from ostiform.pipeline.report_record import (
    RunRecord,
    after,
    read_record,
    recorded_inputs,
    write_record,
)
from ostiform.pipeline.run import Failure, Ready, Run
from ostiform.pipeline.store import Store, file_hash, key_of, slug
from ostiform.report import (
    Drawing,
    FailedShape,
    Page,
    Picture,
    clinical_section,
    correspondence_section,
    cycles_section,
    draw_picture,
    evidence_section,
    headline,
    headline_table,
    maps_section,
    modes_section,
    quality_section,
    remove_stale_drawings,
    render_page,
    run_section,
    sampled_kinks,
    save_drawing,
    scores_section,
    template_section,
    viewer_section,
    volumes_section,
)

LIBRARIES = ("numpy", "scipy", "numba", "vtk", "libigl", "h5py", "matplotlib")
RESULTS = {
    "model.h5": "the optimal model (statismo layout): mean, modes, variances, mesh",
    "correspondence.h5": "every shape in correspondence",
    "meshes": "mean, modes and all shapes as VTP surfaces",
    "scores.csv": "scores of every shape (mm)",
    "volumes.csv": "volumes of every shape (ml)",
    "clinical.csv": "volumes, openings, long axis and twist of every shape",
    "dynamics.json": "who and when: the levels of the dynamic model",
    "dynamics.h5": "the dynamic model",
    "comparison.json": "the three models compared",
    "evaluation.csv": "variance, generalisation and specificity by the number of modes",
    "figures": "every figure as SVG, PDF and PNG (300 dots per inch)",
    "animations": "modes and cycles as moving pictures",
}
"""Files and folders beside the report, and what is in them."""


def report_run(
    run: Run,
    prepared: Prepared,
    embedded: Embedded,
    corresponded: Corresponded,
    failures: Sequence[Failure],
    seconds: Mapping[str, float],
    warnings: Sequence[str] = (),
) -> None:
    """Write the report of a run.

    Parameters
    ----------
    run : Run
    prepared, embedded, corresponded : Prepared, Embedded, Corresponded
        What the stages before have left.
    failures : sequence of Failure
    seconds : mapping of str to float
        Wall time of the stages of this run.
    warnings : sequence of str
        What the stages of this run have warned of.
    """
    study = run.study
    left_out = {f"{failure.id} left out: {failure.reason}" for failure in failures}
    record = RunRecord(
        version=__version__,
        title=study.settings.report.title or study.path.resolve().parent.name or "study",
        study=str(study.path),
        study_sha256=file_hash(study.path),
        settings=study.settings.model_dump(mode="json", by_alias=True),
        entries=len(study.entries),
        shapes=embedded.ready,
        failures=tuple(failures),
        repairs=prepared.repairs,
        warnings=tuple(text for text in warnings if text not in left_out),
        seconds=dict(seconds),
        files=recorded_inputs(run),
        domain_key=prepared.domain_key,
        correspondence_key=corresponded.key,
    )
    record = after(read_record(run.store), record)
    write_record(run.store, record)
    entries = run.study.entries
    write_covariates(run.store, [e.id for e in entries], [e.covariates for e in entries])
    _render(run.store, record, run.workers, run.on_event)


def report_again(output: Path, workers: Executor, on_event: OnEvent) -> RunRecord:
    """Write the report of an output folder again, from what lies in it alone.

    Neither the study nor its meshes are needed.

    Raises
    ------
    ArtifactError
        If the folder holds no finished run, or one of its artifacts is missing or damaged.
    """
    store = Store(output)
    record = read_record(store)
    if record is None:
        raise ArtifactError(
            f"{output}: expected the results of a finished run, found no run.json; run "
            "`ostiform build` with this output folder"
        )
    _render(store, record, workers, on_event)
    return record


def _render(store: Store, record: RunRecord, workers: Executor, on_event: OnEvent) -> None:
    on_event(Progress("report", 0, 1))
    domain = domain_from_json(store.read_json("domain.json"))
    evaluations: dict[str, Evaluation] = {
        kind: read_evaluation(store.path(f"{kind}/evaluation.json")) for kind in KINDS
    }
    comparisons = [compare(evaluations["optimal"], evaluations[kind]) for kind in KINDS[:-1]]
    correspondence = read_correspondence(store.path("optimal/correspondence.h5"))
    models: dict[str, StoredModel] = {
        kind: read_model(store.path(f"{kind}/model.h5")) for kind in KINDS
    }
    stored = models["optimal"]
    dynamics = write_dynamics(
        store, record.correspondence_key, stored, correspondence, record.settings
    )
    dynamic = None if dynamics.evaluation is None else dynamics.evaluation.model
    write_animations(store, record.correspondence_key, stored.model, dynamic)
    intervals = _gain_intervals(models)
    volumes = part_volumes(correspondence.points, stored.model.mesh)
    residues = left_out_point_residues(
        correspondence.aligned,
        correspondence.weights,
        correspondence.ids,
        _most_modes(evaluations, record),
    )
    facts = store.read_json("correspondence.json")
    maps = map_records(store, record.shapes, workers)
    controls = facts["control_points"]
    n_boundary = len(controls["boundary"]["directions"])
    n_interior = len(controls["interior"]["directions"])
    view = state_view(store, _shown(record), record.settings["report"]["part"], domain, facts)
    kinks = sampled_kinks(correspondence, domain)
    repairs = {
        str(shape.id): len(record.repairs[shape.name])
        for shape in record.shapes
        if shape.name in record.repairs
    }
    page = Page(
        title=record.title,
        subtitle=_subtitle(record),
        facts=headline(
            evaluations, len(record.shapes), record.entries, sum(record.seconds.values())
        ),
        sections=(
            viewer_section(stored, dynamic, residues),
            modes_section(stored.model, dynamic),
            evidence_section(evaluations, comparisons, intervals, _variance_errors(models)),
            quality_section(
                stored, evaluations["optimal"], maps, residues, repairs, _failed(store, record)
            ),
            scores_section(stored, dynamic),
            cycles_section(dynamics.evaluation),
            volumes_section(correspondence.ids, volumes),
            clinical_section(dynamics.clinical),
            maps_section(maps, view, kinks),
            template_section(correspondence, evaluations["optimal"]),
            correspondence_section(
                facts["history"],
                facts["statuses"],
                n_interior,
                n_boundary,
                max(len(facts["statuses"]) - facts["settings"]["levels"], 0),
                facts["coherence"] < facts["settings"]["coherence"],
            ),
            run_section(
                _run_facts(store, record, domain, facts),
                record.seconds,
                _notes(record),
                [(file.shape, file.role, file.path, file.sha256) for file in record.files],
                [(name, text) for name, text in RESULTS.items() if store.path(name).exists()],
            ),
        ),
        warnings=(
            *(f"{failure.id} left out: {failure.reason}" for failure in record.failures),
            *record.warnings,
        ),
        summary=headline_table(evaluations, comparisons, intervals),
    )
    drawings = _drawn(page, store, workers, on_event)
    key = key_of("report", record.correspondence_key)
    with store.writing("volumes.csv", key) as path:
        write_volumes_csv(path, correspondence.ids, volumes)
    with store.writing("scores.csv", key) as path:
        write_scores_csv(path, stored)
    with store.writing("report.html", key) as path:
        path.write_text(render_page(page, drawings), encoding="utf-8")
    on_event(Progress("report", len(drawings) + 1, len(drawings) + 1))


def _drawn(page: Page, store: Store, workers: Executor, on_event: OnEvent) -> dict[str, Drawing]:
    """Draw all pictures of a page and write their files."""
    pictures = [picture for section in page.sections for picture in section.pictures]
    folder = store.path("figures")
    drawings = {}
    for done, outcome in enumerate(workers.each(draw_picture, pictures), start=1):
        picture: Picture = pictures[outcome.index]
        drawings[picture.name] = outcome.result
        save_drawing(outcome.result, picture.name, folder)
        on_event(Progress("report", done, len(pictures) + 1, picture.name))
    remove_stale_drawings(folder, drawings)
    return drawings


def _most_modes(evaluations: Mapping[str, Evaluation], record: RunRecord) -> int:
    """The largest number of modes that left-out shapes are reconstructed with."""
    generalisation = evaluations["optimal"].generalisation
    if generalisation is None:
        return int(record.settings["evaluation"]["modes"])
    return max(1, int(generalisation.mode_counts.max()))


def _shown(record: RunRecord) -> Ready:
    """The shape whose map is drawn: the one the study names, else the first."""
    wanted = record.settings["report"]["shape"]
    named = [shape for shape in record.shapes if str(shape.id) == wanted]
    return named[0] if named else record.shapes[0]


def _failed(store: Store, record: RunRecord) -> list[FailedShape]:
    found = []
    for failure in record.failures:
        path = store.path(shape_artifact(slug(failure.id)))
        try:
            parts = read_shape(path).parts
        except ArtifactError:
            parts = {}
        found.append(FailedShape(str(failure.id), failure.stage, parts))
    return found


def _gain_intervals(models: Mapping[str, StoredModel]) -> dict[str, GainInterval]:
    optimal = models["optimal"]
    subjects = [id.subject for id in optimal.ids]
    found = {
        kind: gain_interval(optimal.scores, models[kind].scores, subjects) for kind in KINDS[:-1]
    }
    return {kind: interval for kind, interval in found.items() if interval is not None}


def _variance_errors(models: Mapping[str, StoredModel]) -> dict[str, FloatArray]:
    return {
        kind: cumulative_variance_error(stored.scores, [id.subject for id in stored.ids])
        for kind, stored in models.items()
    }


def _subtitle(record: RunRecord) -> str:
    subjects = len({shape.id.subject for shape in record.shapes})
    return (
        f"{len(record.shapes)} shapes of {subjects} subject{'' if subjects == 1 else 's'}: "
        f"{', '.join(record.part_names)}. Built with Ostiform {record.version}."
    )


def _run_facts(
    store: Store, record: RunRecord, domain: BaseDomain, facts: Mapping[str, object]
) -> dict[str, dict[str, str]]:
    settings = {name: value for name, value in record.settings.items() if name != "ostia"}
    return {
        "Versions and inputs": {
            "ostiform (model)": record.version,
            "ostiform (report)": __version__,
            "python": f"{platform.python_version()} on {sys.platform} {platform.machine()}",
            **{name: version(name) for name in LIBRARIES},
            "study file": Path(record.study).name,
            "SHA-256 of the study file": record.study_sha256,
            "SHA-256 of model.h5": file_hash(store.path("model.h5")),
            "hash of all inputs of the base domain": record.domain_key,
            "hash of all inputs of the correspondence": record.correspondence_key,
            "noise of the shapes (mm)": f"{facts['noise_mm']:.3f}",
            "cut-off of the description length (mm²)": f"{facts['l_cut_mm2']:.5f}",
        },
        "Settings, defaults included": {
            **{name: json.dumps(value, ensure_ascii=False) for name, value in settings.items()},
            "correspondence, complete": json.dumps(facts["settings"], ensure_ascii=False),
        },
        "Circles of the base domain": {
            name: f"centre {np.round(circle.center, 3).tolist()}, "
            f"radius {np.degrees(circle.radius):.1f} degrees"
            for sphere in domain.spheres
            for name, circle in sphere.curves.items()
        },
    }


def _notes(record: RunRecord) -> list[tuple[str, str]]:
    names = {shape.name: str(shape.id) for shape in record.shapes}
    return [
        *(
            (str(failure.id), f"left out ({failure.stage}): {failure.reason}")
            for failure in record.failures
        ),
        *(
            (names.get(name, name), repair)
            for name, repairs in record.repairs.items()
            for repair in repairs
        ),
    ]
