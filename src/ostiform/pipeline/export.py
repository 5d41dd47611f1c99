"""The results of a run in the formats of other programs."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from ostiform.errors import InputError
from ostiform.exchange import (
    ProjectRow,
    mean_cycle_frames,
    write_cycle_glb,
    write_modes_glb,
    write_particles,
    write_shape_vtp,
    write_swproj,
    write_xlsx_project,
)
from ostiform.model import (
    CorrespondedShapes,
    StoredModel,
    read_corresponded_shapes,
    read_model,
    write_mean,
    write_mode,
    write_model,
)
from ostiform.pipeline.carried_fields import Fields, field_tables, read_fields
from ostiform.pipeline.results import result_files
from ostiform.pipeline.store import Store, slug

ExportFormat = Literal["statismo", "vtp", "gltf", "csv", "particles"]
FORMATS: tuple[ExportFormat, ...] = get_args(ExportFormat)
DEVIATIONS = (-2.0, 2.0)


@dataclass(frozen=True, slots=True, eq=False)
class _Export:
    stored: StoredModel
    shapes: CorrespondedShapes | None
    output: Path
    n_modes: int
    shapes_path: Path
    fields: Fields

    def needed_shapes(self, what: str) -> CorrespondedShapes:
        if self.shapes is None:
            raise InputError(
                f"{what}: expected the shapes in correspondence at {self.shapes_path}, found "
                "none: export from a results folder that has them"
            )
        return self.shapes


def export_results(
    results: Path,
    output: Path,
    formats: Sequence[ExportFormat] | None = None,
    n_modes: int = 5,
) -> tuple[Path, ...]:
    """Write a results folder, or a model file alone, in the formats of other programs.

    ``statismo``: ``model.h5``, for statismo and scalismo. ``vtp``: the mean, the modes and every
    shape in correspondence with its scores. ``gltf``: ``modes.glb``, and ``cycle.glb`` where
    subjects have phases. ``csv``: ``scores.csv``, ``volumes.csv``, ``clinical.csv``,
    ``fields/NAME.csv``. ``particles``: local and world particles, the meshes, and
    ``project.swproj`` and ``project.xlsx`` for ShapeWorks.

    Parameters
    ----------
    results : Path
        A results folder, or a model file (without its shapes fewer formats can be written).
    output : Path
        Folder; made if missing.
    formats : sequence of str, optional
        By default all that the results have the shapes and triangles for.
    n_modes : int
        Modes written as meshes and morph targets.

    Returns
    -------
    tuple of Path
        The files written.

    Raises
    ------
    InputError
        If a format is unknown or needs what the results do not hold.
    ArtifactError
        If the results cannot be read or a file cannot be written.
    """
    unknown = [name for name in formats or () if name not in FORMATS]
    if unknown or (formats is not None and not formats):
        raise InputError(
            f"--format: expected some of {', '.join(FORMATS)}, found {', '.join(unknown) or 'none'}"
        )
    if n_modes < 1:
        raise InputError(f"--modes: expected at least 1, found {n_modes}")
    if output.exists() and not output.is_dir():
        raise InputError(f"{output}: expected a folder to export to, found a file")
    model_path = results / "model.h5" if results.is_dir() else results
    shapes_path = model_path.parent / "correspondence.h5"
    shapes = (
        read_corresponded_shapes(shapes_path)
        if results.is_dir() and shapes_path.is_file()
        else None
    )
    fields = () if shapes is None else read_fields(Store(results))
    export = _Export(read_model(model_path), shapes, output, n_modes, shapes_path, fields)
    written: list[Path] = []
    for name in dict.fromkeys(_possible(export) if formats is None else formats):
        written += WRITERS[name](export)
    return tuple(written)


def _possible(export: _Export) -> tuple[ExportFormat, ...]:
    needs_faces, needs_shapes = {"vtp", "gltf"}, {"particles"}
    return tuple(
        name
        for name in FORMATS
        if not (name in needs_faces and not len(export.stored.model.mesh.faces))
        and not (name in needs_shapes and export.shapes is None)
    )


def _statismo(export: _Export) -> list[Path]:
    path = export.output / "model.h5"
    write_model(path, export.stored)
    return [path]


def _vtp(export: _Export) -> list[Path]:
    model = export.stored.model
    paths = [export.output / "meshes" / "mean.vtp"]
    write_mean(paths[0], model, export.fields)
    for mode in range(min(export.n_modes, len(model.modes))):
        for deviation in DEVIATIONS:
            paths.append(export.output / "meshes" / f"mode{mode + 1}_{deviation:+.0f}sd.vtp")
            write_mode(paths[-1], model, mode, deviation)
    if export.shapes is not None:
        for index, id in enumerate(export.shapes.ids):
            paths.append(export.output / "shapes" / f"{slug(id)}.vtp")
            write_shape_vtp(paths[-1], export.shapes, index, export.stored, fields=export.fields)
    return paths


def _gltf(export: _Export) -> list[Path]:
    paths = [export.output / "modes.glb"]
    write_modes_glb(paths[0], export.stored.model, export.n_modes)
    frames = mean_cycle_frames(export.stored)
    if frames is not None:
        paths.append(export.output / "cycle.glb")
        write_cycle_glb(paths[-1], export.stored.model.mesh, frames)
    return paths


def _csv(export: _Export) -> list[Path]:
    files = {
        name: write
        for name, write in result_files(export.stored, export.shapes).items()
        if name.endswith(".csv")
    }
    if export.shapes is not None:
        files |= field_tables(export.shapes.ids, export.fields)
    for name, write in files.items():
        write(export.output / name)
    return [export.output / name for name in files]


def _particles(export: _Export) -> list[Path]:
    shapes = export.needed_shapes("particles")
    has_faces = len(shapes.mesh.faces) > 0
    paths, rows = [], []
    for index, id in enumerate(shapes.ids):
        name = slug(id)
        files = {
            "local_particles_1": f"particles/{name}_local.particles",
            "world_particles_1": f"particles/{name}_world.particles",
        }
        write_particles(export.output / files["local_particles_1"], shapes.points[index])
        write_particles(export.output / files["world_particles_1"], shapes.aligned[index])
        paths += [export.output / path for path in files.values()]
        columns = {"name": name, "subject": id.subject, "phase": id.phase}
        if has_faces:
            mesh = f"shapes/{name}.vtp"
            write_shape_vtp(export.output / mesh, shapes, index, export.stored)
            paths.append(export.output / mesh)
            columns |= {"shape_1": mesh, "groomed_1": mesh}
        columns |= {
            **files,
            "alignment_1": _matrix(np.eye(4)),
            "procrustes_1": _matrix(shapes.transforms[index]),
        }
        rows.append(ProjectRow(columns))
    settings = {"number_of_particles": str(shapes.points.shape[1])}
    for writer, suffix in ((write_swproj, "swproj"), (write_xlsx_project, "xlsx")):
        paths.append(export.output / f"project.{suffix}")
        writer(paths[-1], rows, settings)
    return paths


def _matrix(transform: np.ndarray) -> str:
    return " ".join(repr(float(value)) for value in transform.ravel())


WRITERS: dict[ExportFormat, Callable[[_Export], list[Path]]] = {
    "statismo": _statismo,
    "vtp": _vtp,
    "gltf": _gltf,
    "csv": _csv,
    "particles": _particles,
}
