"""Shapes whose correspondence already exists: meshes, particles or landmarks that share an order.

Whatever the source, the outcome is the same: N shapes with P points each, one mesh on them
(perhaps without triangles) and names for its openings.
"""

import csv
import io
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.errors import InputError, TopologyError
from ostiform.exchange.landmarks import read_landmarks
from ostiform.exchange.particles import read_particles
from ostiform.model import ModelMesh, SurfaceField
from ostiform.study import (
    NO_PHASE,
    FieldSettings,
    ShapeId,
    name_expression,
    natural_key,
    times_of_phases,
    values_at,
    with_fields,
)
from ostiform.surface import RawMesh, boundary_loops, oriented_outward, placed_vertices, read_mesh
from ostiform.values import Axes, value

DEFAULT_PART = "surface"
PART_ARRAY = "part"
"""Cell array that says which part a triangle belongs to."""


@dataclass(frozen=True, slots=True)
class SourceFile:
    """One shape and the file that holds it."""

    id: ShapeId
    path: Path


@value
class OrderedShapes:
    """N shapes that share the order of their points.

    Attributes
    ----------
    ids : tuple of ShapeId
    points : (N, P, 3) float64, mm
        LPS.
    mesh : ModelMesh
    notes : tuple of str
        What was concluded, one sentence each.
    covariates : tuple of mapping of str to str
        Of each shape, where the source states them; empty where it does not.
    fields : tuple of SurfaceField
        What the meshes hold at their points and was asked for.
    """

    ids: Annotated[tuple[ShapeId, ...], Axes("N")]
    points: Annotated[FloatArray, Axes("N", "P", 3)]
    mesh: Annotated[ModelMesh, Axes("P")]
    notes: tuple[str, ...] = ()
    covariates: tuple[Mapping[str, str], ...] = ()
    fields: tuple[SurfaceField, ...] = ()


def found_ids(files: Sequence[Path], folder: Path, pattern: str | None) -> tuple[SourceFile, ...]:
    """Return who and when each file of a folder is, in natural order.

    Parameters
    ----------
    files : sequence of Path
    folder : Path
        That the pattern is relative to.
    pattern : str or None
        With the fields ``{subject}`` and perhaps ``{phase}``, and ``*``; None takes the name
        without its ending as the subject.

    Raises
    ------
    InputError
        If no file matches, or two are the same shape.
    """
    expression = _expression(pattern) if pattern is not None else None
    names: dict[tuple[str, str], Path] = {}
    for path in files:
        if expression is None:
            who = (re.sub(r"[_.](local|world)$", "", path.name.rsplit(".", 1)[0]), NO_PHASE)
        else:
            match = expression.fullmatch(path.relative_to(folder).as_posix())
            if match is None:
                continue
            who = (match["subject"], match.groupdict().get("phase", NO_PHASE))
        if who in names:
            raise InputError(
                f"{path}: expected one file for the shape {ShapeId(*who, 0.0)}, found "
                f"{names[who].name} too: give a --pattern or a --sheet that tells them apart"
            )
        names[who] = path
    if not names:
        raise InputError(
            f"{folder}: expected files matching {pattern or 'a known ending'}, found none among "
            f"{len(files)}"
        )
    order = sorted(names, key=lambda who: (natural_key(who[0]), natural_key(who[1])))
    return tuple(
        SourceFile(ShapeId(*who, time), names[who])
        for who, time in zip(order, times_of_phases(order), strict=True)
    )


def read_ordered_meshes(
    files: Sequence[SourceFile],
    units: str,
    frame: str,
    parts: Sequence[str] = (DEFAULT_PART,),
    fields: Mapping[str, FieldSettings] | None = None,
) -> OrderedShapes:
    """Read meshes that share vertices and triangles.

    Parameters
    ----------
    files : sequence of SourceFile
    units : {"mm", "cm", "m", "um"}
    frame : {"LPS", "RAS"}
        Of files that do not state their own (3D Slicer's ``SPACE``, openCARP's micrometres).
    parts : sequence of str
        One name, or as many as the cell array ``part`` has values (0, 1, ...).
    fields : mapping of str to FieldSettings, optional
        Arrays of the files to carry.

    Raises
    ------
    InputError
        If a file cannot be read, lacks a field, or its vertices or triangles differ from the first
        file's.
    """
    meshes = [read_mesh(file.path) for file in files]
    first = meshes[0]
    for file, mesh in zip(files, meshes, strict=True):
        if len(mesh.vertices) != len(first.vertices):
            raise InputError(
                f"{file.path}: expected {len(first.vertices)} vertices as in "
                f"{files[0].path.name}, found {len(mesh.vertices)}: only meshes that share their "
                "vertex order are in correspondence (others are built with `ostiform build`)"
            )
        if mesh.faces.shape != first.faces.shape or (mesh.faces != first.faces).any():
            found = (
                f"{len(mesh.faces)} triangles instead of {len(first.faces)}"
                if len(mesh.faces) != len(first.faces)
                else f"another triangle {int((mesh.faces != first.faces).any(axis=1).argmax())}"
            )
            raise InputError(
                f"{file.path}: expected the triangles of {files[0].path.name}, found {found}: "
                "the meshes do not share their vertex order"
            )
    try:
        points = np.stack([placed_vertices(mesh, units, frame) for mesh in meshes])
    except InputError as error:
        raise InputError(f"{files[0].path}: {error}") from None
    faces, notes = _outward(points.mean(axis=0), first.faces)
    face_part = _face_part(files[0].path, first, parts)
    part = np.zeros(points.shape[1], dtype=np.int64)
    for number in range(len(parts) - 1, -1, -1):  # a shared point carries its first part
        part[faces[face_part == number]] = number
    shared = ModelMesh(faces, face_part, part, tuple(parts), {})
    carried = _fields(files, meshes, fields or {})
    return OrderedShapes(tuple(file.id for file in files), points, shared, notes, fields=carried)


def _fields(
    files: Sequence[SourceFile], meshes: Sequence[RawMesh], fields: Mapping[str, FieldSettings]
) -> tuple[SurfaceField, ...]:
    """Return fields at the vertices; one of cells has the value of a triangle at the vertex."""
    rows = []
    for file, mesh in zip(files, meshes, strict=True):
        try:
            named = with_fields(fields, DEFAULT_PART, mesh)
        except InputError as error:
            raise InputError(f"{file.path}: {error}") from None
        own = values_at(named, fields, mesh.vertices)
        none = np.full(len(mesh.vertices), np.nan)
        rows.append([named.point_data.get(name, own.get(name, none)) for name in fields])
    return tuple(
        SurfaceField(name, field.units, field.kind == "label", np.stack([row[k] for row in rows]))
        for k, (name, field) in enumerate(fields.items())
    )


def read_particle_shapes(
    ids: Sequence[ShapeId],
    domains: Mapping[str, Sequence[Path]],
    factors: FloatArray,
) -> OrderedShapes:
    """Read particles, the domains of a shape one after the other.

    Parameters
    ----------
    ids : sequence of ShapeId
        N shapes.
    domains : mapping of str to sequence of Path
        By the name of the domain (which becomes the part), one file per shape.
    factors : (3,) float64
        By which coordinates are multiplied to be millimetres in LPS.

    Raises
    ------
    InputError
        If a file cannot be read or its number of points differs from the first shape's.
    """
    columns, part = [], []
    for number, paths in enumerate(domains.values()):
        sets = [read_particles(path) * factors for path in paths]
        for path, points in zip(paths, sets, strict=True):
            if len(points) != len(sets[0]):
                raise InputError(
                    f"{path}: expected {len(sets[0])} particles as in {paths[0].name}, found "
                    f"{len(points)}: particles of one project share their order"
                )
        columns.append(np.stack(sets))
        part.append(np.full(len(sets[0]), number))
    return OrderedShapes(
        tuple(ids),
        np.concatenate(columns, axis=1),
        _without_triangles(np.concatenate(part), tuple(domains)),
        ("points without triangles",),
    )


def read_landmark_shapes(files: Sequence[SourceFile], factors: FloatArray) -> OrderedShapes:
    """Read landmarks in scalismo's JSON; they correspond by name, in the first file's order.

    Raises
    ------
    InputError
        If a file cannot be read or its names differ from the first file's.
    """
    sets = [{mark.name: mark.position for mark in read_landmarks(file.path)} for file in files]
    names = list(sets[0])
    for file, marks in zip(files, sets, strict=True):
        different = sorted(set(marks) ^ set(names))
        if different:
            raise InputError(
                f"{file.path}: expected the {len(names)} landmarks of {files[0].path.name}, found "
                f"{len(marks)}: {', '.join(different[:5])} in one of them only"
            )
    points = np.stack([[marks[name] for name in names] for marks in sets]) * factors
    mesh = _without_triangles(np.zeros(len(names), dtype=np.int64), ("landmarks",))
    note = f"landmarks in order: {', '.join(names)}"
    return OrderedShapes(tuple(file.id for file in files), points, mesh, (note,))


def mesh_with_openings(mesh: ModelMesh, names: Path | None) -> tuple[ModelMesh, tuple[str, ...]]:
    """Return the mesh with its boundary loops as named openings, and what was concluded.

    Parameters
    ----------
    mesh : ModelMesh
    names : Path or None
        A CSV file with the columns ``name`` (``PART.OSTIUM``) and, optionally, ``vertex``, the
        index from 0 of any vertex on the rim; rows without one take the loops of their part in
        order of their smallest vertex index. Without a file they are called ``opening1`` and so
        on. A curve where two parts meet is an opening of both.

    Raises
    ------
    InputError
        If the names do not fit the loops.
    TopologyError
        If a part is not a manifold.
    """
    loops: list[tuple[int, IntArray]] = []
    for number, part in enumerate(mesh.parts):
        faces = mesh.faces[mesh.face_part == number]
        if not len(faces):
            continue
        try:
            loops += [(number, loop) for loop in boundary_loops(faces)]
        except TopologyError as error:
            raise TopologyError(f"part {part} of the meshes: {error}") from None
    if names is None:
        counts = Counter[int]()
        named = {}
        for number, loop in loops:
            counts[number] += 1
            named[f"{mesh.parts[number]}.opening{counts[number]}"] = loop
    else:
        named = _named(names, mesh, loops)
    found = ", ".join(f"{name} ({len(loop)} vertices)" for name, loop in named.items())
    return replace(mesh, loops=named), (f"openings: {found or 'none'}",)


def _named(
    path: Path, mesh: ModelMesh, loops: Sequence[tuple[int, IntArray]]
) -> dict[str, IntArray]:
    rows = _name_rows(path)
    named: dict[str, IntArray] = {}
    taken: list[int] = []
    for line, (name, vertex) in enumerate(rows, start=2):
        part, _, ostium = name.partition(".")
        if part not in mesh.parts or not ostium or name in named:
            raise InputError(
                f"{path}, row {line}: expected another PART.OSTIUM of the parts "
                f'{", ".join(mesh.parts)}, found "{name}"'
            )
        of_part = [k for k, (number, _) in enumerate(loops) if mesh.parts[number] == part]
        if vertex is None:
            fitting = [k for k in of_part if k not in taken][:1]
        else:
            fitting = [k for k in of_part if k not in taken and (loops[k][1] == vertex).any()]
        if not fitting:
            where = "left" if vertex is None else f"through vertex {vertex}"
            raise InputError(
                f"{path}, row {line}: expected an opening of {part} {where} for {name}, found "
                f"none among its {len(of_part)} openings"
            )
        taken.append(fitting[0])
        named[name] = loops[fitting[0]][1]
    left = [k for k in range(len(loops)) if k not in taken]
    if left:
        number, loop = loops[left[0]]
        raise InputError(
            f"{path}: expected a name for each of {len(loops)} openings, found {len(rows)}: the "
            f"opening of {mesh.parts[number]} through vertex {int(loop[0])} has none"
        )
    return named


def _name_rows(path: Path) -> list[tuple[str, int | None]]:
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: expected a CSV file of names, found {error}") from None
    reader = csv.DictReader(io.StringIO(text), skipinitialspace=True)
    if reader.fieldnames is None or "name" not in reader.fieldnames:
        raise InputError(
            f"{path}: expected the columns name and perhaps vertex, found "
            f"{', '.join(reader.fieldnames or ()) or 'an empty file'}"
        )
    rows = []
    for line, row in enumerate(reader, start=2):
        written = (row.get("vertex") or "").strip()
        if written and not written.isdecimal():
            raise InputError(
                f'{path}, row {line}: expected the index of a vertex, found "{written}"'
            )
        rows.append(((row["name"] or "").strip(), int(written) if written else None))
    return rows


def _outward(mean: FloatArray, faces: IntArray) -> tuple[IntArray, tuple[str, ...]]:
    turned = oriented_outward(mean, faces)
    changed = int((turned != faces).any(axis=1).sum())
    note = f"turned {changed} of {len(faces)} triangles to face outwards"
    return turned, ((note,) if changed else ())


def _face_part(path: Path, mesh: RawMesh, parts: Sequence[str]) -> IntArray:
    if len(parts) == 1:
        return np.zeros(len(mesh.faces), dtype=np.int64)
    values = mesh.cell_data.get(PART_ARRAY)
    if values is None:
        raise InputError(
            f'{path}: expected a cell array "{PART_ARRAY}" that tells the {len(parts)} parts '
            f"{', '.join(parts)} apart, found {', '.join(mesh.cell_data) or 'no cell array'}"
        )
    found = np.asarray(values).reshape(len(mesh.faces), -1)[:, 0].astype(np.int64)
    if found.min() < 0 or found.max() >= len(parts):
        raise InputError(
            f'{path}: expected values from 0 to {len(parts) - 1} in the cell array "{PART_ARRAY}", '
            f"found {int(found.min())} to {int(found.max())}"
        )
    return found


def _without_triangles(part: IntArray, parts: tuple[str, ...]) -> ModelMesh:
    return ModelMesh(
        faces=np.empty((0, 3), dtype=np.int64),
        face_part=np.empty(0, dtype=np.int64),
        part=part,
        parts=parts,
        loops={},
    )


def _expression(pattern: str) -> re.Pattern[str]:
    seen: set[str] = set()

    def of_field(name: str) -> str:
        if name not in ("subject", "phase") or name in seen:
            raise InputError(
                f'--pattern: expected the fields {{subject}} and {{phase}} once each, found "'
                f'{pattern}"'
            )
        seen.add(name)
        return f"(?P<{name}>[^/]+)"

    expression = name_expression(pattern, of_field)
    if "subject" not in seen:
        raise InputError(f'--pattern: expected the field {{subject}}, found "{pattern}"')
    return expression
