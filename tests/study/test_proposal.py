import nibabel
import nrrd
import numpy as np
import pytest

from ostiform.errors import InputError
from ostiform.study import parsed_settings, proposed_study, read_study, survey_shape
from ostiform.study.name_pattern import guessed_pattern
from ostiform.surface import write_surface
from tests.oracles.holed_spheres import half_sphere, holed_sphere, sphere_with_circles


@pytest.mark.parametrize(
    ("names", "pattern", "parts"),
    [
        (["LA_with_fibers_1.vtk", "LA_with_fibers_2.vtk"], "LA_with_fibers_{subject}.vtk", ("LA",)),
        (
            ["patient1_LV_ENDO_000.vtk", "patient1_LV_ENDO_001.vtk"],
            "{subject}_LV_ENDO_{phase}.vtk",
            ("LV",),
        ),
        (
            [f"{s}_{p}_{c}.vtp" for s in ("A", "B") for p in ("00", "01") for c in ("LV", "LA")],
            "{subject}_{phase}_{part}.vtp",
            ("LV", "LA"),
        ),
        (
            [f"{s}/{c}.ply" for s in ("s1", "s2", "s3") for c in ("LV", "LA")],
            "{subject}/{part}.ply",
            ("LV", "LA"),
        ),
        (
            [f"study-{a}-{b}.stl" for a in ("x1", "x2") for b in ("anna", "otto")],
            "study-{subject}.stl",
            (),
        ),
        (["anna.stl", "otto long name.stl"], "{subject}.stl", ()),
        (["heart.vtp"], "{subject}.vtp", ()),
        (["a1.nii.gz", "a2.nii.gz"], "{subject}.nii.gz", ()),
    ],
)
def test_patterns_are_read_off_the_names(names, pattern, parts):
    found = guessed_pattern(names)
    assert (found.pattern, found.parts) == (pattern, parts)


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
