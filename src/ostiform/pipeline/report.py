"""Stage 6: the report, drawn from the results alone.

Artifacts: ``report.html``, the files of its figures in ``figures/``, and ``animations/``. Nothing
is fitted or measured here: a folder of results that was copied elsewhere has a report of its own.
"""

import json
import platform
import sys
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ostiform import __version__
from ostiform.arrays import FloatArray
from ostiform.artifacts import load
from ostiform.correspondence import KINDS
from ostiform.domain import BaseDomain, domain_from_json
from ostiform.embedding import Embedding, Embeddings
from ostiform.errors import ArtifactError
from ostiform.evaluation import (
    ClinicalTable,
    GainInterval,
    MapRecords,
    PointResidues,
    compare,
    read_evaluation,
)
from ostiform.exchange import read_shape_values_csv
from ostiform.execution import Executor, Workers
from ostiform.model import read_correspondence, read_model
from ostiform.pipeline.animations import write_animations
from ostiform.pipeline.build import Summary, build_study
from ostiform.pipeline.carried_fields import read_fields
from ostiform.pipeline.dynamics import read_dynamics
from ostiform.pipeline.events import Note, OnEvent, Progress
from ostiform.pipeline.folder import locked
from ostiform.pipeline.maps import MAPS, PAPER_CHAIN, chosen_part
from ostiform.pipeline.model import INTERVALS, LEFT_OUT, SURFACES
from ostiform.pipeline.prepare import read_poses
from ostiform.pipeline.prepared import read_shape, shape_artifact
from ostiform.pipeline.record import RECORD, RunRecord, changed_inputs, read_record
from ostiform.pipeline.store import Store, file_hash, key_of, slug
from ostiform.report import (
    Drawing,
    FailedShape,
    Page,
    Picture,
    ReadShape,
    StateView,
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
    save_drawing,
    scores_section,
    template_section,
    viewer_section,
    volumes_section,
)

NAMED = 3
"""Files that are named where several have changed or are gone."""

LIBRARIES = ("numpy", "scipy", "numba", "vtk", "libigl", "h5py", "matplotlib")
RESULTS = {
    "model.h5": "the optimal model (statismo layout): mean, modes, variances, mesh",
    "correspondence.h5": "every shape in correspondence",
    "fields": "the fields of the surface at the corresponding points, one table each",
    "meshes": "mean, modes and all shapes as VTP surfaces",
    "scores.csv": "scores of every shape (mm)",
    "volumes.csv": "volumes of every shape (ml)",
    "clinical.csv": "volumes, openings, long axis and twist of every shape",
    "surfaces.csv": "the same sizes of the meshes as read, which the model samples",
    "dynamics.json": "who and when: the levels of the dynamic model",
    "dynamics.h5": "the dynamic model",
    "comparison.json": "the three models compared",
    "evaluation.csv": "variance, generalisation and specificity by the number of modes",
    "figures": "every figure as SVG, PDF and PNG (300 dots per inch)",
    "animations": "modes and cycles as moving pictures",
}
"""Files and folders beside the report, and what is in them."""


def report_results(
    source: Path,
    output: Path | None = None,
    *,
    workers: int = 1,
    scheduler: str | None = None,
    on_event: OnEvent | None = None,
) -> Summary:
    """Write the report of a folder of results.

    Parameters
    ----------
    source : Path
        The folder; or the ``study.toml`` of its run, or where that was: what is still there must
        then be what the run has read, else what has changed is built again first.
    output : Path, optional
        The folder, where `source` is a study.
    workers : int
        Processes of this machine.
    scheduler : str, optional
        As `build_study`, where something is built again.
    on_event : callable, optional
        Takes the events of the run.

    Raises
    ------
    ArtifactError
        If a folder alone is given that holds no finished run, or an artifact is missing or
        damaged.
    OstiformError
        As `build_study`, for a study.
    """
    watch: OnEvent = on_event or (lambda _: None)
    results = source if output is None else output
    record = read_record(Store(results))
    if output is None and record is None:
        raise ArtifactError(
            f"{results}: expected the results of a finished run, found no {RECORD}; run "
            "`ostiform build` with this output folder"
        )
    if output is not None:
        changed, gone = ([], []) if record is None else changed_inputs(record, source)
        if changed:
            watch(Note(f"changed since the last run: {_several(changed)}; building again"))
        if record is None or changed:
            return build_study(source, output, workers=workers, scheduler=scheduler, on_event=watch)
        if gone:
            watch(Note(f"gone since the last run: {_several(gone)}; the report shows that run"))
    with locked(results), Workers(workers) as pool:
        record = write_report(Store(results), pool, watch)
    return Summary(results, record.entries, record.failures, dict(record.seconds))


def _several(paths: list[str]) -> str:
    more = f" and {len(paths) - NAMED} more" if len(paths) > NAMED else ""
    return f"{', '.join(paths[:NAMED])}{more}"


def write_report(store: Store, workers: Executor, on_event: OnEvent) -> RunRecord:
    """Draw the report of a finished run, and return what was run.

    Raises
    ------
    ArtifactError
        If an artifact is missing or damaged.
    """
    on_event(Progress("report", 0, 1))
    record = read_record(store)
    if record is None:
        raise ArtifactError(f"{store.root}: expected the results of a finished run, found none")
    page = _page(store, record)
    drawings = _drawn(page, store, workers, on_event)
    write_animations(store, record.correspondence_key, workers)
    with store.writing("report.html", key_of("report", record.correspondence_key)) as path:
        path.write_text(render_page(page, drawings), encoding="utf-8")
    on_event(Progress("report", len(drawings) + 1, len(drawings) + 1))
    on_event(Note(f"report: {store.path('report.html')}"))
    return record


def _page(store: Store, record: RunRecord) -> Page:
    domain = domain_from_json(store.read_json("domain.json"))
    facts = store.read_json("correspondence.json")
    evaluations = {str(k): read_evaluation(store.path(f"{k}/evaluation.json")) for k in KINDS}
    comparisons = [compare(evaluations["optimal"], evaluations[kind]) for kind in KINDS[:-1]]
    intervals = store.read_json(INTERVALS)
    gains = {
        kind: GainInterval(low, high, intervals["subjects"])
        for kind, (low, high) in intervals["variance_gain"].items()
    }
    errors = {
        kind: np.array(half)
        for kind, half in intervals["cumulative_variance_half_width_mm2"].items()
    }
    correspondence = read_correspondence(store.path("optimal/correspondence.h5"))
    stored = read_model(store.path("optimal/model.h5"))
    dynamics = read_dynamics(store)
    dynamic = None if dynamics is None else dynamics.model
    clinical = ClinicalTable(*read_shape_values_csv(store.path("clinical.csv")))
    own_sizes = store.path(SURFACES)
    surfaces = ClinicalTable(*read_shape_values_csv(own_sizes)) if own_sizes.is_file() else None
    left_out = store.path(LEFT_OUT)
    residues = load(left_out, PointResidues) if left_out.is_file() else None
    maps = load(store.path(MAPS), MapRecords)
    stated, labels = record.settings["report"], [str(shape.id) for shape in record.shapes]
    shown = stated["shape"] if stated["shape"] in labels else labels[0]
    chain = load(store.path(PAPER_CHAIN), Embeddings)
    view = state_view(shown, chain, stated["part"], domain, facts)
    turned = {
        pose.id: Rotation.from_matrix(pose.transform[:3, :3]).magnitude()
        for pose in read_poses(store)
    }
    read = {
        str(shape.id): ReadShape(
            len(record.repairs.get(shape.name, ())), float(np.degrees(turned[shape.id]))
        )
        for shape in record.shapes
        if shape.id in turned
    }
    return Page(
        title=record.title,
        subtitle=_subtitle(record),
        facts=headline(
            evaluations, len(record.shapes), record.entries, sum(record.seconds.values())
        ),
        sections=(
            viewer_section(stored, dynamic, residues, read_fields(store)),
            modes_section(stored.model, dynamic),
            evidence_section(evaluations, comparisons, gains, errors),
            quality_section(
                stored,
                evaluations["optimal"],
                maps.shapes,
                residues,
                read,
                _failed(store, record),
            ),
            scores_section(stored, dynamics),
            cycles_section(dynamics),
            volumes_section(clinical, surfaces),
            clinical_section(clinical),
            maps_section(maps, view),
            template_section(correspondence, evaluations["optimal"]),
            correspondence_section(facts),
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
        summary=headline_table(evaluations, comparisons, gains),
    )


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


def state_view(
    label: str,
    chain: Sequence[Embedding],
    part: str | None,
    domain: BaseDomain,
    facts: Mapping[str, Any],
) -> StateView:
    """Return the steps of the map of one part, those of the paper's chain beside them.

    Parameters
    ----------
    label : str
        Of the shape.
    chain : (Embedding, Embedding)
        See `shown_map`.
    part : str or None
        As there.
    domain : BaseDomain
    facts : mapping
        Of the correspondence; holds the control points.
    """
    used, paper = chain
    index = next(i for i, s in enumerate(domain.spheres) if s.name == used.component.name)

    def controls(group: str) -> FloatArray:
        stored = facts["control_points"][group]
        pairs = zip(stored["directions"], stored["sphere"], strict=True)
        return np.array([d for d, sphere in pairs if sphere == index]).reshape(-1, 3)

    return StateView(
        label,
        used,
        domain.spheres[index],
        chosen_part([used], part)[1],
        paper.states,
        controls("interior"),
        controls("boundary"),
    )


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
