"""Fits of simulated pixels, against their truth; bad input; real pixels."""

import warnings

import lightkurve as lk
import numpy as np
import pytest
from astropy import units as u
from astropy.io import fits
from astropy.modeling.fitting import TRFLSQFitter
from matplotlib import pyplot as plt
from photutils.psf import CircularGaussianPSF

from scope_models import (
    PRF,
    BivariateGaussianPSF,
    Detector,
    Motion,
    SensitivityPolynomial,
    Star,
    fit_tpf,
    simulate,
)
from scope_models.benchmark import make_sky
from scope_models.exceptions import FitWarning
from scope_models.fitting import FitOptions, _solver
from scope_models.io import read_tpf
from scope_models.io.tpf import write_hdulist
from scope_models.models import TabulatedPRF

TRUE_SHAPE = {
    "sigma_x_0": 0.5, "sigma_y_0": 0.45, "rho_0": 0.15, "sigma_x_1": 1.1, "sigma_y_1": 1.2,
    "rho_1": -0.1, "flux_fraction_1": 0.25, "x_offset_1": 0.1, "y_offset_1": -0.05,
    "ax2": -0.05, "ay2": -0.05,
}  # fmt: skip


def column(name):
    """Return a property of the first table."""

    def change(self, values):
        self.hdu[1].data[name] = values

    return property(lambda self: self.hdu[1].data[name], change)


class Pixels(lk.KeplerTargetPixelFile):
    """A target pixel file whose columns can be changed."""

    flux, flux_err = column("FLUX"), column("FLUX_ERR")
    pos_corr1, pos_corr2 = column("POS_CORR1"), column("POS_CORR2")

    def __init__(self, tpf):
        hdus = fits.HDUList([hdu.copy() for hdu in tpf.hdu])
        super().__init__(hdus, quality_bitmask="none")
        self.hdu[1].data = self.hdu[1].data[tpf.quality_mask]
        self.quality_mask = np.ones(len(self.hdu[1].data), dtype=bool)


def make(motion=None, mag=12.0, shape=(7, 7), seed=1, n=80, sensitivity=None, **star):
    """A target pixel file of a Gaussian star, as plain arrays."""
    motion = 3 * Motion.k2_roll(n) if motion is None else motion
    detector = Detector.k2(shape=shape, interpixel_distribution="normal", sensitivity=sensitivity)
    return Pixels(simulate(Star(mag, **star), detector, motion, seed=seed).to_tpf())


def messages_of(*arguments, **options):
    """Fit, and return the fit and the warnings."""
    with warnings.catch_warnings(record=True) as record:
        warnings.simplefilter("always")
        fit = fit_tpf(*arguments, **options)
    assert all(issubclass(warning.category, FitWarning) for warning in record)
    assert {warning.filename for warning in record} <= {__file__}
    return fit, " | ".join(str(warning.message) for warning in record)


def truth_of(observation, fit):
    """Which cadences were fitted, and the mean response that belongs to the fluxes."""
    used = np.isin(observation.cadenceno, fit.cadenceno)
    weights = np.maximum(np.median(fit.observed, axis=0), 0)
    return used, np.sum(weights * observation.truth.interpixel) / weights.sum()


class TestTruth:
    def test_chi2(self, fit):
        assert fit.converged
        assert abs(fit.reduced_chi2 - 1) < 5 * np.sqrt(2 / fit.dof)
        assert fit.error_scale == 1

    @pytest.mark.parametrize("name", sorted(TRUE_SHAPE))
    def test_shape(self, fit, name):
        assert abs(fit.values[name] - TRUE_SHAPE[name]) < 4 * fit.errors[name]

    def test_positions_and_fluxes(self, fit, observation):
        used, response = truth_of(observation, fit)
        x, y = observation.truth.x[0, used], observation.truth.y[0, used]
        flux = observation.truth.flux[0] * response
        assert np.abs(fit.x - x).max() < 6 * fit.x_err.max()
        assert np.abs(fit.y - y).max() < 6 * fit.y_err.max()
        assert np.abs(fit.flux - flux).max() < 6 * fit.flux_err.max()
        relative = (fit.flux - fit.flux.mean()) / fit.flux_scatter
        assert 0.5 < relative.std() < 1.5

    def test_interpixel_map(self, fit, observation):
        _, response = truth_of(observation, fit)
        pulls = (fit.interpixel - observation.truth.interpixel / response) / fit.interpixel_err
        # They are correlated: a shift of the star is a gradient of the map.
        assert np.abs(pulls).max() < 4.5
        assert 0.6 < np.sqrt(np.mean(pulls**2)) < 1.5
        # What crosses the pixel measures its response far better than the prior of 1 %.
        assert fit.interpixel_err.min() < 0.0005
        weights = np.maximum(np.median(fit.observed, axis=0), 0)
        assert np.sum(weights * fit.interpixel) / weights.sum() == pytest.approx(1, abs=1e-9)

    def test_model_is_the_simulators(self, fit, observation):
        used, _ = truth_of(observation, fit)
        model = observation.model()[used]
        assert np.abs(fit.fitted - model).max() < 4 * fit.observed_err.max()
        np.testing.assert_allclose(fit.residual, fit.observed - fit.fitted)

    @pytest.mark.slow
    def test_pulls(self):
        """Over many stars, the errors are those of the parameters."""
        pulls = []
        curvature = SensitivityPolynomial(fixed={"ax1": True, "ay1": True})
        detector = Detector.k2(shape=(7, 7), interpixel_distribution="normal", well_depth=None)
        for seed in range(50):
            x, y = np.random.default_rng(seed).uniform(2.8, 3.2, 2)
            motion = (1 if seed % 2 else 5) * Motion.k2_roll(250)
            star = Star(10 + 3 * (seed % 5) / 4, x, y, psf=BivariateGaussianPSF(rho=0.2))
            observation = simulate(star, detector, motion, seed=seed)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", FitWarning)  # 1x motion does not measure ax2
                all_columns = FitOptions(saturation=False)
                fit = fit_tpf(observation.to_tpf(), 1, curvature, options=all_columns)
            used, response = truth_of(observation, fit)
            truth = {"sigma_x": 0.5, "sigma_y": 0.5, "rho": 0.2, "ax2": -0.05, "ay2": -0.05}
            row = [(fit.values[k] - v) / fit.errors[k] for k, v in truth.items()]
            row.append((fit.x[0] - observation.truth.x[0, used][0]) / fit.x_err[0])
            row.append((fit.y[0] - observation.truth.y[0, used][0]) / fit.y_err[0])
            row.append((fit.flux[0] - observation.truth.flux[0] * response) / fit.flux_err[0])
            pulls.append(row)
        pulls = np.array(pulls)
        assert np.all(np.abs(pulls.mean(axis=0)) < 4 / np.sqrt(50))
        assert np.all(np.abs(pulls.std(axis=0) - 1) < 4 / np.sqrt(100))


class TestOptions:
    def test_fixed_and_bounds_of_the_model(self):
        psf = BivariateGaussianPSF(
            sigma_x=0.6, fixed={"sigma_x": True}, bounds={"sigma_y": (0.55, 0.7)}
        )
        fit, messages = messages_of(make(), psf, interpixel=0.01)
        assert "the model does not describe the pixels" in messages
        assert "sigma_x" not in fit.names
        assert fit.model.sigma_x == 0.6
        assert fit.values["sigma_y"] == pytest.approx(0.55, abs=1e-12)
        # A parameter at a bound has no error, and the fit has not converged.
        assert fit.at_bounds == ("sigma_y",)
        assert np.isnan(fit.errors["sigma_y"])
        assert not fit.converged
        assert "the fit ends at bounds, sigma_y = 0.55" in messages
        # The interpixel map takes up what a width leaves that is nearly right, with a warning.
        nearly = BivariateGaussianPSF(sigma_x=0.51, fixed={"sigma_x": True})
        _, messages = messages_of(make(), nearly, interpixel=0.01)
        assert "it describes errors of the PSF; interpixel=0 leaves it out" in messages

    def test_one_cadence_as_astropy_fits_it(self):
        tpf = make(Motion.still(1), mag=16.0, shape=(9, 9))
        fit = fit_tpf(tpf, 1, interpixel=0, options=FitOptions(background="none"))
        prf = PRF(BivariateGaussianPSF(), flux=4e3, x_0=4, y_0=4)
        y, x = np.mgrid[:9, :9]
        weights = 1 / tpf.flux_err[0]
        plain = TRFLSQFitter()(prf, x, y, tpf.flux[0], weights=weights)
        for name in ("sigma_x", "sigma_y", "rho"):
            assert fit.values[name] == pytest.approx(getattr(plain, name).value, abs=1e-6)
        assert fit.x[0] == pytest.approx(plain.x_0.value, abs=1e-6)
        assert fit.flux[0] == pytest.approx(plain.flux.value, rel=1e-6)
        error = np.sqrt(np.diag(plain.cov_matrix.cov_matrix)) if plain.cov_matrix else None
        if error is not None:
            assert fit.errors["sigma_x"] > 0

    def test_any_density(self):
        psf = CircularGaussianPSF(fwhm=1.0)
        psf.fwhm.fixed = False
        fit = fit_tpf(make(n=20), psf)
        assert fit.values["fwhm"] == pytest.approx(0.5 * np.sqrt(8 * np.log(2)), rel=0.003)

    def test_table(self):
        """A PRF with nothing to fit but the cadences' own parameters."""
        y, x = np.mgrid[-45:46, -45:46] / 9
        table = TabulatedPRF(PRF(BivariateGaussianPSF())(x, y), 9)
        detector = Detector.k2(shape=(9, 9), sensitivity=None, interpixel_scatter=0)
        tpf = simulate(Star(12.0), detector, Motion.k2_roll(40), seed=1).to_tpf()
        fit = fit_tpf(tpf, table, interpixel=0)
        assert fit.names == ()
        assert fit.converged
        assert abs(fit.reduced_chi2 - 1) < 5 * np.sqrt(2 / fit.dof)
        np.testing.assert_allclose(fit.flux, fit_tpf(tpf, 1, interpixel=0).flux, rtol=1e-3)

    def test_path(self):
        tpf = make()
        fit = fit_tpf(tpf, 1, positions="path")
        assert fit.values["x_by_corr1"] == pytest.approx(1, abs=0.008)
        assert fit.values["y_by_corr1"] == pytest.approx(0, abs=0.002)
        assert fit.x.std() > 0
        assert np.all(fit.x_err > 0)
        loose = fit_tpf(tpf, 1, positions="prior", options=FitOptions(position_error=1.0))
        free = fit_tpf(tpf, 1, positions="free")
        np.testing.assert_allclose(loose.x, free.x, atol=1e-3)
        assert fit.path_r2() == (pytest.approx(1), pytest.approx(1))

    def test_constant_background(self):
        tpf = make()
        tpf.flux += 7.0
        fit = fit_tpf(tpf, 1, options=FitOptions(background="constant"))
        assert abs(fit.values["background"] - 7) < 5 * fit.errors["background"]
        assert np.ptp(fit.background) == 0

    def test_soft_loss_forgives_cosmic_rays(self):
        tpf = make()
        clean = fit_tpf(tpf, 1)
        hit = np.random.default_rng(2).integers(0, 7, (40, 2))
        for cadence, (row, column) in enumerate(hit):
            tpf.flux[cadence, row, column] += 4000
        hard, messages = messages_of(tpf, 1)
        assert "does not describe" in messages
        soft, _ = messages_of(tpf, 1, options=FitOptions(loss="soft_l1"))
        moved = [np.abs(fit.x - clean.x).max() for fit in (soft, hard)]
        assert moved[0] < 0.06 * moved[1]

    def test_empirical_term_describes_another_psf(self):
        psf = BivariateGaussianPSF(0.6, 0, 0, 0.4, 0.5) + BivariateGaussianPSF(
            0.4, 0.5, 0.3, 0.7, 0.6, 0.5
        )
        tpf = make(3 * Motion.k2_roll(100), psf=psf)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FitWarning)
            plain = fit_tpf(tpf, 1)
            rich = fit_tpf(tpf, 1, empirical=4)
        assert rich.reduced_chi2 < 0.2 * plain.reduced_chi2

    def test_path_of_a_file(self, tmp_path):
        detector = Detector.k2(shape=(7, 7))
        observation = simulate(Star(12.0), detector, Motion.k2_roll(60), seed=1)
        path = observation.write(tmp_path / "star.fits")
        from_path, from_object = fit_tpf(path, 1), fit_tpf(read_tpf(path), 1)
        np.testing.assert_array_equal(from_path.flux, from_object.flux)
        assert from_path.meta == from_object.meta
        error = from_path.observed_err[0] * u.electron / u.s
        assert fit_tpf(path, 1, flux_err=error).converged
        with pytest.raises(ValueError, match="`flux_err` must be in electron / s"):
            fit_tpf(path, 1, flux_err=1 * u.pix)


class TestBadInput:
    def test_nan_pixels_cadences_and_columns(self):
        tpf = make()
        clean = fit_tpf(tpf, 1)
        tpf.flux[3] = np.nan
        tpf.flux[5, 2, 2] = np.nan
        tpf.flux[:, :, 6] = np.nan
        fit = fit_tpf(tpf, 1)
        assert len(fit.time) == len(clean.time) - 1
        assert np.isnan(fit.residual[:, :, 6]).all()
        assert np.isnan(fit.chi2_pixels[:, 6]).all()
        assert fit.values["sigma_x"] == pytest.approx(clean.values["sigma_x"], abs=5e-5)

    def test_errors_zero_or_absent(self):
        tpf = make()
        tpf.flux_err[:, 0, 0] = 0
        with pytest.warns(FitWarning, match="80 pixel values|pixel values without a positive"):
            fit_tpf(tpf, 1)
        tpf.flux_err[:] = np.nan
        with pytest.raises(ValueError, match="the file has no errors"):
            fit_tpf(tpf, 1)
        assert fit_tpf(tpf, 1, flux_err=20.0).converged
        with pytest.raises(ValueError, match="must broadcast"):
            fit_tpf(tpf, 1, flux_err=np.ones(5))

    def test_star_at_the_edge(self):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            tpf = make(Motion.k2_roll(60), x_0=-0.3, y_0=3)
        with pytest.warns(FitWarning, match="at the edge"):
            fit = fit_tpf(tpf, 1)
        assert np.median(fit.x) == pytest.approx(-0.3, abs=0.05)

    def test_saturated_column(self):
        tpf = make(Motion.k2_roll(60), mag=9.0, shape=(11, 11))
        fit, messages = messages_of(tpf, 1)
        assert "columns 4, 5, 6 hold saturated pixels" in messages
        assert np.isnan(fit.residual[:, :, 5]).all()
        # The light beside the full columns still gives the star's place.
        assert np.median(fit.y) == pytest.approx(5, abs=0.2)
        whole = fit_tpf(make(n=30), 1, options=FitOptions(saturation=False))
        assert not np.isnan(whole.residual).any()

    def test_two_stars_with_one_model(self):
        detector, motion = Detector.k2(shape=(9, 9)), Motion.k2_roll(60)
        stars = [Star(12.0, 3, 4), Star(12.3, 5.5, 4)]
        tpf = simulate(stars, detector, motion, seed=1).to_tpf()
        fit, messages = messages_of(tpf, 1)
        assert "does not describe the pixels" in messages
        assert 'may be other stars: neighbors="find" fits them' in messages
        assert fit.error_scale > 2

    def test_still_star_does_not_tell_the_sensitivity(self, curvature):
        with pytest.warns(FitWarning, match="does not constrain the sensitivity"):
            fit = fit_tpf(make(Motion.still(60)), 1, curvature)
        assert fit.errors["ax2"] > 0.05

    def test_far_start(self):
        near = fit_tpf(make(), 1)
        far = fit_tpf(make(), BivariateGaussianPSF(sigma_x=2.0, sigma_y=0.15, rho=-0.8))
        assert far.values["sigma_x"] == pytest.approx(near.values["sigma_x"], abs=1e-4)

    def test_too_few_steps(self):
        fit, messages = messages_of(make(), 2, options=FitOptions(max_steps=1, loss="soft_l1"))
        assert "has not converged after" in messages
        assert not fit.converged
        assert np.isfinite(fit.parameters["value"]).all()

    def test_best_parameters_are_kept_when_steps_fail(self, monkeypatch):
        """Where no step can be made any more, what was found before is returned."""
        step, calls, allowed = _solver._step, [], 1

        def fails_later(*arguments):
            calls.append(arguments[1])
            return step(*arguments) if len(calls) <= allowed else (None, 0.0)

        tpf = make(n=30)
        monkeypatch.setattr(_solver, "_step", fails_later)
        start, _ = messages_of(tpf, 1, interpixel=0.01)
        calls, allowed = [], 4
        fit, messages = messages_of(tpf, 1, interpixel=0.01)
        assert "has not converged" in messages
        assert not fit.converged
        assert fit.n_steps <= 4
        assert fit.chi2 < start.chi2
        np.testing.assert_array_equal(list(fit.values.values()), calls[-1].shared)

    @pytest.mark.parametrize(
        "options, error, message",
        [
            ({"psf": 4}, ValueError, "`psf` must be 1, 2 or 3"),
            ({"psf": "gauss"}, TypeError, "`psf` must be"),
            ({"sensitivity": 1}, TypeError, "`sensitivity` must be"),
            ({"positions": "here"}, ValueError, "`positions` must be one of"),
            ({"interpixel": -1.0}, ValueError, "`interpixel` must not be negative"),
            ({"empirical": 1.5}, TypeError, "`empirical` must be an integer"),
            ({"options": {"loss": "l2"}}, TypeError, "`options` must be FitOptions or None"),
            ({"options": FitOptions(focus=1e-6), "psf": 1}, ValueError, "`focus` is shorter than"),
            ({"progress": "yes"}, TypeError, "`progress` must be True, False or None"),
        ],
    )
    def test_options(self, options, error, message):
        with pytest.raises(error, match=message):
            fit_tpf(make(n=5), **options)

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"background": "spline"}, "`background` must be one of"),
            ({"loss": "l2"}, "`loss` must be one of"),
            ({"neighbor_flux": "none"}, "`neighbor_flux` must be one of"),
            ({"max_steps": 0}, "`max_steps` must be at least 1"),
        ],
    )
    def test_rare_options(self, options, message):
        with pytest.raises(ValueError, match=message):
            FitOptions(**options)

    def test_saturation_is_no_level(self):
        with pytest.raises(TypeError, match="`saturation` must be True or False"):
            FitOptions(saturation="x")

    def test_a_number_of_components_of_numpy(self):
        assert fit_tpf(make(n=5), psf=np.int64(1)).model.n_components == 1

    def test_not_a_file(self):
        with pytest.raises(TypeError, match="`tpf` must be a target pixel file"):
            fit_tpf(np.ones((3, 4, 5)))
        tpf = make(n=5)
        tpf.flux[:] = np.nan
        with pytest.raises(ValueError, match="no finite value"):
            fit_tpf(tpf)
        with pytest.raises(ValueError, match="must have at least the target"):
            fit_tpf(tpf, stars="find")
        tpf.flux[:] = -1.0
        with pytest.raises(ValueError, match="no star to fit"):
            fit_tpf(tpf)

    def test_no_light_beside_the_full_columns(self):
        tpf = make(n=20, mag=9.0, shape=(11, 11))
        tpf.flux[:, :, [*range(4), *range(7, 11)]] -= 1e4
        with (
            pytest.warns(FitWarning, match="saturated"),
            pytest.raises(ValueError, match="no star"),
        ):
            fit_tpf(tpf, 1)

    def test_path_without_pos_corr(self):
        tpf = make(n=5)
        tpf.pos_corr1 = tpf.pos_corr2 = np.nan
        with pytest.raises(ValueError, match="has no POS_CORR"):
            fit_tpf(tpf, positions="path")


def test_real_star_follows_pos_corr(shared_data):
    path = shared_data / "k2_tpf" / "ktwo211956421-c05_lpd-targ.fits.gz"
    tpf = lk.read(path)
    part = Pixels(tpf[::12])
    tpf.hdu.close()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FitWarning)
        fit = fit_tpf(part, 2, interpixel=0, options=FitOptions(loss="soft_l1"))
    column, row = fit.path_r2()
    assert column > 0.98
    assert row > 0.9


def test_a_constant_shows_no_star():
    tpf = simulate(Star(12.0), Detector.k2(shape=(5, 5)), Motion.k2_roll(60), seed=1).to_tpf()
    tpf.hdu[1].data["FLUX"] = 5.0
    with pytest.warns(FitWarning, match=r"no star is seen: its mean flux is .* e-/s"):
        fit_tpf(tpf, psf=1)


@pytest.mark.parametrize("options", [{}, {"psf": 2}, {"response": "pixels"}])
def test_a_fit_of_noise_ends_soon(options):
    motion = Motion.k2_roll(150)
    tpf = simulate(Star(40.0), Detector.k2(shape=(7, 7)), motion, seed=1).to_tpf()
    fit, doubts = messages_of(tpf, **options)
    assert "no star is seen: its mean flux is" in doubts
    assert fit.n_steps < 50
    assert not fit.response


def test_an_outlier_hides_no_star():
    tpf = make(Motion.k2_roll(150), mag=17.0)
    tpf.flux[70] += 1e6
    fit, doubts = messages_of(tpf, psf=1)
    assert "no star" not in doubts
    assert fit.converged


def test_a_psf_that_leaves_the_flux_open_hides_no_star():
    scene = Star(17.0), Detector.k2(shape=(3, 3)), Motion.still(10)
    fit, doubts = messages_of(simulate(*scene, seed=1).to_tpf(), psf=2)
    assert "no star" not in doubts
    assert fit.flux.mean() < fit.flux_err.mean()


@pytest.mark.parametrize("positions", ["start", "path"])
def test_remedies_are_not_those_that_were_tried(positions):
    psf = BivariateGaussianPSF(0.6, 0, 0, 0.25, 0.25) + BivariateGaussianPSF(0.4, 0.2, 0, 1, 1)
    tpf = make(2 * Motion.k2_roll(60), psf=psf)
    doubts = messages_of(tpf, 1, interpixel=0, positions=positions)[1]
    assert "times that of POS_CORR" in doubts
    assert ('positions="path"' in doubts) == (positions == "start")


def test_light_curve(fit):
    curve = fit.to_lightcurve()
    assert curve.flux.unit == u.electron / u.s
    assert curve.time.format == "bkjd"
    np.testing.assert_array_equal(curve["cadenceno"], fit.cadenceno)
    np.testing.assert_array_equal(curve.time.value, fit.time)


def test_rich_models_converge(psf):
    """Terms that can imitate each other leave no doubt about where the minimum is."""
    observation = simulate(
        Star(12.0, 3.2, 2.9, psf=psf), Detector.k2(shape=(7, 7)), 3 * Motion.k2_roll(60), seed=2
    )
    fit = fit_tpf(observation.to_tpf(), psf=2, empirical=6)
    assert fit.converged
    assert fit.n_steps < 100
    longer = fit_tpf(observation.to_tpf(), psf=2, empirical=6, options=FitOptions(max_steps=1000))
    assert longer.chi2 == pytest.approx(fit.chi2, abs=0.1)
    assert abs(fit.reduced_chi2 - 1) < 5 * np.sqrt(2 / fit.dof)


def test_long_series_start_from_some_of_their_cadences(psf, curvature):
    """The guess from a part leads to the fit of the whole, whose errors are those of all data."""
    observation = simulate(
        Star(13.0, 3.1, 3.0, psf=psf), Detector.k2(shape=(7, 7)), 5 * Motion.k2_roll(660), seed=4
    )
    tpf = observation.to_tpf()
    whole, half = (fit_tpf(part, 2, curvature) for part in (tpf, tpf[::2]))
    assert whole.converged
    assert abs(whole.reduced_chi2 - 1) < 5 * np.sqrt(2 / whole.dof)
    for name in ("sigma_x_0", "ax2", "ay2"):
        assert whole.errors[name] == pytest.approx(half.errors[name] / 2**0.5, rel=0.1)
        assert abs(whole.values[name] - TRUE_SHAPE[name]) < 4 * whole.errors[name]


def test_sensitivity_stays_within_what_a_pixel_can_do(curvature):
    """Where the PSF is wrong, the response at an edge is held between none and twice the center."""
    wrong = BivariateGaussianPSF(0.5, 0, 0, 0.2, 0.2) + BivariateGaussianPSF(0.5, 0.6, 0, 0.2, 0.2)
    fit, messages = messages_of(make(n=20, psf=wrong), 1, curvature)
    assert abs(fit.values["ax2"]) == 4
    assert "the sensitivity is at its bound, ax2" in messages
    assert "along columns, at its bound" in [
        text.get_text() for text in fit.plot()["sensitivity"].get_legend().get_texts()
    ]
    plt.close("all")


class TestDefault:
    @pytest.mark.parametrize("sensitivity", [None, Detector.k2().sensitivity])
    def test_star_of_one_gaussian(self, sensitivity):
        """The simplest model that is true is kept: nothing in it is without constraint.

        The response within the pixels, which the width would take up, is in it where it is seen.
        """
        detector = Detector.k2(
            shape=(7, 7), interpixel_distribution="normal", sensitivity=sensitivity
        )
        observation = simulate(Star(12.0), detector, 3 * Motion.k2_roll(500), seed=1)
        fit, messages = messages_of(observation.to_tpf())
        assert fit.converged
        assert not messages
        response = () if sensitivity is None else ("ax1", "ax2", "ay1", "ay2")
        assert fit.names == ("sigma_x", "sigma_y", "rho", *response)
        assert fit.n_steps < 30
        assert abs(fit.reduced_chi2 - 1) < 5 * np.sqrt(2 / fit.dof)
        for name, true in {"sigma_x": 0.5, "sigma_y": 0.5, "ax2": -0.05, "ay2": -0.05}.items():
            if name in fit.names:
                assert abs(fit.values[name] - true) < 4 * fit.errors[name]
        relative = fit.flux / observation.truth.flux[0]
        pulls = (relative - relative.mean()) * fit.flux / fit.flux_scatter
        # With a sensitivity the cadences have an error in common: it does not average out.
        assert pulls.std() < (1.5 if sensitivity is None else 3.0)

    @pytest.mark.parametrize(("mag", "moves"), [(12.0, 1), (14.0, 1), (16.0, 3)])
    def test_a_width_with_the_response_within_pixels_in_it_is_doubted(self, mag, moves):
        """Chi-squared is 1, but the errors of the width do not hold what it has taken up."""
        psf = BivariateGaussianPSF(0.8, 0, 0, 0.45, 0.45) + BivariateGaussianPSF(
            0.2, 0, 0, 1.261, 1.261
        )
        for response in (None, Detector.k2_calibrated().sensitivity):
            detector = Detector.k2_calibrated(shape=(9, 9), sensitivity=response, well_depth=None)
            star = simulate(Star(mag, psf=psf), detector, moves * Motion.k2_roll(400), seed=5)
            fit, messages = messages_of(star.to_tpf(), 2)
            wrong = abs(fit.values["sigma_y_0"] - 0.45) > 4 * fit.errors["sigma_y_0"]
            assert wrong == (response is not None)
            assert ("a response within pixels would lower chi-squared" in messages) == wrong

    def test_errors_follow_the_misfit_of_the_bright_pixels(self):
        """Most pixels have no light: they do not show that the PSF is wrong."""
        motion = Motion.k2_roll(60)
        psf = BivariateGaussianPSF(0.7, 0, 0, 0.45, 0.45) + BivariateGaussianPSF(0.3, 0.2, 0.1)
        fit, _ = messages_of(make(motion, shape=(21, 21), psf=psf), 1, interpixel=0)
        assert np.median(fit.chi2_pixels) < 1.5
        image = np.median(fit.observed, axis=0)
        assert fit.error_scale**2 > 0.3 * fit.chi2_pixels[image > 0.1 * image.max()].mean()

    def test_a_robust_loss_follows_all_pixels_alike(self):
        """Most pixels have no light: the loss counts in their noise, the errors in the misfit."""
        motion = Motion.k2_roll(40)
        psf = BivariateGaussianPSF(0.7, 0, 0, 0.45, 0.45) + BivariateGaussianPSF(0.3, 0.2, 0.1)
        tpf = make(motion, shape=(15, 15), psf=psf)
        fit, _ = messages_of(tpf, 1, interpixel=0, options=FitOptions(loss="soft_l1"))
        assert fit.error_scale > 2
        # At the minimum the derivative of the loss by the background of each cadence is zero.
        residual = fit.residual / fit.observed_err
        by_background = np.sum(
            residual / np.sqrt(1 + (residual / 3) ** 2) / fit.observed_err, (1, 2)
        )
        information = np.sqrt(np.sum(fit.observed_err**-2.0, axis=(1, 2)))
        assert np.abs(by_background / information).max() < 0.01

    def test_simulated_star(self, default):
        """Where the model is true, the response between pixels is fitted with it."""
        assert default.options["interpixel"] == 0.01
        assert default.names[0] == "sigma_x_0"
        assert abs(default.reduced_chi2 - 1) < 5 * np.sqrt(2 / default.dof)

    def test_wrong_psf(self):
        """Where it is not, b is 1, and another model is chosen if it is better."""
        square = sum(
            (BivariateGaussianPSF(1.0, x, y, 0.3, 0.3) for x in (-0.8, 0.8) for y in (-0.8, 0.8)),
            start=BivariateGaussianPSF(0.5, 0.9, 0, 0.2, 0.2),
        )
        fit, _ = messages_of(make(n=60, psf=square, mag=11.0))
        assert fit.options["interpixel"] == 0
        assert np.all(fit.interpixel == 1)
        assert fit.error_scale > 1
        assert fit.options["positions"] == "prior"
        np.testing.assert_allclose(fit.path_scale(), 1, atol=0.25)

    def test_sensitivity_without_a_psf_that_fits_has_no_error(self, curvature):
        wrong = BivariateGaussianPSF(0.5, 0, 0, 0.4, 0.4) + BivariateGaussianPSF(
            0.5, 0.5, 0.3, 0.6, 0.5, 0.3
        )
        fit, messages = messages_of(make(psf=wrong), 1, curvature)
        assert np.isnan(fit.errors["ay2"])
        assert "sensitivity is" in messages

    def test_motion_is_checked_against_pos_corr(self):
        tpf = make()
        tpf.pos_corr1 = 3 * tpf.pos_corr1
        fit, messages = messages_of(tpf, 1)
        assert fit.path_scale()[0] == pytest.approx(1 / 3, rel=0.01)
        assert "the fitted motion along x is 0.33 times that of POS_CORR" in messages
        for factor in (-1, 1.15, 0.85):
            turned = make(n=40)
            turned.pos_corr1 = turned.pos_corr1 / factor
            fit, messages = messages_of(turned, 1)
            assert fit.path_scale()[0] == pytest.approx(factor, abs=0.015)
            assert "the fitted motion along x is" in messages
            assert "along y" not in messages

    def test_progress(self, capsys):
        fit_tpf(make(n=20), 1, progress=True)
        assert "cost" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("regime", ["k2-1x-constant", "k2-5x-constant", "k2-1x-kp17"])
def test_sensitivity_of_messy_stars_is_not_quoted(regime, curvature):
    """The PSF of these stars is no sum of Gaussians: a coefficient describes that, if anything."""
    tpf = make_sky(regime, seed=3, n_cadences=200).to_tpf()
    fit, messages = messages_of(tpf, sensitivity=curvature)
    assert "the sensitivity is" in messages
    assert fit.reduced_chi2 > 1.1
    assert all(np.isnan(fit.errors[name]) for name in ("ax2", "ay2"))
    np.testing.assert_allclose(fit.path_scale(), 1, atol=0.15)


@pytest.mark.parametrize("name", ["_make_problem", "make_results"])
def test_singular_pixels_are_a_clear_error(monkeypatch, name):
    def fail(*_, **__):
        raise np.linalg.LinAlgError("singular")

    monkeypatch.setattr(f"scope_models.fitting.fit.{name}", fail)
    tpf = simulate(Star(12.0), Detector.k2(shape=(5, 5)), Motion.k2_roll(30), seed=1).to_tpf()
    with pytest.raises(ValueError, match=r"pixels of `tpf` do not constrain .*singular") as error:
        fit_tpf(tpf, 1)
    assert not isinstance(error.value, np.linalg.LinAlgError)


@pytest.mark.parametrize(
    ("column", "values", "error"),
    [
        ("FLUX", lambda flux: np.broadcast_to(flux[:, :, 3:4], flux.shape), None),  # all alike
        ("FLUX_ERR", lambda error: 0 * error, "`flux_err` must be positive"),
        ("FLUX_ERR", lambda error: 0 * error + 1e-30, "`tpf` do not constrain .*: check FLUX_ERR"),
    ],
)
def test_files_whose_pixels_are_singular(tmp_path, column, values, error):
    """The linear algebra of the pixels' shares fails in a warning or an error of the file."""
    motion = Motion.k2_roll(60, seed=1)
    tpf = simulate(Star(12, 3, 3), Detector.k2(shape=(7, 7)), motion, seed=1).to_tpf()
    data = tpf.hdu[1].data
    data[column][:] = values(data[column].copy())
    path = tmp_path / "singular.fits"
    write_hdulist(tpf.hdu, path)
    if error:
        with pytest.raises(ValueError, match=error):
            fit_tpf(path, response="pixels")
        return
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        fit = fit_tpf(path, response="pixels")
    assert any(issubclass(warning.category, FitWarning) for warning in caught)
    assert np.isfinite(fit.flux).all()
