"""From labels on a grid to a solid whose regions meet in one contact each.

The solid holds the parts that seams join and, beyond every opening that is a contact, a *stub*: a
few voxels of the label that the part opens into. Regions that touch without a seam or an opening
are parted by a channel of one voxel. What is left of handles and holes is mended where it is small.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from typing import Annotated

import numpy as np
from scipy import ndimage

from ostiform.arrays import BoolArray, FloatArray, IntArray
from ostiform.errors import InputError, TopologyError
from ostiform.study.label_contacts import Patch, bridged, contact_patches, place_words, touching_box
from ostiform.study.label_grid import BY_EDGES, BY_FACES, LabelGrid, spread
from ostiform.surface import VoxelChange, counted, signed_distance, without_handles
from ostiform.values import Axes, value

LARGEST_STRAY_SHARE = 0.1
"""Pieces beside the largest are dropped only while they hold less than a tenth of the volume."""

_ENCLOSED = 0.5
"""Share of a part's border from which on the other surrounds it."""
_STUB_MM = 6.0
_LEAST_STUB = 3
_SMOOTHING = 0.7
"""Voxels: spikes and pits of one voxel go, on maps of noisy networks and of 1 to 1.5 mm."""


@value(eq=True)
class ContactRules:
    """How contacts are looked for, and what is mended.

    Attributes
    ----------
    gap_mm : float
        The widest gap between labels that is bridged.
    contact_mm2 : float
        Contacts below this are noise.
    handles_mm : float
        The longest loop of a handle that is mended.
    """

    gap_mm: float
    contact_mm2: float
    handles_mm: float


@value(eq=True)
class Interface:
    """A contact that becomes an opening.

    Attributes
    ----------
    first, second : int
        Regions, from 0.
    name : str
        What it is called in sentences.
    ostium : str or None
        Full name of the opening, for a contact that has one of its own.
    """

    first: int
    second: int
    name: str
    ostium: str | None = None


@value(eq=True)
class WantedOpening:
    """A part that is open where it touches a label.

    Attributes
    ----------
    part, label : int
        Regions, from 0; those of labels come after the parts.
    ostia : tuple of str
        Full names; as many contacts are wanted.
    name : str
        What the label is called in sentences.
    """

    part: int
    label: int
    ostia: tuple[str, ...]
    name: str


@value
class Solid:
    """Regions that meet in one contact for each interface, without handles.

    Attributes
    ----------
    grid : LabelGrid
        Of parts and stubs.
    distance : (I, J, K) float64
        Signed distance from the surface before it was mended, positive inside, mm.
    names : tuple of str
        Of the regions.
    interfaces : tuple of Interface
    notes : tuple of str
    """

    grid: LabelGrid
    distance: Annotated[FloatArray, Axes(None, None, None)]
    names: tuple[str, ...]
    interfaces: tuple[Interface, ...]
    notes: tuple[str, ...]


def labelled_solid(
    grid: LabelGrid,
    parts: Sequence[str],
    seams: Sequence[Interface],
    openings: Sequence[WantedOpening],
    rules: ContactRules,
) -> Solid:
    """Return the solid of some parts and what they open into.

    Raises
    ------
    InputError
        If labels do not touch where a seam or an opening says that they do.
    TopologyError
        If a part is in several large pieces, or the solid has handles too large to be mended.
    """
    notes: list[str] = []
    grid = _without_islands(grid, parts, notes)
    for item in seams:
        grid, width = bridged(grid, item.first + 1, item.second + 1, rules.gap_mm)
        _tell_gap(notes, parts[item.first], parts[item.second], width)
    for wanted in openings:
        grid, width = bridged(grid, wanted.part + 1, wanted.label + 1, rules.gap_mm)
        _tell_gap(notes, parts[wanted.part], wanted.name, width)
    interfaces = list(seams)
    apart = np.zeros(grid.owner.shape, dtype=np.bool_)
    for item in seams:
        _refuse_enclosed(grid, parts, item)
        apart |= _beside_seam(grid, parts, item, rules, notes)
    stubs = np.zeros(grid.owner.shape, dtype=np.int64)
    names = list(parts)
    for wanted in openings:
        patches = _wanted_patches(grid, parts, wanted, rules, notes)
        for k, patch in enumerate(patches):
            ostium = wanted.ostia[0] if len(wanted.ostia) == 1 else None
            name = ostium or f"{parts[wanted.part]} at {wanted.name}, contact {k + 1}"
            interfaces.append(Interface(wanted.part, len(names), name, ostium))
            names.append(f"{wanted.name} beyond {parts[wanted.part]}")
            stubs[tuple(patch.voxels.T)] = len(names)
        _grow_stubs(stubs, grid, wanted, len(names) - len(patches))
    owner = np.where(grid.owner > len(parts), 0, grid.owner)
    owner = np.where((stubs > 0) & (owner == 0), stubs, owner)
    owner[apart] = 0
    owner = _smoothed(owner)
    joined = {frozenset((item.first, item.second)) for item in interfaces}
    owner, channel, kept_apart = _parted(owner, len(parts), joined)
    notes += [
        f"kept {parts[one]} and {parts[two]}, whose labels touch without a seam, apart"
        for one, two in kept_apart
    ]
    channel |= apart
    grid = replace(grid, owner=owner)
    return _mended(grid, names, interfaces, channel, rules, notes)


def _without_islands(grid: LabelGrid, parts: Sequence[str], notes: list[str]) -> LabelGrid:
    """Return the regions with the largest piece of every part only."""
    owner = grid.owner.copy()
    for k, (part, box) in enumerate(
        zip(parts, ndimage.find_objects(owner, len(parts)), strict=True), start=1
    ):
        if box is None:
            raise InputError(f"expected voxels of {part}, found none that are not another part's")
        own = owner[box] == k
        label, count = ndimage.label(own, BY_FACES)
        if count < 2:
            continue
        sizes = np.bincount(label.ravel())
        sizes[0] = 0
        largest = int(sizes.argmax())
        share = 1.0 - sizes[largest] / sizes.sum()
        others = [n for n in np.argsort(-sizes).tolist() if n and n != largest and sizes[n]]
        start = np.array([s.start for s in box])
        listed = ", ".join(
            f"{grid.volume_mm3(int(sizes[n])):.3g} mm3 at "
            f"[{place_words(grid.place(np.argwhere(label == n).mean(axis=0) + start))}]"
            for n in others[:4]
        )
        if share > LARGEST_STRAY_SHARE:
            raise TopologyError(
                f"{part}: expected one piece of the label, found {count} pieces, others beside "
                f"the largest with {100.0 * share:.0f} % of the volume ({listed}): give each piece "
                "a label of its own, or remove the others"
            )
        more = f" and {len(others) - 4} more" if len(others) > 4 else ""
        notes.append(
            f"{part}: kept the largest of {count} pieces of the label, dropped "
            f"{100.0 * share:.2g} % of the volume ({listed}{more})"
        )
        owner[box][own & (label != largest)] = 0
    return replace(grid, owner=owner)


def _tell_gap(notes: list[str], one: str, two: str, width: float) -> None:
    if width:
        notes.append(f"{one} and {two} do not touch: bridged a gap of {width:.2g} mm between them")


def _refuse_enclosed(grid: LabelGrid, parts: Sequence[str], item: Interface) -> None:
    """Refuse a seam of a part that lies inside the other."""
    for own, other in ((item.first, item.second), (item.second, item.first)):
        mask = grid.owner == own + 1
        around = ndimage.binary_dilation(mask, BY_FACES) & ~mask
        share = float((grid.owner[around] == other + 1).mean())
        if share > _ENCLOSED:
            raise InputError(
                f"expected {parts[own]} and {parts[other]} beside each other at the seam "
                f"{item.name}, found {parts[own]} inside {parts[other]}, which surrounds "
                f"{100.0 * share:.0f} % of it: give {parts[other]} both labels and no seam with "
                f"{parts[own]}"
            )


def _beside_seam(
    grid: LabelGrid, parts: Sequence[str], item: Interface, rules: ContactRules, notes: list[str]
) -> BoolArray:
    """Return voxels that touch across a seam away from the largest contact there."""
    one, two = parts[item.first], parts[item.second]
    patches = contact_patches(grid, item.first + 1, item.second + 1, 1, rules.contact_mm2)
    apart = np.zeros(grid.owner.shape, dtype=np.bool_)
    if not patches:
        found = touching_box(grid.owner, item.first + 1, item.second + 1)
        raise InputError(
            f"expected the labels of {one} and {two} to touch for the seam {item.name}, found "
            f"them {'apart' if found is None else f'more than {rules.gap_mm:.3g} mm apart'}: check "
            "the labels where they meet, or raise labels.gap_mm"
        )
    for patch in patches[1:]:
        apart[tuple(patch.voxels.T)] = True
    large = [str(patch) for patch in patches[1:] if patch.area_mm2 >= rules.contact_mm2]
    if large:
        notes.append(
            f"{one} and {two} touch in {len(large) + 1} places: their seam is the largest "
            f"({patches[0]}); kept them apart at the others ({', '.join(large)})"
        )
    return apart


def _wanted_patches(
    grid: LabelGrid,
    parts: Sequence[str],
    wanted: WantedOpening,
    rules: ContactRules,
    notes: list[str],
) -> list[Patch]:
    part, n_wanted = parts[wanted.part], len(wanted.ostia)
    patches = contact_patches(grid, wanted.part + 1, wanted.label + 1, n_wanted, rules.contact_mm2)
    large = [patch for patch in patches if patch.area_mm2 >= rules.contact_mm2]
    small = [patch for patch in patches if patch.area_mm2 < rules.contact_mm2]
    if len(large) < n_wanted:
        listed = "; ".join(map(str, patches[:8])) or "none within reach"
        usual = np.median([patch.area_mm2 for patch in large]) if len(large) > 1 else np.inf
        trunk = [patch for patch in large if patch.area_mm2 > 1.6 * usual]
        said = f", {trunk[0]} may be a common trunk" if trunk else ""
        raise InputError(
            f"{part} touches {wanted.name} in {counted(len(large), 'patch', 'patches')} of "
            f"{rules.contact_mm2:.3g} mm2 or more ({listed}), expected {n_wanted} "
            f"({', '.join(wanted.ostia)}){said}: mend the labels there, or change the ostia"
        )
    closed = large[n_wanted:]
    if closed:
        notes.append(
            f"{part} touches {wanted.name} in {len(large)} patches, expected {n_wanted}: closed at "
            f"the smallest ({', '.join(map(str, closed))})"
        )
    if small:
        notes.append(
            f"{part}: closed at {counted(len(small), 'small contact')} with {wanted.name} "
            f"({', '.join(map(str, small[:3]))})"
        )
    return large[:n_wanted]


def _grow_stubs(stubs: IntArray, grid: LabelGrid, wanted: WantedOpening, first: int) -> None:
    """Grow the stubs of an opening into its label, each voxel to the contact nearest to it."""
    found = touching_box(grid.owner, wanted.part + 1, wanted.label + 1, reach=12)
    if found is None:
        return
    box, part, label = found
    own = np.where(stubs[box] > first, stubs[box], 0)
    # What touches the part beside the wanted contacts stays closed.
    free = label & ~ndimage.binary_dilation(part, BY_FACES)
    for _ in range(max(int(round(_STUB_MM / grid.step)), _LEAST_STUB)):
        beside = ndimage.grey_dilation(own, footprint=BY_FACES)
        own = np.where(free & (own == 0), beside, own)
    stubs[box] = np.where(own > 0, own, stubs[box])


def _smoothed(owner: IntArray) -> IntArray:
    """Return the regions without spikes and pits of single voxels."""
    inside = ndimage.gaussian_filter((owner > 0).astype(np.float32), _SMOOTHING) > 0.5
    return np.where(inside, spread(owner, inside), 0)


def _parted(
    owner: IntArray, n_parts: int, joined: set[frozenset[int]]
) -> tuple[IntArray, BoolArray, list[tuple[int, int]]]:
    """Take from regions that touch without an interface what touches: from stubs, or the larger."""
    owner = owner.copy()
    sizes = np.bincount(owner.ravel())
    lost = np.zeros(owner.shape, dtype=np.bool_)
    told = []
    for one, two in combinations(range(len(sizes) - 1), 2):
        if frozenset((one, two)) in joined:
            continue
        found = touching_box(owner, one + 1, two + 1)
        if found is None:
            continue
        box, first, second = found
        givers = [k for k in (one, two) if k >= n_parts]
        if not givers:
            givers = [one if sizes[one + 1] >= sizes[two + 1] else two]
        for giver in givers:
            own, other = (first, second) if giver == one else (second, first)
            touching = own & ndimage.binary_dilation(other, BY_EDGES)
            lost[box] |= touching
        if two < n_parts and touching.any():
            told.append((one, two))
    owner[lost] = 0
    return owner, lost, told


def _mended(
    grid: LabelGrid,
    names: Sequence[str],
    interfaces: Sequence[Interface],
    channel: BoolArray,
    rules: ContactRules,
    notes: list[str],
) -> Solid:
    inside = grid.owner > 0
    distance = signed_distance(inside, grid.steps)
    mended = without_handles(
        inside,
        distance,
        grid.step,
        rules.handles_mm,
        may_fill=~channel,
        may_cut=np.ones(inside.shape, dtype=np.bool_),
    )
    if mended.handles:
        listed = "; ".join(_change_words(grid, names, change) for change in mended.handles)
        raise TopologyError(
            f"expected the labels of {' and '.join(_parts_of(names, interfaces))} to make one "
            f"surface without handles, found {counted(len(mended.handles), 'handle')} larger than "
            f"handles_mm = {rules.handles_mm:.3g} ({listed}): check there for a hole through a "
            "label and for labels that touch, or raise labels.handles_mm"
        )
    by_kind: dict[str, list[VoxelChange]] = {}
    for change in mended.changes:
        by_kind.setdefault(change.kind, []).append(change)
    for kind, changes in by_kind.items():
        said = {"cut": "cut through", "filled": "filled the hole of", "hole": "filled"}[kind]
        what = "enclosed hole" if kind == "hole" else "handle"
        listed = "; ".join(_change_words(grid, names, change) for change in changes)
        notes.append(f"{said} {counted(len(changes), f'small {what}')} of the labels ({listed})")
    owner = np.where(mended.mask, spread(grid.owner, mended.mask), 0)
    kept = replace(grid, owner=owner)
    return Solid(kept, distance, tuple(names), tuple(interfaces), tuple(notes))


def _parts_of(names: Sequence[str], interfaces: Sequence[Interface]) -> list[str]:
    stubs = {item.second for item in interfaces if " beyond " in names[item.second]}
    return [name for k, name in enumerate(names) if k not in stubs]


def _change_words(grid: LabelGrid, names: Sequence[str], change: VoxelChange) -> str:
    """Return where a change is, how large, and the labels there."""
    at = np.rint(change.center).astype(np.int64)
    box = tuple(slice(max(a - 2, 0), a + 3) for a in at.tolist())
    there = [names[k - 1] for k in np.unique(grid.owner[box]).tolist() if k]
    size = f"{grid.volume_mm3(change.n_voxels):.3g} mm3"
    if change.kind != "hole":
        way = "round" if change.kind == "cut" else "through"
        size = f"a loop of {change.loop_mm:.3g} mm {way} it, {size}"
    return f"{' and '.join(there)} at [{place_words(grid.place(change.center))}]: {size}"
