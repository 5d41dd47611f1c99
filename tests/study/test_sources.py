import json

import nibabel
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ostiform.errors import InputError
from ostiform.study import read_study
from ostiform.study.markups import curve_cut, cut_heights, plane_cut, read_markups
from ostiform.study.naming import loop_facts
from ostiform.study.reading import survey_shape
from ostiform.surface import (
    boundary_loops,
    enclosed_volume,
    welded_components,
    write_surface,
)
from tests.oracles.holed_spheres import holed_sphere, sphere_with_circles
from tests.oracles.label_volumes import posed_grid, voxel_centers
from tests.study.single_shapes import read_shape

TO_RAS = np.diag([-1.0, -1.0, 1.0, 1.0])
HEART = """
schema = 1
[parts.LV]
ostia = ["mitral", "aortic"]
[parts.LA]
ostia = ["mitral", "vein"]
[[seams]]
first = "LV.mitral"
second = "LA.mitral"
[shapes]
pattern = "{subject}.EXT"
"""


def study_of(folder, text):
    path = folder / "study.toml"
    path.write_text(text, encoding="utf-8")
    study = read_study(path)
    return study, study.entries[0]


def heart_labels(spacing, rng, turned=True):
    """LV (1) and LA (2), two ellipsoids that meet in the plane z = 0, with a tube each."""
    turn = Rotation.random(rng=rng).as_matrix() if turned else np.eye(3)
    size, affine, center = posed_grid(spacing, 150.0, rng, turned)
    points = (voxel_centers(size, affine) - center) @ turn
    x, y, z = points.T
    lower = ((x / 25) ** 2 + (y / 25) ** 2 + ((z + 25) / 35) ** 2 < 1) & (z < 0)
    upper = ((x / 28) ** 2 + (y / 24) ** 2 + ((z - 15) / 22) ** 2 < 1) & (z >= 0)
    aorta = (np.hypot(y, z + 25) < 9) & (x > 0) & (x < 42)
    vein = (np.hypot(y, z - 18) < 7) & (x < 0) & (x > -45)
    labels = np.where(upper | vein, 2, np.where(lower | aorta, 1, 0)).reshape(size)
    return labels.astype(np.uint8), affine, center, turn


def test_touching_labels_become_parts_with_one_common_annulus_and_open_tubes(tmp_path, rng):
    labels, affine, center, turn = heart_labels((1.5, 1.5, 1.5), rng)
    nibabel.save(nibabel.Nifti1Image(labels, TO_RAS @ affine), tmp_path / "a.nii.gz")
    ends = {"LV.aortic": [36.0, 0, -25], "LA.vein": [-40.0, 0, 18]}
    normal = (turn @ [1.0, 0, 0]).tolist()
    planes = "\n".join(
        f'"{name}" = {{center = {(center + turn @ point).tolist()}, normal = {normal}}}'
        for name, point in ends.items()
    )
    text = HEART.replace("EXT", "nii.gz") + "[labels]\nedge_mm = 3.0\nvalues = {LV = 1, LA = 2}\n"
    study, entry = study_of(tmp_path, f"{text}[cuts.planes]\n{planes}\n")
    shape = read_shape(study, entry)
    rims = [shape.parts[part].vertices[shape.parts[part].loops["mitral"]] for part in ("LV", "LA")]
    assert {tuple(p) for p in rims[0].tolist()} == {tuple(p) for p in rims[1].tolist()}
    height = (rims[0] - center) @ turn[:, 2]
    assert np.abs(height).max() < 1.5
    assert abs(height.mean()) < 0.5
    for name, point in ends.items():
        part, ostium = name.split(".")
        surface = shape.parts[part]
        rim = (surface.vertices[surface.loops[ostium]] - center) @ turn
        np.testing.assert_allclose(rim[:, 0], point[0], atol=1e-6)
        middle = loop_facts(rim, np.arange(len(rim))).center
        np.testing.assert_allclose(middle, point, atol=0.5)
    (component,) = welded_components(shape.parts, shape.seams)
    assert len(boundary_loops(component.faces)) == 2
    edges = np.linalg.norm(
        component.vertices[component.faces] - component.vertices[np.roll(component.faces, 1, 1)],
        axis=2,
    )
    assert np.median(edges) == pytest.approx(3.0, rel=0.15)


def test_a_mitral_plane_divides_labels_that_touch(tmp_path, rng):
    labels, affine, center, turn = heart_labels((2.0, 2.0, 2.0), rng)
    nibabel.save(nibabel.Nifti1Image(labels, TO_RAS @ affine), tmp_path / "a.nii.gz")
    normal = turn @ [0.0, 0.1, 1.0]
    at = center + turn @ [0.0, 0, -2.0]
    text = HEART.replace("EXT", "nii.gz").replace(', "aortic"', "").replace(', "vein"', "")
    text += "[labels]\nedge_mm = 3.0\nvalues = {LV = 1, LA = 2}\n"
    text += f'[cuts.planes]\n"LV.mitral" = {{center = {at.tolist()}, normal = {normal.tolist()}}}\n'
    shape = read_shape(*study_of(tmp_path, text))
    for part in ("LV", "LA"):
        rim = shape.parts[part].vertices[shape.parts[part].loops["mitral"]]
        assert np.abs((rim - at) @ normal).max() < 0.3
    (component,) = welded_components(shape.parts, shape.seams)
    assert boundary_loops(component.faces) == ()


def test_labels_that_do_not_touch_are_refused(tmp_path, rng):
    labels, affine, _, _ = heart_labels((2.5, 2.5, 2.5), rng, turned=False)
    apart = labels.copy()
    # A gap of empty slices between the two.
    z = (np.indices(labels.shape)[2] + 0.0)[labels == 2].min()
    apart[:, :, int(z) : int(z) + 3] = 0
    nibabel.save(nibabel.Nifti1Image(apart, TO_RAS @ affine), tmp_path / "a.nii.gz")
    text = HEART.replace("EXT", "nii.gz") + "[labels]\nvalues = {LV = 1, LA = 2}\n"
    study, entry = study_of(tmp_path, text)
    with pytest.raises(InputError, match="LV and LA to touch for the seam .* more than 3 mm apart"):
        read_shape(study, entry)


def test_one_file_per_part_and_a_missing_label(tmp_path, rng):
    labels, affine, _, _ = heart_labels((2.5, 2.5, 2.5), rng)
    nibabel.save(
        nibabel.Nifti1Image((labels == 1).astype(np.uint8), TO_RAS @ affine), tmp_path / "a.nii"
    )
    text = 'schema = 1\n[parts.LV]\nostia = []\n[shapes]\npattern = "{subject}.nii"\n'
    study, entry = study_of(tmp_path, text)
    shape = read_shape(study, entry)
    volume = enclosed_volume(shape.parts["LV"].vertices, shape.parts["LV"].faces)
    assert volume == pytest.approx((labels == 1).sum() * 2.5**3, rel=0.01)
    study, entry = study_of(tmp_path, text + "[labels]\nvalues = {LV = 7}\n")
    with pytest.raises(InputError, match=r"voxels of \[7\] for the part LV, found the labels 0, 1"):
        read_shape(study, entry)


@pytest.mark.parametrize("kind", ["cell_data", "point_data"])
def test_one_labelled_mesh_is_split_into_parts_with_a_seam(tmp_path, kind):
    axis = (0.0, 0.0, 1.0)
    holes = [((0.6, 0, 0.8), 0.2, 14), ((0.6, 0, -0.8), 0.25, 16)]
    vertices, faces = holed_sphere(800, holes, [(axis, np.pi / 2, 40)])
    if kind == "cell_data":
        data = {"part": np.where(vertices[faces].mean(axis=1)[:, 2] > 0, 2, 1)}
    else:
        data = {"part": np.where(vertices[:, 2] > 0.01, 2, 1)}
    write_surface(tmp_path / "a.vtp", 40 * vertices, faces, **{kind: data})
    split = 'split = {array = "part", LV = 1, LA = [2, 5]}\n'
    study, entry = study_of(tmp_path, HEART.replace("EXT", "vtp") + split)
    shape = read_shape(study, entry)
    assert {n: len(l) for n, l in shape.parts["LA"].loops.items()} == {
        "mitral": 40,
        "vein": 14,
    } or (kind == "point_data")
    (component,) = welded_components(shape.parts, shape.seams)
    assert len(component.vertices) == len(vertices)
    assert len(component.faces) == len(faces)
    wrong = HEART.replace("EXT", "vtp") + split.replace("LV = 1", "LV = 9")
    study, entry = study_of(tmp_path, wrong)
    with pytest.raises(InputError, match="triangles of value 9 in part for the part LV, found"):
        read_shape(study, entry)


def test_caps_may_be_marked_at_points(tmp_path):
    holes = [((0, 0, 1), 0.5, 30), ((1, 0, 0), 0.3, 20)]
    vertices, faces, circles = sphere_with_circles(600, holes)
    label = np.ones(len(vertices))
    for (center, radius, _), circle, value in zip(holes, circles, (3, 7), strict=True):
        label[np.arccos(np.clip(vertices @ np.array(center, float), -1, 1)) < radius] = value
        label[circle] = value
    write_surface(tmp_path / "a.vtp", 40 * vertices, faces, {"label": label})
    text = """
schema = 1
[parts.LA]
ostia = ["mitral", "vein"]
[shapes]
pattern = "{subject}.vtp"
open = {array = "label", mitral = 3, vein = 7}
"""
    shape = read_shape(*study_of(tmp_path, text))
    assert {name: len(loop) for name, loop in shape.parts["LA"].loops.items()} == {
        "mitral": 30,
        "vein": 20,
    }


def markups(system, sign):
    plane = {
        "type": "Plane",
        "name": "mitral",
        "coordinateSystem": system,
        "coordinateUnits": "mm",
        "planeType": "pointNormal",
        "baseToNode": [1, 0, 0, 0, 0, 0, -1, 0, 0, 1, 0, 0, 0, 0, 0, 1],
        "planeBounds": [-30, 30, -30, 30],
        "controlPoints": [{"position": [0, 25 * sign, 0]}],
    }
    turn = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    curve = np.c_[np.full(24, 30.0), 15 * np.cos(turn), 15 * np.sin(turn)]
    curve[:, 0] += 1.5 * np.cos(2 * turn)  # a saddle
    curve *= [sign, sign, 1]
    controls = [{"label": f"c-{k}", "position": p} for k, p in enumerate(curve.tolist())]
    closed = {
        "type": "ClosedCurve",
        "name": "LA.vein",
        "coordinateSystem": system,
        "controlPoints": controls,
    }
    points = {
        "type": "Fiducial",
        "coordinateSystem": system,
        "controlPoints": [{"label": "LA.x", "position": [sign, 2 * sign, 3]}],
    }
    return {"markups": [plane, closed, points]}


@pytest.mark.parametrize(("system", "sign"), [("LPS", 1), ("RAS", -1)])
def test_slicer_planes_and_curves_open_a_closed_surface(tmp_path, system, sign):
    vertices, faces = holed_sphere(1500, [])
    write_surface(tmp_path / "a.vtp", 35 * vertices, faces)
    (tmp_path / "a.mrk.json").write_text(json.dumps(markups(system, sign)), encoding="utf-8")
    text = """
schema = 1
[parts.LA]
ostia = ["mitral", "vein"]
[shapes]
pattern = "{subject}.vtp"
[cuts]
markups = "{subject}.mrk.json"
"""
    study, entry = study_of(tmp_path, text)
    surface = read_shape(study, entry).parts["LA"]
    np.testing.assert_allclose(surface.vertices[surface.loops["mitral"], 1], 25.0, atol=1e-9)
    rim = surface.vertices[surface.loops["vein"]]
    angle = np.arctan2(rim[:, 2], rim[:, 1])
    # The curve of 24 points is followed to the sagitta of its chords.
    np.testing.assert_allclose(rim[:, 0], 30 + 1.5 * np.cos(2 * angle), atol=0.15)
    survey = survey_shape(study, entry)
    assert set(survey.parts["LA"].known) == {"mitral", "vein"}
    renamed = text.replace('"vein"]', '"other"]')
    with pytest.raises(InputError, match='cuts named by an ostium .*, found "LA.vein"'):
        read_shape(*study_of(tmp_path, renamed))


def test_points_of_markups_are_read(tmp_path):
    (tmp_path / "a.mrk.json").write_text(json.dumps(markups("RAS", -1)), encoding="utf-8")
    found = read_markups(tmp_path / "a.mrk.json")
    np.testing.assert_allclose(found.points["LA.x"], [1, 2, 3])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: m["markups"][0].pop("coordinateSystem"), 'expected coordinateSystem "LPS"'),
        (lambda m: m["markups"][0].update(type="ROI"), "expected a Plane, ClosedCurve or Fiducial"),
        (lambda m: m["markups"][0].update(controlPoints=[]), "expected a control point or centre"),
        (
            lambda m: m["markups"][1].update(controlPoints=[{"position": [0, 0, 0]}]),
            "three or more",
        ),
        (lambda m: m["markups"][0].update(coordinateUnits="ft"), "coordinateUnits mm, .* found ft"),
        (lambda m: m["markups"][1]["controlPoints"][0].update(position=["a"]), "Markups schema"),
        (lambda m: m.update(markups=3), "expected a list of markups"),
        (lambda m: m.pop("markups"), "expected 3D Slicer Markups"),
    ],
)
def test_markups_that_cannot_be_used_are_refused(tmp_path, change, message):
    content = markups("LPS", 1)
    change(content)
    (tmp_path / "a.mrk.json").write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(InputError, match=message):
        read_markups(tmp_path / "a.mrk.json")


def test_centre_and_normal_and_three_points_define_the_same_plane(tmp_path):
    base = {"type": "Plane", "name": "p", "coordinateSystem": "LPS"}
    one = {**base, "center": [1, 2, 3], "normal": [0, 0, 2]}
    corners = [[0, 2, 3], [2, 2, 3], [1, 5, 3]]
    two = {**base, "controlPoints": [{"position": p} for p in corners]}
    for item in (one, two):
        (tmp_path / "a.json").write_text(json.dumps({"markups": [item]}), encoding="utf-8")
        cut = read_markups(tmp_path / "a.json").cuts["p"]
        np.testing.assert_allclose(np.abs(cut.normal), [0, 0, 1], atol=1e-12)
        assert cut.center[2] == 3.0


def test_heights_over_a_planar_curve_are_those_over_its_plane(rng):
    turn = np.linspace(0, 2 * np.pi, 30, endpoint=False)
    curve = np.c_[np.cos(turn), np.sin(turn), np.zeros(30)]
    points = rng.normal(size=(50, 3))
    plane = plane_cut(np.zeros(3), np.array([0.0, 0, 1]))
    assert (
        np.abs(
            np.abs(cut_heights(curve_cut(curve), points)) - np.abs(cut_heights(plane, points))
        ).max()
        < 1e-9
    )
