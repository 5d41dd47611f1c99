"""Guide points of biventricular fitting tools, column by column."""

import numpy as np
import pytest

from ostiform.errors import InputError
from ostiform.fitting.guide_points import (
    guide_contours,
    is_guide_point_file,
    read_guide_points,
)

HEAD = "x\ty\tz\tcontour type\tframeID\tweight\ttime frame\n"
ROWS = (
    "1.00000\t2.00000\t3.00000\tSAX_LV_ENDOCARDIAL\t4\t1.0\t0\n"
    "9.00000\t2.00000\t3.00000\tSAX_LV_ENDOCARDIAL\t4\t1.0\t0\n"
    "5.00000\t2.00000\t3.00000\tSAX_RV_SEPTUM\t4\t1.0\t0\n"
    "6.33182\t39.11732\t-15.96727\tMITRAL_VALVE\t7\t1.0\t0\n"
    "7.00000\t2.00000\t3.00000\tSAX_LV_ENDOCARDIAL\t5\t0.0\t3\n"
    "8.00000\t2.00000\t3.00000\tSAX_LV_ENDOCARDIAL\t5\t1.0\t3\n"
)
OPENINGS = ("LV.mitral", "LV.aortic")


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "GPFile_000.txt"
    path.write_text(HEAD + ROWS)
    return path


def test_slices_frames_and_types_are_read(file):
    found = read_guide_points(file)
    assert is_guide_point_file(file)
    assert found.slices == ("4", "4", "4", "7", "5")
    assert found.frames.tolist() == [0, 0, 0, 0, 3]
    assert found.types[3] == "MITRAL_VALVE"
    np.testing.assert_array_equal(found.positions[3], [6.33182, 39.11732, -15.96727])


def test_points_belong_to_parts_and_openings_of_the_model(file):
    found = read_guide_points(file)
    contours, unknown = guide_contours(found, np.arange(4), ("LV",), OPENINGS)
    assert unknown == ("SAX_RV_SEPTUM",)
    wall, valve = contours
    assert (wall.slice, wall.part, wall.opening) == ("slice 4", "LV", None)
    assert len(np.concatenate(wall.curves)) == 2
    assert (valve.slice, valve.part, valve.opening) == ("slice 7", "LV", "LV.mitral")


@pytest.mark.parametrize("name", ["slice", "sliceID", "frameID"])
def test_the_slice_has_several_names(tmp_path, name):
    path = tmp_path / "g.txt"
    path.write_text(HEAD.replace("frameID", name) + ROWS)
    assert read_guide_points(path).slices[0] == "4"


def test_a_column_frame_is_the_slice_where_its_points_are_flat(tmp_path):
    ring = np.linspace(0.0, 6.0, 12)
    flat = [(10 * np.cos(t), 10 * np.sin(t), z) for z in (0.0, 8.0) for t in ring]
    body = [(x, y, z + 5.0 * np.sin(3.0 * k)) for k, (x, y, z) in enumerate(flat)]
    for points, is_slice in ((flat, True), (body, False)):
        path = tmp_path / f"{is_slice}.txt"
        rows = (
            f"{x}\t{y}\t{z}\tSAX_LV_ENDOCARDIAL\t{k // 12}\t1\n"
            for k, (x, y, z) in enumerate(points)
        )
        path.write_text("x\ty\tz\tcontour type\tframe\tweight\n" + "".join(rows))
        found = read_guide_points(path)
        assert (found.slices[-1] == "1") is True
        assert (found.frames[-1] == 1) is not is_slice


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("x\ty\tz\tkind\n1\t2\t3\tA\n", "expected a first line with the columns x, y, z"),
        (HEAD + "1\t2\t3\tMITRAL_VALVE\t1\n", "line 2: expected 7 columns"),
        (HEAD + "a\t2\t3\tMITRAL_VALVE\t1\t1\t0\n", "line 2: expected numbers"),
        (HEAD, "expected guide points, found none"),
    ],
)
def test_damage_is_one_sentence(tmp_path, text, sentence):
    path = tmp_path / "g.txt"
    path.write_text(text)
    with pytest.raises(InputError, match=sentence):
        read_guide_points(path)
