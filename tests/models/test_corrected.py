"""Tables of PRFs times a smooth correction: known distortions come back."""

import numpy as np
import pytest

from scope_models import PRF, BivariateGaussianPSF, Detector, Motion, Star, fit_tpf, simulate
from scope_models.models import CorrectedPRF, TabulatedPRF

DETECTOR = Detector.k2(shape=(9, 9), sensitivity=None, interpixel_scatter=0)
TRUTH = {"c_2_0": 0.1, "c_1_1": -0.06, "c_0_2": 0.04, "c_2_1": 0.05}


def samples_of(sigma):
    y, x = np.mgrid[-40:41, -40:41] / 8
    return PRF(BivariateGaussianPSF(sigma_x=sigma, sigma_y=sigma))(x, y)


def observed(psf, mag=12.0):
    star = Star(mag, 4.2, 3.8, psf=psf)
    return simulate(star, DETECTOR, 2 * Motion.k2_roll(40), seed=1)


def test_sum_is_that_of_the_table():
    samples = samples_of(0.6)
    corrected = CorrectedPRF(samples, 8, order=3, **TRUTH).corrected_table()
    assert corrected.array.sum() == pytest.approx(samples.sum(), rel=1e-12)
    assert np.abs(corrected.array / samples - 1)[40, 50:60].max() > 0.02


def test_known_distortion_is_fitted():
    samples = samples_of(0.6)
    observation = observed(CorrectedPRF(samples, 8, order=3, **TRUTH))
    tpf = observation.to_tpf()
    fit = fit_tpf(tpf, PRF(TabulatedPRF(samples, 8)), empirical=3, interpixel=0)
    assert fit.converged
    assert abs(fit.reduced_chi2 - 1) < 5 * np.sqrt(2 / fit.dof)
    for name, value in fit.values.items():
        assert abs(value - TRUTH.get(name, 0.0)) < 4 * fit.errors[name], name
    used = np.isin(observation.cadenceno, fit.cadenceno)
    assert np.median(fit.flux) == pytest.approx(observation.truth.flux[0], rel=0.01)
    assert np.abs((fit.x - observation.truth.x[0, used]) / fit.x_err).max() < 5
    twin = simulate(fit.scene(signal="fitted"), noise=False)
    expected = fit.fitted - fit.background[:, None, None]
    np.testing.assert_allclose(twin.flux, expected, rtol=1e-5, atol=1e-2)


def test_table_of_another_width_is_corrected(tmp_path):
    """The correction describes what no term of it is, and survives a file."""
    tpf = observed(BivariateGaussianPSF(sigma_x=0.62, sigma_y=0.6), mag=13.0).to_tpf()
    table = TabulatedPRF(samples_of(0.6), 8)
    with pytest.warns(UserWarning, match="does not describe"):
        plain = fit_tpf(tpf, table, interpixel=0)
    fit = fit_tpf(tpf, table, empirical=4, interpixel=0)
    assert plain.reduced_chi2 > 100
    assert fit.reduced_chi2 < 1.5
    again = type(fit).read(fit.write(tmp_path / "fit.fits"))
    np.testing.assert_allclose(again.model.render((9, 9)), fit.model.render((9, 9)), rtol=1e-12)


def test_an_empirical_term_needs_a_table_or_a_density():
    prf = PRF(BivariateGaussianPSF())
    with pytest.raises(ValueError, match="`empirical` must be left out"):
        fit_tpf(observed(None).to_tpf(), prf, empirical=2)
