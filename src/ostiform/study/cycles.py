"""Which phases make a cycle, and when they are where nothing says so."""

import re
from collections.abc import Iterable, Mapping, Sequence


def natural_key(name: str) -> tuple[tuple[tuple[int, int, str], ...], str]:
    """Return the key that sorts names as people do: ``s2`` before ``s10``."""
    steps = tuple(
        (0, int(step), "") if step.isdecimal() else (1, 0, step.casefold())
        for step in re.findall(r"\d+|\D+", name)
    )
    return steps, name


def common_cycles(shapes: Iterable[tuple[str, str]]) -> dict[str, tuple[str, ...]]:
    """Return the phases, in natural order, of the cycle that each subject has some of.

    Subjects that share the name of a phase share a cycle: all phases that any of them has, evenly
    spaced, so that equal names are equal times. Others have cycles of their own.

    Parameters
    ----------
    shapes : iterable of (str, str)
        Subject and phase.
    """
    own: dict[str, set[str]] = {}
    for subject, phase in shapes:
        own.setdefault(subject, set()).add(phase)
    cycle_of: dict[str, set[str]] = {}
    for phases in own.values():
        joined = phases.union(*(cycle_of.get(phase, ()) for phase in phases))
        cycle_of.update(dict.fromkeys(joined, joined))
    ordered: dict[int, tuple[str, ...]] = {}
    cycles = {}
    for subject, phases in own.items():
        cycle = cycle_of[next(iter(phases))]
        cycles[subject] = ordered.setdefault(id(cycle), tuple(sorted(cycle, key=natural_key)))
    return cycles


def times_of_phases(shapes: Sequence[tuple[str, str]]) -> list[float]:
    """Return the time of every shape (subject, phase) as a fraction of its common cycle."""
    cycles = common_cycles(shapes)
    return [cycles[s].index(phase) / len(cycles[s]) for s, phase in shapes]


def missing_phases(
    cycles: Mapping[str, Sequence[str]], subject: str, own: set[str], are_frames: bool
) -> str | None:
    """Return the sentence that says which phases of its cycle a subject lacks, if any.

    Frames of one file (`are_frames`) have the times of the file.
    """
    cycle = cycles[subject]
    missing = [phase for phase in cycle if phase not in own]
    if not missing:
        return None
    several = len(missing) > 1
    sentence = (
        f"subject {subject} lacks the phase{'s' * several} {', '.join(missing)} that others have: "
    )
    if are_frames:
        return sentence + "its times are those of its own file"
    sentence += f"its times leave room for {'them' if several else 'it'}"
    if set(cycle[: len(own)]) == own and len(own) > 1:
        sentence += "; give times (shapes.times or a sheet) if its whole cycle has fewer phases"
    return sentence
