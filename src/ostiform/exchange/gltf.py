"""Writing glTF 2.0 (``.glb``): one mesh, its morph targets, and animations of their weights.

Positions are those of the program, millimetres in LPS. The only node turns and scales them into
what the format asks for: metres, up is +Y, the front (the patient's chest) looks along +Z.
The layout follows the Khronos glTF 2.0 specification (ISO/IEC 12113:2022).
"""

import json
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.atomic import atomically
from ostiform.errors import InputError
from ostiform.surface import vertex_normals
from ostiform.values import Axes, value

FLOAT, UNSIGNED_INT = 5126, 5125
ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963
GLB_MAGIC, JSON_CHUNK, BINARY_CHUNK = 0x46546C67, 0x4E4F534A, 0x004E4942

METRES_PER_MM = 0.001
LPS_TO_GLTF = (-float(np.sqrt(0.5)), 0.0, 0.0, float(np.sqrt(0.5)))
"""Quaternion (x, y, z, w) of the turn by -90 degrees about x: superior becomes +Y."""

COLOURS = ((0.75, 0.28, 0.25), (0.30, 0.48, 0.70), (0.85, 0.65, 0.30), (0.40, 0.62, 0.45))
"""Of the parts, linear RGB; used again from the start where there are more parts."""


@dataclass(frozen=True, slots=True, eq=False)
class SceneMesh:
    """What is shown before any weight is set.

    Attributes
    ----------
    vertices : (P, 3) float64, mm
    faces : (F, 3) int64
        At least one triangle.
    face_part : (F,) int64
        Index into `parts`; every part becomes a primitive with its own material.
    parts : tuple of str
    """

    vertices: FloatArray
    faces: IntArray
    face_part: IntArray
    parts: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class MorphTarget:
    """A displacement that a viewer adds in any amount.

    Attributes
    ----------
    name : str
    displacement : (P, 3) float64, mm
        At weight 1.
    """

    name: str
    displacement: FloatArray


@value
class WeightAnimation:
    """The weights of all targets over time, linear between the given times.

    Attributes
    ----------
    name : str
    seconds : (T,) float64
        Increasing from 0.
    weights : (T, K) float64
    """

    name: str
    seconds: Annotated[FloatArray, Axes("T")]
    weights: Annotated[FloatArray, Axes("T", "K")]

    def __post_init__(self) -> None:
        """Check what annotations cannot say."""
        if not len(self.seconds) or self.seconds[0] != 0.0 or (np.diff(self.seconds) <= 0.0).any():
            raise InputError(
                f"animation {self.name}: expected increasing times from 0 s, found "
                f"{np.array2string(self.seconds, threshold=6, precision=3)}"
            )


def write_glb(
    path: Path,
    mesh: SceneMesh,
    targets: Sequence[MorphTarget],
    animations: Sequence[WeightAnimation],
    facts: Mapping[str, Any] | None = None,
) -> None:
    """Write a mesh with morph targets and animations as one binary glTF file.

    Parameters
    ----------
    path : Path
        Ends in ``.glb``.
    mesh : SceneMesh
    targets : sequence of MorphTarget
    animations : sequence of WeightAnimation
        Each sets the weight of every target.
    facts : mapping, optional
        Values that JSON can hold, kept as the mesh's ``extras``.

    Raises
    ------
    InputError
        If the name ends otherwise, there is no triangle, or the arrays do not fit each other.
    ArtifactError
        If the file cannot be written.
    """
    if path.suffix.lower() != ".glb":
        raise InputError(f"{path}: expected a name ending in .glb, found {path.suffix or 'none'}")
    content = glb_bytes(mesh, targets, animations, facts)
    with atomically(path) as partial:
        partial.write_bytes(content)


def glb_bytes(
    mesh: SceneMesh,
    targets: Sequence[MorphTarget],
    animations: Sequence[WeightAnimation],
    facts: Mapping[str, Any] | None = None,
) -> bytes:
    """Return the bytes of a binary glTF file; equal input gives equal bytes.

    Parameters and errors are those of `write_glb`.
    """
    _check(mesh, targets, animations)
    buffer = _Buffer(bytearray(), [], [])
    attributes = _shading(buffer, mesh.vertices, mesh.faces)
    base = _normals(mesh.vertices, mesh.faces)
    morphs = []
    for target in targets:
        moved = _normals(mesh.vertices + target.displacement, mesh.faces)
        morphs.append(
            {
                "POSITION": buffer.vectors(target.displacement, bounds=True),
                "NORMAL": buffer.vectors(moved - base),
            }
        )
    primitives = []
    for number, part in enumerate(mesh.parts):
        corners = mesh.faces[mesh.face_part == number]
        if not len(corners):
            continue
        primitive: dict[str, Any] = {
            "attributes": attributes,
            "indices": buffer.indices(corners),
            "material": number,
            "extras": {"part": part},
        }
        if morphs:
            primitive["targets"] = morphs
        primitives.append(primitive)
    shape: dict[str, Any] = {
        "name": "mean",
        "primitives": primitives,
        "extras": {**(facts or {}), "targetNames": [target.name for target in targets]},
    }
    if morphs:
        shape["weights"] = [0.0] * len(morphs)
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "ostiform"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [
            {
                "name": "model",
                "mesh": 0,
                "rotation": list(LPS_TO_GLTF),
                "scale": [METRES_PER_MM] * 3,
            }
        ],
        "meshes": [shape],
        "materials": [_material(number, part) for number, part in enumerate(mesh.parts)],
    }
    if animations:
        document["animations"] = [_animation(buffer, animation) for animation in animations]
    document |= {
        "accessors": buffer.accessors,
        "bufferViews": buffer.views,
        "buffers": [{"byteLength": len(buffer.content)}],
    }
    return _packed(document, bytes(buffer.content))


@dataclass(frozen=True, slots=True, eq=False)
class _Buffer:
    """The binary chunk, and the accessors and views of what was put into it."""

    content: bytearray
    accessors: list[dict[str, Any]]
    views: list[dict[str, Any]]

    def vectors(self, values: FloatArray, bounds: bool = False) -> int:
        """Put vertex attributes (P, 3) and return their accessor."""
        single = np.ascontiguousarray(values, dtype="<f4")
        limits = {"min": single.min(axis=0), "max": single.max(axis=0)} if bounds else {}
        return self._put(single, "VEC3", FLOAT, ARRAY_BUFFER, limits)

    def indices(self, faces: IntArray) -> int:
        """Put triangles (F, 3) and return their accessor."""
        return self._put(faces.astype("<u4").ravel(), "SCALAR", UNSIGNED_INT, ELEMENT_ARRAY_BUFFER)

    def scalars(self, values: FloatArray, bounds: bool = False) -> int:
        """Put numbers (n,) that no vertex refers to and return their accessor."""
        single = np.ascontiguousarray(values, dtype="<f4").ravel()
        limits = {"min": single[[single.argmin()]], "max": single[[single.argmax()]]}
        return self._put(single, "SCALAR", FLOAT, None, limits if bounds else {})

    def _put(
        self,
        values: np.ndarray,
        kind: str,
        component: int,
        target: int | None,
        limits: Mapping[str, np.ndarray] | None = None,
    ) -> int:
        view = {"buffer": 0, "byteOffset": len(self.content), "byteLength": values.nbytes}
        self.views.append(view | ({"target": target} if target is not None else {}))
        self.content.extend(values.tobytes())
        self.accessors.append(
            {
                "bufferView": len(self.views) - 1,
                "componentType": component,
                "count": len(values),
                "type": kind,
                **{name: [float(v) for v in found] for name, found in (limits or {}).items()},
            }
        )
        return len(self.accessors) - 1


def _shading(buffer: _Buffer, vertices: FloatArray, faces: IntArray) -> dict[str, int]:
    return {
        "POSITION": buffer.vectors(vertices, bounds=True),
        "NORMAL": buffer.vectors(_normals(vertices, faces)),
    }


def _animation(buffer: _Buffer, animation: WeightAnimation) -> dict[str, Any]:
    return {
        "name": animation.name,
        "samplers": [
            {
                "input": buffer.scalars(animation.seconds, bounds=True),
                "output": buffer.scalars(animation.weights),
                "interpolation": "LINEAR",
            }
        ],
        "channels": [{"sampler": 0, "target": {"node": 0, "path": "weights"}}],
    }


def _material(number: int, part: str) -> dict[str, Any]:
    return {
        "name": part,
        "doubleSided": True,
        "pbrMetallicRoughness": {
            "baseColorFactor": [*COLOURS[number % len(COLOURS)], 1.0],
            "metallicFactor": 0.0,
            "roughnessFactor": 0.6,
        },
    }


def _normals(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Return unit normals (P, 3), area-weighted means of the triangles'; +z where there is none."""
    normals = vertex_normals(vertices, faces)
    normals[~normals.any(axis=1)] = (0.0, 0.0, 1.0)
    return normals


def _packed(document: Mapping[str, Any], binary: bytes) -> bytes:
    text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    length = 12 + 8 + len(text) + 8 + len(binary)
    return b"".join(
        [
            struct.pack("<III", GLB_MAGIC, 2, length),
            struct.pack("<II", len(text), JSON_CHUNK),
            text,
            struct.pack("<II", len(binary), BINARY_CHUNK),
            binary,
        ]
    )


def _check(
    mesh: SceneMesh, targets: Sequence[MorphTarget], animations: Sequence[WeightAnimation]
) -> None:
    if not len(mesh.faces):
        raise InputError("glTF: expected a mesh of triangles, found points without triangles")
    for target in targets:
        if target.displacement.shape != mesh.vertices.shape:
            raise InputError(
                f"glTF: expected {len(mesh.vertices)} displacements in the target {target.name}, "
                f"found an array of shape {target.displacement.shape}"
            )
    for animation in animations:
        if animation.weights.shape[1] != len(targets):
            raise InputError(
                f"glTF: expected {len(targets)} weights at every time of the animation "
                f"{animation.name}, found {animation.weights.shape[1]}"
            )
