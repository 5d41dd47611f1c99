"""glTF: read back by another library, played by VTK, and judged by the Khronos validator."""

import json
import shutil
import struct
import subprocess
from pathlib import Path

import numpy as np
import pygltflib
import pytest
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkIOGeometry import vtkGLTFReader

from ostiform.errors import InputError
from ostiform.exchange import (
    CycleFrames,
    MorphTarget,
    SceneMesh,
    WeightAnimation,
    glb_bytes,
    mean_cycle_frames,
    write_cycle_glb,
    write_glb,
    write_modes_glb,
)
from ostiform.model import StoredModel, fit_model, mesh_of_template, project, reconstruct
from tests.populations import population

SINGLE = 4e-7  # relative: glTF holds single precision
VALIDATOR = Path(__file__).resolve().parents[2] / "viewer" / "node_modules" / "gltf-validator"


@pytest.fixture
def stored():
    shapes = population(3, 5, np.random.default_rng(5))
    model = fit_model(shapes.aligned, shapes.weights, mesh_of_template(shapes.template))
    return StoredModel(model, project(model, shapes.aligned), shapes.ids, shapes.template)


def accessor(document: pygltflib.GLTF2, index: int) -> np.ndarray:
    """Values of an accessor as pygltflib's user sees them."""
    found = document.accessors[index]
    view = document.bufferViews[found.bufferView]
    start = view.byteOffset
    raw = document.binary_blob()[start : start + view.byteLength]
    dtype = {5126: "<f4", 5125: "<u4"}[found.componentType]
    width = {"SCALAR": 1, "VEC3": 3}[found.type]
    return np.frombuffer(raw, dtype).reshape(found.count, width)


def test_another_reader_finds_the_mean_and_every_mode(tmp_path, stored):
    write_modes_glb(tmp_path / "modes.glb", stored.model, 3)
    document = pygltflib.GLTF2().load(tmp_path / "modes.glb")
    (mesh,) = document.meshes
    assert [document.materials[p.material].name for p in mesh.primitives] == ["LV", "LA"]
    assert mesh.extras["targetNames"] == ["mode 1", "mode 2", "mode 3"]
    faces = []
    for primitive in mesh.primitives:
        points = accessor(document, primitive.attributes.POSITION)
        np.testing.assert_allclose(points, stored.model.mean, atol=SINGLE * 80.0)
        faces.append(accessor(document, primitive.indices).reshape(-1, 3))
        for k, target in enumerate(primitive.targets):
            expected = stored.model.modes[k] * np.sqrt(stored.model.variances[k])
            found = accessor(document, target["POSITION"])
            np.testing.assert_allclose(found, expected, atol=SINGLE * 80.0)
    by_part = np.argsort(stored.model.mesh.face_part, kind="stable")
    np.testing.assert_array_equal(np.vstack(faces), stored.model.mesh.faces[by_part])


def test_every_mode_has_an_animation_of_its_own_weight(tmp_path, stored):
    write_modes_glb(tmp_path / "modes.glb", stored.model, 3)
    document = pygltflib.GLTF2().load(tmp_path / "modes.glb")
    assert [a.name for a in document.animations] == ["mode 1", "mode 2", "mode 3"]
    for k, animation in enumerate(document.animations):
        (channel,), (sampler,) = animation.channels, animation.samplers
        assert (channel.target.path, channel.target.node) == ("weights", 0)
        seconds = accessor(document, sampler.input)[:, 0]
        weights = accessor(document, sampler.output).reshape(len(seconds), 3)
        np.testing.assert_allclose(
            weights[:, k], 2.0 * np.sin(2.0 * np.pi * seconds / 3.0), atol=1e-5
        )
        assert (np.delete(weights, k, axis=1) == 0.0).all()


def played(path: Path, animation: int, seconds: float) -> np.ndarray:
    """Points (P, 3) of the first primitive when VTK plays an animation, in the scene's frame."""
    reader = vtkGLTFReader()
    reader.SetFileName(str(path))
    reader.ApplyDeformationsToGeometryOn()
    reader.UpdateInformation()
    reader.SetFrameRate(0)  # any time, not only those of frames
    reader.EnableAnimation(animation)
    reader.UpdateTimeStep(seconds)
    iterator = reader.GetOutput().NewTreeIterator()
    piece = iterator.GetCurrentDataObject()
    return vtk_to_numpy(piece.GetPoints().GetData()).astype(float)


def in_scene(points: np.ndarray) -> np.ndarray:
    """LPS millimetres as glTF wants them: metres, (left, superior, anterior)."""
    return 0.001 * points[:, [0, 2, 1]] * [1.0, 1.0, -1.0]


@pytest.mark.parametrize(("mode", "seconds", "weight"), [(0, 0.75, 2.0), (1, 2.25, -2.0)])
def test_a_viewer_plays_a_mode_as_the_model_makes_it(tmp_path, stored, mode, seconds, weight):
    write_modes_glb(tmp_path / "modes.glb", stored.model, 2)
    scores = np.zeros(2)
    scores[mode] = weight * np.sqrt(stored.model.variances[mode])
    expected = in_scene(reconstruct(stored.model, scores))
    found = played(tmp_path / "modes.glb", mode, seconds)
    np.testing.assert_allclose(found, expected, atol=1e-3 * np.ptp(expected))


def test_a_viewer_plays_the_mean_cycle(tmp_path, stored):
    frames = mean_cycle_frames(stored)
    assert frames is not None
    error = write_cycle_glb(tmp_path / "cycle.glb", stored.model.mesh, frames, seconds=1.0)
    assert error < 1e-6  # five frames have four directions
    for number in (1, 3):
        found = played(tmp_path / "cycle.glb", 0, float(frames.times[number]))
        expected = in_scene(frames.shapes[number])
        np.testing.assert_allclose(found, expected, atol=1e-3 * np.ptp(expected))


def test_the_mean_cycle_is_the_mean_of_subjects_with_equal_phases(stored):
    frames = mean_cycle_frames(stored)
    assert frames is not None
    shapes = reconstruct(stored.model, stored.scores).reshape(3, 5, -1, 3)
    np.testing.assert_allclose(frames.times, np.arange(5) / 5)
    np.testing.assert_allclose(frames.shapes, shapes.mean(axis=0), atol=1e-9)


def test_a_population_without_phases_has_no_cycle():
    shapes = population(4, 1, np.random.default_rng(5))
    model = fit_model(shapes.aligned, shapes.weights, mesh_of_template(shapes.template))
    stored = StoredModel(model, project(model, shapes.aligned), shapes.ids, None)
    assert mean_cycle_frames(stored) is None


def test_a_cycle_of_many_directions_says_how_much_it_leaves_out(tmp_path, stored, rng):
    shapes = stored.model.mean + rng.normal(size=(12, *stored.model.mean.shape))
    frames = CycleFrames(np.arange(12) / 12, shapes)
    error = write_cycle_glb(tmp_path / "cycle.glb", stored.model.mesh, frames)
    document = pygltflib.GLTF2().load(tmp_path / "cycle.glb")
    assert len(document.meshes[0].primitives[0].targets) == 8
    np.testing.assert_allclose(document.meshes[0].extras["largest error (mm)"], error)
    assert 0.1 < error < 10.0


def test_the_chunks_of_a_glb_are_as_long_as_they_say(stored):
    mesh = stored.model.mesh
    content = glb_bytes(
        SceneMesh(stored.model.mean, mesh.faces, mesh.face_part, mesh.parts), [], []
    )
    magic, version, length = struct.unpack("<4sII", content[:12])
    assert (magic, version, length) == (b"glTF", 2, len(content))
    size, kind = struct.unpack("<I4s", content[12:20])
    assert kind == b"JSON"
    assert size % 4 == 0
    json.loads(content[20 : 20 + size])


def test_what_cannot_be_shown_is_refused(tmp_path, stored):
    mesh = stored.model.mesh
    scene = SceneMesh(stored.model.mean, mesh.faces, mesh.face_part, mesh.parts)
    with pytest.raises(InputError, match="ending in .glb"):
        write_glb(tmp_path / "modes.gltf", scene, [], [])
    with pytest.raises(InputError, match="displacements in the target odd"):
        glb_bytes(scene, [MorphTarget("odd", np.zeros((3, 3)))], [])
    with pytest.raises(InputError, match="expected 0 weights"):
        glb_bytes(scene, [], [WeightAnimation("odd", np.array([0.0, 1.0]), np.zeros((2, 1)))])
    with pytest.raises(InputError, match="increasing times"):
        WeightAnimation("odd", np.array([0.0, 0.0]), np.zeros((2, 1)))
    with pytest.raises(InputError, match="points without triangles"):
        glb_bytes(SceneMesh(scene.vertices, mesh.faces[:0], mesh.face_part[:0], ("LV",)), [], [])
    with pytest.raises(InputError, match="at least 1 mode"):
        write_modes_glb(tmp_path / "modes.glb", stored.model, 0)
    with pytest.raises(InputError, match="at least 2 frames"):
        write_cycle_glb(
            tmp_path / "cycle.glb", mesh, CycleFrames(np.zeros(1), stored.model.mean[None])
        )


def test_the_khronos_validator_finds_nothing(tmp_path, stored):
    if shutil.which("node") is None or not VALIDATOR.is_dir():
        pytest.skip("gltf-validator not installed: `npm install` in viewer/")
    write_modes_glb(tmp_path / "modes.glb", stored.model)
    write_cycle_glb(tmp_path / "cycle.glb", stored.model.mesh, mean_cycle_frames(stored))
    script = (
        "const v=require(process.argv[1]),fs=require('fs');"
        "Promise.all(process.argv.slice(2).map(f=>v.validateBytes("
        "new Uint8Array(fs.readFileSync(f))))).then(r=>console.log(JSON.stringify("
        "r.map(x=>[x.issues.numErrors,x.issues.numWarnings,x.info.animationCount]))))"
    )
    files = [str(tmp_path / name) for name in ("modes.glb", "cycle.glb")]
    done = subprocess.run(
        ["node", "-e", script, str(VALIDATOR), *files], capture_output=True, text=True, check=True
    )
    assert json.loads(done.stdout) == [[0, 0, 5], [0, 0, 1]]
