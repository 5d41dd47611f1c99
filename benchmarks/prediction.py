"""Predict unseen beating hearts through the whole chain, from meshes to a predicted cycle.

``python benchmarks/prediction.py OUT``: for each generated population the meshes of all hearts are
written, a model is built of the first 24 through all stages (kept in OUT, and used again where it
is current), and the others' cycles are predicted from meshes, parts of meshes or contours of one
or two of their phases. Errors are against the true meshes of the other phases: mean of the two
area-weighted mean distances between the surfaces, and the volume of the first part. *Mean motion*
and *nearest subject* are the baselines of `baseline_cycles`, added to the same fitted phases.
"""

import argparse
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from benchmarks.fitting import Truth, contours, partial, true_parts
from benchmarks.populations import family
from ostiform.demo.demonstration import write_population
from ostiform.evaluation import (
    baseline_cycles,
    enclosed_volumes,
    part_volumes,
    surface_distances,
)
from ostiform.fitting import SurfaceTarget, fit_prior, fit_shape
from ostiform.model import (
    dynamic_model_of,
    fit_cycle_predictor,
    pose_to_mean_cycle,
    predict_cycle,
    read_model,
)
from ostiform.pipeline import Stage, build_study
from ostiform.pipeline.prediction import phase_of_fit
from ostiform.study import read_study
from ostiform.surface import boundary_loops, distances_to_surface

TRAINING, UNSEEN, PHASES = 24, 8, 6
EDGE_MM, POINTS = 3.2, 800
POPULATIONS = {"left-hearts": 31, "ventricle": 32}
SYSTOLE = 1.0 / 3.0
GIVEN = {
    "meshes at 0": ("meshes", (0.0,)),
    "meshes at 1/3": ("meshes", (SYSTOLE,)),
    "meshes at 0 and 1/3": ("meshes", (0.0, SYSTOLE)),
    "half of the surface at 0": ("half", (0.0,)),
    "half of the surface at 0 and 1/3": ("half", (0.0, SYSTOLE)),
    "six short-axis contours at 0": ("contours", (0.0,)),
    "six short-axis contours at 0 and 1/3": ("contours", (0.0, SYSTOLE)),
}
RULES = ("predicted", "mean motion", "nearest subject")


@dataclass
class Found:
    surface: list = field(default_factory=lambda: [[], [], []])
    volume: list = field(default_factory=lambda: [[], [], []])
    fitted: list = field(default_factory=list)
    inside: list = field(default_factory=list)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--workers", type=int, default=1)
    chosen = parser.parse_args()
    print(
        "| population | given | fit of the given | predicted | mean motion | nearest subject "
        "| volume: predicted | mean motion | nearest subject | inside the 95 % interval |\n"
        "|---|---|---|---|---|---|---|---|---|---|"
    )
    for name, seed in POPULATIONS.items():
        show(name, *built(name, seed, chosen.out / name, chosen.workers))


def built(name, seed, folder, workers):
    """Return the study of all hearts and the model of the first of them."""
    if not (folder / "study.toml").is_file():
        truth = family(name, TRAINING + UNSEEN, PHASES, seed)
        path = write_population(folder, truth, EDGE_MM)
        with path.open("a", encoding="utf-8") as stream:
            stream.write(f"\n[template]\npoints = {POINTS}\n")
    study = read_study(folder / "study.toml")
    train = tuple(e for e in study.entries if int(e.id.subject[1:]) <= TRAINING)
    build_study(replace(study, entries=train), folder / "model", until=Stage.MODEL, workers=workers)
    return study, read_model(folder / "model" / "model.h5")


def show(name, study, stored):
    prior = fit_prior(stored)
    dynamic = dynamic_model_of(stored)
    hearts = {}
    for entry in study.entries:
        if int(entry.id.subject[1:]) > TRAINING:
            hearts.setdefault(entry.id.subject, []).append(entry)
    for label, (kind, times) in GIVEN.items():
        predictor = fit_cycle_predictor(dynamic, times)
        found = Found()
        for entries in hearts.values():
            add_heart(found, prior, predictor, entries, kind, times)
        rows = [*map(np.mean, found.surface), *map(np.mean, found.volume)]
        millimetres = " | ".join(f"{value:.2f}" for value in rows[:3])
        millilitres = " | ".join(f"{value:.1f} ml" for value in rows[3:])
        print(
            f"| {name} | {label} | {np.mean(found.fitted):.2f} | {millimetres} | {millilitres} "
            f"| {np.mean(found.inside):.0%} |",
            flush=True,
        )


def add_heart(found, prior, predictor, entries, kind, times):
    phases = np.array([entry.id.time for entry in entries])
    chosen = [int(np.abs((phases - t + 0.5) % 1.0 - 0.5).argmin()) for t in times]
    truths = [Truth(str(e.id), true_parts(e), np.zeros((0, 3)), np.eye(4)) for e in entries]
    fits = [fit_shape(prior, targets(truths[index], kind)) for index in chosen]
    given = [phase_of_fit(prior, f, phases[i]) for f, i in zip(fits, chosen, strict=True)]
    other = np.setdiff1d(np.arange(len(phases)), chosen)
    predicted = predict_cycle(predictor, given, phases[other])
    seen = np.stack([phase.points for phase in given])
    pose = pose_to_mean_cycle(predictor.model, seen, phases[chosen])
    linear, shift = pose[:3, :3], pose[:3, 3]
    rules = baseline_cycles(predictor.model, seen @ linear.T + shift, phases[chosen], phases[other])
    back = [(shapes - shift) @ linear for shapes in rules]
    mesh = prior.model.mesh
    for fit, index in zip(fits, chosen, strict=True):
        vertices, faces = truths[index].whole()
        measured = surface_distances(fit.points[None], mesh.faces, vertices, faces)
        found.fitted.append(measured[0].mean)
    for row, shapes in enumerate((predicted.shapes, *back)):
        volumes = part_volumes(shapes, mesh)[mesh.parts[0]]
        for shape, volume, index in zip(shapes, volumes, other, strict=True):
            vertices, faces = truths[index].whole()
            measured = surface_distances(shape[None], mesh.faces, vertices, faces)
            found.surface[row].append(measured[0].mean)
            found.volume[row].append(1e-3 * abs(volume - true_volume(truths[index])))
    found.inside.append(covered(prior, predicted, truths, other))


def targets(truth, kind):
    if kind == "contours":
        return contours(truth, 6, 0)
    if kind == "half":
        return partial(truth, np.random.default_rng(sum(truth.label.encode())), 0.5)
    return [SurfaceTarget(v, f, {}, part) for part, (v, f) in truth.parts.items()]


def true_volume(truth):
    vertices, faces = next(iter(truth.parts.values()))
    return float(enclosed_volumes(vertices[None], faces, boundary_loops(faces))[0])


def covered(prior, predicted, truths, other):
    """Return the share of the predicted surfaces that has the true one within 1.96 sd."""
    shares = []
    for shape, sd, index in zip(predicted.shapes, predicted.deviations, other, strict=True):
        vertices, faces = truths[index].whole()
        apart = distances_to_surface(shape, vertices, faces)
        shares.append((apart <= 1.96 * sd) @ prior.model.weights)
    return np.mean(shares)


if __name__ == "__main__":
    main()
