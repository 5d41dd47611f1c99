"""The text of a proposed study file, with its comments."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.study.contradictions import quoted
from ostiform.study.label_schemes import Labels
from ostiform.study.naming import LoopFacts


@dataclass(frozen=True, slots=True)
class ProposedPart:
    """A part with its openings, the values of its caps and the array that holds them."""

    name: str
    ostia: Mapping[str, LoopFacts | None] = field(default_factory=dict)
    caps: Mapping[str, int] = field(default_factory=dict)
    array: str | None = None


@dataclass(frozen=True, slots=True)
class ProposedStudy:
    """What a study file will say.

    Attributes
    ----------
    pattern, place : str
        Of the files, and the folder that holds them.
    parts : tuple of ProposedPart
    seams : tuple of (str, str)
        Full names of openings that are one curve.
    units, frame : str
    labels : mapping of str to labels
        Of parts in one label map.
    maps : bool
        Whether the files are label maps.
    notes : tuple of str
        What the comments at the top say.
    """

    pattern: str
    place: str
    parts: tuple[ProposedPart, ...]
    seams: tuple[tuple[str, str], ...]
    units: str
    frame: str
    labels: Mapping[str, Labels]
    maps: bool
    notes: tuple[str, ...] = ()


def proposal_text(proposal: ProposedStudy) -> str:
    """Return the study file as TOML."""
    parts, seams = proposal.parts, proposal.seams
    lines = [
        "# Proposed by `ostiform init`: read it through, give the openings their real names (the",
        "# same in all tables), then run `ostiform check` on it.",
        *(f"# {' '.join(note.split())}" for note in proposal.notes),
        "schema = 1",
        f'units = "{proposal.units}"              # mm | cm | m | um, of the coordinates',
        f'frame = "{proposal.frame}"             # LPS | RAS',
        "repair = true             # false: refuse meshes with flaws instead of mending them",
    ]
    for part in parts:
        listed = ", ".join(json.dumps(name) for name in part.ostia)
        lines += ["", f"[parts.{_key(part.name)}]", f"ostia = [{listed}]"]
        for name, facts in part.ostia.items():
            if facts is not None:
                lines.append(f"# {name}: {_described(facts)} in the first shape")
        if len(part.ostia) > 1:
            lines.append("# cuts = []   # those that end a tube wherever it was cut, such as veins")
        if not part.ostia:
            lines.append("# closed; name its openings here, and cut them by [cuts] below")
    for first, second in seams:
        lines += ["", "[[seams]]", f"first = {_text(first)}", f"second = {_text(second)}"]
    if len(parts) > 1 and not seams:
        lines += ["", "# [[seams]]               # two openings that are one curve, such as the"]
        lines += ['# first = "LV.mitral"      # mitral annulus of the ventricle and the atrium']
        lines += ['# second = "LA.mitral"']
    lines += ["", "[shapes]", f"pattern = {_text(proposal.pattern)}"]
    if proposal.place != ".":
        lines.append(f"folder = {_text(proposal.place)}")
    lines.append('on_error = "skip"         # skip: leave shapes out that cannot be used | stop')
    caps = next((part for part in parts if part.array is not None and part.caps), None)
    if caps is not None:
        listed = ", ".join(f"{_key(name)} = {value}" for name, value in caps.caps.items())
        lines.append(f"open = {{array = {_text(caps.array)}, {listed}}}")
    if proposal.maps:
        lines += ["", "[labels]", "# edge_mm = 2.0           # edge length of the surfaces"]
        names = [part.name for part in parts]
        listed = ", ".join(
            f"{_key(name)} = {_text(value)}"
            for name, value in proposal.labels.items()
            if name in names
        )
        lines += [f"values = {{{listed}}}"] if listed else []
    if proposal.maps or not any(part.ostia for part in parts):
        lines += [
            "",
            "# [cuts]                  # planes and closed curves of 3D Slicer, named by openings",
            '# markups = "{subject}.mrk.json"',
        ]
    return "\n".join([*lines, *_points(proposal), ""])


def _points(proposal: ProposedStudy) -> list[str]:
    """Return rough points of all openings that were seen."""
    rows = [
        f"{_text(f'{part.name}.{name}')} = {_numbers(facts.center)}"
        for part in proposal.parts
        for name, facts in part.ostia.items()
        if facts is not None
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


def _text(value: object) -> str:
    return json.dumps(value, ensure_ascii=False)


def _key(name: str) -> str:
    return quoted(name) if name.isascii() else json.dumps(name, ensure_ascii=False)
