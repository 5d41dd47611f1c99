"""Write a population with exactly known correspondence, other than the demonstration's.

Run from the repository root:
``python benchmarks/populations.py atria /tmp/atria --subjects 4 --phases 9 --seed 1``.

Families: ``atria`` (an LA alone, five openings, 2.4 mm mean edge), ``ventricle`` (two openings,
strongly asymmetric), ``one-mode`` (atria that differ by one displacement field times a number:
exactly one true mode), ``left-hearts`` (two parts, coarser than the demonstration's). Further ones
do not move as smoothly as the objective's prior expects: ``free-vessels`` (veins that slide over
their atrium, each by itself and in its own time), ``growth`` (a few places grow, the rest does
not), ``torsion`` (a ventricle with three pouches, which show how it turns), ``articulated`` (two
bodies that bend and turn against each other at a joint), ``rough`` (subjects that differ in many
small places). No constant was chosen on the last two. ``--noise`` adds noise to the vertices and
``--cuts`` cuts the vessels shorter, each at random. Every parameter is in the folder's
``truth/truth.json``.
"""

import argparse
from pathlib import Path

import numpy as np

from benchmarks.spoiling import spoiled
from ostiform.demo.deformation import Deformation
from ostiform.demo.demonstration import demonstration_truth, write_population
from ostiform.demo.implicit import Anatomy, Cut, Ellipsoid, Tube
from ostiform.demo.spacemaps import Affine, Axial, Bumps, TubeWarp
from ostiform.demo.truth import Truth
from ostiform.study.shape import ShapeId

EDGES_MM = {
    "atria": 2.4,
    "ventricle": 2.2,
    "one-mode": 2.4,
    "left-hearts": 2.6,
    "free-vessels": 2.4,
    "growth": 2.4,
    "torsion": 2.4,
    "articulated": 2.4,
    "rough": 2.4,
}
HELD_OUT = ("articulated", "rough")
"""Families that no constant of the correspondence was chosen on: they are run last."""


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


SMALL_MM = 11.0
"""Radius of the regions that move by themselves in families without a smooth prior."""

POUCHES = (
    ((22.0, 4.0, -40.0), (7.0, 8.0, 9.0)),
    ((-18.0, 14.0, -52.0), (8.0, 7.0, 8.0)),
    ((-8.0, -20.0, -30.0), (7.0, 7.0, 9.0)),
)
JOINTED_VESSELS = {
    "inlet": ((-2.0, 0.0, 26.0), (-0.2, 0.1, 0.97), 9.0, 8.0),
    "outlet": ((3.0, 2.0, -64.0), (0.3, 0.2, -0.93), 7.0, 10.0),
    "side": ((17.0, 4.0, 8.0), (0.9, 0.2, 0.3), 6.0, 9.0),
}


def pouched_ventricle():
    plain = ventricle()
    pouches = tuple(Ellipsoid(np.array(c), np.array(a), np.eye(3)) for c, a in POUCHES)
    return Anatomy((*plain.primitives, *pouches), plain.blend_mm, plain.cuts, plain.seeds)


def jointed():
    bodies = [
        ((0.0, 0.0, 8.0), (19.0, 16.0, 20.0)),
        ((2.0, 1.0, -16.0), (10.0, 10.0, 16.0)),
        ((2.0, 0.0, -44.0), (15.0, 18.0, 22.0)),
        ((-8.0, 8.0, -48.0), (10.0, 10.0, 10.0)),
    ]
    return opened_body("body", bodies, JOINTED_VESSELS, (0.0, 16.0, 8.0))


def sliding(vessels, rng, size_mm):
    """Return a displacement of every vessel's root along the wall, the wall round it at rest."""
    centers, shifts = [], []
    for base, direction, radius, _ in vessels.values():
        if radius > 10.0:
            continue
        direction = unit(direction)
        shift = rng.uniform(-size_mm, size_mm, size=3)
        centers.append(np.array(base) + 2.0 * direction)
        shifts.append(shift - (shift @ direction) * direction)
    return Bumps(np.array(centers), np.full(len(centers), 2.0 * SMALL_MM), np.array(shifts))


def grown(anatomy, rng, count, size_mm):
    """Return outward displacements at a few places of the bodies."""
    bodies = [p for p in anatomy.primitives if isinstance(p, Ellipsoid)]
    centers, shifts = [], []
    for index in range(count):
        body = bodies[index % len(bodies)]
        direction = unit(rng.normal(size=3))
        centers.append(body.center + body.semi_axes * direction)
        shifts.append(rng.uniform(0.2, 1.0) * size_mm * direction)
    return Bumps(np.array(centers), np.full(count, 1.6 * SMALL_MM), np.array(shifts))


def scaled(bumps, amounts):
    """Return regional displacements times a number, or one number each."""
    amounts = np.broadcast_to(amounts, (len(bumps.centers),))
    return Bumps(bumps.centers, bumps.radii, amounts[:, None] * bumps.displacements)


def turned(anatomy, angles):
    """Return a turn about the z axis, by angles (K,) at equal heights from below."""
    low, high = anatomy.bounds()
    count = len(angles)
    flat = np.zeros((count, 3)), np.zeros((count, 2))
    return Axial(np.zeros(2), np.linspace(low[2], high[2], count), *flat, np.asarray(angles))


def joint(bend_mm, turn):
    """Return a bend by a slope (x, y) below a joint at z = -16 and a turn there, both sudden."""
    knots = np.array([-90.0, -50.0, -24.0, -20.0, -16.0, -12.0, -8.0, 40.0])
    depth = np.maximum(-16.0 - knots, 0.0)[:, None]
    shift = np.hstack([depth * np.asarray(bend_mm), np.zeros((8, 1))])
    angles = turn * np.array([1.0, 1.0, 1.0, 0.9, 0.5, 0.1, 0.0, 0.0])
    return Axial(np.array([2.0, 1.0]), knots, shift, np.zeros((8, 2)), angles)


def uneven(name, subjects, phases, seed):
    """Return the truth of a family whose shapes do not differ by smooth motions of space."""
    anatomy = {"torsion": pouched_ventricle, "articulated": jointed}.get(name, atrium)()
    deformations = {}
    for index, child in enumerate(np.random.SeedSequence(seed).spawn(subjects)):
        rng = np.random.default_rng(child)
        pose = Affine(rng.uniform(0.94, 1.06) * np.eye(3), rng.uniform(-5.0, 5.0, size=3))
        wall = walls(anatomy, rng, 8, 24.0, 1.6)
        small = walls(anatomy, rng, 60, SMALL_MM, 1.3)
        own, beating_part = sliding(ATRIUM_VESSELS, rng, 4.5), sliding(ATRIUM_VESSELS, rng, 3.0)
        growing = grown(anatomy, rng, 4, 5.0)
        delays = rng.uniform(0.0, 1.0, size=len(own.centers))
        twists = rng.uniform([0.35, -0.5], [0.6, -0.2])
        bends = rng.uniform(-0.3, 0.3, size=(2, 2))
        turns = rng.uniform(-0.4, 0.4, size=2)
        squeeze = rng.uniform(0.06, 0.12)
        for phase in range(phases):
            time = phase / phases
            amount = 0.5 - 0.5 * np.cos(2.0 * np.pi * time)
            late = 0.5 - 0.5 * np.cos(2.0 * np.pi * (time - 0.1))
            motion = beat(anatomy, squeeze * amount, 0.05 * late, 3.0 * amount)
            maps = {
                "free-vessels": (
                    own,
                    scaled(beating_part, np.sin(2.0 * np.pi * (time + delays))),
                    wall,
                    motion,
                ),
                "growth": (scaled(growing, 0.4 + 0.6 * amount), wall, motion),
                "torsion": (
                    wall,
                    beat(anatomy, 2.0 * squeeze * amount, 0.0, 4.0 * amount),
                    turned(anatomy, late * np.linspace(twists[0], twists[1], 5)),
                ),
                "articulated": (
                    wall,
                    joint(bends[0] + amount * bends[1], turns[0] + late * turns[1]),
                ),
                "rough": (small, motion),
            }[name]
            deformations[ShapeId(f"S{index + 1}", f"{phase:02d}", time)] = Deformation(
                (*maps, pose)
            )
    return Truth(seed, anatomy, deformations)


def family(name, subjects, phases, seed):
    """Return the truth of a family."""
    if name == "atria":
        return beating(atrium(), ATRIUM_VESSELS, subjects, phases, seed)
    if name == "ventricle":
        return beating(ventricle(), VENTRICLE_VESSELS, subjects, phases, seed)
    if name == "one-mode":
        return one_mode(subjects * phases, seed)
    if name == "left-hearts":
        return demonstration_truth(subjects, subjects * phases, seed)
    return uneven(name, subjects, phases, seed)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("family", choices=list(EDGES_MM))
    parser.add_argument("folder", type=Path)
    parser.add_argument("--subjects", type=int, default=4)
    parser.add_argument("--phases", type=int, default=9)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--edge", type=float, help="mean edge, mm")
    parser.add_argument("--noise", type=float, default=0.0, help="of the vertices, mm")
    parser.add_argument("--cuts", type=float, default=0.0, help="most that vessels lose, mm")
    chosen = parser.parse_args()
    truth = family(chosen.family, chosen.subjects, chosen.phases, chosen.seed)
    study = write_population(chosen.folder, truth, chosen.edge or EDGES_MM[chosen.family])
    spoiled(chosen.folder, truth, chosen.noise, chosen.cuts)
    print(study)


if __name__ == "__main__":
    main()
