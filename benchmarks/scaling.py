"""Time and memory against the number of shapes: 36, 99, 297 and 1,008 by default.

    python -m benchmarks.scaling FOLDER [--subjects 4 11 33 112] [--points 2500] [--workers 2]
    python -m benchmarks.scaling FOLDER --subjects 33 --points 1000 --batches 150 75
    python -m benchmarks.scaling FOLDER --large

Every shape is a generated atrium of its own (`benchmarks.populations`), meshed on its own grid;
the smaller populations are the first subjects of the largest. Measured are the commands that a
user runs, `ostiform embed` and then `ostiform model` (the same as the second alone), each in a
fresh process with its workers. Memory is the proportional set size of all processes together,
sampled once a second. FOLDER keeps the populations, not the results.
"""

import argparse
import csv
import json
import resource
import shutil
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import psutil

from benchmarks.populations import EDGES_MM, family
from ostiform.correspondence import Correspondence
from ostiform.correspondence.streaming import streamed_length, streamed_spectrum
from ostiform.correspondence.terms.description_length import length_of_spectrum, spectrum
from ostiform.demo.demonstration import write_population
from ostiform.model import read_correspondence

PHASES = 9
SEED = 1


@dataclass(frozen=True, slots=True)
class Cost:
    """What a command cost; `stages` are wall seconds as the command says itself."""

    cpu_s: float
    wall_s: float
    peak_gb: float
    stages: dict[str, float]


def main() -> None:
    """Measure what was asked for and print its table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--subjects", type=int, nargs="+", default=[4, 11, 33, 112])
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--points", type=int, default=2500)
    parser.add_argument("--batches", type=int, nargs="+", help="compare these sizes with all")
    parser.add_argument("--large", action="store_true", help="decompose 10,000 shapes")
    asked = parser.parse_args()
    if asked.large:
        print(json.dumps(decomposed()))
        return
    population(asked.folder, max(asked.subjects), asked.workers)
    if asked.batches:
        show_batches(asked)
    else:
        show_scaling(asked)


def show_scaling(asked: argparse.Namespace) -> None:
    """Print a row for every number of subjects, and the exponents."""
    stages = ("prepare", "embed", "correspond", "model")
    titles = ["N", "read and map, CPU s", "the rest, CPU s", "all, CPU s"]
    titles += [f"{stage}, wall s" for stage in stages] + ["all, wall s", "peak GB"]
    print(f"| {' | '.join(titles)} |\n|{'---|' * len(titles)}")
    sizes, rows = [], []
    for subjects in asked.subjects:
        study = study_of(asked.folder, subjects, asked.points)
        out = study.parent / "out"
        shutil.rmtree(out, ignore_errors=True)
        mapped = run("embed", study, out, asked.workers)
        modelled = run("model", study, out, asked.workers)
        seconds = [mapped.stages[stage] for stage in stages[:2]]
        seconds += [modelled.stages[stage] for stage in stages[2:]]
        sizes.append(subjects * PHASES)
        rows.append(
            [mapped.cpu_s, modelled.cpu_s, mapped.cpu_s + modelled.cpu_s, *seconds]
            + [mapped.wall_s + modelled.wall_s, max(mapped.peak_gb, modelled.peak_gb)]
        )
        cells = [f"{value:.1f}" for value in rows[-1][:-1]]
        print(f"| {sizes[-1]} | {' | '.join(cells)} | {rows[-1][-1]:.2f} |", flush=True)
        shutil.rmtree(out)
    if len(sizes) > 1:
        slopes = np.polyfit(np.log(sizes), np.log(rows), 1)[0]
        print(f"| exponent | {' | '.join(f'{slope:.2f}' for slope in slopes)} |")


def show_batches(asked: argparse.Namespace) -> None:
    """Print how sweeps in batches end beside whole ones, and how the two decompositions agree."""
    print("| N | batch | CPU s | sweeps | description length | points apart, mm |\n|" + "---|" * 6)
    for subjects in asked.subjects:
        study = study_of(asked.folder, subjects, asked.points)
        out = study.parent / "out"
        shutil.rmtree(out, ignore_errors=True)
        run("embed", study, out, asked.workers)
        stated, whole = study.read_text(), None
        for size in (None, *asked.batches):
            study.write_text(stated + (f"\n[correspondence]\nbatch = {size}\n" if size else ""))
            cost = run("model", study, out, asked.workers)
            found = read_correspondence(out / "correspondence.h5")
            facts = json.loads((out / "correspondence.json").read_text())
            whole = whole or found
            gaps = np.linalg.norm(found.points - whole.points, axis=2) @ found.weights
            sweeps = sum(record["sweep"] > 0 for record in facts["history"])
            exact = spectrum(found.aligned, found.weights)
            length = length_of_spectrum(exact.eigenvalues, facts["l_cut_mm2"])
            print(
                f"| {subjects * PHASES} | {size or 'all'} | {cost.cpu_s:.0f} | {sweeps} "
                f"| {length:.1f} | {gaps.mean():.2f} |",
                flush=True,
            )
        print(decompositions_told(whole, facts["l_cut_mm2"]))
        study.write_text(stated)
        shutil.rmtree(out)


def decompositions_told(found: Correspondence, l_cut: float) -> str:
    """Return how the exact and the streamed decomposition of shapes agree."""
    exact = spectrum(found.aligned, found.weights)
    streamed = streamed_spectrum(
        lambda: (found.aligned[first : first + 50] for first in range(0, len(found.ids), 50)),
        found.weights,
        l_cut,
        np.random.default_rng(0),
    )
    strong = len(streamed.eigenvalues)
    error = np.abs(streamed.eigenvalues / exact.eigenvalues[:strong] - 1.0).max()
    lengths = streamed_length(streamed, l_cut), length_of_spectrum(exact.eigenvalues, l_cut)
    return (
        f"{strong} eigenvalues above the cut-off, streamed against exact: largest relative error "
        f"{error:.1e}, of the description length {abs(lengths[0] / lengths[1] - 1.0):.1e}"
    )


def population(folder: Path, subjects: int, workers: int) -> None:
    """Write the largest population, if it is not there."""
    if (folder / "population" / "study.toml").is_file():
        found = len(rows_of(folder)) // PHASES
        if found < subjects:
            raise SystemExit(
                f"benchmarks.scaling: expected {subjects} subjects in {folder / 'population'}, "
                f"found {found}: remove that folder"
            )
        return
    with ProcessPoolExecutor(workers) as pool:
        truth = family("atria", subjects, PHASES, SEED)
        write_population(folder / "population", truth, EDGES_MM["atria"], pool.map)


def rows_of(folder: Path) -> list[dict[str, str]]:
    with (folder / "population" / "shapes.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def study_of(folder: Path, subjects: int, points: int) -> Path:
    """Write a study of the first subjects and return its file."""
    rows = rows_of(folder)[: subjects * PHASES]
    study = folder / f"{len(rows)}x{points}" / "study.toml"
    study.parent.mkdir(exist_ok=True)
    with (study.parent / "shapes.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows({**row, "LA": f"../population/{row['LA']}"} for row in rows)
    stated = (folder / "population" / "study.toml").read_text(encoding="utf-8")
    stated = stated.replace('"truth/', '"../population/truth/')
    study.write_text(f"{stated}\n[template]\npoints = {points}\n", encoding="utf-8")
    return study


def run(command: str, study: Path, out: Path, workers: int) -> Cost:
    """Run a command of Ostiform, measuring its processes all together."""
    before, start = children_seconds(), time.monotonic()
    with subprocess.Popen(
        [sys.executable, "-m", "ostiform", command, str(study), "--output", str(out)]
        + ["--workers", str(workers), "--quiet", "--json"],
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        peak = 0
        while process.poll() is None:
            peak = max(peak, tree_bytes(psutil.Process(process.pid)))
            time.sleep(1.0)
        summary = json.load(process.stdout)
    wall = time.monotonic() - start
    return Cost(children_seconds() - before, wall, peak / 2**30, summary["seconds"])


def children_seconds() -> float:
    """Return the processor seconds of all children that have ended, and of theirs."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def tree_bytes(root: psutil.Process) -> int:
    """Return the proportional set size of a process and its children."""
    total = 0
    try:
        for process in (root, *root.children(recursive=True)):
            total += process.memory_full_info().pss
    except (psutil.NoSuchProcess, psutil.AccessDenied):
        pass  # ended meanwhile
    return total


def decomposed(count: int = 10_000, n_points: int = 640, rank: int = 150) -> dict[str, float]:
    """Decompose synthetic landmarks of 10,000 shapes exactly and by random projection."""
    rng = np.random.default_rng(SEED)
    weights = np.full(n_points, 1.0 / n_points)
    spreads = 4.0 * 0.95 ** np.arange(rank)
    modes = np.linalg.qr(rng.normal(size=(3 * n_points, rank)))[0].T * np.sqrt(n_points)
    aligned = (rng.normal(size=(count, rank)) * spreads) @ modes
    aligned += 0.3 * rng.normal(size=aligned.shape)
    aligned = aligned.reshape(count, n_points, 3)
    before = time.process_time()
    exact = spectrum(aligned, weights)
    between = time.process_time()
    found = streamed_spectrum(
        lambda: (aligned[first : first + 500] for first in range(0, count, 500)),
        weights,
        2.0 * 3.0 * 0.3**2 / (3 * n_points),
        np.random.default_rng(0),
    )
    after = time.process_time()
    strong = len(found.eigenvalues)
    error = np.abs(found.eigenvalues / exact.eigenvalues[:strong] - 1.0).max()
    return {
        "exact CPU s": round(between - before, 1),
        "streamed CPU s": round(after - between, 1),
        "modes": strong,
        "largest relative error": float(error),
    }


if __name__ == "__main__":
    main()
