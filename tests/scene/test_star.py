"""Stars: checks of their fields, and relative flux from models, functions and arrays."""

import dataclasses

import numpy as np
import pytest
from astropy.modeling.models import Const1D, Gaussian2D, Sine1D
from photutils.psf import GaussianPRF

from scope_models import BivariateGaussianPSF, Star

TIME = np.linspace(0, 1, 5)


def test_constant_by_default():
    assert np.array_equal(Star(12.0).relative_flux(TIME), np.ones(5))


@pytest.mark.parametrize(
    "signal",
    [
        Const1D(1.0) + Sine1D(amplitude=0.1, frequency=1.0),
        lambda time: 1 + 0.1 * np.sin(2 * np.pi * time),
        1 + 0.1 * np.sin(2 * np.pi * TIME),
        list(1 + 0.1 * np.sin(2 * np.pi * TIME)),
    ],
    ids=["model", "function", "array", "list"],
)
def test_signals(signal):
    expected = 1 + 0.1 * np.sin(2 * np.pi * TIME)
    np.testing.assert_allclose(Star(12.0, signal=signal).relative_flux(TIME), expected, rtol=1e-14)


def test_star_is_independent_of_its_arguments():
    signal, psf = np.ones(5), BivariateGaussianPSF(sigma_x=0.7)
    star = Star(12.0, signal=signal, psf=psf)
    signal[0] = 0.0
    psf.sigma_x = 3.0
    assert star.relative_flux(TIME)[0] == 1
    assert star.psf.sigma_x == 0.7
    star.relative_flux(TIME)[0] = 5.0
    assert star.relative_flux(TIME)[0] == 1
    with pytest.raises(dataclasses.FrozenInstanceError):
        star.mag = 3.0


def test_replace():
    star = Star(12.0, 3.0, 4.0).replace(mag=10.0)
    assert (star.mag, star.x_0, star.y_0) == (10.0, 3.0, 4.0)
    with pytest.raises(TypeError, match="magnitude"):
        star.replace(magnitude=10.0)


@pytest.mark.parametrize(
    "arguments, error, message",
    [
        ({"mag": np.nan}, ValueError, "`mag` must be finite, got nan"),
        ({"mag": "12"}, TypeError, "`mag` must be a number, got '12'"),
        ({"x_0": np.inf}, ValueError, "`x_0` must be finite, got inf"),
        ({"y_0": "left"}, TypeError, "`y_0` must be a number, got 'left'"),
        ({"psf": 0.5}, TypeError, "`psf` must be a two-dimensional astropy model or None, got 0.5"),
        ({"psf": Const1D()}, TypeError, "`psf` must be a two-dimensional astropy model"),
        ({"psf": Gaussian2D()}, ValueError, "a component needs flux, x_0 and y_0"),
        ({"psf": GaussianPRF()}, ValueError, "already integrated over pixels"),
        ({"signal": Gaussian2D()}, TypeError, "`signal` must be a model of time alone"),
        ({"signal": "transit"}, TypeError, "`signal` must be a model, a function of time"),
        ({"signal": np.ones((2, 3))}, TypeError, "`signal` must be a model, a function of time"),
        ({"signal": [1.0, np.nan]}, ValueError, "`signal` must be finite in every cadence"),
        ({"signal": [1.0, -0.1]}, ValueError, "`signal` must not be negative, got -0.1"),
    ],
)
def test_bad_arguments(arguments, error, message):
    with pytest.raises(error, match=message):
        Star(**({"mag": 12.0} | arguments))


@pytest.mark.parametrize(
    "signal, message",
    [
        (np.ones(4), r"one number for each of the 5 cadences, got the shape \(4,\)"),
        (lambda time: time[:2], r"one number for each of the 5 cadences, got the shape \(2,\)"),
        (lambda time: time - 0.5, "`signal` must not be negative, got -0.5"),
        (lambda time: np.full(len(time), np.nan), "`signal` must be finite in every cadence"),
    ],
)
def test_bad_signals(signal, message):
    with pytest.raises(ValueError, match=message):
        Star(12.0, signal=signal).relative_flux(TIME)
