"""Statistical shape models as values: a mean, modes, variances, and the mesh they live on.

The methods of `ShapeModel` are the functions of `ostiform.model` under short names; these modules
build on this one and are therefore imported where they are called.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike

from ostiform.arrays import FloatArray, IntArray, frozen_floats, frozen_ints, frozen_mapping
from ostiform.domain import Template
from ostiform.errors import InputError
from ostiform.study import ShapeId

if TYPE_CHECKING:
    import pyvista

ORTHONORMAL_TOLERANCE = 1e-8
"""Largest entry of |Phi^T W Phi - I|, a pure number: rounding of sums over 3P products."""

WEIGHT_SUM_TOLERANCE = 1e-9
"""Of a sum of shares that is 1: rounding, weights that were written in double precision."""


@dataclass(frozen=True, slots=True, eq=False)
class ModelMesh:
    """The triangulation that a model's points share, with the names of its parts and openings.

    Attributes
    ----------
    faces : (F, 3) int64
        Point indices, counter-clockwise seen from outside.
    face_part : (F,) int64
        Index into `parts`.
    part : (P,) int64
        Index into `parts`; a seam point carries the first part of its seam.
    parts : tuple of str
    loops : mapping of str to (n,) int64
        Points of each ostium's rim by full name, surface of that part on the left.
    """

    faces: IntArray
    face_part: IntArray
    part: IntArray
    parts: tuple[str, ...]
    loops: Mapping[str, IntArray]

    def __post_init__(self) -> None:
        """Check the arrays and make them read-only."""
        object.__setattr__(self, "faces", frozen_ints(self.faces, (None, 3), "faces"))
        object.__setattr__(
            self, "face_part", frozen_ints(self.face_part, (len(self.faces),), "face_part")
        )
        object.__setattr__(self, "part", frozen_ints(self.part, (None,), "part"))
        object.__setattr__(
            self,
            "loops",
            frozen_mapping(
                {n: frozen_ints(loop, (None,), f"loop {n}") for n, loop in self.loops.items()}
            ),
        )
        for name, indices, count in (
            ("faces", self.faces, len(self.part)),
            ("face_part", self.face_part, len(self.parts)),
            ("part", self.part, len(self.parts)),
            *((f"loop {n}", loop, len(self.part)) for n, loop in self.loops.items()),
        ):
            if indices.size and (indices.min() < 0 or indices.max() >= count):
                raise InputError(
                    f"{name}: expected indices from 0 to {count - 1}, "
                    f"found {int(indices.min())} to {int(indices.max())}"
                )


def mesh_of_template(template: Template) -> ModelMesh:
    """Return what a model keeps of a template: its triangles, parts and openings."""
    return ModelMesh(
        faces=template.faces,
        face_part=template.face_part,
        part=template.part,
        parts=template.parts,
        loops=template.loops,
    )


@dataclass(frozen=True, slots=True, eq=False)
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

    mean: FloatArray
    modes: FloatArray
    variances: FloatArray
    weights: FloatArray
    mesh: ModelMesh
    residual_variance: float
    sample_count: int

    def __post_init__(self) -> None:
        """Check the arrays and make them read-only."""
        count = len(self.mesh.part)
        object.__setattr__(self, "mean", frozen_floats(self.mean, (count, 3), "mean"))
        object.__setattr__(self, "modes", frozen_floats(self.modes, (None, count, 3), "modes"))
        object.__setattr__(
            self, "variances", frozen_floats(self.variances, (len(self.modes),), "variances")
        )
        object.__setattr__(self, "weights", frozen_floats(self.weights, (count,), "weights"))
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

    def project(self, shapes: FloatArray) -> FloatArray:
        """Return the scores (..., K) in mm of shapes (..., P, 3): see `ostiform.model.project`."""
        from ostiform.model import pca

        return pca.project(self, shapes)

    def reconstruct(self, scores: ArrayLike) -> FloatArray:
        """Return the shapes (..., P, 3) in mm of scores: see `ostiform.model.reconstruct`."""
        from ostiform.model import pca

        return pca.reconstruct(self, np.asarray(scores, dtype=np.float64))

    def sample(self, count: int = 1, seed: int = 0, limit: float = 3.0) -> FloatArray:
        """Return random shapes (count, P, 3) in mm, equal for equal seeds.

        Scores are truncated at `limit` standard deviations: see `ostiform.model.sample_shapes`.
        """
        from ostiform.model import pca

        return pca.sample_shapes(self, count, np.random.default_rng(seed), limit)

    def truncated(self, n_modes: int) -> "ShapeModel":
        """Return the model with its first modes only: see `ostiform.model.truncated`."""
        from ostiform.model import pca

        return pca.truncated(self, n_modes)

    def part(self, name: str) -> "ShapeModel":
        """Return the model of one part: see `ostiform.model.part_marginal`."""
        from ostiform.model import pca

        return pca.part_marginal(self, name)

    def marginal(self, points: IntArray) -> "ShapeModel":
        """Return the model of some of the points: see `ostiform.model.marginal`."""
        from ostiform.model import pca

        return pca.marginal(self, points)

    def posterior(
        self, points: IntArray, positions: FloatArray, noise_mm: FloatArray | float
    ) -> "ShapeModel":
        """Return what remains open once some points are seen: see `ostiform.model.posterior`."""
        from ostiform.model import pca

        return pca.posterior(self, points, positions, noise_mm)

    def resampled(self, n_points: int) -> "ShapeModel":
        """Return the model on a new, even mesh of its mean: see `ostiform.model.resampled`."""
        from ostiform.model import resampling

        return resampling.resampled(self, n_points)

    def resampled_onto(self, vertices: FloatArray, faces: IntArray) -> "ShapeModel":
        """Return the model on a given mesh near its mean: see `ostiform.model.resampled_onto`."""
        from ostiform.model import resampling

        return resampling.resampled_onto(self, vertices, faces)

    def plot(
        self,
        scores: ArrayLike = (),
        colour: Literal["part", "displacement", "deviation"] = "part",
        off_screen: bool | None = None,
        window_size: Sequence[int] = (800, 700),
    ) -> "pyvista.Plotter":
        """Return a PyVista plotter of one shape: see `ostiform.model.model_plotter`."""
        from ostiform.model import plotting

        return plotting.model_plotter(self, scores, colour, off_screen, window_size)


@dataclass(frozen=True, slots=True, eq=False)
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

    model: ShapeModel
    scores: FloatArray
    ids: tuple[ShapeId, ...]
    template: Template | None

    def __post_init__(self) -> None:
        """Check the arrays and make them read-only."""
        object.__setattr__(
            self,
            "scores",
            frozen_floats(self.scores, (len(self.ids), len(self.model.modes)), "scores"),
        )
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


def check_weights(weights: FloatArray) -> None:
    """Raise `InputError` unless point weights are positive and sum to one."""
    total = float(weights.sum())
    if (weights <= 0.0).any():
        worst = int(np.argmin(weights))
        raise InputError(
            f"point weights: expected positive area shares, found {weights[worst]:.3g} "
            f"at point {worst}"
        )
    if abs(total - 1.0) > WEIGHT_SUM_TOLERANCE:
        raise InputError(f"point weights: expected a sum of 1, found {total:.12g}")
