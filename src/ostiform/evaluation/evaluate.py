"""All the evidence about one model of a population in one call."""

from collections.abc import Sequence

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.correspondence import Correspondence, description_length
from ostiform.errors import InputError
from ostiform.evaluation.classical import FEWEST_SHAPES, classical_measures
from ostiform.evaluation.compactness import model_compactness
from ostiform.evaluation.coverage import population_coverage
from ostiform.evaluation.generalisation import Generalisation, OriginalMesh
from ostiform.evaluation.specificity import N_SAMPLES, model_specificity
from ostiform.evaluation.specificity_to_surface import surface_specificity
from ostiform.evaluation.truth import TruthDistance
from ostiform.evaluation.types import Evaluation
from ostiform.evaluation.variance import population_spread
from ostiform.model import ShapeModel


def evaluate_model(  # noqa: PLR0913 (evidence of many kinds is gathered)
    kind: str,
    model: ShapeModel,
    shapes: tuple[Correspondence, Correspondence],
    originals: Sequence[OriginalMesh],
    l_cut: float,
    seed: int,
    generalisation: Generalisation | None = None,
    truth: TruthDistance | None = None,
    *,
    samples: int = N_SAMPLES,
) -> Evaluation:
    """Gather the evidence about one model; what takes long is computed before and passed in.

    Parameters
    ----------
    kind : str
    model : ShapeModel
        Fitted to the aligned shapes of the correspondence.
    shapes : (Correspondence, Correspondence)
        The model's correspondence, and the initial one that no warp has touched, of the same
        shapes and template (the same one twice for the conformal model).
    originals : sequence of OriginalMesh
        Of all shapes, in study order.
    l_cut : float, mm^2
        Of the shared metric that the models of a comparison share.
    seed : int
        For the random shapes of the specificity: the same for the models of a comparison.
    generalisation : Generalisation, optional
    truth : TruthDistance, optional
    samples : int
        Random shapes of the specificity to points.

    Raises
    ------
    InputError
        If the two correspondences or the originals are not of the same shapes.
    """
    correspondence, initial = shapes
    if correspondence.ids != initial.ids or len(originals) != len(initial.ids):
        raise InputError(
            f"evaluation of the {kind} model: expected the same shapes in the correspondence, the "
            f"initial one and the originals, found {len(correspondence.ids)}, {len(initial.ids)} "
            f"and {len(originals)}"
        )
    return Evaluation(
        kind=kind,
        ids=correspondence.ids,
        compactness=model_compactness(model),
        description_length=description_length(correspondence.aligned, model.weights, l_cut),
        l_cut=l_cut,
        specificity=model_specificity(
            model, correspondence.aligned, np.random.default_rng(seed), samples
        ),
        coverage=population_coverage(
            originals, correspondence.points, initial.points, correspondence.template.faces
        ),
        generalisation=generalisation,
        truth=truth,
        spread=population_spread(
            correspondence.aligned,
            _in_pose(initial.points, correspondence.transforms),
            model.weights,
            correspondence.template.faces,
        ),
        surface_specificity=surface_specificity(
            model,
            correspondence.aligned,
            correspondence.transforms,
            originals,
            np.random.default_rng(seed),
        ),
        classical=None
        if len(correspondence.ids) < FEWEST_SHAPES
        else classical_measures(
            correspondence.aligned, np.random.default_rng(seed), n_samples=samples
        ),
    )


def _in_pose(points: FloatArray, transforms: FloatArray) -> FloatArray:
    """Return the shapes (N, P, 3) carried by their transforms (N, 4, 4)."""
    moved: FloatArray = points @ np.swapaxes(transforms[:, :3, :3], 1, 2)
    return moved + transforms[:, None, :3, 3]
