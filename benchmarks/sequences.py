"""How well whole cycles of hearts never seen are fitted from what a scanner gives.

``python benchmarks/sequences.py OUT [--docs docs/fitting.md]``: a model of 800 points is built
through all stages from the meshes of 24 generated left hearts in 6 phases (kept in OUT). Other
hearts of the same generator are then cut into ten short-axis slices 8 mm apart and two long-axis
slices, fixed in space over all phases; the curves get 0.7 mm of noise (independent points 2 mm
apart) and every slice one shift in its plane of 2 mm standard deviation along each axis. Label maps
of the same stacks have pixels of 1.4 mm. Errors are against the true meshes, mean of the two
area-weighted mean distances, in the true frame; a shift that all slices share is one of the heart,
and is taken off before shifts are compared.
"""

import argparse
import sys
import time as clock
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyvista
from matplotlib.path import Path as MarkedPath

from benchmarks.populations import family
from ostiform.demo.contouring import canonical_points, extract
from ostiform.demo.demonstration import write_population
from ostiform.evaluation import enclosed_volumes, part_volumes, surface_distances
from ostiform.fitting import (
    ContourTarget,
    PhaseTarget,
    SequenceSettings,
    SliceContours,
    fit_sequence,
    fit_shape,
    sequence_prior,
)
from ostiform.fitting.label_contours import label_outlines
from ostiform.model import read_model
from ostiform.pipeline import Stage, build_study
from ostiform.study import read_study
from ostiform.surface import boundary_loops, distances_to_surface

TRAINING, TRAINING_PHASES, SEED = 24, 6, 31
EDGE_MM, POINTS = 3.2, 800
SHORT_AXIS, SPACING_MM = 10, 8.0
NOISE_MM, SHIFT_MM, STEP_MM = 0.7, 2.0, 2.0
PIXEL_MM, PIXELS = 1.4, 140
MARK = "<!-- sequences -->"


@dataclass(frozen=True)
class Heart:
    """An unseen heart: meshes by phase and part, planes, and the slices' shifts."""

    times: np.ndarray
    parts: list
    planes: dict
    shifts: dict
    rng: np.random.Generator


def trained(out):
    """Return the model of the training hearts, built where it is not current."""
    folder = out / "hearts"
    if not (folder / "study.toml").is_file():
        truth = family("left-hearts", TRAINING, TRAINING_PHASES, SEED)
        path = write_population(folder, truth, EDGE_MM)
        with path.open("a", encoding="utf-8") as stream:
            stream.write(f"\n[template]\npoints = {POINTS}\n")
    build_study(read_study(folder / "study.toml"), folder / "model", until=Stage.MODEL, workers=1)
    return read_model(folder / "model" / "model.h5")


def unseen(count, phases):
    """Yield hearts that the model was not built of."""
    truth = family("left-hearts", TRAINING + count, phases, SEED)
    canonical = canonical_points(truth.anatomy, EDGE_MM)
    for index in range(TRAINING, TRAINING + count):
        rng = np.random.default_rng([SEED, index])
        name = f"S{index + 1}"
        shapes = {id: d for id, d in truth.deformations.items() if id.subject == name}
        parts = [
            {
                part: (surface.vertices, surface.faces)
                for part, surface in extract(truth.anatomy, d, EDGE_MM, rng, canonical).items()
            }
            for d in shapes.values()
        ]
        planes = imaging_planes(parts[0])
        shifts = {
            view: rng.normal(scale=SHIFT_MM, size=2) @ in_plane(normal)
            for view, (normal, _) in planes.items()
        }
        times = np.array([id.time for id in shapes])
        yield Heart(times, parts, planes, shifts, rng)


def imaging_planes(parts):
    """Return normal and a point of every slice: a stack from the apex up, two along the axis."""
    ventricle, _ = parts["LV"]
    middle = ventricle.mean(axis=0)
    axis = np.linalg.svd(ventricle - middle, full_matrices=False)[2][0]
    atrium, _ = parts["LA"]
    axis *= np.sign((atrium.mean(axis=0) - middle) @ axis)
    apex = float(((ventricle - middle) @ axis).min())
    planes = {
        f"sax{k:02d}": (axis, middle + (apex + 0.5 * SPACING_MM + k * SPACING_MM) * axis)
        for k in range(SHORT_AXIS)
    }
    across = in_plane(axis)
    planes["lax0"], planes["lax1"] = (across[0], middle), (across[1], middle)
    return planes


def in_plane(normal):
    first = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(normal, first)])


def cut(surface, normal, origin):
    """Return the curves along which a plane cuts a surface."""
    mesh = pyvista.PolyData.from_regular_faces(*surface)
    strips = mesh.slice(normal=normal, origin=origin).strip(max_length=100_000)
    lines, place, curves = np.asarray(strips.lines), 0, []
    while place < len(lines):
        count = int(lines[place])
        curves.append(np.asarray(strips.points, float)[lines[place + 1 : place + 1 + count]])
        place += count + 1
    return curves


def contoured(heart, views=None):
    """Return the phases of a heart as contours with noise and shifts."""
    phases = []
    for number, (time, parts) in enumerate(zip(heart.times, heart.parts, strict=True)):
        items = []
        for view, (normal, origin) in heart.planes.items():
            if views is not None and view not in views:
                continue
            axes = in_plane(normal)
            for part, surface in parts.items():
                curves = [
                    noisy(curve, heart.rng) @ np.eye(3) + heart.shifts[view]
                    for curve in cut(surface, normal, origin)
                ]
                curves = [flat(curve, axes, normal, origin) for curve in curves if len(curve) > 2]
                if curves:
                    items.append(SliceContours(view, tuple(curves), part))
        phases.append(PhaseTarget(float(time), tuple(items), f"{number:02d}"))
    return phases


def noisy(curve, rng):
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])
    wanted = np.linspace(0.0, length[-1], max(int(length[-1] / STEP_MM), 2))
    points = np.stack([np.interp(wanted, length, curve[:, d]) for d in range(3)], axis=1)
    return points + rng.normal(scale=NOISE_MM, size=points.shape)


def flat(curve, axes, normal, origin):
    """Return a curve put back into its plane: noise is in plane."""
    return curve - np.outer((curve - origin) @ normal, normal)


def whole(parts):
    vertices = [v for v, _ in parts.values()]
    starts = np.cumsum([0, *map(len, vertices)])
    faces = [s + f for s, (_, f) in zip(starts, parts.values(), strict=False)]
    return np.concatenate(vertices), np.concatenate(faces)


def surface_error(points, mesh, parts):
    """Return mean distances: of everything, and of the ventricle."""
    found = [surface_distances(points[None], mesh.faces, *whole(parts))[0].mean]
    faces = mesh.faces[mesh.face_part == mesh.parts.index("LV")]
    used, own = np.unique(faces, return_inverse=True)
    found.append(surface_distances(points[None, used], own.reshape(-1, 3), *parts["LV"])[0].mean)
    return found


def ejection(volumes):
    return 100.0 * (1.0 - volumes.min() / volumes.max())


def true_volumes(heart):
    return np.array(
        [
            enclosed_volumes(v[None], f, boundary_loops(f))[0]
            for v, f in (parts["LV"] for parts in heart.parts)
        ]
    )


def judged(prior, heart, fit):
    """Return errors of a fit to a heart."""
    mesh = prior.space.model.mesh
    errors = np.array(
        [surface_error(p, mesh, parts) for p, parts in zip(fit.points, heart.parts, strict=True)]
    )
    inside = [
        float((distances_to_surface(p, *whole(parts)) <= 1.96 * sd) @ prior.space.model.weights)
        for p, sd, parts in zip(fit.points, fit.normal_sd, heart.parts, strict=True)
    ]
    volumes = part_volumes(fit.points, mesh)["LV"]
    shift_error = np.nan
    if fit.shifts:
        shift_error = relative_shift_error(heart, fit)
    return {
        "surface": errors[:, 0].mean(),
        "ventricle": errors[:, 1].mean(),
        "inside": np.mean(inside),
        "ejection": abs(ejection(volumes) - ejection(true_volumes(heart))),
        "shift": shift_error,
    }


def relative_shift_error(heart, fit):
    """Return the RMS error of a shift along an axis, a common shift of all slices taken off."""
    rows, rest = [], []
    for found in fit.shifts:
        axes = in_plane(heart.planes[found.slice][0])
        rows.append(axes)
        rest.append(axes @ (found.shift - heart.shifts[found.slice]))
    axes, left = np.concatenate(rows), np.concatenate(rest)
    common = np.linalg.lstsq(axes, left, rcond=None)[0]
    return float(np.sqrt(((left - axes @ common) ** 2).mean()))


def by_phase(prior, phases):
    """Return the shapes of fits phase by phase, without shifts."""
    shapes = []
    for phase in phases:
        targets = [ContourTarget(item.curves, item.part) for item in phase.targets]
        shapes.append(fit_shape(prior.space, targets).points)
    return np.stack(shapes)


def labelled(heart):
    """Return the phases of a heart as the outlines of label maps of its slices, shifted."""
    phases = []
    for number, (time, parts) in enumerate(zip(heart.times, heart.parts, strict=True)):
        items = []
        for view, (normal, origin) in heart.planes.items():
            for part, surface in parts.items():
                mask, affine = label_of(surface, normal, origin)
                affine[:3, 3] += heart.shifts[view]
                items += label_outlines(mask, affine, view, part)
        phases.append(PhaseTarget(float(time), tuple(items), f"{number:02d}"))
    return phases


def label_of(surface, normal, origin):
    """Return the pixels of a slice inside a surface whose openings are closed, and their affine."""
    axes = in_plane(normal)
    corner = origin - 0.5 * PIXELS * PIXEL_MM * axes.sum(axis=0)
    vertices, faces = surface
    fans, centres = [faces], []
    for k, loop in enumerate(boundary_loops(faces)):
        centres.append(vertices[loop].mean(axis=0))
        after = np.roll(loop, -1)
        fans.append(np.stack([after, loop, np.full(len(loop), len(vertices) + k)], axis=1))
    closed = np.concatenate([vertices, *(centre[None] for centre in centres)])
    mask = np.zeros((PIXELS, PIXELS), dtype=bool)
    grid = np.stack(np.meshgrid(*[np.arange(PIXELS)] * 2, indexing="ij"), axis=-1).reshape(-1, 2)
    for curve in cut((closed, np.concatenate(fans)), normal, origin):
        pixels = (curve - corner) @ axes.T / PIXEL_MM
        mask ^= MarkedPath(pixels).contains_points(grid).reshape(mask.shape)
    affine = np.eye(4)
    affine[:3, 0], affine[:3, 1] = PIXEL_MM * axes[0], PIXEL_MM * axes[1]
    affine[:3, 2], affine[:3, 3] = SPACING_MM * normal, corner
    return mask[:, :, None], affine


def rows(prior, hearts):
    """Yield the name of a way to fit and its errors, means over hearts."""
    mesh = prior.space.model.mesh
    found: dict[str, list[dict[str, float]]] = {}
    for heart in hearts:
        phases = contoured(heart)
        ways = (
            ("contours, shifts solved for", phases, SHIFT_MM),
            ("contours, without shifts", phases, 0.0),
            ("label maps, shifts solved for", labelled(heart), SHIFT_MM),
        )
        for name, given, sd in ways:
            start = clock.process_time()
            fit = fit_sequence(prior, given, SequenceSettings(shift_sd_mm=sd))
            errors = judged(prior, heart, fit)
            found.setdefault(name, []).append({**errors, "seconds": clock.process_time() - start})
        plain = by_phase(prior, phases)
        apart = [surface_error(p, mesh, q) for p, q in zip(plain, heart.parts, strict=True)]
        volumes = part_volumes(plain, mesh)["LV"]
        found.setdefault("contours, phase by phase", []).append(
            {
                "surface": float(np.mean(apart, axis=0)[0]),
                "ventricle": float(np.mean(apart, axis=0)[1]),
                "ejection": abs(ejection(volumes) - ejection(true_volumes(heart))),
            }
        )
        print({k: v[-1] for k, v in found.items()}, file=sys.stderr, flush=True)
    for name, errors in found.items():
        yield name, {key: float(np.mean([e[key] for e in errors])) for key in errors[0]}


def table(prior, hearts, phases):
    lines = [
        f"{len(hearts)} unseen hearts in {phases} phases, prior of {prior.subjects} subjects:",
        "",
        "| data | whole surface mm | ventricle mm | ejection fraction points | shifts mm "
        "| inside 95 % interval | CPU s |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, e in rows(prior, hearts):
        shift = f"{e['shift']:.2f}" if np.isfinite(e.get("shift", np.nan)) else ""
        inside = f"{e['inside']:.0%}" if "inside" in e else ""
        seconds = f"{e['seconds']:.1f}" if "seconds" in e else ""
        lines.append(
            f"| {name} | {e['surface']:.2f} | {e['ventricle']:.2f} | {e['ejection']:.1f} "
            f"| {shift} | {inside} | {seconds} |"
        )
    return "\n".join(lines)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--hearts", type=int, default=4)
    parser.add_argument("--phases", type=int, default=8)
    parser.add_argument("--docs", type=Path, help="page whose place for the table is filled")
    chosen = parser.parse_args()
    prior = sequence_prior(trained(chosen.out))
    text = table(prior, list(unseen(chosen.hearts, chosen.phases)), chosen.phases)
    print(text)
    if chosen.docs is not None:
        before, _, rest = chosen.docs.read_text("utf-8").partition(MARK)
        after = rest.partition(MARK)[2] if MARK in rest else rest
        chosen.docs.write_text(f"{before}{MARK}\n\n{text}\n\n{MARK}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()
