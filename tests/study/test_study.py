import pytest

from ostiform.errors import InputError
from ostiform.pipeline.store import slug
from ostiform.study import natural_key, read_study

PARTS = """
schema = 1
[parts.LV]
ostia = ["mitral"]
[parts.LA]
ostia = ["mitral"]
[shapes]
"""
ONE_PART = """
schema = 1
[parts.LA]
ostia = ["mitral"]
[shapes]
"""


@pytest.fixture
def study(tmp_path):
    def make(text, *files):
        for name in files:
            path = tmp_path / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.touch()
        path = tmp_path / "study.toml"
        path.write_text(text, encoding="utf-8")
        return read_study(path)

    return make


def ids(found):
    return [str(entry.id) for entry in found.entries]


def test_a_pattern_finds_the_parts_of_every_shape(study):
    found = study(
        PARTS + 'pattern = "{subject}_{phase}_{part}.vtp"',
        *(f"s{k}_{p}_{part}.vtp" for k in (1, 2) for p in (0, 1) for part in ("LV", "LA")),
        "notes.txt",
        "s1_0_RV.vtp",
    )
    assert ids(found) == ["s1/0", "s1/1", "s2/0", "s2/1"]
    assert list(found.entries[0].files) == ["LV", "LA"]
    assert found.entries[0].files["LA"].name == "s1_0_LA.vtp"


def test_subjects_and_phases_are_in_natural_order(study):
    found = study(
        ONE_PART + 'pattern = "{subject}_{phase}.vtp"',
        *(f"s{k}_{p}.vtp" for k in (10, 2, 1) for p in ("9", "10")),
    )
    assert ids(found) == ["s1/9", "s1/10", "s2/9", "s2/10", "s10/9", "s10/10"]
    assert natural_key("a2b") < natural_key("a10b")
    assert natural_key("01") != natural_key("1")


def test_times_default_to_the_rank_of_the_phase(study):
    found = study(ONE_PART + 'pattern = "{subject}_{phase}.vtp"', "a_3.vtp", "a_1.vtp", "b_7.vtp")
    assert [entry.id.time for entry in found.entries] == [0.0, 0.5, 0.0]


def test_times_may_be_given_by_phase(study):
    text = ONE_PART + 'pattern = "{subject}_{phase}.vtp"\ntimes = {ED = 0.0, ES = 0.35}'
    assert [e.id.time for e in study(text, "a_ED.vtp", "a_ES.vtp").entries] == [0.0, 0.35]
    with pytest.raises(InputError, match="a time for every phase, found none for MD"):
        study(text, "a_MD.vtp")


def test_folders_and_repeated_fields_are_matched(study):
    found = study(
        PARTS + 'pattern = "{subject}/{phase}/{subject}-{part}*.vtp"',
        *(f"Åsa 1/late/Åsa 1-{part} final.vtp" for part in ("LV", "LA")),
        "Åsa 1/late/other-LV.vtp",
    )
    assert ids(found) == ["Åsa 1/late"]


def test_underscores_belong_to_the_subject(study):
    found = study(ONE_PART + 'pattern = "{subject}_{phase}.vtp"', "left_heart_01_3.vtp")
    assert ids(found) == ["left_heart_01/3"]


def test_files_may_lie_in_another_folder(study, tmp_path):
    found = study(
        ONE_PART + 'folder = "meshes"\npattern = "{subject}.vtp"', "meshes/a.vtp", "b.vtp"
    )
    assert ids(found) == ["a"]
    assert found.folder == tmp_path / "meshes"
    with pytest.raises(InputError, match="shapes.folder: expected a folder, found none"):
        study(ONE_PART + 'folder = "elsewhere"\npattern = "{subject}.vtp"')


def test_a_missing_part_is_left_for_the_shape_to_report(study):
    found = study(PARTS + 'pattern = "{subject}_{part}.vtp"', "a_LV.vtp", "b_LV.vtp", "b_LA.vtp")
    assert [list(entry.files) for entry in found.entries] == [["LV"], ["LV", "LA"]]


def test_two_files_for_one_part_are_refused(study):
    with pytest.raises(InputError, match=r"shape a: expected one file for LV, found 2"):
        study(PARTS + 'pattern = "{subject}_{part}*.vtp"', "a_LV1.vtp", "a_LV2.vtp", "a_LA1.vtp")


def test_two_rows_for_one_shape_are_refused(study, tmp_path):
    (tmp_path / "shapes.csv").write_text("subject,phase,LA\na,1,x.vtp\na,1,y.vtp\n")
    with pytest.raises(InputError, match="shape a/1: expected one row, found 2"):
        study(ONE_PART + 'sheet = "shapes.csv"')


def test_a_sheet_gives_files_times_and_covariates(study, tmp_path):
    (tmp_path / "shapes.csv").write_text(
        "subject,phase,time,LV,LA,age\nb,1,0.5,bv.vtp,ba.vtp,60\na,1,0.25,av.vtp,aa.vtp,50\n"
    )
    found = study(PARTS + 'sheet = "shapes.csv"')
    assert ids(found) == ["a/1", "b/1"]
    assert found.entries[0].id.time == 0.25
    assert dict(found.entries[1].covariates) == {"age": "60"}
    assert found.entries[1].files["LV"] == tmp_path / "bv.vtp"


def test_times_for_some_rows_only_are_refused(study, tmp_path):
    (tmp_path / "shapes.csv").write_text("subject,time,LA\na,0.5,x.vtp\nb,,y.vtp\n")
    with pytest.raises(InputError, match="shape b: expected a time in the sheet"):
        study(ONE_PART + 'sheet = "shapes.csv"')


def test_an_empty_study_is_refused(study, tmp_path):
    with pytest.raises(InputError, match=r'matching "\{subject\}.vtk" .* such as a.vtp'):
        study(ONE_PART + 'pattern = "{subject}.vtk"', "a.vtp")
    (tmp_path / "shapes.csv").write_text("subject,LA\n")
    with pytest.raises(InputError, match="one row per shape, found none"):
        study(ONE_PART + 'sheet = "shapes.csv"')


@pytest.mark.parametrize(
    ("pattern", "message"),
    [
        ("{subject}_{day}.vtp", r"found \{day\}"),
        ("{subject}.vtp", r"expected the field \{part\}"),
    ],
)
def test_a_pattern_with_wrong_fields_is_refused(study, pattern, message):
    with pytest.raises(InputError, match=message):
        study(PARTS + f'pattern = "{pattern}"', "a.vtp")


def test_a_pattern_without_subject_is_one_subject(study):
    found = study(PARTS + 'pattern = "{phase}_{part}.vtp"', "0_LV.vtp", "0_LA.vtp", "1_LV.vtp")
    assert [str(entry.id) for entry in found.entries] == ["1/0", "1/1"]


def test_points_for_a_shape_that_does_not_exist_are_refused(study):
    points = '\n[ostia.shapes."b/0"]\n"LA.mitral" = [0, 0, 0]'
    with pytest.raises(InputError, match=r'ostia.shapes."b/0": expected a shape'):
        study(ONE_PART + 'pattern = "{subject}.vtp"' + points, "a.vtp")


def test_alignment_is_per_subject_where_a_subject_has_several_phases(study):
    pattern = ONE_PART + 'pattern = "{subject}_{phase}.vtp"'
    assert study(pattern, "a_1.vtp", "b_1.vtp").alignment_per == "shape"
    assert study(pattern, "a_2.vtp").alignment_per == "subject"
    assert study(pattern + '\n[alignment]\nper = "shape"').alignment_per == "shape"


def test_equal_phase_names_are_equal_times_whichever_are_missing(study):
    # Case: first frame missing on one of two, last and inner ones on others.
    names = [f"p{s}_{k}.vtp" for s in range(4) for k in range(6)]
    missing = {"p1_0.vtp", "p2_5.vtp", "p3_2.vtp", "p3_3.vtp"}
    found = study(
        ONE_PART + 'pattern = "{subject}_{phase}.vtp"', *(n for n in names if n not in missing)
    )
    for entry in found.entries:
        assert entry.id.time == int(entry.id.phase) / 6
    notes = {entry.id.subject: "".join(entry.notes) for entry in found.entries}
    assert notes["p0"] == ""
    assert "p1 lacks the phase 0 that others have: its times leave room for it" in notes["p1"]
    assert "p2 lacks the phase 5" in notes["p2"]
    assert "give times (shapes.times or a sheet)" in notes["p2"]
    assert "p3 lacks the phases 2, 3" in notes["p3"]


def test_a_sheet_leaves_out_what_it_excludes_without_moving_the_others(study, tmp_path):
    rows = [f"p{s},{k},p{s}_{k}.vtp,{'yes' if (s, k) == (1, 0) else ''}" for s in (1, 2)
            for k in (0, 1)]  # fmt: skip
    (tmp_path / "sheet.csv").write_text("\n".join(["subject,phase,file,exclude", *rows]))
    found = study(ONE_PART + 'sheet = "sheet.csv"')
    assert {str(e.id): e.id.time for e in found.entries} == {"p1/1": 0.5, "p2/0": 0.0, "p2/1": 0.5}
    assert [str(id) for id in found.excluded] == ["p1/0"]
    assert all(not entry.notes for entry in found.entries)
    (tmp_path / "sheet.csv").write_text("subject,file,exclude\np1,a.vtp,maybe\n")
    with pytest.raises(InputError, match='row 2: expected exclude yes or no, found "maybe"'):
        study(ONE_PART + 'sheet = "sheet.csv"')


def test_a_subject_without_phases_is_called_by_its_name_alone(study, tmp_path):
    found = study(ONE_PART + 'pattern = "{subject}.vtp"', "10.vtp", "11.vtp")
    assert ids(found) == ["10", "11"]
    assert [slug(entry.id) for entry in found.entries] == ["10_0", "11_0"]
    assert [entry.id.phase for entry in found.entries] == ["", ""]
    (tmp_path / "sheet.csv").write_text("subject,phase,file\np1,,a.vtp\np1,0,b.vtp\n")
    with pytest.raises(InputError, match="subject p1: expected a phase for all .* or for none"):
        study(ONE_PART + 'sheet = "sheet.csv"')


def test_braces_of_file_names_are_doubled_in_a_pattern(study):
    name = "case{1}_{x}.vtp"
    found = study(ONE_PART + 'pattern = "{subject}_{{x}}.vtp"', name)
    assert [(str(e.id), e.files["LA"].name) for e in found.entries] == [("case{1}", name)]
    with pytest.raises(InputError, match=r"\(\{\{ for a brace\), found \{x\}"):
        study(ONE_PART + 'pattern = "{subject}_{x}.vtp"')


def test_hidden_files_are_no_shapes_and_dead_links_are(study, tmp_path):
    (tmp_path / "b.vtp").symlink_to(tmp_path / "gone.vtp")
    text = ONE_PART + 'pattern = "{subject}.vtp"'
    assert ids(study(text, "a.vtp", "._a.vtp", ".hidden.vtp")) == ["a", "b"]
    assert ids(study(text.replace('"{', '".{'), "a.vtp")) == ["_a", "hidden"]


@pytest.mark.parametrize("encoding", ["utf-16", "utf-8-sig", "utf-8"])
def test_sheets_of_any_unicode_are_read(study, tmp_path, encoding):
    text = "subject\tphase\ttime\tfile\nM\u00fcller\tED\t0,5\ta.vtp\n"
    (tmp_path / "sheet.csv").write_text(text, encoding)
    (entry,) = study(ONE_PART + 'sheet = "sheet.csv"').entries
    assert (str(entry.id), entry.id.time) == ("M\u00fcller/ED", 0.5)
