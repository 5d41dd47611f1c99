"""Stage 6: the report, rendered from artifacts only.

Artifacts: ``report.html`` and the files of its figures in ``figures/``.
"""

import json
import platform
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from typing import Any

import numpy as np

from ostiform import __version__
from ostiform.correspondence import KINDS
from ostiform.embedding import Embedding, paper_states
from ostiform.evaluation import Evaluation, compare, read_evaluation
from ostiform.model import read_correspondence, read_model
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
    evidence_section,
    headline,
    maps_section,
    modes_section,
    render_page,
    run_section,
    save_picture,
    scores_section,
    template_section,
)

__all__ = ["report_run"]

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
    run.tell(Progress("report", 0, 2))
    evaluations: dict[str, Evaluation] = {
        kind: read_evaluation(store.path(f"{kind}/evaluation.json")) for kind in KINDS
    }
    comparisons = [compare(evaluations["optimal"], evaluations[kind]) for kind in KINDS[:-1]]
    correspondence = read_correspondence(store.path("optimal/correspondence.h5"))
    stored = read_model(store.path("optimal/model.h5"))
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
        facts=headline(evaluations, comparisons, len(embedded.ready), len(run.study.entries)),
        sections=(
            evidence_section(evaluations, comparisons),
            modes_section(stored.model),
            scores_section(stored.model, stored.scores, evaluations["optimal"]),
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
    run.tell(Progress("report", 1, 2))
    for section in page.sections:
        for picture in section.pictures:
            save_picture(picture, store.path("figures"))
    with store.writing("report.html", key_of("report", corresponded.key)) as path:
        path.write_text(render_page(page), encoding="utf-8")
    run.tell(Progress("report", 2, 2))


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
