"""Images with an axis of time, as nibabel, pynrrd and SimpleITK write them: a phase per frame."""

import nibabel
import nrrd
import numpy as np
import pytest
import SimpleITK

from ostiform.errors import InputError
from ostiform.pipeline.check import UNLABELLED, check_study
from ostiform.study import proposed_study, read_study
from ostiform.study.frames import Frames
from ostiform.study.labelmaps import read_label_map
from ostiform.surface import enclosed_volume
from tests.study.single_shapes import read_shape

STEP = 2.5
SCALES = (1.0, 0.9, 0.75, 0.8, 0.95)
ML = (168.1, 123.5, 70.9, 87.6, 146.4)
"""Of voxels of the ellipsoids of these scales, counted by hand."""

STUDY = 'schema = 1\n[parts.LV]\n[shapes]\npattern = "{subject}.%s"\n'


def ventricle(scale):
    index = np.indices((40, 40, 48)).transpose(1, 2, 3, 0)
    offset = STEP * index - STEP * np.array([40, 40, 48]) / 2.0
    return (((offset / (scale * np.array([30.0, 30.0, 45.0]))) ** 2).sum(-1) < 1.0).astype(np.uint8)


@pytest.fixture(scope="module")
def ventricles():
    return [ventricle(scale) for scale in SCALES]


def nifti(path, frames, step=0.04, unit="sec", start=0.0):
    image = nibabel.Nifti1Image(np.stack(frames, -1), np.diag([-STEP, -STEP, STEP, 1.0]))
    image.header.set_xyzt_units("mm", unit)
    image.header["pixdim"][4], image.header["toffset"] = step, start
    nibabel.save(image, path)


def sequence(path, frames, axis=0, kind="list", **more):
    rows = [[STEP, 0, 0], [0, STEP, 0], [0, 0, STEP]]
    rows.insert(axis, [np.nan] * 3)
    kinds = ["domain"] * 3
    kinds.insert(axis, kind)
    header = {
        "space": "left-posterior-superior",
        "space directions": np.array(rows),
        "kinds": kinds,
        "space origin": np.zeros(3),
        **more,
    }
    nrrd.write(str(path), np.stack(frames, axis), header, index_order="F")


def itk(path, frames, step=40.0, start=0.0):
    image = SimpleITK.JoinSeries(
        [SimpleITK.GetImageFromArray(own.transpose(2, 1, 0)) for own in frames]
    )
    image.SetSpacing((STEP, STEP, STEP, step))
    image.SetOrigin((0.0, 0.0, 0.0, start))
    SimpleITK.WriteImage(image, str(path), True)


SLICER = {"axis 0 index type": "numeric", "axis 0 index values": "0 40 80 120 160"}
WRITERS = {
    "nii.gz": nifti,
    "seq.nrrd": lambda path, frames: sequence(path, frames, **SLICER),
    "nrrd": lambda path, frames: sequence(path, frames, 3),
    "time.nrrd": lambda path, frames: sequence(path, frames, 0, "time"),
    "itk.nrrd": itk,
    "mha": itk,
    "itk.nii.gz": itk,
}


def study(folder, ending, more=""):
    (folder / "study.toml").write_text(STUDY % ending + more)
    return read_study(folder / "study.toml")


@pytest.mark.parametrize("ending", WRITERS)
def test_every_frame_is_a_phase_with_its_own_voxels(tmp_path, ventricles, ending):
    WRITERS[ending](tmp_path / f"p1.{ending}", ventricles)
    found = study(tmp_path, ending)
    assert [str(entry.id) for entry in found.entries] == [f"p1/0{k}" for k in range(5)]
    assert [entry.id.time for entry in found.entries] == [0.0, 0.2, 0.4, 0.6, 0.8]
    for entry, own in zip(found.entries, ventricles, strict=True):
        image = read_label_map(entry.files["LV"], entry.frame)
        np.testing.assert_array_equal(image.labels, own)
        np.testing.assert_allclose(image.affine, np.diag([STEP, STEP, STEP, 1.0]), atol=1e-12)


def test_volumes_are_those_of_the_frames(tmp_path, ventricles):
    nifti(tmp_path / "p1.nii.gz", ventricles)
    found = study(tmp_path, "nii.gz", "[labels]\nedge_mm = 6\n")
    surfaces = [read_shape(found, entry).parts["LV"] for entry in found.entries]
    volumes = [enclosed_volume(s.vertices, s.faces) / 1000.0 for s in surfaces]
    np.testing.assert_allclose(volumes, ML, rtol=0.01)


def times(found, subject="p1"):
    return {e.id.phase: e.id.time for e in found.entries if e.id.subject == subject}


SMALL = [np.ones((3, 3, 3), np.uint8)] * 4


def test_the_cycle_has_the_length_that_is_stated(tmp_path):
    nifti(tmp_path / "p1.nii.gz", SMALL, 40.0, "msec")
    found = study(tmp_path, "nii.gz", "[cycle]\nlength_s = 0.8\n")
    assert times(found) == {"00": 0.0, "01": 0.05, "02": 0.1, "03": 0.15}
    with pytest.raises(InputError, match="within the cycle of 0.1 s, found the last at 0.12 s"):
        study(tmp_path, "nii.gz", "[cycle]\nlength_s = 0.1\n")
    (tmp_path / "sheet.csv").write_text("subject,file,heart_rate_bpm\np1,p1.nii.gz,60\n")
    (tmp_path / "b.toml").write_text('schema = 1\n[parts.LV]\n[shapes]\nsheet = "sheet.csv"\n')
    assert times(read_study(tmp_path / "b.toml"))["03"] == pytest.approx(0.12)


def test_missing_first_frames_leave_their_times_to_others(tmp_path):
    nifti(tmp_path / "p1.nii.gz", SMALL)
    nifti(tmp_path / "p2.nii.gz", SMALL[:3], start=0.04)
    found = study(tmp_path, "nii.gz")
    assert times(found) == {"00": 0.0, "01": 0.25, "02": 0.5, "03": 0.75}
    assert times(found, "p2") == {"01": 0.25, "02": 0.5, "03": 0.75}
    assert "lacks the phase 00 that others have" in found.entries[-1].notes[0]


def test_times_between_the_steps_and_spacings_count(tmp_path):
    sequence(tmp_path / "p1.nrrd", SMALL, **{**SLICER, "axis 0 index values": "0 30 80 120"})
    assert list(times(study(tmp_path, "nrrd")).values()) == [0.0, 0.1875, 0.5, 0.75]
    sequence(
        tmp_path / "p1.nrrd",
        SMALL,
        spacings=[40.0, np.nan, np.nan, np.nan],
        units=["ms", "", "", ""],
        **{"axis mins": [20.0, np.nan, np.nan, np.nan]},
    )
    found = study(tmp_path, "nrrd", "[cycle]\nlength_s = 0.8\n")
    assert list(times(found).values()) == pytest.approx([0.025, 0.075, 0.125, 0.175])


@pytest.mark.parametrize("listed", ["0 40 80", "0 40 40 80", "0 80 40 120"])
def test_wrong_lists_of_times_are_refused_with_the_shape(tmp_path, listed):
    sequence(tmp_path / "p1.nrrd", SMALL, **{**SLICER, "axis 0 index values": listed})
    with pytest.raises(InputError, match="4 increasing times of the frames"):
        read_label_map(tmp_path / "p1.nrrd", 0)


def test_other_axes_than_time_are_refused(tmp_path):
    sequence(tmp_path / "p1.nrrd", SMALL, 0, "4-vector")
    with pytest.raises(InputError, match="one of time, found 4 axes of kinds 4-vector"):
        read_label_map(tmp_path / "p1.nrrd", 0)
    nifti(tmp_path / "p1.nii", SMALL, unit="hz")
    with pytest.raises(InputError, match="found sizes 3x3x3x4 in hz"):
        read_label_map(tmp_path / "p1.nii")


def test_frames_where_the_phase_is_stated_are_refused_with_what_to_do(tmp_path):
    nifti(tmp_path / "p1_ED.nii", SMALL)
    (tmp_path / "a.toml").write_text((STUDY % "nii").replace("subject}", "subject}_{phase}"))
    found = read_study(tmp_path / "a.toml")
    with pytest.raises(InputError, match=r"p1/ED.*4 frames: for one phase per frame leave {phase}"):
        read_shape(found, found.entries[0])


def test_files_of_a_shape_need_as_many_frames(tmp_path):
    nifti(tmp_path / "p1_LV.nii", SMALL)
    nifti(tmp_path / "p1_LA.nii", SMALL[:3])
    text = (STUDY % "nii").replace("subject}", "subject}_{part}").replace("LV]", "LV]\n[parts.LA]")
    (tmp_path / "a.toml").write_text(text)
    with pytest.raises(InputError, match=r"found 3 in p1_LA.nii, 4 in p1_LV.nii"):
        read_study(tmp_path / "a.toml")


def test_a_study_is_proposed_for_files_with_frames(tmp_path, ventricles):
    for name in ("p1", "p2"):
        nifti(tmp_path / f"{name}.nii.gz", ventricles)
    (tmp_path / "study.toml").write_text(proposed_study(tmp_path, tmp_path / "study.toml"))
    found = read_study(tmp_path / "study.toml")
    assert [str(e.id) for e in found.entries] == [f"p{s}/0{k}" for s in (1, 2) for k in range(5)]


def test_frames_that_nobody_segmented_are_left_out_and_told(tmp_path, ventricles):
    empty = np.zeros_like(ventricles[0])
    for name, own in (("p1", [ventricles[0], empty, ventricles[2], empty]), ("p2", ventricles[:4])):
        nifti(tmp_path / f"{name}.nii.gz", own)
    (tmp_path / "study.toml").write_text(STUDY % "nii.gz")
    checks = check_study(tmp_path / "study.toml")
    left_out = {str(c.id): c.repairs for c in checks if c.is_excluded}
    assert left_out == dict.fromkeys(("p1/01", "p1/03"), (UNLABELLED,))
    assert all(c.problem is None for c in checks)
    assert {str(c.id): c.id.time for c in checks}["p1/02"] == pytest.approx(0.5)
    nifti(tmp_path / "p1.nii.gz", [empty] * 4)
    problems = [c.problem for c in check_study(tmp_path / "study.toml") if c.problem]
    assert problems == ["shape p1/00: expected a label in some frame, found none in 4"]


@pytest.mark.parametrize("count", [0, 1])
def test_an_axis_of_time_without_frames_is_refused(tmp_path, count):
    with pytest.raises(InputError, match=f"expected two or more frames along time, found {count}"):
        Frames(3, np.zeros(count), None)
    sequence(tmp_path / "p1.nrrd", SMALL, 3, "time")
    text = (tmp_path / "p1.nrrd").read_bytes().replace(b"sizes: 3 3 3 4", b"sizes: 3 3 3 0")
    (tmp_path / "p1.nrrd").write_bytes(text)
    with pytest.raises(InputError, match=r"p1.nrrd"):
        read_label_map(tmp_path / "p1.nrrd")
