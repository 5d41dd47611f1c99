"""How well a model is fitted to data it has never seen, against held-out truth.

``python benchmarks/fitting.py STUDY OUT [--every 4] [--image docs/images/fitting.svg]``: every
subject of a study is left out in turn (of one subject, blocks of phases): from the others' meshes
a model is built through all stages (kept in OUT, and used again where it is current), so that
neither domain nor template, warps, mean or modes have seen the left-out shapes. Every
``--every``-th of them is then fitted from

- its whole surface, and a share of it (cut by a plane of a random direction),
- 2,000 points with noise, and with outliers (uniform in a box 1.5 times as large),
- short-axis contours, evenly spaced along the first part's long axis, with or without two
  long-axis contours,
- labelled landmarks: the centres of the openings, or points of the model with 1 mm of noise.

Errors are against the whole true surface, mean of the two area-weighted mean distances, and
against the shape's own points, weighted root mean square: where `add_shapes` puts them, which maps
and warps the shape against the finished model. The floor is the best projection: these points
projected on the modes.
"""

import argparse
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pyvista

from ostiform.arrays import FloatArray, IntArray
from ostiform.errors import OstiformError
from ostiform.evaluation import cross_validation_folds, surface_distances
from ostiform.fitting import (
    CloudTarget,
    ContourTarget,
    FitPrior,
    FitSettings,
    LandmarkTarget,
    SurfaceTarget,
    Target,
    fit_prior,
    fit_shape,
)
from ostiform.model import project, read_correspondence, read_model, reconstruct
from ostiform.pipeline import Stage, build_study
from ostiform.pipeline.add import add_shapes
from ostiform.study import ShapeEntry, read_study
from ostiform.surface import face_areas, read_mesh

CLOUD = 2000


@dataclass(frozen=True)
class Truth:
    """A left-out shape: its surface by part, and where the model's points are on it."""

    label: str
    parts: dict[str, tuple[FloatArray, IntArray]]
    points: FloatArray
    transform: FloatArray

    def whole(self) -> tuple[FloatArray, IntArray]:
        vertices = [v for v, _ in self.parts.values()]
        starts = np.cumsum([0, *map(len, vertices)])
        faces = [s + f for s, (_, f) in zip(starts, self.parts.values(), strict=False)]
        return np.concatenate(vertices), np.concatenate(faces)


@dataclass(frozen=True)
class Outcome:
    surface: float
    p95: float
    point: float
    covered: float
    seconds: float
    outlier: bool


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("study", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--every", type=int, default=4)
    parser.add_argument("--only", default="", help="only conditions whose name holds this")
    parser.add_argument("--image", type=Path)
    given = parser.parse_args()
    parts = tuple(read_study(given.study).settings.parts)
    table: dict[str, list[Outcome]] = {}
    floors: list[tuple[float, float, float]] = []
    for prior, truth in left_out(given.study, given.out, given.every):
        floors.append(floor_of(prior, truth))
        for name, make, settings in conditions(parts):
            if given.only in name:
                table.setdefault(name, []).append(outcome(prior, truth, make, settings))
        print(f"{truth.label} done", flush=True)
    show(table, floors)
    if given.image is not None:
        draw(given.image, table, floors)


def left_out(path: Path, out: Path, every: int) -> Iterator[tuple[FitPrior, Truth]]:
    study = read_study(path)
    division = cross_validation_folds([entry.id for entry in study.entries])
    for number, fold in enumerate(division.folds):
        kept = tuple(study.entries[i] for i in fold.train)
        place = out / f"without-{number + 1}"
        build_study(replace(study, entries=kept), place, until=Stage.MODEL)
        prior = fit_prior(read_model(place / "model.h5"))
        for i in fold.test:
            if i % every == 0:
                entry = study.entries[i]
                try:
                    add_shapes(place, path, out / "added", [str(entry.id)])
                except OstiformError as error:
                    print(f"{entry.id} left out: {error}")
                    continue
                larger = read_correspondence(out / "added" / "correspondence.h5")
                yield (
                    prior,
                    Truth(
                        str(entry.id), true_parts(entry), larger.points[-1], larger.transforms[-1]
                    ),
                )


def true_parts(entry: ShapeEntry) -> dict[str, tuple[FloatArray, IntArray]]:
    raw = {part: read_mesh(file) for part, file in entry.files.items()}
    return {part: used_only(mesh.vertices, mesh.faces) for part, mesh in raw.items()}


def used_only(vertices: FloatArray, faces: IntArray) -> tuple[FloatArray, IntArray]:
    used, renumbered = np.unique(faces, return_inverse=True)
    return vertices[used], renumbered.reshape(-1, 3)


Make = Callable[[FitPrior, Truth, np.random.Generator], list[Target]]


def conditions(parts: tuple[str, ...]) -> Iterator[tuple[str, Make, FitSettings]]:
    near, unknown = FitSettings(), FitSettings(pose="unknown")
    yield "surface, openings unnamed", whole_surface, near
    yield "surface, turned at random", turned_surface, unknown
    for share in (0.75, 0.5, 0.25):
        yield f"surface, {share:.0%} of it", lambda p, t, r, s=share: partial(t, r, s), near
    if len(parts) > 1:
        yield f"surface, {parts[0]} only", first_part, near
    for noise in (0.5, 1.0, 2.0, 4.0):
        yield f"points, noise {noise:g} mm", lambda p, t, r, n=noise: cloud(t, r, n, 0.0), near
    for share in (0.1, 0.2, 0.3):
        yield (
            f"points, noise 1 mm, {share:.0%} outliers",
            lambda p, t, r, s=share: cloud(t, r, 1.0, s),
            near,
        )
    for count in (2, 3, 4, 6, 9, 12):
        yield f"contours, {count} short", lambda p, t, r, c=count: contours(t, c, 0), near
    for count in (3, 6):
        yield f"contours, {count} short + 2 long", lambda p, t, r, c=count: contours(t, c, 2), near
    yield "contours, 6 short, pose unknown", turned_contours, unknown
    yield "landmarks, openings' centres", opening_centres, near
    for count in (6, 12, 25, 50, 100):
        yield f"landmarks, {count}", lambda p, t, r, c=count: landmarks(t, r, c), near


def outcome(prior: FitPrior, truth: Truth, make: Make, settings: FitSettings) -> Outcome:
    rng = np.random.default_rng(sum(truth.label.encode()))
    targets = make(prior, truth, rng)
    back = np.eye(4)
    if make in (turned_surface, turned_contours):
        back = np.linalg.inv(turn_of(truth))  # type: ignore[assignment]
    start = time.process_time()
    fit = fit_shape(prior, targets, settings)
    seconds = time.process_time() - start
    points = fit.points @ back[:3, :3].T + back[:3, 3]
    spread = np.einsum("ai,pij,bj->pab", back[:3, :3], fit.point_covariance, back[:3, :3])
    deviations = np.sqrt(np.einsum("pii->pi", spread))
    inside = np.abs(points - truth.points) < 1.96 * deviations
    vertices, faces = truth.whole()
    distance = surface_distances(points[None], prior.model.mesh.faces, vertices, faces)[0]
    return Outcome(
        distance.mean,
        distance.p95,
        point_error(prior, points, truth),
        float(prior.model.weights @ inside.mean(axis=1)),
        seconds,
        fit.typicality.is_outlier,
    )


def point_error(prior: FitPrior, points: FloatArray, truth: Truth) -> float:
    return float(np.sqrt(((points - truth.points) ** 2).sum(axis=1) @ prior.model.weights))


def floor_of(prior: FitPrior, truth: Truth) -> tuple[float, float, float]:
    linear, shift = truth.transform[:3, :3], truth.transform[:3, 3]
    aligned = truth.points @ linear.T + shift
    best = reconstruct(prior.model, project(prior.model, aligned))
    points = (best - shift) @ np.linalg.inv(linear).T
    vertices, faces = truth.whole()
    distance = surface_distances(points[None], prior.model.mesh.faces, vertices, faces)[0]
    return distance.mean, distance.p95, point_error(prior, points, truth)


def whole_surface(prior: FitPrior, truth: Truth, rng: np.random.Generator) -> list[Target]:
    return [SurfaceTarget(v, f, {}, part) for part, (v, f) in truth.parts.items()]


def first_part(prior: FitPrior, truth: Truth, rng: np.random.Generator) -> list[Target]:
    return whole_surface(prior, truth, rng)[:1]


def turn_of(truth: Truth) -> FloatArray:
    """Return a random turn about the shape's middle and a shift."""
    rng = np.random.default_rng(sum(truth.label.encode()) + 1)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.linalg.det(turn)
    middle = truth.points.mean(axis=0)
    matrix = np.eye(4)
    matrix[:3, :3] = turn
    matrix[:3, 3] = middle - turn @ middle + rng.normal(scale=100.0, size=3)
    return matrix


def turned_surface(prior: FitPrior, truth: Truth, rng: np.random.Generator) -> list[Target]:
    matrix = turn_of(truth)
    return [
        SurfaceTarget(v @ matrix[:3, :3].T + matrix[:3, 3], f, {}, part)
        for part, (v, f) in truth.parts.items()
    ]


def turned_contours(prior: FitPrior, truth: Truth, rng: np.random.Generator) -> list[Target]:
    matrix = turn_of(truth)
    (target,) = contours(truth, 6, 0)
    assert isinstance(target, ContourTarget)
    moved = tuple(c @ matrix[:3, :3].T + matrix[:3, 3] for c in target.curves)
    return [ContourTarget(moved)]


def partial(truth: Truth, rng: np.random.Generator, share: float) -> list[Target]:
    """Return the share of the surface on one side of a plane of random direction."""
    direction = rng.normal(size=3)
    vertices, faces = truth.whole()
    height = vertices[faces].mean(axis=1) @ direction
    order = np.argsort(height)
    areas = face_areas(vertices, faces)[order]
    limit = height[order[np.searchsorted(np.cumsum(areas), share * areas.sum())]]
    targets: list[Target] = []
    for part, (v, f) in truth.parts.items():
        kept = f[v[f].mean(axis=1) @ direction < limit]
        if len(kept) > 20:
            targets.append(SurfaceTarget(*manifold(v, kept), {}, part))
    return targets


def manifold(vertices: FloatArray, faces: IntArray) -> tuple[FloatArray, IntArray]:
    """Return the largest connected piece, corners that hang on by one vertex taken off."""
    piece = pyvista.PolyData.from_regular_faces(vertices, faces).connectivity("largest")  # type: ignore[arg-type]
    faces = np.asarray(piece.regular_faces, dtype=np.int64)
    points = np.asarray(piece.points, dtype=np.float64)
    while True:
        edges = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2))
        _, index, count = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
        open_edges = (count[index].reshape(-1, 3) == 1).sum(axis=1)
        ends = edges[count[index] == 1]
        degree = np.bincount(ends.ravel(), minlength=len(points))
        bad = (open_edges >= 2) | (degree[faces] > 2).any(axis=1)
        if not bad.any():
            return used_only(points, faces)
        faces = faces[~bad]


def cloud(truth: Truth, rng: np.random.Generator, noise: float, outliers: float) -> list[Target]:
    vertices, faces = truth.whole()
    areas = face_areas(vertices, faces)
    chosen = rng.choice(len(faces), CLOUD, p=areas / areas.sum())
    share = rng.dirichlet([1.0, 1.0, 1.0], CLOUD)
    points = np.einsum("nk,nki->ni", share, vertices[faces[chosen]])
    points = points + rng.normal(scale=noise, size=points.shape)
    wrong = rng.permutation(CLOUD)[: round(outliers * CLOUD)]
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    middle, half = 0.5 * (low + high), 0.75 * (high - low)
    points[wrong] = rng.uniform(middle - half, middle + half, size=(len(wrong), 3))
    return [CloudTarget(points)]


def contours(truth: Truth, short: int, long: int) -> list[Target]:
    """Return short-axis rings and long-axis curves about the first part's long axis."""
    name = next(iter(truth.parts))
    vertices, faces = truth.whole()
    own = truth.parts[name][0]
    middle = own.mean(axis=0)
    axis = np.linalg.svd(own - middle, full_matrices=False)[2][0]
    whole = pyvista.PolyData.from_regular_faces(vertices, faces)  # type: ignore[arg-type]
    height = (vertices - middle) @ axis
    levels = np.linspace(height.min(), height.max(), 2 * short + 1)[1::2]
    planes = [(axis, middle + level * axis) for level in levels]
    across = np.linalg.svd(own - middle, full_matrices=False)[2][1:]
    for k in range(long):
        angle = np.pi * k / long
        planes.append((np.cos(angle) * across[0] + np.sin(angle) * across[1], middle))
    curves = []
    for normal, origin in planes:
        strips = whole.slice(normal=normal, origin=origin).strip(max_length=100_000)
        lines = np.asarray(strips.lines)
        place = 0
        while place < len(lines):
            count = int(lines[place])
            curves.append(np.asarray(strips.points)[lines[place + 1 : place + 1 + count]])
            place += count + 1
    return [ContourTarget(tuple(np.asarray(c, dtype=np.float64) for c in curves))]


def opening_centres(prior: FitPrior, truth: Truth, rng: np.random.Generator) -> list[Target]:
    loops = prior.model.mesh.loops
    centres = np.array([truth.points[rim].mean(axis=0) for rim in loops.values()])
    if len(loops) < 3:  # two centres fix no pose: four points of every rim beside them
        labels = list(loops)
        rows = [centres]
        for rim in loops.values():
            quarter = rim[:: max(len(rim) // 4, 1)][:4]
            labels += [str(k) for k in quarter]
            rows.append(truth.points[quarter])
        return [LandmarkTarget(tuple(labels), np.concatenate(rows))]
    return [LandmarkTarget(tuple(loops), centres)]


def landmarks(truth: Truth, rng: np.random.Generator, count: int) -> list[Target]:
    chosen = rng.choice(len(truth.points), count, replace=False)
    noise = rng.normal(scale=1.0, size=(count, 3))
    return [LandmarkTarget(tuple(str(k) for k in chosen), truth.points[chosen] + noise)]


def show(table: dict[str, list[Outcome]], floors: list[tuple[float, float, float]]) -> None:
    mean, p95, point = np.mean(floors, axis=0)
    print(
        f"\n{len(floors)} left-out shapes; best projection (floor): surface {mean:.2f} mm, 95 % "
        f"{p95:.2f} mm, points {point:.2f} mm\n\n"
        "| data | surface mean mm | worst shape | surface 95 % mm | points RMS mm "
        "| inside 95 % interval | called outlier | CPU s mean / max |\n"
        "|---|---|---|---|---|---|---|---|"
    )
    for name, rows in table.items():
        surface = np.array([row.surface for row in rows])
        seconds = [row.seconds for row in rows]
        print(
            f"| {name} | {surface.mean():.2f} | {surface.max():.2f} "
            f"| {np.mean([r.p95 for r in rows]):.2f} | {np.mean([r.point for r in rows]):.2f} "
            f"| {np.mean([r.covered for r in rows]):.0%} | {sum(r.outlier for r in rows)} "
            f"of {len(rows)} | {np.mean(seconds):.2f} / {max(seconds):.2f} |"
        )


def draw(
    path: Path,
    table: dict[str, list[Outcome]],
    floors: list[tuple[float, float, float]],
) -> None:
    from ostiform.report.style import COLOURS, figure, styled

    families = [
        ("contours, {} short", (2, 3, 4, 6, 9, 12), "short-axis contours"),
        ("surface, {}% of it", (25, 50, 75), "share seen (%)"),
        ("points, noise {} mm", (0.5, 1, 2, 4), "noise of points (mm)"),
        ("points, noise 1 mm, {}% outliers", (10, 20, 30), "outliers (%)"),
        ("landmarks, {}", (6, 12, 25, 50, 100), "labelled landmarks"),
    ]
    floor = float(np.mean([f[0] for f in floors]))
    with styled():
        drawing = figure(45.0 * len(families), 62.0)
        grid = drawing.subplots(1, len(families), sharey=True)
        for axes, (pattern, values, label) in zip(grid, families, strict=True):
            rows = [table.get(pattern.format(f"{value:g}"), []) for value in values]
            means = [np.mean([r.surface for r in row]) if row else np.nan for row in rows]
            worst = [max((r.surface for r in row), default=np.nan) for row in rows]
            axes.plot(values, means, "o-", color=COLOURS["optimal"], label="fit, mean")
            axes.plot(values, worst, ":", color=COLOURS["optimal"], label="fit, worst shape")
            axes.axhline(floor, color=COLOURS["truth"], lw=0.8, label="best projection")
            axes.set_xlabel(label)
        grid[0].set_ylim(bottom=0.0)
        grid[0].set_ylabel("surface error (mm)")
        grid[0].legend(fontsize=7)
        path.parent.mkdir(parents=True, exist_ok=True)
        drawing.savefig(path)


if __name__ == "__main__":
    main()
