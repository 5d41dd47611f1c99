"""Time and accuracy of the embedding over mesh sizes and vein lengths, one core, after warm-up.

    python -m benchmarks.embedding [largest number of vertices]

Meshes: atria with veins of 4 and 8 radii, a ventricle with two openings (near-equilateral, and raw
marching cubes beside), and left hearts solved jointly (their time is divided by their two parts).
Hygiene is included; remeshing is not needed, but is what a build does with parts of more than
10,000 vertices ("coarsened", its time included).
"""

import sys
import time

import numpy as np

from ostiform.domain import chosen_pole, lay_out, outlined
from ostiform.embedding import Embedding, EmbeddingSettings, conformal_holes, embed
from ostiform.pipeline.prepare import FINEST
from ostiform.surface import Component, cleaned_for_embedding, coarsened
from tests.oracles.implicit_atria import (
    atrium,
    joined_component,
    left_heart,
    opened_component,
    ventricle,
)

SIZES = {"5k": 5_000, "20k": 20_000, "90k": 90_000}
REPEATS = 3
RELAXATIONS = 20
HEADER = "| mesh | vertices | s per part | turned | angle | area 1 to 99 % | seam jump (floor) |"


def main(largest: int) -> None:
    """Print a row per mesh."""
    measured(opened_component(ventricle(), 4.0, "LV", RELAXATIONS))  # compile
    print(HEADER)
    print("|---|---|---|---|---|---|---|")
    rng = np.random.default_rng(0)
    for size, n_vertices in SIZES.items():
        if n_vertices > largest:
            break
        for name, body, area in (
            ("ventricle", ventricle(), 12_000.0),
            ("atrium, veins 4 radii", atrium(4.0), 9_000.0),
            ("atrium, veins 8 radii", atrium(8.0), 12_000.0),
        ):
            spacing = float(np.sqrt(area / n_vertices * 2.0 / np.sqrt(3.0)))
            for kind, relax in (("relaxed", RELAXATIONS), ("raw", 0)):
                component = opened_component(body, spacing, "P", relax)
                row(f"{name}, {size}, {kind}", component)
        spacing = float(np.sqrt(20_000.0 / (2 * n_vertices) * 2.0 / np.sqrt(3.0)))
        row(f"left heart, {size} a part", joined_component(left_heart(rng), spacing, RELAXATIONS))


def row(name: str, component: Component) -> None:
    """Print one row."""
    n_parts = len(component.parts)
    report(name, n_parts, *measured(component))
    if len(component.vertices) > FINEST * n_parts:
        report(f"{name}, coarsened", n_parts, *measured(component, FINEST * n_parts))


def report(name: str, n_parts: int, seconds: float, vertices: int, embedding: Embedding) -> None:
    """Print what was measured."""
    distortion = embedding.distortion
    jumps = [f"{j.mean:.2f} ({j.floor_mean:.2f})" for j in distortion.seam_jump.values()]
    print(
        f"| {name} | {vertices} | {seconds / n_parts:.2f} "
        f"| {embedding.certificate.flipped + embedding.certificate.degenerate} "
        f"| {distortion.angle_mean:.2f} | {distortion.area_p01:.2f} to {distortion.area_p99:.2f} "
        f"| {' '.join(jumps)} |",
        flush=True,
    )


def measured(
    component: Component, most_vertices: int = sys.maxsize
) -> tuple[float, int, Embedding]:
    """Return the median processor time of hygiene and embedding, the size, and the map."""
    times = []
    for _ in range(REPEATS if len(component.vertices) < 50_000 else 1):
        start = time.process_time()
        cleaned, _ = coarsened(cleaned_for_embedding(component)[0], most_vertices)
        cleaning = time.process_time() - start
        outline = outlined(cleaned)
        pole = chosen_pole([outline])
        holes = conformal_holes(cleaned, pole, np.eye(4))
        sphere = lay_out([[outline]], [[holes]]).spheres[0]
        start = time.process_time()
        embedding = embed(cleaned, sphere, EmbeddingSettings(), np.eye(4))
        times.append(cleaning + time.process_time() - start)
    return float(np.median(times)), len(cleaned.vertices), embedding


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 90_000)
