import openpyxl
import pytest

from ostiform.errors import InputError
from ostiform.study.sheet import read_sheet


@pytest.fixture
def sheet(tmp_path):
    def write(text, name="shapes.csv"):
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return path

    return write


def test_columns_are_read_by_name_and_others_kept_as_covariates(sheet):
    path = sheet("age,LA,subject,phase,LV,time\n61,a.vtp,s1,ED,b.vtp,0.25\n,c.vtp,s2,ES,d.vtp,0\n")
    first, second = read_sheet(path, ["LV", "LA"])
    assert (first.subject, first.phase, first.time) == ("s1", "ED", 0.25)
    assert dict(first.files) == {"LV": "b.vtp", "LA": "a.vtp"}
    assert dict(first.covariates) == {"age": "61"}
    assert (second.time, dict(second.covariates)) == (0.0, {"age": ""})


def test_phase_and_time_may_be_left_out_and_one_part_may_be_called_file(sheet):
    (row,) = read_sheet(sheet("subject,file\ns1,a.vtp\n\n"), ["LA"])
    assert (row.phase, row.time, dict(row.files)) == (None, None, {"LA": "a.vtp"})


def test_an_empty_cell_is_a_missing_file(sheet):
    (row,) = read_sheet(sheet("subject,LV,LA\ns1,,a.vtp\n"), ["LV", "LA"])
    assert dict(row.files) == {"LA": "a.vtp"}


def test_semicolons_tabulators_and_a_byte_order_mark_are_understood(sheet):
    for mark, separator in (("", ";"), ("\ufeff", "\t")):
        (row,) = read_sheet(
            sheet(f"{mark}subject{separator}LA\nMüller{separator}a b.vtp\n"), ["LA"]
        )
        assert (row.subject, dict(row.files)) == ("Müller", {"LA": "a b.vtp"})


def test_a_spreadsheet_says_the_same_as_its_csv(tmp_path, sheet):
    book = openpyxl.Workbook()
    book.active.append(["subject", "phase", "time", "LA", "smoker"])
    book.active.append([1, 2.0, 0.5, "a.vtp", True])
    path = tmp_path / "shapes.xlsx"
    book.save(path)
    assert read_sheet(path, ["LA"]) == read_sheet(
        sheet("subject,phase,time,LA,smoker\n1,2,0.5,a.vtp,true\n"), ["LA"]
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "found an empty sheet"),
        ("subject,LV\ns1,a\n", "expected the columns LA, found subject, LV"),
        ("phase,LA\ns1,a\n", "expected the columns subject"),
        ("subject,LA,LA\ns1,a,b\n", "found LA twice"),
        ("subject,LA\ns1,a\n,b\n", "row 3: expected a subject, found an empty cell"),
        ("subject,LA,time\ns1,a,1.0\n", 'row 2: expected a time from 0 to below 1 .* "1.0"'),
        ("subject,LA,time\ns1,a,late\n", 'found "late"'),
        ('subject,LA\n"s1,a\n', "expected a CSV file, found a mistake"),
    ],
)
def test_a_mistake_is_named_with_its_row(sheet, text, message):
    with pytest.raises(InputError, match=message):
        read_sheet(sheet(text), ["LA"])


def test_files_that_are_no_sheets_are_refused(tmp_path):
    with pytest.raises(InputError, match="found no file"):
        read_sheet(tmp_path / "shapes.csv", ["LA"])
    broken = tmp_path / "shapes.xlsx"
    broken.write_bytes(b"PK\x03\x04 not a workbook")
    with pytest.raises(InputError, match="XLSX sheet, found a file that cannot be read"):
        read_sheet(broken, ["LA"])
    latin = tmp_path / "shapes.csv"
    latin.write_bytes("subject,LA\nMüller,a\n".encode("latin-1"))
    with pytest.raises(InputError, match="UTF-8"):
        read_sheet(latin, ["LA"])
