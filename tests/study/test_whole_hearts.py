"""Whole-heart label maps: one part, two that share a seam, and a chain of three."""

import nibabel
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ostiform.errors import TopologyError
from ostiform.study import read_study
from ostiform.surface import enclosed_volume, welded_components
from tests.oracles.label_volumes import posed_grid, voxel_centers
from tests.oracles.whole_hearts import ENDS, LABELS, whole_heart_labels
from tests.study.single_shapes import read_shape

MIDDLE = np.array([10.0, 0.0, 0.0])
LEFT = """
schema = 1
[parts.LV]
ostia = ["mitral", "aortic"]
[parts.LA]
ostia = ["mitral", "RPV", "LPV"]
[parts.AO]
ostia = ["aortic", "top"]
[[seams]]
first = "LV.mitral"
second = "LA.mitral"
[[seams]]
first = "LV.aortic"
second = "AO.aortic"
[shapes]
pattern = "{subject}.nii.gz"
[labels]
edge_mm = 3.0
values = {LV = 500, LA = 420, AO = 820}
[cuts.planes]
"""
ONE = """
schema = 1
[parts.PART]
[shapes]
pattern = "{subject}.nii.gz"
[labels]
edge_mm = 3.0
values = {PART = VALUES}
"""


def written(folder, spacing, seed, change=lambda labels: labels):
    """Write a turned whole heart; return its planes as text."""
    rng = np.random.default_rng(seed)
    size, affine, center = posed_grid(spacing, 180.0, rng)
    turn = Rotation.random(rng=rng).as_matrix()
    labels = whole_heart_labels((voxel_centers(size, affine) - center) @ turn + MIDDLE)
    image = change(labels.reshape(size))
    nibabel.save(
        nibabel.Nifti1Image(image, np.diag([-1.0, -1, 1, 1]) @ affine), folder / "a.nii.gz"
    )
    rows = [
        f'"{name}" = {{center = {(center + turn @ (np.array(at) - MIDDLE)).tolist()}, '
        f"normal = {(turn @ np.array(normal)).tolist()}}}"
        for name, (at, normal) in ENDS.items()
    ]
    return "\n".join(rows)


def shape_of(folder, text):
    (folder / "study.toml").write_text(text, encoding="utf-8")
    study = read_study(folder / "study.toml")
    return read_shape(study, study.entries[0])


@pytest.mark.parametrize(("spacing", "seed"), [((1.5, 1.5, 1.5), 1), ((1.2, 1.2, 7.0), 2)])
def test_ventricle_atrium_and_aorta_become_one_chain(tmp_path, spacing, seed):
    planes = written(tmp_path, spacing, seed)
    shape = shape_of(tmp_path, LEFT + planes)
    assert {p: set(s.loops) for p, s in shape.parts.items()} == {
        "LV": {"mitral", "aortic"},
        "LA": {"mitral", "RPV", "LPV"},
        "AO": {"aortic", "top"},
    }
    for one, two, ostium in (("LV", "LA", "mitral"), ("LV", "AO", "aortic")):
        rims = [shape.parts[p].vertices[shape.parts[p].loops[ostium]] for p in (one, two)]
        assert {tuple(v) for v in rims[0].tolist()} == {tuple(v) for v in rims[1].tolist()}
    (component,) = welded_components(shape.parts, shape.seams)
    assert len(component.seams) == 2
    assert any("labels touch without a seam" in repair for repair in shape.repairs)


def test_one_chamber_alone_and_one_inside_another(tmp_path):
    written(tmp_path, (2.0, 2.0, 2.0), 3)
    volumes = {}
    for name, values in (("LV", "500"), ("LV", "[205, 500]")):
        shape = shape_of(tmp_path, ONE.replace("PART", name).replace("VALUES", values))
        surface = shape.parts[name]
        labels = np.asarray(nibabel.nifti1.load(tmp_path / "a.nii.gz").dataobj)
        voxels = np.isin(labels, [500, 205] if "205" in values else [LABELS["LV"]]).sum()
        volumes[values] = enclosed_volume(surface.vertices, surface.faces)
        assert volumes[values] == pytest.approx(8.0 * voxels, rel=0.03)


def test_a_hole_through_a_label_is_told_with_its_place(tmp_path):
    def drilled(labels):
        own = labels.copy()
        i, j, _ = np.argwhere(labels == LABELS["LV"]).mean(axis=0).astype(int)
        own[i - 2 : i + 3, j - 2 : j + 3, :] = 0
        return own

    written(tmp_path, (2.0, 2.0, 2.0), 4, drilled)
    with pytest.raises(TopologyError, match=r"1 handle larger than .*a loop of .* mm \w+ it"):
        shape_of(tmp_path, ONE.replace("PART", "LV").replace("VALUES", "500"))
