"""
Shapes that correspond already
==============================

A model of meshes that share their vertex order, wherever they come from, and the same model widened
by smooth displacements because it was built from few shapes.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import ostiform
from ostiform.model import (
    Kernel,
    fit_model,
    posterior,
    read_corresponded_shapes,
    widened,
)
from ostiform.pipeline.adopt import adopt_shapes
from ostiform.pipeline.adopt_sources import SourceSettings
from ostiform.pipeline.export import export_results

# %%
# A folder of meshes that share their vertex order, made here by exporting the example.

folder = Path(tempfile.mkdtemp())
export_results(ostiform.example_results(), folder, ["vtp"])
settings = SourceSettings(pattern="{subject}_{phase}.vtp", parts=("LV", "LA"))
adopted = adopt_shapes(folder / "shapes", folder / "adopted", settings)
print(f"{adopted.shapes} shapes of {adopted.points} points, {adopted.modes} modes")
print("\n".join(adopted.notes))

# %%
# Leave one subject out, build the model of the other two, and widen it. Then show it every tenth
# point of the subject left out and let it predict the rest.

shapes = read_corresponded_shapes(folder / "adopted" / "correspondence.h5")
subjects = np.array([id.subject for id in shapes.ids])
left_out = subjects == subjects[-1]
plain = fit_model(shapes.aligned[~left_out], shapes.weights, shapes.mesh)
seen = np.arange(0, len(shapes.weights), 10)
unseen = np.setdiff1d(np.arange(len(shapes.weights)), seen)


def error(model):
    """Root mean square distance of the points predicted from the points that are there, mm."""
    found = [posterior(model, seen, shape[seen], 0.5).mean for shape in shapes.aligned[left_out]]
    squared = ((np.stack(found) - shapes.aligned[left_out]) ** 2).sum(axis=2)
    return float(np.sqrt(squared[:, unseen].mean()))


lengths = np.array([10.0, 15.0, 20.0, 30.0, 40.0, 60.0])
results = [widened(plain, [Kernel(2.0, length)]) for length in lengths]
for length, result in zip(lengths, results, strict=True):
    print(
        f"{length:3.0f} mm: {result.added_variance:.2f} mm² per point added to "
        f"{plain.total_variance:.2f}, {len(result.model.modes)} modes, "
        f"error {error(result.model):.2f} mm"
    )

figure, axes = plt.subplots(figsize=(6, 3), layout="constrained")
axes.plot(lengths, [error(result.model) for result in results], "o-", label="widened by 2 mm")
axes.axhline(error(plain), color="0.4", linestyle="--", label="as it was built")
axes.set(xlabel="length of the kernel, mm", ylabel="error at unseen points, mm", ylim=(0.0, None))
axes.legend(frameon=False)
