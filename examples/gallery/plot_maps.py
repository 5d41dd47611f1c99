"""
How a surface gets onto the sphere
==================================

The map of the left atrium step by step, and the paper's own chain on the same mesh.
"""

import ostiform

results = ostiform.read_results(ostiform.example_results())

# %%
# Five openings (the mitral annulus is the outer circle, four veins lie inside) are brought to
# circles and stay there. Triangles that are turned over are orange; the last state has none, by
# exact arithmetic. The lower row enlarges the dashed square.

figure = ostiform.figures.maps(results, "S1/00", "LA")

# %%
# The paper's chain on the same mesh: harmonic maps fold where a circle is much wider than the
# radius that the opening gets in the conformal map.

figure = ostiform.figures.paper_maps(results, "S1/00", "LA")

# %%
# How much the maps of all shapes distort angles and areas; 1 is no distortion.

figure = ostiform.figures.distortion(results)
