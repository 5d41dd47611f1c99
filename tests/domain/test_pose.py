"""Population poses: recovered motions, equivariance, every way to fix a rotation."""

import time
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ostiform.domain import PoseMethod, landmarks, population_poses
from ostiform.domain.procrustes import transformed
from ostiform.errors import InputError
from ostiform.study import Shape, ShapeId
from ostiform.surface import Seam, Surface, boundary_loops
from tests.oracles.holed_spheres import half_sphere, holed_sphere

MANY_HOLES = {
    "mitral": ([0.0, 0.0, 1.0], 0.5),
    "one": ([1.0, 0.2, -0.6], 0.2),
    "two": ([-1.0, 0.4, -0.5], 0.25),
    "three": ([0.2, -1.0, -0.3], 0.2),
}


def bent(vertices, seed=0):
    """Make a sphere into a lopsided body: no symmetry, principal axes of different length."""
    x, y, z = vertices.T
    wobble = 0.03 * np.sin(seed + 3.0 * vertices @ [0.6, 0.3, 0.74])
    body = np.c_[20 * x + 4 * y**2, 30 * y + 5 * x * z, 44 * z + 6 * z * z + 5 * x * y]
    return body * (1.0 + wobble[:, None])


def surface(holes, n_points=1500, seed=0):
    circles = [(center, radius, 24) for center, radius in holes.values()]
    vertices, faces = holed_sphere(n_points, circles)
    loops = {}
    for loop in boundary_loops(faces):
        middle = vertices[loop].mean(axis=0)
        name = min(holes, key=lambda n: np.linalg.norm(unit(middle) - unit(holes[n][0])))
        loops[name] = loop
    return Surface(bent(vertices, seed), faces, loops)


def unit(vector):
    return np.asarray(vector) / np.linalg.norm(vector)


def shape(body, subject="a"):
    return Shape(ShapeId(subject, "0", 0.0), {"B": body}, ())


def moved(one, motion, subject=None):
    """The shape carried by a rigid motion (or a reflection, with its faces turned over)."""
    turned_over = np.linalg.det(motion[:3, :3]) < 0
    parts = {
        name: Surface(
            transformed(body.vertices, motion),
            body.faces[:, ::-1] if turned_over else body.faces,
            {n: loop[::-1] if turned_over else loop for n, loop in body.loops.items()},
        )
        for name, body in one.parts.items()
    }
    subject = one.id.subject if subject is None else subject
    return Shape(ShapeId(subject, one.id.phase, one.id.time), parts, one.seams)


def random_motion(rng):
    motion = np.eye(4)
    motion[:3, :3] = Rotation.random(random_state=rng).as_matrix()
    motion[:3, 3] = 100.0 * rng.normal(size=3)
    return motion


def posed(shapes, poses):
    return [
        transformed(one.parts["B"].vertices, transform)
        for one, transform in zip(shapes, poses.transforms, strict=True)
    ]


HOLES_BY_METHOD = [
    (MANY_HOLES, PoseMethod.LANDMARKS),
    ({"mitral": MANY_HOLES["mitral"]}, PoseMethod.AXIS_AND_SURFACE),
    ({}, PoseMethod.SURFACE),
]


@pytest.mark.parametrize(("holes", "method"), HOLES_BY_METHOD)
def test_copies_of_one_shape_are_laid_on_each_other(rng, holes, method):
    one = shape(surface(holes))
    copies = [moved(one, random_motion(rng), name) for name in "abcd"]
    poses = population_poses(copies)
    assert poses.method is method
    vertices = posed(copies, poses)
    for other in vertices[1:]:
        np.testing.assert_allclose(other, vertices[0], atol=1e-6)
    np.testing.assert_allclose(poses.residuals, 0.0, atol=1e-6)
    assert not poses.mirrored.any()


@pytest.mark.parametrize(("holes", "method"), HOLES_BY_METHOD)
def test_rotating_the_inputs_changes_the_result_by_one_global_motion_only(rng, holes, method):
    shapes = [shape(surface(holes, 1200 + 100 * k, k), f"s{k}") for k in range(5)]
    shapes = [moved(one, random_motion(rng)) for one in shapes]  # they share no frame
    turned = [moved(one, random_motion(rng)) for one in shapes]
    before, after = population_poses(shapes), population_poses(turned)
    assert before.reference == after.reference
    assert before.method is method
    first = np.concatenate(posed(shapes, before))
    second = np.concatenate(posed(turned, after))
    first, second = first - first.mean(axis=0), second - second.mean(axis=0)
    rotation, _ = Rotation.align_vectors(first, second)
    # 1e-5 mm on 60 mm bodies: a rotated input may round to another nearest point once.
    np.testing.assert_allclose(rotation.apply(second), first, atol=1e-5)


@pytest.mark.parametrize(("holes", "method"), HOLES_BY_METHOD)
def test_the_order_of_the_shapes_does_not_matter(rng, holes, method):
    shapes = [moved(shape(surface(holes, 1200, k), f"s{k}"), random_motion(rng)) for k in range(5)]
    order = rng.permutation(5)
    before, after = population_poses(shapes), population_poses([shapes[k] for k in order])
    assert order[after.reference] == before.reference
    np.testing.assert_allclose(after.transforms, before.transforms[order], atol=1e-9)


@pytest.mark.parametrize(("holes", "method"), HOLES_BY_METHOD)
def test_similar_shapes_end_up_turned_alike(rng, holes, method):
    """Bodies that differ by a few percent: the true relative rotation is known to a few degrees."""
    shapes = [shape(surface(holes, 1200, 0.4 * k), f"s{k}") for k in range(4)]
    motions = [random_motion(rng) for _ in shapes]
    turned = [moved(one, motion) for one, motion in zip(shapes, motions, strict=True)]
    relative = population_poses(turned).transforms @ np.array(motions)
    reference = relative[0, :3, :3]
    angles = Rotation.from_matrix(relative[:, :3, :3] @ reference.T).magnitude()
    assert np.degrees(angles).max() < 5.0


def test_the_reference_keeps_its_input_frame(rng):
    shapes = [moved(shape(surface(MANY_HOLES, 900, k), f"{k}"), random_motion(rng)) for k in (0, 1)]
    poses = population_poses(shapes)
    np.testing.assert_array_equal(poses.transforms[poses.reference], np.eye(4))


@pytest.mark.parametrize("holes", [MANY_HOLES, {}])
def test_a_mirrored_shape_is_reported_and_not_reflected(rng, holes):
    shapes = [shape(surface(holes, 1200, 0.3 * k), f"s{k}") for k in range(4)]
    shapes[2] = moved(shapes[2], np.diag([1.0, -1.0, 1.0, 1.0]))
    poses = population_poses(shapes)
    np.testing.assert_array_equal(poses.mirrored, [False, False, True, False])
    np.testing.assert_allclose(np.linalg.det(poses.transforms[:, :3, :3]), 1.0, rtol=1e-12)


def test_openings_on_one_line_are_completed_by_the_surface():
    holes = {"top": ([0.0, 0.0, 1.0], 0.4), "bottom": ([0.0, 0.0, -1.0], 0.4)}
    circles = [(center, radius, 24) for center, radius in holes.values()]
    vertices, faces = holed_sphere(1500, circles)
    tube = vertices * [20.0, 30.0, 50.0]
    upper = [loop for loop in boundary_loops(faces) if vertices[loop, 2].mean() > 0]
    lower = [loop for loop in boundary_loops(faces) if vertices[loop, 2].mean() < 0]
    one = shape(Surface(tube, faces, {"top": upper[0], "bottom": lower[0]}))
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_rotvec([0.0, 0.0, 0.7]).as_matrix()
    poses = population_poses([one, moved(one, turn, "b")])
    assert poses.method is PoseMethod.AXIS_AND_SURFACE
    np.testing.assert_allclose(poses.residuals, 0.0, atol=1e-6)


def test_a_seam_is_one_landmark():
    parts = {}
    for name, side in (("LV", -1.0), ("LA", 1.0)):
        vertices, faces = half_sphere(600, 40, side)
        parts[name] = Surface(vertices, faces, {"mitral": boundary_loops(faces)[0]})
    one = Shape(ShapeId("a", "0", 0.0), parts, (Seam("LV.mitral", "LA.mitral"),))
    points = landmarks(one)
    assert sorted(points) == ["LA", "LV", "LV.mitral"]
    np.testing.assert_allclose(points["LV.mitral"], 0.0, atol=1e-12)
    np.testing.assert_allclose(points["LA"], [0.0, 0.0, 0.5], atol=0.01)


def test_landmarks_do_not_depend_on_how_a_rim_is_cut_into_edges():
    angle = 2 * np.pi * np.r_[0.0, 0.1, 0.15, 0.2, 0.21, 0.22, np.linspace(0.25, 0.99, 40)]
    ring = np.c_[np.cos(angle), np.sin(angle), np.zeros(len(angle))]
    vertices = np.vstack([ring, [0.0, 0.0, -1.0]])
    k = np.arange(len(ring))
    faces = np.c_[np.roll(k, -1), k, np.full(len(k), len(ring))]
    points = landmarks(shape(Surface(vertices, faces, {"rim": k})))
    np.testing.assert_allclose(points["B.rim"], 0.0, atol=0.02)


@pytest.mark.long
def test_thirty_four_shapes_take_less_than_two_seconds(rng):
    one = surface(MANY_HOLES, 4000)
    shapes = [moved(shape(one), random_motion(rng), f"s{k}") for k in range(34)]
    started = time.process_time()
    population_poses(shapes)
    assert time.process_time() - started < 2.0


def test_unusable_populations_are_refused():
    with pytest.raises(InputError, match="at least one shape"):
        population_poses([])
    two = {name: MANY_HOLES[name] for name in ("mitral", "one")}
    with pytest.raises(InputError, match=r"difference in B\.three, B\.two"):
        population_poses([shape(surface(MANY_HOLES, 900)), shape(surface(two, 900), "b")])
    flat = Surface(np.ones((3, 3)), np.array([[0, 1, 2]]), {})
    with pytest.raises(InputError, match="positive area"):
        population_poses([shape(flat)])


def bumpy(widths, seed):
    """An ellipsoid with one hole and bumps of its own."""
    vertices, faces = holed_sphere(1200, [([0.0, 0.0, 1.0], 0.5, 24)])
    rng = np.random.default_rng(seed)
    bumps = sum(np.sin(9.0 * vertices @ unit(rng.normal(size=3)) + rng.normal()) for _ in range(6))
    body = vertices * [*widths, 40.0] * (1.0 + 0.03 * bumps[:, None])
    return shape(Surface(body, faces, {"mitral": boundary_loops(faces)[0]}), f"s{seed}")


def rotation_angles(poses):
    return np.degrees(Rotation.from_matrix(poses.transforms[:, :3, :3]).magnitude())


def test_an_ambiguous_shape_stays_as_its_file_has_it_where_the_files_share_a_frame(rng):
    shapes = [bumpy((32.0, 24.0), seed) for seed in range(6)]
    ambiguous = bumpy((28.0, 28.0), 8)
    posed_alone = population_poses([moved(ambiguous, random_motion(rng)), *shapes])
    assert rotation_angles(posed_alone)[0] > 60.0  # not of that frame
    assert rotation_angles(population_poses([*shapes, ambiguous])).max() == 0.0


def test_a_shape_that_was_turned_is_turned_back_though_the_others_share_a_frame():
    shapes = [bumpy((36.0, 20.0), seed) for seed in range(6)]
    quarter = np.eye(4)
    quarter[:3, :3] = Rotation.from_rotvec([0.0, 0.0, np.pi / 2.0]).as_matrix()
    angles = rotation_angles(population_poses([*shapes[:5], moved(shapes[5], quarter)]))
    assert angles[:5].max() < 30.0
    assert abs(angles[5] - 90.0) < 30.0


def test_phases_of_a_subject_turn_together_whatever_frame_the_subject_has(rng):
    shapes = []
    for subject in range(4):
        motion = random_motion(rng)
        for phase, width in (("0", 30.0), ("1", 26.0)):  # nearly round: the fits differ at will
            one = bumpy((width, 27.0), subject)
            one = replace(one, id=ShapeId(f"p{subject}", phase, float(phase) / 2.0))
            shapes.append(moved(one, motion))
    rotations = population_poses(shapes).transforms[:, :3, :3]
    np.testing.assert_array_equal(rotations[::2], rotations[1::2])


def bone(seed):
    """A long body bent one way at one end and another way at the other."""
    size = np.array([90.0, 14.0, 13.0]) * np.random.default_rng(seed).normal(1.0, 0.06, 3)
    vertices, faces = holed_sphere(1200, [])
    far, near = np.clip(vertices[:, 0], 0.0, None), np.clip(-vertices[:, 0], 0.0, None)
    bend = np.c_[0.0 * far, 12.0 * far**3, 12.0 * near**3]
    return shape(Surface(vertices * size + bend, faces, {}), f"m{seed}")


def test_the_minority_is_mirrored_where_mirror_images_fit_less_than_twice_as_well():
    shapes = [bone(k) for k in range(7)]
    assert not population_poses(shapes).mirrored.any()
    flip = np.diag([1.0, -1.0, 1.0, 1.0])
    for wrong in ([1, 4], [0, 2, 5]):
        mixed = [moved(s, flip) if k in wrong else s for k, s in enumerate(shapes)]
        assert np.flatnonzero(population_poses(mixed).mirrored).tolist() == wrong


def test_a_mirrored_shape_is_told_by_its_surface_where_its_names_fit():
    # The openings of a belt exchange in the mirror: landmarks alone fit as they are.
    holes = {"a": ([0.8, 0.6, 0.1], 0.3), "b": ([-0.8, 0.6, 0.1], 0.3), "c": ([0, -1.0, 0.1], 0.3)}
    shapes = [shape(surface(holes, 1200, 0.2 * k), f"s{k}") for k in range(6)]
    assert not population_poses(shapes).mirrored.any()
    (body,) = moved(shapes[3], np.diag([-1.0, 1.0, 1.0, 1.0])).parts.values()
    swapped = {**body.loops, "a": body.loops["b"], "b": body.loops["a"]}
    shapes[3] = shape(Surface(body.vertices, body.faces, swapped), "s3")
    assert np.flatnonzero(population_poses(shapes).mirrored).tolist() == [3]
