"""The true correspondence of a generated population, kept aside for evaluation.

`truth.json` holds the parameters of the material anatomy and of every shape's deformation; the
maps themselves are evaluated when asked for.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ostiform.arrays import FloatArray, IntArray
from ostiform.artifacts import load, save
from ostiform.atomic import atomically
from ostiform.demo.deformation import Deformation
from ostiform.demo.implicit import Anatomy
from ostiform.demo.inversion import solve3
from ostiform.demo.relaxation import cut_slopes, project_to_curves, project_to_surface
from ostiform.errors import InputError
from ostiform.study import ShapeId
from ostiform.values import value

_CLOSEST_POINT_STEPS = 8
_ARRIVED_MM = 1e-10
"""Steps shorter than this move no digit of a distance that anyone reads."""


@value
class Truth:
    """A material anatomy and the deformation that makes each shape of a population from it.

    Attributes
    ----------
    seed : int
        Of the generator that drew the population.
    anatomy : Anatomy
    deformations : mapping of ShapeId to Deformation
        From material to input coordinates, in study order.
    """

    seed: int
    anatomy: Anatomy
    deformations: Mapping[ShapeId, Deformation]

    def deformation(self, shape_id: ShapeId) -> Deformation:
        """Return the deformation of a shape, found by subject and phase.

        Raises
        ------
        InputError
            If the population has no such shape.
        """
        for known, deformation in self.deformations.items():
            if (known.subject, known.phase) == (shape_id.subject, shape_id.phase):
                return deformation
        raise InputError(
            f"{shape_id}: expected one of the {len(self.deformations)} shapes of the truth, found "
            "none of that subject and phase; give the truth that was written with the study"
        )


def material_coordinates(
    truth: Truth, shape_id: ShapeId, part: str, points: FloatArray
) -> FloatArray:
    """Return the material points of points on or near a part of a shape.

    Parameters
    ----------
    truth : Truth
    shape_id : ShapeId
        Only subject and phase are looked at.
    part : str
    points : (n, 3) float64, mm
        In the shape's input coordinates.

    Returns
    -------
    (n, 3) float64, mm
        phi_i^-1 of the closest point of the true surface of that part; beyond an opening, of its
        rim.

    Raises
    ------
    InputError
        If the population has no such shape or part.
    """
    if part not in truth.anatomy.seeds:
        raise InputError(
            f"{shape_id}: expected a part of {', '.join(truth.anatomy.seeds)}, found {part}; name "
            "one of these"
        )
    anatomy, deformation = truth.anatomy, truth.deformation(shape_id)
    points = np.asarray(points, dtype=np.float64)
    material = project_to_surface(anatomy, deformation.inverse(points))
    going = np.arange(len(points))
    for _ in range(_CLOSEST_POINT_STEPS):
        # Gauss-Newton on |phi(X) - x|^2 within the tangent plane of {f = 0}.
        start = material[going]
        image, jacobian = deformation.linearised(start)
        _, gradient = anatomy.level(start)
        step = solve3(jacobian, points[going] - image)
        normal = solve3(np.einsum("nki,nkj->nij", jacobian, jacobian), gradient)
        share = np.einsum("ij,ij->i", gradient, step) / np.einsum("ij,ij->i", gradient, normal)
        material[going] = project_to_surface(anatomy, start + step - share[:, None] * normal)
        going = _underway(going, start, material)
    return _within_rims(anatomy, deformation, part, points, material)


def _underway(going: IntArray, start: FloatArray, material: FloatArray) -> IntArray:
    """Return which of the points (n,) that were going have not arrived."""
    length: FloatArray = np.linalg.norm(material[going] - start, axis=1)
    return going[length > _ARRIVED_MM]


def _within_rims(
    anatomy: Anatomy,
    deformation: Deformation,
    part: str,
    points: FloatArray,
    material: FloatArray,
) -> FloatArray:
    """Return material points (n, 3) with those beyond an opening of a part on its rim."""
    curve = np.full(len(points), -1)
    for _, sign, cut in anatomy.part_cuts(part):
        near = np.flatnonzero(cut.reaches(material))
        beyond = near[sign * cut.height(material[near])[0] > 0.0]
        curve[beyond] = anatomy.cuts.index(cut)
    going = np.flatnonzero(curve >= 0)
    material[going] = project_to_curves(anatomy, material[going], curve[going])
    for _ in range(_CLOSEST_POINT_STEPS):
        # Gauss-Newton on |phi(X) - x|^2 along the curve of a cut.
        start, on = material[going], curve[going]
        _, gradient = anatomy.level(start)
        along = np.cross(gradient, cut_slopes(anatomy, start, on)[1])
        position, jacobian = deformation.linearised(start)
        image = np.einsum("nij,nj->ni", jacobian, along)
        gap = points[going] - position
        share = np.einsum("ij,ij->i", image, gap) / np.einsum("ij,ij->i", image, image)
        material[going] = project_to_curves(anatomy, start + share[:, None] * along, on)
        going = _underway(going, start, material)
    return material


def true_positions(truth: Truth, shape_id: ShapeId, part: str, material: FloatArray) -> FloatArray:
    """Return the positions (n, 3), mm, on a shape of material points (n, 3): phi_i.

    The deformation is one of space, so the result does not depend on the part; it is named so that
    calls read alike.
    """
    return truth.deformation(shape_id).forward(np.asarray(material, dtype=np.float64))


def write_truth(truth: Truth, path: Path) -> Path:
    """Write a truth as JSON and return the path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomically(path) as partial:
        save(partial, truth)
    return path


def read_truth(path: Path) -> Truth:
    """Return the truth that `write_truth` wrote.

    Raises
    ------
    ArtifactError
        If the file is missing, damaged, or of another layout.
    """
    return load(path, Truth, "generate the population again")
