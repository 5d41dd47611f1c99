"""The pieces of HDF5 files that models and correspondences share: texts, templates, identities."""

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ostiform import __version__
from ostiform.arrays import IntArray
from ostiform.atomic import atomically
from ostiform.domain import Template, TemplateLevel
from ostiform.errors import ArtifactError, InputError, OstiformError
from ostiform.model.mesh import ModelMesh
from ostiform.study import ShapeId

SCHEMA = 1
"""Version of the layouts of design section 7."""

SHAPE_ARRAYS = ("points", "aligned", "transforms", "weights")
"""Of all shapes in correspondence, whatever brought them there."""

TEXT = h5py.string_dtype("utf-8")


@contextmanager
def writing(path: Path) -> Iterator[h5py.File]:
    """Give an HDF5 file to fill; it takes its name only when the block succeeds."""
    with atomically(path) as temporary, h5py.File(temporary, "w") as file:
        yield file


@contextmanager
def reading(path: Path, content: str, opened: h5py.File | None = None) -> Iterator[h5py.File]:
    """Give an HDF5 file to read from, and turn what goes wrong into one sentence about it.

    Parameters
    ----------
    path : Path
    content : str
        What the file should be, for the message.
    opened : h5py.File, optional
        Already open in memory, to be filled from the file; closed by the caller.

    Raises
    ------
    ArtifactError
        If the file is missing, is no HDF5 file, or lacks something that the block asks for.
    """
    try:
        with nullcontext(opened) if opened is not None else h5py.File(path, "r") as file:
            yield file
    except OstiformError as error:
        raise ArtifactError(f"{path}: expected {content}, found that {error}") from error
    except (
        OSError, KeyError, IndexError, ValueError, TypeError, AttributeError, RuntimeError,
        MemoryError, OverflowError,
    ) as error:  # fmt: skip
        reason = str(error.args[0]) if error.args else type(error).__name__
        if isinstance(error, OSError) and error.errno:
            reason = os.strerror(error.errno)
        raise ArtifactError(
            f"{path}: expected {content}, found a missing, foreign or damaged file ({reason}); "
            "make it again or check the path"
        ) from error


def put_facts(group: h5py.Group, parts: Sequence[str]) -> None:
    """Write the attributes that say how to read a group: schema, units, frame, version, parts."""
    group.attrs["schema"] = SCHEMA
    group.attrs["units"] = "mm"
    group.attrs["frame"] = "LPS"
    group.attrs["package_version"] = __version__
    group.attrs.create("parts", list(parts), dtype=TEXT)


def check_schema(group: h5py.Group) -> None:
    """Raise `InputError` if the group was written with a layout that this version cannot read."""
    found = int(group.attrs["schema"])
    if found != SCHEMA:
        raise InputError(f"its schema is {found} where {SCHEMA} can be read")


def put_texts(group: h5py.Group, name: str, texts: Sequence[str]) -> None:
    """Write texts as variable-length UTF-8."""
    group.create_dataset(name, data=np.array(list(texts), dtype=object), dtype=TEXT)


def take_texts(dataset: Any) -> tuple[str, ...]:
    """Read what `put_texts` wrote, or an attribute of texts."""
    return tuple(
        text.decode("utf-8") if isinstance(text, bytes) else str(text)
        for text in np.asarray(dataset).ravel()
    )


def put_ids(group: h5py.Group, ids: Sequence[ShapeId]) -> None:
    """Write who and when: `subject` and `phase` as UTF-8, `time` as a fraction of the cycle."""
    put_texts(group, "subject", [id.subject for id in ids])
    put_texts(group, "phase", [id.phase for id in ids])
    group.create_dataset("time", data=np.array([id.time for id in ids], dtype=np.float64))


def take_ids(group: h5py.Group) -> tuple[ShapeId, ...]:
    """Read what `put_ids` wrote."""
    return tuple(
        ShapeId(subject, phase, float(time))
        for subject, phase, time in zip(
            take_texts(group["subject"]), take_texts(group["phase"]), group["time"], strict=True
        )
    )


def put_shapes(group: h5py.Group, shapes: object) -> None:
    """Write the arrays of shapes in correspondence (`SHAPE_ARRAYS`, attributes of the object)."""
    for name in SHAPE_ARRAYS:
        group.create_dataset(name, data=getattr(shapes, name))


def take_shapes(group: h5py.Group) -> dict[str, Any]:
    """Read what `put_shapes` and `put_ids` wrote, by the names of the attributes."""
    arrays = {name: group[name][:] for name in SHAPE_ARRAYS}
    return {"ids": take_ids(group), **arrays}


def put_loops(group: h5py.Group, loops: Mapping[str, IntArray]) -> None:
    """Write rims as ``loops/<part>/<ostium>``."""
    target = group.create_group("loops", track_order=True)
    for name, loop in loops.items():
        part, _, ostium = name.partition(".")
        if not (part and ostium) or "/" in name:
            raise InputError(
                f'name of an opening: expected "PART.OSTIUM" without a slash, found "{name}"'
            )
        parent = target[part] if part in target else target.create_group(part, track_order=True)
        parent.create_dataset(ostium, data=loop)


def take_loops(group: h5py.Group) -> dict[str, IntArray]:
    """Read what `put_loops` wrote."""
    return {
        f"{part}.{ostium}": loop[:]
        for part, ostia in group["loops"].items()
        for ostium, loop in ostia.items()
    }


def put_mesh(group: h5py.Group, mesh: ModelMesh | Template) -> None:
    """Write triangles, parts and rims."""
    for name in ("faces", "face_part", "part"):
        group.create_dataset(name, data=getattr(mesh, name))
    put_loops(group, mesh.loops)


def put_template(group: h5py.Group, template: Template) -> None:
    """Write a template: triangles, parts, rims, nested levels, and its points on the sphere."""
    put_mesh(group, template)
    group.create_dataset("template_points", data=template.points)
    group.create_dataset("sphere", data=template.sphere)
    group.create_dataset("curve", data=template.curve)
    group.attrs.create("curves", list(template.curves), dtype=TEXT, shape=(len(template.curves),))
    levels = group.create_group("levels")
    for number, level in enumerate(template.levels):
        stored = levels.create_group(str(number))
        stored.create_dataset("index", data=level.index)
        stored.create_dataset("faces", data=level.faces)
        stored.create_dataset("face_part", data=level.face_part)


def take_template(group: h5py.Group) -> Template:
    """Read what `put_template` wrote into a group with the attributes of `put_facts`."""
    levels = group["levels"]
    return Template(
        points=group["template_points"][:],
        sphere=group["sphere"][:],
        part=group["part"][:],
        faces=group["faces"][:],
        face_part=group["face_part"][:],
        parts=take_texts(group.attrs["parts"]),
        curve=group["curve"][:],
        curves=take_texts(group.attrs["curves"]),
        loops=take_loops(group),
        levels=tuple(
            TemplateLevel(*(levels[name][key][:] for key in ("index", "faces", "face_part")))
            for name in sorted(levels, key=int)
        ),
    )
