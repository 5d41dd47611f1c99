"""Whole-heart maps become shapes by contacts alone, whatever the order, numbers and edges."""

import re
from itertools import permutations

import numpy as np
import pytest

from ostiform.errors import InputError
from ostiform.study import read_study
from ostiform.study.label_parts import component_meshes
from ostiform.study.labelmaps import LabelMap
from ostiform.study.settings import StudySettings
from ostiform.study.settings_file import parsed_settings
from ostiform.surface import boundary_loops, genus
from tests.oracles.heart_maps import VEINS, heart_map, saved_map
from tests.study.single_shapes import read_shape

TEXT = """
schema = 1
{parts}
[[seams]]
first = "LV.mitral"
second = "LA.mitral"
[shapes]
pattern = "{{subject}}.nii.gz"
[labels]
edge_mm = {edge}
values = {{LV = {LV}, LA = {LA}, AO = {AO}}}
{more}
[labels.openings]
"LA.veins" = {{label = {PV}, ostia = ["RSPV", "RIPV", "LSPV", "LIPV"]}}
"""
PARTS = {
    "LV": '[parts.LV]\nostia = ["mitral", "aortic"]',
    "LA": '[parts.LA]\nostia = ["mitral", "RSPV", "RIPV", "LSPV", "LIPV"]',
    "AO": '[parts.AO]\nostia = ["aortic"]',
}
AORTA = '[[seams]]\nfirst = "LV.aortic"\nsecond = "AO.aortic"'
NUMBERS = {"LV": 3, "LA": 2, "AO": 6, "PV": 8}


@pytest.fixture(scope="module")
def noisy():
    return {spacing: heart_map(3, (2.0, 2.0, spacing)) for spacing in (2.0, 7.0)}


def settings_of(order=("LV", "LA", "AO"), edge=3.0, numbers=NUMBERS, more=""):
    parts = "\n".join(PARTS[part] for part in order)
    text = TEXT.format(parts=parts, edge=edge, more=more, **numbers)
    return parsed_settings(text.replace("[shapes]", f"{AORTA}\n[shapes]"))


def meshes_of(settings, labels, affine):
    label_map = LabelMap(labels.astype(np.int64), affine)
    masks = {part: labels == settings.labels.values[part] for part in settings.parts}
    return component_meshes(settings, masks, label_map, {})


def counts(made):
    return {part: len(boundary_loops(faces)) for part, (_, faces) in made.meshes.items()}


@pytest.mark.parametrize("spacing", [2.0, 7.0])
@pytest.mark.parametrize(
    ("order", "edge"),
    [*zip(permutations(("LV", "LA", "AO")), (2.0, 2.5, 3.0, 3.5, 4.0, 5.0), strict=True)],
)
def test_the_verdict_depends_neither_on_order_nor_on_edge_length(noisy, spacing, order, edge):
    made = meshes_of(settings_of(order, edge), *noisy[spacing])
    assert counts(made) == {"LV": 2, "LA": 5, "AO": 1}
    assert all(genus(faces) == 0 for _, faces in made.meshes.values())


def test_the_numbers_of_labels_do_not_matter(noisy):
    labels, affine = noisy[2.0]
    turned = np.where(labels > 0, 11 - labels, 0)
    numbers = {name: 11 - value for name, value in NUMBERS.items()}
    one = meshes_of(settings_of(), labels, affine)
    two = meshes_of(settings_of(numbers=numbers), turned, affine)
    for part in one.meshes:
        np.testing.assert_allclose(one.meshes[part][0], two.meshes[part][0], atol=1e-9)


@pytest.mark.parametrize("rim", ["curve", "plane"])
def test_rims_lie_where_the_labels_touch(rim):
    labels, affine = heart_map(5, (1.8, 1.8, 1.8), noise=False, turn=False, amplitude=0.0)
    made = meshes_of(settings_of(more=f'rim = "{rim}"'), labels, affine)
    ventricle, faces = made.meshes["LV"]
    for loop in boundary_loops(faces):
        # Both valves of the heart that is not deformed lie in the plane z = 0.
        assert np.abs(ventricle[loop][:, 2]).mean() < 1.3
    atrium, faces = made.meshes["LA"]
    centers = np.array([atrium[loop].mean(axis=0) for loop in boundary_loops(faces)])
    for way in VEINS.values():
        way = np.asarray(way) / np.linalg.norm(way)
        off = centers - np.array([-10.0, 0.0, 20.0])
        along = off @ way
        across = np.linalg.norm(off - along[:, None] * way, axis=1)
        assert across[along > 0].min() < 3.0
    said = any("degrees to the slices" in note for note in made.notes)
    assert said == (rim == "plane")


def test_one_contact_with_a_label_is_an_opening_with_its_name(tmp_path, noisy):
    saved_map(tmp_path / "a.nii.gz", *noisy[2.0])
    text = TEXT.format(
        parts=PARTS["LV"] + "\n" + PARTS["LA"], edge=3.0, more="", **NUMBERS
    ).replace(", AO = 6", "")
    (tmp_path / "study.toml").write_text(text + '"LV.aortic" = 6\n', encoding="utf-8")
    study = read_study(tmp_path / "study.toml")
    # The veins need rough points; the aorta has its name from the contact.
    with pytest.raises(InputError, match="loop 4 at") as told:
        read_shape(study, study.entries[0])
    assert "LV" not in str(told.value)
    text = re.sub(r'"LA.veins".*', "", text).replace(', "RSPV", "RIPV", "LSPV", "LIPV"', "")
    (tmp_path / "study.toml").write_text(text + '"LV.aortic" = 6\n', encoding="utf-8")
    study = read_study(tmp_path / "study.toml")
    shape = read_shape(study, study.entries[0])
    assert set(shape.parts["LV"].loops) == {"mitral", "aortic"}


def test_too_few_contacts_are_told_with_area_and_place(noisy):
    labels, affine = noisy[2.0]
    pieces = settings_of()
    joined = labels.copy()
    below = np.indices(labels.shape)[2] < np.argwhere(labels == 8)[:, 2].mean()
    joined[(labels == 8) & below] = 0  # the lower veins are missing
    with pytest.raises(InputError, match=r"LA touches label 8 in \d patch.*mm2 at \[.*expected 4"):
        meshes_of(pieces, joined, affine)


def test_more_contacts_than_openings_are_closed_and_told(noisy):
    labels, affine = noisy[2.0]
    text = TEXT.format(parts="\n".join(PARTS.values()), edge=3.0, more="", **NUMBERS)
    text = text.replace("[shapes]", f"{AORTA}\n[shapes]").replace(', "LIPV"]', "]")
    made = meshes_of(parsed_settings(text), labels, affine)
    assert counts(made)["LA"] == 4
    assert any(re.search(r"in 4 patches, expected 3: closed at", note) for note in made.notes)


def test_a_gap_between_labels_is_bridged_as_far_as_the_study_says():
    x, y, z = np.indices((24, 24, 44)) - np.array([12, 12, 22]).reshape(3, 1, 1, 1)
    labels = np.where((x / 8) ** 2 + (y / 8) ** 2 + (z / 18) ** 2 < 1, np.where(z < 0, 3, 2), 0)
    labels[(z == 0) | (z == -1)] = 0  # 3 mm of nothing between the two
    text = TEXT.format(parts=PARTS["LV"] + PARTS["LA"].replace("[parts", "\n[parts"), edge=3.0,
                       more="MORE", **NUMBERS)  # fmt: skip
    text = text[: text.index("[labels.openings]")].replace(", AO = 6", "")
    affine = np.diag([1.5, 1.5, 1.5, 1.0])
    made = meshes_of(parsed_settings(text.replace("MORE", "")), labels, affine)
    assert counts(made) == {"LV": 1, "LA": 1}
    assert "LV and LA do not touch: bridged a gap of 3 mm between them" in made.notes
    with pytest.raises(InputError, match="more than 2 mm apart"):
        meshes_of(parsed_settings(text.replace("MORE", "gap_mm = 2.0")), labels, affine)


def test_openings_are_of_parts_and_name_their_ostia():
    settings = settings_of().model_dump(by_alias=True)
    assert isinstance(StudySettings.model_validate(settings), StudySettings)
    for key, into, message in (
        ("XX.a", 8, "expected a part"),
        ("LV.mitral", 8, "a seam already"),
        ("LV.other", 8, "expected an ostium of LV"),
        ("LA.v", {"label": 8, "ostia": ["nope"]}, "expected ostia of LA"),
    ):
        text = TEXT.format(parts="\n".join(PARTS.values()), edge=3.0, more="", **NUMBERS)
        shown = into if isinstance(into, int) else '{label = 8, ostia = ["nope"]}'
        with pytest.raises(InputError, match=message):
            parsed_settings(f'{text}"{key}" = {shown}\n')
