"""Fits of several stars and of several files, against the truth of simulations and real pixels."""

import warnings

import numpy as np
import pytest
from astropy import units as u
from astropy.table import Table

from scope_models import (
    PRF,
    BivariateGaussianPSF,
    Detector,
    Motion,
    Scene,
    Star,
    TPFFit,
    fit_tpf,
    simulate,
)
from scope_models.exceptions import FitWarning
from scope_models.fitting import FitOptions
from scope_models.io import read_pixels

DETECTOR = Detector.k2(shape=(9, 11), interpixel_scatter=0, sensitivity=None, well_depth=None)
EACH, FEW = FitOptions(neighbor_flux="cadence"), FitOptions(max_steps=5)
PLACES = [(3.2, 4.1), (6.6, 4.4)]


@pytest.fixture(scope="module")
def pair():
    """Two stars that move together, the second with a signal of its own."""
    motion = 2 * Motion.k2_roll(120)
    signal = 1 + 0.02 * np.sin(np.arange(120))
    stars = Star(12.0, *PLACES[0]), Star(12.6, *PLACES[1], signal=signal)
    return simulate(stars, DETECTOR, motion, seed=4)


@pytest.mark.parametrize("name", ["stars", "neighbors"])
def test_the_target_is_the_star_at_the_coordinates(name):
    """A brighter star is in the aperture, too."""
    stars = Star(13.0, *PLACES[0]), Star(12.0, 7.4, 4.4)
    sky = Scene(stars, DETECTOR, 2 * Motion.k2_roll(60), ra=130.0, dec=18.0, seed=4)
    tpf = simulate(sky).to_tpf()
    tpf.hdu[2].data[:] = 3
    fit = fit_tpf(tpf, 1, interpixel=0, options=FEW, **{name: "find"})
    assert np.median(fit.x) == pytest.approx(PLACES[0][0], abs=0.1)
    assert len(fit.neighbors) == 1
    for hdu in tpf.hdu[:2]:  # 5 px to the left: no star is there
        hdu.header["RA_OBJ"] += 5 * 3.98 / 3600 / np.cos(np.radians(18))
    fit = fit_tpf(tpf, 1, interpixel=0, options=FEW, **{name: "find"})
    assert np.median(fit.x) == pytest.approx(7.4, abs=0.1)


def truth_of(observation, name, star):
    truth = observation.truth
    if name == "flux":
        return truth.flux[star] * truth.relative_flux[star]
    return getattr(truth, name)[star]


def pulls(values, errors, truth):
    return (values - truth) / errors


@pytest.mark.parametrize("how", ["stars", "neighbors", "quantity", "table", "sky", "find"])
def test_two_stars(pair, how):
    tpf = pair.to_tpf(metadata={"ra": 10.0, "dec": 5.0})
    given = {
        "stars": {"stars": PLACES},
        "neighbors": {"neighbors": [PLACES[1]]},
        "quantity": {"stars": PLACES * u.pix},
        "table": {"neighbors": Table({"x": [PLACES[1][0]], "y": [PLACES[1][1]]})},
        "find": {"stars": "find"},
    }
    if how == "sky":
        given["sky"] = {"neighbors": tpf.wcs.pixel_to_world(*PLACES[1])}
    fit = fit_tpf(tpf, 1, **given[how])
    used = np.isin(pair.cadenceno, fit.cadenceno)
    assert fit.converged
    assert abs(fit.reduced_chi2 - 1) < 5 * np.sqrt(2 / fit.dof)
    (neighbor,) = fit.neighbors
    for star, k in ((fit, 0), (neighbor, 1)):
        for name in ("x", "y", "flux"):
            truth = truth_of(pair, name, k)[used]
            values, errors = getattr(star, name), getattr(star, f"{name}_err")
            if fit.options["interpixel"] and name == "flux":
                continue  # the mean response of each star's pixels is not known
            assert np.abs(pulls(values, errors, truth)).max() < 6, (k, name)
    assert fit.values["x_star_1"] == pytest.approx(PLACES[1][0] - PLACES[0][0], abs=1e-3)


def test_a_close_neighbor():
    """Also where its light moves the centroid."""
    place = (PLACES[0][0] + 0.9, PLACES[0][1] + 0.8)
    stars = Star(12.0, *PLACES[0]), Star(12.6, *place)
    observation = simulate(stars, DETECTOR, Motion.k2_roll(60), seed=4)
    fit, messages = messages_of(observation.to_tpf(), 1, neighbors=[place], interpixel=0)
    assert messages == ""
    used = np.isin(observation.cadenceno, fit.cadenceno)
    for k, star in enumerate((fit, *fit.neighbors)):
        truth = truth_of(observation, "flux", k)[used]
        assert np.abs(pulls(star.flux, star.flux_err, truth)).max() < 5


@pytest.mark.parametrize("place", [PLACES[1], (5.4, 4.4)])  # the second beside the target's pixel
@pytest.mark.parametrize("how", ["pixels", "sky", "find"])
def test_a_brighter_neighbor(place, how):
    scene = Scene(
        [Star(15.0, *PLACES[0]), Star(13.0, *place)], DETECTOR, Motion.k2_roll(60), seed=1,
        ra=10.0, dec=5.0,
    )  # fmt: skip
    observation = simulate(scene)
    tpf = observation.to_tpf()
    given = {"pixels": [place], "sky": tpf.wcs.pixel_to_world(*place), "find": "find"}
    fit = fit_tpf(tpf, 1, neighbors=given[how], interpixel=0)
    (neighbor,) = fit.neighbors
    for k, star in enumerate((fit, neighbor)):
        assert np.median(star.flux) == pytest.approx(observation.truth.flux[k], rel=1e-3)


def test_catalogs_may_hold_the_target():
    """On the sky it is where the coordinates of the file are, wherever the telescope points."""
    motion = Motion.still(40)
    scene = Scene(
        [Star(12.0, *PLACES[0]), Star(13.0, *PLACES[1])], DETECTOR,
        motion.replace(x=np.full(40, 0.7)), seed=1, ra=10.0, dec=5.0,
    )  # fmt: skip
    tpf = simulate(scene).to_tpf()
    moved = np.add(PLACES, [[0.36, 0.0], [0.0, 0.0]])  # as a star with a large proper motion
    catalog = tpf.wcs.pixel_to_world(*moved.T)
    for neighbors in (catalog, Table({"ra": catalog.ra, "dec": catalog.dec})):
        fit = fit_tpf(tpf, 1, neighbors=neighbors, interpixel=0)
        assert len(fit.neighbors) == 1
        assert fit.values["x_star_1"] == pytest.approx(PLACES[1][0] - PLACES[0][0], abs=1e-3)


def test_constant_neighbor():
    stars = Star(12.0, *PLACES[0]), Star(15.0, *PLACES[1])
    observation = simulate(stars, DETECTOR, 2 * Motion.k2_roll(120), seed=4)
    tpf = observation.to_tpf()
    fit = fit_tpf(tpf, 1, neighbors=[PLACES[1]], interpixel=0)
    assert np.ptp(fit.neighbors[0].flux) == 0
    error = fit.errors["flux_star_1"]
    assert abs(fit.values["flux_star_1"] - observation.truth.flux[1]) < 5 * error
    free = fit_tpf(tpf, 1, neighbors=[PLACES[1]], interpixel=0, options=EACH)
    assert np.ptp(free.neighbors[0].flux) > 0
    assert free.chi2 < fit.chi2


def test_neighbor_is_kept_in_the_file(pair, tmp_path):
    fit = fit_tpf(pair.to_tpf(), 1, stars=PLACES, interpixel=0)
    again = TPFFit.read(fit.write(tmp_path / "fit.fits"))
    np.testing.assert_array_equal(again.neighbors[0].flux, fit.neighbors[0].flux)
    assert again.at_bounds == fit.at_bounds


def test_several_files():
    """One PSF and one motion in two stamps, with the errors of both together."""
    motion, psf = 2 * Motion.k2_roll(100), BivariateGaussianPSF(1, 0, 0, 0.55, 0.6, 0.2)
    observations = [
        simulate(Star(mag, x, y, psf=psf), DETECTOR, motion, seed=seed)
        for mag, x, y, seed in ((12.5, 5.2, 4.1, 1), (13.0, 4.7, 3.6, 2))
    ]
    tpfs = [observation.to_tpf() for observation in observations]
    fits = fit_tpf(tpfs, 1, interpixel=0)
    alone = fit_tpf(tpfs[0], 1, interpixel=0)
    assert len(fits) == 2
    for fit, observation in zip(fits, observations, strict=True):
        used = np.isin(observation.cadenceno, fit.cadenceno)
        assert fit.converged
        assert abs(fit.reduced_chi2 - 1) < 5 * np.sqrt(2 / fit.dof)
        for name in ("x", "y", "flux"):
            truth = truth_of(observation, name, 0)[used]
            pull = pulls(getattr(fit, name), getattr(fit, f"{name}_err"), truth)
            assert np.abs(pull).max() < 6, name
        for name, truth in (("sigma_x", 0.55), ("sigma_y", 0.6), ("rho", 0.2)):
            assert abs(fit.values[name] - truth) < 4 * fit.errors[name]
    assert fits[0].errors["sigma_x"] < alone.errors["sigma_x"]
    assert np.median(fits[0].x_err) < np.median(alone.x_err)


@pytest.mark.parametrize("positions", ["start", "path"])
def test_motion_of_another_file_is_mapped(positions):
    """A field that rotates and shrinks in the motion of the second file is found."""
    motion = 3 * Motion.k2_roll(60)
    matrix = np.array([[0.8, 0.3], [-0.2, 1.1]])
    x, y = matrix @ [motion.x, motion.y]
    there = Motion(time=motion.time, x=x, y=y, cadenceno=motion.cadenceno, quality=motion.quality)
    observations = [
        simulate(Star(12.5, 5.2, 4.1), DETECTOR, motion, seed=1),
        simulate(Star(12.0, 4.7, 3.6), DETECTOR, there, seed=2),
    ]
    fits = fit_tpf([item.to_tpf() for item in observations], 1, interpixel=0, positions=positions)
    second = fits[1]
    names = ("x_by_x_1", "x_by_y_1", "y_by_x_1", "y_by_y_1")
    for name, truth in zip(names, matrix.ravel(), strict=True):
        assert abs(second.values[name] - truth) < 4 * second.errors[name] < 0.01
    used = np.isin(observations[1].cadenceno, second.cadenceno)
    for name in ("x", "y"):
        truth = truth_of(observations[1], name, 0)[used]
        pull = pulls(getattr(second, name), getattr(second, f"{name}_err"), truth)
        assert np.abs(pull).max() < 5
    assert abs(second.reduced_chi2 - 1) < 5 * np.sqrt(2 / second.dof)


@pytest.mark.slow
def test_seven_real_stars_share_a_psf(shared_data):
    """One PSF for seven files; they move together, as their POS_CORR do, within the errors."""
    paths = sorted((shared_data / "kepler_q12_ch4").glob("*.fits.gz"))
    files = [read_pixels(path, quality_bitmask="default")[::4] for path in paths]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FitWarning)
        fits = fit_tpf(files, 1, empirical=6, interpixel=0, neighbors="find")
    assert fits[0].converged
    first = fits[0].pos_corr - fits[0].pos_corr.mean(axis=0)
    for number, fit in enumerate(fits[1:], start=1):
        other = fit.pos_corr - fit.pos_corr.mean(axis=0)
        expected = np.linalg.lstsq(first, other, rcond=None)[0].T.ravel()
        names = [f"{axis}_by_{of}_{number}" for axis in "xy" for of in "xy"]
        for name, truth in zip(names, expected, strict=True):
            assert abs(fit.values[name] - truth) < 3 * fit.errors[name]
        assert min(fit.path_r2()) > 0.99


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"stars": "all"}, '`stars` must be positions or "find"'),
        ({"stars": [[1, 2, 3]]}, r"`stars` must be finite positions of shape \(k, 2\)"),
        ({"stars": [[1, 2]], "neighbors": [[3, 4]]}, "give either `stars` or `neighbors`"),
        ({"neighbors": [[1, 2]] * u.s}, "`neighbors` must be in pix"),
        ({"neighbors": Table({"a": [1]})}, "must have the columns x and y"),
        ({"stars": [[40, 2]]}, "no pixel is within 2 px of the star"),
    ],
)
def test_bad_places(pair, options, message):
    with pytest.raises(ValueError, match=message):
        fit_tpf(pair.to_tpf(), 1, **options)


def test_no_file():
    with pytest.raises(ValueError, match="at least one file"):
        fit_tpf([])


def test_tess_star_with_its_neighbor(shared_data):
    """The flux of the target agrees with its magnitude; without the neighbor it does not."""
    path = shared_data / "tess_tpf" / "tesssip_tpf1.fits"
    series = read_pixels(path, quality_bitmask="default")
    prf = PRF.from_tess(shared_data / "tess_prf", 2, 3, 1078, 889)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FitWarning)
        fit = fit_tpf(series, prf, stars="find", interpixel=0, options=EACH)
    assert np.median(fit.flux) == pytest.approx(12200, rel=0.02)
    assert len(fit.neighbors) >= 1


def test_neighbors_far_outside_of_the_pixels_are_left_out():
    tpf = simulate(Star(13.0), Detector.k2(shape=(7, 7)), Motion.k2_roll(60), seed=1).to_tpf()
    with pytest.warns(FitWarning, match="1 of `neighbors` are far outside"):
        fit = fit_tpf(tpf, psf=1, neighbors=[(500.0, 4.0)])
    assert not fit.neighbors


def messages_of(*arguments, **options):
    """Fit, and return the fit and the warnings."""
    with warnings.catch_warnings(record=True) as record:
        warnings.simplefilter("always")
        fit = fit_tpf(*arguments, **options)
    assert all(issubclass(item.category, FitWarning) for item in record)
    return fit, " | ".join(str(item.message) for item in record)


def test_shares_of_many_stars_are_warned_of():
    """Stars that nothing but the PSF separates, about one with deep eclipses."""
    generator = np.random.default_rng(1)
    eclipses = 1 - 0.9 * (np.abs(np.arange(50) / 48 % 1.7 - 0.85) < 0.1)
    places = generator.uniform(0, 6, (5, 2))
    others = [Star(generator.uniform(12, 17), *place) for place in places]
    stars = [Star(12.0, 3, 3, signal=eclipses), *others]
    crowd = simulate(stars, Detector.k2(shape=(7, 7)), Motion.k2_roll(50), seed=1)
    fit, messages = messages_of(crowd.to_tpf(), 1, neighbors=places, response="pixels", options=FEW)
    assert "divides the light of several stars between them by the PSF" in messages
    assert np.isfinite(fit.flux).all()
    assert np.isfinite(fit.flux_err).all()


def test_shares_that_take_up_another_star_are_warned_of():
    """Nothing in chi-squared shows it."""
    stars = [Star(12.0 + k, *place) for k, place in enumerate(PLACES)]
    tpf = simulate(stars, DETECTOR, 0.2 * Motion.k2_roll(60), seed=4).to_tpf()
    message = '1 other maximum of the median image may be other stars: neighbors="find"'
    fit, messages = messages_of(tpf, 1, response="pixels")
    assert fit.error_scale == 1
    assert message in messages
    assert message not in messages_of(tpf, 1, stars=PLACES, response="pixels")[1]


def test_the_brightest_are_found():
    places = [(x, y) for x in range(2, 20, 4) for y in range(2, 20, 4)]
    stars = [Star(12 + 0.1 * k, *place) for k, place in enumerate(places)]
    detector = Detector.k2(shape=(20, 20))
    tpf = simulate(stars, detector, Motion.k2_roll(12), seed=1).to_tpf()
    fit, messages = messages_of(tpf, 1, stars="find", interpixel=0, options=FEW)
    assert "the 11 brightest of 25 maxima of the median image are fitted" in messages
    assert len(fit.neighbors) == 10


def test_negative_flux_is_warned_of(pair):
    """A neighbor where there is less than no light."""
    tpf = pair.to_tpf()
    rows, columns = np.indices((9, 11))
    tpf = tpf - 300.0 * (np.hypot(columns - 9, rows - 1) < 1)
    _, messages = messages_of(tpf, 1, stars=[*PLACES, (9, 1)], interpixel=0)
    assert "the flux of neighbor 2 is negative in" in messages


def test_branches_of_flux_are_warned_of(pair):
    """Fluxes that jump where the light in the pixels does not."""
    fit, messages = messages_of(pair.to_tpf(), 1, stars=PLACES, interpixel=0)
    assert "several solutions" not in messages
    jumps = np.where(np.arange(len(fit.time)) % 7 < 3, 0.5, 1.0)
    cadences = fit.cadences.copy()
    cadences["flux"] *= jumps
    doubtful = fit.replace(cadences=cadences)
    assert "the data allow several solutions" in doubtful.summary()
