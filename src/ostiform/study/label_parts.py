"""From label maps to the meshes of the parts; parts that touch are given one common rim."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ostiform.arrays import BoolArray, FloatArray
from ostiform.errors import InputError, UnlabelledError
from ostiform.study.label_grid import label_grid
from ostiform.study.label_regions import (
    ContactRules,
    Interface,
    WantedOpening,
    labelled_solid,
)
from ostiform.study.label_surface import PartedSurface, parted_surface
from ostiform.study.labelmaps import LabelMap, label_mask, read_label_map
from ostiform.study.markups import Cut
from ostiform.study.settings import LabelOpening, LabelsSettings, StudySettings
from ostiform.surface import RawMesh, component_parts, split_ostium_name

_DEFAULT_EDGE_IN_VOXELS = 1.5
"""Default edge length in units of the finest voxel step."""
_DEFAULT_HANDLE_MM = 20.0
_DEFAULT_HANDLE_IN_SLICES = 4.0
"""By default handles with a loop of 20 mm, or of four slices where these are thick, are mended:
they are what networks leave on maps of 1 to 1.5 mm and of 7 mm."""
_PLANE_FROM_MM = 3.0
"""Slices thicker than this make steps that a plane through them smooths best."""


@dataclass(frozen=True, slots=True, eq=False)
class LabelMeshes:
    """What label maps make of a shape.

    Attributes
    ----------
    meshes : mapping of str to RawMesh
        By part, in mm and LPS.
    rims : mapping of str to (n, 3) float64
        Of openings that are contacts of their own, by full name.
    """

    meshes: Mapping[str, RawMesh]
    rims: Mapping[str, FloatArray]


def label_meshes(
    settings: StudySettings,
    files: Mapping[str, Path],
    cuts: Mapping[str, Cut],
    frame: int | None = None,
) -> LabelMeshes:
    """Return the surface of every part, closed but for seams and openings that are contacts.

    Parameters
    ----------
    settings : StudySettings
    files : mapping of str to Path
        The label map of each part; one file may hold several.
    cuts : mapping of str to Cut
        By full ostium name; one at a seam parts the labels there.
    frame : int, optional
        Of maps of several.

    Raises
    ------
    InputError
        If a map cannot be read, a label is missing, or labels do not touch where they should.
    TopologyError
        If labels make a surface with handles too large to be mended.
    """
    maps = {path: read_label_map(path, frame) for path in dict.fromkeys(files.values())}
    masks = {part: _mask(settings, part, files[part], maps[files[part]]) for part in files}
    meshes: dict[str, RawMesh] = {}
    rims: dict[str, FloatArray] = {}
    for group in component_parts(tuple(settings.parts), settings.seam_pairs):
        grids = [maps[files[part]] for part in group]
        groups = [group] if _same_grid(grids) else [(part,) for part in group]
        for parts in groups:
            label_map = maps[files[parts[0]]]
            own = {part: masks[part] for part in parts}
            made = component_meshes(settings, own, label_map, cuts)
            rims.update(made.rims)
            for part, (vertices, faces) in made.meshes.items():
                notes = (*label_map.notes, *_notes(masks[part]))
                # What is said of a component is said once, with its first part.
                notes = (*notes, *made.notes) if part == parts[0] else notes
                meshes[part] = RawMesh(vertices, faces, space="LPS", notes=notes)
    return LabelMeshes({part: meshes[part] for part in settings.parts}, rims)


def component_meshes(
    settings: StudySettings,
    masks: Mapping[str, BoolArray],
    label_map: LabelMap,
    cuts: Mapping[str, Cut],
) -> PartedSurface:
    """Return the meshes of parts that seams join, from their voxels on one grid.

    Errors are those of `label_meshes`.
    """
    parts = tuple(masks)
    labels = settings.labels
    steps = np.linalg.norm(label_map.affine[:3, :3], axis=0)
    seams, at_seams = list[Interface](), dict[str, Cut]()
    for seam in settings.seam_pairs:
        (first, _), (second, _) = split_ostium_name(seam.first), split_ostium_name(seam.second)
        if first in parts and second in parts and first != second:
            name = f"{seam.first} = {seam.second}"
            seams.append(Interface(parts.index(first), parts.index(second), name))
            stated = [cuts[ostium] for ostium in (seam.first, seam.second) if ostium in cuts]
            if stated:
                at_seams[name] = stated[0]
    openings, beyond = list[WantedOpening](), list[BoolArray]()
    for key, into in labels.openings.items():
        part = split_ostium_name(key)[0]
        if part not in parts:
            continue
        opening = into if isinstance(into, LabelOpening) else LabelOpening(label=into)
        wanted = opening.labels
        try:
            beyond.append(label_mask(label_map, wanted) & ~masks[part])
        except InputError as error:
            raise InputError(f'labels.openings."{key}": {error}') from None
        names = ", ".join(map(str, wanted))
        if not beyond[-1].any():
            raise InputError(
                f'labels.openings."{key}": expected voxels of the label {names}, found none: check '
                "the label, or whether this map lacks it"
            )
        ostia = tuple(f"{part}.{ostium}" for ostium in opening.ostia) or (key,)
        at = len(parts) + len(openings)
        openings.append(WantedOpening(parts.index(part), at, ostia, f"label {names}"))
    grid = label_grid([*masks.values(), *beyond], len(parts), label_map.affine)
    rules = ContactRules(
        gap_mm=labels.gap_mm,
        contact_mm2=labels.contact_mm2,
        handles_mm=_handles_mm(labels, float(steps.max())),
    )
    solid = labelled_solid(grid, parts, seams, openings, rules)
    rim = labels.rim or ("plane" if steps.max() > _PLANE_FROM_MM else "curve")
    edge = labels.edge_mm or _DEFAULT_EDGE_IN_VOXELS * float(steps.min())
    made = parted_surface(solid, parts, edge, rim, at_seams)
    return PartedSurface(made.meshes, made.rims, (*solid.notes, *made.notes))


def _handles_mm(labels: LabelsSettings, slice_mm: float) -> float:
    if labels.handles_mm is not None:
        return labels.handles_mm
    return max(_DEFAULT_HANDLE_MM, _DEFAULT_HANDLE_IN_SLICES * slice_mm)


def _mask(settings: StudySettings, part: str, path: Path, label_map: LabelMap) -> BoolArray:
    values = settings.labels.values.get(part)
    wanted = (values,) if isinstance(values, int | str) else values
    if wanted is None:
        layers = (label_map.labels, *label_map.further)
        mask: BoolArray = np.logical_or.reduce([layer != 0 for layer in layers])
    else:
        try:
            mask = label_mask(label_map, wanted)
        except InputError as error:
            raise InputError(f"{path}: part {part}: {error}") from None
    if not mask.any():
        present = np.unique(label_map.labels)
        sought = "voxels other than 0" if wanted is None else f"voxels of {list(wanted)}"
        expected = f"{path}: expected {sought} for the part {part}, found"
        if not present.any() and not label_map.further:
            raise UnlabelledError(f"{expected} no label at all: this image was not segmented")
        found = ", ".join(map(str, present[:12].tolist()))
        raise InputError(f"{expected} the labels {found}: check labels.values")
    return mask


def _same_grid(maps: Sequence[LabelMap]) -> bool:
    first = maps[0]
    step = np.linalg.norm(first.affine[:3, :3], axis=0).min()
    return all(
        item.labels.shape == first.labels.shape
        and float(np.abs(item.affine - first.affine).max()) < 1e-3 * step
        for item in maps
    )


def _notes(mask: BoolArray) -> tuple[str, ...]:
    for axis in range(3):
        ends = mask.take([0, -1], axis=axis)
        if ends.any():
            return (
                "closed the surface where the label reaches the edge of its image: check that "
                "nothing is missing",
            )
    return ()
