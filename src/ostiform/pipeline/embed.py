"""Stage 3: every component of every shape is mapped to its sphere, and the map is certified.

Artifacts: ``embeddings/NAME.bin``, one per shape, whether certified or not.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

from ostiform.arrays import FloatArray
from ostiform.artifacts import load, save
from ostiform.domain import BaseDomain, ConformalHoles
from ostiform.embedding import (
    Certificate,
    Embeddings,
    EmbeddingSettings,
    embed,
    population_problems,
)
from ostiform.errors import EmbeddingError
from ostiform.pipeline.events import Warn
from ostiform.pipeline.prepare import Prepared
from ostiform.pipeline.prepared import read_prepared, shape_artifact
from ostiform.pipeline.run import Failure, Ready, Run, over_shapes, survivors
from ostiform.pipeline.store import Store, key_of
from ostiform.study import EmbeddingMethod


@dataclass(frozen=True, slots=True, eq=False)
class Embedded:
    """The shapes with certified maps.

    Attributes
    ----------
    ready : tuple of Ready
        In study order; keys are those of the embeddings.
    index : tuple of int
        Place of each among the prepared shapes.
    failures : tuple of Failure
        Shapes without a certified map, with the reason.
    """

    ready: tuple[Ready, ...]
    index: tuple[int, ...]
    failures: tuple[Failure, ...]


def embed_shapes(run: Run, prepared: Prepared) -> Embedded:
    """Embed every prepared shape; those whose map is not certified are left out."""
    method = run.study.settings.embedding.method
    tasks = [
        _EmbedTask(
            run.store,
            shape,
            pose,
            prepared.holes.get(shape.name),
            prepared.domain,
            prepared.domain_key,
            method,
        )
        for shape, pose in zip(prepared.ready, prepared.poses, strict=True)
    ]
    ids = [shape.id for shape in prepared.ready]
    found, failures = over_shapes(run, "embed", _embed, tasks, ids)
    differing = _differing(run, [item for item in found if item is not None])
    lost = {failure.id for failure in differing}
    kept = [
        item.ready if item is not None and item.ready.id not in lost else None for item in found
    ]
    return Embedded(
        survivors(kept),
        tuple(index for index, shape in enumerate(kept) if shape is not None),
        (*failures, *differing),
    )


def embedding_artifact(name: str) -> str:
    """Return the artifact of a shape's embeddings."""
    return f"embeddings/{name}.bin"


@dataclass(frozen=True, slots=True, eq=False)
class _EmbedTask:
    store: Store
    shape: Ready
    pose: FloatArray
    holes: tuple[ConformalHoles, ...] | None
    domain: BaseDomain
    domain_key: str
    method: EmbeddingMethod


@dataclass(frozen=True, slots=True, eq=False)
class _Mapped:
    ready: Ready
    certificates: tuple[Certificate, ...]


def _embed(task: _EmbedTask) -> _Mapped:
    settings = EmbeddingSettings(method=task.method)
    key = key_of("embedding", task.shape.key, task.domain_key, task.method)
    artifact = embedding_artifact(task.shape.name)
    embeddings = task.store.read_current(artifact, key, partial(load, kind=Embeddings))
    if embeddings is None:
        components = read_prepared(task.store.path(shape_artifact(task.shape.name))).components
        spheres = {sphere.name: sphere for sphere in task.domain.spheres}
        holes = task.holes or (None,) * len(components)
        embeddings = tuple(
            embed(component, spheres[component.name], settings, task.pose, own)
            for component, own in zip(components, holes, strict=True)
        )
        with task.store.writing(artifact, key) as path:
            save(path, embeddings, Embeddings)
    problems = [problem for e in embeddings for problem in e.certificate.problems]
    if problems:
        raise EmbeddingError(f"{task.shape.id}: the map is not certified: {'; '.join(problems)}")
    return _Mapped(
        Ready(task.shape.id, task.shape.name, key), tuple(e.certificate for e in embeddings)
    )


def _differing(run: Run, mapped: Sequence[_Mapped]) -> list[Failure]:
    """Return the shapes whose maps are of another kind than the population's (winding, order)."""
    if not mapped:
        return []
    columns = zip(*(item.certificates for item in mapped), strict=True)
    per_component = [population_problems(list(column)) for column in columns]
    failures = []
    for item, problems in zip(mapped, zip(*per_component, strict=True), strict=True):
        reasons = [reason for component in problems for reason in component]
        if not reasons:
            continue
        reason = f"{item.ready.id}: its map differs from the others': {'; '.join(reasons)}"
        if run.study.settings.shapes.on_error == "stop":
            raise EmbeddingError(reason)
        run.on_event(Warn(f"{item.ready.id} left out: {reason}"))
        failures.append(Failure(item.ready.id, "embed", reason))
    return failures
