"""The pictures of the modes: of all shapes, between subjects, and of the motion."""

import numpy as np
import pytest

from ostiform.model import StoredModel, dynamic_model_of, fit_model, mesh_of_template, project
from ostiform.report import modes_section, viewer_section
from tests.populations import population, two_part_template


@pytest.fixture(scope="module")
def stored():
    shapes = population(3, 4, np.random.default_rng(8), two_part_template(9, 24))
    model = fit_model(shapes.aligned, shapes.weights, mesh_of_template(shapes.template))
    return StoredModel(model, project(model, shapes.aligned), shapes.ids, None)


def test_subjects_with_phases_have_a_mode_between_them_and_one_of_the_motion(stored):
    section = modes_section(stored.model, dynamic_model_of(stored))
    names = [picture.name for picture in section.pictures]
    assert names == ["mode1", "mode2", "mode3", "between1", "motion1"]
    assert section.pictures[-1].caption.startswith("First mode of the motion: ")
    assert "of the variance of the motion" in section.pictures[-1].caption


def test_single_phases_have_the_modes_of_all_shapes_only(stored):
    section = modes_section(stored.model)
    assert [picture.name for picture in section.pictures] == ["mode1", "mode2", "mode3"]


def test_several_parts_have_a_legend(stored):
    figure = modes_section(stored.model).pictures[0].figure
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["LV", "LA"]


def test_a_level_without_variance_has_no_picture_and_no_colours():
    shapes = population(1, 5, np.random.default_rng(8), two_part_template(9, 24))
    model = fit_model(shapes.aligned, shapes.weights, mesh_of_template(shapes.template))
    alone = StoredModel(model, project(model, shapes.aligned), shapes.ids, None)
    dynamic = dynamic_model_of(alone)
    assert [picture.name for picture in modes_section(model, dynamic).pictures][3:] == ["motion1"]
    (points,) = viewer_section(alone, dynamic, None).pictures
    titles = [axes.get_title() for axes in points.figure.axes]
    assert "sd of the motion" in titles
    assert "sd between subjects" not in titles
