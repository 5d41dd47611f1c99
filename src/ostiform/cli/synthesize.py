"""``ostiform synthesize``: new shapes and animations from a model file."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

import ostiform.model
from ostiform import pipeline
from ostiform.cli.options import DEFAULTS, Common, Output
from ostiform.cli.running import run_command
from ostiform.errors import InputError

FIRST_MODES = 3


@Parameter(name="*")
@dataclass(frozen=True)
class Wanted:
    """What to make."""

    mode: Annotated[
        list[int] | None,
        Parameter(help="A mode, from 1; may be given again.", negative=""),
    ] = None
    sd: Annotated[str, Parameter(help="Where on the modes, in standard deviations.")] = "-2,2"
    scores: Annotated[
        str | None,
        Parameter(help="One shape: standard deviations of the first modes, as 1.5,-1."),
    ] = None
    samples: Annotated[int, Parameter(help="How many random shapes.")] = 0
    seed: Annotated[int, Parameter(help="The random shapes follow from it.")] = 0
    cycle: Annotated[
        list[str] | None,
        Parameter(help="A beating shape: mean, or a subject; may be given again.", negative=""),
    ] = None
    heart: Annotated[
        str | None,
        Parameter(
            help="A new beating shape: standard deviations of the first modes between subjects."
        ),
    ] = None
    times: Annotated[int, Parameter(name=["--frames", "--times"], help="Shapes per cycle.")] = 20
    format: Annotated[
        list[Literal["vtp", "ply", "stl", "obj"]] | None,
        Parameter(help="Of the meshes; may be given again. Default vtp.", negative=""),
    ] = None
    animations: Annotated[bool, Parameter(help="Animate the modes and cycles.")] = True


NOTHING_CHOSEN = Wanted()


def synthesize(
    model: Annotated[Path, Parameter(help="A model file (model.h5).")],
    output: Output = Path("synthesized"),
    *,
    wanted: Wanted = NOTHING_CHOSEN,
    common: Common = DEFAULTS,
) -> int:
    """Write meshes and animations of shapes that a model can make.

    Without a choice: the mean, the first three modes at -2 and 2 standard deviations and, where
    the subjects have several phases, the mean cycle. Animations are written as WebP and as
    numbered PNG frames.
    """

    def work(on_event: pipeline.OnEvent) -> int:
        stored = ostiform.model.read_model(model)
        return _show(
            common,
            output,
            pipeline.synthesized(stored, output, _synthesis(stored, wanted), on_event),
        )

    return run_command(common, work)


def _synthesis(stored: ostiform.model.StoredModel, wanted: Wanted) -> pipeline.Synthesis:
    is_chosen = any((wanted.mode, wanted.scores, wanted.samples, wanted.cycle, wanted.heart))
    first = tuple(range(min(FIRST_MODES, len(stored.model.modes))))
    return pipeline.Synthesis(
        modes=tuple(number - 1 for number in wanted.mode or ()) if is_chosen else first,
        deviations=_numbers("--sd", wanted.sd),
        scores=None if wanted.scores is None else _numbers("--scores", wanted.scores),
        samples=wanted.samples,
        seed=wanted.seed,
        cycles=tuple(wanted.cycle or ()) if is_chosen else _own_cycle(stored),
        heart=None if wanted.heart is None else _numbers("--heart", wanted.heart),
        times=wanted.times,
        suffixes=tuple(f".{name}" for name in wanted.format or ("vtp",)),
        animations=wanted.animations,
    )


def _own_cycle(stored: ostiform.model.StoredModel) -> tuple[str, ...]:
    several = len({id.subject for id in stored.ids}) < len(stored.ids)
    return (pipeline.MEAN_CYCLE,) if several and not stored.model.residual_variance else ()


def _numbers(option: str, text: str) -> tuple[float, ...]:
    try:
        return tuple(float(piece) for piece in text.split(","))
    except ValueError:
        raise InputError(
            f'{option}: expected numbers separated by commas, found "{text}"'
        ) from None


def _show(common: Common, output: Path, written: list[Path]) -> int:
    names = [path.relative_to(output).as_posix() for path in written]
    if common.json:
        print(json.dumps({"output": str(output), "files": names}, indent=1, ensure_ascii=False))
    elif not common.quiet:
        films = [name for name in names if name.endswith(".webp")]
        print(f"{len(names) - len(films)} meshes and {len(films)} animations in {output}")
    return 0
