"""``ostiform fit``: files in, files out, one sentence where something is wrong."""

import json

import numpy as np
import pytest
import pyvista

from ostiform.cli import COMMANDS
from ostiform.cli.fit import Files, fit
from ostiform.cli.options import Common
from ostiform.errors import InputError
from ostiform.fitting import CloudTarget, ContourTarget, LandmarkTarget, SurfaceTarget
from ostiform.fitting.files import FileRules, read_named_points, read_targets
from ostiform.model import write_model
from ostiform.surface import read_mesh, write_surface
from ostiform.surface.polylines import read_polylines
from tests.fitting.fitting_cases import drawn_shape

PARTS = ("LV", "LA")


@pytest.fixture
def case(tmp_path, stored, prior, rng):
    """A model file, the mesh of a new shape, and that shape."""
    write_model(tmp_path / "model.h5", stored)
    truth = drawn_shape(prior, rng)
    write_surface(tmp_path / "target.vtp", truth, stored.model.mesh.faces)
    return tmp_path, truth


def run(folder, *targets, files=None, **options):
    quiet = Common(quiet=True)
    return fit(
        folder / "model.h5",
        *targets,
        output=folder / "out",
        files=files or Files(),
        common=options.pop("common", quiet),
        **options,
    )


def markups(name, kind, positions, labels=None):
    controls = [
        {"label": label, "position": list(position)}
        for label, position in zip(labels or [""] * len(positions), positions, strict=True)
    ]
    item = {
        "type": kind,
        "name": name,
        "coordinateSystem": "RAS",
        "coordinateUnits": "mm",
        "controlPoints": controls,
    }
    return json.dumps({"markups": [item]})


def test_a_fit_is_written_and_summed_up(case, capsys):
    folder, truth = case
    assert run(folder, str(folder / "target.vtp"), common=Common()) == 0
    printed = capsys.readouterr().out
    for word in ("data to model", "posterior sd", "Mahalanobis", "results in", "LA.vein"):
        assert word in printed
    fitted = read_mesh(folder / "out" / "fitted.vtp")
    assert np.linalg.norm(fitted.vertices - truth, axis=1).mean() < 2.0
    assert {"posterior_sd_mm", "normal_sd_mm", "residue_mm"} <= set(fitted.point_data)
    facts = json.loads((folder / "out" / "fit.json").read_text("utf-8"))
    assert facts["typicality"]["is_outlier"] in (True, False)
    assert np.array(facts["pose"]["matrix"]).shape == (4, 4)
    n_modes = len(facts["scores_mm"])
    assert np.array(facts["score_covariance_mm2"]).shape == (n_modes, n_modes)


def test_the_summary_is_json_where_asked(case, capsys):
    folder, _ = case
    assert run(folder, str(folder / "target.vtp"), common=Common(json=True)) == 0
    assert json.loads(capsys.readouterr().out)["residue_mm"]["data_to_model"]["mean"] < 1.0


def test_units_and_frame_are_taken_off(case, prior):
    folder, truth = case
    rows = truth[::2] * [-0.1, -0.1, 0.1]  # centimetres in RAS
    np.savetxt(folder / "cloud.xyz", rows)
    files = Files(units="cm", frame="RAS")
    assert run(folder, str(folder / "cloud.xyz"), files=files, pose="known") == 0
    fitted = read_mesh(folder / "out" / "fitted.vtp").vertices
    assert np.linalg.norm(fitted - truth, axis=1).mean() < 2.0


def test_one_part_is_fitted_by_name(case, stored):
    folder, truth = case
    mesh = stored.model.mesh
    write_surface(folder / "lv.vtp", truth, mesh.faces[mesh.face_part == 0])
    assert run(folder, f"LV={folder / 'lv.vtp'}") == 0
    facts = json.loads((folder / "out" / "fit.json").read_text("utf-8"))
    assert "LV.mitral" in facts["openings_matched"].values()


def test_rough_positions_name_the_openings(case, stored):
    folder, truth = case
    mesh = stored.model.mesh
    rows = [
        f"{name} {' '.join(map(str, truth[mesh.loops[name]].mean(axis=0) + 3.0))}"
        for name in ("LV.aortic", "LA.vein")
    ]
    (folder / "openings.txt").write_text("\n".join(rows))
    files = Files(openings=folder / "openings.txt")
    assert run(folder, str(folder / "target.vtp"), files=files) == 0
    facts = json.loads((folder / "out" / "fit.json").read_text("utf-8"))
    assert facts["openings_matched"] == {}
    (folder / "openings.txt").write_text(f"{rows[0]}\n{rows[0].replace('LV.aortic', 'LV.mitral')}")
    assert run(folder, str(folder / "target.vtp"), files=files) == 2


@pytest.mark.parametrize(
    ("make", "code", "message"),
    [
        (lambda f: ["nowhere.vtp"], 2, "found none"),
        (lambda f: [str(f / "model.h5")], 2, "expected a file ending in"),
        (lambda f: [f"RV={f / 'target.vtp'}"], 2, "found the part RV"),
        (lambda f: [], 2, "at least one target"),
    ],
)
def test_wrong_targets_are_one_sentence(case, capsys, make, code, message):
    folder, _ = case
    assert run(folder, *make(folder)) == code
    error = capsys.readouterr().err
    assert message in error
    assert len(error.strip().splitlines()) == 1


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "found none"),
        ("1 2\n3 4\n", "columns"),
        ("1 2 3\n4 five 6\n", "three numbers"),
        ("1 2 3\n4 nan 6\n", "finite"),
        ("LA.tricuspid 1 2 3\n", "LA.tricuspid"),
    ],
)
def test_wrong_text_is_one_sentence(case, capsys, text, message):
    folder, _ = case
    (folder / "data.txt").write_text(text)
    assert run(folder, str(folder / "data.txt"), pose="known") == 2
    error = capsys.readouterr().err
    assert message in error
    assert len(error.strip().splitlines()) == 1


def test_units_off_by_a_thousand_are_one_sentence(case, capsys):
    folder, _ = case
    assert run(folder, str(folder / "target.vtp"), files=Files(units="m")) == 2
    assert "units" in capsys.readouterr().err


def test_a_file_that_is_no_model_is_one_sentence(case, capsys):
    folder, _ = case
    (folder / "model.h5").write_text("not a model")
    assert run(folder, str(folder / "target.vtp")) == 6
    assert len(capsys.readouterr().err.strip().splitlines()) == 1


def test_wrong_settings_are_one_sentence(case, capsys):
    folder, _ = case
    assert run(folder, str(folder / "target.vtp"), noise=-1.0) == 2
    assert "noise" in capsys.readouterr().err


def test_text_tells_its_kind(tmp_path):
    path = tmp_path / "data.csv"
    path.write_text("x,y,z\n1,2,3\n4,5,6\n")
    (cloud,) = read_targets([str(path)], PARTS, FileRules())
    assert isinstance(cloud, CloudTarget)
    np.testing.assert_allclose(cloud.points, [[1, 2, 3], [4, 5, 6]])
    path.write_text("1 2 3\n4 5 6\n\n7 8 9\n1 1 1\n")
    (curves,) = read_targets([f"LA={path}"], PARTS, FileRules())
    assert isinstance(curves, ContourTarget)
    assert [len(c) for c in curves.curves] == [2, 2]
    assert curves.part == "LA"
    path.write_text("# name x y z\na 1 2 3\na 4 5 6\nb 7 8 9\n")
    (named,) = read_targets([str(path)], PARTS, FileRules())
    assert isinstance(named, LandmarkTarget)
    assert named.labels == ("a", "a", "b")
    (curves,) = read_targets([str(path)], PARTS, FileRules(kind="contours"))
    assert isinstance(curves, ContourTarget)
    assert [len(c) for c in curves.curves] == [2, 1]
    for kind, message in (("surface", "mesh file"),):
        with pytest.raises(InputError, match=message):
            read_targets([str(path)], PARTS, FileRules(kind=kind))  # type: ignore[arg-type]
    path.write_text("1 2 3\n")
    with pytest.raises(InputError, match="no names"):
        read_targets([str(path)], PARTS, FileRules(kind="landmarks"))


@pytest.mark.parametrize("suffix", [".vtp", ".vtk"])
def test_curves_of_vtk_files_are_contours(tmp_path, suffix, stored):
    mesh = stored.model.mesh
    surface = pyvista.PolyData.from_regular_faces(stored.model.mean, mesh.faces)
    rings = surface.slice(normal="z").strip(max_length=10_000)
    path = tmp_path / f"rings{suffix}"
    rings.save(path, binary=False)
    (target,) = read_targets([str(path)], PARTS, FileRules())
    assert isinstance(target, ContourTarget)
    joined = np.concatenate(target.curves)
    np.testing.assert_allclose(np.ptp(joined[:, 2]), 0.0, atol=1e-4)
    np.testing.assert_allclose(np.ptp(joined[:, 0]), np.ptp(rings.points[:, 0]), rtol=1e-5)
    (cloud,) = read_targets([str(path)], PARTS, FileRules(kind="points"))
    assert isinstance(cloud, CloudTarget)


def test_a_damaged_file_of_curves_is_refused(tmp_path):
    (tmp_path / "a.vtp").write_text("<VTKFile type='PolyData'><PolyData/></VTKFile>")
    with pytest.raises(InputError, match="found none"):
        read_polylines(tmp_path / "a.vtp")
    with pytest.raises(InputError, match="expected a file of curves"):
        read_polylines(tmp_path / "none.vtk")
    with pytest.raises(InputError, match="ending|file of curves"):
        read_polylines(tmp_path / "a.obj")
    (tmp_path / "b.vtk").write_text(
        "# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\nPOINTS 2 float\n0 0 0 1 1 1\n"
        "LINES 1 3\n2 0 7\n"
    )
    with pytest.raises(InputError, match="indices from 0 to 1"):
        read_polylines(tmp_path / "b.vtk")


def test_slicer_markups_are_landmarks_or_contours(tmp_path):
    positions = [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 10.0]]
    path = tmp_path / "points.mrk.json"
    path.write_text(markups("F", "Fiducial", positions, ["LV.mitral-1", "LV.mitral-2", "3"]))
    (target,) = read_targets([str(path)], PARTS, FileRules())
    assert isinstance(target, LandmarkTarget)
    np.testing.assert_allclose(target.positions[0], [-1.0, -2.0, 3.0])
    labels, _ = read_named_points(path, FileRules())
    assert labels == ("LV.mitral-1", "LV.mitral-2", "3")
    (cloud,) = read_targets([str(path)], PARTS, FileRules(kind="points"))
    assert isinstance(cloud, CloudTarget)
    path.write_text(markups("ring", "ClosedCurve", positions))
    (target,) = read_targets([str(path)], PARTS, FileRules())
    assert isinstance(target, ContourTarget)
    assert len(target.curves[0]) == 4
    with pytest.raises(InputError, match="found none"):
        read_named_points(path, FileRules())


def test_a_mesh_can_be_a_cloud_and_a_soup_is_mended(tmp_path, stored):
    mesh = stored.model.mesh
    path = tmp_path / "a.vtp"
    soup = stored.model.mean[mesh.faces].reshape(-1, 3)
    write_surface(path, soup, np.arange(len(soup)).reshape(-1, 3))
    (target,) = read_targets([str(path)], PARTS, FileRules())
    assert isinstance(target, SurfaceTarget)
    assert len(target.vertices) == len(stored.model.mean)
    (cloud,) = read_targets([str(path)], PARTS, FileRules(kind="points"))
    assert isinstance(cloud, CloudTarget)
    with pytest.raises(InputError, match="landmarks as text"):
        read_targets([str(path)], PARTS, FileRules(kind="landmarks"))


def test_the_command_is_registered():
    assert COMMANDS["fit"][0] == "fit"


def test_what_a_target_holds_comes_to_the_fitted_surface(case, stored):
    folder, truth = case
    mesh = stored.model.mesh
    arrays = {"voltage": truth[:, 0], "noted": truth[:, 1]}
    write_surface(folder / "target.vtp", truth, mesh.faces, arrays, {"region": mesh.face_part})
    files = Files(fields="voltage,region:label")
    assert run(folder, str(folder / "target.vtp"), files=files) == 0
    fitted = read_mesh(folder / "out" / "fitted.vtp")
    assert "noted" not in fitted.point_data
    known = ~np.isnan(fitted.point_data["voltage"])
    assert known.mean() > 0.9
    off = np.abs(fitted.point_data["voltage"] - fitted.vertices[:, 0])[known]
    assert off.mean() < 2.0  # the surface is that near
    rows = (folder / "out" / "fields.csv").read_text("utf-8").splitlines()
    assert rows[0] == "point,voltage,region"
    assert len(rows) == 1 + len(truth)
    assert run(folder, str(folder / "target.vtp"), files=Files(fields="thickness")) == 2


def test_units_that_a_format_never_has_are_refused(tmp_path):
    (tmp_path / "a.elem").write_text("1\nTr 0 1 2 1\n")
    (tmp_path / "a.pts").write_text("3\n0 0 0\n1 0 0\n0 1 0\n")
    with pytest.raises(InputError, match=r"a.elem: expected coordinates in um, .* found cm stated"):
        read_targets([str(tmp_path / "a.elem")], PARTS, FileRules(units="cm"))
