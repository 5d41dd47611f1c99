"""Measure trajectories and predictions on generated populations and on a real heart.

``python benchmarks/dynamics.py [--data DATA]`` prints the tables of ``docs/dynamics.md``; DATA is a
folder with ``lv-cine`` in it. Generated populations are taken in their true correspondence.
"""

import argparse
from pathlib import Path

import numpy as np

from benchmarks.populations import family
from ostiform.evaluation import prediction_errors, true_population
from ostiform.model import (
    ModelMesh,
    fit_cycle_predictor,
    fit_dynamic_model,
    fourier_design,
    phase_prediction,
    resampled_cycle,
)
from ostiform.study import ShapeId
from ostiform.surface.files import read_mesh
from ostiform.surface.operators import vertex_areas

EDGE_MM = 7.0
TRAJECTORIES = {
    "demonstration, 4 subjects x 8.5 phases, seed 2004": ("left-hearts", 4, 34, 2004),
    "the same, seed 1": ("left-hearts", 4, 34, 1),
    "the same, seed 2": ("left-hearts", 4, 34, 2),
    "the same, seed 3": ("left-hearts", 4, 34, 3),
    "one heart x 25 phases, seed 11": ("left-hearts", 1, 25, 11),
    "one heart x 25 phases, seed 12": ("left-hearts", 1, 25, 12),
    "3 hearts x 25 phases": ("left-hearts", 3, 75, 21),
    "10 hearts x 6 phases": ("left-hearts", 10, 60, 22),
    "24 hearts x 10 phases": ("left-hearts", 24, 240, 23),
    "4 atria x 9 phases": ("atria", 4, 36, 1),
    "4 ventricles x 9 phases": ("ventricle", 4, 36, 1),
}
PATTERNS = ((0.0,), (0.35,), (0.0, 0.35), (0.0, 0.35, 0.6))
UNSEEN = 16
MOST_REFITS = 40


def generated(name, subjects, shapes, seed):
    truth = family(name, subjects, shapes // subjects, seed)
    if name == "left-hearts":
        from ostiform.demo import demonstration_truth

        truth = demonstration_truth(subjects, shapes, seed)
    return true_population(truth, EDGE_MM)


def real_heart(folder):
    """Return the phases (T, P, 3), identities, weights and mesh of the heart in ``lv-cine``."""
    meshes = [read_mesh(path) for path in sorted(folder.glob("*.vtk"))]
    used = np.unique(meshes[0].faces)
    faces = np.searchsorted(used, meshes[0].faces)
    phases = np.stack([mesh.vertices for mesh in meshes])[:, used]
    areas = vertex_areas(phases.mean(axis=0), faces)
    mesh = ModelMesh(
        faces, np.zeros(len(faces), np.int64), np.zeros(len(used), np.int64), ("LV",), {}
    )
    count = len(phases)
    ids = [ShapeId("patient", f"{f:02d}", f / count) for f in range(count)]
    return phases, ids, areas / areas.sum(), mesh


def withheld(shapes, ids, weights, mesh, goals=None):
    """Return the mean errors of curves and of lines at every second phase, withheld."""
    goals = shapes if goals is None else goals
    subjects = np.array([id.subject for id in ids])
    times = np.array([id.time for id in ids])
    curves, lines = [], []
    for first in (0, 1):
        kept = np.concatenate([np.flatnonzero(subjects == s)[first::2] for s in set(subjects)])
        kept.sort()
        model = fit_dynamic_model(shapes[kept], [ids[k] for k in kept], weights, mesh)
        for index in np.setdiff1d(np.arange(len(ids)), kept):
            own = kept[subjects[kept] == subjects[index]]
            found = resampled_cycle(model, subjects[index], times[index : index + 1])[0]
            since, until = (times[index] - times[own]) % 1.0, (times[own] - times[index]) % 1.0
            before, after = own[since.argmin()], own[until.argmin()]
            share = since.min() / max(since.min() + until.min(), 1e-12)
            line = shapes[before] + share * (shapes[after] - shapes[before])
            for target, shape in ((curves, found), (lines, line)):
                target.append(np.sqrt(((shape - goals[index]) ** 2).sum(axis=1) @ weights))
    return np.mean(curves), np.mean(lines)


def refitted(shapes, ids, weights, mesh):
    """Return the mean error of curves at each phase, everything fitted again without it."""
    subjects = np.array([id.subject for id in ids])
    errors = []
    for index in np.flatnonzero([(subjects == s).sum() > 1 for s in subjects]):
        kept = np.delete(np.arange(len(ids)), index)
        model = fit_dynamic_model(shapes[kept], [ids[k] for k in kept], weights, mesh)
        time = np.array([ids[index].time])
        found = resampled_cycle(model, subjects[index], time)[0]
        errors.append(np.sqrt(((found - shapes[index]) ** 2).sum(axis=1) @ weights))
    return np.mean(errors)


def show_trajectories(name, shapes, ids, weights, mesh):
    half_curve, half_line = withheld(shapes, ids, weights, mesh)
    phases = phase_prediction(fit_dynamic_model(shapes, ids, weights, mesh))
    again = ""
    if len(ids) <= MOST_REFITS:
        curve = refitted(shapes, ids, weights, mesh)
        again = f"{curve:.3f} ({curve / phases.interpolation:.2f})"
    print(
        f"| {name} | {half_line:.3f} | {half_curve:.3f} ({half_curve / half_line:.2f}) | "
        f"{phases.interpolation:.3f} | {phases.trajectory:.3f} "
        f"({phases.trajectory / phases.interpolation:.2f}) | {again} |",
        flush=True,
    )


def jittered(folder, seeds):
    """Show the real heart's own first harmonics with noise like its frames', against the truth.

    The motion is the first four harmonics of the heart's, the noise its rest, the frames in random
    order and each with a random sign: what the curve and the line miss of the noiseless phase.
    """
    phases, ids, weights, mesh = real_heart(folder)
    design = fourier_design(np.array([id.time for id in ids]), 4)
    flat = phases.reshape(len(phases), -1)
    smooth = design @ np.linalg.lstsq(design, flat, rcond=None)[0]
    rest = (flat - smooth) * np.sqrt(len(flat) / (len(flat) - design.shape[1]))
    found = []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        noise = rng.choice([-1.0, 1.0], (len(rest), 1)) * rng.permutation(rest)
        shapes = (smooth + noise).reshape(phases.shape)
        truth = smooth.reshape(phases.shape)
        found.append(
            [
                *withheld(shapes, ids, weights, mesh),
                *withheld(shapes, ids, weights, mesh, truth),
            ]
        )
    curve, line, true_curve, true_line = np.mean(found, axis=0)
    size = np.sqrt((rest.reshape(phases.shape) ** 2).sum(axis=2) @ weights).mean()
    print(
        f"\nfour harmonics of the real heart and {size:.2f} mm of noise: every second phase "
        f"withheld, to the noisy phases line {line:.3f}, curve {curve:.3f} ({curve / line:.2f}); "
        f"to the noiseless ones line {true_line:.3f}, curve {true_curve:.3f} "
        f"({true_curve / true_line:.2f})"
    )


def show_predictions(name, subjects, phases, seed):
    total = subjects + UNSEEN
    hearts = generated(name, total, total * phases, seed)
    n = subjects * phases
    model = fit_dynamic_model(hearts.aligned[:n], hearts.ids[:n], hearts.weights, hearts.mesh)
    for pattern in PATTERNS:
        predictor = fit_cycle_predictor(model, pattern)
        found = []
        for subject in range(subjects, total):
            own = slice(subject * phases, (subject + 1) * phases)
            times = np.array([id.time for id in hearts.ids[own]])
            given = [int(np.abs((times - t + 0.5) % 1.0 - 0.5).argmin()) for t in pattern]
            found.append(prediction_errors(predictor, hearts.points[own], times.tolist(), given))
        mean = [
            np.mean(np.concatenate([getattr(item, key) for item in found]))
            for key in ("predicted", "mean_motion", "nearest_subject", "coverage")
        ]
        listed = ", ".join(f"{time:g}" for time in pattern)
        print(
            f"| {name}, seed {seed}, {subjects} x {phases} | {listed} | {mean[0]:.3f} | "
            f"{mean[1]:.3f} | {mean[2]:.3f} | {100 * mean[3]:.0f} % |",
            flush=True,
        )


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    chosen = parser.parse_args()
    for name, (kind, subjects, shapes, seed) in TRAJECTORIES.items():
        hearts = generated(kind, subjects, shapes, seed)
        show_trajectories(name, hearts.aligned, hearts.ids, hearts.weights, hearts.mesh)
    if (chosen.data / "lv-cine").is_dir():
        show_trajectories("real LV, 25 phases (lv-cine)", *real_heart(chosen.data / "lv-cine"))
        jittered(chosen.data / "lv-cine", 10)
    for kind, subjects, phases, seed in (
        ("left-hearts", 20, 10, 5),
        ("left-hearts", 24, 8, 7),
        ("left-hearts", 40, 10, 9),
        ("atria", 20, 10, 5),
    ):
        show_predictions(kind, subjects, phases, seed)


if __name__ == "__main__":
    main()
