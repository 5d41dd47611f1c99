"""Spoil a generated population: noise on its surfaces, vessels cut shorter, each at random."""

from pathlib import Path

import numpy as np

from ostiform.demo.truth import Truth
from ostiform.surface import read_mesh, tube_cut, vertex_normals, write_surface

WIDEST_CUT_MM = 10.0
"""Openings of a larger radius are anatomy (valves): they are not cut."""


def spoiled(folder: Path, truth: Truth, noise_mm: float, cuts_mm: float) -> None:
    """Cut the vessels of a written population shorter and add noise to its vertices.

    Parameters
    ----------
    folder : Path
        As `write_population` left it; its surfaces are written again.
    truth : Truth
        Of the population, which stays that of the shapes as they were before.
    noise_mm : float
        Standard deviation of independent displacements of the vertices along their normals.
    cuts_mm : float
        Every vessel loses a length between 0 and this, in material coordinates.
    """
    if noise_mm == 0.0 and cuts_mm == 0.0:
        return
    rng = np.random.default_rng([truth.seed, 5])
    for shape_id, deformation in truth.deformations.items():
        for part in truth.anatomy.seeds:
            path = folder / "shapes" / f"{shape_id.subject}_{shape_id.phase}_{part}.vtp"
            mesh = read_mesh(path)
            vertices, faces = mesh.vertices, mesh.faces
            for _, _, cut in truth.anatomy.part_cuts(part):
                if cuts_mm and cut.second is None and cut.radius_mm < 1.9 * WIDEST_CUT_MM:
                    lost = rng.uniform(0.0, cuts_mm)
                    height = cut.height(deformation.inverse(vertices))[0] + lost
                    center = deformation.forward((cut.center - lost * cut.normal)[None])[0]
                    short = tube_cut(vertices, faces, height, center, cut.radius_mm)
                    used, corners = np.unique(short.faces, return_inverse=True)
                    vertices, faces = short.vertices[used], corners.reshape(-1, 3)
            if noise_mm:
                along = rng.normal(0.0, noise_mm, size=len(vertices))
                vertices = vertices + along[:, None] * vertex_normals(vertices, faces)
            write_surface(path, vertices, faces)
