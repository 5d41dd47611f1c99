"""Labels of landmarks, and the points of the model that they mean."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.errors import InputError
from ostiform.fitting.prior import FitPrior
from ostiform.fitting.types import LandmarkTarget

NUMBERED = re.compile(r"^(?P<name>.+?)[-_ ](?P<number>\d+)$")


@dataclass(frozen=True, slots=True, eq=False)
class Labelled:
    """Landmarks by what they mean on the model.

    Attributes
    ----------
    points : (n,) int64
        Points of the prior (model points, or centres of openings).
    positions : (n, 3) float64, mm
    on_rims : mapping of str to (m, 3) float64
        Positions somewhere on the rim of an opening.
    """

    points: IntArray
    positions: FloatArray
    on_rims: Mapping[str, FloatArray]


def labelled(prior: FitPrior, targets: Sequence[LandmarkTarget]) -> Labelled:
    """Return what the labels of landmarks mean on a model.

    Raises
    ------
    InputError
        If a label is neither a point nor an opening of the model.
    """
    count = len(prior.model.mean)
    points: list[int] = []
    positions: list[FloatArray] = []
    rims: dict[str, list[FloatArray]] = {}
    for target in targets:
        for label, position in zip(target.labels, target.positions, strict=True):
            numbered = NUMBERED.match(label)
            if label in prior.centres:
                points.append(prior.centres[label])
                positions.append(position)
            elif label.isdecimal() and int(label) < count:
                points.append(int(label))
                positions.append(position)
            elif numbered and numbered["name"] in prior.centres:
                rims.setdefault(numbered["name"], []).append(position)
            else:
                raise InputError(
                    f'landmark "{label}": expected a point number from 0 to {count - 1} or one of '
                    f"the openings {', '.join(prior.centres) or '(none)'} (with -1, -2, ... for "
                    "points on its rim)"
                )
    return Labelled(
        np.array(points, dtype=np.int64),
        np.array(positions).reshape(-1, 3),
        {name: np.array(rows) for name, rows in rims.items()},
    )
