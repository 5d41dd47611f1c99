"""The maps of a run as results: the numbers of all of them, and one part step by step.

Artifacts: ``maps.bin`` (certificates, distortions and histograms of every map, and the kinks
across the seams) and ``paper-chain.bin`` (the map of the component that the report draws, and the
states of the paper's own chain on it).
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace

from ostiform.artifacts import load, save
from ostiform.correspondence import Correspondence
from ostiform.domain import BaseDomain
from ostiform.embedding import Embedding, Embeddings, paper_states
from ostiform.evaluation import MapRecord, MapRecords, map_record, sampled_kinks
from ostiform.execution import Executor
from ostiform.pipeline.embed import embedding_artifact
from ostiform.pipeline.run import Ready, Run
from ostiform.pipeline.store import Store, key_of

MAPS = "maps.bin"
PAPER_CHAIN = "paper-chain.bin"


def write_maps(
    run: Run,
    shapes: Iterable[Ready],
    domain: BaseDomain,
    correspondence: Correspondence,
    correspondence_key: str,
) -> None:
    """Write the numbers of the maps of all shapes, and the steps of the one that is shown."""
    shapes = tuple(shapes)
    store, stated = run.store, run.study.settings.report
    key = key_of("maps", [shape.key for shape in shapes], correspondence_key)
    if not store.is_current(MAPS, key):
        records = map_records(store, shapes, run.workers)
        with store.writing(MAPS, key) as path:
            save(path, MapRecords(records, sampled_kinks(correspondence, domain)))
    shown = next((shape for shape in shapes if str(shape.id) == stated.shape), shapes[0])
    key = key_of("paper chain", shown.key, stated.part)
    if not store.is_current(PAPER_CHAIN, key):
        chain = shown_map(store, shown.name, stated.part, domain)
        with store.writing(PAPER_CHAIN, key) as path:
            save(path, chain, Embeddings)


def map_records(store: Store, shapes: Iterable[Ready], workers: Executor) -> tuple[MapRecord, ...]:
    """Return what is kept of the maps of every shape, in their order."""
    tasks = [(store, shape) for shape in shapes]
    found: dict[int, MapRecord] = {}
    for outcome in workers.each(_record, tasks):
        found[outcome.index] = outcome.result
    return tuple(found[index] for index in range(len(tasks)))


def _record(task: tuple[Store, Ready]) -> MapRecord:
    store, shape = task
    return map_record(str(shape.id), load(store.path(embedding_artifact(shape.name)), Embeddings))


def shown_map(
    store: Store, name: str, part: str | None, domain: BaseDomain
) -> tuple[Embedding, Embedding]:
    """Return the map of the component that holds a part, and the same with the paper's states.

    Parameters
    ----------
    store : Store
    name : str
        Of the shape's artifacts.
    part : str or None
        Default the part with the most openings, the one that is hardest to map.
    domain : BaseDomain
    """
    embeddings = load(store.path(embedding_artifact(name)), Embeddings)
    used = embeddings[chosen_part(embeddings, part)[0]]
    sphere = next(sphere for sphere in domain.spheres if sphere.name == used.component.name)
    if not sphere.rims and not sphere.seams:
        return used, replace(used, states=())  # no opening that the paper's chain could start from
    rotations = {name: curve.first_angle for name, curve in used.curves.items()}
    return used, replace(used, states=paper_states(used.component, sphere, rotations))


def chosen_part(embeddings: Sequence[Embedding], part: str | None) -> tuple[int, str]:
    """Return the component and the part that are shown: the part named, or the most opened."""
    candidates = [
        (sum(name.startswith(f"{own}.") for name in embedding.component.rims), number, own)
        for number, embedding in enumerate(embeddings)
        for own in embedding.component.parts
        if part is None or own == part
    ]
    _, number, chosen = max(candidates, key=lambda item: (item[0], -item[1]))
    return number, chosen
