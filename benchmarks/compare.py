"""Ostiform beside simple alternatives on populations with known truth: one command, one table.

    python -m benchmarks.compare
    python -m benchmarks.compare --families atria --phases 9 --points 512 --seeds 1
    python -m benchmarks.compare --poor 20
    python -m benchmarks.compare --permuted
    python -m benchmarks.compare --ablation

Populations, their maps and the alternatives' registrations are kept in the cache folder: a second
run pays for the correspondence only. Every method is run in a process of its own, one after the
other; `docs/benchmarks.md` says what is measured and how.
"""

import argparse
import importlib.util
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from benchmarks.cases import PREFIX_END, CaseName, loaded, prepared
from benchmarks.judging import Judged, Verdict, judged_once, summary
from benchmarks.optimisers import draw_optimisers
from benchmarks.peer_cache import peer_placement
from benchmarks.peers import DRIFT, PEERS
from benchmarks.placements import (
    CONJUGATE_GRADIENT,
    METHODS,
    OURS,
    Placement,
    Task,
    placements,
    prepared_case,
)
from ostiform.arrays import FloatArray, IntArray
from ostiform.correspondence import SweepRecord
from ostiform.evaluation import OriginalMesh
from ostiform.surface import closest_points, surface_tree

FAMILIES = ("atria", "ventricle", "one-mode", "left-hearts")
SEEDS = (1, 2, 3, 4, 5)
SMALL_PHASES = 4
LARGE = CaseName("atria", 4, 9, 1, 512)
"""The size at which a particle-based peer was measured."""

CACHE = Path("/tmp/ostiform-compare")

COLUMNS: Mapping[str, tuple[str, str]] = {
    "length": ("description length (truth)", "{length:.1f} ({true_length:.1f})"),
    "variance": ("variance mm² (truth)", "{variance:.2f} ({true_variance:.2f})"),
    "divided": (
        "normal (in true poses), tangential / truth",
        "{normal:.2f} ({normal_posed:.2f}), {tangential:.2f}",
    ),
    "error": ("error mm, mean / 95 %", "{error:.2f} / {error_95:.2f}"),
    "coverage": ("coverage mm, max / 95 %", "{coverage:.2f} / {coverage_95:.2f}"),
    "nearest": ("nearest point mm, max / 95 %", "{nearest:.2f} / {nearest_95:.2f}"),
    "residue": ("left-out residue mm", "{residue:.3f}"),
    "specificity": ("specificity mm", "{specificity:.3f}"),
    "rim": ("off the rim mm, max / mean", "{rim:.1e} / {rim_mean:.1e}"),
    "turned": ("turned", "{turned:.0f}"),
    "cost": ("CPU s", "{cpu_s:.1f}"),
    "wall": ("wall s", "{wall_s:.1f}"),
    "memory": ("MB", "{memory_mb:.0f}"),
}

RATIOS = {
    "error": "error",
    "error_95": "95 % error",
    "coverage": "coverage",
    "coverage_95": "95 % coverage",
    "nearest": "nearest point",
    "length": "description length",
}

ABLATIONS: Mapping[str, tuple[tuple[str, object], ...]] = {
    "all": (),
    "without coherence": (("coherence", 0.0),),
    "without metric": (("metric", 0.0),),
    "without stretch penalty": (("stretch", 0.0),),
    "without offset penalty": (("offset", 0.0),),
    "without any of these": (
        ("coherence", 0.0),
        ("metric", 0.0),
        ("stretch", 0.0),
        ("offset", 0.0),
    ),
    "one level fewer": (("levels", 3),),
    "level 1 only, then one of length": (("levels", 2),),
    "one sweep a level": (("sweeps", 1),),
    "no alignment in the loop": (("alignment", "none"),),
    "aligned shape by shape": (("per", "shape"),),
}


def main() -> None:
    """Run what was asked for and print its tables."""
    asked = arguments().parse_args()
    if DRIFT in asked.methods and importlib.util.find_spec("pycpd") is None:
        raise SystemExit(
            "benchmarks.compare: expected the package pycpd, found none; run `python -m pip "
            'install --group benchmarks`, or leave out the method "coherent point drift"'
        )
    asked.cache.mkdir(parents=True, exist_ok=True)
    phases = asked.phases or SMALL_PHASES
    groups = [
        [CaseName(family, asked.subjects, phases, seed, asked.points) for seed in asked.seeds]
        for family in asked.families
    ]
    if asked.phases is None and not (asked.poor or asked.permuted or asked.ablation):
        groups.insert(0, [LARGE])
    for name in (name for group in groups for name in group):
        prepared(asked.cache, name)
    if asked.ablation:
        show_ablation(asked, groups)
    elif asked.permuted:
        show_permuted(asked, groups)
    else:
        show_comparison(asked, groups)


def arguments() -> argparse.ArgumentParser:
    """Return the options of the command."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--families", nargs="+", default=list(FAMILIES), choices=FAMILIES)
    parser.add_argument("--seeds", nargs="+", type=int, default=list(SEEDS))
    parser.add_argument("--subjects", type=int, default=4)
    parser.add_argument(
        "--phases",
        type=int,
        help=f"default {SMALL_PHASES}, and 36 atria first: {LARGE.subjects} x {LARGE.phases}",
    )
    parser.add_argument("--points", type=int, default=512, help="of the template")
    parser.add_argument("--methods", nargs="+", default=list(METHODS), choices=METHODS)
    parser.add_argument(
        "--full",
        type=int,
        default=1,
        metavar="SEEDS",
        help="on so many seeds of a family the alternatives run and subjects are left out too",
    )
    parser.add_argument("--poor", type=float, default=0.0, metavar="DEGREES", help="turn the rims")
    parser.add_argument("--permuted", action="store_true", help="another order of the shapes")
    parser.add_argument("--ablation", action="store_true", help="each ingredient off in turn")
    parser.add_argument("--cache", type=Path, default=CACHE)
    parser.add_argument("--json", type=Path, help="write every number here too")
    parser.add_argument(
        "--image", type=Path, help="draw the optimisers on the first population here"
    )
    return parser


def show_comparison(asked: argparse.Namespace, groups: Sequence[Sequence[CaseName]]) -> None:
    """Print the table of methods; with several seeds, their median and worst."""
    print(header("population", "N", "P", "method"), flush=True)
    everything, remarks = [], []
    histories: dict[str, Sequence[SweepRecord]] = {}
    for group in groups:
        by_method: dict[str, list[Judged]] = {}
        for number, name in enumerate(group):
            is_full = number < asked.full
            task = Task(asked.cache, name, "", poor=asked.poor, with_folds=is_full)
            case = prepared_case(task)
            shared = case.shared_metric()
            size = len(case.ids), len(shared.template.points)
            for placement in placed(task, asked.methods):
                item = judged_once(asked.cache, case, shared, placement, is_full)
                by_method.setdefault(item.method, []).append(item)
                if item.method in ("optimal", CONJUGATE_GRADIENT):
                    histories.setdefault(item.method, placement.history)
                everything.append(record(name, asked.poor, item))
        for method, items in by_method.items():
            found = [item.verdict for item in items]
            if len(items) == 1:
                label = f"{name.family}, seed {group[0].seed}"
                print(row((label, *size, method), found[0]), flush=True)
                continue
            for kind in ("median", "worst"):
                label = f"{name.family}, {kind} of {len(items)}"
                print(row((label, *size, method), summary(found, kind)), flush=True)
        remarks += [*parts_told(name, by_method), *ratios_told(name, by_method)]
    print("\n" + "\n".join(remarks))
    if asked.json is not None:
        asked.json.write_text(json.dumps(everything, indent=1), encoding="utf-8")
    if asked.image is not None:
        draw_optimisers(asked.image, histories)


def placed(task: Task, methods: Sequence[str]) -> Iterable[Placement]:
    """Yield the placements of the methods asked for, in their order."""
    if set(methods) & set(OURS):
        for placement in placements(replace(task, method="ours")):
            if placement.method in methods:
                yield placement
    if not task.with_folds:
        return
    if CONJUGATE_GRADIENT in methods:
        yield from placements(replace(task, method=CONJUGATE_GRADIENT, with_folds=False))
    for method in PEERS:
        if method in methods:
            yield peer_placement(replace(task, method=method))


def parts_told(name: CaseName, by_method: Mapping[str, Sequence[Judged]]) -> Iterable[str]:
    """Yield the errors part by part where there is more than one, as medians over the seeds."""
    for method, items in by_method.items():
        if len(items[0].parts) > 1:
            told = ", ".join(
                f"{part} {np.median([item.parts[part][0] for item in items]):.2f} / "
                f"{np.median([item.parts[part][1] for item in items]):.2f}"
                for part in items[0].parts
            )
            yield f"- {name.family}, {method}: error by part, mean / 95 % mm: {told}"


def ratios_told(name: CaseName, by_method: Mapping[str, Sequence[Judged]]) -> Iterable[str]:
    """Yield how the optimal model does against the other two of the paper, seed by seed."""
    for other in ("conformal", "euclidean"):
        if other not in by_method or "optimal" not in by_method:
            continue
        pairs = [
            (mine.verdict, theirs.verdict)
            for mine, theirs in zip(by_method["optimal"], by_method[other], strict=True)
        ]
        told = []
        for field, title in RATIOS.items():
            ratios = [getattr(mine, field) / getattr(theirs, field) for mine, theirs in pairs]
            told.append(f"{title} {np.median(ratios):.3f} (worst {max(ratios):.3f})")
        mine, theirs = (
            np.array([item.residues[1:] for item in by_method[method] if item.residues])
            for method in ("optimal", other)
        )  # (seeds, modes)
        if len(mine):
            means = mine.mean(axis=1) / theirs.mean(axis=1)
            pooled = mine.mean(axis=0) / theirs.mean(axis=0)
            told.append(f"left-out residue {np.median(means):.3f} (worst {means.max():.3f})")
            told.append(
                f"at the worst number of modes {pooled.max():.3f} "
                f"(of one population {(mine / theirs).max():.3f})"
            )
        size = name.subjects * name.phases
        yield f"- {name.family}, N = {size}, optimal over {other}: {', '.join(told)}"


def show_permuted(asked: argparse.Namespace, groups: Sequence[Sequence[CaseName]]) -> None:
    """Print how far corresponding points move when the shapes come in another order."""
    print(
        "| population | method | moved mm | mean error mm | moved / error |\n|---|---|---|---|---|"
    )
    for name in (name for group in groups for name in group):
        task = Task(asked.cache, name, "ours")
        case = loaded(asked.cache, name)
        shared = case.shared_metric()
        other_task = replace(task, name=replace(name, permuted=True))
        other = loaded(asked.cache, other_task.name)
        found = {
            (id.subject.split(PREFIX_END, 1)[1], id.phase): i for i, id in enumerate(other.ids)
        }
        order = [found[id.subject, id.phase] for id in case.ids]
        faces = other.shared_metric().template.faces
        for first, second in zip(placements(task), placements(other_task), strict=True):
            originals = [case.original(index) for index in range(len(case.ids))]
            runs = first.points, second.points[order]
            moved = moved_points(*runs, shared.weights, faces, originals)
            error = judged_once(asked.cache, case, shared, first, False).verdict.error
            print(
                f"| {name.family}, seed {name.seed} | {first.method} | {moved:.1e} | {error:.3f} "
                f"| {100 * moved / error:.2g} % |",
                flush=True,
            )


def moved_points(
    first: FloatArray,
    second: FloatArray,
    weights: FloatArray,
    faces: IntArray,
    originals: Sequence[OriginalMesh],
) -> float:
    """Return the weighted mean distance (mm) between the corresponding points of two runs.

    The templates need not be the same. Each point of the first run on one shape is looked up on
    the second run's sampling of that shape; its barycentric place there gives its place on every
    other shape, moved to the closest point of that surface, which is compared with the first
    run's. The mean is over all ordered pairs. Where the templates differ, this counts the error
    of linear interpolation between the second run's points as well.
    """
    trees = [surface_tree(original.vertices, original.faces) for original in originals]
    found = []
    for source in range(len(first)):
        place = closest_points(surface_tree(second[source], faces), first[source])
        carried = np.einsum("pk,npkd->npd", place.barycentric, second[:, faces[place.faces]])
        on_surface = np.stack(
            [closest_points(tree, own).points for tree, own in zip(trees, carried, strict=True)]
        )
        gaps = np.linalg.norm(on_surface - first, axis=2) @ weights
        found.append(np.delete(gaps, source).mean())
    return float(np.mean(found))


def show_ablation(asked: argparse.Namespace, groups: Sequence[Sequence[CaseName]]) -> None:
    """Print the optimal model with each ingredient switched off alone, medians over the seeds."""
    print(header("population", "N", "P", "ingredients"), flush=True)
    for group in groups:
        for label, changes in ABLATIONS.items():
            found = []
            for name in group:
                task = Task(asked.cache, name, "ours", changes=changes, poor=asked.poor)
                case = prepared_case(task)
                shared = case.shared_metric()
                optimal = placements(task)[-1]
                found.append(judged_once(asked.cache, case, shared, optimal, False).verdict)
            size = len(case.ids), len(shared.template.points)
            print(row((name.family, *size, label), summary(found, "median")), flush=True)


def header(*labels: str) -> str:
    """Return the head of a table."""
    titles = [*labels, *(title for title, _ in COLUMNS.values())]
    return f"| {' | '.join(titles)} |\n|{'---|' * len(titles)}"


def row(labels: Sequence[object], verdict: Verdict) -> str:
    """Return a row of a table; what was not measured is left blank."""
    values = asdict(verdict)
    cells = [form.format(**values).replace("nan", "") for _, form in COLUMNS.values()]
    return f"| {' | '.join([*map(str, labels), *cells])} |"


def record(name: CaseName, poor: float, item: Judged) -> dict[str, object]:
    """Return everything measured about one method on one population."""
    numbers = {key: None if np.isnan(v) else v for key, v in asdict(item.verdict).items()}
    return {
        **asdict(name),
        "poor_deg": poor,
        "method": item.method,
        **numbers,
        "parts": item.parts,
        "residues": item.residues,
    }


if __name__ == "__main__":
    main()
