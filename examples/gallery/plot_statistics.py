"""
Groups and covariates
=====================

Whether and where shape differs between two groups, with age adjusted for. The population is drawn
from the model of the example study, with an effect planted in it, so the answer is known.
"""

import numpy as np

import ostiform
from ostiform.model import StoredModel, fit_model
from ostiform.report.effects import effect_figure, null_figure
from ostiform.statistics import (
    Covariate,
    EffectSettings,
    covariate_of,
    shape_effect,
    subject_shapes,
)
from ostiform.study import ShapeId

source = ostiform.read_model(ostiform.example_results() / "model.h5").model

# %%
# Thirty subjects in three phases. In patients the left superior pulmonary vein is longer by 6 mm at
# its end; with every year of age the ventricle grows by 0.2 %.

rng = np.random.default_rng(4)
tip = source.mean[source.mesh.loops["LA.LSPV"]].mean(axis=0)
direction = tip - source.mean[source.mesh.part == 1].mean(axis=0)
near_tip = np.exp(-((np.linalg.norm(source.mean - tip, axis=1) / 14.0) ** 2))
planted = 6.0 * near_tip[:, None] * direction / np.linalg.norm(direction)
growth = 0.002 * (source.mean - source.mean.mean(axis=0)) * (source.mesh.part == 0)[:, None]
group = ["patient" if subject % 2 else "control" for subject in range(30)]
age = rng.uniform(30.0, 80.0, size=30)
ids, shapes = [], []
for subject in range(30):
    own = 0.5 * rng.normal(size=4) * np.sqrt(source.variances[:4])
    for phase in range(3):
        beat = own + [2.0 * np.cos(2.0 * np.pi * phase / 3.0), 0.0, 0.0, 0.0]
        shape = source.reconstruct(beat) + (age[subject] - 55.0) * growth
        shape = shape + (group[subject] == "patient") * planted
        ids.append(ShapeId(f"S{subject + 1}", str(phase), phase / 3.0))
        shapes.append(shape + 0.3 * rng.normal(size=shape.shape))
shapes = np.array(shapes)
model = fit_model(shapes, source.weights, source.mesh)
stored = StoredModel(model, model.project(shapes), tuple(ids), None)

# %%
# Subjects are compared, not shapes: each counts once, by its mean over the cycle.

subjects = subject_shapes(stored)
print(f"{len(subjects.subjects)} subjects, each by its {subjects.what}")
settings = EffectSettings(permutations=1999, seed=1)
effect = shape_effect(
    model, subjects, covariate_of("group", group), [Covariate("age", age)], settings
)
print(f"whole shape: p = {effect.whole.p_value:.4f} ({effect.whole.n_modes} modes)")

# %%
# Where: every point has a q-value (the share of false ones among the points found, Benjamini and
# Hochberg). Nearly all points found move by more than 1 mm in truth.

found = effect.points.q_value <= 0.05
moved = np.linalg.norm(planted, axis=1) > 1.0
print(f"{found.sum()} points found, {(found & moved).sum()} of them among the {moved.sum()} moved")
figure = effect_figure(model, effect)

# %%
# Whether: the statistic among those of permuted subjects. A small patch is a small share of the
# whole shape, so this test sees it less clearly than the map does.

figure = null_figure(effect.whole)

# %%
# The same for age, adjusted for the group: an effect of the whole ventricle.

effect = shape_effect(
    model, subjects, Covariate("age", age), [covariate_of("group", group)], settings
)
print(f"whole shape: p = {effect.whole.p_value:.4f}")
print(f"{(effect.points.q_value <= 0.05).sum()} points found")
figure = effect_figure(model, effect)
