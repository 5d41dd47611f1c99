"""Statistical shape models as values: a mean, modes, variances, and the mesh they live on.

Projecting, sampling, truncating and conditioning return points, scores or another model.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

import numpy as np
from numpy.typing import ArrayLike

from ostiform.arrays import FloatArray, IntArray, frozen_floats
from ostiform.domain import Template
from ostiform.errors import InputError
from ostiform.model.algebra import (
    check_weights,
    checked_points,
    checked_scores,
    conditioned,
    normal_scores,
    principal_modes,
    weighted_size,
)
from ostiform.model.mesh import ModelMesh
from ostiform.model.plotting import Colouring, plotted
from ostiform.model.resampling import Resampling, resampling, resampling_onto
from ostiform.study import ShapeId
from ostiform.values import Axes, value

if TYPE_CHECKING:
    import pyvista

ORTHONORMAL_TOLERANCE = 1e-8
"""Largest entry of |Phi^T W Phi - I|, a pure number: rounding of sums over 3P products."""


@value
class ShapeModel:
    """A Gaussian distribution of shapes: ``x = mean + sum_k b_k modes_k``, ``b_k ~ N(0, l_k)``.

    Attributes
    ----------
    mean : (P, 3) float64, mm
    modes : (K, P, 3) float64, dimensionless
        Orthonormal under the point weights: ``sum_p w_p modes_k[p] . modes_l[p] = delta_kl``, so
        that a score of b mm displaces the points by b mm RMS over the surface.
    variances : (K,) float64, mm^2 per point
        Largest first.
    weights : (P,) float64
        Area share of each point, positive, sum 1.
    mesh : ModelMesh
    residual_variance : float, mm^2 per point
        Variance that the modes leave out, taken to be independent noise of a third of it per
        coordinate.
    sample_count : int
        Number of training shapes; 0 where unknown.
    """

    mean: Annotated[FloatArray, Axes("P", 3)]
    modes: Annotated[FloatArray, Axes("K", "P", 3)]
    variances: Annotated[FloatArray, Axes("K")]
    weights: Annotated[FloatArray, Axes("P")]
    mesh: Annotated[ModelMesh, Axes("P")]
    residual_variance: float
    sample_count: int

    def __post_init__(self) -> None:
        """Check what annotations cannot say."""
        if (self.variances < 0.0).any() or (np.diff(self.variances) > 0.0).any():
            raise InputError(
                "variances of a model: expected non-negative numbers, largest first, "
                f"found {np.array2string(self.variances, precision=3, threshold=8)}"
            )
        if not np.isfinite(self.residual_variance) or self.residual_variance < 0.0:
            raise InputError(
                "residual variance of a model: expected a non-negative number, "
                f"found {self.residual_variance}"
            )
        check_weights(self.weights)
        scaled = (self.modes * np.sqrt(self.weights)[:, None]).reshape(-1, self.mean.size)
        error = np.abs(scaled @ scaled.T - np.eye(len(self.modes))).max(initial=0.0)
        if error > ORTHONORMAL_TOLERANCE:
            raise InputError(
                "modes of a model: expected them orthonormal under the point weights, found an "
                f"error of {error:.2g}; build the model with fit_model"
            )

    @property
    def total_variance(self) -> float:
        """Variance of the modes and of the residual together, mm^2 per point."""
        return float(self.variances.sum()) + self.residual_variance

    @property
    def deviations(self) -> FloatArray:
        """Standard deviation (K,) of the scores in mm."""
        return np.sqrt(self.variances)

    def project(self, shapes: FloatArray) -> FloatArray:
        """Return the scores (..., K) in mm of shapes (..., P, 3) given in the model's frame.

        The projection is orthogonal under the point weights: ``b = Phi^T W (x - mean)``.
        """
        deviations = (np.asarray(shapes) - self.mean) * self.weights[:, None]  # (..., P, 3)
        scores: FloatArray = np.tensordot(deviations, self.modes, axes=([-2, -1], [1, 2]))
        return scores

    def reconstruct(self, scores: ArrayLike) -> FloatArray:
        """Return the shapes (..., P, 3) in mm of scores (..., M), M <= K; missing are zero.

        Raises
        ------
        InputError
            If there are more scores than modes.
        """
        given = checked_scores(scores, len(self.modes))
        moved: FloatArray = np.tensordot(given, self.modes[: given.shape[-1]], axes=1)
        return self.mean + moved

    def displaced(self, mode: int, deviation: float) -> FloatArray:
        """Return the mean (P, 3) displaced along one mode, in standard deviations (HY Fig. 3).

        Raises
        ------
        InputError
            If the model has no such mode.
        """
        if not 0 <= mode < len(self.modes):
            raise InputError(
                f"mode of a model: expected an index from 0 to {len(self.modes) - 1}, found {mode}"
            )
        shape: FloatArray = self.mean + deviation * self.deviations[mode] * self.modes[mode]
        return shape

    def point_deviations(self) -> FloatArray:
        """Return the standard deviation (P,) in mm of every point: RMS distance from its mean."""
        squared = np.einsum("k,kpi,kpi->p", self.variances, self.modes, self.modes)
        deviations: FloatArray = np.sqrt(squared + self.residual_variance)
        return deviations

    def sample_scores(
        self, count: int, rng: np.random.Generator, limit: float = np.inf
    ) -> FloatArray:
        """Return random scores (count, K) in mm, ``b_k ~ N(0, l_k)`` truncated at `limit` sd."""
        return normal_scores(self.variances, count, rng, limit)

    def sample(
        self, count: int = 1, seed: int | np.random.Generator = 0, limit: float = 3.0
    ) -> FloatArray:
        """Return random shapes (count, P, 3) in mm, equal for equal seeds.

        Scores are truncated at `limit` standard deviations; the residual variance is not added as
        noise.
        """
        rng = np.random.default_rng(seed)
        return self.reconstruct(self.sample_scores(count, rng, limit))

    def truncated(self, n_modes: int) -> "ShapeModel":
        """Return the model with its first modes only; what they leave joins the residual variance.

        Raises
        ------
        InputError
            If `n_modes` is negative or more than the model has.
        """
        if not 0 <= n_modes <= len(self.modes):
            raise InputError(
                f"a truncated model: expected from 0 to {len(self.modes)} modes, found {n_modes}"
            )
        left_out = float(self.variances[n_modes:].sum())
        return replace(
            self,
            modes=self.modes[:n_modes],
            variances=self.variances[:n_modes],
            residual_variance=self.residual_variance + left_out,
        )

    def image(
        self, mean: FloatArray, modes: FloatArray, weights: FloatArray, mesh: ModelMesh
    ) -> "ShapeModel":
        """Return the model of the images of its shapes under a linear map.

        The residual variance stays as it is: it is the same noise at every point.

        Parameters
        ----------
        mean : (Q, 3) float64, mm
            Image of the mean.
        modes : (K, Q, 3) float64
            Images of the modes; they are made orthonormal under the new weights.
        weights : (Q,) float64
            Area shares of the new points, sum 1.
        mesh : ModelMesh
        """
        spread = self.deviations[:, None, None]
        found, variances = principal_modes(modes * spread, weights, weighted_size(mean, weights))
        return replace(
            self, mean=mean, modes=found, variances=variances, weights=weights, mesh=mesh
        )

    def marginal(self, points: IntArray) -> "ShapeModel":
        """Return the distribution of some of the points, whatever the others do.

        Triangles and openings are kept where all their points are; the weights are rescaled to
        sum 1 and the modes made orthonormal under them.

        Parameters
        ----------
        points : (Q,) int64
            Distinct point indices, in the order that the new model shall have.

        Raises
        ------
        InputError
            If a point is unknown or given twice, or none is given.
        """
        chosen = checked_points(points, len(self.mean))
        return self._restricted(chosen, self.mesh.restricted(chosen))

    def part(self, name: str) -> "ShapeModel":
        """Return the distribution of one part, the seam points that it shares included.

        Raises
        ------
        InputError
            If the model has no such part.
        """
        return self._restricted(*self.mesh.of_part(name))

    def _restricted(self, points: IntArray, mesh: ModelMesh) -> "ShapeModel":
        weights = self.weights[points] / self.weights[points].sum()
        return self.image(self.mean[points], self.modes[:, points], weights, mesh)

    def posterior(
        self, points: IntArray, positions: FloatArray, noise_mm: FloatArray | float
    ) -> "ShapeModel":
        """Return the distribution of the whole shape, given noisy positions of some of its points.

        Gaussian conditioning of the scores; their covariance is diagonalised inside the span of
        the modes, so the new modes stay orthonormal under the same weights. The model's residual
        variance counts as noise of the observation.

        Parameters
        ----------
        points : (Q,) int64
            The points seen; distinct.
        positions : (Q, 3) float64, mm
            Where they were seen, in the model's frame.
        noise_mm : float or (Q,) float64, mm
            Standard deviation of each coordinate of an observation.

        Raises
        ------
        InputError
            If a point is unknown or given twice, or the noise is not positive anywhere.
        """
        chosen = checked_points(points, len(self.mean))
        seen = frozen_floats(positions, (len(chosen), 3), "observed positions")
        noise = np.broadcast_to(np.asarray(noise_mm, dtype=np.float64), (len(chosen),))
        variance = noise**2 + self.residual_variance / 3.0  # (Q,) per coordinate
        if not (np.isfinite(variance).all() and (variance > 0.0).all() and (noise >= 0.0).all()):
            raise InputError(
                "noise of observed points: expected positive standard deviations in mm, "
                f"found values from {noise.min():.3g} to {noise.max():.3g}"
            )
        scores, variances, directions = conditioned(
            self.modes[:, chosen].reshape(len(self.modes), -1),
            (seen - self.mean[chosen]).ravel(),
            self.variances,
            np.repeat(variance, 3),
        )
        return replace(
            self,
            mean=self.reconstruct(scores),
            modes=np.tensordot(directions, self.modes, axes=1),
            variances=variances,
        )

    def resampled(self, n_points: int) -> "ShapeModel":
        """Return the model on a new, even triangulation of its mean.

        The mean is remeshed with nearly equilateral triangles of one size; rims and seams are
        kept as curves. The weights are the area shares of the new points: the old density of
        weight on the mean, carried over.

        Parameters
        ----------
        n_points : int
            Reached to within 2 %.

        Raises
        ------
        InputError
            If the model has no triangles, or `n_points` is below 4.
        ConvergenceError
            If the points are far too few for the rims and seams.
        """
        return self._resampled(resampling(self.mean, self.mesh, self.weights, n_points))

    def resampled_onto(self, vertices: FloatArray, faces: IntArray) -> "ShapeModel":
        """Return the model on a given triangulation that lies on or near its mean.

        Every vertex goes to the closest point of the mean, a rim vertex to the closest point of
        the model's rim. A triangle belongs to the part that its centroid is nearest to; where two
        parts meet, the seam runs along the edges of the given mesh.

        Parameters
        ----------
        vertices : (Q, 3) float64, mm
            In the model's frame; every one used by a triangle.
        faces : (F, 3) int64
            Counter-clockwise seen from outside.

        Raises
        ------
        InputError
            If an index is out of range, a vertex has no triangle, the openings of a part are not
            as many as the model's, or two vertices fall on one point so that no area is left to
            them.
        TopologyError
            If the mesh is not an oriented manifold.
        """
        return self._resampled(resampling_onto(self.mean, self.mesh, self.weights, vertices, faces))

    def _resampled(self, new: Resampling) -> "ShapeModel":
        modes = np.array([new.carried(mode) for mode in self.modes]).reshape(
            len(self.modes), len(new.weights), 3
        )
        return self.image(new.carried(self.mean), modes, new.weights, new.mesh)

    def plot(
        self,
        scores: ArrayLike = (),
        colour: Colouring = "part",
        off_screen: bool | None = None,
        window_size: Sequence[int] = (800, 700),
    ) -> "pyvista.Plotter":
        """Return a PyVista plotter of one shape, its openings drawn as lines.

        Nothing is opened: call ``show()`` for a window or a notebook's viewer,
        ``screenshot(path)`` for a picture. More meshes can be added before.

        Parameters
        ----------
        scores : (M,) array_like, mm
            Of the shape; missing ones are zero, so that nothing given is the mean.
        colour : str
            ``"part"``, ``"displacement"`` (distance from the mean, mm) or ``"deviation"``
            (standard deviation of every point, mm).
        off_screen : bool, optional
            Draw without a window; PyVista's own setting if absent.
        window_size : (int, int)
            In pixels.

        Raises
        ------
        InputError
            If there are more scores than modes, or PyVista is not installed.
        """
        shape = self.reconstruct(scores)
        values = {
            "part": None,
            "displacement": ("distance (mm)", np.linalg.norm(shape - self.mean, axis=1)),
            "deviation": ("sd (mm)", self.point_deviations()),
        }[colour]
        return plotted(shape, self.mesh, values, off_screen, window_size)


@value
class StoredModel:
    """What a model file holds: the model, and its training shapes where they are known.

    Attributes
    ----------
    model : ShapeModel
    scores : (N, K) float64, mm
        Scores of the training shapes; N is 0 where they are not known.
    ids : tuple of ShapeId
        The N training shapes.
    template : Template or None
        The triangulated base domain of the model's points; None for a model made elsewhere.
    """

    model: Annotated[ShapeModel, Axes("K")]
    scores: Annotated[FloatArray, Axes("N", "K")]
    ids: Annotated[tuple[ShapeId, ...], Axes("N")]
    template: Template | None

    def __post_init__(self) -> None:
        """Check what annotations cannot say."""
        if self.template is not None and not (
            len(self.template.points) == len(self.model.mean)
            and self.template.faces.shape == self.model.mesh.faces.shape
            and (self.template.faces == self.model.mesh.faces).all()
        ):
            raise InputError(
                f"template of a model: expected the model's own {len(self.model.mean)} points and "
                f"{len(self.model.mesh.faces)} triangles, found {len(self.template.points)} and "
                f"{len(self.template.faces)}, or others"
            )
