"""The empirical PSF, against quadrature and against the Gaussian."""

import numpy as np
import pytest
from scipy.integrate import dblquad

from scope_models import PRF, BivariateGaussianPSF, SensitivityPolynomial, integrate_pixels
from scope_models.models import GaussHermitePSF

COEFFICIENTS = {"c_1_0": 0.1, "c_2_1": -0.07, "c_0_3": 0.05, "c_4_0": 0.12}


def surface():
    return GaussHermitePSF(3.0, 0.1, -0.2, 0.6, 0.5, order=4, **COEFFICIENTS)


def test_without_coefficients_it_is_the_gaussian():
    x, y = np.random.default_rng(1).normal(0, 1, (2, 50))
    gaussian = BivariateGaussianPSF(2.0, 0.1, 0.2, 0.5, 0.7)
    np.testing.assert_allclose(
        GaussHermitePSF(2.0, 0.1, 0.2, 0.5, 0.7, order=3)(x, y), gaussian(x, y), rtol=1e-13
    )


def test_first_order_is_a_shift():
    # f(z - e) = f(z) + e z f(z) + ..., and h_1 = z h_0.
    moved = GaussHermitePSF(1.0, order=1, c_1_0=1e-4)
    shifted = BivariateGaussianPSF(1.0, x_0=0.5e-4)
    x = np.linspace(-1, 1, 9)
    np.testing.assert_allclose(moved(x, 0.3), shifted(x, 0.3), atol=3e-8)


def test_flux_is_the_integral():
    image = integrate_pixels(surface(), x=np.arange(-6, 7.0), y=np.arange(-6, 7.0)[:, None])
    assert image.sum() == pytest.approx(3.0, abs=1e-12)


@pytest.mark.parametrize("column, row", [(0, 0), (1, -1), (-1, 1)])
def test_pixels_against_adaptive_quadrature(column, row):
    psf, sensitivity = surface(), SensitivityPolynomial((1, 0.02, -0.3), (1, 0, -0.2))
    expected, _ = dblquad(
        lambda y, x: psf(x, y) * sensitivity(x, y),
        column - 0.5, column + 0.5 - 1e-12, row - 0.5, row + 0.5 - 1e-12,
        epsabs=1e-11,
    )  # fmt: skip
    image = integrate_pixels(psf * sensitivity, x=[column], y=[row])
    assert image[0] == pytest.approx(expected, abs=1e-9)


def test_derivatives_in_a_prf_are_differences():
    gaussian = BivariateGaussianPSF(7.0, 0, 0, 0.45, 0.4, 0.2)
    prf = PRF((gaussian + surface()) * SensitivityPolynomial((1, 0.02, -0.05), (1, 0, -0.2)))
    values = {name: float(getattr(prf, name).value) for name in prf.param_names[3:]}
    places = dict(zip(("x_0", "y_0"), np.random.default_rng(2).uniform(2, 4, (2, 5)), strict=True))
    image, derivatives = prf.unit_images((7, 7), **places, values=values, derivatives=True)
    np.testing.assert_allclose(image, prf.render((7, 7), flux=1, **places), atol=1e-14)
    np.testing.assert_array_equal(image, prf.unit_images((7, 7), **places, derivatives=True)[0])
    assert set(derivatives) == set(prf.param_names) - {"flux"}
    for name, derivative in derivatives.items():
        moved = []
        for step in (1e-5, -1e-5):
            if name in places:
                there = places | {name: places[name] + step}
                moved.append(prf.unit_images((7, 7), **there))
            else:
                there = {name: values[name] + step}
                moved.append(prf.unit_images((7, 7), **places, values=there))
        high, low = moved
        np.testing.assert_allclose(derivative, (high - low) / 2e-5, atol=3e-9, err_msg=name)


def test_parts_of_a_prf_make_it_again():
    gaussian = BivariateGaussianPSF(7.0, 0, 0, 0.45, 0.4, 0.2)
    prf = PRF((gaussian + surface()) * SensitivityPolynomial(), flux=5.0, x_0=3.0, y_0=3.2)
    again = PRF(prf.psf * prf.sensitivity, flux=5.0)
    np.testing.assert_allclose(again.render((7, 7)), prf.render((7, 7)), atol=1e-14)


@pytest.mark.parametrize(
    "options, message",
    [
        ({"order": 0}, "`order` must be at least 1, got 0"),
        ({"order": 21}, "`order` must be at most 20, got 21"),
        ({"order": 2.5}, "`order` must be an integer, got 2.5"),
        ({"order": 1, "c_2_0": 0.1}, "has no coefficient c_2_0"),
        ({"c_2_0": [0.1, 0.2]}, "`c_2_0` must be one number, got 2 values"),
        ({"sigma_x": -1.0}, "`sigma_x` must be positive"),
    ],
)
def test_bad_input(options, message):
    with pytest.raises((TypeError, ValueError), match=message):
        GaussHermitePSF(**options)


def test_widths_of_many_images():
    """Each image has its own width, as one at a time."""
    psf = GaussHermitePSF(1.0, 3.1, 2.9, [0.5, 0.7], 0.6, order=3, c_2_0=0.1)
    images = integrate_pixels(psf, (7, 7))
    for width, image in zip((0.5, 0.7), images, strict=True):
        single = GaussHermitePSF(1.0, 3.1, 2.9, width, 0.6, order=3, c_2_0=0.1)
        np.testing.assert_allclose(image, integrate_pixels(single, (7, 7)), atol=1e-14)
