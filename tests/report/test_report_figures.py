"""The figures as functions: they return Matplotlib figures that show what they should."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

from ostiform.evaluation import volume_curves
from ostiform.evaluation.map_records import ANGLE_EDGES, AREA_EDGES, JUMP_EDGES
from ostiform.model import fit_model, mesh_of_template
from ostiform.report.curves import (
    MODES_DRAWN,
    Band,
    GainPoint,
    convergence_figure,
    evidence_figure,
    gains_figure,
    scores_figure,
    volumes_figure,
)
from ostiform.report.distortions import distortion_figure, seam_figure
from ostiform.report.maps import MapPanel, map_figure
from ostiform.report.modes import modes_figure
from ostiform.report.point_pictures import (
    PointColumn,
    points_figure,
    shapes_figure,
    surfaces_figure,
)
from ostiform.report.shading import ALL_ROUND, FRONT, LEFT
from ostiform.study import ShapeId
from ostiform.surface import Surface
from tests.populations import population, two_part_template

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
        assert max(np.asarray(line.get_xdata()).max() for line in axes.lines) <= MODES_DRAWN


def test_evidence_without_residues_has_no_empty_panel():
    drawing = evidence_figure(bands(4), {}, bands(4))
    assert [axes.get_title() for axes in drawing.axes] == ["Compactness", "Specificity"]


def test_shapes_are_seen_upright_from_four_sides():
    head, left, nose = np.eye(3)[2], np.eye(3)[0], -np.eye(3)[1]  # in LPS
    for view in ALL_ROUND:
        np.testing.assert_allclose(view.axes @ view.axes.T, np.eye(3), atol=1e-15)
        assert np.linalg.det(view.axes) == pytest.approx(1.0)
        assert view.seen(head).tolist() == [0.0, 1.0, 0.0]
    assert FRONT.seen(nose)[2] == 1.0  # nearest to the eye
    assert FRONT.seen(left)[0] == 1.0  # who faces us has the left hand on our right
    assert LEFT.seen(left)[2] == 1.0


def test_modes_are_drawn_at_five_places_from_two_sides(model):
    drawing = modes_figure(model, 0)
    assert isinstance(drawing, Figure)
    assert len(drawing.axes) == 10
    titles = [axes.get_title() for axes in drawing.axes[:5]]
    assert titles == ["\u22123 sd", "\u22122 sd", "mean", "+2 sd", "+3 sd"]
    images = [axes.images[0].get_array() for axes in drawing.axes]
    assert all((image != 255).any() for image in images)
    assert (np.asarray(images[0]) != np.asarray(images[4])).any()


def test_modes_have_a_scale_in_millimetres(model):
    drawing = modes_figure(model, 0)
    (scale,) = [text.get_text() for axes in drawing.axes for text in axes.texts]
    (bar,) = [line for axes in drawing.axes for line in axes.lines]
    np.testing.assert_allclose(np.ptp(bar.get_xdata()), float(scale.removesuffix(" mm")))


def test_gains_show_interval_and_paper_and_residues_only_where_measured():
    gains = {"conformal": GainPoint(0.2, (0.1, 0.3), 0.67), "euclidean": GainPoint(0.1, None, None)}
    alone = gains_figure(gains, {})
    assert [axes.get_title() for axes in alone.axes] == ["Compactness"]
    ends = [
        np.asarray(path.vertices)[:, 0] for c in alone.axes[0].collections for path in c.get_paths()
    ]
    np.testing.assert_allclose(ends, [[10.0, 30.0]])
    both = gains_figure(gains, {"conformal": Band(np.arange(3.0), np.ones(3), np.ones(3))})
    assert [axes.get_title() for axes in both.axes] == ["Compactness", "Generalisation"]


def test_single_shapes_are_drawn_with_their_titles_and_errors(model):
    drawing = shapes_figure(model, model.mean[None], ["who"])
    assert [axes.get_title() for axes in drawing.axes] == ["who"]
    errors = np.linspace(0.0, 2.0, len(model.mean))[None]
    coloured = shapes_figure(model, model.mean[None], ["who"], errors, 2.0)
    parts, coded = (np.asarray(axes.images[0].get_array()) for axes in coloured.axes[:2])
    assert (parts != coded).any()
    assert coloured.axes[2].get_xlabel() == "mm, left-out error"


def test_a_title_too_long_for_its_panel_is_cut(model):
    drawing = shapes_figure(model, model.mean[None], ["x" * 200])
    assert drawing.axes[0].get_title() == "x" * 27 + "\u2026"


def test_points_are_coloured_from_two_sides_each_with_its_scale(model):
    values = np.linspace(0.0, 1.0, len(model.mean))
    drawing = points_figure(model, [PointColumn("a", values, 1.0), PointColumn("b", values, 9.0)])
    titles = [axes.get_title() for axes in drawing.axes]
    assert [title for title in titles if title] == ["a", "b"]
    images = [np.asarray(axes.images[0].get_array()) for axes in drawing.axes if axes.images]
    assert len(images) == 4
    assert (images[0] != images[2]).any()


def test_surfaces_of_other_meshes_are_drawn_as_read(model):
    mesh = model.mesh
    lower = Surface(model.mean, mesh.faces[mesh.face_part == 0], {})
    upper = Surface(model.mean, mesh.faces[mesh.face_part == 1], {})
    drawing = surfaces_figure([("two", {"A": lower, "B": upper}), ("one", {"A": lower})])
    assert [axes.get_title() for axes in drawing.axes] == ["two", "one"]
    for axes in drawing.axes:
        assert (np.asarray(axes.images[0].get_array()) != 255).any()


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


def test_control_points_inside_and_on_curves_are_counted_apart():
    controlled = replace(
        panel(False), boundary_controls=np.zeros((3, 2)), title="points", says_flips=False
    )
    drawing = map_figure([controlled])
    assert drawing.axes[0].get_title() == "points\n1 inside, 3 on curves"


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
    angles = np.full((3, len(ANGLE_EDGES) - 1), 0.02)
    areas = np.full((3, len(AREA_EDGES) - 1), 0.02)
    drawing = distortion_figure([angles, angles], [areas, areas], ["A", "B"])
    assert [axes.get_title() for axes in drawing.axes] == ["Angles", "Areas"]


def test_the_kink_is_drawn_as_mapped_and_as_warped():
    shares = np.full((3, len(JUMP_EDGES) - 1), 0.025)
    kinks = (np.array([0.9, 1.0, 1.1]), np.array([0.8, 1.0, 1.2]))
    drawing = seam_figure({"A = B": shares}, {"A = B": 0.1}, {"A = B": kinks})
    left, right = drawing.axes
    np.testing.assert_allclose(np.asarray(left.lines[0].get_xdata()), 0.1)
    assert [tick.get_text() for tick in right.get_xticklabels()] == ["mapped", "warped"]
    for line, values in zip(right.lines, kinks, strict=True):
        np.testing.assert_allclose(np.asarray(line.get_ydata()), values)


def test_cycles_are_closed_in_scores_and_volumes():
    times = np.array([0.5, 0.0, 0.25])
    drawing = scores_figure(np.arange(6.0).reshape(3, 2), ["s"] * 3, times, np.array([0.7, 0.3]))
    (line,) = drawing.axes[0].lines
    np.testing.assert_allclose(np.asarray(line.get_xdata()), [2.0, 4.0, 0.0, 2.0])
    ids = [ShapeId("s", str(time), time) for time in times]
    drawing = volumes_figure(volume_curves(ids, {"LV": np.array([3e3, 1e3, 2e3])}))
    (line,) = drawing.axes[0].lines
    np.testing.assert_allclose(np.asarray(line.get_xdata()), [0.0, 0.25, 0.5, 1.0])
    np.testing.assert_allclose(np.asarray(line.get_ydata()), [1.0, 2.0, 3.0, 1.0])


def test_one_mode_alone_is_drawn_on_a_line():
    drawing = scores_figure(np.array([[-1.0], [1.0]]), ["a", "b"], np.zeros(2), np.ones(1))
    assert drawing.axes[0].get_ylabel() == ""
    assert all((np.asarray(line.get_ydata()) == 0.0).all() for line in drawing.axes[0].lines)


def test_names_too_long_for_a_legend_are_cut():
    drawing = scores_figure(np.eye(2), ["x" * 100, "b"], np.zeros(2), np.ones(2) / 2)
    assert [text.get_text() for text in drawing.legends[0].get_texts()] == [
        "x" * 25 + "\u2026",
        "b",
    ]


def test_many_subjects_get_no_legend():
    names = [f"s{i}" for i in range(20)]
    drawing = scores_figure(np.zeros((20, 2)), names, np.zeros(20), np.ones(2) / 2)
    assert drawing.legends == []


def test_convergence_has_a_line_per_level_and_the_terms_add_up():
    terms = [{"length": 9.0, "metric": 0.0}, {"length": 6.0, "metric": 1.0}] * 2
    history = [
        {"level": 2 + n // 2, "seconds": 1.0, "objective": sum(own.values()), "terms": own}
        for n, own in enumerate(terms)
    ]
    left, right = convergence_figure(history).axes
    assert [line.get_label() for line in left.lines] == ["level 2", "level 3"]
    curves = [line for line in right.lines if len(np.asarray(line.get_xdata())) == 2][:4]
    assert [line.get_label() for line in curves[::2]] == ["description length", "metric"]
    total = np.asarray(curves[0].get_ydata()) + np.asarray(curves[2].get_ydata())
    np.testing.assert_allclose(total, [0.0, -2.0])
