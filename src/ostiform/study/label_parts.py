"""From label maps to the meshes of the parts; parts that touch are given one common rim."""

from collections.abc import Mapping, Sequence
from itertools import combinations
from pathlib import Path

import numpy as np
from scipy import ndimage

from ostiform.arrays import BoolArray, FloatArray, IntArray
from ostiform.errors import InputError, TopologyError, UnlabelledError
from ostiform.study.labelmaps import LabelMap, label_mask, read_label_map
from ostiform.study.markups import Cut, cut_heights
from ostiform.study.parts import LARGEST_STRAY_SHARE, handle_sentence
from ostiform.study.settings import StudySettings
from ostiform.surface import (
    LevelField,
    MendedMesh,
    RawMesh,
    Seam,
    boundary_loops,
    component_parts,
    connected_components,
    cut_along_zero,
    enclosed_volume,
    face_areas,
    face_fans,
    genus,
    graph_labels,
    isotropic_remeshed,
    kept_apart,
    level_field,
    level_surface,
    level_values,
    non_manifold_vertices,
    parted_at,
    split_ostium_name,
    unique_edges,
    without_unreferenced,
)

_MOST_ROUNDS = 10

_DEFAULT_EDGE_IN_VOXELS = 1.5
"""Default edge length in units of the finest voxel step."""


def label_meshes(
    settings: StudySettings,
    files: Mapping[str, Path],
    cuts: Mapping[str, Cut],
    frame: int | None = None,
) -> dict[str, RawMesh]:
    """Return the surface of every part, closed but for the rims where parts touch.

    Parameters
    ----------
    settings : StudySettings
    files : mapping of str to Path
        The label map of each part; one file may hold several.
    cuts : mapping of str to Cut
        By full ostium name; one at a seam of two parts parts their labels there.
    frame : int, optional
        Of maps of several.

    Returns
    -------
    dict of str to RawMesh
        In mm and LPS.

    Raises
    ------
    InputError
        If a map cannot be read, a label is missing, or parts with a seam do not touch.
    """
    maps = {path: read_label_map(path, frame) for path in dict.fromkeys(files.values())}
    masks = {part: _mask(settings, part, files[part], maps[files[part]]) for part in files}
    meshes: dict[str, RawMesh] = {}
    for group in component_parts(tuple(settings.parts), settings.seam_pairs):
        grids = [maps[files[part]] for part in group]
        seams = [s for s in settings.seam_pairs if s.first.partition(".")[0] in group]
        if len(group) == 1 or not _same_grid(grids):
            for part in group:
                meshes[part] = _alone(masks[part], maps[files[part]], settings.labels.edge_mm)
        else:
            own = {part: masks[part] for part in group}
            at_seam = [cuts[n] for s in seams for n in (s.first, s.second) if n in cuts]
            cut = at_seam[0] if at_seam and len(group) == 2 else None
            meshes.update(_together(own, grids[0], seams, settings.labels.edge_mm, cut))
    return {part: meshes[part] for part in settings.parts}


def remeshed_at(
    vertices: FloatArray, faces: IntArray, edge_mm: float
) -> tuple[FloatArray, IntArray]:
    """Return a closed surface with nearly equilateral triangles and the volume it had."""
    fine = isotropic_remeshed(vertices, faces, edge_mm=edge_mm)
    return _with_volume(fine.vertices, fine.faces, enclosed_volume(vertices, faces)), fine.faces


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


def _edge(label_map: LabelMap, edge_mm: float | None) -> float:
    step = float(np.linalg.norm(label_map.affine[:3, :3], axis=0).min())
    return edge_mm if edge_mm is not None else _DEFAULT_EDGE_IN_VOXELS * step


def _alone(mask: BoolArray, label_map: LabelMap, edge_mm: float | None) -> RawMesh:
    vertices, faces, share, notes = _outline(level_field(mask, label_map.affine))
    _refuse_large_pieces(share)
    vertices, faces = remeshed_at(vertices, faces, _edge(label_map, edge_mm))
    return RawMesh(vertices, faces, space="LPS", notes=(*label_map.notes, *_notes(mask), *notes))


def _refuse_large_pieces(share: float) -> None:
    if share > LARGEST_STRAY_SHARE:
        raise TopologyError(
            "expected one piece of the label, found others beside the largest with "
            f"{100.0 * share:.0f} % of the area: give each piece a label of its own, or remove the "
            "others"
        )


def _outline(field: LevelField) -> tuple[FloatArray, IntArray, float, tuple[str, ...]]:
    """Return the largest piece of a field's outline, and the others' share of the area."""
    vertices, faces = level_surface(field)
    piece = connected_components(faces)
    n_pieces = int(piece.max(initial=-1)) + 1
    share = 0.0
    notes: tuple[str, ...] = ()
    if n_pieces > 1:
        area = np.bincount(piece, weights=face_areas(vertices, faces))
        faces = faces[piece == area.argmax()]
        share = float(1.0 - area.max() / area.sum())
        notes = (
            f"kept the largest of {n_pieces} pieces of the label, dropped {100.0 * share:.2g} % of "
            "the area",
        )
    kept, faces = without_unreferenced(faces, len(vertices))
    return vertices[kept], faces, share, notes


def _together(
    masks: Mapping[str, BoolArray],
    label_map: LabelMap,
    seams: Sequence[Seam],
    edge_mm: float | None,
    cut: Cut | None,
) -> dict[str, RawMesh]:
    """Return parts cut from one surface round all of them, so that they share their rims.

    Two parts are divided by the cut, where there is one; all others where their labels meet.
    """
    parts = tuple(masks)
    union = np.logical_or.reduce([masks[part] for part in parts])
    fields = [level_field(masks[part], label_map.affine) for part in parts]
    edge = _edge(label_map, edge_mm)
    whole, apart = _with_gaps(level_field(union, label_map.affine), masks, fields, seams, edge)
    vertices, faces, share, notes = _outline(whole)
    notes = (*apart, *notes)
    if cut is not None:
        vertices, faces, owner = _divided(vertices, faces, fields, cut)
    else:
        vertices, faces, owner = _divided_by_labels(vertices, faces, fields)
    owner = without_islands(faces, owner, face_areas(vertices, faces))
    borders = [loop for k in range(1, len(parts)) for loop in _border(faces, owner, k)]
    if len(borders) != len(seams):
        raise InputError(
            f"expected the labels of {' and '.join(parts)} to touch along {len(seams)} "
            f"closed curve{'s' * (len(seams) > 1)}, found {len(borders)}: check the labels where "
            "they meet, or give each part a mesh of its own"
        )
    _refuse_large_pieces(share)
    if genus(faces):
        found = handle_sentence(MendedMesh(vertices, faces, np.arange(len(faces)), ()))
        raise TopologyError(
            f"expected the labels of {' and '.join(parts)} to make one surface without handles, "
            f"found {found}: check there for a hole through a label and for labels that touch"
        )
    volume = enclosed_volume(vertices, faces)
    fine = isotropic_remeshed(vertices, faces, edge_mm=edge, curves=borders, labels=owner)
    positions = _with_volume(fine.vertices, fine.faces, volume)
    meshes = {}
    for k, part in enumerate(parts):
        kept, own = without_unreferenced(fine.faces[fine.labels == k], len(positions))
        meshes[part] = RawMesh(
            positions[kept],
            own,
            space="LPS",
            notes=(*label_map.notes, *_notes(masks[part]), *notes),
        )
    return meshes


def _with_gaps(
    whole: LevelField,
    masks: Mapping[str, BoolArray],
    fields: Sequence[LevelField],
    seams: Sequence[Seam],
    width: float,
) -> tuple[LevelField, tuple[str, ...]]:
    """Return the field of all parts with a gap between parts that touch but have no seam."""
    parts = tuple(masks)
    joined = {
        frozenset(split_ostium_name(name)[0] for name in (seam.first, seam.second))
        for seam in seams
    }
    notes = []
    for i, j in combinations(range(len(parts)), 2):
        one, two = parts[i], parts[j]
        if {one, two} in joined or not _are_near(masks[one], masks[two]):
            continue
        others = [field for k, field in enumerate(fields) if k not in (i, j)]
        whole = kept_apart(whole, fields[i], fields[j], others, width)
        notes.append(
            f"kept {one} and {two}, whose labels touch without a seam, {width:.3g} mm apart"
        )
    return whole, tuple(notes)


def _are_near(one: BoolArray, two: BoolArray) -> bool:
    """Return whether two labels have no more than one voxel between them."""
    around = ndimage.binary_dilation(one, np.ones((3, 3, 3), dtype=np.bool_), iterations=2)
    return bool((around & two).any())


def _divided(
    vertices: FloatArray, faces: IntArray, fields: Sequence[LevelField], cut: Cut
) -> tuple[FloatArray, IntArray, IntArray]:
    """Divide a surface between two parts along a cut; each piece goes to the label it is nearer."""
    parted = parted_at(vertices, faces, cut_heights(cut, vertices), cut.center, cut.reach)
    centers = parted.vertices[parted.faces].mean(axis=1)
    first, second = (level_values(field, centers) / field.values.max() for field in fields)
    area = face_areas(parted.vertices, parted.faces)
    is_first = np.where(first > second, area, -area)
    first_side = 1 if is_first[parted.side > 0].sum() > is_first[parted.side < 0].sum() else -1
    return parted.vertices, parted.faces, np.where(parted.side == first_side, 0, 1)


def _divided_by_labels(
    vertices: FloatArray, faces: IntArray, fields: Sequence[LevelField]
) -> tuple[FloatArray, IntArray, IntArray]:
    """Divide a surface between parts where the labels meet."""
    scales = [float(np.sqrt(max(field.values.max(), 1e-300))) for field in fields]
    owner = np.zeros(len(faces), dtype=np.int64)
    for k in range(len(fields) - 1):
        # Height of part k over the best of the parts that come after it.
        values = [level_values(f, vertices) / s for f, s in zip(fields, scales, strict=True)]
        height = values[k] - np.max(values[k + 1 :], axis=0)
        cut = cut_along_zero(vertices, faces, height, owner == k)
        inherited = owner[cut.source]
        owner = np.where((inherited == k) & (cut.side < 0), k + 1, inherited)
        vertices, faces = cut.vertices, cut.faces
    return vertices, faces, owner


def _with_volume(vertices: FloatArray, faces: IntArray, volume: float) -> FloatArray:
    """Move a closed surface along its normals so that it encloses a volume; a small correction."""
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    at_vertices = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(at_vertices, faces[:, k], normals)
    at_vertices /= np.maximum(np.linalg.norm(at_vertices, axis=1, keepdims=True), 1e-300)
    area = 0.5 * float(np.linalg.norm(normals, axis=1).sum())
    moved: FloatArray = vertices + (volume - enclosed_volume(vertices, faces)) / area * at_vertices
    return moved


def _border(faces: IntArray, owner: IntArray, part: int) -> tuple[IntArray, ...]:
    """Return the curves between a part and those before it."""
    _, edge, _ = unique_edges(faces)
    touches = np.zeros(int(edge.max()) + 1, dtype=np.bool_)
    touches[edge.reshape(-1, 3)[owner < part]] = True
    own = faces[owner == part]
    return tuple(
        loop
        for loop in boundary_loops(own)
        if len(np.intersect1d(loop, faces[owner < part])) == len(loop)
    )


def without_islands(faces: IntArray, owner: IntArray, area: FloatArray) -> IntArray:
    """Give pieces of a part beside its largest to the part that surrounds them.

    So are faces that hang on their part by one vertex only.

    Parameters
    ----------
    faces : (F, 3) int64
    owner : (F,) int64
        The part of each face.
    area : (F,) float64

    Returns
    -------
    (F,) int64
    """
    owner = owner.copy()
    for _ in range(_MOST_ROUNDS):
        owner = _without_pinches(faces, _without_small_pieces(faces, owner, area))
        if not any(len(non_manifold_vertices(faces[owner == k])) for k in np.unique(owner)):
            break
    return _without_small_pieces(faces, owner, area)


def _without_pinches(faces: IntArray, owner: IntArray) -> IntArray:
    """Give the smaller fans of a part at a vertex that it touches twice to the other part there."""
    owner = owner.copy()
    for part in np.unique(owner).tolist():
        for vertex in non_manifold_vertices(faces[owner == part]).tolist():
            around = np.flatnonzero((faces == vertex).any(axis=1))
            others = owner[around][owner[around] != part]
            mine = np.flatnonzero(owner == part)
            fans = face_fans(faces[mine], vertex)
            if not len(others) or len(fans) < 2:
                continue
            largest = max(fans, key=len)
            for fan in fans:
                if fan is not largest:
                    owner[mine[fan]] = np.bincount(others).argmax()
    return owner


def _without_small_pieces(faces: IntArray, owner: IntArray, area: FloatArray) -> IntArray:
    owner = owner.copy()
    _, edge, _ = unique_edges(faces)
    order = np.argsort(edge, kind="stable")
    same = np.flatnonzero(edge[order][1:] == edge[order][:-1])
    one, two = order[same] // 3, order[same + 1] // 3
    for _ in range(3):
        alike = owner[one] == owner[two]
        label = graph_labels(one[alike], two[alike], len(faces))
        sizes = np.bincount(label, weights=area)
        changed = False
        for part in np.unique(owner).tolist():
            pieces = np.unique(label[owner == part])
            main = pieces[sizes[pieces].argmax()]
            for piece in pieces[pieces != main].tolist():
                inside = label == piece
                beyond = np.concatenate(
                    [owner[two[inside[one] & ~inside[two]]], owner[one[inside[two] & ~inside[one]]]]
                )
                if len(beyond):
                    owner[inside] = np.bincount(beyond).argmax()
                    changed = True
        if not changed:
            break
    return owner
