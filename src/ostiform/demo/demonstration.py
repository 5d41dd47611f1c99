"""The demonstration population: dynamic left hearts with exactly known correspondence."""

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.atomic import atomically
from ostiform.demo.contouring import canonical_points, extract
from ostiform.demo.deformation import Deformation
from ostiform.demo.implicit import Anatomy
from ostiform.demo.leftheart import left_heart, random_heart_subject
from ostiform.demo.truth import Truth, write_truth
from ostiform.demo.vessel_ends import RandomEnds
from ostiform.errors import InputError
from ostiform.study import ShapeId
from ostiform.surface import write_surface
from ostiform.tables import write_table

DEFAULT_EDGE_MM = 1.9
"""About 4,000 vertices on the LV and 2,600 on the LA."""
_TIME_JITTER = 0.15
"""Phases are unevenly timed, by up to this share of the mean interval."""


def write_demonstration(
    folder: Path,
    subjects: int = 4,
    shapes: int = 34,
    seed: int = 2004,
    edge_mm: float = DEFAULT_EDGE_MM,
    mapped: Callable[..., Iterable[Any]] = map,
) -> Path:
    """Write a population of dynamic left hearts as an ordinary study, with its truth beside.

    Parameters
    ----------
    folder : Path
        Made if it does not exist. Receives ``study.toml``, ``shapes.csv``, ``shapes/*.vtp`` and
        ``truth/truth.json``.
    subjects, shapes : int
        The shapes are shared out over the subjects as evenly as possible.
    seed : int
        Everything random follows from it.
    edge_mm : float
        Mean edge length of the meshes, mm.
    mapped : callable
        As in `write_population`.

    Returns
    -------
    Path
        Of ``study.toml``.

    Raises
    ------
    InputError
        If there are fewer shapes than subjects, or no subject.
    """
    return write_population(folder, demonstration_truth(subjects, shapes, seed), edge_mm, mapped)


def demonstration_truth(subjects: int = 4, shapes: int = 34, seed: int = 2004) -> Truth:
    """Return the parameters of the demonstration population, without making any mesh.

    Raises
    ------
    InputError
        If there are fewer shapes than subjects, or no subject.
    """
    if not 1 <= subjects <= shapes:
        raise InputError(
            f"demonstration: expected at least one subject and one shape for each, found "
            f"{subjects} subjects and {shapes} shapes; ask for more shapes"
        )
    deformations = {}
    for index, child in enumerate(np.random.SeedSequence(seed).spawn(subjects)):
        rng = np.random.default_rng(child)
        subject = random_heart_subject(rng)
        phases = shapes // subjects + (index < shapes % subjects)
        jitter = rng.uniform(-_TIME_JITTER, _TIME_JITTER, size=phases)
        jitter[0] = 0.0
        for phase, time in enumerate((np.arange(phases) + jitter) / phases):
            shape_id = ShapeId(f"S{index + 1}", f"{phase:02d}", round(float(time), 6))
            deformations[shape_id] = subject.deformation(shape_id.time)
    return Truth(seed, left_heart(), deformations)


def write_population(
    folder: Path,
    truth: Truth,
    edge_mm: float,
    mapped: Callable[..., Iterable[Any]] = map,
    ends: RandomEnds | None = None,
) -> Path:
    """Mesh every shape of a truth and write it as a study with its truth beside.

    Parameters
    ----------
    folder : Path
        Made if it does not exist; receives the files of `write_demonstration`.
    truth : Truth
        Of any anatomy and deformations; its seed also turns the grids.
    edge_mm : float
        Mean edge length of the meshes, mm.
    mapped : callable
        Used as ``map``, in order: pass an executor's ``map`` to mesh shapes in parallel, which
        writes the same files.
    ends : RandomEnds, optional
        Vessels that are cut at random; the study says that they are, and the truth is that of the
        whole vessels.

    Returns
    -------
    Path
        Of ``study.toml``.
    """
    folder = Path(folder)
    task = partial(
        _write_shape, folder, truth.anatomy, canonical_points(truth.anatomy, edge_mm), edge_mm, ends
    )
    children = np.random.SeedSequence([truth.seed, 1]).spawn(len(truth.deformations))
    ids = list(truth.deformations)
    rims: dict[str, list[FloatArray]] = {}
    rows = []
    for shape_id, centroids in zip(
        ids, mapped(task, ids, truth.deformations.values(), children), strict=True
    ):
        files = [_file_name(shape_id, part) for part in truth.anatomy.seeds]
        rows.append([shape_id.subject, shape_id.phase, repr(shape_id.time), *files])
        for name, centroid in centroids.items():
            rims.setdefault(name, []).append(centroid)
    write_table(folder / "shapes.csv", ["subject", "phase", "time", *truth.anatomy.seeds], rows)
    write_truth(truth, folder / "truth" / "truth.json")
    study = folder / "study.toml"
    with atomically(study) as partial_file:
        partial_file.write_text(_study_text(truth.anatomy, rims, ends), encoding="utf-8")
    return study


def _file_name(shape_id: ShapeId, part: str) -> str:
    return f"shapes/{shape_id.subject}_{shape_id.phase}_{part}.vtp"


def _write_shape(
    folder: Path,
    anatomy: Anatomy,
    canonical: FloatArray,
    edge_mm: float,
    ends: RandomEnds | None,
    shape_id: ShapeId,
    deformation: Deformation,
    seed: np.random.SeedSequence,
) -> dict[str, FloatArray]:
    # Writes the parts of one shape and returns the centroids of their rims by full name.
    rng = np.random.default_rng(seed)
    if ends is not None:
        anatomy = ends.cut(anatomy, deformation, rng)
    parts = extract(anatomy, deformation, edge_mm, rng, canonical)
    centroids = {}
    for part, surface in parts.items():
        write_surface(folder / _file_name(shape_id, part), surface.vertices, surface.faces)
        for ostium, loop in surface.loops.items():
            centroids[f"{part}.{ostium}"] = surface.vertices[loop].mean(axis=0)
    return centroids


def _study_text(
    anatomy: Anatomy, rims: Mapping[str, list[FloatArray]], ends: RandomEnds | None
) -> str:
    lines = ["schema = 1", 'units = "mm"', 'frame = "LPS"']
    seams = [cut for cut in anatomy.cuts if cut.second is not None]
    if seams:
        lines.append(f'pole = "{seams[0].first}"')
    shortened = set() if ends is None else set(ends.lengths)
    for part in anatomy.seeds:
        ostia = ", ".join(f'"{name}"' for name, _, _ in anatomy.part_cuts(part))
        lines += ["", f"[parts.{part}]", f"ostia = [{ostia}]"]
        cut = [f'"{o}"' for o, _, _ in anatomy.part_cuts(part) if f"{part}.{o}" in shortened]
        if cut:
            lines.append(f"cuts = [{', '.join(cut)}]")
    for seam in seams:
        lines += ["", "[[seams]]", f'first = "{seam.first}"', f'second = "{seam.second}"']
    lines += ["", "[shapes]", 'sheet = "shapes.csv"', "", "[ostia.points]"]
    for name, centroids in rims.items():
        point = ", ".join(f"{value:.1f}" for value in np.mean(centroids, axis=0))
        lines.append(f'"{name}" = [{point}]')
    lines += ["", "[alignment]", 'mode = "rigid"', 'per = "subject"']
    lines += ["", "[evaluation]", 'truth = "truth/truth.json"']
    lines += ["", "[report]", f'title = "Generated {" and ".join(anatomy.seeds)}: a demonstration"']
    lines.append("")
    return "\n".join(lines)
