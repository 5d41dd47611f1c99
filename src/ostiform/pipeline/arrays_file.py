"""Shapes and embeddings as ``.npz`` files: plain arrays and one JSON text, never pickle."""

import json
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from ostiform.arrays import IntArray
from ostiform.embedding import Certificate, Distortion, Embedding, EmbeddingState, SeamJump
from ostiform.errors import ArtifactError
from ostiform.study import Shape, ShapeId
from ostiform.surface import Component, Seam, Surface

__all__ = ["read_embeddings", "read_shape", "write_embeddings", "write_shape"]

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
    }
    _write(path, arrays, facts)


def read_shape(path: Path) -> Shape:
    """Read what `write_shape` wrote.

    Raises
    ------
    ArtifactError
        If the file is missing, damaged or of another kind.
    """
    arrays, facts = _read(path, "shape")
    parts = {
        name: Surface(
            arrays[f"{index}.vertices"],
            arrays[f"{index}.faces"],
            _get_loops(arrays, f"{index}.loop", loops),
        )
        for index, (name, loops) in enumerate(facts["parts"])
    }
    return Shape(ShapeId(*facts["id"]), parts, tuple(Seam(*seam) for seam in facts["seams"]))


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
    arrays, facts = _read(path, "embeddings")
    return tuple(
        _embedding(arrays, index, stored) for index, stored in enumerate(facts["components"])
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
    text = np.frombuffer(json.dumps(facts, default=float).encode(), np.uint8)
    with path.open("wb") as stream:
        np.savez(stream, facts=text, **arrays)  # type: ignore[arg-type]


def _read(path: Path, kind: str) -> tuple[Arrays, Facts]:
    try:
        with np.load(path, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
        facts: Facts = json.loads(arrays.pop("facts").tobytes())
        if facts["kind"] != kind:
            raise ValueError(f"a file of {facts['kind']}")
    except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
        raise ArtifactError(
            f"{path}: expected the {kind} that an earlier stage wrote, found {error}; "
            "run `ostiform build` to make it again"
        ) from error
    for array in arrays.values():
        array.flags.writeable = False
    return arrays, facts
