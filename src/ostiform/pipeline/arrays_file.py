"""Intermediate results as ``.npz`` files: plain arrays and one JSON text, never pickle.

They are shapes, embeddings, and where the sweeps of a level stand.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from ostiform.arrays import IntArray
from ostiform.correspondence import (
    Checkpoint,
    LevelStatus,
    Population,
    Steps,
    SweepRecord,
    WarpState,
)
from ostiform.embedding import Certificate, Distortion, Embedding, EmbeddingState, SeamJump
from ostiform.errors import ArtifactError
from ostiform.study import Shape, ShapeId
from ostiform.surface import Component, Seam, Surface

SCHEMA = 1

Facts = dict[str, Any]
Arrays = dict[str, np.ndarray]


def write_shape(path: Path, shape: Shape) -> None:
    """Write a shape; positions keep every bit."""
    arrays: Arrays = {}
    for index, surface in enumerate(shape.parts.values()):
        arrays[f"{index}.vertices"] = surface.vertices
        arrays[f"{index}.faces"] = surface.faces
        _put_loops(arrays, f"{index}.loop", surface.loops)
    facts = {
        "kind": "shape",
        "id": [shape.id.subject, shape.id.phase, shape.id.time],
        "parts": [[name, list(surface.loops)] for name, surface in shape.parts.items()],
        "seams": [[seam.first, seam.second] for seam in shape.seams],
        "repairs": list(shape.repairs),
    }
    _write(path, arrays, facts)


def read_shape(path: Path) -> Shape:
    """Read what `write_shape` wrote.

    Raises
    ------
    ArtifactError
        If the file is missing, damaged or of another kind.
    """
    with _reading(path, "shape") as (arrays, facts):
        parts = {
            name: Surface(
                arrays[f"{index}.vertices"],
                arrays[f"{index}.faces"],
                _get_loops(arrays, f"{index}.loop", loops),
            )
            for index, (name, loops) in enumerate(facts["parts"])
        }
        return Shape(
            ShapeId(*facts["id"]),
            parts,
            tuple(Seam(*seam) for seam in facts["seams"]),
            tuple(facts.get("repairs", ())),
        )


def write_embeddings(path: Path, embeddings: Sequence[Embedding]) -> None:
    """Write the embeddings of one shape, one per component; states keep single precision."""
    arrays: Arrays = {}
    components = []
    for index, embedding in enumerate(embeddings):
        component = embedding.component
        arrays[f"{index}.vertices"] = component.vertices
        arrays[f"{index}.faces"] = component.faces
        arrays[f"{index}.face_part"] = component.face_part
        arrays[f"{index}.directions"] = embedding.directions
        _put_loops(arrays, f"{index}.rim", component.rims)
        _put_loops(arrays, f"{index}.seam", component.seams)
        for number, state in enumerate(embedding.states):
            arrays[f"{index}.state{number}"] = state.directions.astype(np.float32)
        components.append(
            {
                "name": component.name,
                "parts": component.parts,
                "rims": list(component.rims),
                "seams": [[seam.first, seam.second] for seam in component.seams],
                "rotations": dict(embedding.rotations),
                "certificate": _certificate_facts(embedding.certificate),
                "distortion": _distortion_facts(embedding.distortion),
                "states": [[s.name, s.flipped, s.seconds] for s in embedding.states],
                "method": embedding.method,
                "seconds": embedding.seconds,
            }
        )
    _write(path, arrays, {"kind": "embeddings", "components": components})


def read_embeddings(path: Path) -> tuple[Embedding, ...]:
    """Read what `write_embeddings` wrote.

    Raises
    ------
    ArtifactError
        If the file is missing, damaged or of another kind.
    """
    with _reading(path, "embeddings") as (arrays, facts):
        return tuple(
            _embedding(arrays, index, stored) for index, stored in enumerate(facts["components"])
        )


def write_checkpoint(path: Path, state: Checkpoint) -> None:
    """Write where the sweeps of a level stand; every bit is kept."""
    states = state.population.states
    arrays = {
        "directions": np.stack([one.directions for one in states]),
        "landmarks": state.population.landmarks,
        "damping": np.array([one.damping for one in states]),
        "transforms": state.population.transforms,
        "coefficients": state.steps.coefficients,
        "fastest": state.steps.fastest,
    }
    facts = {
        "kind": "checkpoint",
        "level": state.level,
        "records": [asdict(record) for record in state.records],
        "status": None if state.status is None else state.status.name,
    }
    _write(path, arrays, facts)


def read_checkpoint(path: Path) -> Checkpoint:
    """Read what `write_checkpoint` wrote.

    Raises
    ------
    ArtifactError
        If the file is missing, damaged or of another kind.
    """
    with _reading(path, "checkpoint") as (arrays, facts):
        columns = (arrays["directions"], arrays["landmarks"], arrays["damping"])
        states = tuple(
            # Arrays of their own, as sweeps make them: views could be summed in another order.
            WarpState(directions.copy(), landmarks.copy(), float(damping))
            for directions, landmarks, damping in zip(*columns, strict=True)
        )
        return Checkpoint(
            int(facts["level"]),
            Population(states, arrays["transforms"].copy()),
            Steps(arrays["coefficients"], arrays["fastest"]),
            tuple(SweepRecord(**record) for record in facts["records"]),
            None if facts["status"] is None else LevelStatus[facts["status"]],
        )


def _embedding(arrays: Arrays, index: int, facts: Facts) -> Embedding:
    seams = [Seam(*seam) for seam in facts["seams"]]
    component = Component(
        facts["name"],
        tuple(facts["parts"]),
        arrays[f"{index}.vertices"],
        arrays[f"{index}.faces"],
        arrays[f"{index}.face_part"],
        _get_loops(arrays, f"{index}.rim", facts["rims"]),
        dict(zip(seams, _get_loops(arrays, f"{index}.seam", seams).values(), strict=True)),
    )
    certificate = facts["certificate"]
    return Embedding(
        component,
        arrays[f"{index}.directions"],
        facts["rotations"],
        Certificate(
            **{
                **certificate,
                "hole_order": tuple(certificate["hole_order"]),
                "problems": tuple(certificate["problems"]),
            }
        ),
        _distortion(facts["distortion"]),
        tuple(
            EmbeddingState(name, arrays[f"{index}.state{number}"], flipped, seconds)
            for number, (name, flipped, seconds) in enumerate(facts["states"])
        ),
        facts["method"],
        facts["seconds"],
    )


def _certificate_facts(certificate: Certificate) -> Facts:
    names = ("flipped", "degenerate", "area_defect", "rim_error", "hole_order", "problems")
    return {name: getattr(certificate, name) for name in names} | {"twist": dict(certificate.twist)}


def _distortion_facts(distortion: Distortion) -> Facts:
    names = ("angle_mean", "angle_median", "angle_p99", "area_p01", "area_p99")
    return {name: getattr(distortion, name) for name in names} | {
        "circle_ratio": dict(distortion.circle_ratio),
        "seam_jump": [
            [[seam.first, seam.second], asdict(jump)] for seam, jump in distortion.seam_jump.items()
        ],
    }


def _distortion(facts: Facts) -> Distortion:
    jumps = {Seam(*seam): SeamJump(**jump) for seam, jump in facts["seam_jump"]}
    return Distortion(**{**facts, "seam_jump": jumps})


def _put_loops(arrays: Arrays, prefix: str, loops: Mapping[Any, IntArray]) -> None:
    for number, loop in enumerate(loops.values()):
        arrays[f"{prefix}{number}"] = loop


def _get_loops(arrays: Arrays, prefix: str, names: Sequence[Any]) -> dict[Any, IntArray]:
    return {name: arrays[f"{prefix}{number}"] for number, name in enumerate(names)}


def _write(path: Path, arrays: Arrays, facts: Facts) -> None:
    text = json.dumps({"schema": SCHEMA, **facts}, default=float)
    with path.open("wb") as stream:
        np.savez(stream, facts=np.frombuffer(text.encode(), np.uint8), **arrays)  # type: ignore[arg-type]


@contextmanager
def _reading(path: Path, kind: str) -> Iterator[tuple[Arrays, Facts]]:
    """Give the arrays and facts of a file; whatever they lack is the file's fault."""
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
        facts: Facts = json.loads(arrays.pop("facts").tobytes())
        found = facts["kind"], facts.get("schema", SCHEMA)
        if found != (kind, SCHEMA):
            raise ValueError(f"a file of {found[0]} in layout {found[1]}")
        for array in arrays.values():
            array.flags.writeable = False
        yield arrays, facts
    except Exception as error:
        # The readers of zip files and of array headers let whatever they meet escape.
        raise ArtifactError(
            f"{path}: expected the {kind} that an earlier stage wrote, found "
            f"{str(error)[:200] or type(error).__name__}; run `ostiform build` to make it again"
        ) from error
