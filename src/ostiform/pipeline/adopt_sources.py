"""Where a correspondence that exists already comes from: a folder, a sheet, or a project."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.correspondence import align
from ostiform.errors import InputError
from ostiform.exchange import (
    PARTICLE_SUFFIXES,
    OrderedShapes,
    ProjectRow,
    SourceFile,
    dressed,
    found_ids,
    medoid_shape,
    mesh_with_openings,
    read_landmark_shapes,
    read_ordered_meshes,
    read_particle_shapes,
    read_project,
)
from ostiform.study import NO_PHASE, FieldSettings, ShapeId, read_sheet, times_of_phases
from ostiform.surface import (
    MESH_SUFFIXES,
    MM_PER_UNIT,
    counted,
    lps_factors,
    placed_vertices,
    read_mesh,
)

FRAMES = ("LPS", "RAS")


@dataclass(frozen=True, slots=True)
class SourceSettings:
    """How the files of a source are to be read.

    Attributes
    ----------
    pattern : str or None
        Which files, and what their names say: ``{subject}``, ``{phase}``.
    sheet : Path or None
        A table with the columns subject, phase, time and file instead of the pattern.
    names : Path or None
        Names of the openings; see `exchange.mesh_with_openings`.
    parts : tuple of str
        Names of the parts.
    units : str
        ``mm``, ``cm``, ``m`` or ``um``.
    frame : str
        ``LPS`` or ``RAS``.
    fields : mapping of str to FieldSettings
        Arrays of the meshes to carry.
    """

    pattern: str | None = None
    sheet: Path | None = None
    names: Path | None = None
    parts: tuple[str, ...] = ("surface",)
    units: str = "mm"
    frame: str = "LPS"
    fields: Mapping[str, FieldSettings] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse settings that cannot be used."""
        if self.units not in MM_PER_UNIT:
            raise InputError(f"--units: expected {', '.join(MM_PER_UNIT)}, found {self.units}")
        if self.frame not in FRAMES:
            raise InputError(f"--frame: expected LPS or RAS, found {self.frame}")
        if not self.parts or len(set(self.parts)) < len(self.parts) or not all(self.parts):
            raise InputError(
                f"--parts: expected different names, found {','.join(self.parts) or 'none'}"
            )
        for part in self.parts:
            if "." in part or "/" in part:
                raise InputError(f"--parts: expected names without a dot or slash, found {part}")
        if self.pattern is not None and self.sheet is not None:
            raise InputError("--pattern, --sheet: expected one of the two, found both")

    @property
    def factors(self) -> FloatArray:
        """By which coordinates are multiplied to be millimetres in LPS."""
        return lps_factors(self.units, self.frame)


def read_source(source: Path, settings: SourceSettings) -> OrderedShapes:
    """Read shapes that correspond point by point.

    Parameters
    ----------
    source : Path
        A folder of meshes, ``.particles`` files or landmarks (``.json``), or a ShapeWorks project
        (``.swproj``, ``.xlsx``).
    settings : SourceSettings

    Raises
    ------
    InputError
        If files are missing, damaged or do not share their order.
    TopologyError
        If the mesh is not a manifold.
    """
    if source.is_dir():
        shapes = _from_folder(source, settings)
    elif source.suffix.lower() in (".swproj", ".xlsx"):
        shapes = _from_project(source, settings)
    else:
        raise InputError(
            f"{source}: expected a folder or a ShapeWorks project (.swproj, .xlsx), found "
            f"{'another file' if source.exists() else 'nothing'}"
        )
    if len(shapes.ids) < 2:
        raise InputError(f"{source}: expected at least 2 shapes, found {len(shapes.ids)}")
    if settings.fields and not shapes.fields:
        raise InputError(
            f"--fields: expected meshes with the arrays {', '.join(settings.fields)}, found points "
            f"without any in {source}"
        )
    if not len(shapes.mesh.faces):
        if settings.names is not None:
            raise InputError(
                f"{settings.names}: expected meshes whose openings can be named, found points "
                f"without triangles in {source}"
            )
        return shapes
    mesh, notes = mesh_with_openings(shapes.mesh, settings.names)
    return replace(shapes, mesh=mesh, notes=(*shapes.notes, *notes))


def _from_folder(folder: Path, settings: SourceSettings) -> OrderedShapes:
    notes: tuple[str, ...] = ()
    if settings.sheet is not None:
        files, notes = _sheet_files(folder, settings.sheet)
    else:
        depth = 0 if settings.pattern is None else settings.pattern.count("/")
        known = {*MESH_SUFFIXES, *PARTICLE_SUFFIXES, ".json"}
        present = [
            path
            for path in sorted(folder.glob("*/" * depth + "*"))
            if path.is_file() and path.suffix.lower() in known
        ]
        if settings.pattern is None:
            present = _without_world(present)
        files = found_ids(present, folder, settings.pattern)
    kinds = {_kind(file.path) for file in files}
    if len(kinds) > 1:
        raise InputError(
            f"{folder}: expected files of one kind, found {' and '.join(sorted(kinds))}: give a "
            "--pattern"
        )
    kind = kinds.pop()
    if kind == "meshes":
        found = read_ordered_meshes(
            files, settings.units, settings.frame, settings.parts, settings.fields
        )
    elif kind == "landmarks":
        found = read_landmark_shapes(files, settings.factors)
    else:
        ids = [file.id for file in files]
        paths = [file.path for file in files]
        found = read_particle_shapes(ids, {settings.parts[0]: paths}, settings.factors)
    return replace(found, notes=(*found.notes, *notes))


def _without_world(files: Sequence[Path]) -> list[Path]:
    """Return the files without the aligned copy of particles that are there unaligned too."""
    local = {path.stem.removesuffix("_local") for path in files if path.stem.endswith("_local")}
    return [
        path
        for path in files
        if not (path.stem.endswith("_world") and path.stem.removesuffix("_world") in local)
    ]


def _sheet_files(folder: Path, sheet: Path) -> tuple[tuple[SourceFile, ...], tuple[str, ...]]:
    """Return the files of a sheet that are not excluded, and a note on those that are."""
    rows = read_sheet(sheet, ["file"])
    who = [(row.subject, row.phase or NO_PHASE) for row in rows]
    ids = [
        ShapeId(*own, time if row.time is None else row.time)
        for row, own, time in zip(rows, who, times_of_phases(who), strict=True)
    ]
    for row, id in zip(rows, ids, strict=True):
        if "file" not in row.files:
            raise InputError(f"{sheet}: {id}: expected a file, found none")
        if who.count((id.subject, id.phase)) > 1:
            raise InputError(f"{sheet}: expected every shape once, found {id} twice")
        if row.reflect:
            raise InputError(
                f"{sheet}: {id}: expected shapes whose points correspond, found one to reflect: "
                "mirror it where it was made"
            )
    kept = [(row, id) for row, id in zip(rows, ids, strict=True) if not row.excluded]
    if not kept:
        raise InputError(f"{sheet}: expected shapes, found all {len(rows)} excluded")
    files = tuple(SourceFile(id, folder / row.files["file"]) for row, id in kept)
    return files, _left_out(len(rows) - len(kept))


def _left_out(count: int) -> tuple[str, ...]:
    return (f"left out {counted(count, 'excluded shape')}",) if count else ()


def _kind(path: Path) -> str:
    suffix = path.suffix.lower()
    if suffix in MESH_SUFFIXES:
        return "meshes"
    return "particles" if suffix in PARTICLE_SUFFIXES else "landmarks"


def _from_project(path: Path, settings: SourceSettings) -> OrderedShapes:
    listed = read_project(path)
    rows = [row for row in listed if not row.is_excluded]
    if not rows:
        raise InputError(f"{path}: expected subjects, found all {len(listed)} excluded")
    domains = rows[0].domains()
    if not domains:
        raise InputError(
            f"{path}: expected particles (columns local_particles_1 or world_particles_1), found "
            f"the columns {', '.join(rows[0].columns)}: optimise the project in ShapeWorks first"
        )
    ids = _project_ids(path, rows)
    chosen: Mapping[str, list[Path]] = {
        domain: [_particles_file(path, row, id, domain) for row, id in zip(rows, ids, strict=True)]
        for domain in domains
    }
    particles = read_particle_shapes(ids, chosen, settings.factors)
    shapes = _with_project_mesh(path, rows, particles, settings)
    groups = tuple(row.groups for row in rows)
    notes = _left_out(len(listed) - len(rows))
    return replace(shapes, notes=(*shapes.notes, *notes), covariates=groups)


def _project_ids(path: Path, rows: Sequence[ProjectRow]) -> list[ShapeId]:
    """Return who the subjects are: the columns subject and phase if there, else the name."""
    who = []
    for number, row in enumerate(rows, start=1):
        name = row.columns.get("subject") or row.columns.get("name") or f"subject{number}"
        who.append((name, row.columns.get("phase", NO_PHASE)))
    for item in who:
        if who.count(item) > 1:
            raise InputError(f"{path}: expected every subject once, found {item[0]} twice")
    ids = []
    for row, own, rank in zip(rows, who, times_of_phases(who), strict=True):
        stated = row.columns.get("time")
        try:
            time = float(stated) if stated is not None else rank
        except ValueError:
            raise InputError(
                f'{path}: {own[0]}/{own[1]}: expected a number as time, found "{stated}"'
            ) from None
        ids.append(ShapeId(*own, time))
    return ids


def _particles_file(path: Path, row: ProjectRow, id: ShapeId, domain: str) -> Path:
    for kind in ("local", "world"):
        stated = row.columns.get(f"{kind}_particles_{domain}")
        if stated:
            return path.parent / stated.replace("\\", "/")
    raise InputError(f"{path}: {id}: expected particles of the domain {domain}, found none")


def _with_project_mesh(
    path: Path, rows: Sequence[ProjectRow], particles: OrderedShapes, settings: SourceSettings
) -> OrderedShapes:
    """Return the particles' shapes as surfaces, if the project has a mesh of the medoid."""
    if len(particles.mesh.parts) > 1:
        return particles
    domain = particles.mesh.parts[0]
    weights = np.full(particles.points.shape[1], 1.0 / particles.points.shape[1])
    reference = medoid_shape(align(particles.points, weights, "rigid").aligned)
    row = rows[reference]
    local = f"local_particles_{domain}" in row.columns
    for column in ("groomed", "shape", "mesh"):
        stated = row.columns.get(f"{column}_{domain}")
        if stated and local and Path(stated).suffix.lower() in MESH_SUFFIXES:
            if not (path.parent / stated).is_file():
                continue
            mesh = read_mesh(path.parent / stated)
            return dressed(
                particles,
                reference,
                placed_vertices(mesh, settings.units, settings.frame),
                mesh.faces,
            )
    return particles
