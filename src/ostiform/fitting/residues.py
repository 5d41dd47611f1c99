"""How far the data and the fitted surface are apart, in both directions."""

import numpy as np

from ostiform.arrays import FloatArray
from ostiform.fitting.data import Data
from ostiform.fitting.patches import closest_on_curve
from ostiform.fitting.prior import FitPrior
from ostiform.fitting.types import Residue
from ostiform.surface import (
    SurfaceDistance,
    closest_points,
    surface_tree,
    vertex_areas,
    vertex_normals,
    weighted_quantile,
)


def measured_residues(
    prior: FitPrior, data: Data, points: FloatArray
) -> tuple[FloatArray, FloatArray, Residue]:
    """Return the normals of fitted points, their residues, and the residues in both directions.

    Parameters
    ----------
    prior : FitPrior
    data : Data
    points : (P, 3) float64, mm
        In the target's frame.

    Returns
    -------
    normals : (P, 3) float64
    residue : (P,) float64, mm
        Signed distance to the target's surface, positive where it lies outside; NaN where the
        target has no surface opposite.
    residues : Residue
    """
    normals = vertex_normals(points, prior.model.mesh.faces)
    points = np.ascontiguousarray(points)
    residue = np.full(len(points), np.nan)
    distances, weights = [], []
    for surface in data.surfaces:
        patch = data.patches[surface.part]
        own = surface_tree(points, patch.faces)
        areas = vertex_areas(surface.tree.vertices, surface.tree.faces)
        used = areas > 0.0
        distances.append(closest_points(own, surface.tree.vertices[used]).distances)
        weights.append(areas[used])
        chosen = np.unique(patch.faces)
        found = closest_points(surface.tree, points[chosen])
        offset = found.points - points[chosen]
        side = np.where(np.einsum("ni,ni->n", offset, normals[chosen]) >= 0.0, 1.0, -1.0)
        signed = np.where(surface.patch.ends_at(found), np.nan, side * found.distances)
        nearer = ~(np.abs(signed) >= np.abs(residue[chosen])) & np.isfinite(signed)
        residue[chosen[nearer]] = signed[nearer]
    for item in data.point_sets:
        own = surface_tree(points, data.patches[item.part].faces)
        distances.append(closest_points(own, item.points).distances)
        weights.append(np.ones(len(item.points)))
    if data.is_labelled_only:
        distances.append(_labelled_distances(prior, data, points))
        weights.append(np.ones(len(distances[-1])))
    seen = np.isfinite(residue)
    own_areas = vertex_areas(points, prior.model.mesh.faces)
    return (
        normals,
        residue,
        Residue(
            to_model=_summary(np.concatenate(distances), np.concatenate(weights)),
            median=weighted_quantile(np.concatenate(distances), np.concatenate(weights), 0.5),
            to_target=_summary(np.abs(residue[seen]), own_areas[seen]) if seen.any() else None,
            covered=float(own_areas[seen].sum() / own_areas.sum()),
        ),
    )


def _labelled_distances(prior: FitPrior, data: Data, points: FloatArray) -> FloatArray:
    loops = prior.model.mesh.loops
    centres = np.array([points[rim].mean(axis=0) for rim in loops.values()]).reshape(-1, 3)
    everything = np.concatenate([points, centres])
    found = [np.linalg.norm(everything[data.labelled.points] - data.labelled.positions, axis=1)]
    for name, positions in data.labelled.on_rims.items():
        nearest = closest_on_curve(points[loops[name]], positions)[2]
        found.append(np.linalg.norm(nearest - positions, axis=1))
    return np.concatenate(found)


def _summary(distances: FloatArray, weights: FloatArray) -> SurfaceDistance:
    return SurfaceDistance(
        mean=float(weights @ distances / weights.sum()),
        p95=weighted_quantile(distances, weights, 0.95),
        maximum=float(distances.max()),
    )
