"""What the tables of a study say against each other."""

from itertools import pairwise
from typing import Any

from ostiform.study.settings import LabelOpening, StudySettings, full_name

OWN_ARRAYS = ("area_share", "distance_from_mean_mm")
"""Arrays of the surfaces that are written, whose names no field may have."""


def quoted(key: str) -> str:
    """Return a key as TOML writes it."""
    return key if key.replace("_", "").replace("-", "").isalnum() else f'"{key}"'


def shown(value: Any) -> str:
    """Return a value of the file for an error message, cut where it is long."""
    text = f'"{value}"' if isinstance(value, str) else str(value)
    return text if len(text) <= 80 else f"{text[:77]}..."


def contradictions(settings: StudySettings) -> list[str]:
    """Return one clause for every contradiction, with its key."""
    return [
        *_part_problems(settings),
        *_cut_problems(settings),
        *_seam_problems(settings),
        *_shared_problems(settings),
        *_opening_problems(settings),
        *_shapes_problems(settings),
        *_cycle_problems(settings),
        *_part_value_problems(settings),
        *_field_problems(settings),
        *_ostium_problems(settings),
        *_evaluation_problems(settings),
        *_report_problems(settings),
    ]


def _evaluation_problems(settings: StudySettings) -> list[str]:
    if settings.evaluation.folds != 1:
        return []
    return ["evaluation.folds: expected 0 for none or at least 2, found 1"]


def _report_problems(settings: StudySettings) -> list[str]:
    part = settings.report.part
    if part is None or part in settings.parts:
        return []
    return [f"report.part: expected a part of [parts], found {shown(part)}"]


def _part_problems(settings: StudySettings) -> list[str]:
    return [
        f"parts.{part}.ostia: expected different names, found {name} more than once"
        for part, listed in settings.parts.items()
        for name in sorted({n for n in listed.ostia if listed.ostia.count(n) > 1})
    ]


def _cut_problems(settings: StudySettings) -> list[str]:
    unknown = [
        f"parts.{part}.cuts: expected ostia of {part}, found {shown(name)}"
        for part, listed in settings.parts.items()
        for name in listed.cuts
        if name not in listed.ostia
    ]
    sewn = {name for seam in settings.seams for name in (seam.first, seam.second)}
    return [
        *unknown,
        *(
            f"parts.{part}.cuts: expected ostia that are no seams, found {shown(name)}"
            for part, listed in settings.parts.items()
            for name in listed.cuts
            if f"{part}.{name}" in sewn
        ),
    ]


def _shared_problems(settings: StudySettings) -> list[str]:
    problems = []
    sewn = {name for seam in settings.seams for name in (seam.first, seam.second)}
    tied = [second for _, second in settings.ostia.shared]
    for index, (first, second) in enumerate(settings.ostia.shared):
        key = f"ostia.shared[{index}]"
        for name in (first, second):
            if name not in settings.ostium_names:
                problems.append(f"{key}: expected ostia of [parts], found {shown(name)}")
            elif name in sewn:
                problems.append(f"{key}: expected ostia that are no seams, found {shown(name)}")
        if first.partition(".")[0] == second.partition(".")[0]:
            problems.append(f"{key}: expected ostia of two parts, found {shown(first)} and its own")
        if first in tied or tied.count(second) > 1:
            problems.append(
                f"{key}: expected second ostia once each and never as a first, found "
                f"{shown(first if first in tied else second)} again"
            )
    return problems


def _seam_problems(settings: StudySettings) -> list[str]:
    problems = []
    used: dict[str, str] = {}
    for index, seam in enumerate(settings.seams):
        for side, name in (("first", seam.first), ("second", seam.second)):
            key = f"seams[{index}].{side}"
            if name not in settings.ostium_names:
                problems.append(
                    f'{key}: expected "PART.OSTIUM" with a part named in [parts] and one of its '
                    f"ostia, found {shown(name)}"
                )
            elif name in used:
                problems.append(
                    f"{key}: expected an ostium of no other seam, found {shown(name)} of "
                    f"{used[name]}"
                )
            used.setdefault(name, key)
    return problems


def _shapes_problems(settings: StudySettings) -> list[str]:
    shapes = settings.shapes
    problems = []
    if (shapes.pattern is None) == (shapes.sheet is None):
        found = "none" if shapes.pattern is None else "both"
        problems.append(f"shapes: expected one of the keys pattern and sheet, found {found}")
    if shapes.joined and shapes.split:
        problems.append("shapes: expected one of the keys joined and split, found both")
    if shapes.joined and not settings.seams:
        problems.append("shapes.joined: expected [[seams]] between the parts, found none")
    if shapes.open:
        if not isinstance(shapes.open.get("array"), str):
            problems.append("shapes.open.array: expected the name of a cell array")
        for name, value in shapes.open.items():
            if name == "array":
                continue
            key = f"shapes.open.{quoted(name)}"
            if full_name(name, settings.parts) not in settings.ostium_names:
                problems.append(f"{key}: expected an ostium of [parts], found {shown(name)}")
            if isinstance(value, str):
                problems.append(f"{key}: expected a number, found {shown(value)}")
    return problems


def _opening_problems(settings: StudySettings) -> list[str]:
    """Openings by contact are of parts, name ostia of these, and are no seams."""
    problems = []
    at_seams = {name for seam in settings.seams for name in (seam.first, seam.second)}
    for key, into in settings.labels.openings.items():
        where = f"labels.openings.{quoted(key)}"
        part, _, ostium = key.partition(".")
        if part not in settings.parts:
            problems.append(f"{where}: expected a part of [parts] before the dot, found {part}")
            continue
        ostia = into.ostia if isinstance(into, LabelOpening) else ()
        if not ostia and ostium not in settings.parts[part].ostia:
            problems.append(f"{where}: expected an ostium of {part}, found {shown(ostium)}")
        missing = [name for name in ostia if name not in settings.parts[part].ostia]
        if missing:
            problems.append(f"{where}: expected ostia of {part}, found {', '.join(missing)}")
        seam = [name for name in (ostia or (ostium,)) if f"{part}.{name}" in at_seams]
        if seam:
            problems.append(f"{where}: {part}.{seam[0]} is a seam already, where parts touch")
    return problems


def _cycle_problems(settings: StudySettings) -> list[str]:
    landmarks = settings.cycle.landmarks
    wanted = max((len(times) for times in landmarks.values()), default=0)
    problems = []
    for subject, times in landmarks.items():
        key = f"cycle.landmarks.{quoted(subject)}"
        if len(times) != wanted:
            problems.append(
                f"{key}: expected as many events as the other subjects have, {wanted}, found "
                f"{len(times)}"
            )
        if any(later <= earlier for earlier, later in pairwise(times)):
            problems.append(
                f"{key}: expected increasing times, found {', '.join(f'{t:g}' for t in times)}"
            )
    return problems


def _part_value_problems(settings: StudySettings) -> list[str]:
    problems = [
        f"labels.values.{quoted(name)}: expected a part of [parts], found {shown(name)}"
        for name in settings.labels.values
        if name not in settings.parts
    ]
    split = settings.shapes.split
    if not split:
        return problems
    if not isinstance(split.get("array"), str):
        problems.append("shapes.split.array: expected the name of a cell or point array")
    for name, value in split.items():
        if name == "array":
            continue
        if name not in settings.parts:
            problems.append(
                f"shapes.split.{quoted(name)}: expected a part of [parts], found {shown(name)}"
            )
        if isinstance(value, str):
            problems.append(
                f"shapes.split.{quoted(name)}: expected a whole number, found {shown(value)}"
            )
    missing = [part for part in settings.parts if part not in split]
    if missing:
        problems.append(f"shapes.split.{quoted(missing[0])}: expected this key, found none")
    return problems


def _field_problems(settings: StudySettings) -> list[str]:
    problems = [
        f"fields.{quoted(name)}.part: expected a part of [parts], found {shown(field.part)}"
        for name, field in settings.fields.items()
        if field.part is not None and field.part not in settings.parts
    ]
    return problems + [
        f"fields.{name}: expected another name, found that of an array of every result"
        for name in OWN_ARRAYS
        if name in settings.fields
    ]


def _ostium_problems(settings: StudySettings) -> list[str]:
    known = settings.ostium_names
    stated = [
        *((f"cuts.planes.{quoted(name)}", name) for name in settings.cuts.planes),
        *(
            (f"cuts.shapes.{quoted(shape)}.{quoted(name)}", name)
            for shape, planes in settings.cuts.shapes.items()
            for name in planes
        ),
        *((f"ostia.points.{quoted(name)}", name) for name in settings.ostia.points),
        *(
            (f"ostia.shapes.{quoted(shape)}.{quoted(name)}", name)
            for shape, points in settings.ostia.shapes.items()
            for name in points
        ),
        *((f"domain.circles.{quoted(name)}", name) for name in settings.domain.circles),
    ]
    if settings.pole is not None:
        stated.append(("pole", settings.pole))
    closing = [
        f'ostia.close[{index}]: expected "PART.NAME" with a part named in [parts] and a name that '
        f"none of its ostia has, found {shown(name)}"
        for index, name in enumerate(settings.ostia.close)
        if name in known or name.partition(".")[0] not in settings.parts or "." not in name
    ]
    return closing + [
        f'{key}: expected "PART.OSTIUM" with a part named in [parts] and one of its ostia, found '
        f"{shown(name)}"
        for key, name in stated
        if name not in known
    ]
