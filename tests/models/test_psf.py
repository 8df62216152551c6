"""The bivariate Gaussian density."""

import numpy as np
import pytest
from astropy import units as u
from astropy.modeling.models import Gaussian2D
from scipy.integrate import dblquad
from scipy.stats import multivariate_normal

from scope_models import PRF, BivariateGaussianPSF, SensitivityPolynomial


def test_is_the_standard_bivariate_normal():
    psf = BivariateGaussianPSF(7.0, 1.2, -0.4, 0.8, 0.5, -0.7)
    covariance = [[0.64, -0.28], [-0.28, 0.25]]
    x, y = np.random.default_rng(0).normal(0, 1, (2, 50))
    expected = 7 * multivariate_normal([1.2, -0.4], covariance).pdf(np.transpose([x, y]))
    np.testing.assert_allclose(psf(x, y), expected, rtol=1e-12)


@pytest.mark.parametrize("rho", [0.0, 0.5, -0.9])
def test_integrates_to_its_flux(rho):
    """With the prefactor and exponent of the paper in print it does not."""
    psf = BivariateGaussianPSF(3.0, 0.0, 0.0, 0.6, 0.4, rho)
    values = psf.parameters
    total = dblquad(lambda y, x: psf.evaluate(x, y, *values), -5, 5, -5, 5, epsabs=1e-9)[0]
    assert total == pytest.approx(3.0, abs=1e-7)


def test_moments():
    psf = BivariateGaussianPSF(1.0, 0.3, -0.2, 0.6, 0.9, 0.5)
    axis = np.linspace(-8, 8, 801)
    x, y = np.meshgrid(axis, axis)
    weight = psf(x, y) * (axis[1] - axis[0]) ** 2
    assert np.sum(weight * x) == pytest.approx(0.3, abs=1e-9)
    assert np.sum(weight * (y + 0.2) ** 2) == pytest.approx(0.81, abs=1e-9)
    covariance = np.sum(weight * (x - 0.3) * (y + 0.2))
    assert covariance == pytest.approx(0.5 * 0.6 * 0.9, abs=1e-9)


def test_without_correlation_is_astropys():
    ours = BivariateGaussianPSF(2 * np.pi * 0.4 * 0.7, 0.1, 0.2, 0.4, 0.7)
    theirs = Gaussian2D(1.0, 0.1, 0.2, 0.4, 0.7)
    x, y = np.mgrid[-2:2:9j, -2:2:9j]
    np.testing.assert_allclose(ours(x, y), theirs(x, y), rtol=1e-13)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"sigma_x": 0.0}, "`sigma_x` must be positive, got 0.0"),
        ({"sigma_y": -1.0}, "`sigma_y` must be positive, got -1.0"),
        ({"rho": 1.0}, r"`rho` must be inside \(-1, 1\), got 1.0"),
        ({"rho": -1.5}, "`rho` must be from -1 to 1, got -1.5"),
        ({"flux": np.nan}, "`flux` must be finite, got nan"),
        ({"x_0": np.inf}, "`x_0` must be finite, got inf"),
        ({"sigma_x": [0.5, -0.5]}, "`sigma_x` must be positive, got -0.5"),
    ],
)
def test_bad_parameters(values, message):
    with pytest.raises(ValueError, match=message):
        BivariateGaussianPSF(**values)


def test_bad_values_are_refused_later_too():
    psf = BivariateGaussianPSF()
    with pytest.raises(ValueError, match="`sigma_x` must be positive, got -2"):
        psf.sigma_x = -2
    with pytest.raises(ValueError, match=r"`rho` must be from -1 to 1, got 1.5"):
        psf.rho = 1.5
    with pytest.raises(TypeError, match="sigma"):
        BivariateGaussianPSF(sigma=1)


def test_a_singular_density_has_no_value():
    psf = BivariateGaussianPSF(rho=0.9)
    prf = PRF(psf * SensitivityPolynomial())
    for model in (psf, prf):
        model.rho = -1.0
        assert np.isnan(model([0.0, 2.0], [0.0, 1.0])).all()
    with pytest.raises(ValueError, match=r"`rho` must be inside"):
        PRF(psf)


def test_units():
    psf = BivariateGaussianPSF(
        10 * u.electron / u.s, 1 * u.pix, 2 * u.pix, 0.5 * u.pix, 0.4 * u.pix, 0.1
    )
    value = psf(1 * u.pix, 2 * u.pix)
    assert value.unit == u.electron / u.s / u.pix**2
    assert value.value == pytest.approx(BivariateGaussianPSF(10, 1, 2, 0.5, 0.4, 0.1)(1, 2))
    with pytest.raises(u.UnitsError):
        psf(1 * u.s, 2 * u.pix)
