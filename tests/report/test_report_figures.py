"""The figures as functions: they return Matplotlib figures that show what they should."""

import numpy as np
import pytest
from matplotlib.figure import Figure
from populations import population, two_part_template

from ostiform.evaluation import volume_curves
from ostiform.model import fit_model, mesh_of_template
from ostiform.report.curves import (
    MODES_DRAWN,
    Band,
    convergence_figure,
    evidence_figure,
    scores_figure,
    volumes_figure,
)
from ostiform.report.maps import MapPanel, distortion_figure, map_figure
from ostiform.report.modes import model_views, modes_figure, shapes_figure
from ostiform.study import ShapeId

KINDS = ("conformal", "euclidean", "optimal")


@pytest.fixture(scope="module")
def model():
    shapes = population(3, 2, np.random.default_rng(4), two_part_template(9, 16))
    return fit_model(shapes.aligned, shapes.weights, mesh_of_template(shapes.template))


def bands(count):
    modes = np.arange(1.0, count + 1.0)
    return {kind: Band(modes, modes, np.ones(count)) for kind in KINDS}


def test_evidence_draws_the_first_modes_only():
    drawing = evidence_figure(bands(40), bands(3), bands(20))
    assert isinstance(drawing, Figure)
    for axes in drawing.axes:
        assert len(axes.lines) == len(KINDS)
        assert max(line.get_xdata().max() for line in axes.lines) <= MODES_DRAWN


def test_evidence_without_residues_has_no_empty_panel():
    drawing = evidence_figure(bands(4), {}, bands(4))
    assert [axes.get_title() for axes in drawing.axes] == ["Compactness", "Specificity"]


def test_modes_show_the_second_part_above_the_first_from_two_sides(model):
    front, side = model_views(model)
    for view in (front, side):
        seen = view.seen(model.mean)
        assert seen[model.mesh.part == 1, 1].mean() > seen[model.mesh.part == 0, 1].mean()
        np.testing.assert_allclose(view.axes @ view.axes.T, np.eye(3), atol=1e-12)
        np.testing.assert_allclose(np.linalg.det(view.axes), 1.0, rtol=1e-12)
    np.testing.assert_allclose(front.axes[2] @ side.axes[2], 0.0, atol=1e-12)


def test_modes_are_drawn_at_five_places_from_two_sides(model):
    drawing = modes_figure(model, 0)
    assert isinstance(drawing, Figure)
    assert len(drawing.axes) == 10
    titles = [axes.get_title() for axes in drawing.axes[:5]]
    assert titles == ["\u22123 sd", "\u22122 sd", "mean", "+2 sd", "+3 sd"]
    images = [axes.images[0].get_array() for axes in drawing.axes]
    assert all((image != 255).any() for image in images)
    assert (np.asarray(images[0]) != np.asarray(images[4])).any()


def test_single_shapes_are_drawn_with_their_titles(model):
    drawing = shapes_figure(model, model.mean[None], ["who"])
    assert [axes.get_title() for axes in drawing.axes] == ["who"]


def panel(flipped):
    points = np.array([[-1.0, -1.0], [1.0, -1.0], [0.0, 1.0]])
    return MapPanel(
        "state",
        points,
        np.array([[0, 1, 2]]),
        np.array([flipped]),
        (np.array([0, 1, 2]),),
        np.zeros((1, 2)),
    )


def test_turned_triangles_are_counted_and_have_another_colour():
    drawing = map_figure([panel(False), panel(True)])
    assert [axes.get_title() for axes in drawing.axes] == [
        "state\n0 turned over",
        "state\n1 turned over",
    ]
    upright, flipped = (np.asarray(axes.images[0].get_array()) for axes in drawing.axes)
    middle = (upright.shape[0] // 2, upright.shape[1] // 2)
    assert upright[middle][2] > 200
    assert flipped[middle][2] < 50


def test_the_second_row_of_a_map_is_enlarged():
    drawing = map_figure([panel(False)], zoom=np.array([0.1, 0.2, 0.3]))
    np.testing.assert_allclose(drawing.axes[1].get_xlim(), (-0.2, 0.4))
    np.testing.assert_allclose(drawing.axes[1].get_ylim(), (-0.1, 0.5))


def test_distortion_has_a_panel_for_angles_and_one_for_areas():
    area = np.array([[0.5, 2.0], [0.4, 3.0]])
    drawing = distortion_figure([np.array([1.1, 1.2])] * 2, [area, area], ["A", "B"])
    assert [axes.get_title() for axes in drawing.axes] == ["Angles", "Areas"]


def test_cycles_are_closed_in_scores_and_volumes():
    times = np.array([0.5, 0.0, 0.25])
    drawing = scores_figure(np.arange(6.0).reshape(3, 2), ["s"] * 3, times, np.array([0.7, 0.3]))
    (line,) = drawing.axes[0].lines
    np.testing.assert_allclose(line.get_xdata(), [2.0, 4.0, 0.0, 2.0])
    ids = [ShapeId("s", str(time), time) for time in times]
    drawing = volumes_figure(volume_curves(ids, {"LV": np.array([3e3, 1e3, 2e3])}))
    (line,) = drawing.axes[0].lines
    np.testing.assert_allclose(line.get_xdata(), [0.0, 0.25, 0.5, 1.0])
    np.testing.assert_allclose(line.get_ydata(), [1.0, 2.0, 3.0, 1.0])


def test_many_subjects_get_no_legend():
    names = [f"s{i}" for i in range(20)]
    drawing = scores_figure(np.zeros((20, 2)), names, np.zeros(20), np.ones(2) / 2)
    assert drawing.legends == []


def test_convergence_has_a_line_per_level():
    drawing = convergence_figure(np.arange(4.0), -np.arange(4.0), np.array([2.0, 2, 3, 3]), "bits")
    assert [line.get_label() for line in drawing.axes[0].lines] == ["level 2", "level 3"]
