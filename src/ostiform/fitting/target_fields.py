"""What the surfaces of a target hold (voltage, thickness, regions), at the points of its fit."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.errors import InputError
from ostiform.fitting.files import FileRules, placed, target_file
from ostiform.fitting.types import ShapeFit
from ostiform.model import ModelMesh
from ostiform.study import FieldSettings, values_at, with_fields
from ostiform.surface import MESH_SUFFIXES, read_cloud_or_mesh

_BEYOND = 2.0
"""A point farther from the data than so many times 95 % of the residues has no value."""


def target_fields(
    names: Sequence[str],
    rules: FileRules,
    fields: Mapping[str, FieldSettings],
    fit: ShapeFit,
    mesh: ModelMesh,
) -> dict[str, FloatArray]:
    """Return the fields (P,) of the files of a target at the points of its fit; NaN elsewhere.

    Parameters
    ----------
    names : sequence of str
        As `read_targets` takes them.
    rules : FileRules
    fields : mapping of str to FieldSettings
    fit : ShapeFit
    mesh : ModelMesh
        Of the model.

    Raises
    ------
    InputError
        If no file is a surface, or one lacks a field.
    """
    found = {name: np.full(len(fit.points), np.nan) for name in fields}
    reach = None if fit.residues.to_model is None else _BEYOND * fit.residues.to_model.p95
    n_surfaces = 0
    for name in names if fields else ():
        part, path = target_file(name, mesh.parts)
        if path.suffix.lower() not in MESH_SUFFIXES:
            continue
        raw = read_cloud_or_mesh(path)
        if not len(raw.faces):
            continue
        n_surfaces += 1
        rows = np.arange(len(fit.points)) if part is None else mesh.of_part(part)[0]
        mesh_mm = replace(raw, vertices=placed(path, raw, rules))
        try:
            named = with_fields(fields, part or path.name, mesh_mm)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
        for field, own in values_at(named, fields, fit.points[rows], reach).items():
            found[field][rows] = np.where(np.isnan(own), found[field][rows], own)
    if fields and not n_surfaces:
        raise InputError(
            f"--fields: expected a surface among the targets that holds {', '.join(fields)}, found "
            "none"
        )
    return found
