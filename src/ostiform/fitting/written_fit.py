"""A fit as files: the fitted surface as VTP, scores, pose and judgement as JSON."""

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from ostiform import __version__
from ostiform.arrays import FloatArray
from ostiform.atomic import atomically
from ostiform.fitting.prior import FitPrior
from ostiform.fitting.types import ShapeFit
from ostiform.surface import SurfaceDistance, write_surface
from ostiform.tables import write_table


def fit_facts(prior: FitPrior, fit: ShapeFit) -> dict[str, Any]:
    """Return a fit as JSON holds it: lengths in mm, matrices for column vectors."""
    leftover = prior.leftover
    return {
        "schema": 1,
        "package_version": __version__,
        "status": fit.status.value,
        "iterations": fit.iterations,
        "pose": {
            "matrix": fit.pose.matrix.tolist(),
            "scale": fit.pose.scale,
            "sd": dict(zip(("rotation_deg", "translation_mm", "scale"), fit.pose_sd, strict=True)),
        },
        "scores_mm": fit.scores.tolist(),
        "score_covariance_mm2": fit.score_covariance.tolist(),
        "point_sd_mm": {
            "mean": float(prior.model.weights @ fit.point_sd),
            "max": float(fit.point_sd.max()),
        },
        "residue_mm": {
            "data_to_model": _distance(fit.residues.to_model),
            "model_to_target": _distance(fit.residues.to_target),
            "share_of_model_covered": fit.residues.covered,
        },
        "noise_mm": dict(fit.noise_mm),
        "outlier_share": fit.outlier_share,
        "openings_matched": dict(fit.openings),
        "notes": list(fit.notes),
        "typicality": {
            **asdict(fit.typicality),
            "reasons": list(fit.typicality.reasons),
        },
        "leftover": {
            "variance_mm2": leftover.variance,
            "length_mm": leftover.length,
            "growth": leftover.growth,
            "source": leftover.source.value,
        },
    }


def write_fit(
    folder: Path, prior: FitPrior, fit: ShapeFit, fields: Mapping[str, FloatArray] | None = None
) -> dict[str, Any]:
    """Write ``fitted.vtp`` and ``fit.json`` to a folder, and return what the latter holds.

    The surface is the posterior mean in the target's frame, with the point arrays
    ``posterior_sd_mm`` (root mean square over the coordinates), ``normal_sd_mm``, ``residue_mm``
    (signed distance to the target, NaN where it has no surface) and the cell array ``part``; fields
    of the target (see `target_fields`) are point arrays too, and the columns of ``fields.csv``.

    Raises
    ------
    ArtifactError
        If the files cannot be written.
    """
    facts = fit_facts(prior, fit)
    mesh = prior.model.mesh
    write_surface(
        folder / "fitted.vtp",
        fit.points,
        mesh.faces,
        point_data={
            **(fields or {}),
            "posterior_sd_mm": fit.point_sd,
            "normal_sd_mm": fit.normal_sd,
            "residue_mm": np.asarray(fit.residue),
        },
        cell_data={"part": mesh.face_part},
    )
    if fields:
        rows = zip(*(values.tolist() for values in fields.values()), strict=True)
        write_table(
            folder / "fields.csv", ["point", *fields], ([k, *row] for k, row in enumerate(rows))
        )
    text = json.dumps(facts, indent=1, ensure_ascii=False)
    with atomically(folder / "fit.json") as partial:
        partial.write_text(text + "\n", encoding="utf-8")
    return facts


def _distance(distance: SurfaceDistance | None) -> dict[str, float] | None:
    return None if distance is None else asdict(distance)
