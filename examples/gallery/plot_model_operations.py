"""
The model as a value
====================

Every operation on a model returns a new model, shapes or scores, and changes nothing.
"""

import matplotlib.pyplot as plt
import numpy as np

import ostiform
from ostiform.model import at_level, point_deviations
from ostiform.report.animation import animation_of

stored = ostiform.read_model(ostiform.example_results() / "model.h5")
model = stored.model
print(f"{len(model.mean)} points, {len(model.modes)} modes, {model.total_variance:.2f} mm^2")

# %%
# **Project and reconstruct.** The scores of a shape are in millimetres; all modes together give
# back every shape of the training.

scores = stored.scores[4]
shape = model.reconstruct(scores)
print("error:", np.abs(model.project(shape) - scores).max(), "mm")

# %%
# **Sample.** Random shapes, equal for equal seeds.

samples = model.sample(3, seed=1)
frames = animation_of(model, samples, ["sample 1", "sample 2", "sample 3"], 1.0).frames
figure, axes = plt.subplots(figsize=(9.0, 3.0), layout="constrained")
axes.imshow(np.concatenate(frames, axis=1))
axes.set_axis_off()

# %%
# **Truncate.** What the modes leave joins the residual variance, so nothing is lost in the sum.

short = model.truncated(2)
print(f"{len(short.modes)} modes, {short.residual_variance:.2f} mm^2 of residual variance")

# %%
# **Marginalise to a part.** The atrium's own model: its modes are not the left heart's.

atrium = model.part("LA")
print(f"{len(atrium.mean)} points; openings {', '.join(atrium.mesh.loops)}")

# %%
# **Posterior.** Thirty points of the ventricle are seen, the first half to within 0.5 mm, the other
# half to within 3 mm. What is returned is the model of what remains open.

truth = model.reconstruct(np.sqrt(model.variances[:3]) * [1.5, -1.0, 0.5])
rng = np.random.default_rng(2)
points = rng.choice(np.flatnonzero(model.mesh.part == 0), 30, replace=False)
noise = np.where(np.arange(30) < 15, 0.5, 3.0)
seen = truth[points] + noise[:, None] * rng.normal(size=(30, 3))
after = model.posterior(points, seen, noise)
for name, one in (("before", model), ("after", after)):
    error = np.sqrt(model.weights @ ((one.mean - truth) ** 2).sum(axis=1))
    print(f"{name}: error {error:.2f} mm, variance left {one.total_variance:.3f} mm^2")

# %%
# **Resample.** Another triangulation of the mean, or one of the template's own coarser levels; the
# openings stay openings, and the weights are the new points' area shares.

coarse = model.resampled(250)
level = at_level(stored, len(stored.template.levels) - 1).model
for name, one in (("stored", model), ("resampled", coarse), ("level", level)):
    print(f"{name:<9} {len(one.mean):>4} points, {one.total_variance:.2f} mm^2 in all")

# %%
# **Draw.** `plot` returns a PyVista plotter, here of the standard deviation of every point.

print(f"between {point_deviations(model).min():.1f} and {point_deviations(model).max():.1f} mm")
plotter = model.plot(colour="deviation", off_screen=True)
plotter.show()

# %%
# The operations combine: the atrium, conditioned and truncated.

print(len(after.part("LA").truncated(2).modes), "modes")
