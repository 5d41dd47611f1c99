"""Registrations of the alternatives, kept: they depend on meshes and template points only."""

import hashlib

import numpy as np

from benchmarks.placements import Placement, Task, folds_of, placements, prepared_case
from ostiform.evaluation import PlacedFold
from ostiform.model import mesh_of_template


def peer_placement(task: Task) -> Placement:
    """Return what an alternative placed, from the cache if it is there."""
    case = prepared_case(task)
    template = case.shared_metric().template
    digest = hashlib.sha256(template.points.tobytes())
    for item in (task.method, task.with_folds, *(e.directions.tobytes() for own in
                 case.embeddings for e in own)):  # fmt: skip
        digest.update(item if isinstance(item, bytes) else repr(item).encode())
    path = task.cache / "peers" / f"{digest.hexdigest()[:32]}.npz"
    if not path.exists():
        path.parent.mkdir(exist_ok=True)
        (placement,) = placements(task)
        arrays = {
            "points": placement.points,
            "costs": np.array([placement.cpu_s, placement.wall_s, placement.memory_mb]),
        }
        for number, (_, fold) in enumerate(placement.folds):
            for name in ("aligned", "weights", "points", "transforms"):
                arrays[f"{name}_{number}"] = getattr(fold, name)
        np.savez(path, **arrays)  # type: ignore[arg-type]
    with np.load(path) as stored:
        mesh = mesh_of_template(template)
        folds = [
            (
                fold,
                PlacedFold(
                    stored[f"aligned_{number}"],
                    stored[f"weights_{number}"],
                    mesh,
                    stored[f"points_{number}"],
                    stored[f"transforms_{number}"],
                ),
            )
            for number, fold in enumerate(folds_of(case).folds if task.with_folds else ())
        ]
        costs = stored["costs"].tolist()
        return Placement(task.method, stored["points"], None, *costs, folds=tuple(folds))
