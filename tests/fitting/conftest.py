"""Simulated target pixel files whose truth is known."""

import pytest

from scope_models import (
    BivariateGaussianPSF,
    Detector,
    Motion,
    SensitivityPolynomial,
    Star,
    fit_tpf,
    simulate,
)


@pytest.fixture(scope="session")
def psf():
    """Return a PSF of two components."""
    return BivariateGaussianPSF(0.75, 0, 0, 0.5, 0.45, 0.15) + BivariateGaussianPSF(
        0.25, 0.1, -0.05, 1.1, 1.2, -0.1
    )


@pytest.fixture(scope="session")
def curvature():
    """Return the sensitivity to fit: quadratic, even along both axes."""
    return SensitivityPolynomial(fixed={"ax1": True, "ay1": True})


@pytest.fixture(scope="session")
def observation(psf):
    """Return an observation with five times the motion of K2."""
    detector = Detector.k2(shape=(9, 9), interpixel_distribution="normal")
    star = Star(12.0, 4.2, 3.8, psf=psf)
    return simulate(star, detector, 5 * Motion.k2_roll(300), seed=3)


@pytest.fixture(scope="session")
def default(observation):
    """Return the fit of the observation without arguments."""
    return fit_tpf(observation.to_tpf())


@pytest.fixture(scope="session")
def fit(observation, curvature):
    """Return the fit of all that made the observation."""
    return fit_tpf(observation.to_tpf(), psf=2, sensitivity=curvature)
