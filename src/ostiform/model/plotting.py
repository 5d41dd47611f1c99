"""A shape in a PyVista window or picture, for notebooks. PyVista is loaded only when asked for."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.model.mesh import ModelMesh

if TYPE_CHECKING:
    import pyvista

Colouring = Literal["part", "displacement", "deviation"]

# Okabe & Ito (2008), distinguishable with any common colour-vision deficiency.
PART_COLOURS = ("#CC79A7", "#56B4E9", "#E69F00", "#009E73", "#F0E442", "#0072B2")
RIM_COLOUR = "#1b2733"
AMBIENT = 0.25


def plotted(
    shape: FloatArray,
    mesh: ModelMesh,
    values: tuple[str, FloatArray] | None,
    off_screen: bool | None,
    window_size: Sequence[int],
) -> "pyvista.Plotter":
    """Return a PyVista plotter of a shape (P, 3), its openings drawn as lines.

    Parameters
    ----------
    shape : (P, 3) float64, mm
    mesh : ModelMesh
    values : (str, (P,) float64) or None
        Title and numbers that colour the points; the parts have colours if absent.
    off_screen, window_size
        As `ShapeModel.plot`.
    """
    import pyvista

    plotter = pyvista.Plotter(off_screen=off_screen, window_size=list(window_size))
    if values is None:
        for number in range(len(mesh.parts)):
            inside = mesh.face_part == number
            if inside.any():
                piece = _surface(shape, mesh.faces[inside])
                paint = PART_COLOURS[number % len(PART_COLOURS)]
                plotter.add_mesh(piece, color=paint, smooth_shading=True, ambient=AMBIENT)
    else:
        title, numbers = values
        surface = _surface(shape, mesh.faces)
        surface.point_data[title] = numbers
        plotter.add_mesh(
            surface,
            scalars=title,
            cmap="cividis",
            smooth_shading=True,
            ambient=AMBIENT,
            scalar_bar_args={
                "vertical": True,
                "color": "black",
                "position_x": 0.84,
                "position_y": 0.3,
                "height": 0.4,
                "n_labels": 3,
                "fmt": "%.1f",
                "title_font_size": 16,
                "label_font_size": 16,
            },
        )
    for loop in mesh.loops.values():
        rim = pyvista.lines_from_points(shape[loop], close=True)
        plotter.add_mesh(rim, color=RIM_COLOUR, line_width=3)
    plotter.background_color = pyvista.Color("white")
    return plotter


def _surface(shape: FloatArray, faces: IntArray) -> "pyvista.PolyData":
    import pyvista

    corners = np.full((len(faces), 1), 3)
    return pyvista.PolyData(shape, np.hstack([corners, faces]).ravel())
