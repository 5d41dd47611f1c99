import numpy as np
import pytest

from ostiform.correspondence.terms.description_length import (
    cut_off_eigenvalue,
    description_length,
    description_length_gradient,
    majoriser,
    spectrum,
)
from ostiform.correspondence.terms.quadratic_form import form_product, form_value
from ostiform.errors import InputError

L_CUT = 0.02


@pytest.fixture
def shapes(rng):
    """Twelve shapes of 30 points with three strong modes and noise."""
    modes = rng.normal(size=(3, 30, 3))
    noise = 0.05 * rng.normal(size=(12, 30, 3))
    return np.einsum("nk,kpi->npi", rng.normal(size=(12, 3)) * [3.0, 2.0, 1.0], modes) + noise


@pytest.fixture
def weights(rng):
    weights = rng.uniform(0.5, 1.5, 30)
    return weights / weights.sum()


def test_description_length_is_that_of_the_covariance_matrix(shapes, weights):
    scaled = ((shapes - shapes.mean(axis=0)) * np.sqrt(weights)[:, None]).reshape(12, -1)
    eigenvalues = np.linalg.eigvalsh(scaled.T @ scaled / 11.0)[::-1][:11]
    strong = eigenvalues >= L_CUT
    expected = (1.0 + np.log(eigenvalues[strong] / L_CUT)).sum()
    expected += (eigenvalues[~strong] / L_CUT).sum()
    assert strong.any()
    assert not strong.all()
    np.testing.assert_allclose(description_length(shapes, weights, L_CUT), expected, rtol=1e-9)


def test_description_length_scales_as_it_must(shapes, weights):
    np.testing.assert_allclose(
        description_length(2.0 * shapes, weights, 4.0 * L_CUT),
        description_length(shapes, weights, L_CUT),
        rtol=1e-10,
    )


def test_the_gradient_has_a_taylor_remainder_of_second_order(shapes, weights, rng):
    direction = rng.normal(size=shapes.shape)
    start = description_length(shapes, weights, L_CUT)
    slope = (description_length_gradient(shapes, weights, L_CUT) * direction).sum()
    steps = 10.0 ** -np.arange(3.0, 5.1, 0.5)
    remainders = [
        abs(description_length(shapes + h * direction, weights, L_CUT) - start - h * slope)
        for h in steps
    ]
    order = np.polyfit(np.log(steps), np.log(remainders), 1)[0]
    assert 1.9 < order < 2.1


def test_the_quadratic_form_majorises_and_touches(shapes, weights, rng):
    form = majoriser(spectrum(shapes, weights), weights, L_CUT)

    def surrogate(candidate):
        return sum(form_value(form, shape) for shape in candidate) / (len(candidate) - 1.0)

    offset = description_length(shapes, weights, L_CUT) - surrogate(shapes)
    for size in (0.01, 0.1, 1.0):
        moved = shapes + size * rng.normal(size=shapes.shape)
        above = surrogate(moved) + offset - description_length(moved, weights, L_CUT)
        assert above > -1e-9
    dense = np.stack([form_product(form, shape) for shape in shapes])
    values = [
        ((s - form.target) * np.sqrt(weights)[:, None] * d).sum()
        for s, d in zip(shapes, dense, strict=True)
    ]
    np.testing.assert_allclose(values, [form_value(form, s) for s in shapes], rtol=1e-9)


def test_the_cut_off_is_what_noise_puts_in_each_mode():
    np.testing.assert_allclose(cut_off_eigenvalue(0.2, 37, 1000), 3.0 * 0.04 / 36.0)
    with pytest.raises(InputError, match="noise above 0"):
        cut_off_eigenvalue(0.0, 37, 1000)


def test_one_shape_has_no_description_length(shapes, weights):
    with pytest.raises(InputError, match="at least 2 shapes"):
        description_length(shapes[:1], weights, L_CUT)
