"""``ostiform adopt``: a model of shapes that correspond already."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

import ostiform.study
from ostiform import pipeline
from ostiform.cli.options import DEFAULTS, Common, Output
from ostiform.cli.running import run_command


@Parameter(name="*")
@dataclass(frozen=True)
class Source:
    """How the files of a source are to be read."""

    pattern: Annotated[
        str | None,
        Parameter(help='Names of the files, for example "{subject}_{phase}.vtp".'),
    ] = None
    sheet: Annotated[
        Path | None,
        Parameter(help="CSV or XLSX with the columns subject, phase, time, file."),
    ] = None
    names: Annotated[
        Path | None,
        Parameter(help="CSV with the columns name (PART.OSTIUM) and vertex (one of its rim)."),
    ] = None
    parts: Annotated[
        str, Parameter(help='Names of the parts, in order of the cell array "part".')
    ] = "surface"
    units: Annotated[Literal["mm", "cm", "m", "um"], Parameter(help="Of the files.")] = "mm"
    frame: Annotated[Literal["LPS", "RAS"], Parameter(help="Of the files.")] = "LPS"
    fields: Annotated[
        str,
        Parameter(
            help="Arrays of the meshes to carry, as voltage,region:label (labels name things)."
        ),
    ] = ""


AS_THEY_ARE = Source()


def adopt(
    source: Annotated[
        Path,
        Parameter(
            help="A folder of meshes that share their vertex order, of .particles files or of "
            "scalismo landmarks (.json); or a ShapeWorks project (.swproj, .xlsx)."
        ),
    ],
    output: Output = Path("out"),
    *,
    files: Source = AS_THEY_ARE,
    alignment: Annotated[
        Literal["rigid", "similarity", "none"], Parameter(help="How the shapes are aligned.")
    ] = "rigid",
    per: Annotated[
        Literal["subject", "shape"] | None,
        Parameter(help="What one transform belongs to; default by the number of phases."),
    ] = None,
    common: Common = DEFAULTS,
) -> int:
    """Make a results folder of shapes that correspond already, point by point.

    Meshes may be VTP, VTK, VTU, PLY, STL, OBJ; their boundary loops become openings. The folder can
    be used like that of a build: exported, fitted, synthesised.
    """

    def work() -> pipeline.Adopted:
        chosen = tuple(part.strip() for part in files.parts.split(","))
        settings = pipeline.SourceSettings(
            files.pattern,
            files.sheet,
            files.names,
            chosen,
            files.units,
            files.frame,
            ostiform.study.stated_fields(files.fields),
        )
        return pipeline.adopt_shapes(source, output, settings, alignment, per)

    return run_command(common, lambda _: _show(common, work()))


def _show(common: Common, adopted: pipeline.Adopted) -> int:
    if common.json:
        print(json.dumps(adopted.as_json(), indent=1, ensure_ascii=False))
    elif not common.quiet:
        for note in adopted.notes:
            print(note)
        print(
            f"{adopted.shapes} shapes of {adopted.points} points, {adopted.modes} modes, "
            f"results in {adopted.output}"
        )
    return 0
