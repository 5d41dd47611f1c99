"""Write a population with exactly known correspondence, other than the demonstration's.

Run from the repository root:
``python benchmarks/populations.py atria /tmp/atria --subjects 4 --phases 9 --seed 1``.

Families: ``atria`` (an LA alone, five openings, 2.4 mm mean edge), ``ventricle`` (two openings,
strongly asymmetric), ``one-mode`` (atria that differ by one displacement field times a number:
exactly one true mode), ``left-hearts`` (two parts, coarser than the demonstration's). Every
parameter is in the folder's ``truth/truth.json``.
"""

import argparse
from pathlib import Path

import numpy as np

from ostiform.demo.deformation import Deformation
from ostiform.demo.demonstration import demonstration_truth, write_population
from ostiform.demo.implicit import Anatomy, Cut, Ellipsoid, Tube
from ostiform.demo.spacemaps import Affine, Axial, Bumps, TubeWarp
from ostiform.demo.truth import Truth
from ostiform.study.shape import ShapeId

EDGES_MM = {"atria": 2.4, "ventricle": 2.2, "one-mode": 2.4, "left-hearts": 2.6}


def unit(vector):
    return np.asarray(vector, dtype=np.float64) / np.linalg.norm(vector)


def opened_body(part, bodies, vessels, seed, blend=2.2):
    """Return an anatomy of one part: ellipsoids (centre, semi-axes) and vessels that open it.

    A vessel is (base at the wall, direction, radius, length from there to its cut), mm.
    """
    primitives: list[Ellipsoid | Tube] = [
        Ellipsoid(np.array(c), np.array(a), np.eye(3)) for c, a in bodies
    ]
    cuts = []
    for name, (base, direction, radius, length) in vessels.items():
        base, direction = np.array(base), unit(direction)
        end = base + length * direction
        primitives.append(
            Tube(base - 1.5 * radius * direction, end + 0.8 * radius * direction, radius, radius)
        )
        across = np.eye(3)[np.abs(direction).argmin()]
        cuts.append(Cut(f"{part}.{name}", None, end, direction, 1.9 * radius, across))
    return Anatomy(tuple(primitives), blend, tuple(cuts), {part: np.array(seed)})


ATRIUM_VESSELS = {
    "mitral": ((2.0, -4.0, -17.0), (0.1, -0.35, -0.93), 14.0, 6.0),
    "RSPV": ((-21.0, -1.0, 10.0), (-0.9, -0.15, 0.4), 6.5, 10.0),
    "RIPV": ((-20.0, 9.0, -3.0), (-0.85, 0.45, -0.25), 5.5, 12.0),
    "LSPV": ((18.0, 6.0, 14.0), (0.6, 0.3, 0.75), 6.0, 13.0),
    "LIPV": ((21.0, 12.0, -2.0), (0.75, 0.6, -0.25), 5.0, 9.0),
}
VENTRICLE_VESSELS = {
    "mitral": ((3.0, 9.0, -4.0), (0.05, 0.45, 0.89), 14.5, 6.0),
    "aortic": ((-6.0, -16.0, -6.0), (-0.35, -0.45, 0.82), 11.0, 18.0),
}


def atrium():
    bodies = [
        ((-7.0, 0.0, 2.0), (18.0, 17.0, 18.0)),
        ((8.0, 4.0, 1.0), (17.0, 15.0, 16.0)),
        ((20.0, -14.0, 4.0), (8.0, 8.0, 6.0)),
    ]
    return opened_body("LA", bodies, ATRIUM_VESSELS, (-7.0, 0.0, 20.0))


def ventricle():
    bodies = [
        ((0.0, -2.0, -36.0), (23.0, 20.0, 40.0)),
        ((-14.0, 4.0, -24.0), (15.0, 12.0, 18.0)),
        ((9.0, -8.0, -58.0), (14.0, 10.0, 22.0)),
    ]
    return opened_body("LV", bodies, VENTRICLE_VESSELS, (9.0, -8.0, -80.0))


def vessel_maps(vessels, rng):
    maps = []
    for base, direction, radius, length in vessels.values():
        direction = unit(direction)
        bend = rng.uniform(-2.5, 2.5, size=3)
        bend -= (bend @ direction) * direction
        reach = rng.uniform(-0.3, 0.8) * length * direction + bend
        widening = rng.uniform(-0.1, 0.1)
        inner = 1.3 * radius
        maps.append(
            TubeWarp(np.array(base), direction, length, inner, inner + 17.0, reach, widening)
        )
    return maps


def walls(anatomy, rng, count, radius_mm, size_mm):
    """Return regional displacements about centres spread over the bodies."""
    bodies = [p for p in anatomy.primitives if isinstance(p, Ellipsoid)]
    centers = []
    for index in range(count):
        body = bodies[index % len(bodies)]
        centers.append(body.center + body.semi_axes * unit(rng.normal(size=3)))
    shifts = rng.uniform(-size_mm, size_mm, size=(count, 3))
    return Bumps(np.array(centers), np.full(count, radius_mm), shifts)


def beat(anatomy, squeeze, twist, shift_mm):
    """Return a contraction about the z axis, strongest in the middle, with torsion."""
    low, high = anatomy.bounds()
    knots = np.linspace(low[2], high[2], 7)
    profile = np.array([0.2, 0.7, 1.0, 1.0, 0.8, 0.5, 0.2])
    lift = np.zeros((7, 3))
    lift[:, 2] = shift_mm * np.linspace(1.0, 0.0, 7) ** 2
    scale = -squeeze * np.column_stack([profile, 0.8 * profile])
    return Axial(np.zeros(2), knots, lift, scale, twist * np.linspace(1.0, -0.4, 7))


def beating(anatomy, vessels, subjects, phases, seed):
    deformations = {}
    for index, child in enumerate(np.random.SeedSequence(seed).spawn(subjects)):
        rng = np.random.default_rng(child)
        turn = Axial(
            np.zeros(2), np.array([-1.0, 1.0]), np.zeros((2, 3)), np.zeros((2, 2)),
            np.full(2, rng.uniform(-0.1, 0.1)),
        )  # fmt: skip
        fixed = [*vessel_maps(vessels, rng), walls(anatomy, rng, 8, 24.0, 2.4), turn]
        pose = Affine(rng.uniform(0.92, 1.08) * np.eye(3), rng.uniform(-5.0, 5.0, size=3))
        squeeze, twist, lift = rng.uniform([0.12, 0.05, 3.0], [0.22, 0.15, 6.0])
        for phase in range(phases):
            time = phase / phases
            amount = 0.5 - 0.5 * np.cos(2.0 * np.pi * time)
            late = 0.5 - 0.5 * np.cos(2.0 * np.pi * (time - 0.05))
            motion = beat(anatomy, squeeze * amount, twist * late, lift * amount)
            shape_id = ShapeId(f"S{index + 1}", f"{phase:02d}", time)
            deformations[shape_id] = Deformation((*fixed, motion, pose))
    return Truth(seed, anatomy, deformations)


def one_mode(subjects, seed):
    """Return atria x + b_i d(x), one displacement field d and one number per subject."""
    rng = np.random.default_rng(seed)
    anatomy = atrium()
    field = walls(anatomy, rng, 10, 26.0, 2.6)
    amounts = np.linspace(-1.0, 1.0, subjects)
    deformations = {
        ShapeId(f"S{index + 1}", "00", 0.0): Deformation(
            (Bumps(field.centers, field.radii, amount * field.displacements),)
        )
        for index, amount in enumerate(amounts)
    }
    return Truth(seed, anatomy, deformations)


def family(name, subjects, phases, seed):
    """Return the truth of a family."""
    if name == "atria":
        return beating(atrium(), ATRIUM_VESSELS, subjects, phases, seed)
    if name == "ventricle":
        return beating(ventricle(), VENTRICLE_VESSELS, subjects, phases, seed)
    if name == "one-mode":
        return one_mode(subjects * phases, seed)
    return demonstration_truth(subjects, subjects * phases, seed)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("family", choices=list(EDGES_MM))
    parser.add_argument("folder", type=Path)
    parser.add_argument("--subjects", type=int, default=4)
    parser.add_argument("--phases", type=int, default=9)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--edge", type=float, help="mean edge, mm")
    chosen = parser.parse_args()
    truth = family(chosen.family, chosen.subjects, chosen.phases, chosen.seed)
    print(write_population(chosen.folder, truth, chosen.edge or EDGES_MM[chosen.family]))


if __name__ == "__main__":
    main()
