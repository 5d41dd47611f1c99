"""A base domain as plain dictionaries and lists, and back, bit for bit."""

from collections.abc import Mapping
from typing import Any

from ostiform.domain.types import NORTH, BaseDomain, Circle, Sphere
from ostiform.errors import ArtifactError, InputError
from ostiform.surface import Seam

SCHEMA = 1


def domain_to_json(domain: BaseDomain) -> dict[str, Any]:
    """Return a base domain as JSON-ready values; angles in radians, on the component sphere."""
    return {
        "schema": SCHEMA,
        "spheres": [
            {
                "name": sphere.name,
                "parts": list(sphere.parts),
                "pole": sphere.pole,
                "rims": {name: _circle_to_json(circle) for name, circle in sphere.rims.items()},
                "seams": [
                    {"first": seam.first, "second": seam.second, **_circle_to_json(circle)}
                    for seam, circle in sphere.seams.items()
                ],
                "handles": [
                    {"first": seam.first, "second": seam.second} for seam in sphere.handles
                ],
                "up": [float(x) for x in sphere.up],
            }
            for sphere in domain.spheres
        ],
    }


def domain_from_json(record: Mapping[str, Any]) -> BaseDomain:
    """Return the base domain that `domain_to_json` wrote.

    Raises
    ------
    ArtifactError
        If the schema is another, or a value is missing or of the wrong kind.
    """
    schema = record.get("schema") if isinstance(record, Mapping) else None
    if schema != SCHEMA:
        raise ArtifactError(
            f"base domain: expected a record of schema {SCHEMA}, found {schema}: lay it out again "
            "with this version"
        )
    try:
        return BaseDomain(tuple(_sphere_from_json(sphere) for sphere in record["spheres"]))
    except (KeyError, TypeError, ValueError, AttributeError, InputError) as error:
        raise ArtifactError(
            f"base domain: expected a record as Ostiform writes it, found a damaged one "
            f"({type(error).__name__}: {error}): lay it out again"
        ) from error


def _circle_to_json(circle: Circle) -> dict[str, Any]:
    return {
        "center": [float(x) for x in circle.center],
        "radius": float(circle.radius),
        "phase": float(circle.phase),
    }


def _circle_from_json(record: Mapping[str, Any]) -> Circle:
    return Circle(record["center"], float(record["radius"]), float(record["phase"]))


def _sphere_from_json(record: Mapping[str, Any]) -> Sphere:
    pole = record["pole"]
    return Sphere(
        name=str(record["name"]),
        parts=tuple(str(part) for part in record["parts"]),
        rims={str(name): _circle_from_json(circle) for name, circle in record["rims"].items()},
        seams={
            Seam(str(seam["first"]), str(seam["second"])): _circle_from_json(seam)
            for seam in record["seams"]
        },
        pole=None if pole is None else str(pole),
        handles=tuple(Seam(str(seam["first"]), str(seam["second"])) for seam in record["handles"]),
        up=record.get("up", NORTH),
    )
