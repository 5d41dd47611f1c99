"""Proposing a study file for a folder of meshes or label maps."""

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from ostiform.errors import InputError, OstiformError, TopologyError
from ostiform.study.cycles import natural_key
from ostiform.study.label_schemes import Labels, label_parts, touching, valve
from ostiform.study.labelmaps import LABEL_MAP_ENDINGS, is_label_map, read_first_frame
from ostiform.study.looks import FileLook, distance
from ostiform.study.name_pattern import NamePattern, guessed_pattern, name_ending
from ostiform.study.naming import LoopFacts, loop_facts
from ostiform.study.parts import surface_facts
from ostiform.study.proposal_text import ProposedPart, ProposedStudy, proposal_text
from ostiform.study.reading import opened_shape
from ostiform.study.settings_file import parsed_settings
from ostiform.study.study import study_of
from ostiform.study.survey import part_survey
from ostiform.surface import (
    MESH_SUFFIXES,
    RawMesh,
    boundary_loops,
    counted,
    face_areas,
    read_mesh,
)

_DEEPEST = 5
_MOST_LABELS = 40
_UNNAMED = "surface"
_SAME_CURVE = 0.02
"""Loops of two parts whose centres are nearer than this share of their perimeter are one curve."""
_SAME_LENGTH = 0.2
_SAME_SURFACE = 1e-3
_SAMPLES = 400
_ADVICE = {
    ".gz": "unpack what is packed, but for .nii.gz",
    ".zip": "unpack it",
    ".img": "save NIfTI pairs as one file, .nii",
    ".hdr": "save NIfTI pairs as one file, .nii",
    ".vtm": "give the folders of its blocks",
    ".dcm": "save the segmentation as NIfTI or NRRD",
}


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """A part of the first shape with what its openings look like."""

    part: ProposedPart
    look: FileLook | None = None


def proposed_study(folder: Path, target: Path) -> str:
    """Return the text of a study file that fits the files of a folder.

    Which pieces of the names are subject, phase and part is read off the names and, where they
    do not tell, off the surfaces; parts, openings and seams off the first shape. What is in doubt
    is said in comments. Openings get numbers for names, and rough points from the first shape.

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
    names, notes = _files(folder)

    @cache
    def look(name: str) -> FileLook | None:
        return _file_look(folder / name)

    guess = guessed_pattern(names, look)
    place = _relative(folder, target.parent)
    first = {part: folder / name for part, name in guess.first.items()}
    if any(is_label_map(path) for path in first.values()):
        proposal = _of_label_maps(guess, place, first, target)
    else:
        proposal = _of_meshes(guess, place, first)
    proposal = replace(proposal, notes=(*guess.notes, *notes, *proposal.notes))
    proposal = _readable(proposal, target)
    text = proposal_text(proposal)
    parsed_settings(text, target.name)
    return text


def _files(folder: Path) -> tuple[list[str], list[str]]:
    """Return the names of the most files of one ending and depth, and what is said of others."""
    if not folder.is_dir():
        raise InputError(f"{folder}: expected a folder of meshes or label maps, found none")
    endings = (*MESH_SUFFIXES, *LABEL_MAP_ENDINGS)
    found: dict[tuple[str, int], list[str]] = {}
    seen = list(_below(folder, _DEEPEST))
    for path in seen:
        name = path.relative_to(folder).as_posix()
        if any(name.lower().endswith(ending) for ending in endings):
            found.setdefault((name_ending(name), name.count("/")), []).append(name)
    if not found:
        raise InputError(
            f"{folder}: expected files ending in {', '.join(endings)}, found {_listed(seen)}: give "
            "the folder that holds the shapes, or convert them"
        )
    chosen = max(found.values(), key=len)
    others = sum(map(len, found.values())) - len(chosen)
    notes = [f"{others} other files of meshes or images lie elsewhere or end otherwise"]
    return sorted(chosen, key=natural_key), notes if others else []


def _listed(paths: Sequence[Path]) -> str:
    """Return what files there are, and how those of known kinds become readable."""
    if not paths:
        return "no file"
    ending = next((p.suffix.lower() for p in paths if p.suffix.lower() in _ADVICE), "")
    advice = f" ({_ADVICE[ending]})" if ending else ""
    return f"{counted(len(paths), 'other file')} such as {paths[0].name}{advice}"


def _below(folder: Path, depth: int) -> Iterable[Path]:
    for base, folders, files in os.walk(folder):
        folders.sort()
        if len(Path(base).relative_to(folder).parts) >= depth - 1:
            folders.clear()
        # Hidden files are what systems leave, as the ._ files of macOS beside every file.
        yield from (Path(base) / name for name in sorted(files) if not name.startswith("."))


def _file_look(path: Path) -> FileLook | None:
    """Return how a file looks, or None where it cannot be read."""
    try:
        if is_label_map(path):
            label_map = read_first_frame(path)
            voxels = np.argwhere(label_map.labels)
            chosen = voxels[np.linspace(0, len(voxels) - 1, _SAMPLES).astype(np.int64)]
            samples = chosen @ label_map.affine[:3, :3].T + label_map.affine[:3, 3]
            size = float(np.linalg.norm(np.ptp(samples, axis=0)))
            return FileLook(size, float(len(voxels)), None, samples) if size else None
        mesh = read_mesh(path)
        facts = surface_facts(mesh)
        survey = part_survey(facts.vertices, facts.faces, (), {})
    except OstiformError:
        return None
    return FileLook(survey.diagonal, survey.area, facts.n_openings, survey.samples)


def _of_label_maps(
    guess: NamePattern, place: str, first: Mapping[str, Path], target: Path
) -> ProposedStudy:
    labels: Mapping[str, Labels] = {}
    notes: tuple[str, ...] = ()
    names = [part or _UNNAMED for part in first]
    seams: list[tuple[str, str, str]] = []
    if len(first) == 1:
        (path,) = first.values()
        label_map = read_first_frame(path)
        hint = f"{guess.pattern} {'cardiac' if (path.parent / 'Info.cfg').is_file() else ''}"
        try:
            found = label_parts(label_map, hint)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
        labels, notes = found.values, found.notes
        names = list(labels) or names
        seams = touching(label_map, labels)
    else:
        seams = [
            (one, two, name)
            for k, one in enumerate(names)
            for two in names[k + 1 :]
            if (name := valve(one, two))
        ]
    proposal = ProposedStudy(
        guess.pattern, place, tuple(map(ProposedPart, names)), (), "mm", "LPS", labels, True, notes
    )
    proposal = _usable_parts(proposal, target)
    for one, two, name in seams:
        if {one, two} <= {part.name for part in proposal.parts}:
            proposal = _with_seam(proposal, one, two, name, target)
    return proposal


def _usable_parts(proposal: ProposedStudy, target: Path) -> ProposedStudy:
    """Leave out labels that make no surface, where others do."""
    if len(proposal.parts) < 2:
        return proposal
    reasons = {p.name: _problem(replace(proposal, parts=(p,)), target) for p in proposal.parts}
    wrong = {name: reason for name, reason in reasons.items() if reason}
    if not wrong or len(wrong) == len(reasons):
        return proposal
    return replace(
        proposal,
        parts=tuple(part for part in proposal.parts if part.name not in wrong),
        notes=(*proposal.notes, *(f"{name} is left out: {why}" for name, why in wrong.items())),
    )


def _with_seam(
    proposal: ProposedStudy, one: str, two: str, name: str, target: Path
) -> ProposedStudy:
    """Join two parts where their labels touch along one curve; say why not where they do not."""
    parts = tuple(
        replace(part, ostia={**part.ostia, name: None}) if part.name in (one, two) else part
        for part in proposal.parts
    )
    joined = replace(
        proposal, parts=parts, seams=(*proposal.seams, (f"{one}.{name}", f"{two}.{name}"))
    )
    reason = _problem(joined, target)
    if reason is None:
        return joined
    said = f"doubt: {one} and {two} touch but are not joined by a seam {name}: {reason}"
    return replace(proposal, notes=(*proposal.notes, said))


def _readable(proposal: ProposedStudy, target: Path) -> ProposedStudy:
    """Say what keeps the first shape from being read as proposed."""
    reason = _problem(proposal, target)
    said = () if reason is None else (f"doubt: the first shape cannot be read: {reason}",)
    return replace(proposal, notes=(*proposal.notes, *said))


def _problem(proposal: ProposedStudy, target: Path) -> str | None:
    """Return why the first shape that has all its files cannot be read as proposed, or None."""
    try:
        study = study_of(target, parsed_settings(proposal_text(proposal), target.name))
        whole = [e for e in study.entries if len(e.files) == len(proposal.parts)]
        opened = opened_shape(study, (whole or study.entries)[0])
    except OstiformError as error:
        return str(error)
    for part, item in opened.parts.items():
        expected = len(study.settings.parts[part].ostia)
        if proposal.maps and len(item.loops) != expected:
            return f"{part} has {len(item.loops)} openings, not {expected}"
    return None


def _of_meshes(guess: NamePattern, place: str, first: Mapping[str, Path]) -> ProposedStudy:
    meshes = {part or _UNNAMED: read_mesh(path) for part, path in first.items()}
    seen = [_looked_at(part, mesh) for part, mesh in meshes.items()]
    frame = next((mesh.space for mesh in meshes.values() if mesh.space), "LPS")
    size = max(float(np.ptp(mesh.vertices, axis=0).max()) for mesh in meshes.values())
    units = next((mesh.units for mesh in meshes.values() if mesh.units), None)
    notes: tuple[str, ...] = ()
    if units is None:
        units = "m" if size < 0.5 else "cm" if size < 25.0 else "mm" if size < 5000.0 else "um"
        if units != "mm":
            notes = (f"doubt: the unit {units} was guessed from a size of {size:.3g}",)
    parts, seams, said = _with_seams(seen)
    return ProposedStudy(guess.pattern, place, parts, seams, units, frame, {}, False, notes + said)


def _looked_at(name: str, mesh: RawMesh) -> _Seen:
    try:
        facts = surface_facts(mesh)
        loops = boundary_loops(facts.faces)
    except TopologyError:
        return _Seen(ProposedPart(name))
    survey = part_survey(facts.vertices, facts.faces, (), {})
    look = FileLook(survey.diagonal, survey.area, facts.n_openings, survey.samples)
    found = sorted((loop_facts(facts.vertices, loop) for loop in loops), key=lambda f: -f.perimeter)
    if found:
        ostia = {f"opening{k}": f for k, f in enumerate(found, start=1)}
        return _Seen(ProposedPart(name, ostia), look)
    array, values = _caps(mesh)
    unknown: dict[str, LoopFacts | None] = {f"opening{k + 1}": None for k in range(len(values))}
    return _Seen(ProposedPart(name, unknown, dict(zip(unknown, values, strict=True)), array), look)


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


def _with_seams(
    seen: Sequence[_Seen],
) -> tuple[tuple[ProposedPart, ...], tuple[tuple[str, str], ...], tuple[str, ...]]:
    """Join parts on either side of one curve; at most one seam joins two parts, and none a ring."""
    parts = {item.part.name: item.part for item in seen}
    group = {name: name for name in parts}
    seams: list[tuple[str, str]] = []
    notes: list[str] = []
    for k, one in enumerate(seen):
        for two in seen[k + 1 :]:
            pairs, same_side = _shared_rims(one, two)
            first, second = one.part.name, two.part.name
            if not pairs:
                continue
            if (
                one.look
                and two.look
                and distance(one.look, two.look) < _SAME_SURFACE * one.look.size
            ):
                notes.append(f"doubt: {first} and {second} are the same surface")
                continue
            if same_side or group[first] == group[second]:
                why = "lie on one side of it" if same_side else "are joined already"
                notes.append(f"doubt: {first} and {second} share a rim but {why}: no seam there")
                continue
            if len(pairs) > 1:
                notes.append(
                    f"doubt: {first} and {second} share {len(pairs)} rims; the longest is their "
                    "seam, two would make a handle: the others are openings of either part"
                )
            common = valve(first, second) or f"{first}-{second}"
            here, there = pairs[0]
            parts[first] = _renamed(parts[first], here, common)
            parts[second] = _renamed(parts[second], there, common)
            seams.append((f"{first}.{common}", f"{second}.{common}"))
            joined = {group[first], group[second]}
            group = {name: first if own in joined else own for name, own in group.items()}
    return tuple(parts.values()), tuple(seams), tuple(notes)


def _are_one(one: _Seen, two: _Seen) -> bool:
    if one.look is None or two.look is None:
        return False
    return distance(one.look, two.look) < _SAME_SURFACE * one.look.size


def _shared_rims(one: _Seen, two: _Seen) -> tuple[list[tuple[str, str]], bool]:
    """Return openings that are one curve, longest first, and whether both parts are on one side."""
    pairs = []
    for first, here in one.part.ostia.items():
        for second, there in two.part.ostia.items():
            if here is None or there is None:
                continue
            apart = float(np.linalg.norm(here.center - there.center))
            alike = abs(here.perimeter - there.perimeter) < _SAME_LENGTH * here.perimeter
            if alike and apart < _SAME_CURVE * here.perimeter:
                pairs.append((first, second, here))
    if not pairs or one.look is None or two.look is None:
        return [(first, second) for first, second, _ in pairs], False
    pairs.sort(key=lambda pair: -pair[2].perimeter)
    rim = pairs[0][2].center
    same = float((one.look.center - rim) @ (two.look.center - rim)) > 0.0 and len(pairs) == 1
    return [(first, second) for first, second, _ in pairs], same


def _renamed(part: ProposedPart, old: str, new: str) -> ProposedPart:
    return replace(part, ostia={new if n == old else n: f for n, f in part.ostia.items()})


def _relative(folder: Path, start: Path) -> str:
    try:
        return folder.resolve().relative_to(start.resolve()).as_posix()
    except ValueError:
        return folder.resolve().as_posix()
