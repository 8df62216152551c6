"""Transits against direct integration over the stellar disc; red noise against its CDPP."""

import copy
import pickle

import numpy as np
import pytest
from astropy import units as u
from astropy.modeling.fitting import TRFLSQFitter
from astropy.time import Time
from numpy.testing import assert_allclose
from scipy.integrate import quad
from scipy.optimize import brentq

from scope_models.models.signals import (
    TransitModel,
    sinusoidal_signal,
    stochastic_signal,
    tabulated_signal,
)
from scope_models.photometry import cdpp

LONG_CADENCE = 0.0204336


def disc_flux(separation, rp, u1, u2, n=2000):
    """Flux left by direct summation of the covered part of the disc, on a fine grid."""
    grid = ((np.arange(n) + 0.5) / n * 2 - 1) * rp
    x, y = grid[np.newaxis, :], grid[:, np.newaxis]
    inside = x**2 + y**2 < rp**2
    mu2 = 1 - ((x + separation) ** 2 + y**2)
    mu = np.sqrt(np.clip(mu2, 0, None))
    intensity = np.where(inside & (mu2 > 0), 1 - u1 * (1 - mu) - u2 * (1 - mu) ** 2, 0)
    covered = intensity.sum() * (2 * rp / n) ** 2
    return 1 - covered / (np.pi * (1 - u1 / 3 - u2 / 6))


def ring_flux(separation, rp, u1, u2):
    """Flux left by adaptive integration over the covered arcs of the star's rings."""
    z = separation

    def covered(r):
        mu = np.sqrt(max(1 - r * r, 0))
        if z < 1e-12 or r == 0:
            half_angle = np.pi if r < rp - z else 0
        else:
            half_angle = np.arccos(np.clip((r * r + z * z - rp * rp) / (2 * r * z), -1, 1))
        return 2 * half_angle * r * (1 - u1 * (1 - mu) - u2 * (1 - mu) ** 2)

    low, kink, high = max(0, z - rp), min(abs(z - rp), 1), min(1, z + rp)
    total = sum(quad(covered, *ends, epsabs=1e-11)[0] for ends in [(low, kink), (kink, high)])
    return 1 - total / (np.pi * (1 - u1 / 3 - u2 / 6))


def sky_distance(time, period, t0, a, inc, ecc, omega):
    """Solve Kepler's equation by bisection and rotate the orbit with matrices."""
    inc, omega = np.radians([inc, omega])

    def mean_anomaly(f):
        eccentric = 2 * np.arctan(np.sqrt((1 - ecc) / (1 + ecc)) * np.tan(f / 2))
        return eccentric - ecc * np.sin(eccentric)

    mean = 2 * np.pi * (time - t0) / period + mean_anomaly(np.pi / 2 - omega)
    mean = (mean + np.pi) % (2 * np.pi) - np.pi
    eccentric = brentq(lambda e: e - ecc * np.sin(e) - mean, -np.pi - 1, np.pi + 1, xtol=1e-14)
    plane = a * np.array([np.cos(eccentric) - ecc, np.sqrt(1 - ecc**2) * np.sin(eccentric), 0])
    c, s = np.cos(omega), np.sin(omega)
    x, y, _ = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ plane
    return np.hypot(x, y * np.cos(inc)) if y * np.sin(inc) > 0 else np.inf


@pytest.mark.parametrize("rp", [0.01, 0.1, 0.4])
@pytest.mark.parametrize("b", [0.0, 0.3, 0.95, 1.02])
def test_transit_is_the_integral_over_the_disc(rp, b):
    """To 0.1 ppm, at ten times from conjunction to beyond the last contact."""
    planet = TransitModel.from_orbit(3, 0.5, rp, a=8, b=b, u1=0.45, u2=0.2)
    time = np.linspace(0.5, 0.75, 10)
    distance = [sky_distance(t, 3, 0.5, 8, planet.inc.value, 0, 90) for t in time]
    expected = [ring_flux(z, rp, 0.45, 0.2) if z < 1 + rp else 1.0 for z in distance]
    assert_allclose(planet(time), expected, atol=1e-7, rtol=0)


@pytest.mark.parametrize("z", [0.0, 0.04, 0.5, 0.93, 1.05])
def test_two_independent_integrations(z):
    """Summation over the disc in two dimensions, to 1 ppm: the grid's own error is 0.3 ppm."""
    expected = disc_flux(z, 0.1, 0.4, 0.3)
    inc = np.degrees(np.arccos(z / 8))
    assert_allclose(
        TransitModel(3, 0, 0.1, 8, inc, 0, 90, 0.4, 0.3)(0), expected, atol=1e-6, rtol=0
    )
    assert_allclose(ring_flux(z, 0.1, 0.4, 0.3), expected, atol=1e-6, rtol=0)


@pytest.mark.parametrize("ecc, omega", [(0.0, 30.0), (0.3, 0.0), (0.6, 200.0), (0.8, -70.0)])
def test_eccentric_orbits(ecc, omega):
    planet = TransitModel(10, 3, 0.1, 15, 88.0, ecc, omega, 0.4, 0.3)
    time = np.linspace(-5, 30, 1501)
    distance = np.array([sky_distance(t, 10, 3, 15, 88.0, ecc, omega) for t in time])
    covered = distance < 1.1
    expected = np.ones_like(time)
    expected[covered] = [ring_flux(z, 0.1, 0.4, 0.3) for z in distance[covered]]
    assert covered.sum() > 5
    assert_allclose(planet(time), expected, atol=1e-8, rtol=0)
    assert_allclose(sky_distance(3.0, 10, 3, 15, 88.0, ecc, omega), planet.impact_parameter)


@pytest.mark.parametrize(
    "period, rp, a, b, exposure",
    [
        (3, 0.1, 10, 0.0, LONG_CADENCE),
        (15, 0.1, 10.5, 0.5, LONG_CADENCE),
        (10, 0.15, 20, 1.05, 1 / 24),
        (0.3, 0.1, 3, 0.0, LONG_CADENCE),
    ],
)
def test_finite_exposure_is_within_1_ppm(period, rp, a, b, exposure):
    """Against the mean of 5000 instantaneous values per exposure."""
    options = {"a": a, "b": b, "u1": 0.4, "u2": 0.3}
    long = TransitModel.from_orbit(period, 0.2, rp, exposure_time=exposure, **options)
    short = TransitModel.from_orbit(period, 0.2, rp, **options)
    time = 0.2 + np.linspace(-0.6, 0.6, 121) * (short.duration + exposure)
    inner = exposure * ((np.arange(5000) + 0.5) / 5000 - 0.5)
    expected = short(time[:, np.newaxis] + inner).mean(axis=1)
    assert_allclose(long(time), expected, atol=1e-6, rtol=0)
    assert np.max(np.abs(long(time) - short(time))) > 1e-4


def test_secondary_eclipse_is_no_transit():
    planet = TransitModel(10, 0, 0.1, 5)
    assert planet(5.0) == 1
    assert planet(10.0) < 0.99
    assert planet(-20.0) == planet(0.0)


@pytest.mark.parametrize("b", [0.0, 0.6, 0.95])
@pytest.mark.parametrize("depth", [1e-4, 0.01, 0.3])
def test_from_depth_duration(depth, b):
    planet = TransitModel.from_depth_duration(depth, 0.25, 7.0, 2.0, b=b, u1=0.4, u2=0.2)
    assert_allclose(1 - planet(2.0), depth, rtol=1e-9)
    assert_allclose([planet.depth, planet.duration], [depth, 0.25], rtol=1e-9)
    assert_allclose(planet.impact_parameter, b, atol=1e-9)
    assert (planet(2 + np.array([-0.12501, 0.12501])) == 1).all()
    assert (planet(2 + np.array([-0.12485, 0.12485])) < 1).all()


def test_duration_of_an_eccentric_orbit():
    """The contacts are where the flux leaves 1, on either side."""
    planet = TransitModel(20, 0, 0.1, 20, 89, 0.5, 20, 0.4, 0.3)
    time = np.linspace(-0.5, 0.5, 200_001)
    inside = time[planet(time) < 1]
    assert_allclose(planet.duration, np.ptp(inside), atol=2e-5)
    assert TransitModel(20, 0, 0.1, 20, 80).duration == 0.0


def test_density_and_axis():
    """Sun and Earth: 215.03 solar radii, 1.41 g/cm3."""
    earth = TransitModel.from_orbit(365.25636, density=1.40977 * u.g / u.cm**3)
    assert_allclose(earth.a.value, 149597870.7 / 695700, rtol=1e-4)
    assert_allclose(earth.stellar_density, 1.40977, rtol=1e-12)
    same = TransitModel.from_orbit(365.25636, density=1409.77 * u.kg / u.m**3)
    assert_allclose(same.a.value, earth.a.value, rtol=1e-12)


def test_fit_recovers_parameters_within_their_errors():
    """A TRF fit to white noise: chi^2 of the five parameters' errors is that of five numbers."""
    true = TransitModel.from_orbit(3, 1, 0.1, a=9, b=0.4, u1=0.4, u2=0.3, exposure_time=0.0204)
    time = np.arange(2000) * LONG_CADENCE
    fixed = {"ecc": True, "omega": True, "u1": True, "u2": True}
    start = TransitModel(
        3.002, 0.99, 0.09, 8, 87, 0, 90, 0.4, 0.3, exposure_time=0.0204, fixed=fixed
    )
    flux = true(time) + np.random.default_rng(8).normal(0, 1e-4, size=time.size)
    fitter = TRFLSQFitter(calc_uncertainties=True)
    fit = fitter(start, time, flux, weights=np.full(time.size, 1e4))
    names = fit.cov_matrix.param_names
    assert names == ["period", "t0", "rp", "a", "inc"]
    offset = [getattr(fit, name).value - getattr(true, name).value for name in names]
    chi2 = offset @ np.linalg.solve(fit.cov_matrix.cov_matrix, offset)
    assert 0.4 < chi2 < 15.1  # the 0.5 and 99 % points
    assert fit.exposure_time == 0.0204


def test_units():
    plain = TransitModel(3, 1, 0.1, 9, 88, 0.1, 60, 0.4, 0.3, exposure_time=0.02)
    units = TransitModel(
        72 * u.hour,
        1 * u.day,
        0.1,
        9,
        np.radians(88) * u.rad,
        0.1,
        60 * u.deg,
        0.4,
        0.3,
        exposure_time=0.48 * u.hour,
    )
    time = np.array([0.9, 1.0, 4.05])
    assert_allclose(units(time * u.day), plain(time), rtol=1e-12)
    assert_allclose(plain(time * 24 * u.hour), plain(time), rtol=1e-12)


def _pickled(model):
    return pickle.loads(pickle.dumps(model))  # noqa: S301 (our own bytes)


def test_copies_and_compounds_keep_the_exposure_time():
    planet = TransitModel(3, 1, 0.1, 9, exposure_time=0.02)
    time = np.linspace(0.9, 1.1, 21)
    for other in (planet.copy(), copy.deepcopy(planet), _pickled(planet)):
        assert_allclose(other(time), planet(time), rtol=0)
    spots = sinusoidal_signal(0.01, 2)
    compound = planet * spots * TransitModel(7, 1, 0.05, 15)
    expected = planet(time) * spots(time) * TransitModel(7, 1, 0.05, 15)(time)
    assert_allclose(compound(time), expected, rtol=1e-14)


def test_shapes_and_missing_times():
    planet = TransitModel(3, 1, 0.1, 9)
    assert np.shape(planet(1.0)) == ()
    assert planet(np.ones((2, 3))).shape == (2, 3)
    assert np.isnan(planet(np.array([1.0, np.nan]))).tolist() == [False, True]
    assert planet(np.array([])).shape == (0,)


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda: TransitModel(period=0), "`period` must be positive, got 0"),
        (lambda: TransitModel(inc=np.nan), "`inc` must be finite, got nan"),
        (lambda: TransitModel(t0=np.inf), "`t0` must be finite, got inf"),
        (lambda: TransitModel(a=-1), "`a` must be positive, got -1"),
        (lambda: TransitModel(rp=-0.1), "`rp` must be at least 0, got -0.1"),
        (lambda: TransitModel(ecc=1), "`ecc` must be at least 0 and below 1, got 1"),
        (lambda: TransitModel(exposure_time=-1), "`exposure_time` must not be negative, got -1"),
        (lambda: TransitModel(period=[1, 2]), "parameters of a TransitModel must be scalars"),
        (lambda: TransitModel.from_depth_duration(0, 0.1, 3), "`depth` must be between 0 and 1"),
        (lambda: TransitModel.from_depth_duration(1, 0.1, 3), "`depth` must be between 0 and 1"),
        (lambda: TransitModel.from_depth_duration(0.1, 0, 3), "`duration` must be above 0"),
        (lambda: TransitModel.from_depth_duration(0.1, 0.1, 0), "`period` must be positive"),
        (lambda: TransitModel.from_depth_duration(0.1, 0.1, 3, b=1), "`b` must be at least 0"),
        (lambda: TransitModel.from_orbit(3), "exactly one of `a` and `density`"),
        (lambda: TransitModel.from_orbit(3, a=9, density=1), "exactly one of `a` and `density`"),
        (lambda: TransitModel.from_orbit(3, a=9, inc=89, b=0.1), "only one of `inc` and `b`"),
        (lambda: TransitModel.from_orbit(3, density=-1), "`density` must be positive"),
        (lambda: TransitModel.from_orbit(3, a=9, b=10), "`b` must be at least 0 and within"),
        (lambda: sinusoidal_signal(1.5, 2), "`amplitude` must be at least 0 and below 1, got 1.5"),
        (lambda: sinusoidal_signal(0.1, 0), "`period` must be positive, got 0"),
        (lambda: tabulated_signal([0, 0], [1, 1]), "`time` must be one-dimensional and increasing"),
        (lambda: tabulated_signal([0, 1], [1]), r"`flux` must have the shape \(2,\)"),
        (lambda: tabulated_signal([0, 1], [1, np.nan]), "`flux` must be finite"),
        (lambda: tabulated_signal([0, 1], [1, -1]), "`flux` must be finite and not negative"),
        (lambda: stochastic_signal([0, 1], 0), "`cdpp` must be positive, got 0"),
        (lambda: stochastic_signal([0, 1], 5, timescale=-1), "`timescale` must be positive"),
        (lambda: stochastic_signal([1, 0], 5), "`time` must be one-dimensional and increasing"),
    ],
)
def test_bad_input(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_sinusoidal_signal():
    signal = sinusoidal_signal(0.02, 4.0, phase=0.25)
    time = np.linspace(0, 8, 33)
    assert_allclose(signal(time), 1 + 0.02 * np.cos(2 * np.pi * time / 4), rtol=1e-14)


def test_tabulated_signal():
    signal = tabulated_signal([1, 2, 4], [1.0, 0.5, 0.9])
    assert_allclose(signal([0, 1, 1.5, 3, 4, 9]), [1, 1, 0.75, 0.7, 0.9, 0.9], rtol=1e-12)
    assert_allclose((signal * signal)(2.0), 0.25, rtol=1e-12)


@pytest.mark.parametrize("quality", [0.5**0.5, 5.0])
@pytest.mark.parametrize("timescale", [0.05, 0.25, 2.0])
def test_stochastic_signal_has_the_stated_cdpp(timescale, quality):
    """Mean CDPP of sixty draws: filter edges and clipping make up to 3 %, the draws 1 %."""
    time = np.arange(4000) * LONG_CADENCE
    kwargs = {"timescale": timescale, "quality": quality}
    draws = [stochastic_signal(time, 50, seed=i, **kwargs)(time) for i in range(60)]
    assert_allclose(np.mean(cdpp(draws)), 50, rtol=0.05)


def test_time_with_a_zero_of_its_own_is_refused():
    planet = TransitModel(period=3, t0=1)
    with pytest.raises(TypeError, match=r"days with the zero of `t0`, as `time.value`, got a"):
        planet(Time([2454834.0, 2454835.0], format="jd", scale="tdb"))


def test_stochastic_signal_on_short_cadences_and_other_durations():
    time = np.arange(6000) * 120 / 86400
    signals = [stochastic_signal(time, 200, duration=2, seed=i)(time) for i in range(12)]
    values = cdpp(np.array(signals), duration=2, cadence=120 / 86400)
    assert_allclose(np.mean(values), 200, rtol=0.1)


def test_stochastic_signal_is_seeded():
    time = np.arange(300) * LONG_CADENCE
    one = stochastic_signal(time, 50, seed=1)(time)
    assert_allclose(stochastic_signal(time, 50, seed=1)(time), one, rtol=0)
    assert np.std(stochastic_signal(time, 50, seed=2)(time) - one) > 1e-6
    assert_allclose(stochastic_signal(time, 100, seed=1)(time) - 1, 2 * (one - 1), atol=1e-12)
    assert abs(one.mean() - 1) < 1e-3
