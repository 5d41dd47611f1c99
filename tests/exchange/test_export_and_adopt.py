"""What is exported is read back by other readers, and adopted again as the same model."""

import csv
import json

import h5py
import numpy as np
import openpyxl
import pytest
import pyvista

from ostiform.errors import ArtifactError, InputError, OstiformError
from ostiform.evaluation import read_evaluation
from ostiform.exchange import (
    Landmark,
    read_landmarks,
    read_particles,
    read_project,
    write_landmarks,
    write_particles,
)
from ostiform.model import (
    StoredModel,
    fit_model,
    mesh_of_template,
    project,
    read_corresponded_shapes,
    read_correspondence,
    read_model,
    write_correspondence,
    write_model,
)
from ostiform.pipeline.adopt import adopt_shapes
from ostiform.pipeline.adopt_sources import SourceSettings
from ostiform.pipeline.export import export_results
from tests.compare import assert_same_model
from tests.populations import population

PHASES = SourceSettings(pattern="{subject}_{phase}.vtp", parts=("LV", "LA"))


@pytest.fixture(scope="module")
def shapes():
    return population(3, 4, np.random.default_rng(11))


@pytest.fixture(scope="module")
def results(tmp_path_factory, shapes):
    folder = tmp_path_factory.mktemp("results")
    model = fit_model(shapes.aligned, shapes.weights, mesh_of_template(shapes.template))
    write_correspondence(folder / "correspondence.h5", shapes)
    stored = StoredModel(model, project(model, shapes.aligned), shapes.ids, shapes.template)
    write_model(folder / "model.h5", stored)
    return folder


@pytest.fixture(scope="module")
def exported(tmp_path_factory, results):
    folder = tmp_path_factory.mktemp("exported")
    written = export_results(results, folder, n_modes=2)
    assert all(path.is_file() for path in written)
    return folder


def test_shapes_are_vtp_with_who_when_and_what_scores(exported, results, shapes):
    stored = read_model(results / "model.h5")
    for index in (0, 7):
        id = shapes.ids[index]
        mesh = pyvista.read(exported / "shapes" / f"{id.subject}_{id.phase}.vtp")
        np.testing.assert_array_equal(mesh.points, shapes.points[index])
        np.testing.assert_array_equal(mesh.regular_faces, shapes.template.faces)
        assert (mesh.field_data["subject"][0], mesh.field_data["phase"][0]) == (
            id.subject,
            id.phase,
        )
        np.testing.assert_array_equal(mesh.field_data["time"], [id.time])
        np.testing.assert_array_equal(mesh.field_data["scores_mm"], stored.scores[index])
        np.testing.assert_array_equal(
            np.reshape(mesh.field_data["transform"], (4, 4)), shapes.transforms[index]
        )
        assert mesh.field_data["SPACE"][0] == "LPS"
        assert mesh.field_data["parts"][0] == "LV,LA"


def test_particles_are_plain_text_in_both_frames(exported, shapes):
    for kind, expected in (("local", shapes.points), ("world", shapes.aligned)):
        found = np.loadtxt(exported / "particles" / f"subject 1_ph02_{kind}.particles")
        np.testing.assert_array_equal(found, expected[6])


def test_the_projects_lead_from_local_to_world_particles(exported, shapes):
    project_file = json.loads((exported / "project.swproj").read_text())
    rows = project_file["data"]
    assert len(rows) == 12
    assert all(isinstance(value, str) for row in rows for value in row.values())
    assert project_file["optimize"] == {"number_of_particles": str(shapes.points.shape[1])}
    book = openpyxl.load_workbook(exported / "project.xlsx")
    assert book.sheetnames == ["data", "optimize", "project"]
    header, *cells = book["data"].values
    for row, line in zip(rows, cells, strict=True):
        assert dict(zip(header, line, strict=True)) == row
        local = np.loadtxt(exported / row["local_particles_1"])
        world = np.loadtxt(exported / row["world_particles_1"])
        transform = np.reshape([float(x) for x in row["procrustes_1"].split()], (4, 4))
        moved = local @ transform[:3, :3].T + transform[:3, 3]
        np.testing.assert_allclose(moved, world, atol=1e-9)
        assert (exported / row["shape_1"]).is_file()


def test_scores_and_volumes_are_csv(exported, results, shapes):
    stored = read_model(results / "model.h5")
    with (exported / "scores.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert [(row["subject"], row["phase"]) for row in rows] == [
        (id.subject, id.phase) for id in shapes.ids
    ]
    first = [float(row["mode1_mm"]) for row in rows]
    np.testing.assert_allclose(first, stored.scores[:, 0], rtol=1e-4, atol=1e-4)
    with (exported / "volumes.csv").open() as stream:
        volumes = list(csv.DictReader(stream))
    closed = pyvista.PolyData.from_regular_faces(shapes.points[0], shapes.template.faces)
    whole = closed.fill_holes(1e3).compute_normals(auto_orient_normals=True).volume
    total = 1000.0 * (float(volumes[0]["LV_ml"]) + float(volumes[0]["LA_ml"]))
    np.testing.assert_allclose(total, whole, rtol=0.01)


def test_the_exported_model_is_the_model(exported, results):
    assert_same_model(
        read_model(exported / "model.h5").model, read_model(results / "model.h5").model
    )


def test_adopting_exported_meshes_gives_the_same_model(tmp_path, exported, shapes):
    settings = SourceSettings(pattern="{subject}_{phase}.vtp", parts=("LV", "LA"))
    adopted = adopt_shapes(exported / "shapes", tmp_path / "out", settings, "none")
    again = read_corresponded_shapes(tmp_path / "out" / "correspondence.h5")
    assert adopted.shapes == 12
    assert [(i.subject, i.phase, i.time) for i in again.ids] == [
        (i.subject, i.phase, i.time) for i in shapes.ids
    ]
    np.testing.assert_array_equal(again.points, shapes.points)
    np.testing.assert_array_equal(again.mesh.faces, shapes.template.faces)
    np.testing.assert_array_equal(again.mesh.face_part, shapes.template.face_part)
    assert sorted(again.mesh.loops) == ["LA.opening1", "LA.opening2", "LV.opening1", "LV.opening2"]
    aligned = adopt_shapes(exported / "shapes", tmp_path / "rigid", settings, "rigid", "shape")
    model = read_model(tmp_path / "rigid" / "model.h5")
    assert aligned.modes == len(model.model.modes)
    expected = fit_model(shapes.aligned, shapes.weights, mesh_of_template(shapes.template))
    assert model.model.total_variance < 1.02 * expected.total_variance
    evaluation = read_evaluation(tmp_path / "rigid" / "evaluation.json")
    assert evaluation.generalisation is not None
    assert evaluation.generalisation.point.shape[0] == 12
    with h5py.File(tmp_path / "rigid" / "optimal" / "model.h5") as file:
        assert "representer/cells" in file


def test_openings_are_named_by_a_vertex_of_their_rim(tmp_path, exported, shapes):
    loops = shapes.template.loops
    lines = [f"{name},{loop[3]}" for name, loop in loops.items()]
    (tmp_path / "names.csv").write_text("\n".join(["name,vertex", *lines]))
    settings = SourceSettings(PHASES.pattern, names=tmp_path / "names.csv", parts=("LV", "LA"))
    adopt_shapes(exported / "shapes", tmp_path / "out", settings)
    again = read_corresponded_shapes(tmp_path / "out" / "correspondence.h5")
    assert set(again.mesh.loops) == set(loops)
    for name, loop in loops.items():
        start = list(again.mesh.loops[name]).index(loop[0])
        np.testing.assert_array_equal(np.roll(again.mesh.loops[name], -start), loop)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("vertex\n1", "columns name"),
        ("", "an empty file"),
        ("name\nLV.a\nLV.b\nLA.a", "expected a name for each of 4 openings, found 3"),
        ("name\nRV.a", "another PART.OSTIUM"),
        ("name\nLV.a\nLV.a", "another PART.OSTIUM"),
        ("name\nLV.a\nLV.b\nLV.c", "row 4: expected an opening of LV left"),
        ("name,vertex\nLV.a,x", "index of a vertex"),
        ("name,vertex\nLV.a,100000", "through vertex 100000"),
    ],
)
def test_wrong_names_of_openings_are_refused(tmp_path, exported, text, message):
    (tmp_path / "names.csv").write_text(text)
    settings = SourceSettings(PHASES.pattern, names=tmp_path / "names.csv", parts=("LV", "LA"))
    with pytest.raises(InputError, match=message):
        adopt_shapes(exported / "shapes", tmp_path / "out", settings)


def test_particles_without_meshes_become_a_model_of_points(tmp_path, exported, shapes):
    adopted = adopt_shapes(exported / "particles", tmp_path / "out", SourceSettings())
    assert (adopted.shapes, adopted.points) == (12, shapes.points.shape[1])
    assert "no triangles" in adopted.notes[-1]
    again = read_corresponded_shapes(tmp_path / "out" / "correspondence.h5")
    np.testing.assert_array_equal(again.points, shapes.points)
    np.testing.assert_allclose(again.weights, 1.0 / shapes.points.shape[1])
    written = export_results(tmp_path / "out", tmp_path / "export")
    assert {path.suffix for path in written} == {".h5", ".csv", ".particles", ".swproj", ".xlsx"}
    with pytest.raises(InputError, match="no triangle"):
        export_results(tmp_path / "out", tmp_path / "export", ["vtp"])


@pytest.mark.parametrize("name", ["project.swproj", "project.xlsx"])
def test_a_project_with_meshes_becomes_a_model_of_surfaces(tmp_path, exported, shapes, name):
    adopt_shapes(exported / name, tmp_path / "out", SourceSettings())
    again = read_corresponded_shapes(tmp_path / "out" / "correspondence.h5")
    assert [str(id) for id in again.ids] == [str(id) for id in shapes.ids]
    # The particles are the vertices of the project's mesh here, so the splines must give them back.
    np.testing.assert_allclose(again.points, shapes.points, atol=1e-6)
    assert len(again.mesh.faces) == len(shapes.template.faces)


def test_landmarks_of_scalismo_become_a_model_of_points(tmp_path, rng):
    base = rng.normal(scale=30.0, size=(6, 3))
    for number in range(5):
        points = base + rng.normal(size=base.shape)
        marks = [Landmark(f"L{k}", point) for k, point in enumerate(points)]
        order = rng.permutation(6)
        write_landmarks(tmp_path / "marks" / f"p{number}.json", [marks[k] for k in order])
    adopted = adopt_shapes(tmp_path / "marks", tmp_path / "out", SourceSettings(), "similarity")
    assert (adopted.shapes, adopted.points) == (5, 6)
    (tmp_path / "marks" / "p3.json").write_text('[{"id": "L0", "coordinates": [0, 0, 0]}]')
    with pytest.raises(InputError, match=r"p3.json: expected the 6 landmarks"):
        adopt_shapes(tmp_path / "marks", tmp_path / "out", SourceSettings())


def test_landmarks_keep_their_uncertainty(tmp_path, rng):
    root = rng.normal(size=(3, 3))
    marks = [Landmark("a", rng.normal(size=3), root @ root.T), Landmark("b", np.zeros(3))]
    write_landmarks(tmp_path / "marks.json", marks)
    first, second = read_landmarks(tmp_path / "marks.json")
    np.testing.assert_array_equal(first.position, marks[0].position)
    np.testing.assert_allclose(first.covariance, root @ root.T, atol=1e-12)
    assert second.covariance is None
    stated = json.loads((tmp_path / "marks.json").read_text())[0]["uncertainty"]
    directions = np.array(stated["pcvectors"])
    np.testing.assert_allclose(directions @ directions.T, np.eye(3), atol=1e-12)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{}", "expected a list of landmarks, found dict"),
        ("[]", "an empty list"),
        ("[", "expected landmarks as JSON"),
        ('[{"id": "a"}]', '"id" and "coordinates"'),
        ('[{"id": "a", "coordinates": [1, 2]}]', "three coordinates"),
        ('[{"id": "a", "coordinates": [1, 2, "x"]}]', "three coordinates"),
        (
            '[{"id": "a", "coordinates": [1, 2, 3]}, {"id": "a", "coordinates": [1, 2, 3]}]',
            "found a twice",
        ),
    ],
)
def test_wrong_landmarks_are_refused(tmp_path, text, message):
    (tmp_path / "marks.json").write_text(text)
    with pytest.raises(InputError, match=message):
        read_landmarks(tmp_path / "marks.json")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "empty file"),
        ("1 2 3\n1 2\n", r"line 2: expected three numbers"),
        ("1 2 nan\n", r"line 1: expected three numbers"),
        ("a b c\n", r"line 1: expected three numbers"),
    ],
)
def test_wrong_particles_are_refused(tmp_path, text, message):
    (tmp_path / "a.particles").write_text(text)
    with pytest.raises(InputError, match=message):
        read_particles(tmp_path / "a.particles")


def test_wrong_projects_are_refused(tmp_path):
    for name, content in (("a.swproj", "{"), ("b.swproj", '{"data": 3}'), ("c.xlsx", "text")):
        (tmp_path / name).write_text(content)
        with pytest.raises(InputError, match="expected a ShapeWorks project"):
            read_project(tmp_path / name)
    (tmp_path / "d.swproj").write_text('{"data": []}')
    with pytest.raises(InputError, match="lists subjects"):
        read_project(tmp_path / "d.swproj")
    with pytest.raises(InputError, match="no such file"):
        read_project(tmp_path / "e.swproj")
    (tmp_path / "f.swproj").write_text('{"data": [{"name": "x", "shape_1": "x.vtk"}]}')
    with pytest.raises(InputError, match="optimise the project"):
        adopt_shapes(tmp_path / "f.swproj", tmp_path / "out", SourceSettings())


def spheres(folder, resolutions):
    folder.mkdir()
    for number, resolution in enumerate(resolutions):
        mesh = pyvista.Sphere(radius=30.0 + number, theta_resolution=resolution)
        mesh.save(folder / f"s{number}.ply")
    return folder


def test_meshes_with_other_vertices_are_refused_by_name_and_number(tmp_path):
    folder = spheres(tmp_path / "a", [12, 12, 14])
    with pytest.raises(InputError, match=r"s2.ply: expected 338 vertices as in s0.ply, found 394"):
        adopt_shapes(folder, tmp_path / "out", SourceSettings())


def test_meshes_with_other_triangles_are_refused(tmp_path):
    folder = spheres(tmp_path / "a", [12, 12])
    mesh = pyvista.read(folder / "s1.ply")
    faces = mesh.regular_faces.copy()
    faces[7] = faces[7][[1, 2, 0]]
    pyvista.PolyData.from_regular_faces(mesh.points, faces).save(folder / "s1.ply")
    with pytest.raises(InputError, match=r"s1.ply: expected the triangles .* another triangle 7"):
        adopt_shapes(folder, tmp_path / "out", SourceSettings())


def test_closed_meshes_are_adopted_with_a_sheet(tmp_path):
    folder = spheres(tmp_path / "a", [12, 12, 12, 12])
    (tmp_path / "sheet.csv").write_text(
        "subject,phase,time,file\nx,ed,0.0,s0.ply\nx,es,0.4,s1.ply\ny,ed,0,s2.ply\ny,es,0.4,s3.ply\n"
    )
    settings = SourceSettings(sheet=tmp_path / "sheet.csv", units="cm", frame="RAS")
    adopted = adopt_shapes(folder, tmp_path / "out", settings)
    assert "openings: none" in adopted.notes
    again = read_corresponded_shapes(tmp_path / "out" / "correspondence.h5")
    assert [(i.subject, i.phase, i.time) for i in again.ids] == [
        ("x", "ed", 0.0),
        ("x", "es", 0.4),
        ("y", "ed", 0.0),
        ("y", "es", 0.4),
    ]
    original = pyvista.read(folder / "s1.ply").points
    np.testing.assert_allclose(again.points[1], original * [-10.0, -10.0, 10.0], atol=1e-9)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"units": "inch"}, "--units"),
        ({"frame": "XYZ"}, "--frame"),
        ({"parts": ()}, "--parts"),
        ({"parts": ("a.b",)}, "without a dot"),
    ],
)
def test_wrong_settings_are_refused(settings, message):
    with pytest.raises(InputError, match=message):
        SourceSettings(**settings)


def test_sources_that_cannot_be_used_are_refused(tmp_path, exported):
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(InputError, match="found nothing"):
        adopt_shapes(tmp_path / "none", tmp_path / "out", SourceSettings())
    with pytest.raises(InputError, match="found none among 0"):
        adopt_shapes(empty, tmp_path / "out", SourceSettings())
    with pytest.raises(InputError, match="expected the field {subject}"):
        adopt_shapes(exported / "shapes", tmp_path / "out", SourceSettings(pattern="{phase}.vtp"))
    one = SourceSettings(pattern="{subject} 0_ph00.vtp")
    with pytest.raises(InputError, match="at least 2 shapes, found 1"):
        adopt_shapes(exported / "shapes", tmp_path / "out", one)
    folder = spheres(tmp_path / "a", [12, 12])
    with pytest.raises(InputError, match='cell array "part"'):
        adopt_shapes(folder, tmp_path / "out", SourceSettings(parts=("LV", "LA")))
    named = SourceSettings(names=tmp_path / "names.csv")
    with pytest.raises(InputError, match="openings can be named"):
        adopt_shapes(exported / "particles", tmp_path / "out", named)


def test_wrong_exports_are_refused(tmp_path, results):
    with pytest.raises(InputError, match="--format"):
        export_results(results, tmp_path, ["obj"])  # type: ignore[list-item]
    with pytest.raises(InputError, match="--modes"):
        export_results(results, tmp_path, n_modes=0)
    with pytest.raises(ArtifactError, match="expected a shape model"):
        export_results(tmp_path, tmp_path / "export")
    with pytest.raises(InputError, match="export from a results folder"):
        export_results(results / "model.h5", tmp_path, ["particles"])


def test_an_adopted_correspondence_says_that_it_has_no_sphere(tmp_path, exported):
    adopt_shapes(exported / "particles", tmp_path / "out", SourceSettings())
    with pytest.raises(OstiformError, match="expected a correspondence"):
        read_correspondence(tmp_path / "out" / "correspondence.h5")


def test_particles_keep_every_digit(tmp_path, rng):
    points = rng.normal(size=(20, 3)) / 3.0
    write_particles(tmp_path / "a.particles", points)
    np.testing.assert_array_equal(read_particles(tmp_path / "a.particles"), points)
