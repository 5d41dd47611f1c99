"""A model in a PyVista window or picture, for notebooks. PyVista is loaded only when asked for."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike

from ostiform.arrays import FloatArray, IntArray
from ostiform.model.pca import reconstruct
from ostiform.model.types import ShapeModel

if TYPE_CHECKING:
    import pyvista

Colouring = Literal["part", "displacement", "deviation"]

# Okabe & Ito (2008), distinguishable with any common colour-vision deficiency.
PART_COLOURS = ("#CC79A7", "#56B4E9", "#E69F00", "#009E73", "#F0E442", "#0072B2")
RIM_COLOUR = "#1b2733"
AMBIENT = 0.25


def point_deviations(model: ShapeModel) -> FloatArray:
    """Return the standard deviation (P,) in mm of every point: RMS distance from its mean."""
    squared = np.einsum("k,kpi,kpi->p", model.variances, model.modes, model.modes)
    deviations: FloatArray = np.sqrt(squared + model.residual_variance)
    return deviations


def model_plotter(
    model: ShapeModel,
    scores: ArrayLike = (),
    colour: Colouring = "part",
    off_screen: bool | None = None,
    window_size: Sequence[int] = (800, 700),
) -> "pyvista.Plotter":
    """Return a PyVista plotter of one shape of a model, its openings drawn as lines.

    Nothing is opened: call ``show()`` for a window or a notebook's viewer, ``screenshot(path)``
    for a picture. More meshes can be added before.

    Parameters
    ----------
    model : ShapeModel
    scores : (M,) array_like, mm
        Of the shape; missing ones are zero, so that nothing given is the mean.
    colour : str
        ``"part"``, ``"displacement"`` (distance from the mean, mm) or ``"deviation"`` (standard
        deviation of every point, mm).
    off_screen : bool, optional
        Draw without a window; PyVista's own setting if absent.
    window_size : (int, int)
        In pixels.

    Raises
    ------
    InputError
        If there are more scores than modes.
    """
    import pyvista

    shape = reconstruct(model, np.asarray(scores, dtype=np.float64))
    plotter = pyvista.Plotter(off_screen=off_screen, window_size=list(window_size))
    mesh = _surface(shape, model.mesh.faces)
    if colour == "part":
        for number in range(len(model.mesh.parts)):
            inside = model.mesh.face_part == number
            if inside.any():
                piece = _surface(shape, model.mesh.faces[inside])
                paint = PART_COLOURS[number % len(PART_COLOURS)]
                plotter.add_mesh(piece, color=paint, smooth_shading=True, ambient=AMBIENT)
    else:
        values, title = (
            (np.linalg.norm(shape - model.mean, axis=1), "distance (mm)")
            if colour == "displacement"
            else (point_deviations(model), "sd (mm)")
        )
        mesh.point_data[title] = values
        plotter.add_mesh(
            mesh,
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
    for loop in model.mesh.loops.values():
        rim = pyvista.lines_from_points(shape[loop], close=True)
        plotter.add_mesh(rim, color=RIM_COLOUR, line_width=3)
    plotter.background_color = pyvista.Color("white")
    return plotter


def _surface(shape: FloatArray, faces: IntArray) -> "pyvista.PolyData":
    import pyvista

    corners = np.full((len(faces), 1), 3)
    return pyvista.PolyData(shape, np.hstack([corners, faces]).ravel())
