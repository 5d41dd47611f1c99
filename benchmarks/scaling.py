"""Processor time and memory against the number of shapes: 36, 100, 300, 1,000 by default.

    python -m benchmarks.scaling FOLDER [--shapes 36 100 300 1000] [--workers 2]
    python -m benchmarks.scaling FOLDER --shapes 300 --batches 150 75

Reading and mapping a shape has nothing to do with the other shapes, so it is measured on 36
generated atria. Populations of any size are these, each warped smoothly in space (a spatial warp
of a mesh keeps its map valid), so that the correspondence and the model see N different shapes.
FOLDER keeps what was made, so that a second run goes on. Memory is the proportional set size of
all processes together, sampled once a second.
"""

import argparse
import json
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import psutil

from benchmarks.populations import EDGES_MM, family
from ostiform.correspondence import CorrespondenceSettings, correspond, sampler
from ostiform.correspondence.build import yardstick_of_template
from ostiform.correspondence.description_length import length_of_spectrum, spectrum
from ostiform.correspondence.population_template import population_template
from ostiform.correspondence.streamed_spectrum import streamed_length, streamed_spectrum
from ostiform.domain import domain_from_json
from ostiform.execution import Workers
from ostiform.model import fit_model, mesh_of_template
from ostiform.pipeline.arrays_file import read_embeddings
from ostiform.pipeline.build import Stage, build_study
from ostiform.pipeline.sampler_file import write_sampler
from ostiform.pipeline.stored_shapes import StoredShape, StoredShapes
from ostiform.study import ShapeId
from ostiform.study.demonstration import write_population

PHASES = 9
SEED = 1
BUMPS, BUMP_MM, SHIFT_MM = 8, 22.0, 1.2


def main() -> None:
    """Measure every size in a process of its own and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--shapes", type=int, nargs="+", default=[36, 100, 300, 1000])
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--points", type=int, default=2500)
    parser.add_argument("--one", type=int, help="measure this size alone, as JSON")
    parser.add_argument("--batches", type=int, nargs="+", help="compare these sizes with all")
    parser.add_argument("--large", action="store_true", help="decompose 10,000 shapes")
    chosen = parser.parse_args()
    if chosen.one is not None:
        print(json.dumps(measured(chosen.folder, chosen.one, chosen.points, chosen.workers)))
        return
    if chosen.large:
        print(json.dumps(decomposed()))
        return
    print(json.dumps({"each of 36 shapes, CPU s": base(chosen.folder)}))
    if chosen.batches:
        for count in chosen.shapes:
            for row in batched(chosen.folder, count, chosen.points, chosen.workers, chosen.batches):
                print(json.dumps(row), flush=True)
        return
    rows = []
    for count in chosen.shapes:
        options = ["--one", str(count), "--points", str(chosen.points)]
        run = subprocess.run(
            [sys.executable, "-m", "benchmarks.scaling", str(chosen.folder), *options]
            + ["--workers", str(chosen.workers)],
            capture_output=True,
            text=True,
            check=True,
        )
        rows.append(json.loads(run.stdout.splitlines()[-1]))
        print(json.dumps(rows[-1]), flush=True)
    stages = list(rows[0]["cpu_s"])
    print("| N | " + " | ".join(stages) + " | all, CPU s | wall s | peak GB |")
    print("|---" * (len(stages) + 4) + "|")
    for row in rows:
        cells = [f"{row['cpu_s'][stage]:.1f}" for stage in stages]
        total = sum(row["cpu_s"].values())
        print(
            f"| {row['shapes']} | {' | '.join(cells)} | {total:.1f} | {row['wall_s']:.0f} "
            f"| {row['peak_gb']:.2f} |"
        )
    if len(rows) > 1:
        sizes = np.log([row["shapes"] for row in rows])
        for stage in [*stages, "all"]:
            times = [
                sum(r["cpu_s"].values()) if stage == "all" else r["cpu_s"][stage] for r in rows
            ]
            slope = np.polyfit(sizes, np.log(times), 1)[0]
            print(f"exponent of {stage}: {slope:.2f}")


def base(folder: Path) -> dict[str, float]:
    """Read and map 36 atria; return the processor seconds of each."""
    study = folder / "base" / "study.toml"
    if not study.is_file():
        study = write_population(
            folder / "base", family("atria", 4, PHASES, SEED), EDGES_MM["atria"]
        )
    before = time.process_time()
    build_study(study, folder / "mapped", until=Stage.EMBED)
    return {"read and map": round((time.process_time() - before) / 36, 3)}


def measured(folder: Path, count: int, n_points: int, workers: int) -> dict[str, object]:
    """Bring so many shapes into correspondence and fit their model, measuring."""
    paths, ids, poses, domain = population(folder, count)
    settings = CorrespondenceSettings(n_points=n_points)
    memory = Memory()
    clock, wall = {}, time.monotonic()
    with Workers(workers) as pool, memory:
        shapes = StoredShapes(tuple(StoredShape(path, None) for path in paths), domain, pool)
        list(pool.each(_imported, [0.5] * workers))  # the processes start and import

        def timed(stage, work):
            before, result = tree_seconds(), work()
            clock[stage] = tree_seconds() - before
            return result

        template = timed(
            "template", lambda: population_template(shapes, domain, settings.n_points, poses)
        )
        yardstick = timed(
            "weights", lambda: yardstick_of_template(shapes, ids, domain, template, settings)
        )
        trained = timed("sweeps", lambda: correspond(shapes, ids, yardstick, settings))
        optimal = trained["optimal"].correspondence
        model = timed(
            "model",
            lambda: fit_model(optimal.aligned, optimal.weights, mesh_of_template(template)),
        )
    return {
        "shapes": count,
        "points": len(template.points),
        "cpu_s": {stage: round(seconds, 2) for stage, seconds in clock.items()},
        "wall_s": round(time.monotonic() - wall, 1),
        "peak_gb": round(memory.peak / 2**30, 3),
        "sweeps": sum(record.sweep > 0 for record in trained["optimal"].history),
        "strong_modes": len(trained["optimal"].eigenvalues),
        "modes": len(model.modes),
    }


def batched(folder, count, n_points, workers, sizes):
    """Yield how sweeps in batches end beside whole ones, and how the two decompositions agree."""
    paths, ids, poses, domain = population(folder, count)
    settings = CorrespondenceSettings(n_points=n_points)
    with Workers(workers) as pool:
        shapes = StoredShapes(tuple(StoredShape(path, None) for path in paths), domain, pool)
        template = population_template(shapes, domain, n_points, poses)
        yardstick = yardstick_of_template(shapes, ids, domain, template, settings)
        whole = None
        for size in (None, *sizes):
            before = tree_seconds()
            trained = correspond(shapes, ids, yardstick, replace(settings, batch=size))["optimal"]
            spent = tree_seconds() - before
            found = trained.correspondence
            whole = whole or found
            exact = spectrum(found.aligned, yardstick.weights)
            streamed = streamed_spectrum(
                lambda aligned=found.aligned: (
                    aligned[first : first + 50] for first in range(0, count, 50)
                ),
                yardstick.weights,
                yardstick.l_cut,
                np.random.default_rng(0),
            )
            strong = len(streamed.eigenvalues)
            gaps = np.linalg.norm(found.points - whole.points, axis=2) @ yardstick.weights
            yield {
                "shapes": count,
                "batch": size,
                "CPU s": round(spent, 1),
                "sweeps": sum(record.sweep > 0 for record in trained.history),
                "description length": length_of_spectrum(exact.eigenvalues, yardstick.l_cut),
                "streamed": streamed_length(streamed, yardstick.l_cut),
                "largest relative error of eigenvalues": float(
                    np.abs(streamed.eigenvalues / exact.eigenvalues[:strong] - 1.0).max()
                ),
                "points apart, mm": float(gaps.mean()),
            }


def _imported(seconds: float) -> None:
    """Do nothing for so long that every process gets one."""
    time.sleep(seconds)


def population(folder: Path, count: int):
    """Return files, ids and poses of so many shapes: the 36, warped; files are kept."""
    results = folder / "mapped"
    domain = domain_from_json(json.loads((results / "domain.json").read_text("utf-8")))
    poses = np.array(json.loads((results / "poses.json").read_text("utf-8")))
    embedded = sorted((results / "embeddings").glob("*.npz"))
    made = folder / "samplers"
    made.mkdir(exist_ok=True)
    paths, ids = [], []
    samplers = {}
    for index in range(count):
        own = index % len(embedded)
        path = made / f"{index:05d}.sampler"
        if not path.is_file():
            if own not in samplers:
                samplers[own] = sampler(read_embeddings(embedded[own]), domain)
            write_sampler(path, warped(samplers[own], np.random.default_rng([SEED, index])))
        paths.append(path)
        ids.append(ShapeId(f"S{index // PHASES}", f"{index % PHASES:02d}", own % PHASES / PHASES))
    return paths, ids, poses[np.arange(count) % len(poses)], domain


def warped(shape, rng):
    """Return a shape carried along by a smooth displacement of space."""
    vertices = shape.components[0].vertices
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    centers = rng.uniform(low, high, size=(BUMPS, 3))
    shifts = rng.normal(scale=SHIFT_MM, size=(BUMPS, 3))
    scale = rng.uniform(0.95, 1.05)

    def moved(points):
        squares = ((points[:, None] - centers) ** 2).sum(axis=2)
        result = scale * points + np.exp(-0.5 * squares / BUMP_MM**2) @ shifts
        result.flags.writeable = points.flags.writeable
        return result

    return replace(
        shape,
        components=tuple(
            replace(
                part,
                vertices=moved(part.vertices),
                curves={
                    name: replace(curve, points=moved(curve.points))
                    for name, curve in part.curves.items()
                },
            )
            for part in shape.components
        ),
    )


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


def tree_seconds() -> float:
    """Return the processor seconds of this process and its children so far."""
    own = psutil.Process()
    total = 0.0
    for process in (own, *own.children(recursive=True)):
        times = process.cpu_times()
        total += times.user + times.system
    return total


class Memory(threading.Thread):
    """Samples the proportional set size of this process and its children."""

    def __init__(self):
        super().__init__(daemon=True)
        self.peak = 0
        self.ended = threading.Event()

    def run(self):
        own = psutil.Process()
        while not self.ended.wait(1.0):
            total = 0
            for process in (own, *own.children(recursive=True)):
                try:
                    total += process.memory_full_info().pss
                except psutil.NoSuchProcess:
                    continue
            self.peak = max(self.peak, total)

    def __enter__(self):
        self.start()
        return self

    def __exit__(self, *_):
        self.ended.set()
        self.join()


if __name__ == "__main__":
    main()
