"""A stage whose results change has another version, so that no folder keeps what it made before."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import ArrayLike

from ostiform.artifacts import load
from ostiform.embedding import Embeddings
from ostiform.evaluation import read_evaluation
from ostiform.model import read_correspondence, read_model
from ostiform.pipeline.prepare import read_poses
from ostiform.pipeline.prepared import read_prepared
from ostiform.pipeline.store import Store
from ostiform.pipeline.versions import VERSIONS
from ostiform.study import OpenedShape
from ostiform.surface import read_mesh

pytestmark = pytest.mark.xdist_group("small_results")

STORED = {
    "demonstration": (2, 34.7582),
    "ingest": (3, 34.433681),
    "prepare": (3, 34.834997),
    "domain": (2, 1.9248165),
    "embedding": (2, 1.3419869),
    "correspondence": (1, 35.487142),
    "model": (2, 2.9177778),
    "evaluation": (2, 1.9877668),
}
"""Version of every stage and a number of its results, in the order of the stages."""

LAST_DIGITS = 1e-5
"""Relative; other libraries round otherwise, and sweeps carry that on."""


def spread(arrays: Iterable[ArrayLike]) -> float:
    """Root mean square of all entries, each weighted by its place, so that order counts."""
    flat = np.concatenate([np.ravel(array) for array in arrays]).astype(np.float64)
    return float(np.sqrt((flat**2 * (1.0 + np.arange(len(flat)) / len(flat))).mean()))


def numbers(study: Path, results: Path) -> dict[str, float]:
    """Return a number of the results of every stage."""
    files = sorted((study.parent / "shapes").glob("*.vtp"))
    opened = [load(path, OpenedShape) for path in sorted((results / "opened").iterdir())]
    prepared = [read_prepared(path) for path in sorted((results / "shapes").iterdir())]
    maps = [load(path, Embeddings) for path in sorted((results / "embeddings").iterdir())]
    measured = read_evaluation(results / "optimal" / "evaluation.json")
    assert measured.generalisation is not None
    return {
        "demonstration": spread(read_mesh(path).vertices for path in files),
        "ingest": spread(part.vertices for one in opened for part in one.parts.values()),
        "prepare": spread(c.vertices[c.faces] for one in prepared for c in one.components),
        "domain": spread(pose.transform for pose in read_poses(Store(results))),
        "embedding": spread(e.directions for one in maps for e in one)
        + spread(e.directions[:, 2] ** 3 for one in maps for e in one),
        "correspondence": spread([read_correspondence(results / "correspondence.h5").points]),
        "model": spread([read_model(results / "model.h5").model.variances]),
        "evaluation": spread([measured.generalisation.surface_mean]),
    }


def difference(found: dict[str, float], stored: dict[str, tuple[int, float]]) -> str:
    """Return what to do about the first stage whose results are not those stored; "" if none."""
    for stage, (version, number) in stored.items():
        if VERSIONS[stage] != version:
            return (
                f"stage {stage} has version {VERSIONS[stage]}, not {version}: store the numbers "
                f"found now, its own and those of the stages after it, which it feeds: {found}"
            )
        if abs(found[stage] - number) > LAST_DIGITS * number:
            return (
                f"results of stage {stage} changed, {found[stage]:.8g} where {number:.8g} is "
                "stored: bump its version"
            )
    return ""


def test_results_of_a_small_study_change_only_with_a_version(small_study, small_results):
    assert difference(numbers(small_study, small_results), STORED) == ""


def test_a_change_of_results_or_of_a_version_is_noticed(monkeypatch):
    found = {stage: number for stage, (_, number) in STORED.items()}
    assert difference(found, STORED) == ""
    changed = found | {"embedding": found["embedding"] * (1.0 + 10.0 * LAST_DIGITS)}
    assert "results of stage embedding changed" in difference(changed, STORED)
    assert difference(changed, STORED).endswith("bump its version")
    monkeypatch.setitem(VERSIONS, "embedding", VERSIONS["embedding"] + 1)
    assert "stage embedding has version" in difference(changed, STORED)
