"""Whatever a value holds comes back from its file bit for bit, or an error says what is wrong."""

import dataclasses
import enum
import json
import struct
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ostiform.arrays import BoolArray, FloatArray, IntArray
from ostiform.artifacts import load, load_mapped, save
from ostiform.codecs import StoredAs
from ostiform.errors import ArtifactError
from ostiform.values import Axes, value


class Status(enum.Enum):
    DONE = "done"
    LEFT = "left"


@dataclasses.dataclass(frozen=True, slots=True, order=True)
class Pair:
    first: str
    second: int


ITEMS = {  # annotation: what may stand there
    int: st.integers(),
    float: st.floats(),
    str: st.text(),
    bool: st.booleans(),
    Status: st.sampled_from(Status),
    Literal["a", "b"]: st.sampled_from(["a", "b"]),
    Pair: st.builds(Pair, st.text(max_size=3), st.integers()),
}


def arrays(dtype, elements):
    shapes = st.lists(st.integers(0, 3), max_size=3).map(tuple)
    return shapes.flatmap(
        lambda shape: st.lists(
            elements, min_size=int(np.prod(shape)), max_size=int(np.prod(shape))
        ).map(lambda numbers: np.array(numbers, dtype).reshape(shape))
    )


ARRAYS = {
    Annotated[FloatArray, Axes(..., gaps=True)]: arrays(np.float64, st.floats(allow_nan=False)),
    IntArray: arrays(np.int64, st.integers(-(2**63), 2**63 - 1)),
    BoolArray: arrays(np.bool_, st.booleans()),
}


@st.composite
def typed(draw, depth=2):
    """An annotation and something of that type."""
    plain = ITEMS | ARRAYS
    kind = draw(st.sampled_from(["plain", "tuple", "str mapping", "mapping", "optional", "value"]))
    if kind == "plain" or not depth:
        hint = draw(st.sampled_from(list(plain)))
        return hint, draw(plain[hint])
    hint, one = draw(typed(depth - 1))
    if kind == "tuple":
        return tuple[hint, ...], (one,) * draw(st.integers(0, 2))  # type: ignore[valid-type]
    if kind == "str mapping":
        return Mapping[str, hint], {name: one for name in draw(st.sets(st.text(max_size=3)))}  # type: ignore[valid-type]
    if kind == "mapping":
        keys = draw(st.sets(ITEMS[Pair], max_size=2))
        return Mapping[Pair, hint], {key: one for key in keys}  # type: ignore[valid-type]
    if kind == "optional":
        return hint | None, draw(st.sampled_from([None, one]))
    made = made_class({"inner": hint})
    return made, made(one)


def made_class(hints):
    return value(type("Generated", (), {"__annotations__": dict(hints), "__module__": __name__}))


def bits(held):
    """What something holds, so that equal means equal to the last bit."""
    if isinstance(held, np.ndarray):
        return held.dtype.str, held.shape, held.tobytes()
    if isinstance(held, float):
        return "nan" if held != held else struct.pack("d", held)
    if isinstance(held, Mapping):
        return [(key, bits(item)) for key, item in held.items()]
    if isinstance(held, tuple):
        return [bits(item) for item in held]
    if dataclasses.is_dataclass(held):
        return [bits(getattr(held, field.name)) for field in dataclasses.fields(held)]
    return type(held), held


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(fields=st.lists(typed(), min_size=1, max_size=3))
def test_every_value_comes_back_bit_for_bit(tmp_path, fields):
    kind = made_class({f"field{n}": hint for n, (hint, _) in enumerate(fields)})
    held = kind(*(item for _, item in fields))
    for name, read in (("a", load), ("a", load_mapped), ("a.json", load)):
        save(tmp_path / name, held)
        assert bits(read(tmp_path / name, kind)) == bits(held)


@value
class Sample:
    points: Annotated[FloatArray, Axes("P", 3)]
    drawn: Annotated[FloatArray, Axes("P"), StoredAs(np.float32)]
    note: float | str = "none"


def sample(count=5):
    rng = np.random.default_rng(count)
    return Sample(rng.normal(size=(count, 3)), rng.normal(size=count))


def test_tuples_of_values_and_alternatives_come_back(tmp_path):
    held = (sample(2), dataclasses.replace(sample(3), note=0.1))
    save(tmp_path / "samples", held, tuple[Sample, ...])
    first, second = load(tmp_path / "samples", tuple[Sample, ...])
    np.testing.assert_array_equal(first.points, held[0].points)
    assert (first.note, second.note) == ("none", 0.1)


def test_an_array_can_be_kept_in_single_precision_in_files_only(tmp_path):
    held = sample()
    save(tmp_path / "sample", held)
    found = load(tmp_path / "sample", Sample)
    assert found.drawn.dtype == np.float64
    np.testing.assert_array_equal(found.drawn, held.drawn.astype(np.float32))


def test_mapped_arrays_are_not_copied(tmp_path):
    save(tmp_path / "sample", sample(1000))
    found = load_mapped(tmp_path / "sample", Sample)
    assert not found.points.flags.owndata
    assert found.points.ctypes.data % 64 == 0


@value
class Other:
    points: Annotated[FloatArray, Axes("P", 3)]


def test_a_file_of_another_kind_or_layout_is_refused(tmp_path):
    for name in ("sample", "sample.json"):
        path = tmp_path / name
        save(path, sample())
        with pytest.raises(ArtifactError, match=r"expected the other .* found sample in layout 1"):
            load(path, Other)
        path.write_bytes(path.read_bytes().replace(b"|1|", b"|9|").replace(b'ut": 1', b'ut": 9'))
        with pytest.raises(ArtifactError, match="found sample in layout 9; run `ostiform build`"):
            load(path, Sample)


def test_a_file_of_other_fields_is_refused(tmp_path):
    changed = value(type("Sample", (), {"__annotations__": {"points": FloatArray}}))
    save(tmp_path / "sample", changed(np.eye(3)))
    with pytest.raises(ArtifactError, match="sample with other fields"):
        load(tmp_path / "sample", Sample)


def test_a_missing_file_is_refused_with_what_to_do(tmp_path):
    with pytest.raises(ArtifactError, match=r"No such file .* choose another$"):
        load(tmp_path / "none", Sample, remedy="choose another")


@pytest.mark.parametrize("name", ["sample", "sample.json"])
def test_a_file_that_was_cut_short_is_refused(tmp_path, name):
    path = tmp_path / name
    save(path, sample())
    content = path.read_bytes()
    for length in range(0, len(content) - 1, 7):
        path.write_bytes(content[:length])
        with pytest.raises(ArtifactError, match="expected the sample that an earlier stage wrote"):
            load(path, Sample)


def test_a_single_changed_byte_is_found_wherever_it_lies(tmp_path):
    path = tmp_path / "sample"
    save(path, sample())
    content = path.read_bytes()
    text_end = content.index(b"\n", content.index(b"\n") + 1)
    for place in [n for n in range(len(content)) if n <= text_end or n % 64 < 40]:
        damaged = bytearray(content)
        damaged[place] ^= 1
        path.write_bytes(damaged)
        try:
            found = load(path, Sample)
        except ArtifactError:
            continue
        assert bits(found) == bits(load_sound(tmp_path, content))


def load_sound(folder, content):
    (folder / "sound").write_bytes(content)
    return load(folder / "sound", Sample)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damaged_json_gives_a_value_or_the_one_error(tmp_path, data):
    path = tmp_path / "sample.json"
    save(path, sample(2))
    facts: Any = json.loads(path.read_text())
    field = data.draw(st.sampled_from(["kind", "layout", "value"]))
    junk = st.recursive(
        st.none() | st.booleans() | st.integers() | st.text(max_size=3),
        lambda inner: (
            st.lists(inner, max_size=3)
            | st.dictionaries(st.sampled_from(["points", "drawn", "note"]), inner, max_size=3)
        ),
    )
    if field == "value":
        facts["value"][data.draw(st.sampled_from(sorted(facts["value"])))] = data.draw(junk)
    else:
        facts[field] = data.draw(junk)
    path.write_text(json.dumps(facts))
    try:
        assert isinstance(load(path, Sample), Sample)
    except ArtifactError:
        pass
