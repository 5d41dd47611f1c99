"""
Fitting to data never seen
==========================

A heart is left out of a model, cut into six short-axis contours, and found again from those.
"""

import numpy as np
import pyvista

import ostiform
from ostiform.evaluation import surface_distances
from ostiform.fitting import ContourTarget, SurfaceTarget, fit_prior, fit_shape
from ostiform.model import StoredModel, fit_model, project, reconstruct

stored = ostiform.read_model(ostiform.example_results() / "model.h5")
model = stored.model
shapes = reconstruct(model, stored.scores)  # exact: no mode was left out

# %%
# A model without the last subject. `fit_prior` adds what new shapes have and the training shapes
# had not: a smooth field, measured by leaving training shapes out in turn.

subject = stored.ids[-1].subject
train = [k for k, id in enumerate(stored.ids) if id.subject != subject]
truth = shapes[-1]
smaller = fit_model(shapes[train], model.weights, model.mesh)
scores = project(smaller, shapes[train])
prior = fit_prior(StoredModel(smaller, scores, tuple(stored.ids[k] for k in train), None))
print(f"beyond the modes: {prior.leftover.variance:.1f} mm2 per point")

# %%
# Six contours across the long axis of the left ventricle.

ventricle = truth[model.mesh.part == model.mesh.parts.index("LV")]
middle = ventricle.mean(axis=0)
axis = np.linalg.svd(ventricle - middle)[2][0]
height = (truth - middle) @ axis
surface = pyvista.PolyData.from_regular_faces(truth, model.mesh.faces)
contours = []
for level in np.linspace(height.min(), height.max(), 13)[1::2]:
    rings = surface.slice(normal=axis, origin=middle + level * axis).strip(max_length=10_000)
    for k in range(rings.n_cells):
        contours.append(np.asarray(rings.get_cell(k).points, dtype=np.float64))

# %%
# The fit: pose, shape and their uncertainty. The same call takes surfaces, points and landmarks.


def error(points):
    """Return the mean distance in mm between a shape and the truth, both ways."""
    faces = model.mesh.faces
    return surface_distances(points[None], faces, truth, faces)[0].mean


fit = fit_shape(prior, [ContourTarget(tuple(contours))])
whole = fit_shape(prior, [SurfaceTarget(truth, model.mesh.faces, {})])
floor = reconstruct(smaller, project(smaller, truth))
for name, points in (
    ("mean shape", smaller.mean),
    ("six contours", fit.points),
    ("whole surface", whole.points),
    ("best projection", floor),
):
    print(f"{name}: {error(points):.2f} mm from the truth")
print(f"posterior sd of a point: {fit.point_sd.mean():.2f} mm")
print(f"Mahalanobis distance {fit.typicality.mahalanobis:.1f}")

# %%
# The mean, the truth and the fit from six contours.

figure = ostiform.figures.shapes(
    smaller, np.stack([smaller.mean, truth, fit.points]), ("mean", "truth", "fit")
)
