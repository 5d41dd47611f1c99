"""Clinical numbers against bodies whose numbers are known."""

from dataclasses import replace

import numpy as np
import pytest

from ostiform.errors import InputError
from ostiform.evaluation import part_volumes
from ostiform.evaluation.measurements import (
    clinical_measures,
    clinical_table,
    long_axes,
    rim_curves,
    rim_measures,
)
from ostiform.exchange import read_shape_values_csv, write_shape_values_csv
from ostiform.model import ModelMesh, mesh_of_template
from ostiform.study import ShapeId
from tests.populations import population, two_part_template

FINE = 2e-3  # relative: polygons of a few hundred sides


def ellipse(a, b, n, rng):
    angles = 2.0 * np.pi * np.arange(n) / n
    flat = np.stack([a * np.cos(angles), b * np.sin(angles), np.zeros(n)], axis=1)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return flat @ turn.T + [30.0, -200.0, 7.0]


def cup(half_axes, rows=60, columns=90):
    """Return half an ellipsoid below z = 0, open at its equator: points, and its mesh."""
    a, b, c = half_axes
    polar = np.linspace(0.0, 0.5 * np.pi, rows + 1)[1:]  # from the apex to the rim
    angles = 2.0 * np.pi * np.arange(columns) / columns
    rings = np.stack(
        [
            a * np.sin(polar)[:, None] * np.cos(angles),
            b * np.sin(polar)[:, None] * np.sin(angles),
            np.repeat(-c * np.cos(polar)[:, None], columns, axis=1),
        ],
        axis=2,
    ).reshape(-1, 3)
    points = np.vstack([rings, [[0.0, 0.0, -c]]])
    index = np.arange(rows * columns).reshape(rows, columns)
    right = np.roll(index, -1, axis=1)
    sides = np.stack([index[:-1], right[:-1], right[1:], index[1:]], axis=-1).reshape(-1, 4)
    apex = np.full(columns, rows * columns)
    faces = np.vstack(
        [
            sides[:, [0, 1, 2]],
            sides[:, [0, 2, 3]],
            np.stack([apex, right[0], index[0]], axis=1),
        ]
    )
    mesh = ModelMesh(
        faces,
        np.zeros(len(faces), np.int64),
        np.zeros(len(points), np.int64),
        ("LV",),
        {"LV.mitral": index[-1][::-1]},
    )
    if part_volumes(points[None], mesh)["LV"][0] < 0.0:
        mesh = ModelMesh(
            faces[:, ::-1], mesh.face_part, mesh.part, ("LV",), {"LV.mitral": index[-1]}
        )
    return points, mesh


def twisted(points, height, angle):
    """Turn points about the z axis by an angle that grows from 0 at z = 0 to its full size."""
    turn = angle * -points[:, 2] / height
    x, y, z = points.T
    return np.stack(
        [np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y, z], axis=1
    )


def test_an_elliptic_rim_has_the_numbers_of_the_ellipse(rng):
    rim = rim_measures(ellipse(20.0, 12.0, 400, rng)[None])
    np.testing.assert_allclose(rim.area, np.pi * 20.0 * 12.0, rtol=FINE)
    np.testing.assert_allclose(rim.diameter_max, 40.0, rtol=FINE)
    np.testing.assert_allclose(rim.diameter_min, 24.0, rtol=FINE)
    # Ramanujan 1914, to about 1e-5 at this excentricity.
    h = (8.0 / 32.0) ** 2
    expected = np.pi * 32.0 * (1.0 + 3.0 * h / (10.0 + np.sqrt(4.0 - 3.0 * h)))
    np.testing.assert_allclose(rim.perimeter, expected, rtol=FINE)


def test_a_rim_measured_backwards_or_with_uneven_points_is_the_same(rng):
    even = ellipse(20.0, 12.0, 400, rng)
    halves = 0.5 * (even + np.roll(even, -1, axis=0))
    uneven = np.vstack([even[:200].repeat(1, axis=0), even[200:]])
    uneven = np.insert(uneven, np.arange(1, 101), halves[:100], axis=0)
    for other in (even[::-1], uneven):
        first, second = rim_measures(even[None]), rim_measures(other[None])
        for name in ("area", "perimeter", "diameter_max", "diameter_min", "centre"):
            np.testing.assert_allclose(getattr(first, name), getattr(second, name), rtol=1e-9)


@pytest.mark.parametrize("n", [12, 16, 24])
def test_a_rim_of_few_uneven_points_has_the_sizes_of_the_rim_they_lie_on(rng, n):
    fine = ellipse(20.0, 12.0, 4000, rng)
    whole = rim_measures(fine[None])
    steps = (np.arange(n) + rng.uniform(-0.3, 0.3, (20, n))) / n
    few = fine[(4000 * steps).astype(int) % 4000]
    polygon, curve = rim_measures(few), rim_measures(rim_curves(few))
    for name in ("area", "perimeter", "diameter_max", "diameter_min"):
        np.testing.assert_allclose(getattr(curve, name), getattr(whole, name)[0], rtol=0.01)
    assert (polygon.area < 0.99 * whole.area).all()


def test_half_an_ellipsoid_that_contracts_has_its_volume_length_and_ejection_fraction():
    points, mesh = cup((25.0, 22.0, 80.0))
    scale = np.array([[0.8, 0.8, 0.75], [1.0, 1.0, 1.0]])
    shapes = points * scale[:, None]
    found = clinical_measures(shapes, mesh, long_axes(shapes, mesh))
    volume = 2.0 / 3.0 * np.pi * 25.0 * 22.0 * 80.0 / 1000.0
    np.testing.assert_allclose(found["LV_volume_ml"], [0.48 * volume, volume], rtol=FINE)
    np.testing.assert_allclose(found["LV_ejection_fraction_percent"], [52.0, 52.0], rtol=1e-9)
    np.testing.assert_allclose(found["LV_ejected_percent"], [52.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(found["LV_long_axis_mm"], [60.0, 80.0], rtol=1e-9)
    np.testing.assert_allclose(found["LV_long_axis_shortening_percent"], [25.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(found["LV_mitral_diameter_max_mm"], [40.0, 50.0], rtol=FINE)
    np.testing.assert_allclose(found["LV_twist_deg"], [0.0, 0.0], atol=1e-9)


@pytest.mark.parametrize("angle", [0.3, -0.2])
def test_a_tube_twisted_by_a_known_angle_has_two_thirds_of_it_between_its_thirds(angle, rng):
    height, columns, rows = 60.0, 40, 90
    angles = 2.0 * np.pi * np.arange(columns) / columns
    z = -np.linspace(0.0, height, rows + 1)
    rings = np.stack(
        [
            np.tile(20.0 * np.cos(angles), rows + 1),
            np.tile(20.0 * np.sin(angles), rows + 1),
            np.repeat(z, columns),
        ],
        axis=1,
    )
    index = np.arange(len(rings)).reshape(rows + 1, columns)
    right = np.roll(index, -1, axis=1)
    a, b, c, d = index[:-1], right[:-1], right[1:], index[1:]
    faces = np.concatenate([np.stack([a, c, b], -1), np.stack([a, d, c], -1)]).reshape(-1, 3)
    shapes = np.stack([rings, twisted(rings, height, angle)])
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn[:, 0] *= np.linalg.det(turn)
    shapes = shapes @ turn.T + [5.0, 6.0, 7.0]
    base, apex = (
        np.repeat((turn @ [0.0, 0.0, h])[None] + [5.0, 6.0, 7.0], 2, axis=0) for h in (0.0, -height)
    )
    from ostiform.evaluation.measurements import twist_angles

    found = twist_angles(shapes, faces, base, apex, 0)
    # Seen from the apex (from below) a turn that is positive about +z runs clockwise.
    np.testing.assert_allclose(found, [0.0, -2.0 / 3.0 * angle], rtol=2e-2, atol=1e-12)


def test_clinical_numbers_do_not_move_with_the_heart_and_scale_with_their_units(rng):
    points, mesh = cup((25.0, 22.0, 80.0), 20, 30)
    shapes = np.stack([points, twisted(0.8 * points, 80.0, 0.2)])
    axes = long_axes(shapes, mesh)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn[:, 0] *= np.linalg.det(turn)
    here = clinical_measures(shapes, mesh, axes)
    there = clinical_measures(2.0 * shapes @ turn.T + [100.0, 50.0, -70.0], mesh, axes)
    factors = {"ml": 8.0, "mm2": 4.0, "mm": 2.0, "percent": 1.0, "deg": 1.0}
    for name, values in here.items():
        factor = factors[name.rsplit("_", 1)[1]]
        np.testing.assert_allclose(there[name], factor * values, rtol=1e-6, atol=1e-6)


def test_one_phase_has_no_motion_and_a_wall_no_ejection(rng, tmp_path):
    points, mesh = cup((25.0, 22.0, 80.0))
    shapes = points * np.array([[0.8, 0.8, 0.75], [1.0, 1.0, 1.0], [0.9, 0.9, 0.9]])[:, None]
    motion = ("_ejected_percent", "_ejection_fraction_percent", "_shortening_percent", "_twist_deg")
    ids = [ShapeId("a", "0", 0.0), ShapeId("a", "1", 0.5), ShapeId("b", "0", 0.0)]
    table = clinical_table(ids, shapes, shapes, mesh)
    for column in table.columns:
        has_gap = np.isnan(table.column(column)).tolist()
        assert has_gap == [False, False, column.endswith(motion)]
    write_shape_values_csv(tmp_path / "a.csv", ids, table.columns, table.values)
    assert "nan" not in (tmp_path / "a.csv").read_text()
    np.testing.assert_allclose(read_shape_values_csv(tmp_path / "a.csv")[2], table.values, 1e-5)
    alone = [ShapeId(name, "0", 0.0) for name in "abc"]
    assert not any(c.endswith(motion) for c in clinical_table(alone, shapes, shapes, mesh).columns)
    wall = replace(mesh, parts=("epicardium",), loops={"epicardium.base": mesh.loops["LV.mitral"]})
    columns = clinical_table(ids, shapes, shapes, wall).columns
    assert "epicardium_volume_ml" in columns
    assert not any(name.endswith(motion[:2]) for name in columns)


def test_the_table_has_a_row_per_shape_and_units_in_its_names(rng):
    shapes = population(2, 3, rng, two_part_template(9, 16))
    mesh = mesh_of_template(shapes.template)
    table = clinical_table(shapes.ids, shapes.aligned, shapes.aligned, mesh)
    assert table.values.shape == (6, len(table.columns))
    assert all(
        name.rsplit("_", 1)[1] in ("ml", "mm", "mm2", "percent", "deg") for name in table.columns
    )
    volumes = part_volumes(shapes.aligned, mesh)
    np.testing.assert_allclose(table.column("LA_volume_ml"), volumes["LA"] / 1000.0)
    for subject in range(2):
        own = table.column("LV_ejected_percent")[3 * subject : 3 * subject + 3]
        np.testing.assert_allclose(own.min(), 0.0, atol=1e-12)
        fraction = table.column("LV_ejection_fraction_percent")[3 * subject]
        np.testing.assert_allclose(own.max(), fraction)
    with pytest.raises(InputError, match="expected one of"):
        table.column("LV_nothing_mm")
