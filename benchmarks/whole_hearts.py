"""Write whole-heart label maps of a known population, and see how many become shapes.

``python benchmarks/whole_hearts.py write OUT --subjects 8`` writes OUT/{subject}.nii.gz, every
other one with slices of 7 mm. ``python benchmarks/whole_hearts.py verdicts`` prints how many of
eight noisy hearts are usable as a left heart with aorta and four veins, and as four chambers with
both arteries, with the parts in several orders and for six edge lengths.
"""

import argparse
import sys
import time
from itertools import permutations
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from ostiform.errors import OstiformError  # noqa: E402
from ostiform.study.label_parts import component_meshes  # noqa: E402
from ostiform.study.labelmaps import LabelMap  # noqa: E402
from ostiform.study.settings import StudySettings  # noqa: E402
from tests.oracles.heart_maps import LABELS, heart_map, saved_map  # noqa: E402

ISOTROPIC, SLICES = (1.2, 1.2, 1.2), (1.2, 1.2, 7.0)
EDGES_MM = (1.2, 1.5, 1.8, 2.0, 2.5, 3.0)
LEFT = {
    "seams": [("LV.mitral", "LA.mitral"), ("LV.aortic", "AO.aortic")],
    "openings": {"LA.veins": {"label": LABELS["PV"], "ostia": ["V1", "V2", "V3", "V4"]}},
}
BOTH = {
    "seams": [
        *LEFT["seams"],
        ("RV.tricuspid", "RA.tricuspid"),
        ("RV.pulmonary", "PA.pulmonary"),
    ],
    "openings": {},
}


def settings_of(stated, order, edge_mm):
    """Return the settings of a study whose parts stand in an order."""
    ostia = {part: [] for part in order}
    for pair in stated["seams"]:
        for name in pair:
            part, ostium = name.split(".")
            ostia[part].append(ostium)
    for key, into in stated["openings"].items():
        ostia[key.split(".")[0]] += into["ostia"]
    return StudySettings.model_validate(
        {
            "schema": 1,
            "parts": {part: {"ostia": ostia[part]} for part in order},
            "seams": [{"first": one, "second": two} for one, two in stated["seams"]],
            "shapes": {"pattern": "{subject}.nii.gz"},
            "labels": {
                "values": {part: LABELS[part] for part in order},
                "openings": stated["openings"],
                "edge_mm": edge_mm,
            },
        }
    )


def verdict(stated, parts, label_map, edge_mm):
    """Return why a heart cannot be used, or None."""
    settings = settings_of(stated, parts, edge_mm)
    groups = [g for g in (("LV", "LA", "AO"), ("RV", "RA", "PA")) if set(g) <= set(parts)]
    try:
        for group in groups:
            own = [part for part in parts if part in group]
            masks = {part: label_map.labels == LABELS[part] for part in own}
            component_meshes(settings, masks, label_map, {})
    except OstiformError as error:
        return str(error)
    return None


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    commands = parser.add_subparsers(required=True, dest="command")
    writing = commands.add_parser("write")
    writing.add_argument("out", type=Path)
    writing.add_argument("--subjects", type=int, default=8)
    commands.add_parser("verdicts").add_argument("--few", action="store_true")
    options = parser.parse_args()
    if options.command == "write":
        for k in range(options.subjects):
            labels, affine = heart_map(k, SLICES if k % 2 else ISOTROPIC)
            saved_map(options.out / f"heart{k:02d}.nii.gz", labels, affine)
        return
    print("| parts | slices mm | usable | orders and edges | CPU s each |\n|---|---|---|---|---|")
    for name, stated, parts in (
        ("LV, LA, AO, 4 veins", LEFT, ("LV", "LA", "AO")),
        ("LV, LA, AO, RV, RA, PA", BOTH, ("LV", "LA", "AO", "RV", "RA", "PA")),
    ):
        orders = list(permutations(parts))
        orders = orders[:: max(len(orders) // 6, 1)]
        for spacing in (ISOTROPIC, SLICES):
            good = total = 0
            start = time.process_time()
            for seed in range(8):
                labels, affine = heart_map(seed, spacing)
                label_map = LabelMap(labels.astype(np.int64), affine)
                for edge_mm, order in zip(
                    EDGES_MM[:: 5 if options.few else 1], orders, strict=False
                ):
                    total += 1
                    why = verdict(stated, order, label_map, edge_mm)
                    good += why is None
                    if why:
                        print(f"# {seed} {spacing} {order} {edge_mm}: {why}", file=sys.stderr)
            spent = (time.process_time() - start) / total
            print(f"| {name} | {spacing[2]:g} | {good} of {total} | 6 | {spent:.1f} |", flush=True)


if __name__ == "__main__":
    main()
