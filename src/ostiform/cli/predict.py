"""``ostiform predict``: the whole cycle of an unseen heart from one or a few of its phases."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from cyclopts import Parameter

from ostiform import fitting, pipeline
from ostiform.cli.options import DEFAULTS, Common, Output
from ostiform.cli.running import run_command
from ostiform.errors import InputError


def predict(
    model: Annotated[Path, Parameter(help="A model file (model.h5) of subjects with phases.")],
    *shapes: Annotated[
        str,
        Parameter(
            help="One per given phase: a surface, or the files of its parts as LV=FILE,LA=FILE."
        ),
    ],
    times: Annotated[
        str, Parameter(help="Fractions of the cycle of the shapes, as 0 or 0,0.35.")
    ] = "0",
    frames: Annotated[int, Parameter(help="How many times of the cycle to predict.")] = 20,
    units: Annotated[Literal["mm", "cm", "m", "um"], Parameter(help="Of the files.")] = "mm",
    frame: Annotated[Literal["LPS", "RAS"], Parameter(help="Of the files.")] = "LPS",
    output: Output = Path("predicted"),
    common: Common = DEFAULTS,
) -> int:
    """Predict the whole cycle of a heart from one or a few of its phases.

    Writes a surface per time with the standard deviation of its points, clinical.csv and
    prediction.json to OUTPUT.
    """
    rules = fitting.FileRules("auto", units, frame)
    return run_command(
        common, lambda _: _predict(model, shapes, (times, frames), rules, output, common)
    )


def _predict(
    model: Path,
    shapes: tuple[str, ...],
    when: tuple[str, int],
    rules: fitting.FileRules,
    output: Path,
    common: Common,
) -> int:
    given = _numbers(when[0])
    if when[1] < 1:
        raise InputError(f"--frames: expected at least 1, found {when[1]}")
    instants = np.arange(when[1]) / when[1]
    prediction = pipeline.predicted_cycle(model, shapes, given, instants, rules)
    facts = pipeline.write_prediction(output, prediction)
    if facts["warning"]:
        print(f"warning: {facts['warning']}", file=sys.stderr)
    if common.json:
        print(json.dumps({"output": str(output), **facts}, indent=1, ensure_ascii=False))
    elif not common.quiet:
        for shape, source in zip(shapes, facts["given_shapes"], strict=True):
            print(f"{shape}: {source}")
        print(
            f"{when[1]} shapes in {output}; standard deviation of a coordinate "
            f"{np.mean(facts['mean_sd_mm']):.2f} mm"
        )
        print(
            f"training subjects, each predicted from the others: {facts['left_out_error_mm']:.2f} "
            f"mm; by the mean motion {facts['left_out_mean_motion_mm']:.2f} mm, by the nearest "
            f"subject's motion {facts['left_out_nearest_subject_mm']:.2f} mm"
        )
    return 0


def _numbers(written: str) -> list[float]:
    try:
        return [float(text) for text in written.split(",")]
    except ValueError:
        raise InputError(
            f'--times: expected numbers with commas between them, found "{written}"'
        ) from None
