"""Shapes prepared for sampling as files that open at once: arrays that are mapped, not read.

Layout: eight bytes with the length of a JSON text, the text, then every array from a multiple of
64 bytes on. The operating system keeps in memory what is used, for all processes together.
"""

import json
import math
import mmap
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.correspondence import ComponentSampler, CurveSampler, ShapeSampler
from ostiform.domain import BaseDomain, Circle, Sphere
from ostiform.errors import ArtifactError
from ostiform.surface import SphereLocator

SCHEMA = 1
ALIGNMENT = 64
LENGTH_BYTES = 8
KINDS = ("float64", "int64")

Facts = dict[str, Any]


def write_sampler(path: Path, shape: ShapeSampler) -> None:
    """Write a shape prepared for sampling, without the user's landmarks; every bit is kept."""
    arrays: list[np.ndarray] = []
    facts = {
        "kind": "sampler",
        "schema": SCHEMA,
        "components": [_component_facts(part, arrays) for part in shape.components],
    }
    facts["arrays"] = _places(arrays)
    text = json.dumps(facts).encode()
    with path.open("wb") as stream:
        stream.write(len(text).to_bytes(LENGTH_BYTES, "little"))
        stream.write(text)
        for array in arrays:
            stream.write(b"\0" * (-stream.tell() % ALIGNMENT))
            stream.write(np.ascontiguousarray(array).data)


def open_sampler(path: Path, domain: BaseDomain) -> ShapeSampler:
    """Return what `write_sampler` wrote, its arrays mapped from the file.

    Parameters
    ----------
    path : Path
    domain : BaseDomain
        That the shape was prepared for.

    Raises
    ------
    ArtifactError
        If the file is missing, damaged or of another kind.
    """
    try:
        with path.open("rb") as stream:
            # Private, so that arrays are writable or not as they were: kernels tell them apart.
            mapped = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_COPY)
        length = int.from_bytes(mapped[:LENGTH_BYTES], "little")
        facts: Facts = json.loads(mapped[LENGTH_BYTES : LENGTH_BYTES + length])
        if (facts["kind"], facts["schema"]) != ("sampler", SCHEMA):
            raise ValueError(f"a file of {facts['kind']} in layout {facts['schema']}")
        arrays = _mapped_arrays(mapped, _after(LENGTH_BYTES + length), facts["arrays"])
        return ShapeSampler(
            tuple(
                _component(own, sphere, arrays)
                for own, sphere in zip(facts["components"], domain.spheres, strict=True)
            )
        )
    except (OSError, ValueError, KeyError, TypeError, IndexError, RecursionError) as error:
        raise ArtifactError(
            f"{path}: expected a shape prepared for sampling, found "
            f"{str(error)[:200] or type(error).__name__}; run the same command again"
        ) from error


def _component_facts(part: ComponentSampler, arrays: list[np.ndarray]) -> Facts:
    locator = part.locator

    def put(array: np.ndarray) -> int:
        arrays.append(array)
        return len(arrays) - 1

    return {
        "locator": [put(a) for a in (locator.points, locator.faces, locator.twins, locator.start)],
        "n_faces": locator.n_faces,
        "mesh": [put(a) for a in (part.directions, part.vertices, part.faces)],
        "curves": {
            name: {
                "first_angle": curve.first_angle,
                "sign": curve.sign,
                "arrays": [put(a) for a in (curve.positions, curve.points, curve.frame)],
            }
            for name, curve in part.curves.items()
        },
    }


def _places(arrays: list[np.ndarray]) -> list[Facts]:
    """Return kind, shape, offset from the first array and access of every array."""
    places, offset = [], 0
    for array in arrays:
        places.append(
            {
                "dtype": str(array.dtype),
                "shape": array.shape,
                "offset": offset,
                "writable": array.flags.writeable,
            }
        )
        offset = _after(offset + array.nbytes)
    return places


def _after(position: int) -> int:
    return position + -position % ALIGNMENT


def _mapped_arrays(mapped: mmap.mmap, first: int, places: list[Facts]) -> list[np.ndarray]:
    arrays = []
    for place in places:
        if place["dtype"] not in KINDS or min(place["shape"], default=0) < 0:
            raise ValueError(f"an array of {place['dtype']}")
        array = np.frombuffer(
            mapped,
            np.dtype(place["dtype"]),
            math.prod(place["shape"]),
            first + place["offset"],
        ).reshape(place["shape"])
        array.flags.writeable = bool(place["writable"])
        arrays.append(array)
    return arrays


def _component(facts: Facts, sphere: Sphere, arrays: list[np.ndarray]) -> ComponentSampler:
    points, faces, twins, start = (arrays[index] for index in facts["locator"])
    directions, vertices, own_faces = (arrays[index] for index in facts["mesh"])
    circles: Mapping[str, Circle] = sphere.curves
    return ComponentSampler(
        name=sphere.name,
        locator=SphereLocator(points, faces, twins, int(facts["n_faces"]), start),
        directions=directions,
        vertices=vertices,
        faces=own_faces,
        curves={
            name: _curve(own, circles[name], [arrays[index] for index in own["arrays"]])
            for name, own in facts["curves"].items()
        },
    )


def _curve(facts: Facts, circle: Circle, arrays: list[FloatArray]) -> CurveSampler:
    positions, points, frame = arrays
    return CurveSampler(
        circle=circle,
        first_angle=float(facts["first_angle"]),
        sign=float(facts["sign"]),
        positions=positions,
        points=points,
        frame=frame,
    )
