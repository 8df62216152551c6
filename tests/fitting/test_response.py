"""The response of each pixel: messy stars, the twin, files, bad input, real pixels."""

import warnings

import numpy as np
import pytest

from scope_models import (
    BivariateGaussianPSF,
    Detector,
    Motion,
    PLDCorrector,
    Star,
    TPFFit,
    fit_tpf,
    simulate,
)
from scope_models.benchmark import SkyRegime, make_sky
from scope_models.effects import PixelShares
from scope_models.effects.light import polynomial_terms, polynomials
from scope_models.exceptions import FitWarning
from scope_models.fitting import FitOptions, _response
from scope_models.photometry import cdpp

# A PSF of many parts, random response within the pixels, focus: another renderer than ours.
FAINT = SkyRegime("faint", magnitude=16.0, shape=(6, 6))


def fitted(pixels, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FitWarning)
        return fit_tpf(pixels, response="pixels", **options)


@pytest.fixture(scope="module")
def sky():
    return make_sky(FAINT, seed=5, n_cadences=400)


@pytest.fixture(scope="module")
def fit(sky):
    return fitted(sky.to_tpf())


def test_messy_pixels_are_described(sky, fit):
    assert fit.converged
    assert 0.95 < fit.reduced_chi2 < 1.12
    assert abs(fit.chi2_held_out / fit.reduced_chi2 - 1) < 0.03
    assert fit.held_out.sum() == len(fit.time) // 10
    # A PSF alone does not describe them.
    held = {"positions": "prior", "interpixel": 0.0}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FitWarning)
        assert fit_tpf(sky.to_tpf(), psf=1, **held).reduced_chi2 > 10 * fit.reduced_chi2


def test_default_follows_from_the_pixels(sky, fit, default):
    """Pixels that no PSF describes get their own responses, unless something else is given."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FitWarning)
        messy = fit_tpf(sky.to_tpf())
        few = fit_tpf(sky.to_tpf()[:99], options=FitOptions(max_steps=1))
        given = fit_tpf(sky.to_tpf()[:120], interpixel=0.0, options=FitOptions(max_steps=1))
    np.testing.assert_array_equal(messy.flux, fit.flux)
    assert messy.response
    assert not few.response
    assert not given.response
    assert not default.response


def test_the_steps_are_bounded_by_their_work(sky, fit, monkeypatch):
    """Of large stamps and long series: fewer terms and steps, and a warning."""
    monkeypatch.setattr(_response, "_MOST_WORK", 1e6)
    monkeypatch.setattr(_response, "_TRIAL_STEPS", 2)  # with four, it converges
    with pytest.warns(FitWarning, match="has not converged after"):
        bounded = fit_tpf(sky.to_tpf(), response="pixels")
    assert bounded.n_steps < fit.n_steps
    assert len(bounded.response[0].coefficients) == len(polynomial_terms(1, 1))
    assert np.isfinite(bounded.flux).all()


def test_flux_and_positions(sky, fit):
    """Positions are right but for their gauge: smooth functions of the position."""
    index = np.searchsorted(sky.cadenceno, fit.cadenceno)
    x, y, t = (v - v.mean() for v in (sky.x[index], sky.y[index], fit.time))
    powers = [(i, j, k) for i in range(4) for j in range(4 - i) for k in range(4 - i - j)]
    gauge = np.column_stack([x**i * y**j * t**k for i, j, k in powers])
    gauge /= np.linalg.norm(gauge, axis=0)
    flux, good = fit.flux / sky.true_flux[index], ~fit.outliers
    pull = (flux / np.median(flux) - 1) / (fit.flux_scatter / fit.flux)
    assert 0.9 < pull[good].std() < 1.1
    for found, error in ((fit.x, fit.x_err), (fit.y, fit.y_err)):
        rest = found - gauge @ np.linalg.lstsq(gauge, found, rcond=None)[0]
        rest /= error * np.sqrt(1 - len(powers) / len(index))
        assert 0.85 < 1.4826 * np.median(np.abs(rest)) < 1.2
    assert min(fit.path_scale()) > 0.9
    assert max(fit.path_scale()) < 1.1


def test_errors_of_the_flux_hold_what_the_gauge_fixes(sky, fit):
    """A change that all pixels share is no part of the model: its prior is part of the errors."""
    index = np.searchsorted(sky.cadenceno, fit.cadenceno)
    relative = fit.flux / sky.true_flux[index]
    deviation = np.abs(relative / np.median(relative) - 1)
    assert np.all(fit.flux_err > fit.flux_scatter)
    assert np.quantile(deviation / (fit.flux_err / fit.flux), 0.95) < 0.4  # 0.13


def deviations(fit, truth):
    """Relative flux less the truth, without outliers, and the light curve's typical error."""
    good, lc = ~fit.outliers, fit.to_lightcurve()
    relative = fit.flux / truth
    error = np.median(lc.flux_err.value / lc.flux.value)
    return (relative / np.median(relative[good]) - 1)[good], error


@pytest.mark.parametrize("seed", [2002, pytest.param(2005, marks=pytest.mark.slow)])
def test_a_light_curve_does_not_follow_the_motion(seed):
    """The sum of the pixels does, at 3 to 5 times its errors."""
    sky = make_sky("k2-1x-kp14", seed)
    tpf = sky.to_tpf()[:400]
    fit = fitted(tpf)
    index = np.searchsorted(sky.cadenceno, fit.cadenceno)
    found, error = deviations(fit, sky.true_flux[index])
    assert 0.8 * error < found.std() < 1.4 * error  # 1.2
    light = np.nansum(fit.observed[:, sky.aperture], axis=1)[~fit.outliers]
    light = light / sky.true_flux[index][~fit.outliers]
    assert found.std() < 0.6 * light.std() / light.mean()
    assert np.abs(np.corrcoef(found, fit.x[~fit.outliers])[0, 1]) < 0.3


@pytest.mark.parametrize(
    ("star", "amplitude", "period"),
    [("rr_lyrae", 0.1, 0.5), pytest.param("sine", 0.005, 10.0, marks=pytest.mark.slow)],
)
def test_variability_stays_in_the_flux(star, amplitude, period):
    regime = SkyRegime("variable", magnitude=13.0, star=star, amplitude=amplitude, period=period)
    sky = make_sky(regime, seed=10, n_cadences=600)
    fit = fitted(sky.to_tpf())
    truth = sky.true_flux[np.searchsorted(sky.cadenceno, fit.cadenceno)]
    good, truth = ~fit.outliers, truth / np.median(truth)
    slope, _ = np.polyfit(truth[good], fit.flux[good] / np.median(fit.flux[good]), 1)
    assert abs(slope - 1) < 0.05
    found, error = deviations(fit, truth)
    assert found.std() < 2 * error


@pytest.mark.parametrize(
    ("name", "positions"),
    [("k2-1x-rr-lyrae", "none"), pytest.param("tess-constant", "wrong", marks=pytest.mark.slow)],
)
def test_flux_is_that_of_the_correction(name, positions):
    """One model of the pixels serves both."""
    tpf = make_sky(name, seed=78, n_cadences=400, positions=positions).to_tpf()
    fit, curve = fitted(tpf), PLDCorrector(tpf).correct()
    _, mine, its = np.intersect1d(fit.cadenceno, curve.cadenceno.value, return_indices=True)
    assert len(mine) > 300
    error, ratio = (fit.flux_scatter / fit.flux)[mine], fit.flux[mine] / curve.flux.value[its]
    assert np.all(np.abs(ratio / np.median(ratio) - 1) < 0.05 * error)
    # those of a light curve also have other stars' light
    assert np.all(error < 1.001 * (curve.flux_err.value / curve.flux.value)[its])


@pytest.mark.parametrize(
    ("star", "amplitude", "period", "positions"),
    [
        ("rr_lyrae", 0.1, 0.5, "wrong"),  # as those of real files
        ("eclipsing", 0.2, 1.7, "none"),
        pytest.param("eclipsing", 0.2, 1.7, "wrong", marks=pytest.mark.slow),
        pytest.param("rr_lyrae", 0.1, 0.5, "none", marks=pytest.mark.slow),
    ],
)
def test_variability_beside_a_star_that_is_not_fitted(star, amplitude, period, positions):
    """Positions follow the star there: they must not explain it."""
    variable = {"star": star, "amplitude": amplitude, "period": period}
    regime = SkyRegime("blend", magnitude=13.0, neighbors=((1.0, 3.0, 0.0),), **variable)
    sky = make_sky(regime, seed=77, n_cadences=400, positions=positions)
    fit = fitted(sky.to_tpf())
    truth = sky.true_flux[np.searchsorted(sky.cadenceno, fit.cadenceno)]
    good, truth = ~fit.outliers, truth / np.median(truth)
    slope, _ = np.polyfit(truth[good], fit.flux[good] / np.median(fit.flux[good]), 1)
    assert 0.7 < slope < 1.01  # its part of all light is 0.715, in its own pixels it is more


@pytest.mark.parametrize(
    ("place", "mag"), [((7.2, 6.1), 13.0), pytest.param((6.3, 6.2), 12.3, marks=pytest.mark.slow)]
)
def test_fluxes_of_a_pair_do_not_follow_the_motion(place, mag):
    time = np.arange(300) / 48.94
    signals = 1 + 0.01 * np.sin(2 * np.pi * time / 3.3), 1 + 0.02 * np.cos(2 * np.pi * time / 0.7)
    places = [(5.0, 5.0), place]
    stars = [Star(13.0, 5.0, 5.0, signal=signals[0]), Star(mag, *place, signal=signals[1])]
    observation = simulate(stars, Detector.k2(shape=(11, 11)), Motion.k2_roll(300, seed=4), seed=3)
    fit = fitted(observation.to_tpf(), stars=places)
    used = np.isin(observation.cadenceno, fit.cadenceno)
    assert fit.converged
    found, error = deviations(fit, signals[0][used])
    assert found.std() < 1.4 * error
    ratio = np.median(fit.neighbors[0].flux / fit.flux)
    assert abs(ratio / 10 ** (0.4 * (13 - mag)) - 1) < 0.02
    other = fit.neighbors[0].flux / signals[1][used]
    assert other.std() / other.mean() < 1.6 * error


def test_the_flux_of_a_star_at_rest_is_that_of_its_psf():
    tpf = simulate(Star(13.0), Detector.k2(shape=(6, 6)), Motion.still(60), seed=1).to_tpf()
    fit = fitted(tpf, psf=1)
    found, error = deviations(fit, 1.0)
    assert 0.7 * error < found.std() < 1.3 * error


def test_sum_of_shares_and_background(fit):
    """No part of the model is common to all pixels: sums are those of PSF and background."""
    light = (
        np.nansum(fit.fitted, axis=(1, 2)) - np.isfinite(fit.fitted).sum((1, 2)) * fit.background
    )
    expected = fit.flux * fit.model.unit_images(fit.shape, fit.x, fit.y).sum(axis=(1, 2))
    full = np.isfinite(fit.fitted).all(axis=(1, 2))
    np.testing.assert_allclose(light[full], expected[full], rtol=0.03)


def test_the_twin_has_the_shares(fit):
    scene = fit.scene(signal="fitted").replace(noise=())
    assert any(isinstance(effect, PixelShares) for effect in scene.effects)
    model = simulate(scene).model() + fit.scene().effects[-1].left[:, None, None]
    inside = np.isfinite(fit.fitted)
    # Negative shares are zero there, and positions and backgrounds have less noise.
    difference = (model - fit.fitted)[inside] / fit.observed_err[inside]
    assert np.std(difference) < 0.5


def test_the_twin_scatters_as_the_star(sky, fit):
    twin = simulate(fit.scene().replace(seed=3))
    observed = np.where(np.isfinite(fit.observed), fit.observed, fit.fitted)
    good = ~fit.outliers
    for aperture in (sky.aperture, np.ones(fit.shape, dtype=bool)):
        real, again = (np.sum(cube[good][:, aperture], axis=1) for cube in (observed, twin.flux))
        assert abs(cdpp(again) / cdpp(real) - 1) < 0.2


def test_files(fit, tmp_path):
    again = TPFFit.read(fit.write(tmp_path / "fit.fits"))
    assert again.response == fit.response
    assert again.chi2_held_out == fit.chi2_held_out
    np.testing.assert_array_equal(again.held_out, fit.held_out)
    np.testing.assert_array_equal(again.outliers, fit.outliers)
    assert again.scene() == fit.scene()
    assert "held-out cadences" in again.summary()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"response": "pixel"}, "`response` must be one of auto, psf, pixels"),
        ({"interpixel": 0.01}, "`interpixel` must be left out with response"),
        ({"options": FitOptions(focus=2.0)}, "`focus` must be left out with response"),
    ],
)
def test_bad_options(sky, options, message):
    with pytest.raises(ValueError, match=message):
        fit_tpf(sky.to_tpf(), **{"response": "pixels", **options})


def test_too_few_cadences_for_a_correction():
    """The light is the sum of pixels, which no convention of the shares moves."""
    star, motion = Star(12.0, 4.0, 4.0), Motion.k2_roll(300, seed=4)
    tpf = simulate(star, Detector.k2(shape=(9, 9)), motion, seed=1).to_tpf()[:24]
    with pytest.warns(FitWarning, match="too few cadences or pixels to correct"):
        fit = fit_tpf(tpf, response="pixels")
    light = (
        np.nansum(fit.observed, axis=(1, 2)) - fit.background * np.isfinite(fit.observed[0]).sum()
    )
    assert np.std(fit.flux / light) / np.mean(fit.flux / light) < 5e-3


def test_too_few_cadences(sky):
    with pytest.raises(ValueError, match=r'`tpf` has 15 cadences; response="pixels" needs 20'):
        fitted(sky.to_tpf()[:15], psf=1)


def test_noisy_pos_corr():
    """No PSF absorbs the motion where the shares of pixels are fitted."""
    regime = SkyRegime("tess", mission="TESS", motion="tess", magnitude=10.0)
    sky = make_sky(regime, seed=13, n_cadences=500)
    with pytest.warns(FitWarning, match="times that of POS_CORR: this, or the light"):
        fit = fit_tpf(sky.to_tpf(), response="pixels")
    x, corr = (v[np.searchsorted(sky.cadenceno, fit.cadenceno)] for v in (sky.x, sky.pos_corr1))
    assert np.std(fit.x - x) < np.std(corr - x)


def test_without_pos_corr(sky):
    tpf = sky.to_tpf()[:150]
    for name in ("POS_CORR1", "POS_CORR2"):
        tpf.hdu[1].data[name][:] = np.nan
    found = fitted(tpf)
    assert found.pos_corr is None
    assert 0.9 < found.reduced_chi2 < 1.2


def test_cadences_without_data_of_the_star(sky):
    """Faint pixels have data there: it has no light to regress."""
    tpf = sky.to_tpf()[:150]
    flux = tpf.hdu[1].data["FLUX"]
    flux[40:43, np.median(flux, axis=0) > 0.002 * np.median(flux, axis=0).max()] = np.nan
    found = fitted(tpf)
    assert np.isfinite(found.flux).all()
    assert 0.9 < found.reduced_chi2 < 1.2


class TestShares:
    def test_derivatives(self):
        generator = np.random.default_rng(1)
        terms = polynomial_terms(5, 2)
        u, v, w = generator.uniform(-1, 1, (3, 20))
        _, by_u, by_v = polynomials(terms, u, v, w)
        step = 1e-6
        for slopes, (du, dv) in ((by_u, (step, 0.0)), (by_v, (0.0, step))):
            ends = [polynomials(terms, u + s * du, v + s * dv, w)[0] for s in (1, -1)]
            np.testing.assert_allclose(slopes, (ends[0] - ends[1]) / (2 * step), atol=1e-7)

    def test_changes_stop_at_the_ranges(self):
        coefficients = np.random.default_rng(2).normal(size=(len(polynomial_terms(2, 1)), 3, 4))
        shares = PixelShares(coefficients, (1.0, 2.0), (0.5, 1.5), (0.0, 10.0), 2, 1)
        inside = shares.changes([2.0], [0.5], [10.0])
        np.testing.assert_allclose(shares.changes([5.0], [-1.0], [99.0]), inside)

    @pytest.mark.parametrize(
        ("changes", "message"),
        [
            ({"coefficients": np.zeros((2, 3, 3))}, r"`coefficients` must be finite, of shape \(3"),
            ({"coefficients": np.full((3, 3, 3), np.nan)}, "`coefficients` must be finite"),
            ({"x_range": (2.0, 1.0)}, "`x_range` must increase"),
            ({"degree": -1}, "`degree` must"),
        ],
    )
    def test_bad_values(self, changes, message):
        given = {"coefficients": np.zeros((3, 3, 3)), "x_range": (0, 1), "y_range": (0, 1)}
        given |= {"time_range": (0, 1), "degree": 1}
        with pytest.raises(ValueError, match=message):
            PixelShares(**(given | changes))

    def test_of_another_stamp(self):
        from scope_models import Detector, Star

        shares = PixelShares(np.zeros((1, 3, 3)), (0, 1), (0, 1), (0, 1), 0)
        with pytest.raises(ValueError, match=r"got \(3, 3\)"):
            simulate(Star(12.0), Detector.k2(), Motion.still(3), effects=shares)


REAL = {
    "k2_tpf/ktwo211956421-c05_lpd-targ.fits.gz": (1.35, 1.4),
    "k2_tpf/ktwo211983544-c18_lpd-targ.fits.gz": (1.4, 1.3),
    "kepler_tpf/kplr009002278-2010174085026_lpd-targ.fits.gz": (1.5, 1.5),
    **{f"kepler_q12_ch4/tpf_0{n}.fits.gz": (1.5, 1.5) for n in (1, 2, 4, 5, 6, 7, 8)},
}


@pytest.mark.slow
@pytest.mark.parametrize("name", REAL)
def test_real_pixels(shared_data, name):
    found = fitted(shared_data / name)
    image = np.median(np.nan_to_num(found.observed), axis=0)
    brightest = found.chi2_pixels.ravel()[np.argsort(-image.ravel())[:6]]
    assert np.nanmedian(found.chi2_pixels) <= REAL[name][0]
    assert brightest.mean() <= REAL[name][1]
    n_held = np.isfinite(found.observed[found.held_out & ~found.outliers]).sum()
    # three standard errors
    assert abs(found.chi2_held_out / found.reduced_chi2 - 1) < 3 * np.sqrt(2 / n_held)
    assert found.converged
    for scale, r2, moved in zip(
        found.path_scale(), found.path_r2(), found.pos_corr.std(axis=0), strict=True
    ):
        if moved > 0.05:
            assert 0.9 < scale < 1.1
            assert r2 > 0.98


@pytest.mark.parametrize(
    ("seed", "mag", "moves"),
    [(2, 11.0, 1), pytest.param(3, 11.0, 2, marks=pytest.mark.slow), (6, 13.5, 1)],
)
def test_width_of_the_psf_where_each_pixel_has_a_response(seed, mag, moves):
    # A known Gaussian on pixels that differ by 1 %; an empirical PSF is fitted to the last two.
    psf = BivariateGaussianPSF(sigma_x=0.6, sigma_y=0.5)
    star = Star(mag, x_0=5.2, y_0=4.9, psf=psf)
    tpf = simulate(star, Detector.k2(), moves * Motion.k2_roll(300), seed=seed).to_tpf()
    fit = fitted(tpf)
    shape = fit.psf_shape()
    fwhm = 2 * np.sqrt(2 * np.log(2))
    truth = {"fwhm": fwhm * np.sqrt(0.3), "fwhm_major": fwhm * 0.6, "fwhm_minor": fwhm * 0.5}
    truth |= {"ellipticity": 1 / 6, "angle": 0.0}
    for row in shape:
        assert abs(row["value"] - truth[row["name"]]) < 3 * row["error"], row["name"]
    assert (shape["error"][:4] < 0.01).all()
    assert f"{shape['value'][1]:.4f} +- " in fit.summary()


def test_errors_of_a_gaussian_hold_the_response_of_the_pixels():
    psf = BivariateGaussianPSF(sigma_x=0.6, sigma_y=0.5)
    pulls = []
    for seed in (1, 2):
        star = Star(11.0, x_0=5.2, y_0=4.9, psf=psf)
        tpf = simulate(star, Detector.k2(), Motion.k2_roll(100), seed=seed).to_tpf()
        fit = fitted(tpf, psf=1)
        pulls += [
            (fit.values[name] - value) / fit.errors[name]
            for name, value in (("sigma_x", 0.6), ("sigma_y", 0.5))
        ]
    assert np.max(np.abs(pulls)) < 4
    assert np.std(pulls) > 0.2


def test_errors_of_a_psf_that_only_its_priors_hold():
    """Deep eclipses beside neighbors: the variances are as large as those of the priors."""
    motion = Motion.k2_roll(60, seed=3)
    eclipses = 1 - 0.9 * (motion.time / 2.7 % 1 < 0.06)
    places = np.random.default_rng(3).uniform(0, 6, (3, 2))
    stars = [Star(10.0, 3, 3, signal=eclipses)]
    stars += [Star(mag, *place) for mag, place in zip((13.0, 15.5, 18.0), places, strict=True)]
    tpf = simulate(stars, Detector.k2(shape=(7, 7)), motion, seed=2).to_tpf()
    fit = fitted(tpf)
    errors = np.sqrt(np.diag(fit.covariance))
    assert np.isfinite(errors).all()
    assert np.linalg.eigvalsh(fit.covariance / np.outer(errors, errors)).min() > -1e-9


def test_image_of_the_psf_has_no_rings():
    """Two Gaussians that an empirical term around another Gaussian cannot describe."""
    psf = BivariateGaussianPSF(0.8, 0, 0, 0.4, 0.35, 0.2) + BivariateGaussianPSF(0.2, 0, 0, 1, 1)
    detector = Detector.k2(shape=(9, 9), sensitivity=None, interpixel_scatter=0)
    observation = simulate(Star(12.0, psf=psf), detector, Motion.k2_roll(80), seed=1)
    fit = fit_tpf(observation.to_tpf(), response="pixels")
    offset, density, _ = fit.psf_image(2.0, 81)
    used, truth = np.isin(observation.cadenceno, fit.cadenceno), observation.truth
    x, y = (np.median(p - q[0, used]) for p, q in ((fit.x, truth.x), (fit.y, truth.y)))
    true = psf(*np.meshgrid(offset + x, offset + y))
    density, true = density / density.sum(), true / true.sum()
    assert np.sum(true * np.abs(density - true)) < 0.03 * np.sum(true**2)
    assert density.min() > -0.005 * density.max()
