"""
A first look at the results
===========================

What a results folder holds, and the figures of the report as Matplotlib figures.
"""

import numpy as np

import ostiform

results = ostiform.read_results(ostiform.example_results())
model = results.model
print(f"{len(results.correspondence.ids)} shapes, {len(model.mean)} points")
print("share of the first modes:", np.round(model.variances[:4] / model.total_variance, 3))
print("left out:", results.left_out or "none")

# %%
# The mean heart displaced along the first mode, from two sides (Fig. 3 of the paper). The ventricle
# is violet, the atrium blue; black lines are openings and the seam between the two.

figure = ostiform.figures.mode(model, 0)

# %%
# The scores of the shapes: the phases of a subject are joined in order of time.

figure = ostiform.figures.scores(results)

# %%
# The evidence: the three models of the paper side by side (its Fig. 4). With three subjects the
# intervals are wide.

figure = ostiform.figures.evidence(results)

# %%
# Volumes over the cycle, openings capped flat.

figure = ostiform.figures.volumes(results)
