"""Times of a sheet in seconds, and events of the cycle in the study file."""

import pytest

from ostiform.errors import InputError
from ostiform.study import parsed_settings
from ostiform.study.sheet import read_sheet

STUDY = """
schema = 1
[parts.LV]
[shapes]
sheet = "shapes.csv"
"""


def rows(tmp_path, text, length=None):
    path = tmp_path / "shapes.csv"
    path.write_text(text, encoding="utf-8")
    return read_sheet(path, ["LV"], cycle_length_s=length)


@pytest.mark.parametrize(
    ("text", "length"),
    [
        ("subject,time_s,cycle_s,LV\na,0.2,0.8,x.vtp\n", None),
        ("subject,time_s,heart_rate_bpm,LV\na,0.2,75,x.vtp\n", None),
        ("subject,time_s,LV\na,0.2,x.vtp\n", 0.8),
        ("subject,time,LV\na,0.25,x.vtp\n", None),
    ],
)
def test_a_time_in_seconds_is_a_fraction_of_the_stated_cycle(tmp_path, text, length):
    (row,) = rows(tmp_path, text, length)
    assert row.time == pytest.approx(0.25)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("subject,time_s,LV\na,0.2,x.vtp\n", "length of the cycle"),
        ("subject,time_s,cycle_s,LV\na,0.9,0.8,x.vtp\n", "below the cycle's 0.8 s"),
        ("subject,time_s,cycle_s,LV\na,0.2,-1,x.vtp\n", "positive cycle_s"),
        ("subject,time,time_s,LV\na,0.2,0.1,x.vtp\n", "found both"),
    ],
)
def test_wrong_times_in_seconds_are_refused(tmp_path, text, message):
    with pytest.raises(InputError, match=message):
        rows(tmp_path, text)


def test_events_of_the_cycle_are_read():
    settings = parsed_settings(STUDY + "[cycle]\nlandmarks = {a = [0.3], b = [0.4]}\n")
    assert settings.cycle.landmarks == {"a": (0.3,), "b": (0.4,)}


@pytest.mark.parametrize(
    ("events", "message"),
    [("{a = [0.3], b = [0.3, 0.5]}", "as many events"), ("{a = [0.5, 0.3]}", "increasing")],
)
def test_wrong_events_are_refused(events, message):
    with pytest.raises(InputError, match=message):
        parsed_settings(STUDY + f"[cycle]\nlandmarks = {events}\n")
