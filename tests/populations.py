"""Small populations in correspondence with known modes, on a sphere of two parts with openings."""

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.correspondence import Correspondence
from ostiform.domain import Template, TemplateLevel
from ostiform.study import ShapeId
from ostiform.surface.operators import vertex_areas


def two_part_template(rows: int = 9, columns: int = 16) -> Template:
    """Return a sphere between 60 degrees south and north: LV below the equator, LA above it.

    Openings: ``LV.aortic`` at the south rim, ``LA.vein`` at the north rim; the equator is the
    seam ``LV.mitral`` = ``LA.mitral``. `rows` must be odd, so that a row lies on the equator.
    """
    latitudes = np.radians(np.linspace(-60.0, 60.0, rows))
    longitudes = 2.0 * np.pi * np.arange(columns) / columns
    points = np.stack(
        [
            np.outer(np.cos(latitudes), np.cos(longitudes)),
            np.outer(np.cos(latitudes), np.sin(longitudes)),
            np.repeat(np.sin(latitudes)[:, None], columns, axis=1),
        ],
        axis=2,
    ).reshape(-1, 3)
    index = np.arange(rows * columns).reshape(rows, columns)
    right = np.roll(index, -1, axis=1)
    a, b, c, d = index[:-1], right[:-1], right[1:], index[1:]
    faces = np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)], 2).reshape(-1, 3)
    face_part = np.repeat([0, 1], len(faces) // 2)
    part = np.repeat((np.arange(rows) > rows // 2).astype(np.int64), columns)
    curve = np.full(rows * columns, -1)
    seam = index[rows // 2]
    curve[index[0]], curve[seam], curve[index[-1]] = 0, 1, 2
    return Template(
        points=points,
        sphere=np.zeros(len(points), dtype=np.int64),
        part=part,
        faces=faces,
        face_part=face_part,
        parts=("LV", "LA"),
        curve=curve,
        curves=("LV.aortic", "LV.mitral", "LA.vein"),
        loops={
            "LV.aortic": index[0],
            "LV.mitral": seam[::-1],
            "LA.mitral": seam,
            "LA.vein": index[-1][::-1],
        },
        levels=(_coarse_level(rows, columns),),
    )


def area_weights(points: FloatArray, faces: IntArray) -> FloatArray:
    areas = vertex_areas(points, faces)
    return areas / areas.sum()


def ellipsoids(points: FloatArray, semi_axes: FloatArray) -> FloatArray:
    """Return the ellipsoids (N, P, 3) with semi-axes (N, 3) over unit vectors (P, 3)."""
    return points * semi_axes[:, None, :]


def population(
    subjects: int, phases: int, rng: np.random.Generator, template: Template | None = None
) -> Correspondence:
    """Return ellipsoids that differ by subject, beat by phase, and lie anywhere in space."""
    template = two_part_template() if template is None else template
    times = np.arange(phases) / phases
    size = rng.normal([40.0, 36.0, 50.0], [4.0, 3.0, 6.0], size=(subjects, 1, 3))
    beat = 1.0 - 0.15 * np.sin(np.pi * times) ** 2  # (F,)
    axes = (size * beat[:, None]).reshape(-1, 3)
    aligned = ellipsoids(template.points, axes)
    aligned = aligned + rng.normal(scale=0.2, size=aligned.shape)
    ids = tuple(
        ShapeId(f"subject {s}", f"ph{f:02d}", float(times[f]))
        for s in range(subjects)
        for f in range(phases)
    )
    rotations, _ = np.linalg.qr(rng.normal(size=(len(ids), 3, 3)))
    rotations *= np.linalg.det(rotations)[:, None, None]
    transforms = np.zeros((len(ids), 4, 4))
    transforms[:, :3, :3], transforms[:, :3, 3] = rotations, rng.normal(size=(len(ids), 3))
    transforms[:, 3, 3] = 1.0
    points = np.einsum("nij,npi->npj", rotations, aligned - transforms[:, None, :3, 3])
    return Correspondence(
        template=template,
        ids=ids,
        directions=np.broadcast_to(template.points, aligned.shape),
        points=points,
        aligned=aligned,
        transforms=transforms,
        weights=area_weights(aligned.mean(axis=0), template.faces),
    )


def _coarse_level(rows: int, columns: int) -> TemplateLevel:
    index = np.arange(rows * columns)
    return TemplateLevel(
        index=index[: 2 * columns],
        faces=np.array([[0, 1, columns], [1, columns + 1, columns]]),
        face_part=np.zeros(2, dtype=np.int64),
    )
