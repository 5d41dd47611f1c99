"""Further shapes in a finished model: embedded, placed and analysed, the others left as they are.

Artifacts, in a new folder: ``correspondence.h5`` and ``model.h5`` (both also in ``optimal/``),
``shapes/`` and ``embeddings/`` of the new shapes, ``scores.csv``, ``volumes.csv``,
``domain.json``, ``correspondence.json``, ``failed.json`` and ``added.json``.
"""

import shutil
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ostiform.arrays import FloatArray, frozen_floats
from ostiform.correspondence import (
    Correspondence,
    CorrespondenceSettings,
    Placed,
    TrainedCorrespondence,
    place,
    sampler,
    trained_from,
)
from ostiform.domain import BaseDomain, domain_from_json, population_poses
from ostiform.embedding import Embedding, EmbeddingSettings, embed, population_problems
from ostiform.errors import ArtifactError, EmbeddingError, InputError
from ostiform.evaluation import OriginalMesh, part_volumes, shape_coverage
from ostiform.exchange import write_scores_csv, write_volumes_csv
from ostiform.model import (
    StoredModel,
    fit_model,
    mesh_of_template,
    project,
    read_correspondence,
    reconstruct,
    write_correspondence,
    write_model,
)
from ostiform.pipeline.arrays_file import read_embeddings, write_embeddings, write_shape
from ostiform.pipeline.arrays_file import read_shape as read_stored_shape
from ostiform.pipeline.embed import embedding_artifact
from ostiform.pipeline.events import Note, Progress, Tell
from ostiform.pipeline.prepare import prepared_components, shape_artifact
from ostiform.pipeline.store import Store, key_of, slug
from ostiform.study import (
    Shape,
    ShapeEntry,
    ShapeId,
    Study,
    named_population,
    read_shape,
    read_study,
    survey_from_json,
    survey_shape,
)

__all__ = ["AddedShape", "Addition", "add_shapes"]

READ_STAGES = ("look", "read")


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
    tell: Tell | None = None,
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
    tell : callable, optional

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
    watch: Tell = tell or (lambda _: None)
    if output.resolve() == results.resolve():
        raise InputError(f"{output}: expected another folder than the results that are added to")
    study = read_study(study_path)
    finished = _finished(results)
    entries = _new_entries(study, finished, wanted)
    watch(Progress("add", 0, len(entries)))
    store = Store(output)
    key = key_of("added", str(results.resolve()), [str(entry.id) for entry in entries])
    shapes = _read(study, finished, entries)
    embeddings = _embedded(study, finished, shapes)
    placed, trained = _placed(finished, shapes, embeddings, watch)
    correspondence, stored, residues = _refitted(finished.correspondence, shapes, placed, trained)
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
        with store.writing(shape_artifact(slug(shape.id)), key) as path:
            write_shape(path, shape)
        with store.writing(embedding_artifact(slug(shape.id)), key) as path:
            write_embeddings(path, own)
    _write(store, key, finished, correspondence, stored)
    addition = Addition(output, len(finished.correspondence.ids), len(correspondence.ids), added)
    store.write_json("added.json", key, {"results": str(results.resolve()), **addition.as_json()})
    watch(Progress("add", len(entries), len(entries)))
    return addition


@dataclass(frozen=True, slots=True, eq=False)
class _Finished:
    store: Store
    correspondence: Correspondence
    domain: BaseDomain
    settings: CorrespondenceSettings
    noise_mm: float
    l_cut: float
    failed: tuple[tuple[str, str, str], ...]


def _finished(results: Path) -> _Finished:
    store = Store(results)
    correspondence = read_correspondence(results / "correspondence.h5")
    facts = store.read_json("correspondence.json")
    failed = store.read_json("failed.json")
    try:
        return _Finished(
            store,
            correspondence,
            domain_from_json(store.read_json("domain.json")),
            CorrespondenceSettings(**facts["settings"]),
            float(facts["noise_mm"]),
            float(facts["l_cut_mm2"]),
            tuple((item["subject"], item["phase"], item["stage"]) for item in failed),
        )
    except (KeyError, TypeError, ValueError) as error:
        raise ArtifactError(
            f"{results}: expected the results of `ostiform build`, found others ({error}): shapes "
            "can only be added to a model that this program built"
        ) from error


def _new_entries(study: Study, finished: _Finished, wanted: Sequence[str]) -> list[ShapeEntry]:
    known = {(id.subject, id.phase) for id in finished.correspondence.ids}
    left_out = {(subject, phase) for subject, phase, _ in finished.failed}
    by_name: dict[str, list[ShapeEntry]] = {}
    for entry in study.entries:
        by_name.setdefault(entry.id.subject, []).append(entry)
        by_name.setdefault(str(entry.id), []).append(entry)
    for name in wanted:
        if name not in by_name:
            raise InputError(
                f"{name}: expected a shape SUBJECT/PHASE or a subject of {study.path}, found "
                f"neither among its {len(study.entries)} shapes: list the new shape in the study"
            )
        if all((e.id.subject, e.id.phase) in known for e in by_name[name]):
            raise InputError(f"{name}: expected a new shape, found it in the model already")
    chosen = {str(entry.id) for name in wanted for entry in by_name[name]}
    entries = [
        entry
        for entry in study.entries
        if (entry.id.subject, entry.id.phase) not in known
        and (
            str(entry.id) in chosen
            if wanted
            else (entry.id.subject, entry.id.phase) not in left_out
        )
    ]
    if not entries:
        raise InputError(
            f"{study.path}: expected shapes that the model does not have, found none: list the new "
            "shapes in the study"
        )
    return entries


def _read(study: Study, finished: _Finished, entries: Sequence[ShapeEntry]) -> list[Shape]:
    """Read the new shapes, their openings named over the whole population."""
    surveys = [survey_shape(study, entry) for entry in entries]
    known = [
        survey_from_json(finished.store.read_json(name))
        for name in (f"surveys/{slug(id)}.json" for id in finished.correspondence.ids)
        if finished.store.path(name).is_file()
    ]
    population = named_population(study.settings, [*known, *surveys])
    shapes = []
    for entry in entries:
        if entry.id in population.problems:
            raise InputError(f"shape {entry.id}: {population.problems[entry.id]}")
        shapes.append(read_shape(study, entry, population.names[entry.id]))
    return shapes


def _poses(study: Study, finished: _Finished, shapes: Sequence[Shape]) -> FloatArray:
    """Return the poses (n, 4, 4) of new shapes in the frame that the domain was laid out in."""
    unread = {(s, p) for s, p, stage in finished.failed if stage in READ_STAGES}
    mapped = {(id.subject, id.phase) for id in finished.correspondence.ids}
    mapped |= {(s, p) for s, p, stage in finished.failed if stage not in READ_STAGES}
    order = [
        entry.id for entry in study.entries if (entry.id.subject, entry.id.phase) in mapped - unread
    ]
    stored = np.asarray(finished.store.read_json("poses.json"), dtype=np.float64)
    if stored.shape != (len(order), 4, 4):
        raise ArtifactError(
            f"{finished.store.path('poses.json')}: expected the poses of the {len(order)} shapes "
            f"that {study.path} and the results share, found an array of shape {stored.shape}: "
            "keep the shapes of the build listed in the study"
        )
    known = [read_stored_shape(finished.store.path(shape_artifact(slug(id)))) for id in order]
    found = population_poses([*known, *shapes])
    anchor = found.reference if found.reference < len(known) else 0
    frame = stored[anchor] @ np.linalg.inv(found.transforms[anchor])
    return frozen_floats(frame @ found.transforms[len(known) :], (len(shapes), 4, 4), "poses")


def _embedded(
    study: Study, finished: _Finished, shapes: Sequence[Shape]
) -> list[tuple[Embedding, ...]]:
    spheres = {sphere.name: sphere for sphere in finished.domain.spheres}
    settings = EmbeddingSettings(method=study.settings.embedding.method)
    known = [
        read_embeddings(finished.store.path(embedding_artifact(slug(id))))
        for id in finished.correspondence.ids
    ]
    made = []
    for shape, pose in zip(shapes, _poses(study, finished, shapes), strict=True):
        components, _ = prepared_components(shape)
        for component in components:
            if component.name not in spheres:
                raise InputError(
                    f"shape {shape.id}: expected the components {', '.join(spheres)}, found "
                    f"{component.name}: its parts and seams differ from the model's"
                )
        own = tuple(embed(c, spheres[c.name], settings, pose) for c in components)
        problems = [problem for e in own for problem in e.certificate.problems]
        for number, embedding in enumerate(own):
            others = [item[number].certificate for item in known]
            problems += population_problems([*others, embedding.certificate])[-1]
        if problems:
            raise EmbeddingError(f"{shape.id}: the map is not certified: {'; '.join(problems)}")
        made.append(own)
    return made


def _placed(
    finished: _Finished,
    shapes: Sequence[Shape],
    embeddings: Sequence[tuple[Embedding, ...]],
    tell: Tell,
) -> tuple[Placed, TrainedCorrespondence]:
    trained = trained_from(
        finished.correspondence,
        finished.domain,
        finished.settings,
        finished.noise_mm,
        finished.l_cut,
    )
    samplers = [sampler(own, finished.domain) for own in embeddings]
    count = len(trained.mean)
    directions = np.empty((len(shapes), count, 3))
    points, transforms = np.empty_like(directions), np.empty((len(shapes), 4, 4))
    subjects = [shape.id.subject for shape in shapes]
    for subject in dict.fromkeys(subjects):
        own_shapes = [index for index, name in enumerate(subjects) if name == subject]
        result = place(
            [samplers[index] for index in own_shapes],
            trained,
            jointly=finished.settings.per == "subject",
            transform=_known_transform(finished, subject),
        )
        directions[own_shapes] = result.directions
        points[own_shapes] = result.points
        transforms[own_shapes] = result.transforms
        tell(Note(f"placed {subject}: {len(own_shapes)} shapes"))
    return Placed(directions, points, transforms), trained


def _known_transform(finished: _Finished, subject: str) -> FloatArray | None:
    if finished.settings.per == "subject":
        for index, id in enumerate(finished.correspondence.ids):
            if id.subject == subject:
                transform: FloatArray = finished.correspondence.transforms[index]
                return transform
    return None


def _refitted(
    before: Correspondence,
    shapes: Sequence[Shape],
    placed: Placed,
    trained: TrainedCorrespondence,
) -> tuple[Correspondence, StoredModel, list[float]]:
    linear = placed.transforms[:, None, :3, :3]
    aligned = (linear @ placed.points[..., None])[..., 0] + placed.transforms[:, None, :3, 3]
    mesh = mesh_of_template(before.template)
    old = fit_model(before.aligned, before.weights, mesh)
    left = aligned - reconstruct(old, project(old, aligned))  # (n, P, 3)
    residues = np.sqrt((left**2).sum(axis=2) @ before.weights)
    ids: tuple[ShapeId, ...] = (*before.ids, *(shape.id for shape in shapes))
    after = Correspondence(
        template=trained.yardstick.template,
        ids=ids,
        directions=np.concatenate([before.directions, placed.directions]),
        points=np.concatenate([before.points, placed.points]),
        aligned=np.concatenate([before.aligned, aligned]),
        transforms=np.concatenate([before.transforms, placed.transforms]),
        weights=before.weights,
    )
    model = fit_model(after.aligned, after.weights, mesh)
    stored = StoredModel(model, project(model, after.aligned), ids, after.template)
    return after, stored, [float(value) for value in residues]


def _write(
    store: Store,
    key: str,
    finished: _Finished,
    correspondence: Correspondence,
    stored: StoredModel,
) -> None:
    with store.writing("correspondence.h5", key) as path:
        write_correspondence(path, correspondence)
    with store.writing("model.h5", key) as path:
        write_model(path, stored)
    for name in ("correspondence.h5", "model.h5"):
        with store.writing(f"optimal/{name}", key) as path:
            shutil.copyfile(store.path(name), path)
    for name in ("domain.json", "correspondence.json", "failed.json"):
        with store.writing(name, key) as path:
            shutil.copyfile(finished.store.path(name), path)
    with store.writing("scores.csv", key) as path:
        write_scores_csv(path, stored)
    volumes = part_volumes(correspondence.points, stored.model.mesh)
    with store.writing("volumes.csv", key) as path:
        write_volumes_csv(path, correspondence.ids, volumes)


def _original(shape: Shape) -> OriginalMesh:
    parts = list(shape.parts.values())
    offsets = np.cumsum([0, *(len(part.vertices) for part in parts)])
    return OriginalMesh(
        np.vstack([part.vertices for part in parts]),
        np.vstack([part.faces + o for part, o in zip(parts, offsets[:-1], strict=True)]),
    )
