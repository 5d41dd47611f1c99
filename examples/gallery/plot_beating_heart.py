"""
Who and when: a beating heart
=============================

The phases of a few hearts are split into what differs between the hearts and what moves, and a
heart that nobody has measured beats.
"""

import matplotlib.pyplot as plt
import numpy as np

import ostiform
from ostiform.evaluation import clinical_measures, long_axes
from ostiform.model import (
    beating_shape,
    dynamic_model_of,
    phase_prediction,
    reconstruct,
    resampled_cycle,
    variance_shares,
)

stored = ostiform.read_model(ostiform.example_results() / "model.h5")
model = dynamic_model_of(stored)

# %%
# The variance of all shapes is exactly the sum of that between subjects and that within them; the
# latter is the motion common to all and each subject's own. The interval is over subjects.

for name, share in variance_shares(model).items():
    interval = "" if share.low is None else f" (95 %: {share.low:.2f} to {share.high:.2f})"
    print(f"{name}: {share.value:.3f}{interval}")

# %%
# Every subject's cycle is a closed curve, so it can be asked at any time. How well it predicts a
# phase that was left out, against the straight line between the phases beside it:

if np.isfinite(model.trajectories.left_out_errors).any():
    print(phase_prediction(model))

times = np.arange(40) / 40
axes = long_axes(reconstruct(stored.model, stored.scores), stored.model.mesh)
cycles = {name: resampled_cycle(model, name, times) for name in model.subjects}

# %%
# A heart with chosen scores between subjects, beating as the population does on average.

scores = np.zeros(len(model.between.modes))
scores[0] = 2.0 * np.sqrt(model.between.variances[0])
cycles["made, +2 sd"] = beating_shape(model, scores, times)

# %%
# Clinical numbers of measured and made hearts alike.

part = stored.model.mesh.parts[0]
figure, panels = plt.subplots(1, 2, figsize=(9, 3.5), layout="constrained")
for name, shapes in cycles.items():
    numbers = clinical_measures(shapes, stored.model.mesh, axes)
    style = "k--" if name.startswith("made") else "-"
    panels[0].plot(times, numbers[f"{part}_volume_ml"], style, label=name)
    panels[1].plot(times, numbers[f"{part}_long_axis_shortening_percent"], style)
panels[0].set_ylabel(f"{part} volume (ml)")
panels[1].set_ylabel(f"{part} long-axis shortening (%)")
for panel in panels:
    panel.set_xlabel("time (fraction of the cycle)")
figure.legend(loc="outside upper center", ncols=4)
plt.show()
