"""One PRF of all stars of a stamp, learned from their pixels."""

import numpy as np
import pytest
from scipy.special import erf

from scope_models.correctors._neighbors import WIDTH, Crowd, CrowdPixels, learn, track
from scope_models.models import PRF, BivariateGaussianPSF

SHAPE, N = (9, 11), 300
AWAY, FLUX = np.array([2.6, 1.1]), 6000.0
TIME = np.arange(N) / 49
LIGHT = 20_000 * (1 + 0.2 * np.sin(2 * np.pi * TIME / 0.6))
X, Y = 4.1 + 0.3 * (TIME / 0.25 % 1), 4.2 + 0.2 * (TIME / 0.25 % 1)
WIDER = 0.004 * np.sin(2 * np.pi * TIME / 5)


def image(x, y, wider=0.0):
    """Return pixels of unit flux of a PSF with a skirt on one side, ``(n, ny, nx)``."""
    total = 0.0
    for part, away, sigma in ((0.6, 0.0, 0.55), (0.25, 0.35, 0.9), (0.15, -0.2, 1.3)):
        axes = []
        for size, center in zip(SHAPE, (y, x + away), strict=True):
            edges = np.arange(size + 1) - 0.5 - np.asarray(center)[:, None]
            edges = erf(edges / (np.sqrt(2) * sigma * (1 + np.broadcast_to(wider, N)[:, None])))
            axes.append(np.diff(edges, axis=1) / 2)
        total = total + part * axes[0][:, :, None] * axes[1][:, None, :]
    return total


@pytest.fixture(scope="module")
def found():
    rng = np.random.default_rng(1)
    gains = 1 + 0.01 * rng.standard_normal(SHAPE)
    neighbor = FLUX * gains * image(X + AWAY[0], Y + AWAY[1], WIDER)
    flux = LIGHT[:, None, None] * gains * image(X, Y, WIDER) + neighbor + 30
    error = np.sqrt(flux / 1600 + 4)
    flux = flux + error * rng.standard_normal(flux.shape)
    expected = np.column_stack([np.full(N, 2e4), X, Y, np.zeros(N), np.zeros(N)])
    expected[:, 1:3] += 0.007 * rng.standard_normal((N, 2))
    sigma = np.broadcast_to([2e4, 0.02, 0.02, WIDTH, 2e4], expected.shape)
    pixels = CrowdPixels(flux, error, expected, sigma)
    first = BivariateGaussianPSF(0.7, 0, 0, 0.55, 0.55) + BivariateGaussianPSF(0.3, 0, 0, 1.1, 1.1)
    guess = Crowd.first(
        PRF(first, flux=1, x_0=0, y_0=0), SHAPE, np.array([0.8 * FLUX]), AWAY[None] + 0.1
    )
    crowd = learn(guess, pixels[::3])
    return crowd, *track(crowd, pixels), neighbor


def test_light_of_the_neighbor(found):
    crowd, _, light, neighbor = found
    total, _ = crowd.sum_and_center()
    assert total * crowd.fluxes[0] == pytest.approx(FLUX, rel=0.01)
    near = neighbor > 0.02 * neighbor.max()
    assert abs((light - neighbor)[near].sum() / neighbor[near].sum()) < 0.005
    assert np.std((light - neighbor)[near]) < 0.002 * neighbor.max()


def test_brightness_widths_and_positions_of_all_cadences(found):
    _, states, _, _ = found
    slope = np.polyfit(LIGHT / LIGHT.mean(), states[:, 0] / states[:, 0].mean(), 1)[0]
    assert slope == pytest.approx(1, abs=0.002)
    for k, true in ((1, X), (2, Y)):
        assert np.std(states[:, k] - true) < 1.5e-3  # that of what was expected is 7e-3
    assert np.corrcoef(states[:, 3], WIDER)[0, 1] > 0.95
    assert np.std(states[:, 3] - WIDER) < 1e-3


def test_a_narrow_prf_has_no_change_far_from_the_star():
    """Integrals of its wings are rounding errors, which may be negative."""
    prf = PRF(BivariateGaussianPSF(1, 0, 0, 0.1, 0.3, -0.5), flux=1, x_0=0, y_0=0)
    assert prf.unit_images((1, 1), 1.0, 2.0) < 0
    crowd = Crowd.first(prf, SHAPE, np.array([1.0]), AWAY[None])
    sizes = crowd.sizes()[: crowd.change.size]
    assert (sizes >= 0).all()
    assert sizes.max() > 1e-3
