"""Label maps as public programs write them, and the parts that are proposed for them."""

import nibabel
import numpy as np
import pytest

from ostiform.errors import InputError
from ostiform.study import named_population, proposed_study, read_study, survey_shape
from ostiform.study.label_schemes import chamber, label_parts, valve
from ostiform.study.labelmaps import LabelMap

SHAPE = (30, 26, 34)
CENTRES = np.stack(np.meshgrid(*[2.0 * np.arange(n) for n in SHAPE], indexing="ij"), axis=-1)


def ball(center, radius):
    return ((CENTRES - center) ** 2).sum(axis=-1) < radius**2


def saved(path, labels):
    path.parent.mkdir(parents=True, exist_ok=True)
    nibabel.save(nibabel.Nifti1Image(labels.astype(np.uint8 if labels.max() < 256 else np.int16),
                                     np.diag([-2.0, -2.0, 2.0, 1.0])), path)  # fmt: skip


def short_axis(lv, wall, rv):
    """An LV in its wall, open at the base, and an RV beside it."""
    labels = np.zeros(SHAPE, dtype=np.int64)
    labels[ball((40, 25, 33), 14)] = rv
    labels[ball((24, 25, 33), 17)] = wall
    labels[ball((24, 25, 33), 11)] = lv
    labels[:, :, 20:] = 0
    return labels


def left_heart(lv, la, aorta):
    labels = np.zeros(SHAPE, dtype=np.int64)
    labels[ball((30, 25, 24), 15)] = lv
    labels[ball((30, 25, 48), 12) & (labels == 0)] = la
    labels[ball((12, 25, 12), 6) & (labels == 0)] = aorta
    return labels


def proposed(folder):
    path = folder / "study.toml"
    path.write_text(proposed_study(folder, path), encoding="utf-8")
    study = read_study(path)
    surveys = [survey_shape(study, entry) for entry in study.entries]
    assert not named_population(study.settings, surveys).problems
    return study, path.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("lv", "wall", "rv", "name", "expected"),
    [
        (3, 2, 1, "patient001_frame01_gt", {"LV": 3, "EPI": (2, 3), "RV": 1}),  # ACDC
        (1, 2, 4, "label_sa_ED", {"LV": 1, "EPI": (2, 1), "RV": 4}),  # UK Biobank
        (1, 2, 3, "A0S9V9_sa_gt", {"LV": 1, "EPI": (2, 1), "RV": 3}),  # M&Ms
    ],
)
def test_a_short_axis_image_is_told_by_what_the_wall_surrounds(lv, wall, rv, name, expected):
    found = label_parts(LabelMap(short_axis(lv, wall, rv), np.eye(4)), name)
    assert found.values == expected
    assert any(note.startswith("doubt") for note in found.notes)


def test_three_labels_of_nothing_cardiac_keep_their_numbers():
    found = label_parts(LabelMap(short_axis(3, 2, 1), np.eye(4)), "knee_07")
    assert found.values == {"label1": 1, "label2": 2, "label3": 3}


def test_a_label_that_encloses_another_is_taken_with_it():
    labels = np.zeros(SHAPE, dtype=np.int64)
    labels[ball((30, 25, 33), 18)], labels[ball((30, 25, 33), 10)] = 2, 5
    found = label_parts(LabelMap(labels, np.eye(4)), "knee_07")
    assert found.values == {"label2": (2, 5), "label5": 5}


def test_whole_heart_schemes_are_known_by_their_values():
    labels = np.zeros((8, 8, 8), dtype=np.int64)
    labels[0, 0, :7] = [500, 600, 420, 550, 205, 820, 850]
    found = label_parts(LabelMap(labels, np.eye(4)), "x").values
    assert found == {
        "LV": 500, "RV": 600, "LA": 420, "RA": 550, "AO": 820, "PA": 850, "EPI": (205, 500),
    }  # fmt: skip
    labels[0, 0, :7] = np.arange(1, 8)
    found = label_parts(LabelMap(labels, np.eye(4)), "x").values
    assert found == {"LA": 2, "LV": 3, "RA": 4, "RV": 5, "AO": 6, "PA": 7, "EPI": (1, 3)}


def test_of_all_structures_of_a_body_those_of_the_heart_are_taken():
    labels = np.zeros((8, 8, 8), dtype=np.int64)
    labels.reshape(-1)[:118] = np.arange(118)
    found = label_parts(LabelMap(labels, np.eye(4)), "x")
    assert found.values["LAA"] == 61
    assert "TotalSegmentator" in found.notes[0]
    labels[7, 7, 7] = 900
    with pytest.raises(InputError, match="label map of a few labels, found 119"):
        label_parts(LabelMap(labels, np.eye(4)), "x")


@pytest.mark.parametrize(
    ("part", "short"),
    [
        ("heart_atrium_left", "LA"),
        ("left ventricle", "LV"),
        ("heart_ventricle_right", "RV"),
        ("pulmonary_artery", "PA"),
        ("heart_myocardium", "MYO"),
        ("Ascending aorta", "AO"),
        ("liver", "liver"),
    ],
)
def test_parts_of_the_heart_are_known_by_their_words(part, short):
    assert chamber(part) == short


def test_a_valve_lies_between_the_two_parts_that_it_joins():
    assert valve("heart_atrium_left", "heart_ventricle_left") == "mitral"
    assert valve("LA", "RV") is None


def test_touching_chambers_of_one_map_are_joined_by_their_valve(tmp_path):
    for k in (1, 2):
        saved(tmp_path / f"ct_{k}_label.nii.gz", left_heart(500, 420, 820))
        saved(tmp_path / f"ct_{k}_image.nii.gz", left_heart(900, 20, 11))
    study, text = proposed(tmp_path)
    assert [(s.first, s.second) for s in study.settings.seams] == [
        ("LA.mitral", "LV.mitral"), ("LV.aortic", "AO.aortic"),
    ]  # fmt: skip
    assert study.settings.labels.values == {"LA": 420, "LV": 500, "AO": 820}
    assert "labels of MM-WHS" in text


def test_chambers_that_do_not_touch_get_no_seam_and_the_reason(tmp_path):
    labels = left_heart(1, 2, 3)
    for name, mask in (("LV", labels == 1), ("LA", np.roll(labels == 2, 4, axis=2))):
        saved(tmp_path / f"s1_{name}.nii.gz", mask)
        saved(tmp_path / f"s2_{name}.nii.gz", mask)
    study, text = proposed(tmp_path)
    assert not study.settings.seams
    assert "# doubt: LA and LV" in text


def test_a_file_for_every_structure_becomes_parts_of_the_heart(tmp_path):
    labels = left_heart(1, 2, 3)
    names = {"heart_ventricle_left": 1, "heart_atrium_left": 2, "aorta": 3, "liver": 3}
    for subject in ("s0011", "s0223"):
        for name, value in names.items():
            saved(tmp_path / subject / "segmentations" / f"{name}.nii.gz", labels == value)
        saved(tmp_path / subject / "ct.nii.gz", labels)
    study, text = proposed(tmp_path)
    assert len(study.entries) == 2
    assert set(study.settings.part_names) == {"heart_ventricle_left", "heart_atrium_left", "aorta"}
    assert "heart_atrium_left.mitral" in {seam.first for seam in study.settings.seams}
    assert "# not used: liver" in text


def test_a_label_in_pieces_is_left_out_and_said(tmp_path):
    labels = left_heart(1, 2, 3)
    labels[ball((50, 25, 60), 6)] = 3
    saved(tmp_path / "a.nii.gz", labels)
    study, text = proposed(tmp_path)
    assert study.settings.part_names == ("label1", "label2")
    assert "# label3 is left out: " in text


def test_phases_with_names_of_their_own_in_every_subject_are_phases(tmp_path):
    for p, last in ((1, 12), (2, 10), (3, 13)):
        for frame in (1, last):
            stem = tmp_path / f"patient00{p}" / f"patient00{p}_frame{frame:02}"
            saved(stem.with_name(f"{stem.name}_gt.nii.gz"), short_axis(3, 2, 1))
            saved(stem.with_name(f"{stem.name}.nii.gz"), short_axis(90, 70, 30))
        (stem.parent / "Info.cfg").write_text(f"ED: 1\nES: {last}\n", encoding="utf-8")
    study, _ = proposed(tmp_path)
    assert [str(entry.id) for entry in study.entries][:3] == [
        "patient001/frame01", "patient001/frame12", "patient002/frame01",
    ]  # fmt: skip
    assert study.settings.part_names == ("LV", "EPI", "RV")
