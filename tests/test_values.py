"""Values check and freeze what they hold, once, by the annotations of their fields."""

import dataclasses
import pickle  # noqa: TID251 (what multiprocessing uses)
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
import pytest

from ostiform.arrays import BoolArray, FloatArray, IntArray
from ostiform.errors import InputError
from ostiform.values import Above, AtLeast, Axes, IndexOf, axis_length, value


@value
class Mesh:
    vertices: Annotated[FloatArray, Axes("V", 3)]
    faces: Annotated[IntArray, Axes("F", 3), IndexOf("V")]
    loops: Mapping[str, Annotated[IntArray, Axes(None), IndexOf("V")]]
    chosen: Annotated[BoolArray, Axes("F")] | None = None
    names: Annotated[tuple[str, ...], Axes("V")] | None = None


@value
class Field:
    mesh: Annotated[Mesh, Axes("V")]
    numbers: Annotated[FloatArray, Axes("V", gaps=True)]
    others: tuple[Annotated[FloatArray, Axes("K", "K")], ...] = ()


@value(eq=True)
class Rules:
    kind: Literal["plain", "fancy"] = "plain"
    rounds: Annotated[int, AtLeast(1)] = 1
    sd_mm: Annotated[FloatArray, Axes(None), Above(0)] | None = None


@value(eq=True)
class Lengths:
    lengths: Mapping[str, float]

    def __post_init__(self):
        if min(self.lengths.values()) < 0.0:
            raise InputError("lengths: expected no negative one")


def mesh(**changes):
    fields: dict[str, Any] = {
        "vertices": np.eye(3),
        "faces": np.array([[0, 1, 2]]),
        "loops": {"rim": [0, 1, 2]},
    } | changes
    return Mesh(**fields)


def test_arrays_and_mappings_become_read_only_copies_of_what_was_given():
    vertices, loops = np.eye(3), {"rim": np.array([0, 1, 2])}
    made = mesh(vertices=vertices, loops=loops, chosen=[True])
    vertices[0, 0] = 7.0
    loops["more"] = np.zeros(1)
    assert made.vertices[0, 0] == 1.0
    assert list(made.loops) == ["rim"]
    assert made.chosen.dtype == np.bool_
    for array in (made.vertices, made.loops["rim"], made.chosen):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0
    with pytest.raises(TypeError):
        made.loops["rim"] = made.loops["rim"]
    with pytest.raises(dataclasses.FrozenInstanceError):
        made.vertices = vertices


def test_what_is_frozen_already_is_not_copied_again():
    first = mesh()
    second = mesh(vertices=first.vertices, loops=first.loops)
    assert second.vertices is first.vertices
    assert second.loops is first.loops
    assert dataclasses.replace(first, faces=first.faces[:0]).vertices is first.vertices


def test_bounds_and_choices_hold_where_they_are_stated():
    assert Rules("fancy", 3, np.array([])).rounds == 3
    assert Rules() == Rules("plain", 1, None)
    with pytest.raises(InputError, match='kind: expected one of plain, fancy, found "odd"'):
        Rules(kind="odd")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="rounds: expected at least 1, found 0"):
        Rules(rounds=0)
    with pytest.raises(InputError, match="sd mm: expected a number above 0, found 0"):
        Rules(sd_mm=np.array([1.0, 0.0]))
    for bad in (np.nan, np.inf):
        with pytest.raises(InputError, match=f"rounds: expected at least 1, found {bad}"):
            Rules(rounds=bad)  # type: ignore[arg-type]


def test_values_travel_between_processes():
    copied = pickle.loads(pickle.dumps(mesh()))
    np.testing.assert_array_equal(copied.loops["rim"], [0, 1, 2])
    assert pickle.loads(pickle.dumps(Lengths({"a": 1.0}))) == Lengths({"a": 1.0})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"vertices": np.eye(2)}, r"vertices: expected an array of shape \(V, 3\), found \(2, 2"),
        ({"vertices": [[0.0, np.nan, 1.0]]}, "vertices: expected finite numbers, found 1"),
        ({"chosen": [True, False]}, r"chosen: expected an array of shape \(1\), found \(2,\)"),
        ({"faces": [[0, 1, 3]]}, "faces: expected indices from 0 to 2, found 0 to 3"),
        ({"loops": {"rim": [-1]}}, "loops rim: expected indices from 0 to 2, found -1 to -1"),
        ({"loops": {"rim": [[0, 1]]}}, "loops rim: expected an array of shape"),
        ({"names": ("a", "b")}, r"vertices: expected an array of shape \(2, 3\), found \(3, 3\)"),
    ],
)
def test_what_does_not_fit_is_refused_by_its_name(changes, message):
    with pytest.raises(InputError, match=message):
        mesh(**changes)


def test_letters_stand_for_one_length_in_the_value_and_in_those_that_it_holds():
    held = Field(mesh(), [1.0, np.nan, 2.0], (np.eye(2), np.eye(2)))  # type: ignore[arg-type]
    assert axis_length(held, "V") == 3
    with pytest.raises(InputError, match=r"numbers: expected an array of shape \(3\), found"):
        Field(mesh(), [1.0, 2.0])  # type: ignore[arg-type]
    with pytest.raises(InputError, match="others 0: expected an array of shape"):
        Field(mesh(), np.zeros(3), (np.zeros((2, 3)),))
    with pytest.raises(InputError, match="others 1: expected an array of shape"):
        Field(mesh(), np.zeros(3), (np.eye(2), np.eye(3)))


def test_what_annotations_cannot_say_is_checked_after_them():
    assert Lengths({"a": 0.5}) == Lengths({"a": 0.5})
    with pytest.raises(InputError, match="no negative one"):
        Lengths({"a": -1.0})
