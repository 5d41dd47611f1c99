"""Further shapes in a finished model: embedded, placed and analysed, the others left as they are.

Artifacts, in a new folder: ``correspondence.h5`` and ``model.h5`` (both also in ``optimal/``),
``warps.h5``, ``opened/``, ``shapes/`` and ``embeddings/`` of the new shapes, ``scores.csv``,
``volumes.csv``, ``clinical.csv``, the fields, ``domain.json``, ``correspondence.json``,
``failed.json`` and ``added.json``.
"""

import shutil
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ostiform.artifacts import save
from ostiform.correspondence import (
    Correspondence,
    Placed,
    place,
    sampler,
    side_by_side,
    tied_rims,
    with_tied_rims,
)
from ostiform.embedding import Embeddings
from ostiform.errors import InputError
from ostiform.evaluation import OriginalMesh, shape_coverage
from ostiform.execution import Workers
from ostiform.model import (
    StoredModel,
    analysed,
    corresponded_shapes,
    read_frozen,
    read_warps,
    write_correspondence,
    write_warps,
)
from ostiform.pipeline.carried_fields import (
    carried_fields,
    fields_of_all,
    read_fields,
    write_fields,
)
from ostiform.pipeline.correspond import WARPS
from ostiform.pipeline.embed import embedding_artifact
from ostiform.pipeline.events import Note, OnEvent, Progress
from ostiform.pipeline.finished import (
    FinishedModel,
    embedded_in,
    finished_model,
    new_entries,
    read_named,
)
from ostiform.pipeline.landmarks import stated_marks
from ostiform.pipeline.results import Writer, copy_artifact, result_files, write_all
from ostiform.pipeline.store import Store, key_of, slug
from ostiform.study import (
    Shape,
    ShapeId,
    read_study,
)


@dataclass(frozen=True, slots=True)
class AddedShape:
    """One shape that was added.

    Attributes
    ----------
    subject, phase : str
    residue_mm : float
        Weighted RMS distance of its points from the best shape of the model without it.
    coverage_p95_mm : float
        95 % over area of the distance from its surface to the sampled one.
    """

    subject: str
    phase: str
    residue_mm: float
    coverage_p95_mm: float

    @property
    def name(self) -> str:
        """As all commands call it."""
        return str(ShapeId(self.subject, self.phase, 0.0))


@dataclass(frozen=True, slots=True)
class Addition:
    """What an addition made.

    Attributes
    ----------
    output : Path
    before, after : int
        Shapes in the model.
    added : tuple of AddedShape
    """

    output: Path
    before: int
    after: int
    added: tuple[AddedShape, ...]

    def as_json(self) -> dict[str, Any]:
        """Return the summary as plain values."""
        return {
            **asdict(self),
            "output": str(self.output),
            "added": [asdict(a) for a in self.added],
        }


def add_shapes(
    results: Path,
    study_path: Path,
    output: Path,
    wanted: Sequence[str] = (),
    on_event: OnEvent | None = None,
) -> Addition:
    """Add the shapes of a study that a finished model does not have yet.

    The base domain, the template, the weights and the points, alignment and transforms of all
    shapes of the model stay bit for bit; a new shape is embedded in the domain, warped against the
    frozen model (see `place`) and aligned to its mean; then the principal
    components are computed afresh from all.

    Parameters
    ----------
    results : Path
        Of a build.
    study_path : Path
        The build's study, in which the new shapes are listed too; the files of the others are not
        read again.
    output : Path
        A new folder.
    wanted : sequence of str
        ``SUBJECT`` or ``SUBJECT/PHASE``; empty for every new shape of the study.
    on_event : callable, optional

    Raises
    ------
    InputError
        If there is nothing new, a wanted shape is unknown or there already, or the output is the
        results folder itself.
    ArtifactError
        If the results are not those of a build.
    OstiformError
        If a new shape cannot be read, mapped or placed.
    """
    watch: OnEvent = on_event or (lambda _: None)
    if output.resolve() == results.resolve():
        raise InputError(f"{output}: expected another folder than the results that are added to")
    study = read_study(study_path)
    finished = finished_model(results)
    entries = new_entries(study, finished, wanted)
    watch(Progress("add", 0, len(entries)))
    store = Store(output)
    key = key_of("added", str(results.resolve()), [str(entry.id) for entry in entries])
    prepared = read_named(study, finished, entries, store)
    shapes = [one.shape for one in prepared]
    embeddings = embedded_in(study, finished, prepared)
    frozen = read_frozen(results / WARPS)
    ids = [shape.id for shape in shapes]
    samplers = [
        replace(sampler(own, finished.domain), marks=marks)
        for own, marks in zip(embeddings, stated_marks(study, ids), strict=True)
    ]
    placed = place(samplers, ids, frozen)
    before = finished.correspondence
    shared = study.settings.ostia.shared
    tied = tied_rims(before.template, before.aligned.mean(axis=0), shared)
    placed = replace(placed, points=with_tied_rims(placed.points, tied))
    watch(Note(f"placed {len(ids)} shapes"))
    correspondence, stored, residues = _refitted(finished.correspondence, ids, placed)
    added = tuple(
        AddedShape(
            shape.id.subject,
            shape.id.phase,
            residue,
            shape_coverage(_original(shape), points, points, correspondence.template.faces).p95,
        )
        for shape, points, residue in zip(shapes, placed.points, residues, strict=True)
    )
    for shape, own in zip(shapes, embeddings, strict=True):
        with store.writing(embedding_artifact(slug(shape.id)), key) as path:
            save(path, own, Embeddings)
    _write(store, key, finished, correspondence, stored)
    if known := read_fields(finished.store):
        mesh = stored.model.mesh
        with Workers(1) as pool:
            new = carried_fields(study.settings, entries, placed.points, mesh, pool)
        write_fields(store, key, correspondence.ids, fields_of_all(known, new, len(ids)))
    warps = side_by_side(read_warps(results / WARPS), placed.warps)
    with store.writing(WARPS, key) as path:
        write_warps(
            path, replace(frozen, ids=warps.ids, transforms=correspondence.transforms), warps
        )
    addition = Addition(output, len(finished.correspondence.ids), len(correspondence.ids), added)
    store.write_json("added.json", key, {"results": str(results.resolve()), **addition.as_json()})
    watch(Progress("add", len(entries), len(entries)))
    return addition


def _refitted(
    before: Correspondence,
    new: Sequence[ShapeId],
    placed: Placed,
) -> tuple[Correspondence, StoredModel, list[float]]:
    linear = placed.transforms[:, None, :3, :3]
    aligned = (linear @ placed.points[..., None])[..., 0] + placed.transforms[:, None, :3, 3]
    old = analysed(corresponded_shapes(before)).model
    left = aligned - old.reconstruct(old.project(aligned))  # (n, P, 3)
    residues = np.sqrt((left**2).sum(axis=2) @ before.weights)
    ids: tuple[ShapeId, ...] = (*before.ids, *new)
    after = Correspondence(
        template=before.template,
        ids=ids,
        directions=np.concatenate([before.directions, placed.directions]),
        points=np.concatenate([before.points, placed.points]),
        aligned=np.concatenate([before.aligned, aligned]),
        transforms=np.concatenate([before.transforms, placed.transforms]),
        weights=before.weights,
    )
    stored = analysed(corresponded_shapes(after), after.template)
    return after, stored, [float(value) for value in residues]


def _write(
    store: Store,
    key: str,
    finished: FinishedModel,
    correspondence: Correspondence,
    stored: StoredModel,
) -> None:
    files: dict[str, Writer] = {
        "correspondence.h5": partial(write_correspondence, correspondence=correspondence),
        **result_files(stored, corresponded_shapes(correspondence)),
    }
    for name in ("domain.json", "correspondence.json", "failed.json"):
        files[name] = partial(shutil.copyfile, finished.store.path(name))
    write_all(store, key, files)
    for name in ("correspondence.h5", "model.h5"):
        copy_artifact(store, name, f"optimal/{name}", key)


def _original(shape: Shape) -> OriginalMesh:
    parts = list(shape.parts.values())
    offsets = np.cumsum([0, *(len(part.vertices) for part in parts)])
    return OriginalMesh(
        np.vstack([part.vertices for part in parts]),
        np.vstack([part.faces + o for part, o in zip(parts, offsets[:-1], strict=True)]),
    )
