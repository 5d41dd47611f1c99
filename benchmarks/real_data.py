"""Build the three studies of ``docs/real-data.md`` and print the numbers that it quotes.

``python benchmarks/real_data.py DATA OUT``: DATA holds the folders ``left-atria``, ``lv-cine`` and
``left-heart-template`` with the surfaces named in ``examples/studies``; one that is absent is
skipped. Results go to OUT, and are used again where they are current.
"""

import argparse
import time
from pathlib import Path

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.artifacts import load
from ostiform.correspondence import KINDS
from ostiform.embedding import Embeddings
from ostiform.evaluation import (
    TruthDistance,
    compare,
    distance_to_truth,
    read_evaluation,
)
from ostiform.model import read_correspondence
from ostiform.pipeline import Stage, Summary, build_study
from ostiform.pipeline.prepared import read_shape
from ostiform.study import ShapeId
from ostiform.surface import closest_points, surface_tree

STUDIES = Path(__file__).resolve().parents[1] / "examples" / "studies"
SINGLE = {"left-heart-template"}
TRUE_BY_VERTEX_ORDER = {"lv-cine": "LV"}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    for template in sorted(STUDIES.glob("*.toml")):
        name = template.stem
        if not (given.data / name).is_dir():
            print(f"\n## {name}: skipped, no folder {given.data / name}")
            continue
        folder = given.out / name
        folder.mkdir(parents=True, exist_ok=True)
        text = template.read_text(encoding="utf-8")
        place = (given.data / name).resolve().as_posix()
        study = folder / "study.toml"
        study.write_text(text.replace('folder = "."', f'folder = "{place}"'), encoding="utf-8")
        until = Stage.EMBED if name in SINGLE else Stage.REPORT
        clock = time.monotonic()
        summary = build_study(study, folder / "out", until=until, workers=given.workers)
        print(f"\n## {name}: {time.monotonic() - clock:.0f} s wall, {given.workers} workers\n")
        show_shapes(summary)
        show_maps(summary.output)
        if until is Stage.REPORT:
            part = TRUE_BY_VERTEX_ORDER.get(name)
            show_models(summary.output, part)


def show_shapes(summary: Summary) -> None:
    used = summary.shapes - len(summary.failures)
    print(f"{used} of {summary.shapes} shapes used")
    for failure in summary.failures:
        print(f"- left out ({failure.stage}): {failure.reason}")
    print("stages: " + ", ".join(f"{k} {v:.1f} s" for k, v in summary.seconds.items()))


def show_maps(output: Path) -> None:
    print(
        "\n| shape | vertices | flipped | angle mean / 99 % | area 1 % to 99 % | widest circle "
        "/ conformal | largest twist (deg) | CPU s |\n|---|---|---|---|---|---|---|---|"
    )
    for path in sorted((output / "embeddings").glob("*.bin")):
        for e in load(path, Embeddings):
            c, d = e.certificate, e.distortion
            print(
                f"| {path.stem} | {len(e.component.vertices)} | {c.flipped + c.degenerate} "
                f"| {d.angle_mean:.2f} / {d.angle_p99:.1f} | {d.area_p01:.2f} to {d.area_p99:.2f}"
                f" | {max(d.circle_ratio.values(), default=1.0):.1f} "
                f"| {max(abs(np.degrees(t)) for t in c.twist.values()):.0f} | {e.seconds:.2f} |"
            )


def show_models(output: Path, part: str | None) -> None:
    evaluations = {kind: read_evaluation(output / kind / "evaluation.json") for kind in KINDS}
    print(
        "\n| model | variance mm^2 | modes for 95 % | description length | surface residue at 0, 1,"
        " 3, 10 modes mm | specificity mm | worst coverage 95 % mm | least area share ratio "
        "| furthest vertex, % of diameter | distance to truth, mean / 95 % mm |\n"
        "|---|---|---|---|---|---|---|---|---|---|"
    )
    for kind, item in evaluations.items():
        residue = (
            ""
            if item.generalisation is None
            else " / ".join(
                f"{item.generalisation.surface_mean.mean(axis=0)[m]:.3f}" for m in (0, 1, 3, 10)
            )
        )
        truth = None if part is None else vertex_order_truth(output, kind, part)
        shown = "" if truth is None else f"{truth.mean:.2f} / {truth.p95:.2f}"
        print(
            f"| {kind} | {item.compactness.total:.2f} | {item.compactness.modes_for(0.95)} "
            f"| {item.description_length:.2f} | {residue} | {item.specificity.mean[-1]:.2f} "
            f"| {max(c.p95 for c in item.coverage):.2f} "
            f"| {min(c.smallest_share_ratio for c in item.coverage):.2f} "
            f"| {100 * max(c.maximum / c.diameter for c in item.coverage):.2f} | {shown} |"
        )
    for kind in KINDS[:-1]:
        found = compare(evaluations["optimal"], evaluations[kind])
        line = f"- optimal against {kind}: variance gain {found.variance_gain:.1%}"
        if found.residues is not None:
            paired = found.residues.surface_over_modes
            interval = "" if paired.low is None else f" ({paired.low:+.3f} to {paired.high:+.3f})"
            line += (
                f", residue over 1 to 10 modes lower by {paired.mean:+.3f} mm{interval}, "
                f"worst ratio {found.residues.worst_ratio:.3f}"
            )
        print(line)


def vertex_order_truth(output: Path, kind: str, part: str) -> TruthDistance:
    """Measure a correspondence where equal vertex numbers are the true one.

    Material coordinates of a point: the triangle that holds it and its barycentric coordinates.
    """
    correspondence = read_correspondence(output / kind / "correspondence.h5")
    shapes = [read_shape(path) for path in sorted((output / "shapes").glob("*.bin"))]
    surfaces = {shape.id: shape.parts[part] for shape in shapes}
    trees = {id: surface_tree(s.vertices, s.faces) for id, s in surfaces.items()}

    def to_material(id: ShapeId, _: str, points: FloatArray) -> FloatArray:
        found = closest_points(trees[id], points)
        return np.column_stack([found.faces, found.barycentric])

    def from_material(id: ShapeId, _: str, material: FloatArray) -> FloatArray:
        surface = surfaces[id]
        corners = surface.vertices[surface.faces[material[:, 0].astype(np.int64)]]  # (n, 3, 3)
        carried: FloatArray = np.einsum("nk,nka->na", material[:, 1:], corners)
        return carried

    return distance_to_truth(correspondence, to_material, from_material)


if __name__ == "__main__":
    main()
