"""Measure trajectories and predictions on generated populations and on a real heart.

``python benchmarks/dynamics.py [--data DATA]`` prints the tables of ``docs/dynamics.md``; DATA is a
folder with ``lv-cine`` in it. Generated populations are taken in their true correspondence.
"""

import argparse
from pathlib import Path

import numpy as np
from populations import family

from ostiform.evaluation import prediction_errors, true_population
from ostiform.model import (
    ModelMesh,
    fit_cycle_predictor,
    fit_dynamic_model,
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


def generated(name, subjects, shapes, seed):
    truth = family(name, subjects, shapes // subjects, seed)
    if name == "left-hearts":
        from ostiform.study import demonstration_truth

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


def withheld(shapes, ids, weights, mesh):
    """Return the mean errors of curves and of lines at every second phase, withheld."""
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
                target.append(np.sqrt(((shape - shapes[index]) ** 2).sum(axis=1) @ weights))
    return np.mean(curves), np.mean(lines)


def show_trajectories(name, shapes, ids, weights, mesh):
    half_curve, half_line = withheld(shapes, ids, weights, mesh)
    phases = phase_prediction(fit_dynamic_model(shapes, ids, weights, mesh))
    print(
        f"| {name} | {half_line:.3f} | {half_curve:.3f} ({half_curve / half_line:.2f}) | "
        f"{phases.interpolation:.3f} | {phases.trajectory:.3f} "
        f"({phases.trajectory / phases.interpolation:.2f}) |",
        flush=True,
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
            found.append(prediction_errors(predictor, hearts.points[own], times, given))
        mean = [
            np.mean(np.concatenate([getattr(item, key) for item in found]))
            for key in ("predicted", "mean_motion", "nearest_subject", "coverage")
        ]
        given = ", ".join(f"{time:g}" for time in pattern)
        print(
            f"| {name}, seed {seed}, {subjects} x {phases} | {given} | {mean[0]:.3f} | "
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
    for kind, subjects, phases, seed in (
        ("left-hearts", 20, 10, 5),
        ("left-hearts", 24, 8, 7),
        ("left-hearts", 40, 10, 9),
        ("atria", 20, 10, 5),
    ):
        show_predictions(kind, subjects, phases, seed)


if __name__ == "__main__":
    main()
