"""Maps of an effect: where it was planted they are coloured, elsewhere grey."""

import numpy as np
import pytest

from ostiform.model import StoredModel, fit_model, mesh_of_template, project
from ostiform.report.effects import effect_figure, effect_page, null_figure
from ostiform.report.html import render_page
from ostiform.report.shading import ALL_ROUND
from ostiform.statistics import EffectSettings, covariate_of, shape_effect, subject_shapes
from tests.populations import population


@pytest.fixture(scope="module")
def found():
    shapes = population(12, 1, np.random.default_rng(5))
    aligned = np.array(shapes.aligned)
    aligned[::2, shapes.template.points[:, 2] > 0.5] *= 1.5
    model = fit_model(aligned, shapes.weights, mesh_of_template(shapes.template))
    stored = StoredModel(model, project(model, aligned), shapes.ids, shapes.template)
    group = covariate_of("group <b>", list("ab" * 6))
    settings = EffectSettings(permutations=299)
    return model, shape_effect(model, subject_shapes(stored), group, (), settings)


def test_a_figure_has_three_maps_from_four_sides_and_their_scales(found):
    figure = effect_figure(*found)
    titles = [axes.get_title() for axes in figure.axes if axes.get_title()]
    assert titles == [view.name for view in ALL_ROUND]
    assert len(figure.axes) == 3 * (4 + 1)


def test_points_that_were_not_found_are_grey(found):
    model, effect = found
    assert (effect.points.q_value <= 0.05).any()
    picture = effect_figure(model, effect).axes[0].images[0].get_array().astype(float)
    spread = picture.max(axis=2) - picture.min(axis=2)
    shown = picture.min(axis=2) < 250.0
    assert (spread[shown] > 60.0).any()  # coloured
    assert (spread[shown] < 25.0).mean() > 0.2  # grey


def test_the_page_says_what_was_found_and_escapes_names(found):
    page = effect_page(*found, "12 subjects", ["A note."], ["A warning."])  # type: ignore[call-arg]
    text = render_page(page)
    assert "group &lt;b&gt;" in text
    assert "group <b>" not in text
    assert "A warning." in text
    assert f"{found[1].whole.p_value:.4f}" in text


def test_the_null_figure_marks_the_data(found):
    test = found[1].whole
    axes = null_figure(test).axes[0]
    np.testing.assert_allclose(np.asarray(axes.lines[0].get_xdata()), test.statistic)
