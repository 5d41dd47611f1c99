"""Atria whose veins were cut at random: whole veins, cut ones, and cut ones that the study states.

Run from the repository root: ``python -m benchmarks.cut_vessels FOLDER``. Prints the table of
`docs/benchmarks.md`.
"""

import argparse
from pathlib import Path

import numpy as np

from benchmarks.populations import ATRIUM_VESSELS, EDGES_MM, beating, opened_body
from ostiform.arrays import FloatArray
from ostiform.correspondence import Correspondence
from ostiform.demo import RandomEnds, Truth, material_coordinates, true_positions, write_population
from ostiform.model import analysed, corresponded_shapes, read_correspondence
from ostiform.pipeline import Stage, build_study
from ostiform.surface import boundary_loops, read_mesh

VEIN_MM = 20.0
"""Length of the whole veins, material coordinates."""
COMMON_MM = 8.0
"""Points up to so far from the veins' bases, material coordinates, are compared."""
LONGEST_MM, SLANT_DEG = 12.0, 15.0
SCORES = 10
VESSELS = {
    name: (base, direction, radius, length if name == "mitral" else VEIN_MM)
    for name, (base, direction, radius, length) in ATRIUM_VESSELS.items()
}
VEINS = [name for name in VESSELS if name != "mitral"]


def population(subjects: int, phases: int, seed: int) -> Truth:
    """Return atria with long veins."""
    bodies = [
        ((-7.0, 0.0, 2.0), (18.0, 17.0, 18.0)),
        ((8.0, 4.0, 1.0), (17.0, 15.0, 16.0)),
        ((20.0, -14.0, 4.0), (8.0, 8.0, 6.0)),
    ]
    anatomy = opened_body("LA", bodies, VESSELS, (-7.0, 0.0, 20.0))
    return beating(anatomy, VESSELS, subjects, phases, seed)


def common_error(truth: Truth, found: Correspondence) -> tuple[float, float]:
    """Return mean and 95 % of the distance to the true points, mm, where all shapes have some."""
    material = np.stack(
        [
            material_coordinates(truth, id, "LA", points)
            for id, points in zip(found.ids, found.points, strict=True)
        ]
    )  # (N, P, 3)
    common = np.ones(material.shape[1], dtype=bool)
    for name in VEINS:
        base, direction, radius, _ = VESSELS[name]
        axis = np.array(direction) / np.linalg.norm(direction)
        along = (material - np.array(base)) @ axis
        across = np.linalg.norm(material - np.array(base) - along[..., None] * axis, axis=2)
        common &= ~((across < 1.5 * radius) & (along > COMMON_MM)).any(axis=0)
    errors = []
    for target, id in enumerate(found.ids):
        for source in range(len(found.ids)):
            if source != target:
                there = true_positions(truth, id, "LA", material[source][common])
                errors.append(np.linalg.norm(there - found.points[target][common], axis=1))
    weights = found.weights[common] / found.weights[common].sum()
    return float(np.mean(errors, axis=0) @ weights), float(np.percentile(errors, 95.0))


def explained(found: Correspondence, ends: FloatArray) -> float:
    """Return the largest share of one of the first scores' variance that lengths (N, 4) explain.

    Adjusted for the number of lengths. What whole veins give, whose shapes know nothing of the
    cuts, is what the largest of ten shares reaches by chance.
    """
    shapes = corresponded_shapes(found)
    scores = analysed(shapes).model.project(shapes.aligned)[:, :SCORES]
    design = np.column_stack([np.ones(len(ends)), ends])
    left = scores - design @ np.linalg.lstsq(design, scores, rcond=None)[0]
    share = (left**2).sum(axis=0) / ((scores - scores.mean(axis=0)) ** 2).sum(axis=0)
    freedom = (len(ends) - 1) / (len(ends) - design.shape[1])
    return float((1.0 - freedom * share).max())


def planted(truth: Truth, folder: Path) -> FloatArray:
    """Return how much too short every vein of the files is, (N, 4), mm in world coordinates."""
    rows = []
    for id, deformation in truth.deformations.items():
        mesh = read_mesh(folder / f"shapes/{id.subject}_{id.phase}_LA.vtp")
        rims = np.stack([mesh.vertices[loop].mean(axis=0) for loop in boundary_loops(mesh.faces)])
        whole = {cut.first: cut.center for cut in truth.anatomy.cuts}
        ends = deformation.forward(np.stack([whole[f"LA.{name}"] for name in VEINS]))
        bases = deformation.forward(np.stack([np.array(VESSELS[name][0]) for name in VEINS]))
        middle = 0.5 * (ends + bases)
        nearest = np.linalg.norm(rims - middle[:, None], axis=2).argmin(axis=1)
        rows.append(np.linalg.norm(rims[nearest] - ends, axis=1))
    return np.array(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--subjects", type=int, default=12)
    parser.add_argument("--phases", type=int, default=4)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1])
    parser.add_argument("--points", type=int, default=500)
    chosen = parser.parse_args()
    print("| seed | veins | conformal mm (95 %) | optimal mm (95 %) | scores explained by cuts |")
    print("|---|---|---|---|---|")
    for seed in chosen.seeds:
        truth = population(chosen.subjects, chosen.phases, seed)
        ends = RandomEnds({f"LA.{name}": VEIN_MM for name in VEINS}, LONGEST_MM, SLANT_DEG)
        found = {}
        for title, cut, stated in (
            ("whole", None, False),
            ("cut, taken for anatomy", ends, False),
            ("cut, stated as cuts", ends, True),
        ):
            folder = chosen.folder / f"{seed}-{title.replace(', ', '-').replace(' ', '-')}"
            study = write_population(folder, truth, EDGES_MM["atria"], ends=cut)
            text = study.read_text(encoding="utf-8")
            if not stated:
                text = "\n".join(t for t in text.splitlines() if not t.startswith("cuts ="))
            study.write_text(f"{text}\n[template]\npoints = {chosen.points}\n", encoding="utf-8")
            build_study(study, folder / "out", until=Stage.CORRESPOND)
            found[title] = [
                read_correspondence(folder / "out" / kind / "correspondence.h5")
                for kind in ("conformal", "optimal")
            ]
        lengths = planted(truth, folder)
        for title, (conformal, optimal) in found.items():
            row = ["{:.2f} ({:.2f})".format(*common_error(truth, c)) for c in (conformal, optimal)]
            print(f"| {seed} | {title} | {row[0]} | {row[1]} | {explained(optimal, lengths):.0%} |")


if __name__ == "__main__":
    main()
