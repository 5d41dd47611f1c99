"""``ostiform fit``: a model fitted to data that it has never seen."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Group, Parameter

import ostiform.model
import ostiform.study
from ostiform import fitting
from ostiform.cli.options import DEFAULTS, Common, Output
from ostiform.cli.running import run_command
from ostiform.fitting import FitSettings, PoseKnowledge, Scaling, TargetKind


@Parameter(name="*", group=Group("What the files are", sort_key=0))
@dataclass(frozen=True)
class Files:
    """How to read the targets."""

    kind: Annotated[
        TargetKind, Parameter(help="What the files are; auto tells by what they hold.")
    ] = "auto"
    units: Annotated[Literal["mm", "cm", "m", "um"], Parameter(help="Of the files.")] = "mm"
    frame: Annotated[
        Literal["LPS", "RAS"], Parameter(help="Of files that do not state theirs.")
    ] = "LPS"
    fields: Annotated[
        str,
        Parameter(
            help="Arrays of the surfaces to carry to the fitted one, as voltage,region:label "
            "(labels name things)."
        ),
    ] = ""
    openings: Annotated[
        Path | None,
        Parameter(
            help="Rough positions of openings (rows NAME x y z, or Slicer Markups): the boundary "
            "nearest to each is that opening. Default: matched by geometry."
        ),
    ] = None


DEFAULT_FILES = Files()


def fit(
    model: Annotated[Path, Parameter(help="A model file (model.h5), of Ostiform or scalismo.")],
    *targets: Annotated[
        str,
        Parameter(
            help="Files to fit to, all of one shape: meshes, curves, points, landmarks; "
            "PART=FILE where a file is one part of the model."
        ),
    ],
    output: Output = Path("fit"),
    pose: Annotated[
        PoseKnowledge,
        Parameter(
            help="near: turned by less than about 45 degrees against the model, anywhere; known: "
            "in the model's frame; unknown: turned in any way."
        ),
    ] = "near",
    scaling: Annotated[Scaling, Parameter(help="Whether the size belongs to the pose.")] = "rigid",
    noise: Annotated[
        float | None, Parameter(help="Noise of the data in mm; default estimated.")
    ] = None,
    files: Files = DEFAULT_FILES,
    common: Common = DEFAULTS,
) -> int:
    """Fit a model to a surface, points, contours or landmarks of a shape it has never seen.

    Writes OUTPUT/fitted.vtp (the most probable surface, with its uncertainty and residue at every
    point) and OUTPUT/fit.json (pose, scores with their covariance, residues, how typical the
    shape is of the model's population).
    """
    return run_command(
        common,
        lambda _: _fit(
            model, targets, output, files, lambda: FitSettings(pose, scaling, noise), common
        ),
    )


def _fit(
    model: Path,
    targets: tuple[str, ...],
    output: Path,
    files: Files,
    settings: Callable[[], FitSettings],
    common: Common,
) -> int:
    chosen = settings()  # in here, so that a wrong value is one sentence
    rules = fitting.FileRules(files.kind, files.units, files.frame)
    stored = ostiform.model.read_model(model)
    named = {}
    if files.openings is not None:
        labels, positions = fitting.read_named_points(files.openings, rules)
        named = dict(zip(labels, positions, strict=True))
    data = fitting.read_targets(targets, stored.model.mesh.parts, rules, named)
    prior = fitting.fit_prior(stored)
    fields = ostiform.study.stated_fields(files.fields)
    found = fitting.fit_shape(prior, data, chosen)
    carried = fitting.target_fields(targets, rules, fields, found, prior.model.mesh)
    facts = fitting.write_fit(output, prior, found, carried)
    if common.json:
        print(json.dumps({"output": str(output), **facts}, indent=1, ensure_ascii=False))
    elif not common.quiet:
        print(_summary(facts, output))
    return 0


def _summary(facts: dict[str, Any], output: Path) -> str:
    residue, typical = facts["residue_mm"], facts["typicality"]
    pose, there = facts["pose"], residue["data_to_model"]
    lines = [
        f"{facts['status']} after {facts['iterations']} iterations",
        f"data to model: mean {there['mean']:.2f} mm, 95 % {there['p95']:.2f} mm, largest "
        f"{there['maximum']:.2f} mm",
    ]
    back = residue["model_to_target"]
    if back is not None:
        lines.append(
            f"model to target: mean {back['mean']:.2f} mm, 95 % {back['p95']:.2f} mm, largest "
            f"{back['maximum']:.2f} mm, over {100 * residue['share_of_model_covered']:.0f} % of "
            "the model"
        )
    lines.append(
        f"posterior sd of a point: mean {facts['point_sd_mm']['mean']:.2f} mm, largest "
        f"{facts['point_sd_mm']['max']:.2f} mm"
    )
    sd = pose["sd"]
    lines.append(
        f"pose: scale {pose['scale']:.3f}, sd {sd['rotation_deg']:.1f} degrees and "
        f"{sd['translation_mm']:.2f} mm"
    )
    for loop, name in facts["openings_matched"].items():
        lines.append(f"{loop}: taken for {name}")
    lines += facts["notes"]
    lines.append(
        f"Mahalanobis distance {typical['mahalanobis']:.2f} with {typical['dof']:.1f} degrees of "
        f"freedom: beyond {100 * typical['percentile']:.0f} % of the population; beyond the modes "
        f"{typical['leftover_ratio']:.2f} times the energy of left-out shapes"
    )
    if typical["is_outlier"]:
        lines.append("outlier: " + "; ".join(typical["reasons"]))
    lines.append(f"results in {output}")
    return "\n".join(lines)
