"""``ostiform widen``: a model widened by a smooth Gaussian process."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

import ostiform.model
from ostiform.cli.options import DEFAULTS, Common
from ostiform.cli.running import run_command
from ostiform.errors import InputError


def widen(
    model: Annotated[Path, Parameter(help="A model file, of Ostiform or of scalismo.")],
    output: Annotated[Path, Parameter(name=["--output", "-o"], help="The new model file.")],
    *,
    sd: Annotated[
        str,
        Parameter(help="Standard deviation per coordinate in mm; comma-separated for scales."),
    ],
    length: Annotated[
        str, Parameter(help="Length over which displacements go together, mm; as many as --sd.")
    ],
    kernel: Annotated[
        Literal["gaussian", "compact"], Parameter(help="Shape of the kernel.")
    ] = "gaussian",
    left_out: Annotated[
        float, Parameter(help="Share of the kernel's variance that may be left out.")
    ] = 0.01,
    common: Common = DEFAULTS,
) -> int:
    """Widen a model built from few shapes by a smooth Gaussian process.

    The covariance of the new model is the old one's plus that of random smooth displacements; what
    was added is said, in mm^2 per point.
    """
    return run_command(
        common, lambda _: _widen(model, output, _kernels(sd, length, kernel), left_out, common)
    )


def _kernels(
    sd: str, length: str, shape: Literal["gaussian", "compact"]
) -> list[ostiform.model.Kernel]:
    values = {}
    for name, written in (("--sd", sd), ("--length", length)):
        try:
            values[name] = [float(word) for word in written.split(",")]
        except ValueError:
            raise InputError(f'{name}: expected millimetres, found "{written}"') from None
    if len(values["--sd"]) != len(values["--length"]):
        raise InputError(
            f"--sd, --length: expected as many of both, found {len(values['--sd'])} and "
            f"{len(values['--length'])}"
        )
    return [
        ostiform.model.Kernel(deviation, reach, shape)
        for deviation, reach in zip(values["--sd"], values["--length"], strict=True)
    ]


def _widen(
    model: Path, output: Path, kernels: list[ostiform.model.Kernel], left_out: float, common: Common
) -> int:
    stored = ostiform.model.read_model(model)
    new, result = ostiform.model.widened_stored(stored, kernels, left_out)
    ostiform.model.write_model(output, new)
    facts = {
        "output": str(output),
        "modes": len(result.model.modes),
        "variance_mm2": stored.model.total_variance,
        "added_variance_mm2": result.added_variance,
        "kernel_variance_mm2": result.kernel_variance,
    }
    if common.json:
        print(json.dumps(facts, indent=1))
    elif not common.quiet:
        print(
            f"{facts['modes']} modes in {output}: {stored.model.total_variance:.3f} mm2 per point "
            f"and {result.added_variance:.3f} added (of {result.kernel_variance:.3f} of the kernel)"
        )
    return 0
