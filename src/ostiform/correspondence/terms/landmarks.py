"""Landmarks of the user as soft correspondences (an optional term of every shape's objective).

A landmark l marks the same place on every shape, with a stated standard deviation. Its place on
the template is the mean over the shapes of the directions that the maps give it; with
``b_l`` its barycentric coordinates in the triangle of the optimiser's points around that place, a
shape adds ``sum_l |sum_k b_lk x_k - p_l|^2 / sd_l^2`` to its objective: the negative logarithm,
twice, of the probability that the user clicked at p_l where the shape's points say the place is.
"""

from dataclasses import dataclass

import numpy as np

from ostiform.arrays import FloatArray, IntArray, frozen_floats
from ostiform.correspondence.sampling import ShapeSampler, SurfaceMarks, pull_back
from ostiform.correspondence.shapes import GivenShapes, as_shapes
from ostiform.correspondence.state import Linearised, WarpState
from ostiform.correspondence.terms.term import System
from ostiform.domain import Template
from ostiform.errors import InputError
from ostiform.surface import closest_points, normalised, surface_tree


@dataclass(frozen=True, slots=True, eq=False)
class TemplateMarks:
    """Where the landmarks lie among the optimiser's points.

    Attributes
    ----------
    names : tuple of str
        L landmarks.
    corners : (L, 3) int64
        Points of the triangle around each.
    barycentric : (L, 3) float64
    """

    names: tuple[str, ...]
    corners: IntArray
    barycentric: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class LandmarkTerm:
    """The landmarks of one shape, as its objective sees them.

    Attributes
    ----------
    corners : (L, 3) int64
    barycentric : (L, 3) float64
    positions : (L, 3) float64, mm
        In input coordinates.
    precisions : (L,) float64
        One over the variance of a coordinate, mm^-2.
    """

    corners: IntArray
    barycentric: FloatArray
    positions: FloatArray
    precisions: FloatArray

    def value(self, state: WarpState, transform: FloatArray) -> float:
        """Return the term of a shape; it is measured in input coordinates."""
        squares = (_residuals(self, state.landmarks) ** 2).sum(axis=1)
        return float(self.precisions @ squares)

    def system(self, at: Linearised) -> System:
        """Return the term's gradient and Gauss-Newton matrix about a state."""
        rows = _jacobian_rows(self, at)  # (3L, D)
        residuals = np.sqrt(self.precisions)[:, None] * _residuals(self, at.state.landmarks)
        return System(residuals.ravel() @ rows, rows.T @ rows)


def template_marks(shapes: GivenShapes, coarse: Template) -> TemplateMarks | None:
    """Return where the population's landmarks lie on a template; None where no shape has any.

    Parameters
    ----------
    shapes : Shapes or sequence of ShapeSampler
    coarse : Template
        Of the optimiser's points.

    Raises
    ------
    InputError
        If a landmark lies on different components of different shapes.
    """
    places: dict[str, list[tuple[int, FloatArray]]] = {}
    for of_shape in as_shapes(shapes).each(_places, [None] * len(shapes), None):
        for name, place in zip(*of_shape, strict=True):
            places.setdefault(name, []).append(place)
    if not places:
        return None
    corners, barycentric = [], []
    for name, found in places.items():
        spheres = {sphere for sphere, _ in found}
        if len(spheres) > 1:
            raise InputError(
                f"landmark {name}: expected it on the same component of every shape, found it on "
                f"{len(spheres)} different ones: check the names and the frame of the landmarks"
            )
        direction = normalised(np.mean([place for _, place in found], axis=0)[None])[0]
        corner, share = _located(coarse, spheres.pop(), direction)
        corners.append(corner)
        barycentric.append(share)
    return TemplateMarks(tuple(places), np.array(corners), np.array(barycentric))


def landmark_term(marks: TemplateMarks | None, own: SurfaceMarks | None) -> LandmarkTerm | None:
    """Return the term of one shape; None where it has no landmarks that the template knows."""
    if marks is None or own is None:
        return None
    pairs = [(marks.names.index(n), k) for k, n in enumerate(own.names) if n in marks.names]
    if not pairs:
        return None
    here, there = np.array(pairs).T
    return LandmarkTerm(
        corners=marks.corners[here],
        barycentric=marks.barycentric[here],
        positions=own.positions[there],
        precisions=own.sd_mm[there] ** -2.0,
    )


def _jacobian_rows(term: LandmarkTerm, at: Linearised) -> FloatArray:
    """Return the derivative (3L, D) of the weighted residuals by the coefficients of fields."""
    starts, fields = at.fields.starts, at.fields.fields
    rows = np.zeros((len(term.corners), 3, len(at.basis)))
    for mark, (corners, shares) in enumerate(zip(term.corners, term.barycentric, strict=True)):
        for point, share in zip(corners, shares, strict=True):
            active = slice(starts[point], starts[point + 1])
            rows[mark][:, fields[active]] += share * at.moved[active].T
    rows *= np.sqrt(term.precisions)[:, None, None]
    return rows.reshape(-1, len(at.basis))


def _residuals(term: LandmarkTerm, points: FloatArray) -> FloatArray:
    placed = np.einsum("lk,lkd->ld", term.barycentric, points[term.corners])
    residuals: FloatArray = placed - term.positions
    return residuals


def _places(
    sampler: ShapeSampler, _item: None, _shared: None
) -> tuple[tuple[str, ...], list[tuple[int, FloatArray]]]:
    """Return the component and the direction that a shape's map gives each of its landmarks."""
    if sampler.marks is None:
        return (), []
    positions = sampler.marks.positions
    distances = np.stack(
        [
            np.linalg.norm(
                closest_points(surface_tree(mesh.vertices, mesh.faces), positions).points
                - positions,
                axis=1,
            )
            for mesh in (part.component for part in sampler.components)
        ]
    )  # (C, L)
    component = distances.argmin(axis=0)
    return sampler.marks.names, [
        (int(number), frozen_floats(pull_back(sampler, int(number), point[None])[0], (3,), "mark"))
        for number, point in zip(component, positions, strict=True)
    ]


def _located(coarse: Template, sphere: int, direction: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the triangle around a direction, or the nearest one, and the place in it."""
    faces = coarse.faces[coarse.sphere[coarse.faces[:, 0]] == sphere]
    corners = np.swapaxes(coarse.points[faces], 1, 2)  # (F, 3, 3), columns are corners
    shares = np.linalg.solve(corners, np.broadcast_to(direction[:, None], (len(faces), 3, 1)))
    weights = shares[:, :, 0] / np.abs(shares[:, :, 0]).sum(axis=1, keepdims=True)
    best = int(weights.min(axis=1).argmax())
    inside = np.maximum(weights[best], 0.0)
    return faces[best], inside / inside.sum()
