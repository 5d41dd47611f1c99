"""What a report says about the run itself: versions, settings, hashes, repairs, files."""

from collections.abc import Mapping, Sequence

from ostiform.report.html import Section, Table


def run_section(
    groups: Mapping[str, Mapping[str, str]],
    seconds: Mapping[str, float],
    notes: Sequence[tuple[str, str]],
    inputs: Sequence[tuple[str, str, str, str]],
    results: Sequence[tuple[str, str]],
) -> Section:
    """Return what was run: versions, settings, hashes; and what was repaired or left out.

    Parameters
    ----------
    groups : mapping of str to mapping of str to str
        Names and values by the title of their table.
    seconds : mapping of str to float
        Wall time of each stage.
    notes : sequence of (str, str)
        Shape, and what was repaired or why it was left out.
    inputs : sequence of (str, str, str, str)
        Shape, what the file is, its path and its SHA-256.
    results : sequence of (str, str)
        A file beside the report, and what is in it.
    """
    tables = [
        Table(title, ("name", "value"), tuple(group.items()), rows_shown=len(group))
        for title, group in groups.items()
        if group
    ]
    if seconds:
        rows = [(stage, f"{value:.1f}") for stage, value in seconds.items()]
        rows.append(("together, before this report", f"{sum(seconds.values()):.1f}"))
        tables.append(Table("Wall time of the stages (s)", ("stage", "time"), tuple(rows)))
    tables.append(
        Table(
            "Repairs and shapes left out",
            ("shape", "what"),
            tuple(notes) or (("all shapes", "used as they were read: nothing was repaired"),),
        )
    )
    if inputs:
        tables.append(
            Table("Input files", ("shape", "holds", "file", "SHA-256"), tuple(inputs), rows_shown=0)
        )
    if results:
        tables.append(Table("Files beside this report", ("file", "what"), tuple(results)))
    return Section("run", "What was run", (), (), tuple(tables))
