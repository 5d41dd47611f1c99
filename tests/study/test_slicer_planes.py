"""Planes exactly as 3D Slicer 5 saves them: one node a file, its name nowhere in the file."""

import json

import numpy as np
import pytest

from ostiform.errors import InputError, TopologyError
from ostiform.study.label_parts import component_meshes
from ostiform.study.labelmaps import LabelMap
from ostiform.study.settings import StudySettings
from ostiform.study.sources import shape_markups
from ostiform.study.study import read_study

PLACES = {"right": [19, 4, 10], "left": [-19, -2, 11], "mitral": [0, 0, -13]}


def plane(center, label="F-1", **more):
    item = {"type": "Plane", "coordinateSystem": "LPS", "center": center, "normal": [0, 0, 1]}
    return json.dumps(
        {"markups": [{**item, "controlPoints": [{"label": label, "position": center}], **more}]}
    )


def study(folder, markups):
    (folder / "p0.vtp").touch()
    (folder / "study.toml").write_text(
        'schema = 1\n[parts.LA]\nostia = ["mitral", "right", "left"]\n[shapes]\n'
        f'pattern = "{{subject}}.vtp"\n[cuts]\nmarkups = "{markups}"\n'
    )
    found = read_study(folder / "study.toml")
    return shape_markups(found.settings, found.entries[0])


@pytest.mark.parametrize("pattern", ["{subject}_*.mrk.json", "{subject}_{ostium}.mrk.json"])
def test_planes_in_several_files_are_named_by_their_files(tmp_path, pattern):
    for name, place in PLACES.items():
        (tmp_path / f"p0_{name}.mrk.json").write_text(plane(place, "right-1"))
    cuts = study(tmp_path, pattern).cuts
    assert {name: cut.center.tolist() for name, cut in cuts.items()} == {
        f"LA.{name}": place for name, place in PLACES.items()
    }


def test_a_plane_in_a_file_of_another_name_is_named_by_its_control_points(tmp_path):
    (tmp_path / "p0.mrk.json").write_text(plane(PLACES["right"], "right-1"))
    assert list(study(tmp_path, "{subject}.mrk.json").cuts) == ["LA.right"]
    (tmp_path / "p0.mrk.json").write_text(plane(PLACES["right"], "P-1"))
    with pytest.raises(InputError, match='found "P": rename the markup or its file'):
        study(tmp_path, "{subject}.mrk.json")


def test_planes_that_are_missing_or_there_twice_are_refused(tmp_path):
    with pytest.raises(InputError, match=r'expected files "p0_\*.mrk.json" of p0'):
        study(tmp_path, "{subject}_*.mrk.json")
    for name in ("p0_right", "p0_new_right"):
        (tmp_path / f"{name}.mrk.json").write_text(plane(PLACES["right"]))
    with pytest.raises(InputError, match="one cut for LA.right, found two"):
        study(tmp_path, "{subject}_*.mrk.json")


def meshes(mask, label_map):
    settings = StudySettings.model_validate(
        {"schema": 1, "parts": {"K": {}}, "shapes": {"pattern": "x"}, "labels": {"edge_mm": 2.0}}
    )
    return component_meshes(settings, {"K": mask}, label_map, {})


def test_two_large_pieces_under_one_label_are_refused_as_meshes_are():
    grid = np.moveaxis(np.indices((40, 24, 24)), 0, -1) - [0, 12, 12]
    first = ((grid - [9, 0, 0]) ** 2).sum(-1) < 49
    for radius, is_kept in ((2, True), (6, False)):
        mask = first | (((grid - [30, 0, 0]) ** 2).sum(-1) < radius**2)
        label_map = LabelMap(mask.astype(np.int64), np.eye(4))
        if is_kept:
            assert "kept the largest of 2 pieces" in meshes(mask, label_map).notes[0]
            continue
        with pytest.raises(TopologyError, match="beside the largest with 40 % of the volume"):
            meshes(mask, label_map)
