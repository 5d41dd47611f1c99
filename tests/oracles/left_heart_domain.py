"""Outlines and hole positions of left hearts, as the layout of a base domain takes them."""

import numpy as np

from ostiform.domain import ComponentOutline, ConformalHoles, lay_out
from ostiform.surface import Seam

MITRAL = Seam("LV.mitral", "LA.mitral")
VEINS = ("LA.RSPV", "LA.RIPV", "LA.LSPV", "LA.LIPV")


def at(latitude, longitude):
    lat, lon = np.radians([latitude, longitude])
    return np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])


def outline(parts, rims, seams=(), areas=None):
    return ComponentOutline(
        "+".join(parts),
        tuple(parts),
        areas or dict.fromkeys(parts, 10_000.0),
        dict.fromkeys(rims, 40.0) if not isinstance(rims, dict) else rims,
        dict.fromkeys(seams, 90.0),
    )


def left_heart_outline():
    return outline(("LV", "LA"), ("LV.aortic", *VEINS), (MITRAL,))


def left_heart_holes(rng=None, **changes):
    directions = {
        "LV.aortic": at(-40, 30),
        "LA.RSPV": at(55, 20),
        "LA.RIPV": at(40, 60),
        "LA.LSPV": at(60, 200),
        "LA.LIPV": at(35, 160),
    } | {name.replace("_", "."): value for name, value in changes.items()}
    if rng is not None:
        directions = {name: value + 0.05 * rng.normal(size=3) for name, value in directions.items()}
        directions = {name: value / np.linalg.norm(value) for name, value in directions.items()}
    radii = {name: np.radians(0.2) for name in VEINS} | {"LV.aortic": np.radians(8.0)}
    return ConformalHoles(directions, radii)


def chain(second_seam, **explicit):
    """Three parts in a row; C hangs on B by the second seam."""
    seams = (Seam("A.b", "B.a"), second_seam)
    one = outline(("A", "B", "C"), ("A.rim", "B.rim", "C.rim"), seams)
    holes = ConformalHoles(
        {
            "A.rim": at(-60, 0),
            "B.rim": at(40, 180),
            "C.rim": at(50, 20),
            second_seam.first: at(50, 10),
        },
        {"A.rim": 0.01, "B.rim": 0.01, "C.rim": 0.01, second_seam.first: 0.2},
    )
    (sphere,) = lay_out([[one]], [[holes]], circles=explicit).spheres
    return sphere
