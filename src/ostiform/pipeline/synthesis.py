"""New shapes from a model file: meshes and animations in a folder of their own."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated
from urllib.parse import quote

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.errors import InputError
from ostiform.model import (
    DynamicModel,
    ShapeModel,
    StoredModel,
    beating_shape,
    dynamic_model_of,
    mean_cycle,
    resampled_cycle,
)
from ostiform.pipeline.events import Event, OnEvent, Progress
from ostiform.report import (
    FRAMES,
    Animation,
    cycle_animation,
    mode_animation,
    write_frames,
    write_webp,
)
from ostiform.surface import PLAIN_SUFFIXES, write_plain_mesh, write_surface
from ostiform.tables import write_table
from ostiform.values import AtLeast, value

MEAN_CYCLE = "mean"
"""Asks for the population's mean cycle where a subject's name asks for that subject's."""

SUFFIXES = (".vtp", *PLAIN_SUFFIXES)
SAMPLE_LIMIT = 3.0
"""Random scores are truncated at this many standard deviations."""


@value(eq=True)
class Synthesis:
    """What to make of a model.

    Attributes
    ----------
    mean : bool
        The mean shape.
    modes : tuple of int
        From 0.
    deviations : tuple of float
        The modes' meshes, in standard deviations.
    scores : tuple of float or None
        One shape with chosen scores, in standard deviations of the first modes.
    samples : int
        Random shapes.
    seed : int
    cycles : tuple of str
        Beating shapes: ``"mean"``, or subjects of the training.
    heart : tuple of float or None
        A beating shape with chosen scores, in standard deviations of the first modes between
        subjects.
    times : int
        Shapes per cycle.
    suffixes : tuple of str
        Formats of the meshes: ``.vtp``, ``.ply``, ``.stl``, ``.obj``.
    animations : bool
        Of every mode and cycle asked for.
    """

    mean: bool = True
    modes: tuple[int, ...] = ()
    deviations: tuple[float, ...] = (-2.0, 2.0)
    scores: tuple[float, ...] | None = None
    samples: Annotated[int, AtLeast(0)] = 0
    seed: Annotated[int, AtLeast(0)] = 0
    cycles: tuple[str, ...] = ()
    heart: tuple[float, ...] | None = None
    times: Annotated[int, AtLeast(2)] = FRAMES
    suffixes: tuple[str, ...] = (".vtp",)
    animations: bool = True

    def __post_init__(self) -> None:
        """Check what is asked for."""
        for suffix in self.suffixes:
            if suffix not in SUFFIXES:
                raise InputError(
                    f"format of meshes: expected one of "
                    f"{', '.join(s[1:] for s in SUFFIXES)}, found {suffix.lstrip('.')}"
                )


def synthesized(
    stored: StoredModel, folder: Path, wanted: Synthesis, on_event: OnEvent | None = None
) -> list[Path]:
    """Write the shapes and animations asked for, and ``scores.csv`` with what each shape is.

    Parameters
    ----------
    stored : StoredModel
    folder : Path
        Made if missing; files of the same names are replaced.
    wanted : Synthesis
    on_event : callable, optional
        Takes the events.

    Returns
    -------
    list of Path
        The meshes and animations, in the order written; not the frames.

    Raises
    ------
    InputError
        If the model has no such mode, subject or cycle.
    ArtifactError
        If a file cannot be written.
    """
    model = stored.model
    watch = on_event or _silent
    shapes = _single_shapes(model, wanted)
    dynamic = _dynamic(stored) if wanted.cycles or wanted.heart is not None else None
    cycles = {} if dynamic is None else _cycles(dynamic, wanted)
    total = len(shapes) + len(cycles) + (len(wanted.modes) + len(cycles)) * wanted.animations
    written: list[Path] = []
    rows: list[tuple[str, FloatArray]] = []

    def put(name: str, shape: FloatArray) -> None:
        written.extend(_write_mesh(folder, name, model, shape, wanted.suffixes))
        rows.append((name, model.project(shape)))

    def put_animation(name: str, animation: Animation) -> None:
        write_frames(folder / f"{name}_frames", animation)
        write_webp(folder / f"{name}.webp", animation)
        written.append(folder / f"{name}.webp")

    done = 0

    def told(name: str) -> None:
        nonlocal done
        done += 1
        watch(Progress("synthesize", done, total, name))

    for name, shape in shapes.items():
        put(name, shape)
        told(name)
    for name, cycle in cycles.items():
        for number, shape in enumerate(cycle):
            put(f"{name}/{number:04d}", shape)
        told(name)
    if wanted.animations:
        for mode in wanted.modes:
            put_animation(f"mode{mode + 1}", mode_animation(model, mode))
            told(f"mode{mode + 1}.webp")
        times = np.arange(wanted.times) / wanted.times
        for name, cycle in cycles.items():
            title = name.removeprefix("cycle_") if name.startswith("cycle_") else name
            put_animation(name, cycle_animation(model, cycle, times, title))
            told(f"{name}.webp")
    columns = [f"mode{k + 1}_mm" for k in range(len(model.modes))]
    lines = ([name, *map(float, scores)] for name, scores in rows)
    write_table(folder / "scores.csv", ["shape", *columns], lines)
    return written


def _single_shapes(model: ShapeModel, wanted: Synthesis) -> dict[str, FloatArray]:
    shapes = {"mean": model.mean} if wanted.mean else {}
    for mode in wanted.modes:
        if not 0 <= mode < len(model.modes):
            raise InputError(
                f"mode of a model: expected a number from 1 to {len(model.modes)}, found {mode + 1}"
            )
        for deviation in wanted.deviations:
            shapes[f"mode{mode + 1}_{deviation:+g}sd"] = model.displaced(mode, deviation)
    if wanted.scores is not None:
        shapes["chosen"] = model.reconstruct(_in_mm(wanted.scores, model))
    if wanted.samples:
        drawn = model.sample(wanted.samples, wanted.seed, SAMPLE_LIMIT)
        shapes.update({f"sample{n + 1:04d}": shape for n, shape in enumerate(drawn)})
    return shapes


def _in_mm(standard: Sequence[float], model: ShapeModel) -> FloatArray:
    if len(standard) > len(model.modes):
        raise InputError(
            f"scores of a shape: expected at most {len(model.modes)}, one per mode, "
            f"found {len(standard)}"
        )
    scores: FloatArray = np.asarray(standard) * np.sqrt(model.variances[: len(standard)])
    return scores


def _dynamic(stored: StoredModel) -> DynamicModel:
    if len({id.subject for id in stored.ids}) == len(stored.ids):
        raise InputError(
            "cycle of a model: expected a model of subjects with several phases, found "
            + (f"one shape for each of {len(stored.ids)} subjects" if stored.ids else "no phases")
        )
    return dynamic_model_of(stored)


def _cycles(dynamic: DynamicModel, wanted: Synthesis) -> dict[str, FloatArray]:
    times = np.arange(wanted.times) / wanted.times
    cycles = {
        f"cycle_{quote(name, safe=' ')}": mean_cycle(dynamic, times)
        if name == MEAN_CYCLE
        else resampled_cycle(dynamic, name, times)
        for name in wanted.cycles
    }
    if wanted.heart is not None:
        scores = _in_mm(wanted.heart, dynamic.between)
        cycles["heart"] = beating_shape(dynamic, scores, times)
    return cycles


def _write_mesh(
    folder: Path, name: str, model: ShapeModel, shape: FloatArray, suffixes: Sequence[str]
) -> list[Path]:
    paths = [folder / f"{name}{suffix}" for suffix in suffixes]
    for path in paths:
        if path.suffix == ".vtp":
            write_surface(
                path,
                shape,
                model.mesh.faces,
                point_data={"displacement_mm": shape - model.mean, "area_share": model.weights},
                cell_data={"part": model.mesh.face_part},
            )
        else:
            write_plain_mesh(path, shape, model.mesh.faces)
    return paths


def _silent(_: Event) -> None:
    pass
