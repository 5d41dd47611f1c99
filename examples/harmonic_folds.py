"""Show that the harmonic map of a heart with fixed circles folds and the barrier map does not.

Needs the results of ``ostiform demo`` (or of any build whose shapes have narrow openings)::

    ostiform demo -o demo
    python examples/harmonic_folds.py demo/results docs/images

Writes ``harmonic-folds.svg`` (folded triangles against the width of the circles) and
``harmonic-folds.png`` (one opening in the stereographic plane, harmonic and as Ostiform maps it),
and prints the counts.
"""

import argparse
import json
from pathlib import Path

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.artifacts import load
from ostiform.domain import Sphere, domain_from_json, stereographic_view
from ostiform.embedding import (
    Embedding,
    Embeddings,
    conformal_holes,
    folds_by_circle_ratio,
    harmonic_map,
)
from ostiform.pipeline.prepare import read_poses
from ostiform.pipeline.store import Store, slug
from ostiform.report.maps import MapPanel, map_figure
from ostiform.report.style import FLIPPED, PART_COLOURS, figure, styled
from ostiform.surface import count_flipped, exact_orientations

RATIOS = (0.5, 1.0, 1.25, 1.5, 1.75, 2.0, 2.5, 3.0, 4.0, 5.0)


def main() -> None:
    """Draw both figures for one shape of a build."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("results", type=Path, help="output folder of a build")
    parser.add_argument("images", type=Path, help="folder for the figures")
    parser.add_argument("--shape", help="stem of a file in RESULTS/embeddings; default the first")
    given = parser.parse_args()
    shapes = sorted((given.results / "embeddings").glob(f"{given.shape or '*'}.bin"))
    if not shapes:
        parser.error(f"expected embeddings in {given.results}, found none: build the study first")
    embedding = load(shapes[0], Embeddings)[0]
    domain = domain_from_json(json.loads((given.results / "domain.json").read_text()))
    sphere = next(s for s in domain.spheres if s.name == embedding.component.name)
    given.images.mkdir(parents=True, exist_ok=True)
    pose = pose_of(shapes[0].stem, given.results)
    draw_counts(embedding, sphere, pose, given.images / "harmonic-folds.svg")
    draw_opening(embedding, sphere, given.images / "harmonic-folds.png")


def pose_of(name: str, results: Path) -> FloatArray:
    """Return the (4, 4) transform of a shape to the population's frame."""
    return next(p.transform for p in read_poses(Store(results)) if slug(p.id) == name)


def draw_counts(embedding: Embedding, sphere: Sphere, pose: FloatArray, path: Path) -> None:
    """Plot the folded triangles of the harmonic map against circle radius / conformal radius."""
    component = embedding.component
    holes = conformal_holes(component, sphere.pole, pose)
    rotations = {name: curve.first_angle for name, curve in embedding.curves.items()}
    harmonic = folds_by_circle_ratio(component, sphere, holes, RATIOS, rotations)
    ours = count_flipped(embedding.directions, component.faces)
    print(
        f"{len(component.faces)} triangles; Ostiform folds {ours}, with circles of up to "
        f"{max(embedding.distortion.circle_ratio.values()):.1f} times the conformal radius"
    )
    for ratio, count in zip(RATIOS, harmonic, strict=True):
        print(f"  harmonic map, circles of {ratio:4.2f} times the conformal radius: {count}")
    with styled():
        drawing = figure(110.0, 70.0)
        axes = drawing.subplots()
        axes.plot(RATIOS, harmonic, "o-", color=FLIPPED, label="harmonic map (paper)")
        axes.axhline(ours, color=PART_COLOURS[3], label="barrier map (Ostiform), any radius")
        axes.axvline(2.0, color="#888888", linewidth=0.8, linestyle=":")
        axes.set_yscale("symlog", linthresh=1.0)
        axes.set_ylim(-0.2, 2.0 * max(*harmonic, 1))
        powers = [10**k for k in range(1 + int(np.log10(max(*harmonic, 1))))]
        axes.set_yticks([0, *powers], [str(value) for value in (0, *powers)])
        axes.set_xlabel("radius of the circles / conformal radius of the openings")
        axes.set_ylabel("triangles turned over")
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.07))
    drawing.savefig(path, metadata={"Date": None})


def draw_opening(embedding: Embedding, sphere: Sphere, path: Path) -> None:
    """Draw the opening whose circle is widest for it, harmonic and as mapped."""
    component = embedding.component
    ratios = embedding.distortion.circle_ratio
    name = max(ratios, key=lambda rim: ratios[rim])
    fixed = np.zeros(len(component.vertices), dtype=np.bool_)
    for curve in (*component.rims.values(), *component.seams.values()):
        fixed[curve] = True
    harmonic = harmonic_map(component, embedding.directions, fixed)  # the best of starts
    print(f"drawn: {name}, circle of {ratios[name]:.1f} times its conformal radius")
    panels = [
        panel(embedding, sphere, name, "harmonic", harmonic.directions),
        panel(embedding, sphere, name, "barrier", embedding.directions),
    ]
    rim = panels[1].points[panels[1].curves[0]]  # (n, 2)
    center = rim.mean(axis=0)
    reach = 2.5 * np.linalg.norm(rim - center, axis=1).max()
    drawing = map_figure(panels, np.array([*center, reach]))
    drawing.savefig(path, dpi=110)


def panel(
    embedding: Embedding, sphere: Sphere, rim: str, title: str, directions: FloatArray
) -> MapPanel:
    """Return one map of the part that an opening belongs to; the opening is the first curve."""
    component = embedding.component
    part = rim.split(".")[0]
    faces = component.faces[component.face_part == component.parts.index(part)]
    used, local = np.unique(faces, return_inverse=True)
    place = np.full(len(component.vertices), -1, dtype=np.int64)
    place[used] = np.arange(len(used))
    curves = [component.rims[rim], *component.rims.values(), *component.seams.values()]
    return MapPanel(
        title,
        stereographic_view(sphere, part, directions[used])[:, :2],
        local.reshape(-1, 3),
        exact_orientations(directions, faces) <= 0,
        tuple(place[curve] for curve in curves if (place[curve] >= 0).all()),
        np.empty((0, 2)),
    )


if __name__ == "__main__":
    main()
