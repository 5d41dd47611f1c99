"""A finished model, and new shapes of its study: read, named and mapped to its spheres."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ostiform.arrays import FloatArray, frozen_floats
from ostiform.artifacts import load
from ostiform.correspondence import Correspondence, CorrespondenceSettings
from ostiform.domain import BaseDomain, domain_from_json, population_poses
from ostiform.embedding import Embeddings, EmbeddingSettings, embed, population_problems
from ostiform.errors import ArtifactError, EmbeddingError, InputError
from ostiform.execution import Workers
from ostiform.model import read_correspondence
from ostiform.pipeline.embed import embedding_artifact
from ostiform.pipeline.ingest import ingest_shapes, name_shapes, opened_artifact, stored_survey
from ostiform.pipeline.prepare import prepared_shapes, read_poses
from ostiform.pipeline.prepared import PreparedShape, read_prepared, read_shape, shape_artifact
from ostiform.pipeline.run import Run
from ostiform.pipeline.store import Store, slug
from ostiform.pipeline.tube_ends import known_tube_ends
from ostiform.study import ShapeEntry, Study


@dataclass(frozen=True, slots=True, eq=False)
class FinishedModel:
    """What the results of a build say that shapes are added to.

    Attributes
    ----------
    store : Store
    correspondence : Correspondence
    domain : BaseDomain
    settings : CorrespondenceSettings
    noise_mm : float
    l_cut : float, mm^2
    failed : tuple of (str, str, str)
        Subject, phase and stage of the shapes that the build left out.
    """

    store: Store
    correspondence: Correspondence
    domain: BaseDomain
    settings: CorrespondenceSettings
    noise_mm: float
    l_cut: float
    failed: tuple[tuple[str, str, str], ...]


def finished_model(results: Path) -> FinishedModel:
    """Read the results of a build.

    Raises
    ------
    ArtifactError
        If they are not those of a build.
    """
    store = Store(results)
    correspondence = read_correspondence(results / "correspondence.h5")
    facts = store.read_json("correspondence.json")
    failed = store.read_json("failed.json")
    try:
        stated = CorrespondenceSettings(**facts["settings"])
        return FinishedModel(
            store,
            correspondence,
            domain_from_json(store.read_json("domain.json")),
            replace(stated, coherence=float(facts["coherence"])),
            float(facts["noise_mm"]),
            float(facts["l_cut_mm2"]),
            tuple((item["subject"], item["phase"], item["stage"]) for item in failed),
        )
    except (KeyError, TypeError, ValueError) as error:
        raise ArtifactError(
            f"{results}: expected the results of `ostiform build`, found others ({error}): shapes "
            "can only be added to a model that this program built"
        ) from error


def new_entries(study: Study, finished: FinishedModel, wanted: Sequence[str]) -> list[ShapeEntry]:
    """Return the entries of a study that a model does not have: all, or those wanted.

    Raises
    ------
    InputError
        If there are none, or a wanted one is unknown or there already.
    """
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


def read_named(
    study: Study, finished: FinishedModel, entries: Sequence[ShapeEntry], store: Store
) -> list[PreparedShape]:
    """Read and prepare the new shapes, their openings named over the whole population."""
    known = [
        stored_survey(finished.store, slug(id))
        for id in finished.correspondence.ids
        if finished.store.path(opened_artifact(slug(id))).is_file()
    ]
    shapes = study.settings.shapes.model_copy(update={"on_error": "stop"})
    settings = study.settings.model_copy(update={"shapes": shapes})
    new = replace(study, settings=settings, entries=tuple(entries))
    with Workers(1) as pool:
        run = Run(new, store, pool, lambda event: None)
        ends = known_tube_ends(finished.store)
        found, _ = prepared_shapes(run, name_shapes(run, ingest_shapes(run), known), ends)
    return [read_prepared(store.path(shape_artifact(ready.name))) for ready, _ in found]


def _poses(study: Study, finished: FinishedModel, new: Sequence[PreparedShape]) -> FloatArray:
    """Return the poses (n, 4, 4) of new shapes in the frame that the domain was laid out in."""
    stored = read_poses(finished.store)
    known = [read_shape(finished.store.path(shape_artifact(slug(one.id)))) for one in stored]
    trusted = study.settings.alignment.frame == "files"
    found = population_poses([*known, *(one.shape for one in new)], trusted)
    anchor = found.reference if found.reference < len(known) else 0
    frame = stored[anchor].transform @ np.linalg.inv(found.transforms[anchor])
    return frozen_floats(frame @ found.transforms[len(known) :], (len(new), 4, 4), "poses")


def embedded_in(
    study: Study, finished: FinishedModel, shapes: Sequence[PreparedShape]
) -> list[Embeddings]:
    """Map new shapes to the spheres of a finished model.

    Raises
    ------
    InputError
        If a shape has other components.
    EmbeddingError
        If a map is not certified.
    """
    spheres = {sphere.name: sphere for sphere in finished.domain.spheres}
    settings = EmbeddingSettings(method=study.settings.embedding.method)
    known = [
        load(finished.store.path(embedding_artifact(slug(id))), Embeddings)
        for id in finished.correspondence.ids
    ]
    made = []
    for prepared, pose in zip(shapes, _poses(study, finished, shapes), strict=True):
        shape, components = prepared.shape, prepared.components
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
