"""Target pixel files with known truth, made without the package's simulator."""

from dataclasses import dataclass

import numpy as np
import pytest
from lightkurve import KeplerTargetPixelFile
from scipy.special import erf

from scope_models.correctors import PLDCorrector
from scope_models.io import TPFMetadata
from scope_models.io.tpf import make_tpf_hdulist
from scope_models.photometry import cdpp

EXPOSURE = 1625.347  # s, Kepler long cadence
BACKGROUND = 166.0  # e-/s per pixel
READ_NOISE = 90 * np.sqrt(270)  # e- per cadence


@dataclass(frozen=True)
class FakeStar:
    """A target pixel file, and what it was made of."""

    tpf: KeplerTargetPixelFile
    expected: np.ndarray  # e-/s without noise
    noise: np.ndarray  # e-/s
    signal: np.ndarray  # true relative flux

    def floor(self, corrector, method="lightkurve"):
        """Return the CDPP of the noise alone in a corrector's aperture, for a constant star."""
        mask = corrector.aperture_mask
        level = self.expected[:, mask].sum(axis=1).mean()
        return cdpp(level + self.noise[:, mask].sum(axis=1), method=method)


def roll(n, seed, *, amplitude=0.3, drift=0.1):
    """Return a sawtooth of 12 cadences with a slow drift across it, in pixels."""
    rng = np.random.default_rng(seed)
    t = np.arange(n)
    phase = (t % 12) / 12 - 0.5
    heights = amplitude * rng.uniform(0.6, 1.2, n // 12 + 1)[t // 12]
    x = heights * phase + rng.normal(0, 0.005, n)
    return x, 0.4 * x + drift * np.sin(2 * np.pi * t / (0.9 * n))


def pixel_integrals(x_0, sigma, n, a_2):
    """Integrals over pixels of a normal density times (1 + a_2 u^2), by error functions."""
    centers = np.arange(n)
    low, high = centers - 0.5 - x_0[:, None], centers + 0.5 - x_0[:, None]
    d = centers - x_0[:, None]
    i_0 = 0.5 * (erf(high / sigma / 2**0.5) - erf(low / sigma / 2**0.5))

    def density(v):
        return np.exp(-0.5 * (v / sigma) ** 2) / np.sqrt(2 * np.pi) / sigma

    i_1 = -(sigma**2) * (density(high) - density(low))
    i_2 = sigma**2 * (i_0 - high * density(high) + low * density(low))
    return i_0 + a_2 * (i_2 - 2 * d * i_1 + d**2 * i_0)


def make_fake_star(
    n=400, mag=12.0, seed=0, signal=None, scatter=0.01, shape=(9, 9), motion=1.0, noisy=True,
    width=0.5, neighbor=0.0,
):  # fmt: skip
    """A neighbor has this part of the star's light, 2.9 px to the right."""
    rng = np.random.default_rng(seed)
    x, y = roll(n, seed)
    ny, nx = shape
    rate = 1.74e5 * 10 ** (-0.4 * (mag - 12))
    signal = np.ones(n) if signal is None else signal
    along = pixel_integrals(motion * y + ny // 2 + 0.1, width, ny, -0.05)[:, :, None]
    across, beside = (
        pixel_integrals(motion * x + nx // 2 - 0.1 + shift, width, nx, -0.05)[:, None, :]
        for shift in (0, 2.9)
    )
    expected = rate * along * (across * signal[:, None, None] + neighbor * beside)
    expected *= 1 + scatter * rng.standard_normal(shape)
    sigma = np.sqrt(expected * EXPOSURE + BACKGROUND * EXPOSURE + READ_NOISE**2) / EXPOSURE
    noise = sigma * rng.standard_normal(expected.shape) * noisy
    metadata = TPFMetadata(
        mission="K2", target_id=7, pixel_scale=3.98, int_time=6.019802903270,
        read_time=0.518948526144, n_frames=270, campaign=3, column=100, row=200,
    )  # fmt: skip
    hdus = make_tpf_hdulist(
        metadata=metadata, time=2144.1 + 0.0204336 * np.arange(n),
        cadenceno=np.arange(1, n + 1), raw_cnts=None, flux=expected + noise, flux_err=sigma,
        flux_bkg=BACKGROUND, flux_bkg_err=0.1, quality=np.zeros(n, dtype=int),
        pos_corr1=motion * x, pos_corr2=motion * y,
    )  # fmt: skip
    return FakeStar(KeplerTargetPixelFile(hdus), expected, noise, signal)


@pytest.fixture(scope="session")
def fake_star():
    """Return the maker of target pixel files."""
    return make_fake_star


@pytest.fixture(scope="session")
def star():
    """Return a star of 12th magnitude with 400 cadences; do not change it."""
    return make_fake_star()


@pytest.fixture(scope="session")
def corrected(star):
    """Return the corrector of the star after its default call; do not call it again."""
    corrector = PLDCorrector(star.tpf)
    corrector.correct()
    return corrector
