"""What is done with a fit: tables, files, figures, the twin, the command line."""

import dataclasses
import io

import numpy as np
import pytest
from astropy import units as u
from astropy.io import fits
from astropy.table import Table
from astropy.utils.diff import report_diff_values
from matplotlib import pyplot as plt
from photutils.psf import MoffatPSF

from scope_models import (
    BivariateGaussianPSF,
    Detector,
    Motion,
    Scene,
    Star,
    TPFFit,
    fit_tpf,
    simulate,
)
from scope_models.cli import main
from scope_models.effects import Focus
from scope_models.exceptions import FitWarning
from scope_models.fitting import FitOptions
from scope_models.plotting import plot_twin


def test_table(fit):
    table = fit.parameters
    assert table.colnames == ["name", "value", "error", "unit", "fixed", "kind", "at_bound"]
    row = table[table["name"] == "sigma_x_0"][0]
    assert row["value"] == fit.values["sigma_x_0"]
    assert row["unit"] == "pix"
    assert table[table["name"] == "ax0"]["fixed"][0]
    correlation = fit.correlation()
    assert correlation["ax2"][correlation["name"] == "ax2"][0] == pytest.approx(1)
    matrix = np.array([correlation[name] for name in fit.names])
    assert np.all(np.abs(matrix) <= 1 + 1e-9)


def test_html(fit):
    html = fit._repr_html_()
    assert "chi-squared per degree of freedom" in html
    assert all(f"<td>{name}</td>" in html for name in fit.parameters["name"])


def test_chi2_of_pixels_and_cadences(fit):
    assert fit.chi2_pixels.shape == fit.shape
    assert fit.chi2_cadences.shape == fit.time.shape
    assert fit.chi2_pixels.mean() == pytest.approx(fit.reduced_chi2)
    assert fit.chi2_cadences.mean() == pytest.approx(fit.reduced_chi2)


def test_arrays_are_read_only(fit):
    with pytest.raises(ValueError, match="read-only"):
        fit.x[0] = 1


def test_file_holds_everything(fit, tmp_path):
    path = fit.write(tmp_path / "fit.fits")
    again = TPFFit.read(path)
    for name in [field.name for field in dataclasses.fields(fit)]:
        value = getattr(fit, name)
        other = getattr(again, name)
        if isinstance(value, np.ndarray):
            np.testing.assert_array_equal(other, value, err_msg=name)
        elif name == "model":
            np.testing.assert_array_equal(other.parameters, value.parameters)
            assert other.fixed == value.fixed
        elif isinstance(value, Table):
            assert report_diff_values(value, other, io.StringIO()), name
            assert [c.unit for c in value.itercols()] == [c.unit for c in other.itercols()]
        elif name == "statistics":
            assert other.keys() == value.keys()
            assert all(other[k] == v or k == "chi2_held_out" for k, v in value.items())
        elif name != "detector":
            assert other == value, name
    assert again.detector.read_noise == fit.detector.read_noise
    np.testing.assert_array_equal(again.detector.interpixel, fit.detector.interpixel)
    with fits.open(path) as hdus:
        hdus.verify("exception")
    with pytest.raises(FileExistsError, match="overwrite"):
        fit.write(path)
    fit.write(path, overwrite=True)
    assert [file.name for file in tmp_path.iterdir()] == ["fit.fits"]


def test_units_are_those_of_astropy(fit, tmp_path):
    for one in (fit, TPFFit.read(fit.write(tmp_path / "fit.fits"))):
        flux = one.cadences["flux"].quantity
        np.testing.assert_allclose(flux.to_value(u.electron / u.hour), 3600 * fit.flux)
    assert fits.getheader(tmp_path / "fit.fits", "CADENCES")["TUNIT1"] == "d"


def test_file_of_a_telescope_on_the_ground(tmp_path):
    """Its detector has effects of the atmosphere."""
    scene = Star(17.0), Detector.ground(), Motion.ground(20)
    with pytest.warns(FitWarning, match="does not describe the pixels: chi-squared .* is 1.5"):
        fit = fit_tpf(simulate(*scene, seed=1).to_tpf(), psf=1, interpixel=0)
    assert fit.detector.effects
    assert TPFFit.read(fit.write(tmp_path / "fit.fits")) == fit


def test_other_files_are_refused(tmp_path):
    path = tmp_path / "other.fits"
    fits.PrimaryHDU().writeto(path)
    with pytest.raises(ValueError, match="is not a fit of this package"):
        TPFFit.read(path)


def test_twin(fit):
    stars, detector, motion = fit.scene()
    twin = simulate(stars, detector, motion, seed=5)
    noise = np.std((twin.flux - twin.model()) / fit.observed_err)
    assert noise == pytest.approx(1, abs=0.02)
    sums = [cube.sum(axis=(1, 2)).mean() for cube in (twin.flux, fit.observed)]
    assert sums[0] == pytest.approx(sums[1], rel=1e-4)
    exact = simulate(*fit.scene(signal="fitted"), noise=False)
    fitted = fit.fitted - fit.background[:, None, None]
    np.testing.assert_allclose(exact.flux, fitted, rtol=1e-5, atol=1e-2)


def test_twin_keeps_the_identity_of_the_star(observation, tmp_path):
    facts = {"target_id": 77, "object_name": "a star", "ra": 40.0, "dec": -5.0, "row": 31}
    facts |= {"column": 0, "orientation": 25.0, "campaign": 4, "channel": 48}
    tpf = observation.to_tpf(metadata=facts)[:40]
    with pytest.warns(FitWarning):  # one component is too few, which does not matter here
        scene = fit_tpf(tpf, psf=1).scene()
    assert isinstance(scene, Scene)
    given = {name: getattr(scene, name) for name in facts if name not in {"campaign", "channel"}}
    assert given.pop("orientation") == pytest.approx(25.0)
    assert given == {name: facts[name] for name in given}
    assert scene.metadata == {"campaign": 4, "channel": 48}
    header = fits.getheader(simulate(scene, seed=1).write(tmp_path / "twin.fits"))
    assert (header["KEPLERID"], header["OBJECT"], header["CAMPAIGN"]) == (77, "a star", 4)


def test_scene_options(fit):
    stars, _, motion = fit.scene(positions="path", signal="constant")
    assert stars[0].signal is None
    assert np.abs(motion.x - (fit.x - np.median(fit.x))).max() < 1e-3
    with pytest.raises(ValueError, match="`positions` must be"):
        fit.scene(positions="there")
    with pytest.raises(ValueError, match="`signal` must be"):
        fit.scene(signal="loud")


def test_figure(fit):
    axes = fit.plot()
    names = ["chi2", "data", "model", "positions", "psf", "residual", "sensitivity"]
    assert sorted(axes) == names
    scales = {id(axes[name].images[0].norm) for name in ("data", "model")}
    assert len(scales) == 1
    # The residual has a linear scale of its own, symmetric about 0.
    norm = axes["residual"].images[0].norm
    assert (
        norm.vmax == -norm.vmin == pytest.approx(np.abs(np.nanmedian(fit.residual, axis=0)).max())
    )
    np.testing.assert_array_equal(axes["chi2"].images[0].get_array(), fit.chi2_pixels)
    for ax in axes.values():
        assert ax.get_xlabel()
        assert ax.get_ylabel()
    plt.close("all")


def test_figure_without_a_sensitivity_has_the_light_curve(observation):
    with pytest.warns(FitWarning, match="a response within pixels would lower chi-squared"):
        axes = fit_tpf(observation.to_tpf()[:60], 2).plot()
    names = ["chi2", "data", "light curve", "model", "positions", "psf", "residual"]
    assert sorted(axes) == names
    assert axes["light curve"].get_xlabel() == "Time (BKJD)"
    plt.close("all")


def test_figure_with_pixels_that_are_left_out():
    tpf = simulate(Star(12.0), Detector.k2(shape=(7, 7)), Motion.k2_roll(30), seed=1).to_tpf()
    tpf.hdu[1].data["FLUX"][:, :, 0] = np.nan
    axes = fit_tpf(tpf, 1).plot()
    assert np.isnan(axes["data"].images[0].get_array()[:, 0].filled(np.nan)).all()
    plt.close("all")


def test_twin_figure_shows_the_series_and_not_the_outliers():
    curve = 1 + 0.01 * np.sin(np.arange(400))
    wild = curve.copy()
    wild[7] = 5
    axes = plot_twin(np.arange(400), [wild, curve], [curve, curve], [np.eye(3), np.ones((3, 3))])
    assert axes["raw"].get_ylim()[1] < 1.1
    assert axes["real"].images[0].get_clim() == axes["twin"].images[0].get_clim()
    plt.close("all")


def test_twin_has_the_noise_of_the_file(observation):
    """Noise that the headers do not give is measured in the faint pixels."""
    tpf = observation.to_tpf()
    extra = 12.0 * np.random.default_rng(1).standard_normal(tpf.flux.shape)
    fit = fit_tpf(tpf + extra, 2, flux_err=np.hypot(tpf.flux_err.value, 12.0))
    detector = fit.scene()[1]
    expected = np.hypot(90.0, 12.0 * detector.exposure_time / detector.n_reads**0.5)
    assert detector.read_noise == pytest.approx(expected, rel=0.03)
    assert Detector.from_tpf(tpf, psf=None, sensitivity=None).read_noise == 90.0


def test_drift_of_the_residuals_is_no_noise_of_the_twin(fit):
    drift = 50.0 * np.arange(len(fit.time))[:, None, None]
    drifting = fit.replace(observed=fit.observed + drift)
    assert drifting.scene()[1].read_noise == pytest.approx(fit.scene()[1].read_noise)


def test_command(observation, tmp_path, capsys):
    path, output = tmp_path / "star.fits", tmp_path / "fit.fits"
    observation.write(path)
    command = ["fit", str(path), "--components", "2", "--output", str(output)]
    assert main([*command, "--cadences", "60", "--sensitivity"]) == 0
    assert "chi-squared per degree of freedom" in capsys.readouterr().out
    assert len(TPFFit.read(output).time) <= 60
    assert main(command) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert main(["fit", str(tmp_path / "none.fits"), "--output", str(tmp_path / "a.fits")]) == 2


def test_scene_keeps_the_star(observation, curvature):
    """The twin has the identity and the place of the star, in the file too."""
    tpf = observation.to_tpf(metadata={"target_id": 4321, "ra": 12.5, "dec": -3.25})
    scene = fit_tpf(tpf[:60], 2, curvature).scene()
    assert isinstance(scene, Scene)
    assert scene.target_id == 4321
    assert (scene.ra, scene.dec) == pytest.approx((12.5, -3.25))
    twin = simulate(scene.replace(seed=5)).to_tpf()
    assert (twin.column, twin.row) == (tpf.column, tpf.row)


def test_summary(fit):
    text = fit.summary()
    assert "converged after" in text
    assert "motion along x: 1.0" in text
    assert "sigma_x_0" in text
    assert "ax0                           1 fixed" in text


def test_focus():
    """The width that a simulation changes comes back, and the twin has it again."""
    focus = Focus(0.01, period=3.0)
    detector = Detector.k2(shape=(9, 9), interpixel_scatter=0, sensitivity=None, well_depth=None)
    motion = Motion.k2_roll(240)
    observation = simulate(Star(12.5, 4.1, 3.9), detector, motion, seed=2, effects=[focus])
    tpf = observation.to_tpf()
    fit = fit_tpf(tpf, 1, interpixel=0, options=FitOptions(focus=0.5, saturation=False))
    used = np.isin(observation.cadenceno, fit.cadenceno)
    truth = observation.truth.columns["FOCUS"][used]
    assert fit.focus.mean() == pytest.approx(1, abs=1e-9)
    relative = fit.focus - truth / truth.mean()
    assert relative.std() < 0.01 * truth.std()
    for name in ("sigma_x", "sigma_y"):
        assert fit.values[name] == pytest.approx(0.5 * truth.mean(), rel=1e-4)
        assert fit.errors[name] < 2e-5
    assert abs(fit.reduced_chi2 - 1) < 5 * np.sqrt(2 / fit.dof)
    with pytest.warns(FitWarning, match="does not describe the pixels"):
        constant = fit_tpf(tpf, 1, interpixel=0, options=FitOptions(saturation=False))
    assert fit.reduced_chi2 < 0.1 * constant.reduced_chi2
    scene = fit.scene()
    np.testing.assert_allclose(scene.effects[0].series, fit.focus)
    assert simulate(scene.replace(seed=3)).truth.columns["FOCUS"].std() > 0.005


def test_focus_needs_a_width(observation):
    with pytest.raises(ValueError, match="`focus` needs a PSF with a width"):
        fit_tpf(observation.to_tpf(), MoffatPSF(), options=FitOptions(focus=1.0))


def test_shape_and_image_of_the_psf():
    psf = BivariateGaussianPSF(sigma_x=0.6, sigma_y=0.45, rho=0.3)
    detector = Detector.k2(shape=(9, 9), interpixel_scatter=0)
    motion = 2 * Motion.k2_roll(60)
    fit = fit_tpf(simulate(Star(13.0, psf=psf), detector, motion, seed=1).to_tpf(), psf=1)
    shape = fit.psf_shape()
    values, vectors = np.linalg.eigh([[0.36, 0.081], [0.081, 0.2025]])
    minor, major = 2 * np.sqrt(2 * np.log(2) * values)
    angle = np.degrees(np.arctan(vectors[1, 1] / vectors[0, 1]))
    truth = [np.sqrt(major * minor), major, minor, 1 - minor / major, angle]
    assert np.max(np.abs(shape["value"] - truth) / shape["error"]) < 3
    assert (shape["error"][:4] < 0.005).all()
    offset, density, error = fit.psf_image(1.0, 5)
    assert offset.tolist() == [-1, -0.5, 0, 0.5, 1]
    assert density[2, 2] == 1
    true = psf(*np.meshgrid(offset, offset)) / psf(0, 0)
    assert np.all(np.abs(density / true - 1) < 0.02)
    assert np.all((error > 0) & (error < 0.01))
    with pytest.raises(ValueError, match="`half` must be positive"):
        fit.psf_image(-1)
