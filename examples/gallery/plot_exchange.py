"""
Files for other programs
========================

The results of a build as statismo, VTP, glTF, CSV and ShapeWorks files, and a model file of
another program read back.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import ostiform
from ostiform.exchange import mean_cycle_frames, read_particles, write_cycle_glb, write_modes_glb
from ostiform.model import read_statismo
from ostiform.pipeline.export import export_results

results = ostiform.example_results()
folder = Path(tempfile.mkdtemp())

# %%
# Everything at once, as ``ostiform export RESULTS -o FOLDER`` does.

written = export_results(results, folder)
for suffix in sorted({path.suffix for path in written}):
    print(f"{sum(path.suffix == suffix for path in written):3d} files {suffix}")

# %%
# The modes as one animated glTF file: every mode is a morph target, a weight of 1 is one standard
# deviation. The mean cycle is an animation too; how far it is from the cycle's own frames is said.

stored = ostiform.read_model(results / "model.h5")
write_modes_glb(folder / "modes.glb", stored.model, n_modes=3)
frames = mean_cycle_frames(stored)
error = write_cycle_glb(folder / "cycle.glb", stored.model.mesh, frames)
print(f"modes.glb: {(folder / 'modes.glb').stat().st_size / 1e3:.0f} kB")
print(f"cycle.glb: {len(frames.times)} frames, largest error {error:.3f} mm")

# %%
# What other programs read of ``model.h5`` has no area weights: all points count alike. It is the
# same distribution of the points, with modes and variances of its own.

theirs = read_statismo(folder / "model.h5")
figure, axes = plt.subplots(figsize=(6, 3), layout="constrained")
modes = np.arange(1, 9)
axes.bar(modes - 0.2, stored.model.variances[:8], 0.4, label="area-weighted (Ostiform)")
axes.bar(modes + 0.2, theirs.variances[:8], 0.4, label="equal weights (statismo layout)")
axes.set(xlabel="mode", ylabel="variance, mm² per point")
axes.legend(frameon=False)

# %%
# Particles of one shape, in its own frame.

particles = read_particles(next((folder / "particles").glob("*_local.particles")))
print(f"{len(particles)} particles, the first at {np.round(particles[0], 2)} mm")
