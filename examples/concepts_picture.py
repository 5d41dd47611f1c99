"""Draw the flow from surfaces to a model in one picture: ``concepts.png`` of the documentation.

python examples/concepts_picture.py RESULTS IMAGES
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch

import ostiform
from ostiform.artifacts import load
from ostiform.domain import domain_from_json
from ostiform.embedding import Embeddings
from ostiform.pipeline.embed import embedding_artifact
from ostiform.pipeline.prepared import read_shape, shape_artifact
from ostiform.pipeline.store import Store, slug
from ostiform.report.modes import extents_of
from ostiform.report.shading import FRONT, View, draw_raster, draw_visible_curves, shaded_surface
from ostiform.report.style import part_colours

SHOWN = 3
"""Shapes, one per row."""
PIXELS = (520, 620)
EDGE = "#1b2733"
WIDTH = 0.17
GAP = (1.0 - 5 * WIDTH) / 6


def drawn(axes: Axes, view: View, points, faces, colours, loops, extent) -> None:
    """Draw one surface with its openings into a panel."""
    picture = shaded_surface(view, points, faces, colours, extent, PIXELS)
    draw_raster(axes, picture)
    draw_visible_curves(axes, picture, view, loops, EDGE)


def panel(figure: Figure, column: int, row: int) -> Axes:
    """Return the axes of one place in the grid."""
    height = 0.86 / SHOWN
    axes = figure.add_axes(
        (GAP + column * (WIDTH + GAP), 0.86 - (row + 1) * height, WIDTH, 0.98 * height)
    )
    axes.set_axis_off()
    return axes


def main(folder: Path, images: Path) -> None:
    """Draw the picture from a results folder."""
    results, store = ostiform.read_results(folder), Store(folder)
    correspondence, model = results.correspondence, results.model
    mesh = model.mesh
    subjects = list(dict.fromkeys(id.subject for id in correspondence.ids))
    chosen = [
        next(i for i, id in enumerate(correspondence.ids) if id.subject == subject)
        for subject in subjects[:SHOWN]
    ]
    chosen[1] += 3  # another phase
    directions = correspondence.template.points
    rainbow = 0.5 + 0.5 * directions[mesh.faces].mean(axis=1)  # (F, 3)
    domain = domain_from_json(store.read_json("domain.json"))
    scale = np.sqrt(model.variances[0])
    modes = [model.mean + sd * scale * model.modes[0] for sd in (2.0, 0.0, -2.0)]
    extent = extents_of((FRONT,), [*correspondence.aligned[chosen], *modes])[0]

    figure = Figure(figsize=(12.0, 6.0), dpi=110)
    names = []
    for row, index in enumerate(chosen):
        shape = correspondence.ids[index]
        names.append(str(shape))
        rotation = correspondence.transforms[index]
        parts = read_shape(store.path(shape_artifact(slug(shape)))).parts
        faces, points, colour, loops, offset = [], [], [], [], 0
        for number, part in enumerate(parts.values()):
            points.append(part.vertices @ rotation[:3, :3].T + rotation[:3, 3])
            faces.append(part.faces + offset)
            colour.append(np.full(len(part.faces), number))
            loops += [points[-1][loop] for loop in part.loops.values()]
            offset += len(part.vertices)
        axes = panel(figure, 0, row)
        drawn(
            axes,
            FRONT,
            np.vstack(points),
            np.vstack(faces),
            part_colours(np.concatenate(colour)),
            loops,
            extent,
        )

        embedding = load(store.path(embedding_artifact(slug(shape))), Embeddings)[0]
        component = embedding.component
        sphere = np.asarray(embedding.states[-1].directions)
        circles = [sphere[rim] for rim in component.rims.values()]
        circles += [sphere[seam] for seam in component.seams.values()]
        axes = panel(figure, 1, row)
        drawn(
            axes, View(np.array([[0, 1, 0], [-0.75, 0, 0.66], [0.66, 0, 0.75]]), "sphere"), sphere,
            component.faces, part_colours(component.face_part), circles,
            np.array([-1.1, 1.1, -1.31, 1.31]),
        )  # fmt: skip
        axes = panel(figure, 2, row)
        own = correspondence.aligned[index]
        drawn(axes, FRONT, own, mesh.faces, rainbow, [own[loop] for loop in mesh.loops.values()],
              extent)  # fmt: skip
        axes = panel(figure, 3, row)
        drawn(axes, FRONT, modes[row], mesh.faces, part_colours(mesh.face_part),
              [modes[row][loop] for loop in mesh.loops.values()], extent)  # fmt: skip
        axes.text(0.02, 0.04, ("+2 sd", "mean", "\N{MINUS SIGN}2 sd")[row],
                  transform=axes.transAxes, fontsize=10, color=EDGE)  # fmt: skip
    evidence(figure, results)
    titles = ("surfaces, openings named", "maps to the sphere,\nno triangle folded",
              "points that correspond", "model: mean, modes", "evidence, report, use")  # fmt: skip
    for column, title in enumerate(titles):
        x = GAP + column * (WIDTH + GAP) + 0.5 * WIDTH
        figure.text(x, 0.93, title, ha="center", va="center", fontsize=12, color=EDGE)
        if column:
            left = x - 0.5 * WIDTH
            figure.add_artist(
                FancyArrowPatch(
                    (left - 0.9 * GAP, 0.45),
                    (left - 0.1 * GAP, 0.45),
                    arrowstyle="-|>",
                    mutation_scale=18,
                    color="#54626f",
                    linewidth=2,
                    transform=figure.transFigure,
                )  # fmt: skip
            )
    print("shapes drawn:", *names, "circles:", sum(len(s.curves) for s in domain.spheres))
    images.mkdir(parents=True, exist_ok=True)
    figure.savefig(images / "concepts.png", facecolor="white")


def evidence(figure: Figure, results: ostiform.Results) -> None:
    """Draw the left-out residue and the total variance of the three models."""
    colours = {"conformal": "#0072B2", "euclidean": "#E69F00", "optimal": "#009E73"}
    x = GAP + 4 * (WIDTH + GAP)
    upper = figure.add_axes((x + 0.03, 0.53, WIDTH - 0.03, 0.28))
    lower = figure.add_axes((x + 0.03, 0.12, WIDTH - 0.03, 0.26))
    for number, (kind, colour) in enumerate(colours.items()):
        found = results.evaluated(kind)
        residues = found.generalisation.surface_mean.mean(axis=0)
        upper.plot(found.generalisation.mode_counts, residues, color=colour, label=kind)
        lower.bar(number, found.compactness.total, color=colour)
    upper.set_ylim(bottom=0)
    upper.set_title("left-out residue (mm) by modes", fontsize=9)
    lower.set_title("total variance (mm²)", fontsize=9)
    lower.set_xticks(range(3), ["conformal", "Euclidean", "optimal"], fontsize=7)
    upper.tick_params(labelsize=8)
    lower.tick_params(axis="y", labelsize=8)
    for axes in (upper, lower):
        axes.spines[["top", "right"]].set_visible(False)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
