"""Time, memory and accuracy of the whole chain on a population with known truth.

    python -m benchmarks.chain STUDY OUT [WORKERS]

STUDY is a study.toml, of the demonstration (`ostiform demo` writes one) or of
`benchmarks/populations.py`. The output folder must not exist: everything is measured from nothing.
"""

import resource
import sys
from pathlib import Path

from ostiform.evaluation import read_evaluation
from ostiform.pipeline import build_study

KINDS = ("conformal", "euclidean", "optimal")


def main(study: Path, output: Path, workers: int) -> None:
    """Build, then print a table of stages and a table of models."""
    summary = build_study(study, output, workers=workers)
    print("| stage | wall s |\n|---|---|")
    for stage, seconds in summary.seconds.items():
        print(f"| {stage} | {seconds:.1f} |")
    usage = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    processor = sum(item.ru_utime + item.ru_stime for item in usage)
    largest = max(item.ru_maxrss for item in usage) / 1024.0
    print(f"\n{processor:.0f} CPU s, largest process {largest:.0f} MB, {workers} workers\n")
    print("| model | N | variance mm² | description length | true mean / 95 % mm by part ", end="")
    print("| left-out residue mm, 1 to 10 modes | specificity mm | worst coverage mm |")
    print("|---|---|---|---|---|---|---|---|")
    for kind in KINDS:
        print(row(kind, output))


def row(kind: str, output: Path) -> str:
    """Return the row of one model."""
    found = read_evaluation(output / kind / "evaluation.json")
    truth = (
        ""
        if found.truth is None
        else ", ".join(
            f"{part} {mean:.2f} / {p95:.2f}" for part, (mean, p95) in found.truth.parts.items()
        )
    )
    residue = (
        ""
        if found.generalisation is None
        else (f"{found.generalisation.surface_mean[:, 1:].mean():.3f}")
    )
    coverage = max(item.p95 for item in found.coverage)
    return (
        f"| {kind} | {len(found.ids)} | {found.compactness.total:.2f} "
        f"| {found.description_length:.2f} | {truth} | {residue} "
        f"| {found.specificity.mean[-1]:.2f} | {coverage:.2f} |"
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]) if len(sys.argv) > 3 else 2)
