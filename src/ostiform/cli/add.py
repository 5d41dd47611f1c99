"""``ostiform add``: further shapes in a finished model."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from ostiform import pipeline
from ostiform.cli.options import DEFAULTS, Common, StudyPath
from ostiform.cli.running import run_command


def add(
    results: Annotated[Path, Parameter(help="The results folder of a build.")],
    study: StudyPath,
    shapes: Annotated[
        tuple[str, ...],
        Parameter(
            help="SUBJECT or SUBJECT/PHASE; default every shape that is new in the study.",
            negative="",
            show_default=False,
        ),
    ] = (),
    *,
    output: Annotated[
        Path, Parameter(name=["--output", "-o"], help="A new folder for the larger model.")
    ],
    common: Common = DEFAULTS,
) -> int:
    """Add shapes to a finished model without moving the others.

    List the new shapes in the build's study first. The points of all others stay bit for bit; only
    the principal components are computed afresh.
    """
    return run_command(
        common,
        lambda on_event: _show(
            common, pipeline.add_shapes(results, study, output, shapes, on_event)
        ),
    )


def _show(common: Common, addition: pipeline.Addition) -> int:
    if common.json:
        print(json.dumps(addition.as_json(), indent=1, ensure_ascii=False))
    elif not common.quiet:
        for shape in addition.added:
            print(
                f"{shape.name}: {shape.residue_mm:.2f} mm from what the model "
                f"could make, surface covered to {shape.coverage_p95_mm:.2f} mm"
            )
        print(f"{addition.after} shapes, {addition.before} unchanged, in {addition.output}")
    return 0
