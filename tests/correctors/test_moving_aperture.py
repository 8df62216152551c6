"""Tests of correctors with an aperture that follows the star."""

import numpy as np
import pytest

from scope_models.benchmark import make_sky, score
from scope_models.correctors import PLDCorrector
from scope_models.photometry import aperture_flux, moving_aperture


def window(tpf, center, radius):
    """Return weights about the star, which POS_CORR follows."""
    x, y = (
        c + np.where(np.abs(p) < 20, p, np.nan)
        for c, p in zip(center, (tpf.pos_corr1, tpf.pos_corr2), strict=True)
    )
    return moving_aperture(tpf.shape[1:], x, y, radius)


def test_raw_light_curve_is_the_weighted_sum(star):
    weights = window(star.tpf, (3.9, 4.1), 2.5)
    corrector = PLDCorrector(star.tpf, aperture_mask=weights)
    expected = np.sum(weights * star.tpf.flux.value, axis=(1, 2))
    np.testing.assert_allclose(corrector.original_lc.flux.value, expected, rtol=1e-6)
    assert corrector.aperture_mask.shape == star.tpf.shape[1:]
    for bad in (weights[:-1], -weights):
        with pytest.raises(ValueError, match="`aperture_mask` must be"):
            PLDCorrector(star.tpf, aperture_mask=bad)


@pytest.mark.slow
def test_less_noise_where_a_faint_star_moves_far():
    sky = make_sky("k2-5x-kp15", 2)
    tpf = sky.to_tpf()
    weights = window(tpf, (np.median(sky.x), np.median(sky.y)), 2.0)
    raw, error = aperture_flux(tpf.flux.value, weights, tpf.flux_err.value)
    fixed = sky.floor()
    assert np.nanmedian(error / raw) < 0.8 * fixed
    corrector = PLDCorrector(tpf, aperture_mask=weights)
    found = score(corrector.correct(), sky)
    assert found.high_passed < 0.8
    assert found.full < 0.7 * score(corrector.original_lc, sky).full
