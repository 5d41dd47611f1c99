"""``ostiform demo``: a population of left hearts is written, then built like any other study."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from ostiform import pipeline
from ostiform.cli.options import DEFAULTS, Common, Output
from ostiform.cli.running import run_command, show_summary, worker_count


def demo(
    output: Output = Path("demo"),
    *,
    subjects: Annotated[int, Parameter(help="Subjects of the population.")] = 4,
    shapes: Annotated[int, Parameter(help="Shapes in all, shared out over the subjects.")] = 34,
    seed: Annotated[int, Parameter(help="Everything random follows from it.")] = 2004,
    common: Common = DEFAULTS,
) -> int:
    """Build the model of a generated population of beating left hearts.

    The population (left ventricle with outflow tract, left atrium with four pulmonary veins,
    joined at the mitral annulus) is written to OUTPUT/study as ordinary files with a study.toml,
    its true correspondence kept aside; then `ostiform build` runs on it, with results in
    OUTPUT/results.
    """
    return run_command(
        common,
        lambda on_event: show_summary(
            common,
            pipeline.build_study(
                pipeline.demonstration_study(
                    output / "study", subjects, shapes, seed, worker_count(common), on_event
                ),
                output / "results",
                workers=worker_count(common),
                on_event=on_event,
            ),
        ),
    )
