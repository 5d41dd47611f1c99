"""Landmarks that a study states: read in its units and frame, part of what a result depends on."""

import json

import numpy as np
import pytest

from ostiform.errors import InputError
from ostiform.pipeline.landmarks import landmark_inputs, stated_marks
from ostiform.study import read_study

STUDY = """
schema = 1
units = "cm"
frame = "RAS"
[parts.LV]
ostia = ["mitral"]
[shapes]
pattern = "{subject}_{phase}.vtp"
"""


def study_with(tmp_path, landmarks):
    for name in ("p1_ed", "p1_es"):
        (tmp_path / f"{name}.vtp").touch()
    (tmp_path / "study.toml").write_text(STUDY + landmarks)
    study = read_study(tmp_path / "study.toml")
    return study, [entry.id for entry in study.entries]


def write(path, uncertainty=None):
    item = {"id": "apex", "coordinates": [1.0, 2.0, 3.0]}
    if uncertainty is not None:
        item["uncertainty"] = uncertainty
    path.write_text(json.dumps([item]))


def test_landmarks_become_millimetres_in_lps_and_shapes_may_lack_them(tmp_path):
    write(tmp_path / "p1_ed.json")
    study, ids = study_with(tmp_path, '[landmarks]\nfile = "{subject}_{phase}.json"\nsd_mm = 1.5\n')
    first, second = stated_marks(study, ids)
    assert first.names == ("apex",)
    np.testing.assert_allclose(first.positions, [[-10.0, -20.0, 30.0]])
    np.testing.assert_allclose(first.sd_mm, [1.5])
    assert second is None


def test_a_stated_uncertainty_counts_in_the_units_of_the_files(tmp_path):
    deviations = {"stddevs": [0.3, 0.2, 0.1], "pcvectors": np.eye(3).tolist()}
    write(tmp_path / "p1_ed.json", deviations)
    study, ids = study_with(tmp_path, '[landmarks]\nfile = "{subject}_{phase}.json"\n')
    marks = stated_marks(study, ids)[0]
    np.testing.assert_allclose(marks.sd_mm, [10.0 * np.sqrt((0.09 + 0.04 + 0.01) / 3.0)])


def test_a_changed_landmark_changes_what_the_result_depends_on(tmp_path):
    write(tmp_path / "p1_ed.json")
    study, ids = study_with(tmp_path, '[landmarks]\nfile = "{subject}_{phase}.json"\n')
    before = landmark_inputs(study, ids)
    (tmp_path / "p1_ed.json").write_text('[{"id": "apex", "coordinates": [1, 2, 4]}]')
    assert landmark_inputs(study, ids) != before


def test_a_study_without_landmarks_has_none_and_depends_on_none(tmp_path):
    study, ids = study_with(tmp_path, "")
    assert stated_marks(study, ids) == (None, None)
    assert landmark_inputs(study, ids) == []


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('file = "{subject}.json"', "expected the landmarks of some shape at"),
        ('file = "{part}.json"', r"expected the fields \{subject\} and \{phase\}"),
    ],
)
def test_landmarks_that_cannot_be_found_are_refused(tmp_path, text, message):
    study, ids = study_with(tmp_path, f"[landmarks]\n{text}\n")
    with pytest.raises(InputError, match=message):
        stated_marks(study, ids)
