"""Landmarks as scalismo keeps them: JSON with names, positions and uncertainties."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.atomic import atomically
from ostiform.errors import InputError
from ostiform.values import Axes, value


@value
class Landmark:
    """A named point, and how well it is known.

    Attributes
    ----------
    name : str
    position : (3,) float64, mm
    covariance : (3, 3) float64, mm^2, or None
        None where the file states no uncertainty.
    """

    name: str
    position: Annotated[FloatArray, Axes(3)]
    covariance: Annotated[FloatArray, Axes(3, 3)] | None = None


def read_landmarks(path: Path) -> tuple[Landmark, ...]:
    """Read landmarks: a list of ``{"id", "coordinates", "uncertainty"?}``.

    An uncertainty has three standard deviations ``stddevs`` along three orthonormal directions
    ``pcvectors``.

    Raises
    ------
    InputError
        If the file is missing, damaged or of another kind, or a name is there twice.
    """
    try:
        content = json.loads(path.read_bytes())
    except FileNotFoundError:
        raise InputError(f"{path}: expected landmarks, found no such file") from None
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{path}: expected landmarks as JSON, found {error}") from None
    if not isinstance(content, list) or not content:
        raise InputError(
            f"{path}: expected a list of landmarks, found "
            f"{'an empty list' if content == [] else type(content).__name__}"
        )
    found = [_landmark(path, number, item) for number, item in enumerate(content)]
    names = [landmark.name for landmark in found]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"{path}: expected every landmark once, found {name} twice")
    return tuple(found)


def write_landmarks(path: Path, landmarks: Sequence[Landmark]) -> None:
    """Write landmarks so that scalismo reads them.

    Raises
    ------
    ArtifactError
        If the file cannot be written.
    """
    items = []
    for landmark in landmarks:
        item: dict[str, Any] = {"id": landmark.name, "coordinates": landmark.position.tolist()}
        if landmark.covariance is not None:
            variances, vectors = np.linalg.eigh(landmark.covariance)
            item["uncertainty"] = {
                "stddevs": np.sqrt(np.maximum(variances[::-1], 0.0)).tolist(),
                "pcvectors": vectors[:, ::-1].T.tolist(),
            }
        items.append(item)
    with atomically(path) as partial:
        partial.write_text(json.dumps(items, indent=1, ensure_ascii=False) + "\n", "utf-8")


def _landmark(path: Path, number: int, item: Any) -> Landmark:
    label = f"{path}, landmark {number + 1}"
    if not isinstance(item, Mapping) or not {"id", "coordinates"} <= item.keys():
        raise InputError(f'{label}: expected "id" and "coordinates", found {str(item)[:60]}')
    try:
        position = np.array(item["coordinates"], dtype=np.float64)
        covariance = None
        if item.get("uncertainty") is not None:
            spread = np.array(item["uncertainty"]["stddevs"], dtype=np.float64)  # (3,)
            directions = np.array(item["uncertainty"]["pcvectors"], dtype=np.float64)  # (3, 3)
            covariance = (directions.T * spread**2) @ directions
        return Landmark(str(item["id"]), position, covariance)
    except (TypeError, ValueError, KeyError) as error:
        raise InputError(
            f"{label} ({item['id']}): expected three coordinates, and an uncertainty of three "
            f"deviations along three directions if any, found {error}"
        ) from None
