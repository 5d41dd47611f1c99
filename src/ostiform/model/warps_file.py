"""``warps.h5``: the warps of all shapes of a model, and what places further ones."""

from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ostiform.correspondence import (
    FieldBasis,
    FrozenLevel,
    FrozenModel,
    MetricTerm,
    QuadraticForm,
    Steps,
    TemplateMarks,
    Warp,
    Warps,
)
from ostiform.model.hdf5 import (
    check_schema,
    put_facts,
    put_ids,
    put_template,
    put_texts,
    reading,
    take_ids,
    take_template,
    take_texts,
    writing,
)
from ostiform.study import ShapeId

CONTENT = "the warps of an ostiform model"

ARRAYS = ("weights", "mean", "coarse_weights", "transforms")
NUMBERS = ("n_optimised", "stretch", "offset", "alignment", "jointly")
METRIC = ("edges", "weights", "part", "reference")
FIELDS = ("table", "labels", "control", "circles")
FORM = ("target", "root_weights", "modes", "gains", "motions", "shares")


def write_warps(path: Path, frozen: FrozenModel, warps: Warps) -> None:
    """Write the warps of a model's shapes and the model frozen; every bit is kept.

    Raises
    ------
    ArtifactError
        If the file cannot be written.
    """
    with writing(path) as file:
        put_facts(file, frozen.template.parts)
        put_template(file, frozen.template)
        put_ids(file, frozen.ids)
        for name in ARRAYS:
            file.create_dataset(name, data=getattr(frozen, name))
        for name in NUMBERS:
            file.attrs[name] = getattr(frozen, name)
        _put(file.create_group("metric"), frozen.metric, METRIC)
        file["metric"].attrs["strength"] = frozen.metric.strength
        if frozen.marks is not None:
            marks = file.create_group("marks")
            put_texts(marks, "names", frozen.marks.names)
            _put(marks, frozen.marks, ("corners", "barycentric"))
        for number, (level, steps) in enumerate(zip(frozen.levels, warps.steps, strict=True)):
            stored = file.create_group(f"warp/{number}")
            _put(stored, level.basis, FIELDS)
            _put(stored, steps, ("coefficients", "fastest"))
            for name, form in level.forms.items():
                group = stored.create_group(f"forms/{name}", track_order=True)
                _put(group, form, FORM)
                group.attrs["scale"] = form.scale


def read_frozen(path: Path) -> FrozenModel:
    """Read what places further shapes.

    Raises
    ------
    ArtifactError
        If the file is missing, damaged or of another kind or schema.
    """
    with reading(path, CONTENT) as file:
        check_schema(file)
        numbers = {name: _plain(file.attrs[name]) for name in NUMBERS}
        return FrozenModel(
            template=take_template(file),
            ids=take_ids(file),
            metric=MetricTerm(
                **_take(file["metric"], METRIC), strength=float(file["metric"].attrs["strength"])
            ),
            marks=_marks(file),
            levels=tuple(
                FrozenLevel(
                    FieldBasis(**_take(level, FIELDS)),
                    {name: _form(group) for name, group in level["forms"].items()},
                )
                for level in _levels(file)
            ),
            **_take(file, ARRAYS),
            **numbers,
        )


def read_warps(path: Path) -> Warps:
    """Read the warps of all shapes; errors are those of `read_frozen`."""
    with reading(path, CONTENT) as file:
        check_schema(file)
        levels = _levels(file)
        return Warps(
            take_ids(file),
            tuple(FieldBasis(**_take(level, FIELDS)) for level in levels),
            tuple(Steps(level["coefficients"][:], level["fastest"][:]) for level in levels),
        )


def read_warp(path: Path, shape: ShapeId | str) -> Warp:
    """Read the warp of one shape, by its identity or as ``SUBJECT/PHASE``.

    Raises
    ------
    ArtifactError
        As of `read_frozen`, or if there is no such shape.
    """
    with reading(path, CONTENT) as file:
        check_schema(file)
        ids = take_ids(file)
        row = Warps(ids, (), ()).index(shape)
        levels = []
        for level in _levels(file):
            taken = (level[name][:, row : row + 1] for name in ("coefficients", "fastest"))
            levels.append((FieldBasis(**_take(level, FIELDS)), Steps(*taken)))
        return Warp(tuple(levels))


def _levels(file: h5py.File) -> list[h5py.Group]:
    stored = file["warp"] if "warp" in file else {}
    return [stored[name] for name in sorted(stored, key=int)]


def _form(group: h5py.Group) -> QuadraticForm:
    arrays = _take(group, FORM)
    arrays["modes"] = np.asfortranarray(arrays["modes"])
    return QuadraticForm(**arrays, scale=float(group.attrs["scale"]))


def _marks(file: h5py.File) -> TemplateMarks | None:
    if "marks" not in file:
        return None
    names = take_texts(file["marks"]["names"])
    return TemplateMarks(names, **_take(file["marks"], ("corners", "barycentric")))


def _put(group: h5py.Group, value: object, names: tuple[str, ...]) -> None:
    for name in names:
        group.create_dataset(name, data=getattr(value, name))


def _take(group: h5py.Group, names: tuple[str, ...]) -> dict[str, Any]:
    return {name: group[name][:] for name in names}


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value
