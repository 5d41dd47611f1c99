import gzip
import zlib

import nibabel
import nrrd
import numpy as np
import pytest

from ostiform.errors import InputError
from ostiform.study.labelmaps import is_label_map, label_mask, read_label_map
from tests.oracles.label_volumes import posed_grid

TO_RAS = np.diag([-1.0, -1.0, 1.0, 1.0])


@pytest.fixture
def oblique(rng):
    """Labels with an oblique, anisotropic, left-handed grid in LPS."""
    _, affine, _ = posed_grid((1.2, 1.5, 7.0), 30.0, rng)
    affine[:3, 0] *= -1
    return rng.integers(0, 4, (5, 6, 7)).astype(np.uint8), affine


def write_mha(path, labels, affine, *, compressed=False, data=None, big=False):
    spacing = np.linalg.norm(affine[:3, :3], axis=0)
    directions = (affine[:3, :3] / spacing).T.reshape(-1)
    body = labels.astype(">u2" if big else "<u2").tobytes(order="F")
    rows = ["ObjectType = Image", "NDims = 3", "BinaryData = True"]
    rows += [f"BinaryDataByteOrderMSB = {big}", f"CompressedData = {compressed}"]
    rows += ["TransformMatrix = " + " ".join(map(repr, directions.tolist()))]
    rows += ["Offset = " + " ".join(map(repr, affine[:3, 3].tolist()))]
    rows += ["ElementSpacing = " + " ".join(map(repr, spacing.tolist()))]
    rows += ["DimSize = " + " ".join(map(str, labels.shape)), "ElementType = MET_USHORT"]
    rows += [f"ElementDataFile = {data or 'LOCAL'}", ""]
    body = zlib.compress(body) if compressed else body
    path.write_bytes("\n".join(rows).encode() + (b"" if data else body))
    if data:
        (path.parent / data).write_bytes(body)


def written(folder, ending, labels, affine):
    path = folder / f"a.{ending}"
    if ending.startswith("nii"):
        nibabel.save(nibabel.Nifti1Image(labels, TO_RAS @ affine), path)
    elif ending == "nrrd":
        header = {
            "space": "left-posterior-superior",
            "space directions": affine[:3, :3].T,
            "space origin": affine[:3, 3],
        }
        nrrd.write(str(path), labels, header)
    elif ending == "mha":
        write_mha(path, labels, affine, compressed=True)
    else:
        write_mha(path, labels, affine, data="a.raw", big=True)
    return path


@pytest.mark.parametrize("ending", ["nii", "nii.gz", "nrrd", "mha", "mhd"])
def test_labels_and_their_place_come_back_in_lps(tmp_path, ending, oblique):
    labels, affine = oblique
    found = read_label_map(written(tmp_path, ending, labels, affine))
    np.testing.assert_array_equal(found.labels, labels)
    np.testing.assert_allclose(found.affine, affine, atol=1e-5)


def test_an_nrrd_in_ras_is_turned_to_lps(tmp_path, oblique):
    labels, affine = oblique
    ras = TO_RAS @ affine
    header = {"space": "RAS", "space directions": ras[:3, :3].T, "space origin": ras[:3, 3]}
    nrrd.write(str(tmp_path / "a.nrrd"), labels, header)
    np.testing.assert_allclose(read_label_map(tmp_path / "a.nrrd").affine, affine, atol=1e-9)


def test_a_nifti_in_metres_becomes_millimetres(tmp_path, oblique):
    labels, affine = oblique
    scaled = TO_RAS @ np.diag([0.001, 0.001, 0.001, 1.0]) @ affine
    image = nibabel.Nifti1Image(labels, scaled)
    image.header.set_xyzt_units("meter")
    nibabel.save(image, tmp_path / "a.nii")
    np.testing.assert_allclose(read_label_map(tmp_path / "a.nii").affine, affine, rtol=1e-5)


def refused(path, message):
    with pytest.raises(InputError, match=message) as error:
        read_label_map(path)
    assert str(error.value).startswith(str(path))


def test_files_that_are_no_label_maps_are_refused(tmp_path, oblique):
    labels, affine = oblique
    refused(tmp_path / "a.dcm", "ending in .nii")
    refused(tmp_path / "a.nii", "found no file")
    (tmp_path / "b.nii").write_bytes(b"")
    refused(tmp_path / "b.nii", "empty file")
    (tmp_path / "c.nii.gz").write_bytes(gzip.compress(b"nothing"))
    refused(tmp_path / "c.nii.gz", "damaged file")
    fractions = labels.astype(np.float32) + 0.5
    refused(written(tmp_path, "nii", fractions, affine), "this is an image, not a label map")
    four = np.stack([labels, labels], axis=-1)
    refused(written(tmp_path, "nii", four, affine), "found 2 frames: for one phase per frame")
    sheared = affine.copy()
    sheared[:3, 0] += 0.2 * affine[:3, 1]
    refused(written(tmp_path, "nrrd", labels, sheared), "right angles")
    (tmp_path / "d.nrrd").write_bytes(b"NRRD0004\ntype: uchar\n")
    refused(tmp_path / "d.nrrd", "expected")
    (tmp_path / "e.mha").write_bytes(b"NDims = 3\n")
    refused(tmp_path / "e.mha", "expected the header|ElementDataFile")
    write_mha(tmp_path / "f.mha", labels, affine)
    whole = (tmp_path / "f.mha").read_bytes()
    (tmp_path / "f.mha").write_bytes(whole[:-40])
    refused(tmp_path / "f.mha", "bytes of voxels")
    (tmp_path / "g.mhd").write_bytes(
        whole[: whole.index(b"ElementDataFile")] + b"ElementDataFile = ../secret.raw\n"
    )
    refused(tmp_path / "g.mhd", "in the file or beside it")


@pytest.mark.parametrize("ending", ["nii", "nrrd", "mha"])
def test_damaged_label_maps_end_in_a_sentence_or_a_map(tmp_path, ending, oblique, rng):
    whole = written(tmp_path, ending, *oblique).read_bytes()
    path = tmp_path / f"b.{ending}"
    count = 0
    for k in range(60):
        damaged = bytearray(whole)
        if k % 2:
            del damaged[rng.integers(1, len(whole)) :]
        else:
            for place in rng.integers(0, min(len(whole), 350), 4):
                damaged[place] ^= 1 << rng.integers(8)
        path.write_bytes(bytes(damaged))
        try:
            read_label_map(path)
        except InputError:
            count += 1
    assert count >= 20


def test_label_maps_are_known_by_their_endings(tmp_path):
    assert is_label_map(tmp_path / "A.NII.GZ")
    assert not is_label_map(tmp_path / "a.vtp")


def layered(path, labels, affine, names=("LV", "MYO", "LA")):
    """Write a 3D Slicer segmentation of two layers: LV and LA do not overlap, MYO holds LV."""
    first = np.where(labels == 1, 1, np.where(labels == 2, 2, 0))
    second = np.where((labels == 1) | (labels == 3), 1, 0)
    header = {
        "kinds": ["list", "domain", "domain", "domain"],
        "space": "left-posterior-superior",
        "space directions": np.vstack([np.full(3, np.nan), affine[:3, :3].T]),
        "space origin": affine[:3, 3],
    }
    for k, (name, layer, value) in enumerate(zip(names, (0, 1, 0), (1, 1, 2), strict=True)):
        header |= {f"Segment{k}_Name": name, f"Segment{k}_Layer": str(layer)}
        header[f"Segment{k}_LabelValue"] = str(value)
    nrrd.write(str(path), np.stack([first, second]).astype(np.uint8), header)


def test_segments_that_overlap_are_found_by_name_in_their_layers(tmp_path, oblique):
    labels, affine = oblique
    layered(tmp_path / "a.seg.nrrd", labels, affine)
    found = read_label_map(tmp_path / "a.seg.nrrd")
    np.testing.assert_allclose(found.affine, affine, atol=1e-9)
    np.testing.assert_array_equal(label_mask(found, ["LV"]), labels == 1)
    np.testing.assert_array_equal(label_mask(found, ["LA", "LV"]), (labels == 1) | (labels == 2))
    np.testing.assert_array_equal(label_mask(found, ["MYO"]), (labels == 1) | (labels == 3))
    np.testing.assert_array_equal(label_mask(found, [2]), labels == 2)
    with pytest.raises(InputError, match=r"label 1 in one layer, found it in 2 \(LV, MYO\)"):
        label_mask(found, [1])
    with pytest.raises(InputError, match='segment named "RV", found LV, MYO, LA'):
        label_mask(found, ["RV"])


def test_a_segment_in_a_layer_that_is_not_there_is_refused(tmp_path, oblique):
    labels, affine = oblique
    layered(tmp_path / "a.seg.nrrd", labels, affine)
    content = (tmp_path / "a.seg.nrrd").read_bytes()
    (tmp_path / "b.seg.nrrd").write_bytes(content.replace(b"Layer:=1", b"Layer:=7"))
    refused(tmp_path / "b.seg.nrrd", "segments in 2 layers")
