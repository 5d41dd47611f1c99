"""The real surfaces beside the repository as components of one part, openings by size."""

from pathlib import Path

import numpy as np
import pyvista as pv

from ostiform.surface import (
    Component,
    boundary_loops,
    oriented_outward,
    without_unreferenced,
)


def left_atrium(folder: Path, number: int) -> Component:
    """Openings ``LA.0`` (the longest: mitral) to ``LA.4``."""
    mesh = pv.read(folder / "left-atria" / f"LA_with_fibers_{number}.vtk")
    return _component(mesh.extract_surface(algorithm=None), "LA")


def left_heart_template(folder: Path) -> Component:
    mesh = pv.read(folder / "left-heart-template" / "lh_template.vtp")
    wall = mesh.extract_cells(np.asarray(mesh.cell_data["ModelFaceID"]) == 1)
    return _component(wall.extract_surface(algorithm=None), "LH")


def ventricle_phase(folder: Path, phase: int) -> Component:
    mesh = pv.read(folder / "lv-cine" / f"patient1_LV_ENDOCARDIAL_{phase:03d}.vtk")
    return _component(mesh.extract_surface(algorithm=None), "LV")


def _component(mesh: pv.PolyData, part: str) -> Component:
    triangles = mesh.triangulate()
    faces = np.asarray(triangles.faces).reshape(-1, 4)[:, 1:].astype(np.int64)
    vertices = np.asarray(triangles.points, dtype=np.float64)
    kept, faces = without_unreferenced(faces, len(vertices))
    vertices = vertices[kept]
    faces = oriented_outward(vertices, faces)
    loops = sorted(boundary_loops(faces), key=lambda loop: -_length(vertices[loop]))
    rims = {f"{part}.{number}": loop for number, loop in enumerate(loops)}
    return Component(part, (part,), vertices, faces, np.zeros(len(faces), dtype=np.int64), rims, {})


def _length(points):
    return np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1).sum()
