"""Populations with known truth for `benchmarks.compare`: generated, embedded and cached once.

A case is a folder of the cache with the study (`benchmarks.populations`), its maps to the sphere
and what mapping cost. All methods get the same meshes in the same common pose.
"""

import json
import multiprocessing
import os
import resource
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from benchmarks.populations import EDGES_MM, family
from benchmarks.spoiling import spoiled
from ostiform.arrays import FloatArray
from ostiform.artifacts import load
from ostiform.correspondence import (
    CorrespondenceSettings,
    ShapeSampler,
    SharedMetric,
    build_shared_metric,
    sampler,
)
from ostiform.demo.demonstration import write_population
from ostiform.demo.truth import Truth, read_truth
from ostiform.domain import BaseDomain, domain_from_json
from ostiform.embedding import Embedding, Embeddings
from ostiform.evaluation import OriginalMesh
from ostiform.pipeline import Stage, build_study
from ostiform.pipeline.correspond import correspondence_settings
from ostiform.pipeline.prepare import read_poses
from ostiform.pipeline.store import Store, slug
from ostiform.study import ShapeId, read_study

Result = TypeVar("Result")
COSTS = "embedding_costs.json"
PREFIX_END = "-"


@dataclass(frozen=True, slots=True)
class CaseName:
    """Which population.

    Attributes
    ----------
    family : str
    subjects, phases, seed : int
    points : int
        Of the template.
    permuted : bool
        Whether the files come in another order.
    noise_mm, cuts_mm : float
        See `spoiling.spoiled`.
    """

    family: str
    subjects: int
    phases: int
    seed: int
    points: int
    permuted: bool = False
    noise_mm: float = 0.0
    cuts_mm: float = 0.0

    @property
    def folder(self) -> str:
        """Folder of the population in the cache; the points play no part in it."""
        order = "-permuted" if self.permuted else ""
        spoilt = f"-noise{self.noise_mm:g}" if self.noise_mm else ""
        spoilt += f"-cuts{self.cuts_mm:g}" if self.cuts_mm else ""
        return f"{self.family}-{self.subjects}x{self.phases}-seed{self.seed}{order}{spoilt}"


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """A population ready to be put into correspondence.

    Attributes
    ----------
    name : CaseName
    ids : tuple of ShapeId
    embeddings : tuple of tuple of Embedding
        By shape, one per component.
    samplers : tuple of ShapeSampler
    domain : BaseDomain
    poses : (N, 4, 4) float64
        From input coordinates to the population's common pose.
    truth : Truth
    settings : CorrespondenceSettings
        The defaults of a study, with the case's number of points.
    costs : mapping of str to float
        Processor and wall seconds and memory (MB) from surfaces to maps.
    """

    name: CaseName
    ids: tuple[ShapeId, ...]
    embeddings: tuple[tuple[Embedding, ...], ...]
    samplers: tuple[ShapeSampler, ...]
    domain: BaseDomain
    poses: FloatArray
    truth: Truth
    settings: CorrespondenceSettings
    costs: dict[str, float]

    def shared_metric(self) -> SharedMetric:
        """Return the template of the population and what all methods are measured with."""
        return build_shared_metric(self.samplers, self.ids, self.domain, self.poses, self.settings)

    def original(self, index: int) -> OriginalMesh:
        """Return the surface of a shape, all components in one mesh."""
        parts = [part.component for part in self.samplers[index].components]
        offsets = np.cumsum([0, *(len(part.vertices) for part in parts)])
        return OriginalMesh(
            np.vstack([part.vertices for part in parts]),
            np.vstack([part.faces + o for part, o in zip(parts, offsets[:-1], strict=True)]),
        )

    def selected(self, indices: Sequence[int]) -> "Case":
        """Return the case of some of the shapes, in the order given."""
        chosen = list(indices)
        return replace(
            self,
            ids=tuple(self.ids[i] for i in chosen),
            embeddings=tuple(self.embeddings[i] for i in chosen),
            samplers=tuple(self.samplers[i] for i in chosen),
            poses=self.poses[chosen],
        )


def prepared(cache: Path, name: CaseName) -> Path:
    """Return the folder of a population, made and embedded if it is not in the cache."""
    folder = cache / name.folder
    if not (folder / COSTS).exists():
        truth = family(name.family, name.subjects, name.phases, name.seed)
        study = write_population(folder, truth, EDGES_MM[name.family])
        spoiled(folder, truth, name.noise_mm, name.cuts_mm)
        if name.permuted:
            permute_sheet(folder / "shapes.csv", name.seed)
        costs = in_new_process(_embedded, study, folder / "out")
        (folder / COSTS).write_text(json.dumps(costs), encoding="utf-8")
    return folder


def permute_sheet(path: Path, seed: int) -> None:
    """Shuffle the rows of a sheet and give the subjects names that sort in another order too.

    Studies are read in the order of names, so that the order of rows alone would change nothing.
    """
    heading, *rows = path.read_text(encoding="utf-8").splitlines()
    generator = np.random.default_rng([seed, 3])
    subjects = list(dict.fromkeys(row.split(",")[0] for row in rows))
    places = generator.permutation(len(subjects))
    while len(subjects) > 1 and (places == np.arange(len(subjects))).all():
        places = generator.permutation(len(subjects))
    prefixes = {name: f"{place:03d}" for name, place in zip(subjects, places, strict=True)}
    renamed = [f"{prefixes[row.split(',')[0]]}{PREFIX_END}{row}" for row in rows]
    shuffled = [heading, *(renamed[index] for index in generator.permutation(len(rows)))]
    path.write_text("\n".join(shuffled) + "\n", encoding="utf-8")


def _embedded(study: Path, output: Path) -> dict[str, float]:
    with tempfile.TemporaryDirectory() as discarded:
        build_study(study, Path(discarded), until=Stage.EMBED, workers=1)  # compiles the kernels
    processor, wall = time.process_time(), time.monotonic()
    build_study(study, output, until=Stage.EMBED, workers=1)
    return {
        "cpu_s": time.process_time() - processor,
        "wall_s": time.monotonic() - wall,
        "memory_mb": peak_memory_mb(),
    }


def in_new_process(function: Callable[..., Result], *given: object) -> Result:
    """Return what a function returns in a process of its own, with one thread."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(function, given)


def loaded(cache: Path, name: CaseName) -> Case:
    """Return a population of the cache; see `prepared`."""
    folder = prepared(cache, name)
    study = read_study(folder / "study.toml")
    out = folder / "out"
    domain = domain_from_json(json.loads((out / "domain.json").read_text(encoding="utf-8")))
    ids = tuple(entry.id for entry in study.entries)
    left_out = json.loads((out / "failed.json").read_text(encoding="utf-8"))
    if left_out:
        raise SystemExit(f"{folder}: {len(left_out)} shapes were left out: {left_out[0]}")
    embeddings = tuple(load(out / "embeddings" / f"{slug(id)}.bin", Embeddings) for id in ids)
    return Case(
        name=name,
        ids=ids,
        embeddings=embeddings,
        samplers=tuple(sampler(own, domain) for own in embeddings),
        domain=domain,
        poses=np.array([one.transform for one in read_poses(Store(out))]),
        truth=read_truth(folder / "truth" / "truth.json"),
        settings=replace(correspondence_settings(study), n_points=name.points),
        costs=json.loads((folder / COSTS).read_text(encoding="utf-8")),
    )


def peak_memory_mb() -> float:
    """Return the largest memory of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
