"""``ostiform fit``: a model fitted to data that it has never seen."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Group, Parameter

import ostiform.model
import ostiform.study
from ostiform import fitting, pipeline
from ostiform.cli.options import DEFAULTS, Common, Output
from ostiform.cli.running import run_command
from ostiform.errors import InputError
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


@Parameter(name="*", group=Group("All phases at once", sort_key=1))
@dataclass(frozen=True)
class Phases:
    """Fitting to a whole cycle."""

    sequence: Annotated[
        Path | None,
        Parameter(
            help="Fit all phases of a beating shape at once: a sheet of phases (CSV, XLSX), guide "
            "points, or a label map with frames; further views or files as TARGETS."
        ),
    ] = None
    shift_sd: Annotated[
        float,
        Parameter(help="Standard deviation in mm of a slice's shift in its plane; 0 for none."),
    ] = 2.0
    frames: Annotated[int, Parameter(help="Times of the cycle to write.")] = 25
    frames_per_cycle: Annotated[
        int | None,
        Parameter(help="Of numbered files. Default: the highest number and one."),
    ] = None
    labels: Annotated[
        tuple[str, ...],
        Parameter(
            help="Labels of parts in label maps, PART=VALUE[+VALUE]. Default: by known names and "
            "values."
        ),
    ] = ()


DEFAULT_PHASES = Phases()


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
    phases: Phases = DEFAULT_PHASES,
    common: Common = DEFAULTS,
) -> int:
    """Fit a model to a surface, points, contours or landmarks of a shape it has never seen.

    Writes OUTPUT/fitted.vtp (the most probable surface, with its uncertainty and residue at every
    point) and OUTPUT/fit.json (pose, scores with their covariance, residues, how typical the
    shape is of the model's population).

    With --sequence: all phases of a beating shape at once. Writes the surface of every phase and
    of even times of the cycle, curves.csv (volumes, openings, axes, with intervals), shifts.csv,
    cycle.glb, cycle.webp and fit.json.
    """
    if phases.sequence is not None:
        sources = (phases.sequence, *map(Path, targets))
        return run_command(
            common,
            lambda _: _fit_sequence(
                model, sources, output, files, phases, (pose, scaling, noise), common
            ),
        )
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


def _fit_sequence(
    model: Path,
    sources: tuple[Path, ...],
    output: Path,
    files: Files,
    phases: Phases,
    chosen: tuple[PoseKnowledge, Scaling, float | None],
    common: Common,
) -> int:
    pose, scaling, noise = chosen
    if scaling != "rigid":
        raise InputError("--scaling: expected rigid with --sequence, found similarity")
    settings = fitting.SequenceSettings(pose, noise, phases.shift_sd)
    rules = fitting.SequenceRules(
        fitting.FileRules(files.kind, files.units, files.frame),
        fitting.parsed_labels(phases.labels),
        phases.frames_per_cycle,
    )
    stored = ostiform.model.read_model(model)
    found = fitting.read_sequence(sources, stored.model.mesh, rules)
    prior = fitting.sequence_prior(stored)
    fit = fitting.fit_sequence(prior, found.phases, settings)
    facts = pipeline.write_sequence(output, stored, prior, fit, phases.frames, found.notes)
    for note in facts["notes"]:
        print(f"warning: {note}", file=sys.stderr)
    if common.json:
        print(json.dumps({"output": str(output), **facts}, indent=1, ensure_ascii=False))
    elif not common.quiet:
        print(_sequence_summary(facts, output))
    return 0


def _sequence_summary(facts: dict[str, Any], output: Path) -> str:
    distances = [phase["data_to_model_mm"]["mean"] for phase in facts["phases"].values()]
    sd = facts["pose"]["sd"]
    lines = [
        f"{len(distances)} phases: {facts['status']} after {facts['iterations']} iterations",
        f"data to model: mean {sum(distances) / len(distances):.2f} mm, worst phase "
        f"{max(distances):.2f} mm",
        f"posterior sd of a point: mean {facts['point_sd_mm']['mean']:.2f} mm, largest "
        f"{facts['point_sd_mm']['max']:.2f} mm",
        f"pose: sd {sd['rotation_deg']:.1f} degrees and {sd['translation_mm']:.2f} mm",
    ]
    if facts["shifts_mm"]:
        sizes = [sum(v * v for v in shift) ** 0.5 for shift in facts["shifts_mm"].values()]
        lines.append(
            f"{len(sizes)} slices shifted by {sum(sizes) / len(sizes):.1f} mm on average, at most "
            f"{max(sizes):.1f} mm"
        )
    for part, own in facts["ejection"].items():
        low, high = own["interval_percent"]
        lines.append(
            f"{part}: {own['largest_volume_ml']:.1f} to {own['smallest_volume_ml']:.1f} ml, "
            f"ejection fraction {own['ejection_fraction_percent']:.1f} % (95 % {low:.1f} to "
            f"{high:.1f})"
        )
    if facts["typicality"]["is_outlier"]:
        lines.append("outlier: " + "; ".join(facts["typicality"]["reasons"]))
    lines.append(f"results in {output}")
    return "\n".join(lines)


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
