"""Volumes of the parts, and how they change over the cycle.

A part is closed by capping every opening flat: the cap of a rim that lies in a plane is that plane
polygon, of any other rim the fan about the mean of its points.
"""

from collections.abc import Mapping, Sequence
from typing import Annotated

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.errors import InputError
from ostiform.model import ModelMesh
from ostiform.study import ShapeId
from ostiform.values import Axes, value


@value
class VolumeCurve:
    """The volume of one part of one subject over the cycle.

    Attributes
    ----------
    part, subject : str
    phases : tuple of str
        In order of time.
    times : (T,) float64
        Fractions of the cycle, increasing.
    volumes : (T,) float64, mm^3
    """

    part: str
    subject: str
    phases: Annotated[tuple[str, ...], Axes("T")]
    times: Annotated[FloatArray, Axes("T")]
    volumes: Annotated[FloatArray, Axes("T")]

    @property
    def largest(self) -> int:
        """Index of the phase of the largest volume (end-diastole of a ventricle)."""
        return int(np.argmax(self.volumes))

    @property
    def smallest(self) -> int:
        """Index of the phase of the smallest volume (end-systole of a ventricle)."""
        return int(np.argmin(self.volumes))

    @property
    def ejection_fraction(self) -> float:
        """Share of the largest volume that is ejected: (largest - smallest) / largest."""
        return float(1.0 - self.volumes[self.smallest] / self.volumes[self.largest])


def enclosed_volumes(points: FloatArray, faces: IntArray, loops: Sequence[IntArray]) -> FloatArray:
    """Return the volumes that shapes on one mesh enclose with their openings capped flat.

    By the divergence theorem the sum over the triangles a, b, c, those of the caps included, of
    ``a . (b x c) / 6``; positive where the triangles are counter-clockwise seen from outside.

    Parameters
    ----------
    points : (N, P, 3) float64, mm
    faces : (F, 3) int64
    loops : sequence of (n,) int64
        The openings' rims in order, the surface on their left.

    Returns
    -------
    volumes : (N,) float64, mm^3

    Raises
    ------
    InputError
        If an edge of the surface borders neither another triangle nor an opening.
    """
    _check_closed(faces, loops)
    shapes = np.asarray(points, dtype=np.float64)
    used = np.unique(faces)
    shapes = shapes - shapes[:, used].mean(axis=1)[:, None]  # rounding does not depend on place
    volumes = _sixfold(shapes[:, faces[:, 0]], shapes[:, faces[:, 1]], shapes[:, faces[:, 2]])
    for loop in loops:
        rim = shapes[:, loop]  # (N, n, 3)
        centre = np.broadcast_to(rim.mean(axis=1, keepdims=True), rim.shape)
        volumes = volumes + _sixfold(np.roll(rim, -1, axis=1), rim, centre)
    return volumes / 6.0


def part_volumes(points: FloatArray, mesh: ModelMesh) -> dict[str, FloatArray]:
    """Return the volumes (N,) in mm^3 of every part of shapes (N, P, 3) in correspondence.

    Parameters
    ----------
    points : (N, P, 3) float64, mm
        In coordinates that were not scaled.
    mesh : ModelMesh
        A part's openings are the loops whose name begins with the part's; seams belong to both.
    """
    return {
        part: enclosed_volumes(
            points,
            mesh.faces[mesh.face_part == index],
            [loop for name, loop in mesh.loops.items() if name.startswith(f"{part}.")],
        )
        for index, part in enumerate(mesh.parts)
        if (mesh.face_part == index).any()
    }


def volume_curves(
    ids: Sequence[ShapeId], volumes: Mapping[str, FloatArray]
) -> tuple[VolumeCurve, ...]:
    """Return the volume curve of every part of every subject with at least two phases.

    Parameters
    ----------
    ids : (N,) sequence of ShapeId
    volumes : mapping of part to (N,) float64, mm^3

    Returns
    -------
    curves : tuple of VolumeCurve
        Part by part, subjects in study order; empty where no subject has two phases.

    Raises
    ------
    InputError
        If there is not one volume per shape.
    """
    curves = []
    for part, values in volumes.items():
        if len(values) != len(ids):
            raise InputError(
                f"volumes of {part}: expected one for each of {len(ids)} shapes, "
                f"found {len(values)}"
            )
        for subject in dict.fromkeys(id.subject for id in ids):
            own = sorted(
                (i for i, id in enumerate(ids) if id.subject == subject), key=lambda i: ids[i].time
            )
            if len(own) > 1:
                curves.append(
                    VolumeCurve(
                        part,
                        subject,
                        tuple(ids[i].phase for i in own),
                        np.array([ids[i].time for i in own]),
                        np.array([values[i] for i in own]),
                    )
                )
    return tuple(curves)


def _sixfold(a: FloatArray, b: FloatArray, c: FloatArray) -> FloatArray:
    sixfold: FloatArray = np.einsum("nfk,nfk->n", a, np.cross(b, c))
    return sixfold


def _check_closed(faces: IntArray, loops: Sequence[IntArray]) -> None:
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    # A rim runs with the edges of its triangles; the cap's edges run against them.
    caps = [np.stack([np.roll(loop, -1), loop], axis=1) for loop in loops]
    every = np.concatenate([edges, *caps])
    count = int(every.max(initial=0)) + 1
    forward = np.sort(every[:, 0] * count + every[:, 1])
    backward = np.sort(every[:, 1] * count + every[:, 0])
    unmatched = int((forward != backward).sum())
    if unmatched:
        raise InputError(
            "volume of a part: expected its triangles and openings to close it, found edges that "
            f"border one triangle and no opening ({unmatched} of {len(every)} do not match); "
            "name every opening of the part"
        )
