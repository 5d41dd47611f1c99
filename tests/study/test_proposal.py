import nibabel
import nrrd
import numpy as np
import pytest

from ostiform.errors import InputError
from ostiform.study import (
    named_population,
    parsed_settings,
    proposed_study,
    read_study,
    survey_shape,
)
from ostiform.surface import write_surface
from tests.oracles.holed_spheres import half_sphere, holed_sphere, sphere_with_circles


def heart(folder):
    for subject, scale in (("s1", 40.0), ("s2", 43.0)):
        for phase in ("00", "01", "02"):
            lower = half_sphere(400, 36, -1, [((0.6, 0, -0.8), 0.25, 16)])
            upper = half_sphere(300, 36, 1, [((0.6, 0, 0.8), 0.2, 14), ((-0.6, 0, 0.8), 0.2, 12)])
            for part, (vertices, faces) in (("LV", lower), ("LA", upper)):
                write_surface(folder / f"{subject}_{phase}_{part}.vtp", scale * vertices, faces)


def test_a_folder_of_parts_becomes_a_study_that_reads(tmp_path):
    heart(tmp_path)
    path = tmp_path / "study.toml"
    path.write_text(proposed_study(tmp_path, path), encoding="utf-8")
    study = read_study(path)
    assert len(study.entries) == 6
    assert study.settings.ostium_names[:2] == ("LA.mitral", "LA.opening2")
    assert [(s.first, s.second) for s in study.settings.seams] == [("LA.mitral", "LV.mitral")]
    survey = survey_shape(study, study.entries[0])
    assert "mitral" in survey.parts["LV"].known


def test_a_closed_mesh_with_caps_is_opened_by_its_array(tmp_path):
    holes = [((0, 0, 1), 0.5, 30), ((1, 0, 0), 0.3, 20)]
    vertices, faces, _ = sphere_with_circles(400, holes)
    centroids = vertices[faces].mean(axis=1)
    centroids /= np.linalg.norm(centroids, axis=1, keepdims=True)
    label = np.ones(len(faces), dtype=np.int32)
    for (center, radius, _), value in zip(holes, (3, 7), strict=True):
        label[np.arccos(np.clip(centroids @ np.array(center, float), -1, 1)) < radius] = value
    write_surface(tmp_path / "a.vtp", 0.04 * vertices, faces, cell_data={"Face": label})
    settings = parsed_settings(proposed_study(tmp_path, tmp_path / "x" / "study.toml"))
    assert settings.shapes.open == {"array": "Face", "opening1": 3, "opening2": 7}
    assert settings.units == "m"
    assert settings.shapes.folder == tmp_path.as_posix()


def test_a_label_map_gives_its_labels(tmp_path):
    labels = np.zeros((12, 12, 12), np.uint8)
    labels[3:9, 3:9, 3:6], labels[3:9, 3:9, 6:9] = 1, 4
    nibabel.save(nibabel.Nifti1Image(labels, np.eye(4)), tmp_path / "a.nii.gz")
    settings = parsed_settings(proposed_study(tmp_path, tmp_path / "study.toml"))
    assert settings.labels.values == {"label1": 1, "label4": 4}
    assert settings.shapes.pattern == "{subject}.nii.gz"


def test_a_folder_without_shapes_is_refused(tmp_path):
    with pytest.raises(InputError, match="expected a folder"):
        proposed_study(tmp_path / "none", tmp_path / "study.toml")
    (tmp_path / "notes.txt").write_text("x", encoding="utf-8")
    with pytest.raises(InputError, match="expected files ending in .vtp"):
        proposed_study(tmp_path, tmp_path / "study.toml")


def test_a_mesh_that_cannot_be_oriented_is_still_proposed(tmp_path):
    vertices, faces = holed_sphere(200, [])
    fin = np.vstack([faces, [[faces[0, 0], faces[0, 1], len(vertices)]]])
    write_surface(tmp_path / "a.vtp", np.vstack([vertices, [[0, 0, 9]]]), fin)
    assert "ostia = []" in proposed_study(tmp_path, tmp_path / "study.toml")


def half_torus(side):
    """A tube bent by 180 degrees, open at both ends."""
    about, along = np.meshgrid(np.arange(24) / 24, np.linspace(0, 0.5, 31))
    tube, ring = 2 * np.pi * about.ravel(), 2 * np.pi * (along.ravel() + (0.5 if side else 0.0))
    thick = 9.0 + 3.0 * np.cos(ring)
    radius = 30.0 + thick * np.cos(tube)
    vertices = np.c_[radius * np.cos(ring), radius * np.sin(ring), thick * np.sin(tube)]
    k = np.arange(30 * 24).reshape(30, 24)
    right = np.roll(k, -1, axis=1)
    quads = np.stack([k, k + 24, right + 24, right], axis=-1).reshape(-1, 4)
    return vertices, np.vstack([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def test_of_two_rims_that_two_parts_share_one_is_their_seam(tmp_path):
    for subject, scale in (("s1", 1.0), ("s2", 1.1)):
        for side, part in enumerate(("LV", "RV")):
            vertices, faces = half_torus(side)
            write_surface(tmp_path / f"{subject}_{part}.vtp", scale * vertices, faces)
    path = tmp_path / "study.toml"
    text = proposed_study(tmp_path, path)
    path.write_text(text, encoding="utf-8")
    assert "# doubt: LV and RV share 2 rims; the longest is their seam" in text
    study = read_study(path)
    assert len(study.settings.seams) == 1
    surveys = [survey_shape(study, entry) for entry in study.entries]
    assert not named_population(study.settings, surveys).problems


def test_surfaces_on_one_side_of_a_common_rim_get_no_seam(tmp_path):
    vertices, faces = half_sphere(400, 36, -1)
    outer = vertices * (1.0 + 0.2 * (vertices[:, 2:] < -1e-6))
    write_surface(tmp_path / "s1_endo.vtp", 30.0 * vertices, faces)
    write_surface(tmp_path / "s1_epi.vtp", 30.0 * outer, faces)
    text = proposed_study(tmp_path, tmp_path / "study.toml")
    assert "# doubt: endo and epi share a rim but lie on one side of it" in text
    assert not parsed_settings(text).seams


def test_a_guessed_unit_is_said_to_be_guessed(tmp_path):
    vertices, faces = holed_sphere(200, [((0, 0, 1), 0.5, 20)])
    write_surface(tmp_path / "a.vtp", 0.04 * vertices, faces)
    text = proposed_study(tmp_path, tmp_path / "study.toml")
    assert 'units = "m"' in text
    assert "# doubt: the unit m was guessed from a size of 0.0" in text


def test_named_segments_become_parts_of_their_names(tmp_path):
    labels = np.zeros((8, 8, 8), dtype=np.uint8)
    labels[2:6, 2:6, 2:4], labels[2:6, 2:6, 4:6] = 1, 2
    header = {
        "space": "left-posterior-superior",
        "space directions": np.eye(3),
        "space origin": np.zeros(3),
        "Segment0_Name": "left ventricle",
        "Segment0_LabelValue": "1",
        "Segment1_Name": "LA+veins",
        "Segment1_LabelValue": "2",
    }
    nrrd.write(str(tmp_path / "a.seg.nrrd"), labels, header)
    settings = parsed_settings(proposed_study(tmp_path, tmp_path / "study.toml"))
    assert settings.labels.values == {"left ventricle": "left ventricle", "LA_veins": "LA+veins"}


@pytest.mark.parametrize(
    ("name", "said"),
    [("a.vtk.gz", "unpack what is packed"), ("a.hdr", "save NIfTI pairs as one file"),
     ("a.pdf", "1 other file such as a.pdf: give"), (".a.vtp", "found no file")],
)  # fmt: skip
def test_a_folder_without_readable_files_says_what_is_there(tmp_path, name, said):
    (tmp_path / name).touch()
    with pytest.raises(InputError, match=said):
        proposed_study(tmp_path, tmp_path / "study.toml")
