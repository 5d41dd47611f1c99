"""What is kept of the maps of all shapes: numbers and histograms, not meshes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.correspondence import Correspondence
from ostiform.domain import BaseDomain
from ostiform.embedding import (
    Certificate,
    Distortion,
    Embedding,
    angle_distortion,
    area_shares,
    one_sided_derivatives,
)
from ostiform.surface import Component, Seam

ANGLE_EDGES: Final = np.geomspace(1.0, 10.0, 51)
AREA_EDGES: Final = np.geomspace(0.05, 20.0, 61)
JUMP_EDGES: Final = np.linspace(0.0, 0.6, 41)
"""Bins of the histograms; what lies beyond the ends is counted in the first and last bin."""


@dataclass(frozen=True, slots=True, eq=False)
class ComponentRecord:
    """The map of one component of one shape.

    Attributes
    ----------
    name : str
    vertices : int
    certificate : Certificate
    distortion : Distortion
    seconds : float
    angles, areas : (bins,) float64
        Share of the surface in each bin of the ratio of singular values (`ANGLE_EDGES`) and of
        the share of the sphere over that of the surface (`AREA_EDGES`).
    jumps : mapping of Seam to (bins,) float64
        Share of the seam's length in each bin of the relative jump (`JUMP_EDGES`).
    """

    name: str
    vertices: int
    certificate: Certificate
    distortion: Distortion
    seconds: float
    angles: FloatArray
    areas: FloatArray
    jumps: Mapping[Seam, FloatArray]


@dataclass(frozen=True, slots=True, eq=False)
class MapRecord:
    """The maps of one shape, one per component."""

    label: str
    components: tuple[ComponentRecord, ...]


@dataclass(frozen=True, slots=True, eq=False)
class SeamKink:
    """How a quantity across a seam differs between the shapes as the model samples them.

    Attributes
    ----------
    kink : (N,) float64
        Mean of ``|g+| / |g-|`` along the seam, as in `SeamJump`.
    shear : (N,) float64
        Mean angle between g+ and g-, radians.
    """

    kink: FloatArray
    shear: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class MapRecords:
    """The maps of all shapes of a model, and the kinks that are left across the seams.

    Attributes
    ----------
    shapes : tuple of MapRecord
    kinks : mapping of Seam to SeamKink
        Across the seams, after the warps.
    """

    shapes: tuple[MapRecord, ...]
    kinks: Mapping[Seam, SeamKink]


def map_record(label: str, embeddings: Sequence[Embedding]) -> MapRecord:
    """Return what the report keeps of the maps of one shape.

    Parameters
    ----------
    label : str
    embeddings : sequence of Embedding
        One per component.
    """
    return MapRecord(label, tuple(_component_record(embedding) for embedding in embeddings))


def _component_record(embedding: Embedding) -> ComponentRecord:
    component, directions = embedding.component, embedding.directions
    ratio, share = area_shares(component, directions)
    jumps = {}
    for seam, path in component.seams.items():
        across = one_sided_derivatives(component, directions, path)
        jumps[seam] = _histogram(across.relative_jump, across.lengths, JUMP_EDGES)
    return ComponentRecord(
        component.name,
        len(component.vertices),
        embedding.certificate,
        embedding.distortion,
        embedding.seconds,
        _histogram(angle_distortion(component, directions), share, ANGLE_EDGES),
        _histogram(ratio, share, AREA_EDGES),
        jumps,
    )


def sampled_kinks(correspondence: Correspondence, domain: BaseDomain) -> dict[Seam, SeamKink]:
    """Return the kink across every seam after the warps, from the sampled shapes to the template.

    A mean or a mode is G1 across the seam where neither varies between the shapes (design 3).
    """
    template = correspondence.template
    found = {}
    for index, sphere in enumerate(domain.spheres):
        own = template.sphere[template.faces[:, 0]] == index
        faces, face_part = template.faces[own], template.face_part[own]
        for seam in sphere.seams:
            path = template.loops[seam.second]
            values = np.array(
                [
                    _kink(
                        Component(
                            sphere.name, template.parts, points, faces, face_part, {}, {seam: path}
                        ),
                        template.points,
                        seam,
                    )
                    for points in correspondence.aligned
                ]
            )  # (N, 2)
            found[seam] = SeamKink(values[:, 0], values[:, 1])
    return found


def _kink(component: Component, directions: FloatArray, seam: Seam) -> tuple[float, float]:
    across = one_sided_derivatives(component, directions, component.seams[seam])
    plus = np.linalg.norm(across.left, axis=1)
    minus = np.linalg.norm(across.right, axis=1)
    turned = np.arctan2(
        np.linalg.norm(np.cross(across.left, across.right), axis=1),
        np.einsum("na,na->n", across.left, across.right),
    )
    weights = across.lengths / across.lengths.sum()
    return float(weights @ (plus / minus)), float(weights @ turned)


def _histogram(values: FloatArray, weights: FloatArray, edges: FloatArray) -> FloatArray:
    within = np.clip(values, edges[0], edges[-1])
    counts = np.histogram(within, bins=edges, weights=weights)[0]
    shares: FloatArray = counts / counts.sum()
    return shares
