"""How the rules on frames and mirror images do on shapes that they were not chosen on.

``python -m benchmarks.shared_frame``: of generated left hearts and implicit atria, how much worse a
shape fits as its file has it than turned freely, and which are told to be mirrored. 2 minutes.
"""

import tempfile
from pathlib import Path

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.demo.demonstration import write_demonstration
from ostiform.domain import population_poses
from ostiform.domain.surface_fit import SurfaceSample, fit_at, fitted_rotation, sampled_surface
from ostiform.study import Shape, ShapeId, read_study
from ostiform.surface import Surface, read_mesh
from tests.oracles.implicit_atria import atrium, opened_component

SPACING_MM = 4.0


def random_rotation(rng: np.random.Generator) -> FloatArray:
    turn, upper = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.sign(np.diag(upper))
    turn[:, 0] *= np.linalg.det(turn)
    return np.asarray(turn)


def turned(surface: Surface, rotation: FloatArray) -> Surface:
    center = surface.vertices.mean(axis=0)
    return Surface((surface.vertices - center) @ rotation.T + center, surface.faces, surface.loops)


def mirrored(surface: Surface) -> Surface:
    loops = {name: loop[::-1] for name, loop in surface.loops.items()}
    return Surface(surface.vertices * [-1.0, 1.0, 1.0], surface.faces[:, ::-1], loops)


def excess(moving: SurfaceSample, fixed: SurfaceSample) -> float:
    """Return the residual as the file has it over that of the best turn."""
    return fit_at(moving, fixed, np.eye(3)).residual / fitted_rotation(moving, fixed).residual


def judge_frames(name: str, pairs: list[tuple[Surface, Surface]]) -> None:
    """Print the excess of pairs (moving, fixed) as filed and turned at random."""
    rng = np.random.default_rng(0)
    rows = []
    for moving, fixed in pairs:
        there = sampled_surface(name, [fixed])
        other = turned(moving, random_rotation(rng))
        rows.append([excess(sampled_surface(name, [own]), there) for own in (moving, other)])
    five, middle, most = np.percentile(rows, [5, 50, 95], axis=0)
    print(
        f"{name}, {len(rows)} pairs: as filed {middle[0]:.2f} ({five[0]:.2f} to {most[0]:.2f}), "
        f"turned at random {middle[1]:.2f} ({five[1]:.2f} to {most[1]:.2f})",
        flush=True,
    )


def judge_mirrors(name: str, surfaces: list[Surface]) -> None:
    """Print how many of sound and of mirrored shapes are told to be mirrored."""
    wrong = [1, 4]
    chosen = [mirrored(s) if k in wrong else s for k, s in enumerate(surfaces)]
    counts = []
    for own in (surfaces, chosen):
        shapes = [Shape(ShapeId(f"s{k}", "", 0.0), {"P": s}, ()) for k, s in enumerate(own)]
        counts.append(population_poses(shapes).mirrored)
    told = counts[0].sum() + np.delete(counts[1], wrong).sum()
    print(
        f"{name}: told {counts[1][wrong].sum()} of {len(wrong)} mirrored, "
        f"{told} of {2 * len(surfaces) - len(wrong)} sound",
        flush=True,
    )


def atria(n_veins: int, seed: int, count: int) -> list[Surface]:
    """Return implicit atria; those whose veins grow into each other are left out."""
    rng = np.random.default_rng(seed)
    found: list[Surface] = []
    while len(found) < count:
        try:
            body = opened_component(atrium(12.0, n_veins, rng), SPACING_MM)
        except AssertionError:
            continue
        rims = {name.partition(".")[2]: loop for name, loop in body.rims.items()}
        found.append(Surface(body.vertices, body.faces, rims))
    return found


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        study = read_study(write_demonstration(Path(folder), 8, 16, seed=7, edge_mm=4.0))
        for part in ("LV", "LA"):
            by_subject: dict[str, list[Surface]] = {}
            for entry in study.entries:
                mesh = read_mesh(entry.files[part])
                surface = Surface(mesh.vertices, mesh.faces, {})
                by_subject.setdefault(entry.id.subject, []).append(surface)
            every = [surface for own in by_subject.values() for surface in own]
            judge_frames(f"generated {part}, shapes", [(s, every[0]) for s in every[1:]])
            phases = [(s, own[0]) for own in by_subject.values() for s in own[1:]]
            judge_frames(f"generated {part}, phases", phases)
    for n_veins in (4, 2):
        surfaces = atria(n_veins, 5, 12)
        name = f"implicit atria of {n_veins} veins"
        judge_frames(name, [(s, surfaces[0]) for s in surfaces[1:]])
        for seed in (0, 100, 200):
            judge_mirrors(name, atria(n_veins, seed, 8))


if __name__ == "__main__":
    main()
