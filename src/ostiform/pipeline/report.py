"""Stage 6: the report, rendered from artifacts only.

Artifacts: ``report.html``, the files of its figures in ``figures/``, and the numbers behind two of
them: ``volumes.csv`` (ml) and ``scores.csv`` (mm).
"""

import csv
import json
import platform
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from typing import Any

import numpy as np

from ostiform import __version__
from ostiform.arrays import FloatArray
from ostiform.correspondence import KINDS
from ostiform.embedding import Embedding, paper_states
from ostiform.evaluation import (
    Evaluation,
    GainInterval,
    compare,
    cumulative_variance_error,
    gain_interval,
    part_volumes,
    read_evaluation,
)
from ostiform.model import (
    DynamicModel,
    StoredModel,
    dynamic_model_of,
    read_correspondence,
    read_model,
)
from ostiform.pipeline.arrays_file import read_embeddings
from ostiform.pipeline.correspond import Corresponded
from ostiform.pipeline.embed import Embedded, embedding_artifact
from ostiform.pipeline.events import Progress
from ostiform.pipeline.prepare import Prepared
from ostiform.pipeline.run import Failure, Run
from ostiform.pipeline.store import key_of
from ostiform.report import (
    Page,
    ShapeMaps,
    StateView,
    correspondence_section,
    draw_picture,
    evidence_section,
    headline,
    maps_section,
    modes_section,
    render_page,
    run_section,
    save_drawing,
    scores_section,
    template_section,
    viewer_section,
    volumes_section,
)
from ostiform.study import ShapeId

__all__ = ["report_run"]

MM3_PER_ML = 1000.0
LIBRARIES = ("numpy", "scipy", "numba", "vtk", "libigl", "h5py", "matplotlib")


def report_run(
    run: Run,
    prepared: Prepared,
    embedded: Embedded,
    corresponded: Corresponded,
    failures: Sequence[Failure],
    seconds: Mapping[str, float],
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
    """
    store = run.store
    run.tell(Progress("report", 0, 1))
    evaluations: dict[str, Evaluation] = {
        kind: read_evaluation(store.path(f"{kind}/evaluation.json")) for kind in KINDS
    }
    comparisons = [compare(evaluations["optimal"], evaluations[kind]) for kind in KINDS[:-1]]
    correspondence = read_correspondence(store.path("optimal/correspondence.h5"))
    models: dict[str, StoredModel] = {
        kind: read_model(store.path(f"{kind}/model.h5")) for kind in KINDS
    }
    stored = models["optimal"]
    dynamic = _dynamic(stored)
    intervals = _gain_intervals(models)
    volumes = part_volumes(correspondence.points, stored.model.mesh)
    facts = store.read_json("correspondence.json")
    maps = [
        ShapeMaps(str(shape.id), read_embeddings(store.path(embedding_artifact(shape.name))))
        for shape in embedded.ready
    ]
    controls = facts["control_points"]
    n_boundary = len(controls["boundary"]["directions"])
    n_interior = len(controls["interior"]["directions"])
    page = Page(
        title=run.study.path.parent.name or "study",
        subtitle=_subtitle(run, len(embedded.ready), seconds),
        facts=headline(
            evaluations, comparisons, intervals, len(embedded.ready), len(run.study.entries)
        ),
        sections=(
            viewer_section(stored, dynamic),
            evidence_section(evaluations, comparisons, intervals, _variance_errors(models)),
            modes_section(stored.model),
            scores_section(stored, dynamic, evaluations["optimal"]),
            volumes_section(correspondence.ids, volumes),
            maps_section(maps, _state_view(prepared, maps[0], facts), maps[0].label),
            template_section(correspondence, evaluations["optimal"]),
            correspondence_section(facts["history"], facts["statuses"], n_interior, n_boundary),
            run_section(_run_facts(run, prepared, facts), _notes(prepared, failures)),
        ),
        warnings=(
            *(f"{failure.id} left out: {failure.reason}" for failure in failures),
            *((facts["warning"],) if facts["warning"] else ()),
        ),
    )
    pictures = [picture for section in page.sections for picture in section.pictures]
    drawings = {}
    for done, picture in enumerate(pictures, start=1):
        run.tell(Progress("report", done, len(pictures) + 1, picture.name))
        drawings[picture.name] = draw_picture(picture)
        save_drawing(drawings[picture.name], picture.name, store.path("figures"))
    key = key_of("report", corresponded.key)
    _write_volumes(run, key, correspondence.ids, volumes)
    _write_scores(run, key, stored)
    with store.writing("report.html", key) as path:
        path.write_text(render_page(page, drawings), encoding="utf-8")
    run.tell(Progress("report", len(pictures) + 1, len(pictures) + 1))


def _dynamic(stored: StoredModel) -> DynamicModel | None:
    """The model by its sources, where a subject has several phases."""
    if len({id.subject for id in stored.ids}) == len(stored.ids):
        return None
    return dynamic_model_of(stored)


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


def _write_volumes(
    run: Run, key: str, ids: Sequence[ShapeId], volumes: Mapping[str, FloatArray]
) -> None:
    rows = [
        [
            id.subject,
            id.phase,
            f"{id.time:.6g}",
            *(f"{v[i] / 1000.0:.6g}" for v in volumes.values()),
        ]
        for i, id in enumerate(ids)
    ]
    _write_table(
        run, "volumes.csv", key, ["subject", "phase", "time", *(f"{n}_ml" for n in volumes)], rows
    )


def _write_scores(run: Run, key: str, stored: StoredModel) -> None:
    rows = [
        [id.subject, id.phase, f"{id.time:.6g}", *(f"{score:.6g}" for score in scores)]
        for id, scores in zip(stored.ids, stored.scores, strict=True)
    ]
    modes = [f"mode{k + 1}_mm" for k in range(stored.scores.shape[1])]
    _write_table(run, "scores.csv", key, ["subject", "phase", "time", *modes], rows)


def _write_table(
    run: Run, name: str, key: str, header: Sequence[str], rows: Sequence[Sequence[str]]
) -> None:
    with (
        run.store.writing(name, key) as path,
        path.open("w", encoding="utf-8", newline="") as stream,
    ):
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(rows)


def _subtitle(run: Run, n_shapes: int, seconds: Mapping[str, float]) -> str:
    parts = ", ".join(run.study.settings.part_names)
    total = sum(seconds.values())
    return f"{n_shapes} shapes of {parts}; this run took {total:.0f} s; Ostiform {__version__}"


def _state_view(prepared: Prepared, maps: ShapeMaps, facts: Mapping[str, Any]) -> StateView:
    """Choose the part with the most openings, the one that is hardest to map."""
    openings = [
        (sum(name.startswith(f"{part}.") for name in embedding.component.rims), number, part)
        for number, embedding in enumerate(maps.embeddings)
        for part in embedding.component.parts
    ]
    _, number, part = max(openings, key=lambda item: (item[0], -item[1]))
    embedding: Embedding = maps.embeddings[number]
    spheres = prepared.domain.spheres
    index = next(i for i, s in enumerate(spheres) if s.name == embedding.component.name)
    controls = facts["control_points"]
    directions = np.array(
        [
            direction
            for group in ("interior", "boundary")
            for direction, sphere in zip(
                controls[group]["directions"], controls[group]["sphere"], strict=True
            )
            if sphere == index
        ]
    ).reshape(-1, 3)
    return StateView(
        embedding,
        spheres[index],
        part,
        paper_states(embedding.component, spheres[index], embedding.rotations),
        directions,
    )


def _run_facts(run: Run, prepared: Prepared, facts: Mapping[str, Any]) -> dict[str, str]:
    settings = run.study.settings.model_dump(mode="json", exclude={"ostia"})
    circles = {
        name: f"centre {np.round(circle.center, 3).tolist()}, "
        f"radius {np.degrees(circle.radius):.1f} degrees"
        for sphere in prepared.domain.spheres
        for name, circle in sphere.curves.items()
    }
    return {
        "ostiform": __version__,
        "python": platform.python_version(),
        **{name: version(name) for name in LIBRARIES},
        "study": str(run.study.path.name),
        "noise (mm)": f"{facts['noise_mm']:.3f}",
        "l_cut (mm²)": f"{facts['l_cut_mm2']:.5f}",
        **{f"settings: {name}": json.dumps(value) for name, value in settings.items()},
        "settings: correspondence, complete": json.dumps(facts["settings"]),
        **{f"circle {name}": text for name, text in circles.items()},
        "hash of all inputs": prepared.domain_key[:16],
    }


def _notes(prepared: Prepared, failures: Sequence[Failure]) -> list[tuple[str, str]]:
    names = {shape.name: str(shape.id) for shape in prepared.ready}
    return [
        *(
            (str(failure.id), f"left out ({failure.stage}): {failure.reason}")
            for failure in failures
        ),
        *(
            (names.get(name, name), repair)
            for name, repairs in prepared.repairs.items()
            for repair in repairs
        ),
    ]
