"""Turn meshes of left hearts into label maps of coarse slices, and see what comes back.

``python examples/label_maps.py STUDY OUT`` takes a study written by ``ostiform demo`` (the folder
that holds ``shapes.csv``), and writes OUT/maps/*.nii.gz (LV = 1, LA = 2) with voxels of 1.2 x 1.2 x
7 mm, the slices across the long axis of the ventricle as in cine imaging; OUT/maps/*.mrk.json, the
planes of 3D Slicer that open aorta and veins; and OUT/study.toml. It then reads the study as
``ostiform build`` does, and prints how far the surfaces are from the meshes they were made from.
"""

import argparse
import csv
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import igl
import nibabel
import numpy as np
from scipy.spatial import cKDTree

from ostiform.arrays import FloatArray, IntArray
from ostiform.pipeline.check import check_study
from ostiform.study import Shape, ShapeEntry, Study, read_shape, read_study
from ostiform.surface import Surface, closest_points, face_areas, surface_tree

LABELS = {"LV": 1, "LA": 2}
MARGIN_MM = 15.0
INSIDE_MM = 5.0
"""Tubes are cut this far from where the label ends: its own end is a blind cap."""
TO_RAS = np.diag([-1.0, -1.0, 1.0, 1.0])

STUDY = """schema = 1
units = "mm"
frame = "LPS"

[parts.LV]
ostia = ["mitral", "aortic"]

[parts.LA]
ostia = ["mitral", "RSPV", "RIPV", "LSPV", "LIPV"]

[[seams]]
first = "LV.mitral"
second = "LA.mitral"

[shapes]
sheet = "shapes.csv"

[labels]
values = {LV = 1, LA = 2}
edge_mm = 2.5

[cuts]
markups = "maps/{subject}_{phase}.mrk.json"
"""


@dataclass(frozen=True, slots=True)
class Difference:
    """How far a recovered surface is from the true one, mm.

    Attributes
    ----------
    mean, p95, largest : float
        Of the distance of the recovered surface from the true one, by area.
    mean_at_ends : float
        Of what lies within one slice of either end of the true surface.
    annulus : float
        Mean distance of the recovered mitral annulus from the true one.
    """

    mean: float
    p95: float
    largest: float
    mean_at_ends: float
    annulus: float


def main() -> None:
    """Write the maps, read them, and print the differences."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("study", type=Path, help="folder of a study that `ostiform demo` wrote")
    parser.add_argument("out", type=Path)
    parser.add_argument("--spacing", type=float, nargs=3, default=(1.2, 1.2, 7.0))
    parser.add_argument("--every", type=int, default=1, help="take every n-th shape only")
    given = parser.parse_args()
    true = read_study(given.study / "study.toml")
    chosen = true.entries[:: given.every]
    (given.out / "maps").mkdir(parents=True, exist_ok=True)
    axes = {
        str(entry.id): write_maps(read_shape(true, entry), given.out / "maps", given.spacing)
        for entry in chosen
    }
    write_study(given.out, chosen)
    report(true, read_study(given.out / "study.toml"), axes, given.spacing[2])


def write_maps(shape: Shape, folder: Path, spacing: tuple[float, ...]) -> FloatArray:
    """Write the label map and the planes of one shape; return the direction across the slices."""
    ventricle = shape.parts["LV"].vertices
    mitral = ventricle[shape.parts["LV"].loops["mitral"]].mean(axis=0)
    apex = ventricle[np.linalg.norm(ventricle - mitral, axis=1).argmax()]
    axis = (mitral - apex) / np.linalg.norm(mitral - apex)
    across = np.linalg.svd(axis[None])[2][1:]
    frame = np.column_stack([across[0], np.cross(axis, across[0]), axis])
    points = np.vstack([part.vertices for part in shape.parts.values()]) @ frame
    low, high = points.min(axis=0) - MARGIN_MM, points.max(axis=0) + MARGIN_MM
    size = np.ceil((high - low) / spacing).astype(int)
    index = np.stack(np.meshgrid(*map(np.arange, size), indexing="ij"), -1).reshape(-1, 3)
    centers = (low + index * spacing) @ frame.T
    labels = np.zeros(len(centers), dtype=np.uint8)
    for name, value in LABELS.items():
        vertices, faces = capped(shape.parts[name])
        labels[igl.fast_winding_number(vertices, faces, centers) > 0.5] = value
    affine = np.eye(4)
    affine[:3, :3], affine[:3, 3] = frame * spacing, frame @ low
    stem = f"{shape.id.subject}_{shape.id.phase}"
    image = nibabel.Nifti1Image(labels.reshape(size), TO_RAS @ affine)
    nibabel.save(image, folder / f"{stem}.nii.gz")
    planes = {"markups": [plane(shape, name) for name in tubes(shape)]}
    (folder / f"{stem}.mrk.json").write_text(json.dumps(planes), encoding="utf-8")
    return axis


def capped(part: Surface) -> tuple[FloatArray, IntArray]:
    """Return a part with every opening closed by a cone over its centre."""
    tips = [part.vertices[loop].mean(axis=0) for loop in part.loops.values()]
    fans = [
        np.stack([np.roll(loop, -1), loop, np.full(len(loop), len(part.vertices) + k)], axis=1)
        for k, loop in enumerate(part.loops.values())
    ]
    return np.vstack([part.vertices, *tips]), np.vstack([part.faces, *fans])


def tubes(shape: Shape) -> list[str]:
    """Return the full names of the openings that are no seam's."""
    return [
        f"{part}.{ostium}"
        for part, surface in shape.parts.items()
        for ostium in surface.loops
        if ostium != "mitral"
    ]


def plane(shape: Shape, name: str) -> dict[str, object]:
    """Return the markup of the plane across a tube, a little inside its end."""
    part, ostium = name.split(".")
    surface = shape.parts[part]
    rim = surface.vertices[surface.loops[ostium]]
    center = rim.mean(axis=0)
    normal = np.linalg.svd(rim - center)[2][2]
    near = surface.vertices[np.linalg.norm(surface.vertices - center, axis=1) < 3 * INSIDE_MM]
    inward = np.sign((near.mean(axis=0) - center) @ normal)
    return {
        "type": "Plane",
        "name": name,
        "coordinateSystem": "LPS",
        "center": (center + INSIDE_MM * inward * normal).tolist(),
        "normal": normal.tolist(),
        "size": [30.0, 30.0],
    }


def write_study(out: Path, entries: tuple[ShapeEntry, ...]) -> None:
    """Write the study file and its sheet."""
    with (out / "shapes.csv").open("w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream)
        table.writerow(["subject", "phase", "time", "file"])
        for entry in entries:
            name = f"maps/{entry.id.subject}_{entry.id.phase}.nii.gz"
            table.writerow([entry.id.subject, entry.id.phase, entry.id.time, name])
    (out / "study.toml").write_text(STUDY, encoding="utf-8")


def report(true: Study, made: Study, axes: Mapping[str, FloatArray], slice_mm: float) -> None:
    """Print what cannot be used, and a table of the differences by part."""
    entries = {str(entry.id): entry for entry in true.entries}
    found: dict[str, list[Difference]] = {name: [] for name in LABELS}
    for check in check_study(made.path):
        if check.problem is not None:
            print(check.problem)
    for entry in made.entries:
        here = read_shape(made, entry)
        there = read_shape(true, entries[str(entry.id)])
        for name, rows in found.items():
            axis = axes[str(entry.id)]
            rows.append(difference(here.parts[name], there.parts[name], axis, slice_mm))
    print(
        "| part | mean mm | 95 % mm | largest mm | mean at the end slices mm | mitral annulus mm |"
    )
    print("|---|---|---|---|---|---|")
    for name, rows in found.items():
        mean, p95, ends = (
            np.mean([getattr(row, key) for row in rows]) for key in ("mean", "p95", "mean_at_ends")
        )
        largest = max(row.largest for row in rows)
        annulus = np.mean([row.annulus for row in rows])
        print(f"| {name} | {mean:.2f} | {p95:.2f} | {largest:.2f} | {ends:.2f} | {annulus:.2f} |")


def difference(recovered: Surface, true: Surface, axis: FloatArray, slice_mm: float) -> Difference:
    """Measure a recovered part against the true one."""
    area = face_areas(recovered.vertices, recovered.faces)
    centers = recovered.vertices[recovered.faces].mean(axis=1)
    vertices, faces = capped(true)
    distance = closest_points(surface_tree(vertices, faces), centers).distances
    height = true.vertices @ axis
    at_ends = (centers @ axis < height.min() + slice_mm) | (
        centers @ axis > height.max() - slice_mm
    )
    order = np.argsort(distance)
    share = np.cumsum(area[order]) / area.sum()
    return Difference(
        float(np.average(distance, weights=area)),
        float(distance[order][np.searchsorted(share, 0.95)]),
        float(distance.max()),
        float(np.average(distance[at_ends], weights=area[at_ends])) if at_ends.any() else 0.0,
        float(cKDTree(rim(true)).query(rim(recovered))[0].mean()),
    )


def rim(part: Surface) -> FloatArray:
    """Return points along the mitral annulus."""
    loop = part.vertices[part.loops["mitral"]]
    share = np.linspace(0.0, 1.0, 10, endpoint=False)[:, None, None]
    points: FloatArray = (loop + share * (np.roll(loop, -1, axis=0) - loop)).reshape(-1, 3)
    return points


if __name__ == "__main__":
    main()
