"""Proposing a study file for a folder of meshes or label maps."""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.errors import InputError, TopologyError
from ostiform.study.labelmaps import LABEL_MAP_ENDINGS, is_label_map, read_label_map
from ostiform.study.name_pattern import NamePattern, guessed_pattern
from ostiform.study.naming import LoopFacts, loop_facts
from ostiform.study.parts import surface_facts
from ostiform.study.settings_file import parsed_settings
from ostiform.surface import MESH_SUFFIXES, RawMesh, boundary_loops, face_areas, read_mesh

_DEEPEST = 3
_MOST_LABELS = 40
_UNNAMED = "surface"
_VALVES = {frozenset(("lv", "la")): "mitral", frozenset(("rv", "ra")): "tricuspid",
           frozenset(("lv", "ao")): "aortic", frozenset(("lv", "aorta")): "aortic"}  # fmt: skip
_SAME_CURVE = 0.02
"""Loops of two parts whose centres are nearer than this share of their perimeter are one curve."""


@dataclass(frozen=True, slots=True)
class _Part:
    """What one part of the first shape looks like."""

    name: str
    ostia: dict[str, LoopFacts | None] = field(default_factory=dict)
    caps: dict[str, int] = field(default_factory=dict)
    array: str | None = None


def proposed_study(folder: Path, target: Path) -> str:
    """Return the text of a study file that fits the files of a folder.

    The pattern of the names, parts, openings and seams are read off the names and the first
    shape; openings get numbers for names, and rough points from that shape.

    Parameters
    ----------
    folder : Path
    target : Path
        Where the text will be written; its folder is what the study's paths start from.

    Raises
    ------
    InputError
        If the folder holds no meshes or label maps, or the first shape cannot be read.
    """
    names = _files(folder)
    guess = guessed_pattern(names)
    first = {part: folder / name for part, name in _first_shape(guess, names).items()}
    maps = any(is_label_map(path) for path in first.values())
    labels: dict[str, int | str] = {}
    if maps:
        labels = _labels(first) if len(first) == 1 else {}
        parts = [_Part(name) for name in (labels or first)]
        units, frame, seams = "mm", "LPS", list[tuple[str, str]]()
    else:
        meshes = {part: read_mesh(path) for part, path in first.items()}
        parts = [_looked_at(part, mesh) for part, mesh in meshes.items()]
        units = _units(meshes)
        frame = next((mesh.space for mesh in meshes.values() if mesh.space), "LPS")
        parts, seams = _with_seams(parts)
    place = _relative(folder, target.parent)
    text = _text(guess.pattern, place, parts, seams, units, frame, labels, maps)
    parsed_settings(text, target.name)
    return text


def _files(folder: Path) -> list[str]:
    if not folder.is_dir():
        raise InputError(f"{folder}: expected a folder of meshes or label maps, found none")
    endings = (*MESH_SUFFIXES, *LABEL_MAP_ENDINGS)
    found: dict[tuple[str, int], list[str]] = {}
    for depth in range(_DEEPEST):
        for path in sorted(folder.glob("*/" * depth + "*")):
            ending = next((e for e in endings if path.name.lower().endswith(e)), None)
            if ending == ".gz" or ending is None or not path.is_file():
                continue
            ending = ".nii.gz" if path.name.lower().endswith(".nii.gz") else ending
            found.setdefault((ending, depth), []).append(path.relative_to(folder).as_posix())
    if not found:
        raise InputError(
            f"{folder}: expected files ending in {', '.join(endings)}, found none: give the folder "
            "that holds the shapes"
        )
    return max(found.values(), key=len)


def _first_shape(guess: NamePattern, names: Sequence[str]) -> dict[str, str]:
    """Return the files of the first shape by part."""
    if "{part}" not in guess.pattern:
        return {(*guess.parts, _UNNAMED)[0]: names[0]}
    chosen: dict[str, str] = {}
    for part in guess.parts:
        around = guess.pattern.partition("{part}")
        for name in names:
            tail = around[2].replace("{subject}", "").replace("{phase}", "")
            if part in name and (not tail or name.endswith(tail.rpartition("}")[2])):
                chosen[part] = name
                break
    return chosen


def _labels(first: Mapping[str, Path]) -> dict[str, int | str]:
    """Return a part for every label of a label map, or nothing where there is just one.

    Segments that 3D Slicer has named are parts of those names.
    """
    (path,) = first.values()
    label_map = read_label_map(path)
    if label_map.segments and len(label_map.segments) <= _MOST_LABELS:
        return {re.sub(r"[./\\{}=+]", "_", name).strip(): name for name in label_map.segments}
    values = np.unique(label_map.labels)
    values = values[values != 0]
    if len(values) > _MOST_LABELS:
        raise InputError(
            f"{path}: expected a label map of a few labels, found {len(values)} values"
        )
    return {f"label{v}": int(v) for v in values.tolist()} if len(values) > 1 else {}


def _looked_at(name: str, mesh: RawMesh) -> _Part:
    try:
        facts = surface_facts(mesh)
        loops = boundary_loops(facts.faces)
    except TopologyError:
        return _Part(name)
    found = sorted((loop_facts(facts.vertices, loop) for loop in loops), key=lambda f: -f.perimeter)
    if found:
        return _Part(name, {f"opening{k}": f for k, f in enumerate(found, start=1)})
    array, values = _caps(mesh)
    ostia: dict[str, LoopFacts | None] = {f"opening{k}": None for k in range(1, len(values) + 1)}
    return _Part(name, ostia, dict(zip(ostia, values, strict=True)), array)


def _caps(mesh: RawMesh) -> tuple[str | None, list[int]]:
    """Return the cell array that may mark caps, and its values but for the wall's."""
    area = face_areas(mesh.vertices, mesh.faces)
    for name, values in mesh.cell_data.items():
        if values.ndim != 1 or values.dtype.kind not in "iu":
            continue
        present = np.unique(values)
        if 2 <= len(present) <= _MOST_LABELS:
            sizes = [float(area[values == v].sum()) for v in present]
            wall = int(np.argmax(sizes))
            return name, [int(v) for k, v in enumerate(present) if k != wall]
    return None, []


def _units(meshes: Mapping[str, RawMesh]) -> str:
    size = max(float(np.ptp(mesh.vertices, axis=0).max()) for mesh in meshes.values())
    return "m" if size < 0.5 else "cm" if size < 25.0 else "mm"


def _with_seams(parts: Sequence[_Part]) -> tuple[list[_Part], list[tuple[str, str]]]:
    """Find pairs of openings of two parts that are one curve, and give them one name."""
    named, seams = list(parts), []
    for k, one in enumerate(parts):
        for m, two in enumerate(parts[k + 1 :], start=k + 1):
            chambers = {one.name.casefold(), two.name.casefold()}
            common = _VALVES.get(frozenset(chambers), f"{one.name}-{two.name}")
            for first, here in one.ostia.items():
                for second, there in two.ostia.items():
                    if here is None or there is None:
                        continue
                    apart = float(np.linalg.norm(here.center - there.center))
                    if apart < _SAME_CURVE * here.perimeter:
                        named[k] = _renamed(named[k], first, common)
                        named[m] = _renamed(named[m], second, common)
                        seams.append((f"{one.name}.{common}", f"{two.name}.{common}"))
    return named, seams


def _renamed(part: _Part, old: str, new: str) -> _Part:
    return replace(part, ostia={new if n == old else n: f for n, f in part.ostia.items()})


def _relative(folder: Path, start: Path) -> str:
    try:
        return folder.resolve().relative_to(start.resolve()).as_posix()
    except ValueError:
        return folder.resolve().as_posix()


def _text(
    pattern: str,
    place: str,
    parts: Sequence[_Part],
    seams: Sequence[tuple[str, str]],
    units: str,
    frame: str,
    labels: Mapping[str, int | str],
    maps: bool,
) -> str:
    lines = [
        "# Proposed by `ostiform init`: read it through, give the openings their real names (the",
        "# same in all tables), then run `ostiform check` on it.",
        "schema = 1",
        f'units = "{units}"              # mm | cm | m, of the coordinates in the files',
        f'frame = "{frame}"             # LPS | RAS',
        "repair = true             # false: refuse meshes with flaws instead of mending them",
    ]
    for part in parts:
        listed = ", ".join(json.dumps(name) for name in part.ostia)
        lines += ["", f"[parts.{_key(part.name)}]", f"ostia = [{listed}]"]
        for name, facts in part.ostia.items():
            if facts is not None:
                lines.append(f"# {name}: {_described(facts)} in the first shape")
        if not part.ostia:
            lines.append("# closed; name its openings here, and cut them by [cuts] below")
    for first, second in seams:
        lines += ["", "[[seams]]", f"first = {json.dumps(first)}", f"second = {json.dumps(second)}"]
    if len(parts) > 1 and not seams:
        lines += ["", "# [[seams]]               # two openings that are one curve, such as the"]
        lines += ['# first = "LV.mitral"      # mitral annulus of the ventricle and the atrium']
        lines += ['# second = "LA.mitral"']
    lines += ["", "[shapes]", f"pattern = {json.dumps(pattern, ensure_ascii=False)}"]
    if place != ".":
        lines.append(f"folder = {json.dumps(place, ensure_ascii=False)}")
    lines.append('on_error = "skip"         # skip: leave shapes out that cannot be used | stop')
    caps = next((part for part in parts if part.array is not None and part.caps), None)
    if caps is not None:
        listed = ", ".join(f"{name} = {value}" for name, value in caps.caps.items())
        lines.append(f"open = {{array = {json.dumps(caps.array)}, {listed}}}")
    if maps:
        lines += ["", "[labels]", "# edge_mm = 2.0           # edge length of the surfaces"]
        if labels:
            listed = ", ".join(
                f"{_key(name)} = {json.dumps(value, ensure_ascii=False)}"
                for name, value in labels.items()
            )
            lines.append(f"values = {{{listed}}}")
    if maps or not any(part.ostia for part in parts):
        lines += [
            "",
            "# [cuts]                  # planes and closed curves of 3D Slicer, named by openings",
            '# markups = "{subject}.mrk.json"',
        ]
    return "\n".join([*lines, *_points(parts, seams), ""])


def _points(parts: Sequence[_Part], seams: Sequence[tuple[str, str]]) -> list[str]:
    at_seams = {name for seam in seams for name in seam}
    rows = [
        f"{json.dumps(f'{part.name}.{name}')} = {_numbers(facts.center)}"
        for part in parts
        for name, facts in part.ostia.items()
        if facts is not None and f"{part.name}.{name}" not in at_seams
    ]
    if not rows:
        return []
    return [
        "",
        "# Rough places of the openings in the first shape; the other shapes are matched to it.",
        "[ostia.points]",
        *rows,
    ]


def _described(facts: LoopFacts) -> str:
    return (
        f"centre {_numbers(facts.center)}, {facts.perimeter:.3g} round, {facts.n_vertices} vertices"
    )


def _numbers(point: FloatArray) -> str:
    """Return a rough place to about a hundredth of its distance from the origin."""
    scale = float(np.abs(point).max())
    digits = int(np.clip(2 - np.floor(np.log10(max(scale, 1e-9))), 0, 9))
    return "[" + ", ".join(f"{round(float(x), digits) + 0.0}" for x in point) + "]"


def _key(name: str) -> str:
    return name if name.replace("_", "").replace("-", "").isalnum() else json.dumps(name)
