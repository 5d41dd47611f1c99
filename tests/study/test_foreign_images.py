"""Label maps as other programs write them: whole products of their choices, against SimpleITK."""

import itertools
import zlib

import nibabel
import nrrd
import numpy as np
import pytest
import SimpleITK

from ostiform.errors import InputError
from ostiform.study.labelmaps import label_mask, read_label_map

SIZES = (4, 5, 6)
TURN = np.array([[0.6, -0.8, 0.0], [0.8, 0.6, 0.0], [0.0, 0.0, 1.0]])


@pytest.fixture
def labels(rng):
    return rng.integers(0, 120, SIZES)


def agrees_with_simpleitk(path):
    found, other = read_label_map(path), SimpleITK.ReadImage(str(path))
    np.testing.assert_array_equal(
        found.labels, SimpleITK.GetArrayFromImage(other).transpose(2, 1, 0)
    )
    for index in ((0, 0, 0), (3, 0, 0), (0, 4, 0), (3, 4, 5)):
        np.testing.assert_allclose(
            (found.affine @ [*index, 1])[:3],
            other.TransformIndexToPhysicalPoint(index),
            atol=1e-4,
        )


META_CHOICES = list(
    itertools.product(
        ("MET_CHAR", "MET_UCHAR", "MET_SHORT", "MET_USHORT", "MET_INT", "MET_UINT", "MET_FLOAT",
         "MET_DOUBLE"),
        ("False", "True"),
        ("local", "beside", "skip", "end", "packed", "text"),
    )
)  # fmt: skip
TYPES = {"MET_CHAR": "i1", "MET_UCHAR": "u1", "MET_SHORT": "i2", "MET_USHORT": "u2",
         "MET_INT": "i4", "MET_UINT": "u4", "MET_FLOAT": "f4", "MET_DOUBLE": "f8"}  # fmt: skip


def write_metaimage(path, labels, choice, extra=()):
    kind, big, storage = choice
    body = labels.astype((">" if big == "True" else "<") + TYPES[kind]).tobytes(order="F")
    rows = ["ObjectType = Image", "NDims = 3", f"BinaryData = {storage != 'text'}"]
    rows += [f"BinaryDataByteOrderMSB = {big}", f"CompressedData = {storage == 'packed'}"]
    if storage == "packed":
        body = zlib.compress(body)
        rows += [f"CompressedDataSize = {len(body)}"]
    elif storage == "text":
        body = " ".join(map(str, labels.ravel(order="F").tolist())).encode() + b"\n"
    elif storage in ("skip", "end"):
        rows += [f"HeaderSize = {37 if storage == 'skip' else -1}"]
        body = b"\7" * 37 + body
    rows += ["TransformMatrix = " + " ".join(map(str, TURN.T.ravel())), "Offset = -4 7.5 11"]
    rows += ["CenterOfRotation = 0 0 0", "ElementSpacing = 1.5 2 3.25", *extra]
    rows += ["DimSize = 4 5 6", f"ElementType = {kind}"]
    local = storage in ("local", "packed", "text")
    rows += [f"ElementDataFile = {'LOCAL' if local else 'a.raw'}", ""]
    path.write_bytes("\n".join(rows).encode() + (body if local else b""))
    (path.parent / "a.raw").write_bytes(body)


def test_metaimages_of_every_choice_are_read_as_simpleitk_does(tmp_path, labels):
    # 88 files.
    for choice in META_CHOICES:
        if choice[1:] == ("True", "text"):
            continue  # ITK turns the bytes of numbers in text, which have no order
        path = tmp_path / ("a.mha" if choice[2] in ("local", "packed", "text") else "a.mhd")
        write_metaimage(path, labels, choice)
        agrees_with_simpleitk(path)


@pytest.mark.parametrize(
    ("field", "message"),
    [
        ("NDims = 4", "four with time, found NDims = 4, DimSize = 4 5 6"),
        ("ElementNumberOfChannels = 3", "ElementNumberOfChannels = 1, found 3"),
        ("ElementToIntensityFunctionSlope = 2", "Slope = 1, found 2"),
        ("CenterOfRotation = 1 0 0", "CenterOfRotation of zeros, found 1 0 0"),
        ("DistanceUnits = inch", "DistanceUnits mm, cm, m or um, found inch"),
        ("Kinds = domain domain list", "images of two axes over time"),
        ("ObjectType = Tube", "ObjectType = Image, found Tube"),
        ("HeaderSize = -2", "HeaderSize from 0 on"),
    ],
)
def test_a_field_that_cannot_be_honoured_is_refused_by_name(tmp_path, labels, field, message):
    write_metaimage(tmp_path / "a.mha", labels, ("MET_UCHAR", "False", "local"), [field])
    with pytest.raises(InputError, match=message):
        read_label_map(tmp_path / "a.mha")


def test_voxels_listed_in_several_files_are_refused(tmp_path, labels):
    write_metaimage(tmp_path / "a.mhd", labels, ("MET_UCHAR", "False", "beside"))
    text = (tmp_path / "a.mhd").read_text()
    for name in ("LIST", "a%03d.raw 1 6 1", "../a.raw"):
        (tmp_path / "b.mhd").write_text(text.replace("a.raw", name))
        with pytest.raises(InputError, match="data in the file or beside it"):
            read_label_map(tmp_path / "b.mhd")


def test_micrometres_of_any_header_become_millimetres(tmp_path, labels):
    write_metaimage(
        tmp_path / "a.mha", labels, ("MET_UCHAR", "False", "local"), ["DistanceUnits = um"]
    )
    np.testing.assert_allclose(
        read_label_map(tmp_path / "a.mha").affine[:3, 3], [-0.004, 0.0075, 0.011]
    )
    header = nrrd_header("left-posterior-superior") | {"space units": ["um"] * 3}
    nrrd.write(str(tmp_path / "a.nrrd"), labels.astype(np.uint8), header)
    affine = read_label_map(tmp_path / "a.nrrd").affine
    np.testing.assert_allclose(affine[:3, :3], 0.001 * TURN * [1.5, 2, 3.25], atol=1e-12)
    nrrd.write(
        str(tmp_path / "b.nrrd"), labels.astype(np.uint8), header | {"space units": ["ft"] * 3}
    )
    with pytest.raises(InputError, match="space units of one length, found ft"):
        read_label_map(tmp_path / "b.nrrd")


def nrrd_header(space):
    return {
        "space": space,
        "space directions": (TURN * [1.5, 2, 3.25]).T,
        "space origin": np.array([-4.0, 7.5, 11.0]),
        "kinds": ["domain"] * 3,
    }


NRRD_CHOICES = list(
    itertools.product(
        ("u1", "i2", "u2", "i4", "f4"),
        ("raw", "gzip", "ascii"),
        ("little", "big"),
        ("left-posterior-superior", "right-anterior-superior", "left-anterior-superior"),
    )
)


def test_nrrds_of_every_choice_are_read_as_simpleitk_does(tmp_path, labels):
    # 90 files.
    for kind, encoding, endian, space in NRRD_CHOICES:
        header = nrrd_header(space) | {"encoding": encoding, "endian": endian}
        values = labels.astype((">" if endian == "big" else "<") + kind)
        nrrd.write(str(tmp_path / "a.nrrd"), values, header, index_order="F")
        agrees_with_simpleitk(tmp_path / "a.nrrd")


NIFTI_CHOICES = list(
    itertools.product(
        (np.uint8, np.int16, np.uint16, np.float32),
        ("nii", "nii.gz"),
        ("both", "sform", "qform"),
        (None, 2.0),
    )
)


def test_niftis_of_every_choice_are_read_as_simpleitk_does(tmp_path, labels):
    # 48 files.
    affine = np.eye(4)
    affine[:3, :3], affine[:3, 3] = TURN * [1.5, 2, 3.25], [-4, 7.5, 11]
    for kind, ending, form, slope in NIFTI_CHOICES:
        values = (2 * labels if slope else labels).astype(kind)
        image = nibabel.Nifti1Image(values, None)
        image.set_sform(affine, 1 if form != "qform" else 0)
        image.set_qform(affine, 1 if form != "sform" else 0)
        image.header.set_xyzt_units("mm")
        if slope:
            image.header.set_slope_inter(slope, 0)
        path = tmp_path / (f"a.{ending}" if ending == "nii" else f"b.{ending}")
        nibabel.save(image, path)
        agrees_with_simpleitk(path)
        assert not read_label_map(path).notes


def test_two_places_of_one_image_are_told_with_both_origins(tmp_path, labels):
    image = nibabel.Nifti1Image(labels.astype(np.uint8), None)
    image.set_sform(np.diag([-2.0, -2, 2, 1]) + 10 * np.eye(4, k=3), 2)
    image.set_qform(np.diag([-2.0, -2, 2, 1]) + 60 * np.eye(4, k=3), 1)
    nibabel.save(image, tmp_path / "a.nii")
    (note,) = read_label_map(tmp_path / "a.nii").notes
    assert "took the sform (origin [10, 0, 0] mm in RAS), not the qform (origin [60, 0, 0])" in note
    image.header["sform_code"] = image.header["qform_code"] = 0
    (tmp_path / "b.nii").write_bytes(
        image.header.binaryblock + bytes(4) + labels.astype(np.uint8).tobytes(order="F")
    )
    assert "states no place" in read_label_map(tmp_path / "b.nii").notes[0]


def segmentation(path, values, keys, list_axis=0):
    directions = np.insert(nrrd_header("")["space directions"], list_axis, np.nan, axis=0)
    header = {
        "space": "left-posterior-superior",
        "space directions": directions,
        "space origin": np.zeros(3),
        "kinds": [*["domain"] * list_axis, "list", *["domain"] * (3 - list_axis)],
    }
    nrrd.write(str(path), np.moveaxis(values, 0, list_axis), header | keys, index_order="F")


@pytest.mark.parametrize("list_axis", [0, 3])
def test_a_former_segmentation_has_one_layer_for_each_segment(tmp_path, labels, list_axis):
    layers = np.stack([labels < 40, labels > 100]).astype(np.uint8)
    names = {"Segment0_Name": "LV", "Segment1_Name": "LA"}
    segmentation(tmp_path / "a.seg.nrrd", layers, names, list_axis)
    found = read_label_map(tmp_path / "a.seg.nrrd")
    np.testing.assert_array_equal(label_mask(found, ["LV"]), labels < 40)
    np.testing.assert_array_equal(label_mask(found, ["LA"]), labels > 100)


def test_frames_in_one_file_are_never_joined(tmp_path, labels):
    frames = np.stack([labels > 20, labels > 60]).astype(np.uint8)
    for list_axis in (0, 3):
        segmentation(tmp_path / "a.seq.nrrd", frames, {}, list_axis)
        with pytest.raises(InputError, match="found 2 frames: for one phase per frame"):
            read_label_map(tmp_path / "a.seq.nrrd")
