"""Light curves of pixels that are hardly light: finite or NaN, and counted."""

import warnings

import numpy as np
import pytest

from scope_models import Detector, Motion, Star, simulate
from scope_models.correctors import PLDCorrector
from scope_models.correctors._files import make_lightcurve_hdulist
from scope_models.exceptions import DetrendingWarning
from scope_models.pixelmodel._pixels import credible_flux


def test_what_is_no_correction_is_the_typical_one():
    total = np.array([1.0] * 10 + [2.0] * 4 + [np.nan])
    flux = np.array([1.1] * 10 + [np.inf, 9e22, np.nan, -0.5, np.nan])
    outliers = np.zeros(15, dtype=bool)
    with pytest.warns(DetrendingWarning, match="4 of 14 cadences get the typical correction"):
        kept, errors = credible_flux(flux, np.full(15, 0.1), total, outliers)
    np.testing.assert_allclose(kept, [1.1] * 10 + [2.2] * 4 + [np.nan])
    np.testing.assert_allclose(errors, [0.1] * 10 + [2.2] * 4 + [np.nan])


def test_many_outliers_are_a_warning():
    total = np.ones(10)
    with pytest.warns(DetrendingWarning, match="6 of 10 cadences were left out of the fit"):
        flux, _ = credible_flux(total, total, total, np.arange(10) < 6)
    assert np.array_equal(flux, total)


@pytest.mark.parametrize("excess", [1045, 1056, 1060])
@pytest.mark.parametrize("order", [1, 2])
def test_over_subtracted_background(excess, order):
    """A background that is taken off twice leaves sums of nearly nothing."""
    detector = Detector.k2(shape=(9, 9))
    observation = simulate(Star(17.5), detector, Motion.k2_roll(300), seed=1)
    tpf = observation.to_tpf()
    tpf.hdu[1].data["FLUX"] -= excess / 81
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DetrendingWarning)
        corrector = PLDCorrector(tpf, aperture_mask=np.ones((9, 9), dtype=bool))
        lc = corrector.correct(order=order)
    flux, total = lc.flux.value, corrector.original_lc.flux.value
    assert not np.isinf(flux).any()
    known = np.isfinite(flux)
    ratio = flux[known] / total[known]
    assert np.abs(np.log(ratio / np.median(ratio))).max() < np.log(31)
    width = make_lightcurve_hdulist(corrector)[1].data["WIDTH"]  # of cadences without light, too
    if corrector.model.clean is None:  # where the model fails depends on libraries
        with pytest.raises(ValueError, match="there are no states"):
            corrector.result.plot_states()
        assert np.isnan(width).all()
    else:
        assert "Relative width" in corrector.result.plot_states()
        assert np.isfinite(width).sum() >= known.sum()


def test_one_cadence():
    tpf = simulate(Star(12.0), Detector.k2(), Motion.still(5), seed=1).to_tpf()[:1]
    with pytest.raises(ValueError, match="`tpf` has 1 cadences: at least 3 are needed"):
        PLDCorrector(tpf)
