"""What the files of a shape hold on its surface: point and cell arrays named in ``[fields]``.

They are looked up on the mesh as its file has it, at the closest point: whatever mending, cutting
and welding do to the surface that is mapped, every value stays where it was measured.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.errors import InputError
from ostiform.study.labelmaps import is_label_map
from ostiform.study.parts import MIRROR, face_values
from ostiform.study.settings import FieldSettings, StudySettings
from ostiform.study.sources import file_mesh, part_meshes
from ostiform.study.study import ShapeEntry
from ostiform.surface import (
    RawMesh,
    closest_points,
    interpolated_at,
    median_edge_length,
    prevailing_at,
    surface_tree,
)

OFF_SURFACE = 0.01
"""Of the size of a surface: what is mapped may be a coarser mesh, and leave it a little."""


def stated_fields(text: str) -> dict[str, FieldSettings]:
    """Return the fields that an option states: ``voltage,region:label``.

    Raises
    ------
    InputError
        If a name is empty or doubled, or a kind is none.
    """
    fields: dict[str, FieldSettings] = {}
    for item in text.split(",") if text.strip() else ():
        name, _, kind = (word.strip() for word in item.partition(":"))
        if not name or name in fields or kind not in ("", "number", "label"):
            raise InputError(
                f"--fields: expected different names such as voltage,region:label, found {text}"
            )
        fields[name] = FieldSettings(kind="label" if kind == "label" else "number")
    return fields


def surface_fields(settings: StudySettings, entry: ShapeEntry) -> dict[str, RawMesh]:
    """Return the surface of every part of a shape as its file has it, with the study's fields.

    Returns
    -------
    dict of str to RawMesh
        By part, in mm and LPS, without the cells of caps; the fields that it has are its point or
        cell arrays, by their names in the study.

    Raises
    ------
    InputError
        If a file cannot be read, lacks a field that is required, or the values are none.
    """
    if any(is_label_map(entry.files[part]) for part in settings.parts if part in entry.files):
        raise InputError(
            f"shape {entry.id}: expected meshes with the arrays of [fields], found a label map, "
            "which has none: leave [fields] out or give surfaces"
        )
    try:
        meshes = _file_meshes(settings, entry)
        if entry.reflect:
            meshes = {p: replace(m, vertices=m.vertices * MIRROR) for p, m in meshes.items()}
        return {part: field_mesh(settings, part, mesh) for part, mesh in meshes.items()}
    except InputError as error:
        raise InputError(f"shape {entry.id}: {error}") from None


def field_mesh(settings: StudySettings, part: str, mesh: RawMesh) -> RawMesh:
    """Return the mesh of a part without its caps, its fields as arrays by their names."""
    named = with_fields(settings.fields, part, mesh)
    wall = np.ones(len(mesh.faces), dtype=np.bool_)
    caps = [value for name, value in settings.caps.items() if name.startswith(f"{part}.")]
    if caps:
        wall = ~np.isin(face_values(mesh, str(settings.shapes.open["array"]), "shapes.open"), caps)
    cells = {name: values[wall] for name, values in named.cell_data.items()}
    return replace(named, faces=mesh.faces[wall], cell_data=cells)


def with_fields(fields: Mapping[str, FieldSettings], part: str, mesh: RawMesh) -> RawMesh:
    """Return a mesh with the fields of a part as its only arrays, by their names.

    Raises
    ------
    InputError
        If an array is missing or holds other things than numbers.
    """
    points: dict[str, FloatArray] = {}
    cells: dict[str, FloatArray] = {}
    for name, field in fields.items():
        array = field.array or name
        if field.part not in (None, part):
            continue
        # A label belongs to a cell, a number to a point, where a file has both.
        places = ((mesh.cell_data, cells), (mesh.point_data, points))
        places = places if field.kind == "label" else places[::-1]
        found = next(((data[array], kept) for data, kept in places if array in data), None)
        if found is not None:
            found[1][name] = _numbers(found[0], array, field)
        elif field.required:
            raise InputError(
                f"{part}: expected the array {array} of fields.{name}, found {_listed(mesh)}: "
                "correct its name, or state part = ... where one part has it, or required = false "
                "where some shapes lack it"
            )
    return replace(mesh, point_data=points, cell_data=cells)


def values_at(
    mesh: RawMesh,
    fields: Mapping[str, FieldSettings],
    points: FloatArray,
    reach_mm: float | None = None,
) -> dict[str, FloatArray]:
    """Return the fields (n,) of a surface at points (n, 3) on it; NaN where it has no value.

    Numbers at vertices are interpolated linearly, of labels the one that weighs most at the point
    is taken, and of cells the value of the cell that holds it. A point farther from the surface
    than a median edge and 1 % of its size lies on what was closed, where nothing was measured.

    Parameters
    ----------
    mesh : RawMesh
        From `surface_fields`.
    fields : mapping of str to FieldSettings
    points : (n, 3) float64, mm
    reach_mm : float, optional
        Where points may lie farther off the surface.
    """
    if not (mesh.point_data or mesh.cell_data):
        return {}
    closest = closest_points(surface_tree(mesh.vertices, mesh.faces), points)
    found = {
        name: (prevailing_at if fields[name].kind == "label" else interpolated_at)(
            closest, mesh.faces, values
        )
        for name, values in mesh.point_data.items()
    }
    found |= {name: values[closest.faces] for name, values in mesh.cell_data.items()}
    size = float(np.linalg.norm(np.ptp(mesh.vertices[mesh.faces], axis=(0, 1))))
    edge = median_edge_length(mesh.vertices, mesh.faces)
    reach = max(edge, OFF_SURFACE * size, reach_mm or 0.0)
    off = closest.distances > reach
    return {name: np.where(off, np.nan, values) for name, values in found.items()}


def other_arrays(settings: StudySettings, entry: ShapeEntry) -> tuple[str, ...]:
    """Return the arrays of one number each that a shape's files have and the study does not name.

    None where a file cannot be read: that is told elsewhere.
    """
    named = {field.array or name for name, field in settings.fields.items()}
    named |= {
        str(table["array"]) for table in (settings.shapes.open, settings.shapes.split) if table
    }
    found: dict[str, None] = {}
    for part in settings.parts:
        try:
            mesh = file_mesh(settings, part, entry)
        except (InputError, KeyError):
            continue
        for data in (mesh.point_data, mesh.cell_data):
            found |= {n: None for n, v in data.items() if n not in named and _is_field(v)}
    return tuple(found)


def _file_meshes(settings: StudySettings, entry: ShapeEntry) -> dict[str, RawMesh]:
    if settings.shapes.joined:  # the cuts that part it leave its arrays behind
        whole = file_mesh(settings, settings.part_names[0], entry)
        return dict.fromkeys(settings.parts, whole)
    return dict(part_meshes(settings, entry, {}).meshes)


def _numbers(values: np.ndarray, array: str, field: FieldSettings) -> FloatArray:
    if not _is_field(values):
        raise InputError(
            f"expected one number per item in the array {array}, found "
            f"{values.dtype if values.ndim == 1 else f'{values[0].size} numbers'}: write its size "
            "or one of its components as an array of its own"
        )
    numbers = values.reshape(len(values)).astype(np.float64)
    absent = ~np.isfinite(numbers) | (False if field.missing is None else numbers == field.missing)
    numbers[absent] = np.nan
    if field.kind == "label" and (numbers[~absent] != np.rint(numbers[~absent])).any():
        raise InputError(
            f'expected whole numbers in the labels {array}, found others: state kind = "number"'
        )
    return numbers


def _is_field(values: np.ndarray) -> bool:
    return values.dtype.kind in "iufb" and values.size == len(values)


def _listed(mesh: RawMesh) -> str:
    kinds = (("point", mesh.point_data), ("cell", mesh.cell_data))
    found = [f"the {kind} array {name}" for kind, data in kinds for name in data]
    return ", ".join(found) or "no arrays"
