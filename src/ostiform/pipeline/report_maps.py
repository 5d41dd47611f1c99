"""The maps of a run for its report: the numbers of all of them, and one part step by step.

Artifact: ``paper-chain.bin``, the states of the paper's own chain on the component that is drawn.
"""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from ostiform.domain import BaseDomain
from ostiform.embedding import Embedding, EmbeddingState, paper_states
from ostiform.execution import Executor
from ostiform.pipeline.arrays_file import read_embeddings, write_embeddings
from ostiform.pipeline.embed import embedding_artifact
from ostiform.pipeline.run import Ready
from ostiform.pipeline.store import Store, key_of
from ostiform.report import MapRecord, StateView, map_record

PAPER_CHAIN = "paper-chain.bin"


def map_records(store: Store, shapes: Iterable[Ready], workers: Executor) -> list[MapRecord]:
    """Return what the report says about the maps of every shape, in their order."""
    tasks = [(store, shape) for shape in shapes]
    found: list[MapRecord | None] = [None] * len(tasks)
    for outcome in workers.each(_record, tasks):
        found[outcome.index] = outcome.result
    return [record for record in found if record is not None]


def _record(task: tuple[Store, Ready]) -> MapRecord:
    store, shape = task
    return map_record(str(shape.id), read_embeddings(store.path(embedding_artifact(shape.name))))


def state_view(
    store: Store,
    shape: Ready,
    part: str | None,
    domain: BaseDomain,
    facts: Mapping[str, Any],
) -> StateView:
    """Return the steps of the map of one part, those of the paper's chain beside them.

    Parameters
    ----------
    store : Store
    shape : Ready
        Whose map is drawn.
    part : str or None
        Default the part with the most openings, the one that is hardest to map.
    domain : BaseDomain
    facts : mapping
        Of the correspondence; holds the control points.
    """
    embeddings = read_embeddings(store.path(embedding_artifact(shape.name)))
    number, chosen = _chosen_part(embeddings, part)
    embedding = embeddings[number]
    index = next(i for i, s in enumerate(domain.spheres) if s.name == embedding.component.name)
    return StateView(
        str(shape.id),
        embedding,
        domain.spheres[index],
        chosen,
        _paper_states(store, shape, embedding, domain),
        _controls(facts, "interior", index),
        _controls(facts, "boundary", index),
    )


def _chosen_part(embeddings: tuple[Embedding, ...], part: str | None) -> tuple[int, str]:
    candidates = [
        (sum(name.startswith(f"{own}.") for name in embedding.component.rims), number, own)
        for number, embedding in enumerate(embeddings)
        for own in embedding.component.parts
        if part is None or own == part
    ]
    _, number, chosen = max(candidates, key=lambda item: (item[0], -item[1]))
    return number, chosen


def _paper_states(
    store: Store, shape: Ready, embedding: Embedding, domain: BaseDomain
) -> tuple[EmbeddingState, ...]:
    name = embedding.component.name
    key = key_of("paper chain", shape.key, name)
    sphere = next(sphere for sphere in domain.spheres if sphere.name == name)
    if not sphere.rims and not sphere.seams:
        return ()  # a closed surface has no opening that the paper's chain could project it from
    if not store.is_current(PAPER_CHAIN, key):
        states = paper_states(embedding.component, sphere, embedding.rotations)
        with store.writing(PAPER_CHAIN, key) as path:
            write_embeddings(path, [replace(embedding, states=states)])
    return read_embeddings(store.path(PAPER_CHAIN))[0].states


def _controls(facts: Mapping[str, Any], group: str, sphere: int) -> np.ndarray:
    """Control points (C, 3) of one group on one sphere."""
    stored = facts["control_points"][group]
    own = [d for d, s in zip(stored["directions"], stored["sphere"], strict=True) if s == sphere]
    return np.array(own, dtype=np.float64).reshape(-1, 3)
