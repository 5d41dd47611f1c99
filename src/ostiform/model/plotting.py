"""A shape in a PyVista window or picture, for notebooks: the extra ``ostiform[plot]``."""

import importlib
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal

from ostiform.arrays import FloatArray
from ostiform.errors import InputError
from ostiform.model.mesh import ModelMesh

if TYPE_CHECKING:
    from pyvista import Plotter

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
) -> "Plotter":
    """Return a PyVista plotter of a shape (P, 3), its openings drawn as lines.

    Parameters
    ----------
    shape : (P, 3) float64, mm
    mesh : ModelMesh
    values : (str, (P,) float64) or None
        Title and numbers that colour the points; the parts have colours if absent.
    off_screen, window_size
        As `ShapeModel.plot`.

    Raises
    ------
    InputError
        If PyVista is not installed.
    """
    pyvista = _pyvista()
    plotter: Plotter = pyvista.Plotter(off_screen=off_screen, window_size=list(window_size))
    if values is None:
        for number in range(len(mesh.parts)):
            inside = mesh.face_part == number
            if inside.any():
                piece = pyvista.PolyData.from_regular_faces(shape, mesh.faces[inside])
                paint = PART_COLOURS[number % len(PART_COLOURS)]
                plotter.add_mesh(piece, color=paint, smooth_shading=True, ambient=AMBIENT)
    else:
        title, numbers = values
        surface = pyvista.PolyData.from_regular_faces(shape, mesh.faces)
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


def _pyvista() -> Any:
    """Return the module, or say how to install it."""
    try:
        return importlib.import_module("pyvista")
    except ModuleNotFoundError:
        raise InputError(
            "ShapeModel.plot: expected PyVista to be installed, found no package pyvista; install "
            "it with `pip install 'ostiform[plot]'`"
        ) from None
