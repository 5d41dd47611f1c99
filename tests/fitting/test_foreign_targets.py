"""Points and landmarks as other programs write them."""

import json

import numpy as np
import pytest

from ostiform.errors import InputError
from ostiform.fitting.files import FileRules, read_named_points, read_targets
from ostiform.fitting.types import CloudTarget, LandmarkTarget

PLACES = np.array([[1.25, -2.5, 3.75], [4.5, 5.0, -6.0], [7.0, 8.5, 9.0]])


def target(path, text, **rules):
    path.write_text(text, encoding="utf-8")
    (found,) = read_targets([str(path)], ["LA"], FileRules(**rules))
    return found


def rows(line):
    return "\n".join(line.format(k, *map(float, p)) for k, p in enumerate(PLACES)) + "\n"


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("index.csv", ",x,y,z\n" + rows("{},{},{},{}")),
        ("more.csv", "x,y,z,voltage\r\n" + rows("{1},{2},{3},0.{0}")),
        ("german.csv", "x;y;z\n" + rows("{1};{2};{3}").replace(".", ",")),
        ("bom.csv", "\ufeffX,Y,Z\n" + rows("{1},{2},{3}")),
        ("plain.xyz", rows("{1} {2} {3}")),
        ("cloud.obj", rows("v {1} {2} {3}")),
        ("cloud.off", "OFF\n3 0 0\n" + rows("{1} {2} {3}")),
        ("carp.pts", "3\n" + "\n".join(" ".join(map(repr, p)) for p in (1e3 * PLACES).tolist())),
    ],
)
def test_clouds_of_any_program_are_points(tmp_path, name, text):
    found = target(tmp_path / name, text)
    assert isinstance(found, CloudTarget)
    np.testing.assert_allclose(found.points, PLACES, rtol=1e-12)


def test_points_in_micrometres_are_told_by_their_unit(tmp_path):
    found = target(tmp_path / "a.xyz", rows("{1} {2} {3}"), units="um")
    np.testing.assert_allclose(found.points, 0.001 * PLACES)


def test_a_column_of_names_is_found_by_its_heading(tmp_path):
    found = target(tmp_path / "a.csv", "id,z,y,x,label\n" + rows("7,{3},{2},{1},LA.{0}"))
    assert isinstance(found, LandmarkTarget)
    assert found.labels == ("LA.0", "LA.1", "LA.2")
    np.testing.assert_array_equal(found.positions, PLACES)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (rows("{1} {2} {3} 0.5"), "found four numbers each: keep three columns, name"),
        (rows("{1} {2} {3} 0 0 1"), "rows of 6 columns: keep those columns, or name them"),
        ("x,y,z\n1,2,3\n4,5\n", "line 3: expected 3 columns as in the first row"),
    ],
)
def test_columns_without_a_meaning_are_refused_with_what_to_do(tmp_path, text, message):
    with pytest.raises(InputError, match=message):
        target(tmp_path / "a.xyz", text)


def control(label, place, status="defined"):
    position = None if place is None else list(place)
    return {"label": label, "position": position, "positionStatus": status}


def markups(controls, **more):
    item = {"type": "Fiducial", "coordinateSystem": "LPS", "controlPoints": controls, **more}
    return json.dumps({"markups": [item]})


def test_a_skipped_control_point_takes_its_label_with_it(tmp_path):
    controls = [control("apex", None, "undefined"), control("gone", (0.0, 0.0, 0.0), "missing")]
    controls += [control(name, place) for name, place in zip("abc", PLACES.tolist(), strict=True)]
    found = target(tmp_path / "a.mrk.json", markups(controls))
    assert found.labels == ("a", "b", "c")
    np.testing.assert_array_equal(found.positions, PLACES)
    with pytest.raises(InputError, match='every label once, found "a" twice'):
        target(tmp_path / "b.mrk.json", markups([control("a", (0, 0, 0)), control("a", (1, 0, 0))]))


@pytest.mark.parametrize(("system", "sign"), [("0", -1.0), ("RAS", -1.0), ("1", 1.0), ("LPS", 1.0)])
def test_the_former_list_of_points_is_read_in_its_frame(tmp_path, system, sign):
    head = (
        f"# Markups fiducial file version = 4.10\n# CoordinateSystem = {system}\n"
        "# columns = id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID\n"
    )
    text = head + rows('n_{0},{1},{2},{3},0,0,0,1,1,1,0,"LA, {0}",,')
    (tmp_path / "a.fcsv").write_text(text)
    names, places = read_named_points(tmp_path / "a.fcsv", FileRules())
    assert names == ("LA, 0", "LA, 1", "LA, 2")
    np.testing.assert_array_equal(places, PLACES * [sign, sign, 1.0])
    with pytest.raises(InputError, match='found "": save it with one'):
        target(tmp_path / "b.fcsv", text.replace("CoordinateSystem", "System"))
