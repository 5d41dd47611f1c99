"""Tables as CSV: what is written is read back, by the csv module."""

import csv

import numpy as np

from ostiform.exchange import write_shape_values_csv
from ostiform.study import ShapeId
from ostiform.tables import write_table


def rows_of(path):
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.reader(stream))


def test_texts_are_kept_and_numbers_have_six_digits(tmp_path):
    path = tmp_path / "table.csv"
    write_table(path, ["name", "count", "size"], [["a, b", 12345678, 1.0 / 3.0], ['"c"', 0, 2e9]])
    assert rows_of(path) == [
        ["name", "count", "size"],
        ["a, b", "12345678", "0.333333"],
        ['"c"', "0", "2e+09"],
    ]


def test_values_of_shapes_stand_beside_who_and_when(tmp_path):
    path = tmp_path / "values.csv"
    ids = [ShapeId("s1", "00", 0.0), ShapeId("s1", "01", 0.25)]
    write_shape_values_csv(path, ids, ["LV_ml"], np.array([[100.0], [62.5]]))
    assert rows_of(path) == [
        ["subject", "phase", "time", "LV_ml"],
        ["s1", "00", "0", "100"],
        ["s1", "01", "0.25", "62.5"],
    ]
