"""Readers of what other tools write, and of what fitting and the report are given."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import openpyxl
import pyvista as pv

from ostiform.exchange.landmarks import read_landmarks
from ostiform.exchange.particles import read_particles, read_project
from ostiform.fitting.files import FileRules, read_named_points, read_targets
from ostiform.model.corresponded import read_corresponded_shapes
from ostiform.pipeline.record import read_record
from ostiform.pipeline.store import Store
from ostiform.surface.polylines import read_polylines

__all__ = ["exchange_files"]

Kind = tuple[str, list[Path], Callable[[Path], Any]]


def exchange_files(folder: Path, correspondence: Path) -> list[Kind]:
    """Write sound files; return the name of each reader, its files and the reader."""
    particles = folder / "shape.particles"
    particles.write_text("".join(f"{0.1 * k} {k % 7}.5 -{k}e-1\n" for k in range(40)))
    project = folder / "project.swproj"
    rows = [
        {"name": "a", "shape_1": "a.vtk", "local_particles_1": "a.particles"},
        {"name": "b", "shape_1": "b.vtk", "local_particles_1": "b.particles"},
    ]
    project.write_text(json.dumps({"data": rows, "optimize": {"number_of_particles": "40"}}))
    sheet = folder / "project.xlsx"
    book = openpyxl.Workbook()
    book.active.title = "data"
    for row in (list(rows[0]), *(list(row.values()) for row in rows)):
        book.active.append(row)
    book.save(sheet)
    landmarks = folder / "landmarks.json"
    landmarks.write_text(json.dumps(LANDMARKS))
    curve = pv.lines_from_points([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 2.0, 0.0]])
    curves = []
    for name, binary in (("curve.vtp", True), ("curve.vtk", True), ("text.vtk", False)):
        curves.append(folder / name)
        curve.save(curves[-1], binary=binary)
    table = folder / "points.csv"
    table.write_text("x,y,z\n1,2,3\n4.5,5,6\n7,8,9e0\n1,1,1\n")
    points = folder / "named.txt"
    points.write_text("apex 1 2 3\nLA.RSPV 4.5 5 6\n")
    record = folder / "run.json"
    record.write_text(json.dumps(RECORD))
    shapes = folder / "shapes.h5"
    shutil.copyfile(correspondence, shapes)
    rules = FileRules()
    return [
        ("particles", [particles], read_particles),
        ("project swproj", [project], read_project),
        ("project xlsx", [sheet], read_project),
        ("landmarks json", [landmarks], read_landmarks),
        ("curves vtp", curves[:1], read_polylines),
        ("curves vtk", curves[1:], read_polylines),
        ("target csv", [table], lambda path: read_targets([str(path)], ("LA",), rules)),
        ("named points", [points], lambda path: read_named_points(path, rules)),
        ("corresponded shapes h5", [shapes], read_corresponded_shapes),
        ("run json", [record], _read_run),
    ]


def _read_run(path: Path) -> Any:
    return read_record(Store(path.parent))


LANDMARKS = [
    {"id": "apex", "coordinates": [1.0, 2.0, 3.0]},
    {
        "id": "LA.RSPV",
        "coordinates": [4.0, 5.0, 6.0],
        "uncertainty": {
            "stddevs": [1.0, 2.0, 3.0],
            "pcvectors": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        },
    },
]

RECORD = {
    "schema": 1,
    "version": "0",
    "title": "study",
    "study": "study.toml",
    "study_sha256": "0",
    "settings": {"units": "mm"},
    "entries": 2,
    "shapes": [{"id": {"subject": "S", "phase": "0", "time": 0.0}, "name": "S_0", "key": "k"}],
    "failures": [
        {
            "id": {"subject": "T", "phase": "0", "time": 0.0},
            "stage": "read",
            "reason": "shape T/0: expected a surface, found none",
        }
    ],
    "repairs": {"S_0": ["mended"]},
    "warnings": ["a warning"],
    "seconds": {"prepare": 1.0},
    "files": [{"shape": "S/0", "role": "LA", "path": "a.vtp", "sha256": "0"}],
    "domain_key": "k",
    "correspondence_key": "k",
}
