"""File names as public data sets have them, and what they are read as."""

import numpy as np
import pytest

from ostiform.study import named_population, proposed_study, read_study, survey_shape
from ostiform.study.looks import FileLook, is_series, relation
from ostiform.study.name_pattern import guessed_pattern
from ostiform.surface import write_surface
from tests.oracles.holed_spheres import holed_sphere

DEFORMETRICA = "DeterministicAtlas__Reconstruction__"
BIDS = "sub-{0}/ses-{1}/anat/sub-{0}_ses-{1}_"


def grid(form, *values):
    """Names of a form for every combination of values."""
    names = [form]
    for k, own in enumerate(values):
        names = [name.replace(f"<{k}>", value) for name in names for value in own]
    return names


@pytest.mark.parametrize(
    ("names", "pattern", "parts"),
    [
        (grid("LA_with_fibers_<0>.vtk", "12"), "LA_with_fibers_{subject}.vtk", ("LA",)),
        (["LV_01.vtp"], "LV_{subject}.vtp", ("LV",)),
        (grid("<0>_0<1>.vtp", ("LV", "LA"), "123"), "{part}_{subject}.vtp", ("LV", "LA")),
        (
            grid("patient1_LV_ENDO_00<0>.vtk", "01"),
            "{subject}_LV_ENDO_{phase}.vtk",
            ("LV",),
        ),
        (
            grid("<0>_<1>_<2>.vtp", "AB", ("00", "01"), ("LV", "LA")),
            "{subject}_{phase}_{part}.vtp",
            ("LV", "LA"),
        ),
        (
            grid("<0>_<1>_<2>.vtp", ("anna", "otto", "eva"), ("ED", "ES"), ("LV", "LA")),
            "{subject}_{phase}_{part}.vtp",
            ("LV", "LA"),
        ),
        (["s1_endo.ply", "s1_epi.ply"], "{subject}_{part}.ply", ("endo", "epi")),
        (["LV.ply", "LA.ply"], "{part}.ply", ("LV", "LA")),
        (grid("<0>/<1>.ply", ("s1", "s2"), ("LV", "LA")), "{subject}/{part}.ply", ("LV", "LA")),
        (grid("<0>/<0>_<1>.ply", ("LV", "LA"), "12"), "{part}/{part}_{subject}.ply", ("LV", "LA")),
        (
            grid("<0><1>.ply", ("femur", "patella"), ("01", "02", "03")),
            "{part}{subject}.ply",
            ("femur", "patella"),
        ),
        (
            [*grid("femur_0<0>.ply", "12345"), *grid("patella_0<0>.ply", "1245")],
            "{part}_{subject}.ply",
            ("femur", "patella"),
        ),
        (
            grid("patient<0>_<1>_<2>.vtp", "12", ("EPI", "LV_ENDO", "RV_ENDO"), ("000", "006")),
            "{subject}_{part}_{phase}.vtp",
            ("EPI", "LV_ENDO", "RV_ENDO"),
        ),
        (
            grid(f"{DEFORMETRICA}<0>__subject_<1>.vtk", ("left_atrium", "left_ventricle"), "12"),
            f"{DEFORMETRICA}{{part}}__subject_{{subject}}.vtk",
            ("left_atrium", "left_ventricle"),
        ),
        (["m03_L_femur.vtp", "m04_L_femur.vtp", "n01_R_femur.vtp"], "{subject}_femur.vtp", ()),
        (
            grid("Case_<0>/<1>_<2>.vtk", "123", ("LA", "RA"), ("endo", "epi")),
            "Case_{subject}/{part}.vtk",
            ("LA_endo", "LA_epi", "RA_endo", "RA_epi"),
        ),
        (grid("<0> left (<1>).stl", ("LV", "RV"), "123"), "{part} {subject}.stl",
         ("LV left", "RV left")),
        (
            grid("<0>/s0<1>/<2>.stl", ("control",), "12", ("LV", "RV"))
            + grid("<0>/s0<1>/<2>.stl", ("ill",), "34", ("LV", "RV")),
            "*/{subject}/{part}.stl",
            ("LV", "RV"),
        ),
        (["anna.stl", "otto long name.stl"], "{subject}.stl", ()),
        (["Patient Data/Müller, A.vtp", "Patient Data/O'Neil #2.vtp"],
         "Patient Data/{subject}.vtp", ()),
        (["heart.vtp"], "{subject}.vtp", ()),
        (["00.vtp"], "{subject}.vtp", ()),
        (grid("t<0>.vtp", "0123"), "{phase}.vtp", ()),
        (["A.VTP", "B.VTP"], "{subject}.VTP", ()),
        (["a1.nii.gz", "a2.nii.gz"], "{subject}.nii.gz", ()),
        (
            [f"patient00{p}/patient00{p}_{f}.nii.gz"
             for p in (1, 2, 3)
             for f in ("frame01", "frame01_gt", f"frame{8 + p}", f"frame{8 + p}_gt", "4d")],
            "{subject}/{subject}_{phase}_gt.nii.gz",
            (),
        ),
        (
            grid("<0>/<1>sa_<2>.nii.gz", ("1000123", "1000456"), ("label_", ""), ("ED", "ES")),
            "{subject}/label_sa_{phase}.nii.gz",
            (),
        ),
        (
            grid("s<0>/segmentations/<1>.nii.gz", ("0011", "0223"),
                 ("aorta", "colon", "duodenum", "heart_atrium_left", "heart_myocardium",
                  "liver", "pancreas", "rib_left_1", "stomach", "trachea")),
            "{subject}/segmentations/{part}.nii.gz",
            ("aorta", "heart_atrium_left", "heart_myocardium"),
        ),
        (
            grid("ct_train_<0>_<1>.nii.gz", ("1001", "1002", "1003"), ("image", "label")),
            "ct_train_{subject}_label.nii.gz",
            (),
        ),
        (
            [BIDS.format(s, v) + f"{part}_mask.nii.gz"
             for s in ("01", "02", "03") for v in ("01", "02") for part in ("LV", "LA")],
            BIDS.format("{subject}", "{phase}") + "{part}_mask.nii.gz",
            ("LV", "LA"),
        ),
    ],
)  # fmt: skip
def test_patterns_are_read_off_the_names(names, pattern, parts):
    found = guessed_pattern(names)
    assert (found.pattern, found.parts) == (pattern, parts)


def test_the_same_numbers_in_folders_of_groups_are_not_phases():
    found = guessed_pattern(grid("<0>/0<1>/<2>.stl", ("healthy", "ill"), "123", ("LV", "RV")))
    assert found.pattern == "healthy/{subject}/{part}.stl"
    assert any("rename the files or write a sheet" in note for note in found.notes)


def test_the_first_shape_has_a_file_of_every_part():
    names = [*grid("femur_0<0>.ply", "234"), *grid("patella_0<0>.ply", "1234")]
    first = guessed_pattern(names).first
    assert first == {"femur": "femur_02.ply", "patella": "patella_02.ply"}


def test_names_that_differ_in_case_only_are_doubted():
    notes = guessed_pattern(["P1_ED.vtp", "p1_ES.vtp", "P2_ED.vtp", "P2_ES.vtp"]).notes
    assert any("P1 and p1 differ in case only" in note for note in notes)


def ellipsoid(axes, center=(0.0, 0.0, 0.0), holes=0):
    circles = [((0, 0, 1), 0.4, 16), ((0, 0, -1), 0.3, 12)][:holes]
    vertices, faces = holed_sphere(300, circles)
    return vertices * axes + center, faces


def written(folder, names, shape):
    for name in names:
        path = folder / f"{name}.vtp"
        path.parent.mkdir(exist_ok=True)
        write_surface(path, *shape(name))


def proposed(folder):
    path = folder / "study.toml"
    path.write_text(proposed_study(folder, path), encoding="utf-8")
    study = read_study(path)
    surveys = [survey_shape(study, entry) for entry in study.entries]
    assert not named_population(study.settings, surveys).problems
    return study, path.read_text(encoding="utf-8")


def axes_of(rng, size):
    return size * (1.0 + 0.15 * rng.standard_normal(3))


def test_unknown_words_of_other_size_are_parts(tmp_path, rng):
    names = grid("<0>_0<1>", ("alpha", "beta"), "12345")
    sizes = {"alpha": 60.0, "beta": 25.0}
    written(tmp_path, names, lambda n: ellipsoid(axes_of(rng, sizes[n.partition("_")[0]])))
    study, text = proposed(tmp_path)
    assert study.settings.part_names == ("alpha", "beta")
    assert len(study.entries) == 5
    assert "# doubt: the words alpha, beta were taken for parts" in text


def test_unknown_words_of_other_openings_are_parts(tmp_path, rng):
    names = grid("<0>_0<1>", ("alpha", "beta"), "123")
    holes = {"alpha": 0, "beta": 1}
    written(
        tmp_path, names, lambda n: ellipsoid(axes_of(rng, 30.0), holes=holes[n.partition("_")[0]])
    )
    study, _ = proposed(tmp_path)
    assert len(study.entries) == 3
    assert study.settings.ostium_names == ("beta.opening1",)


def test_unknown_words_in_another_place_are_parts(tmp_path, rng):
    names = grid("<0>_0<1>", ("near", "far"), "123")
    places = {"near": 0.0, "far": 150.0}
    written(
        tmp_path,
        names,
        lambda n: ellipsoid(axes_of(rng, 30.0), (places[n.partition("_")[0]], 0.0, 0.0)),
    )
    assert len(proposed(tmp_path)[0].entries) == 3


@pytest.mark.parametrize("form", ["<0>_0<1>", "<0>/<0>_0<1>"])
def test_unknown_words_of_alike_shapes_are_groups_of_subjects(tmp_path, rng, form):
    names = grid(form, ("control", "ill"), "123456")
    written(tmp_path, names, lambda n: ellipsoid(axes_of(rng, 30.0)))
    study, text = proposed(tmp_path)
    assert len({entry.id.subject for entry in study.entries}) == 12
    assert "taken for groups of other subjects" in text


def test_groups_in_folders_with_the_same_names_are_told_apart_from_one_study(tmp_path, rng):
    names = grid("<0>/<1>", ("control", "ill"), ("s1", "s2", "s3"))
    written(tmp_path, names, lambda n: ellipsoid(axes_of(rng, 30.0)))
    study, text = proposed(tmp_path)
    assert len(study.entries) == 3
    assert "one pattern does not fit the other names" in text
    assert "read from the names: 3 subjects, 3 of 6 files" in text


def test_unknown_words_near_their_own_subject_are_phases(tmp_path, rng):
    axes = {k: 40.0 * (1.0 + 0.3 * rng.standard_normal(3)) for k in "123456"}
    names = grid("s<1>_<0>", ("before", "after"), "123456")
    written(
        tmp_path, names, lambda n: ellipsoid(axes[n[1]] * (1.0 if n.endswith("before") else 1.03))
    )
    study, text = proposed(tmp_path)
    assert len({entry.id.subject for entry in study.entries}) == 6
    assert len(study.entries) == 12
    assert "taken for phases of one subject" in text


def test_versions_of_one_surface_are_not_parts(tmp_path, rng):
    axes = {k: axes_of(rng, 20.0) for k in "12"}
    turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))

    def shape(name):
        vertices, faces = ellipsoid(axes[name[2]])
        return (vertices @ turn if name.endswith("ellalign") else vertices), faces

    names = grid("s0<0>_hippo_L_pp_surf_<1>", "12", ("SPHARM", "SPHARM_ellalign"))
    written(tmp_path, names, shape)
    written(
        tmp_path,
        grid("s0<0>_hippo_L_pp_surf_<1>", "12", ("para",)),
        lambda n: ellipsoid((1.0, 1.0, 1.0)),
    )
    study, text = proposed(tmp_path)
    assert study.settings.shapes.pattern == "{subject}_hippo_L_pp_surf_SPHARM.vtp"
    assert len(study.entries) == 2
    assert "SPHARM_ellalign" in text


def test_a_series_that_moves_is_one_subject(tmp_path):
    def shape(name):
        phase = 2.0 * np.pi * int(name[-2:]) / 20
        return ellipsoid(40.0 * (1.0 + 0.2 * np.cos([phase, phase + 0.3, phase - 0.5])))

    written(tmp_path, [f"model_moved_{k:02}" for k in range(20)], shape)
    study, text = proposed(tmp_path)
    assert len({entry.id.subject for entry in study.entries}) == 1
    assert len(study.entries) == 20
    assert "phases of one subject" in text


def test_numbered_shapes_in_no_order_are_subjects(tmp_path, rng):
    names = [f"model_{k:02}" for k in range(20)]
    written(tmp_path, names, lambda n: ellipsoid(axes_of(rng, 40.0)))
    assert len({entry.id.subject for entry in proposed(tmp_path)[0].entries}) == 20


def test_an_exact_sphere_is_a_parameterisation():
    vertices, _ = holed_sphere(400, [])
    look = FileLook(2.0, 1.0, 0, 3.0 * vertices + 7.0)
    assert look.is_sphere
    assert not FileLook(2.0, 1.0, 0, vertices * (1.0, 1.0, 1.02)).is_sphere


def test_one_pair_tells_no_phases_from_groups():
    vertices, _ = holed_sphere(300, [])
    one, two = (FileLook(2.0, area, 0, vertices) for area in (1.0, 1.1))
    assert relation([(one, two)]) == "alike"
    assert not is_series([one, two])


def test_copies_that_hardly_differ_are_subjects_and_a_motion_is_a_series():
    vertices, _ = holed_sphere(300, [])
    for step, moves in ((0.002, False), (0.05, True)):
        looks = [FileLook(2.0, 1.0, 0, vertices * (1.0 + step * k)) for k in range(6)]
        assert is_series(looks) is moves


def test_braces_in_names_come_back_doubled():
    found = guessed_pattern([f"case{{{k}}}_LA_{{v}}.vtp" for k in range(5)])
    assert found.pattern == "{subject}_LA_{{v}}.vtp"
    assert found.first["LA"] == "case{0}_LA_{v}.vtp"
