"""Targets of a fit from files: meshes, curves, points, landmarks."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.errors import InputError, TopologyError
from ostiform.fitting.contours import joined_curves
from ostiform.fitting.settings import TargetKind
from ostiform.fitting.types import (
    CloudTarget,
    ContourTarget,
    LandmarkTarget,
    SurfaceTarget,
    Target,
)
from ostiform.study import read_markups
from ostiform.surface import (
    MESH_SUFFIXES,
    MM_PER_UNIT,
    MendedMesh,
    RawMesh,
    boundary_loops,
    carp_points,
    lps_factors,
    mended_mesh,
    placed_vertices,
    read_cloud_or_mesh,
    read_polylines,
)

MARKUPS_SUFFIXES = (".json", ".fcsv")
TEXT_SUFFIXES = (".txt", ".csv", ".xyz", ".pts", ".asc", ".particles")
CURVE_SUFFIXES = (".vtp", ".vtk")
_SEPARATORS = re.compile(r"[,\s]+")
_NAME_COLUMNS = ("name", "label", "landmark")


@dataclass(frozen=True, slots=True)
class FileRules:
    """How to read targets.

    Attributes
    ----------
    kind : {"auto", "surface", "points", "contours", "landmarks"}
        What the files are; ``auto`` tells by what they hold.
    units : {"mm", "cm", "m", "um"}
    frame : {"LPS", "RAS"}
        Where a file does not state its own.
    """

    kind: TargetKind = "auto"
    units: str = "mm"
    frame: str = "LPS"

    def __post_init__(self) -> None:
        """Check the values."""
        for name, value, allowed in (
            ("kind of a target", self.kind, get_args(TargetKind)),
            ("units", self.units, tuple(MM_PER_UNIT)),
            ("frame", self.frame, ("LPS", "RAS")),
        ):
            if value not in allowed:
                raise InputError(f'{name}: expected one of {", ".join(allowed)}, found "{value}"')


def read_targets(
    names: Sequence[str],
    parts: Sequence[str],
    rules: FileRules,
    openings: Mapping[str, FloatArray] | None = None,
) -> tuple[Target, ...]:
    """Read the targets of one fit.

    Parameters
    ----------
    names : sequence of str
        ``FILE``, or ``PART=FILE`` where the part of the model that it is, is known.
    parts : sequence of str
        Of the model.
    rules : FileRules
    openings : mapping of str to (3,) float64, optional
        Rough positions of openings in mm (LPS) by full name: the boundary loop nearest to each is
        that opening.

    Raises
    ------
    InputError
        If a file is missing, damaged or of another kind, or a part is not of the model.
    TopologyError
        If a surface cannot be mended to an oriented manifold.
    """
    targets: list[Target] = []
    for name in names:
        part, path = target_file(name, parts)
        targets.append(_read(path, part, rules))
    return _with_openings(targets, openings or {})


def read_named_points(path: Path, rules: FileRules) -> tuple[tuple[str, ...], FloatArray]:
    """Read labels and positions (n, 3) in mm (LPS): rows ``name x y z``, or Slicer Markups."""
    if path.suffix.lower() in MARKUPS_SUFFIXES:
        points = read_markups(path).points
        if not points:
            raise InputError(f"{path}: expected labelled points, found none")
        return tuple(points), np.array(list(points.values()))
    labels: list[str] = []
    rows: list[FloatArray] = []
    for number, words in _rows(path):
        if len(words) != 4:
            raise InputError(
                f"{path}, line {number}: expected a name and three numbers, found {len(words)} "
                "columns"
            )
        labels.append(words[0])
        rows.append(_numbers(path, number, words[1:]))
    if not rows:
        raise InputError(f"{path}: expected labelled points, found none")
    return tuple(labels), np.array(rows) * lps_factors(rules.units, rules.frame)


def target_file(name: str, parts: Sequence[str]) -> tuple[str | None, Path]:
    """Return the part, where stated, and the path of ``FILE`` or ``PART=FILE``."""
    part, equals, rest = name.partition("=")
    if equals and not Path(name).exists():
        if part not in parts:
            raise InputError(
                f"{name}: expected FILE, or PART=FILE with a part among {', '.join(parts)}, found "
                f"the part {part}"
            )
        return part, Path(rest)
    return None, Path(name)


def _read(path: Path, part: str | None, rules: FileRules) -> Target:
    suffix = path.suffix.lower()
    known = (*MESH_SUFFIXES, *TEXT_SUFFIXES, *MARKUPS_SUFFIXES)
    if suffix not in known:
        raise InputError(
            f"{path}: expected a file ending in {', '.join(known)}, found {suffix or 'no ending'}"
        )
    if not path.is_file():
        raise InputError(f"{path}: expected a file to fit to, found none: check the path")
    if suffix in MARKUPS_SUFFIXES:
        return _from_markups(path, part, rules)
    if suffix in TEXT_SUFFIXES:
        return _from_text(path, part, rules)
    if rules.kind == "contours":
        return _from_curves(path, part, rules)
    if rules.kind == "landmarks":
        raise InputError(f"{path}: expected landmarks as text or Slicer Markups, found a mesh file")
    try:
        mesh = read_cloud_or_mesh(path)
    except InputError:
        if suffix in CURVE_SUFFIXES and rules.kind in ("auto", "points") and _has_curves(path):
            return _from_curves(path, part, rules)
        raise
    vertices = placed(path, mesh, rules)
    if not len(mesh.faces) and suffix in CURVE_SUFFIXES and rules.kind != "surface":
        return _from_curves(path, part, rules)
    if not len(mesh.faces) and rules.kind == "surface":
        raise InputError(f"{path}: expected triangles, found {len(vertices)} points alone")
    if rules.kind == "points" or not len(mesh.faces):
        return CloudTarget(vertices, part)
    return _surface(path, mesh, vertices, part)


def placed(path: Path, mesh: RawMesh, rules: FileRules) -> FloatArray:
    """Return the vertices (V, 3) of a file in mm (LPS)."""
    try:
        return placed_vertices(mesh, rules.units, rules.frame)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _surface(path: Path, mesh: RawMesh, vertices: FloatArray, part: str | None) -> SurfaceTarget:
    try:
        mended = mended_mesh(MendedMesh(vertices, mesh.faces, np.arange(len(mesh.faces)), ()))
        boundary_loops(mended.faces)
    except TopologyError as error:
        raise TopologyError(f"{path}: {error}") from None
    used, faces = np.unique(mended.faces, return_inverse=True)
    return SurfaceTarget(mended.vertices[used], faces.reshape(-1, 3), {}, part)


def _has_curves(path: Path) -> bool:
    try:
        points, _, _ = read_polylines(path)
    except InputError:
        return False
    return len(points) > 0


def _from_curves(path: Path, part: str | None, rules: FileRules) -> Target:
    points, curves, space = read_polylines(path)
    placed = points * lps_factors(rules.units, space or rules.frame)
    if not curves:
        if rules.kind == "contours":
            raise InputError(f"{path}: expected curves, found {len(points)} points and no line")
        return CloudTarget(placed, part)
    if rules.kind == "points":
        return CloudTarget(placed, part)
    return ContourTarget(joined_curves(placed, curves), part)


def _from_markups(path: Path, part: str | None, rules: FileRules) -> Target:
    markups = read_markups(path)
    curves = [cut.curve for cut in markups.cuts.values() if cut.curve is not None]
    if rules.kind == "contours" or (rules.kind == "auto" and curves and not markups.points):
        if not curves:
            raise InputError(f"{path}: expected closed curves, found none")
        closed = tuple(np.concatenate([curve, curve[:1]]) for curve in curves)
        return ContourTarget(closed, part)
    if not markups.points:
        raise InputError(f"{path}: expected points or closed curves, found none")
    positions = np.array(list(markups.points.values()))
    if rules.kind == "points":
        return CloudTarget(positions, part)
    if rules.kind == "surface":
        raise InputError(f"{path}: expected a mesh file, found Slicer Markups")
    return LandmarkTarget(tuple(markups.points), positions)


def _from_text(path: Path, part: str | None, rules: FileRules) -> Target:
    in_micrometres = carp_points(path.read_bytes()) if path.suffix.lower() == ".pts" else None
    if in_micrometres is not None:
        return CloudTarget(in_micrometres * lps_factors("um", rules.frame), part)
    rows = _rows(path)
    if not rows:
        raise InputError(f"{path}: expected rows of numbers, found none")
    widths = {len(words) for _, words in rows}
    if len(widths) > 1 or not widths <= {3, 4}:
        raise InputError(
            f"{path}: expected rows of x y z or of name x y z throughout, found rows of "
            f"{', '.join(map(str, sorted(widths)))} columns: keep those columns, or name them in "
            "a first row"
        )
    width = widths.pop()
    if width == 4 and rules.kind == "auto" and all(_is_number(words[0]) for _, words in rows):
        raise InputError(
            f"{path}: expected rows of x y z or of name x y z, found four numbers each: keep three "
            "columns, name the columns in a first row, or say that these are landmarks"
        )
    values = np.array([_numbers(path, number, words[-3:]) for number, words in rows])
    values = values * lps_factors(rules.units, rules.frame)
    labels = [words[0] for _, words in rows] if width == 4 else []
    if rules.kind == "surface":
        raise InputError(f"{path}: expected a mesh file, found text: it holds points")
    if width == 4 and rules.kind in ("auto", "landmarks"):
        return LandmarkTarget(tuple(labels), values)
    if rules.kind == "landmarks":
        raise InputError(f"{path}: expected rows of name x y z, found no names")
    breaks = _breaks(rows, labels)
    if rules.kind == "contours" or (rules.kind == "auto" and breaks):
        return ContourTarget(tuple(np.split(values, breaks)), part)
    return CloudTarget(values, part)


def _breaks(rows: Sequence[tuple[int, list[str]]], labels: Sequence[str]) -> list[int]:
    """Return where a new contour begins: after an empty line, or where the name changes."""
    if labels:
        return [k for k in range(1, len(rows)) if labels[k] != labels[k - 1]]
    return [k for k in range(1, len(rows)) if rows[k][0] > rows[k - 1][0] + 1]


def _rows(path: Path) -> list[tuple[int, list[str]]]:
    """Return the rows of a text file with their line numbers; a heading is left out."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise InputError(f"{path}: expected a text file, found: {error.strerror}") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: expected a text file, found other bytes") from None
    rows = []
    for number, line in enumerate(text.splitlines(), start=1):
        plain = line.partition("#")[0].strip(" \t\r")
        if ";" in plain:  # as spreadsheets separate where the decimal sign is a comma
            plain = plain.replace(",", ".").replace(";", ",")
        words = [word.strip(' "') for word in _SEPARATORS.split(plain)]
        if any(words):
            rows.append((number, words))
    if not rows:
        return []
    first = [word.casefold() for word in rows[0][1]]
    if not {"x", "y", "z"} <= set(first):
        rows = [(number, [word for word in words if word]) for number, words in rows]
        return rows[not all(_is_number(word) for word in rows[0][1][-3:]) :]
    # A heading says which columns are meant: an index or a further value is no name.
    chosen = [first.index(axis) for axis in "xyz"]
    named = [k for k, word in enumerate(first) if word in _NAME_COLUMNS][:1]
    short = next((number for number, words in rows if len(words) != len(first)), None)
    if short is not None:
        raise InputError(f"{path}, line {short}: expected {len(first)} columns as in the first row")
    return [(number, [words[k] for k in (*named, *chosen)]) for number, words in rows[1:]]


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _numbers(path: Path, number: int, words: Sequence[str]) -> FloatArray:
    try:
        values = np.array([float(word) for word in words])
    except ValueError:
        raise InputError(
            f'{path}, line {number}: expected three numbers, found "{" ".join(words)[:60]}"'
        ) from None
    if not np.isfinite(values).all():
        raise InputError(f"{path}, line {number}: expected finite numbers, found {words}")
    return values


def _with_openings(
    targets: Sequence[Target], openings: Mapping[str, FloatArray]
) -> tuple[Target, ...]:
    """Return the targets with the loop nearest to each rough position named."""
    named: dict[tuple[int, int], str] = {}
    loops: dict[tuple[int, int], IntArray] = {}
    for number, target in enumerate(targets):
        if isinstance(target, SurfaceTarget):
            for k, loop in enumerate(boundary_loops(target.faces)):
                loops[number, k] = np.asarray(loop)
    for name, position in openings.items():
        own = name.partition(".")[0]
        best, least = None, np.inf
        for key, loop in loops.items():
            target = targets[key[0]]
            if not isinstance(target, SurfaceTarget) or target.part not in (None, own):
                continue
            distance = float(np.linalg.norm(target.vertices[loop].mean(axis=0) - position))
            if distance < least:
                best, least = key, distance
        if best is None:
            raise InputError(f"opening {name}: expected a surface with a boundary, found none")
        if best in named:
            raise InputError(
                f"opening {name}: expected a boundary loop of its own, found that {named[best]} "
                "is nearest to the same"
            )
        named[best] = name
    result: list[Target] = []
    for number, target in enumerate(targets):
        if isinstance(target, SurfaceTarget):
            found = {name: loops[key] for key, name in named.items() if key[0] == number}
            target = SurfaceTarget(target.vertices, target.faces, found, target.part)
        result.append(target)
    return tuple(result)
