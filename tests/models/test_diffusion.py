"""Charge diffusion: a response that reaches into the pixels around, against a convolution."""

import numpy as np
import pytest
from astropy import units as u
from photutils.psf import MoffatPSF

from scope_models import (
    PRF,
    BivariateGaussianPSF,
    Detector,
    Motion,
    SensitivityPolynomial,
    Star,
    fit_tpf,
    integrate_pixels,
    simulate,
)
from scope_models.models import DiffusionSensitivity

PSF = BivariateGaussianPSF(1.0, 3.1, 2.8, 0.5, 0.4, 0.3)
SHAPE = (7, 7)


@pytest.mark.parametrize("method", ["auto", "quadrature"])
def test_gaussian_becomes_wider(method):
    sigma = 0.2
    wide, tall = np.hypot(0.5, sigma), np.hypot(0.4, sigma)
    convolved = BivariateGaussianPSF(1.0, 3.1, 2.8, wide, tall, 0.3 * 0.5 * 0.4 / (wide * tall))
    image = integrate_pixels(PSF * DiffusionSensitivity(sigma), SHAPE, method=method)
    np.testing.assert_allclose(image, integrate_pixels(convolved, SHAPE), atol=1e-10)


def test_no_diffusion_is_a_box():
    offset = np.array([-0.7, -0.5, 0.2, 0.5, 0.6])
    response = DiffusionSensitivity(0.0)
    np.testing.assert_array_equal(response.response(offset, 0.0), [0, 0.5, 1, 0.5, 0])
    np.testing.assert_array_equal(response.fit_deriv(offset, 0.0, 0.0), np.zeros((1, 5)))


def test_any_density_with_a_polynomial():
    """Each pixel collects the light of nine, weighted where it falls, by a fine rule."""
    psf = MoffatPSF(x_0=3.1, y_0=2.8, alpha=1.2, beta=2.5)
    response = DiffusionSensitivity(0.1)
    polynomial = SensitivityPolynomial((1, 0, -0.4), (1, 0.1, -0.2))
    image = integrate_pixels(psf * response * polynomial, SHAPE)
    nodes, weights = np.polynomial.legendre.leggauss(80)
    u_at, weights = nodes / 2, weights / 2
    for column, row in ((3, 3), (4, 2)):
        total = 0.0
        for i in (-1, 0, 1):
            for j in (-1, 0, 1):
                x, y = column + i + u_at, row + j + u_at[:, None]
                light = psf(*np.broadcast_arrays(x, y)) * polynomial(*np.broadcast_arrays(x, y))
                total += weights @ (light * response.response(x - column, y - row)) @ weights
        assert image[row, column] == pytest.approx(total, abs=1e-10)


def test_no_light_is_lost():
    """The responses of all pixels add up to 1, and so does the light of a star anywhere."""
    offset = np.arange(-4, 5)
    rng = np.random.default_rng(1)
    for u_at, v_at in rng.uniform(-0.5, 0.5, (5, 2)):
        parts = DiffusionSensitivity(0.3).response(u_at - offset[:, None], v_at - offset)
        assert parts.sum() == pytest.approx(1, abs=1e-14)
    psf = BivariateGaussianPSF(1.0, sigma_x=0.35, sigma_y=0.35)
    for x in (5.0, 5.25, 5.5):
        moved = psf.copy()
        moved.x_0, moved.y_0 = x, 5.0
        image = integrate_pixels(moved * DiffusionSensitivity(0.25), (11, 11))
        assert image.sum() == pytest.approx(1, abs=1e-12)


@pytest.mark.parametrize("sigma", [0.0, 0.2])
@pytest.mark.parametrize("response", [None, SensitivityPolynomial((1, 0.1, -0.3))])
def test_derivatives_of_a_prf(sigma, response):
    product = PSF * DiffusionSensitivity(sigma)
    prf = PRF(product if response is None else product * response)
    y, x = np.mgrid[2:4, 2:5]
    derivatives = prf.fit_deriv(x, y, *prf.parameters)
    for name in ("x_0", "sigma_x", "sigma_y", "rho", *(n for n in prf.param_names if "_d" in n)):
        i, step = prf.param_names.index(name), np.zeros(len(prf.parameters))
        step[i] = 1e-4
        high, low = (prf.evaluate(x, y, *(prf.parameters + s * step)) for s in (1, -1))
        np.testing.assert_allclose(derivatives[i], (high - low) / 2e-4, atol=3e-7, err_msg=name)


def test_units_and_domain():
    half = DiffusionSensitivity(0.2 * u.pix)
    assert half(2.5 * u.pix, 0 * u.pix) == pytest.approx(DiffusionSensitivity(0.2)(2.5, 0))
    assert half.response(0.5, 0) == pytest.approx(DiffusionSensitivity(0.2).response(0.5, 0))
    psf = BivariateGaussianPSF(x_0=0 * u.pix, y_0=0 * u.pix, sigma_x=1 * u.pix, sigma_y=1 * u.pix)
    prf = PRF(psf * half)
    assert prf.sensitivity.sigma_d == 0.2
    assert prf.psf.sigma_x.quantity == 1 * u.pix
    with pytest.raises(ValueError, match="`sigma_d` must be at least 0"):
        DiffusionSensitivity(-0.1)
    with pytest.raises(ValueError, match="`sigma_d` must be in pix"):
        DiffusionSensitivity(0.1 * u.s)


def test_simulated_and_fitted():
    """With the optics known, pixels measure the diffusion; otherwise it is held."""
    response = DiffusionSensitivity(0.25)
    detector = Detector.k2(shape=(9, 9), sensitivity=response, interpixel_scatter=0)
    observation = simulate(Star(12.0), detector, 2 * Motion.k2_roll(40), seed=1)
    image = integrate_pixels(
        BivariateGaussianPSF(1, *(p[0, 3] for p in (observation.truth.x, observation.truth.y)))
        * response,
        (9, 9),
    )
    np.testing.assert_allclose(
        observation.model()[3], observation.truth.flux[0] * image, rtol=1e-6, atol=1e-3
    )
    tpf = observation.to_tpf()
    known = BivariateGaussianPSF(fixed={"sigma_x": True, "sigma_y": True, "rho": True})
    fit = fit_tpf(tpf, known, DiffusionSensitivity(0.1), interpixel=0)
    assert abs(fit.values["sigma_d"] - 0.25) < 4 * fit.errors["sigma_d"] < 0.01
    held = fit_tpf(tpf, 1, DiffusionSensitivity(0.25), interpixel=0)
    assert "sigma_d" not in held.names
    assert abs(held.values["sigma_x"] - 0.5) < 4 * held.errors["sigma_x"]
    assert held.scene().detector.sensitivity.sigma_d == 0.25
