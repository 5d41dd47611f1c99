"""``ostiform compare`` and ``ostiform regress``: shape or a field against groups and covariates."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal
from urllib.parse import quote

from cyclopts import Parameter

from ostiform import pipeline
from ostiform.cli.options import DEFAULTS, Common
from ostiform.cli.running import run_command
from ostiform.statistics import EffectSettings

Results = Annotated[Path, Parameter(help="A folder of results, with model.h5.")]


@Parameter(name="*")
@dataclass(frozen=True)
class Testing:
    """How to test."""

    output: Annotated[
        Path | None,
        Parameter(
            name=["--output", "-o"], help="Folder for the answer; default RESULTS/statistics/NAME."
        ),
    ] = None
    adjust: Annotated[
        list[str] | None,
        Parameter(help="A column to adjust for; may be given again.", negative=""),
    ] = None
    categorical: Annotated[
        list[str] | None,
        Parameter(help="A column of numbers that are categories.", negative=""),
    ] = None
    sheet: Annotated[
        Path | None,
        Parameter(help="CSV or XLSX with a column subject; default the study's own sheet."),
    ] = None
    phase: Annotated[
        str | None,
        Parameter(help="The phase that stands for a subject; default its mean over the cycle."),
    ] = None
    field: Annotated[
        str | None, Parameter(help="A field of the surface to test; default shape.")
    ] = None
    movement: Annotated[
        Literal["any", "normal"], Parameter(help="Which movement of a point is tested.")
    ] = "any"
    permutations: Annotated[int, Parameter(help="How many.")] = EffectSettings().permutations
    seed: Annotated[int, Parameter(help="The permutations follow from it.")] = 0
    modes: Annotated[
        int | None, Parameter(help="Modes of the test of the whole shape; default by variance.")
    ] = None


AS_USUAL = Testing()


def compare(
    results: Results,
    *,
    group: Annotated[str, Parameter(help="The column that says the group.")],
    testing: Testing = AS_USUAL,
    common: Common = DEFAULTS,
) -> int:
    """Test whether and where the shapes of groups differ.

    The groups are the values of a column of the study's sheet. Subjects, not shapes, are compared
    and permuted. The answer is a page with maps, a VTP surface with the difference and its p- and
    q-values at every point, the mean shape of every group, and the numbers as JSON and CSV.
    """
    return _answer(results, group, (group,), testing, common)


def regress(
    results: Results,
    *,
    on: Annotated[str, Parameter(help="The column: age, say.")],
    testing: Testing = AS_USUAL,
    common: Common = DEFAULTS,
) -> int:
    """Test whether and where shape depends on a covariate, adjusted for others.

    The covariates are columns of the study's sheet; a column of numbers is continuous, any other
    one categorical. Subjects, not shapes, are permuted. The answer is as that of compare, with the
    change per unit and the shapes fitted at the 5th and 95th percentile.
    """
    return _answer(results, on, (), testing, common)


def _answer(
    results: Path, column: str, categorical: tuple[str, ...], testing: Testing, common: Common
) -> int:
    def work(on_event: pipeline.OnEvent) -> int:
        question = pipeline.Question(
            covariate=column,
            adjusted=tuple(testing.adjust or ()),
            categorical=(*categorical, *(testing.categorical or ())),
            phase=testing.phase,
            field=testing.field,
            settings=EffectSettings(
                permutations=testing.permutations,
                seed=testing.seed,
                movement=testing.movement,
                modes=testing.modes,
            ),
        )
        name = column if testing.field is None else f"{testing.field} by {column}"
        folder = testing.output or results / "statistics" / quote(name, safe=" ")
        on_event(pipeline.Progress("test", 0, 1))
        answer = pipeline.shape_question(results, question, folder, testing.sheet)
        on_event(pipeline.Progress("test", 1, 1))
        return _show(common, answer)

    return run_command(common, work)


def _show(common: Common, answer: pipeline.EffectResult) -> int:
    facts = answer.as_json()
    if common.json:
        print(json.dumps(facts, indent=1, ensure_ascii=False))
    elif not common.quiet:
        whole, points = answer.effect.whole, facts["points"]
        print(
            f"{answer.name}: {len(answer.subjects)} subjects, "
            f"p = {whole.p_value:.4g} ({whole.n_modes} modes, "
            f"{100 * whole.explained:.1f} % of the variance)"
        )
        print(
            f"{points['found_q_0.05']} of {points['number']} points with q at most 0.05, "
            f"{points['found_family_0.05']} with max-T p at most 0.05"
        )
        for warning in answer.warnings:
            print(f"warning: {warning}")
        print(f"report: {answer.folder / 'report.html'}")
    return 0
