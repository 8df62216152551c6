"""CDPP against lightkurve, closed forms and hand-made series; apertures against brute force."""

import itertools

import numpy as np
import pytest
from astropy import units as u
from numpy.testing import assert_allclose, assert_array_equal
from scipy.signal import savgol_coeffs

from scope_models.photometry import (
    LONG_CADENCE,
    aperture_flux,
    cdpp,
    circular_aperture,
    contamination_aperture,
    crowding,
    flux_fraction,
    moving_aperture,
    signal_to_noise_aperture,
    threshold_aperture,
)


@pytest.fixture(scope="module")
def white_noise():
    return np.random.default_rng(42).normal(1, 100e-6, size=(200, 1000))


@pytest.fixture(scope="module")
def lk():
    return pytest.importorskip("lightkurve")


def _awkward_series():
    """A trend, a gap, outliers and missing points."""
    time = np.delete(np.arange(2000), slice(900, 1100)) * LONG_CADENCE
    flux = np.random.default_rng(3).normal(5e4, 12, size=len(time)) * (1 + 0.01 * np.sin(time))
    flux[[50, 400, len(flux) - 1]] *= [2, 0.9, 1.01]
    flux[700:703] = np.nan
    return time, flux


@pytest.mark.parametrize("n_window", [1, 7, 13, 25])
def test_cdpp_is_lightkurves_number(lk, n_window):
    time, flux = _awkward_series()
    lc = lk.LightCurve(time=time, flux=flux)
    duration = n_window * LONG_CADENCE * u.day
    assert_allclose(
        cdpp(lc, duration), lc.estimate_cdpp(transit_duration=n_window).value, rtol=1e-8
    )


def test_cdpp_filter_window_is_lightkurves_savgol_window(lk):
    time, flux = _awkward_series()
    lc = lk.LightCurve(time=time, flux=flux)
    assert_allclose(cdpp(lc, filter_window=51), lc.estimate_cdpp(savgol_window=51).value, rtol=1e-8)


def test_cdpp_of_short_cadence_scales_the_windows(lk):
    """Two-minute cadences: 6.5 h are 195 cadences and 101 long cadences 1485 (odd)."""
    time = np.arange(5000) * 120 / 86400
    lc = lk.LightCurve(time=time, flux=np.random.default_rng(0).normal(1, 1e-3, size=5000))
    expected = lc.estimate_cdpp(transit_duration=195, savgol_window=1485).value
    assert_allclose(cdpp(lc), expected, rtol=1e-8)
    assert_allclose(cdpp(lc.flux, cadence=2 * u.min), expected, rtol=1e-8)


def test_cdpp_of_a_real_light_curve(lk, shared_data):
    path = next((shared_data / "kepler_tpf").glob("*.fits.gz"))
    lc = lk.read(path).to_lightcurve()
    # lightkurve computes in single precision here
    assert_allclose(cdpp(lc), lc.estimate_cdpp(transit_duration=13).value, rtol=2e-3)


def test_cdpp_white_noise_lightkurve(white_noise):
    """The running mean of the filtered noise has the variance of a linear filter."""
    one = np.zeros(401)
    one[200] = 1
    kernel = np.convolve(one - np.convolve(one, savgol_coeffs(101, 2), "same"), np.ones(13) / 13)
    expected = 100 * np.sqrt(np.sum(kernel**2))
    values = cdpp(white_noise)
    assert values.shape == (200,)
    assert_allclose(expected, 23.3, atol=0.3)
    assert_allclose(values.mean(), expected, rtol=0.015)
    assert_allclose(values.mean(), 23.1, atol=0.4)  # measured elsewhere, from other draws


def test_cdpp_white_noise_everest(white_noise):
    assert_allclose(cdpp(white_noise, method="everest").mean(), 25.7, atol=0.4)


def test_cdpp_everest_by_hand():
    """Plain loops over a series that the filter and the clip leave alone."""
    flux = np.random.default_rng(5).normal(1, 1e-3, size=40)
    windows = [np.std(flux[i : i + 13] / np.median(flux)) for i in range(len(flux) - 12)]
    assert_allclose(
        cdpp(flux, method="everest"), 1e6 * np.median(windows) / np.sqrt(13), rtol=1e-12
    )


def test_cdpp_everest_of_as_many_cadences_as_its_window():
    flux = 1 + 1e-4 * np.random.default_rng(5).normal(size=51)
    whole, shorter = cdpp(flux, method="everest"), cdpp(flux[:50], method="everest")
    assert shorter == pytest.approx(whole, rel=0.1)


def test_cdpp_everest_clips_outliers_and_ignores_slow_trends(white_noise):
    flux = white_noise[0]
    clean = cdpp(flux, method="everest")
    spiked = flux.copy()
    spiked[[100, 400, 900]] += 0.01
    trend = flux * (1 + 0.01 * np.linspace(-1, 1, len(flux)) ** 2)
    assert_allclose(cdpp(trend, method="everest"), clean, rtol=0.01)
    assert_allclose(cdpp(spiked, method="everest"), clean, rtol=0.15)


@pytest.mark.parametrize("method", ["lightkurve", "everest"])
def test_cdpp_scaling(white_noise, method):
    """Proportional to the noise, independent of the flux unit; gaps of NaN are left out."""
    flux = white_noise[1]
    one = cdpp(flux, method=method)
    assert isinstance(one, float)
    assert_allclose(cdpp(1 + 3 * (flux - 1), method=method), 3 * one, rtol=1e-3)
    assert_allclose(cdpp(flux * 1e5 * u.electron / u.s, method=method), one, rtol=1e-9)
    holes = flux.copy()
    holes[[3, 500, 777]] = np.nan
    assert_allclose(cdpp(holes, method=method), one, rtol=0.05)
    assert_allclose(cdpp(np.ma.masked_invalid(holes), method=method), cdpp(holes, method=method))
    assert_allclose(cdpp(flux, 6.5 * u.hour, method), one)
    assert_allclose(cdpp(flux, 390 * u.min, method, cadence=29.42394 * u.min), one)


def test_cdpp_of_noiseless_flux_is_zero():
    assert cdpp(np.ones(500), method="everest") < 1e-6
    assert cdpp(np.full(500, 3.0)) < 1e-6


@pytest.mark.parametrize(
    "arguments, message",
    [
        ({"method": "kepler"}, "`method` must be one of lightkurve, everest, got 'kepler'"),
        ({"duration": 0}, "`duration` must be positive, got 0"),
        ({"duration": np.nan}, "`duration` must be finite, got nan"),
        ({"duration": 0.1}, "`duration` must be at least half a cadence"),
        ({"cadence": -1}, "`cadence` must be positive, got -1"),
        ({"filter_window": 1}, "`filter_window` must be at least 3, got 1"),
        ({"filter_window": 10}, "`filter_window` must be odd and at least 3, got 10"),
        ({"duration": 200}, "must have at least 816 finite cadences, got 500"),
    ],
)
def test_cdpp_bad_arguments(arguments, message):
    with pytest.raises(ValueError, match=message):
        cdpp(np.ones(500), **arguments)


@pytest.mark.parametrize(
    "flux, message",
    [
        (np.zeros(500), "median of `lc_or_flux` must be positive"),
        (np.full(500, np.nan), "at least 26 finite cadences, got 0"),
        (np.ones((2, 2, 500)), "must have one or two dimensions"),
    ],
)
def test_cdpp_bad_flux(flux, message):
    with pytest.raises(ValueError, match=message):
        cdpp(flux)


def test_cdpp_needs_times_that_increase(lk):
    lc = lk.LightCurve(time=np.zeros(100), flux=np.ones(100))
    with pytest.raises(ValueError, match="`cadence` cannot be derived from the times"):
        cdpp(lc)


# -- apertures -----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def scene():
    """Target and neighbor images of circular Gaussians (sampled: the shape is what matters)."""
    y, x = np.mgrid[:9, :9]

    def image(flux, x_0, y_0, sigma=0.8):
        r2 = (x - x_0) ** 2 + (y - y_0) ** 2
        return flux * np.exp(-r2 / 2 / sigma**2) / (2 * np.pi * sigma**2)

    return image(1e4, 4.1, 3.8), image(2e4, 6.8, 5.1)


def test_threshold_aperture_follows_the_star(scene):
    target, _ = scene
    moved = np.stack([target, np.roll(target, 2, axis=1)])
    mask = threshold_aperture(moved, threshold=50)
    assert_array_equal(mask, (target > 50) | (np.roll(target, 2, axis=1) > 50))
    default = threshold_aperture(target)
    assert_array_equal(default, target > target.max() / 1000)


def test_signal_to_noise_aperture_is_the_best_of_all():
    """Against all 2^9 masks of a small image."""
    target = np.array([[3.0, 40, 9], [30, 900, 300], [2, 60, 80]])
    other = np.array([[0.0, 0, 100], [0, 10, 900], [0, 0, 50]])
    kwargs = {"neighbors": other, "background": 20.0, "read_noise": 90.0, "n_frames": 10}
    mask = signal_to_noise_aperture(target, 60.0, **kwargs)
    variance = (target + other + 20) / 60 + 10 * (90 / 60) ** 2
    best = max(
        (np.array(m, dtype=bool) for m in itertools.product([0, 1], repeat=9) if any(m)),
        key=lambda m: target.ravel()[m].sum() / np.sqrt(variance.ravel()[m].sum()),
    )
    assert_array_equal(mask, best.reshape(3, 3))


def test_signal_to_noise_aperture_shrinks_with_noise_and_avoids_neighbors(scene):
    target, other = scene
    sizes = [
        signal_to_noise_aperture(target, 1600, background=b, read_noise=90, n_frames=270).sum()
        for b in (1, 100, 1000, 30000)
    ]
    assert sizes == sorted(sizes, reverse=True)
    assert sizes[-1] < sizes[0]
    crowded = signal_to_noise_aperture(target, 1600, neighbors=other)
    assert crowded.sum() < signal_to_noise_aperture(target, 1600).sum()
    assert not crowded[5, 7]


def test_contamination_aperture(scene):
    target, other = scene
    mask = contamination_aperture(target, other, threshold=20)
    assert_array_equal(mask, (target > 20) & (target > other))
    strict = contamination_aperture(target, other, threshold=20, min_fraction=0.95)
    assert strict.sum() < mask.sum()
    assert crowding(target, other, strict) > crowding(target, other, mask)


def test_arguments_that_are_refused():
    with pytest.raises(TypeError, match=r"`shape` must be two integers \(ny, nx\), got 5"):
        circular_aperture(5, 2, 2, 1)
    with pytest.raises(ValueError, match="`method` must be one of lightkurve, everest, got"):
        cdpp(np.ones(500), method=np.array(["lightkurve", "everest"]))
    with pytest.raises(TypeError, match=r"`filter_window` must be an integer, got '101'"):
        cdpp(np.ones(500), filter_window="101")
    with pytest.raises(ValueError, match=r"`flux_err` must have shape \(2, 1, 2\), got \(2,\)"):
        aperture_flux(np.ones((2, 1, 2)), np.array([[True, True]]), [1.0, 1.0])
    with pytest.raises(ValueError, match=r"`flux` must have the shape \(n_c.*got \(1, 2\)"):
        aperture_flux(np.ones((1, 2)), np.array([[True, True]]))


def test_one_error_for_all_pixels():
    flux, error = aperture_flux(np.ones((3, 1, 2)), np.array([[True, True]]), 2.0)
    assert_allclose(flux, 2.0)
    assert_allclose(error, 8**0.5)


def test_circular_aperture():
    y, x = np.mgrid[:7, :6]
    inside = np.hypot(x - 2.3, y - 3.4)
    mask = circular_aperture((7, 6), 2.3, 3.4, 2.0)
    assert mask.shape == (7, 6)
    assert mask[inside < 1.2].all()
    assert not mask[inside > 2.8].any()
    assert_array_equal(circular_aperture((5, 5), 2, 2, 0.5, min_overlap=0.7).sum(), 1)
    assert circular_aperture((5, 5), 0, 0, 2.1)[0, 0]  # over the edge


def test_masks_are_taken_by_lightkurve(lk, shared_data):
    tpf = lk.read(next((shared_data / "kepler_tpf").glob("*.fits.gz")))
    mask = threshold_aperture(np.nanmedian(tpf.flux.value, axis=0), 500)
    assert np.isfinite(tpf.to_lightcurve(aperture_mask=mask).flux.value).any()


def test_crowding_and_flux_fraction(scene):
    target, other = scene
    mask = threshold_aperture(target, 50)
    expected = target[mask].sum() / (target + other)[mask].sum()
    assert_allclose(crowding(target, other, mask), expected, rtol=1e-12)
    assert_allclose(crowding(np.stack([target] * 3), other, mask), expected, rtol=1e-12)
    assert crowding(target, None, mask) == 1.0
    assert_allclose(flux_fraction(target, mask), target[mask].sum() / target.sum(), rtol=1e-12)
    assert_allclose(
        flux_fraction(np.stack([target, target]), mask, total=[1e4, 1e4]),
        target[mask].sum() / 1e4,
        rtol=1e-12,
    )


def test_missing_pixels_are_never_in_an_aperture(scene):
    target = scene[0].copy()
    target[4, 4] = np.nan
    assert not threshold_aperture(target, 10)[4, 4]
    assert not signal_to_noise_aperture(target, 100)[4, 4]


IMAGE = np.ones((3, 3))


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda: threshold_aperture(IMAGE, 5), "no pixel exceeds `threshold` of 5 e-/s"),
        (lambda: threshold_aperture(IMAGE, 0), "`threshold` must be positive, got 0"),
        (lambda: threshold_aperture(np.ones(3)), r"`target` must have shape \(ny, nx\)"),
        (lambda: signal_to_noise_aperture(0 * IMAGE, 1), "`target` has no light"),
        (lambda: signal_to_noise_aperture(IMAGE, 0), "`exposure_time` must be positive, got 0"),
        (lambda: signal_to_noise_aperture(IMAGE, 1, read_noise=-1), "must not be negative"),
        (lambda: signal_to_noise_aperture(IMAGE, 1, background=np.nan), "must not be negative"),
        (lambda: signal_to_noise_aperture(IMAGE, 1, n_frames=0), "`n_frames` must be at least 1"),
        (lambda: contamination_aperture(IMAGE, 2 * IMAGE), "neighbors dominate every pixel"),
        (lambda: contamination_aperture(IMAGE, np.ones((2, 2))), r"must have \(3, 3\) pixels"),
        (
            lambda: contamination_aperture(IMAGE, IMAGE, min_fraction=2),
            "`min_fraction` must not be above 1, got 2",
        ),
        (lambda: circular_aperture((3, 3), 1, 1, 0), "`radius` must be positive, got 0"),
        (lambda: circular_aperture((3, 3), 10, 1, 1), "no pixel of"),
        (
            lambda: circular_aperture((3, 3), 1, 1, 1, min_overlap=0),
            "`min_overlap` must be positive",
        ),
        (lambda: crowding(IMAGE, None, IMAGE), "`aperture` must be a boolean mask"),
        (lambda: crowding(IMAGE, None, IMAGE > 1), "`aperture` has no pixels"),
        (lambda: crowding(0 * IMAGE, None, IMAGE > 0), "`target` has no light in `aperture`"),
        (lambda: flux_fraction(IMAGE, IMAGE > 0, total=0), "`total` flux of the target must be"),
    ],
)
def test_bad_apertures(call, message):
    with pytest.raises(ValueError, match=message):
        call()


class TestMovingAperture:
    def test_is_centered_on_the_star(self):
        x, y = np.array([7.0, 8.3, 6.1]), np.array([7.2, 6.6, 8.0])
        weights = moving_aperture((15, 15), x, y, 2.5, edge=0.5)
        rows, columns = np.indices((15, 15))
        total = weights.sum(axis=(1, 2))
        np.testing.assert_allclose((weights * columns).sum(axis=(1, 2)) / total, x, atol=0.02)
        np.testing.assert_allclose((weights * rows).sum(axis=(1, 2)) / total, y, atol=0.02)

    def test_area_grows_with_the_radius(self):
        radius = np.array([2.0, 3.0, 4.0])
        weights = moving_aperture((15, 15), np.full(3, 7.2), np.full(3, 6.9), radius, edge=0.3)
        # the integral of the weights over the plane is pi (r^2 + (pi e)^2 / 3)
        expected = np.pi * (radius**2 + (np.pi * 0.3) ** 2 / 3)
        np.testing.assert_allclose(weights.sum(axis=(1, 2)), expected, rtol=0.02)

    def test_holds_a_star_that_a_fixed_aperture_loses(self):
        x = np.linspace(3.0, 12.0, 40)
        rows, columns = np.indices((9, 16))
        images = np.exp(-0.5 * ((columns - x[:, None, None]) ** 2 + (rows - 4) ** 2) / 0.8**2)
        fixed = circular_aperture((9, 16), 7.5, 4, 3.0)
        moving = moving_aperture((9, 16), x, 4.0, 3.0)
        assert np.ptp(aperture_flux(images, fixed)) > 1
        assert np.ptp(aperture_flux(images, moving)) < 0.01 * aperture_flux(images, moving)[0]

    def test_unknown_position_gives_nan(self):
        weights = moving_aperture((5, 5), [2.0, np.nan], [2.0, 2.0], 1.5)
        assert np.isfinite(weights[0]).all()
        assert np.isnan(aperture_flux(np.ones((2, 5, 5)), weights)[1])

    @pytest.mark.parametrize(
        ("arguments", "match"),
        [(([1.0], [1.0], 0.0), "`radius` must be positive"),
         (([1.0], [1.0], [1.0, 2.0]), "one number per cadence")],
    )  # fmt: skip
    def test_bad_arguments(self, arguments, match):
        with pytest.raises(ValueError, match=match):
            moving_aperture((5, 5), *arguments)


class TestApertureFlux:
    def test_mask_and_equal_weights_agree(self):
        rng = np.random.default_rng(1)
        flux, error = rng.normal(100, 1, (4, 3, 3)), rng.uniform(1, 2, (4, 3, 3))
        mask = np.eye(3, dtype=bool)
        weights = np.broadcast_to(mask, flux.shape)
        for one, other in zip(
            aperture_flux(flux, mask, error), aperture_flux(flux, weights, error), strict=True
        ):
            np.testing.assert_allclose(one, other)
        np.testing.assert_allclose(
            aperture_flux(flux, mask, error)[1] ** 2, np.einsum("nii->n", error**2)
        )

    def test_pixels_without_weight_may_be_nan(self):
        flux = np.array([[[1.0, np.nan]], [[1.0, 2.0]]])
        np.testing.assert_array_equal(aperture_flux(flux, [[[1, 0]], [[1, 1]]]), [1.0, 3.0])
        assert np.isnan(aperture_flux(flux, np.array([[True, True]]))[0])

    def test_shapes_must_agree(self):
        with pytest.raises(ValueError, match="`aperture` must have shape"):
            aperture_flux(np.ones((2, 3, 3)), np.ones((2, 2), bool))
