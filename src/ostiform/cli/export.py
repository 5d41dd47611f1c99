"""``ostiform export``: results in the formats of other programs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from ostiform import pipeline
from ostiform.cli.options import DEFAULTS, Common
from ostiform.cli.running import run_command


def export(
    results: Annotated[Path, Parameter(help="A results folder, or a model file (model.h5).")],
    output: Annotated[
        Path, Parameter(name=["--output", "-o"], help="Folder for the files; made if missing.")
    ] = Path("export"),
    *,
    format: Annotated[
        str,
        Parameter(
            name=["--format", "-f"],
            help="Comma-separated: statismo, vtp, gltf, csv, particles; or all that can be made.",
        ),
    ] = "all",
    modes: Annotated[int, Parameter(help="Modes written as meshes and as morph targets.")] = 5,
    common: Common = DEFAULTS,
) -> int:
    """Write results in the formats of other programs.

    statismo: the model for statismo and scalismo. vtp: mean, modes, and every shape with its
    scores. gltf: the modes as an animated modes.glb, and the mean cycle as cycle.glb. csv: scores
    and volumes. particles: particles, meshes and projects for ShapeWorks.
    """
    return run_command(common, lambda _: _export(results, output, format, modes, common))


def _export(results: Path, output: Path, format: str, modes: int, common: Common) -> int:
    names = None if format == "all" else tuple(name.strip() for name in format.split(","))
    written = pipeline.export_results(results, output, names, modes)  # type: ignore[arg-type]
    if common.json:
        print(json.dumps([str(path) for path in written], indent=1, ensure_ascii=False))
    elif not common.quiet:
        print(f"{len(written)} files in {output}")
    return 0
