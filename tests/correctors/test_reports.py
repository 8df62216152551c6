"""What correctors hold before, after and instead of a correction, and what they report."""

import contextlib
import re
import warnings
from dataclasses import replace

import numpy as np
import pytest

from scope_models import Detector, Motion, Star, simulate
from scope_models.correctors import PLDCorrector, PLDFit
from scope_models.correctors import _result as result_module
from scope_models.correctors._model import PLDModel
from scope_models.exceptions import DetrendingWarning
from scope_models.pixelmodel import _pixels as pixels_module


def dips(n, depth=0.01):
    signal = np.ones(n)
    for start in range(30, n - 20, 97):
        signal[start : start + 6] -= depth
    return signal


@pytest.fixture(scope="module")
def star(fake_star):
    return fake_star(400, seed=5)


def test_masks_exist_before_a_correction(star):
    corrector = PLDCorrector(star.tpf)
    for name in ("outlier_mask", "transit_mask"):
        assert getattr(corrector, name).tolist() == [False] * 400
    assert corrector.cadence_mask.all()


@pytest.mark.parametrize("mask", [[True] * 3, np.arange(400) < 20])
def test_a_failing_call_changes_nothing(star, mask):
    corrector = PLDCorrector(star.tpf)
    corrected, raw, result = corrector.correct(), corrector.original_lc, corrector.result
    aperture, outliers = corrector.aperture_mask, corrector.outlier_mask
    with pytest.raises(ValueError, match=r"cadence_mask|30 usable cadences"):
        corrector.correct(cadence_mask=mask)
    assert corrector.corrected_lc is corrected
    assert corrector.original_lc is raw
    assert corrector.result is result
    assert (corrector.aperture_mask == aperture).all()
    assert corrector.outlier_mask is outliers


def test_showing_a_result_corrects_nothing(star, monkeypatch):
    corrector = PLDCorrector(star.tpf)
    signal = np.where(np.arange(400) % 97 < 8, 0.999, 1.0)
    corrector.correct(transit_model=signal)
    result = corrector.result
    with monkeypatch.context() as patch:
        patch.setattr(type(result.model), "from_pixels", None)
        assert "survival" not in str(result) + result._repr_html_()
        meta = result.to_table().meta
    assert np.isnan([meta["transit_survival"], meta["transit_scale"]]).all()
    survival, scale = result.transit_survival, result.transit_scale
    assert f"{survival:.3f} +- {result.transit_survival_err:.3f}" in str(result)
    assert result.to_table().meta["transit_survival"] == survival
    assert result.to_table().meta["transit_scale"] == scale


def test_a_survival_that_cannot_be_had_is_nan_with_a_reason(star, monkeypatch):
    corrector = PLDCorrector(star.tpf)
    corrector.correct()
    result = corrector.result
    signal = np.where(np.arange(400) % 97 < 8, 0.999, 1.0)
    with pytest.raises(ValueError, match="`transit_model` must dim the star"):
        result.survival(2 - signal, depth=0.01)
    assert np.isfinite(result.survival(2 - signal))

    def refused(*_):
        raise ValueError("no light")

    with monkeypatch.context() as patch:
        patch.setattr(type(result.model), "from_pixels", refused)
        with pytest.warns(DetrendingWarning, match=r"survival is NaN: the correction .* no light"):
            assert np.isnan(result.survival())
    monkeypatch.setattr(result_module, "depth_ratio", lambda *_: (1.01, 0.33))
    assert (result.transit_survival, result.transit_survival_err) == (1.01, 0.33)
    for found in ((17.2, 5.0), (1.17, 0.01), (-0.06, 0.01), (0.5, 0.26), (1.0, 0.51)):
        monkeypatch.setattr(result_module, "depth_ratio", lambda *_, found=found: found)
        match = f"survival is NaN: {found[0]:.2f} with a standard deviation"
        with pytest.warns(DetrendingWarning, match=match):
            assert np.isnan(result.survival())


def test_a_depth_is_not_taken_from_wild_cadences():
    """One cadence of next to no light, whose error is as large, and scatter that grows."""
    from scope_models.correctors._signals import depth_ratio

    rng = np.random.default_rng(1)
    signal = np.where(np.arange(400) % 100 // 10 == 5, -0.01, 0.0)
    error = np.full(400, 1e-3)
    flux = 1 + 0.9 * signal + 1e-3 * rng.standard_normal(400)
    found, size = depth_ratio(signal, flux, error)
    assert found == pytest.approx(0.9, abs=4 * size)
    assert size == pytest.approx(1e-3 / 0.01 / np.sqrt(40 * 0.7), rel=0.5)
    flux[152], error[152] = 1e5, 1e6
    assert depth_ratio(signal, flux, error)[0] == pytest.approx(found, abs=0.01)
    assert np.isnan(depth_ratio(np.zeros(400), flux, error)).all()


def test_the_error_of_a_depth_holds_differences_between_events():
    """Each event keeps another part of its depth: the error of the mean is of four numbers."""
    from scope_models.correctors._signals import depth_ratio

    kept = np.array([0.6, 1.0, 0.7, 0.9])
    signal = np.where(np.arange(400) % 100 // 10 == 5, -0.01, 0.0)
    found, size = depth_ratio(signal, np.repeat(kept, 100) * signal, np.ones(400))
    assert found == pytest.approx(kept.mean())
    assert size == pytest.approx(kept.std(ddof=1) / 2)


def test_cadences_that_a_user_masks_are_no_outliers(star):
    corrector = PLDCorrector(star.tpf)
    corrector.correct(cadence_mask=np.arange(400) % 25 > 0)
    assert corrector.result.n_outliers < 4
    assert corrector.result.frequencies == ()


@pytest.mark.parametrize(("ratio", "width"), [(0.0, 1.0), (0.4, 1.0), (0.4, 0.5)])
def test_a_neighbor_that_dilutes_is_reported(fake_star, ratio, width):
    """One magnitude fainter at 2.9 px: the images have one peak, or move by 3 px."""
    signal = dips(400)
    facts = {"shape": (9, 11), "width": width, "motion": 1.0 if width == 1 else 10.0}
    alone, pair = (fake_star(400, seed=5, signal=signal, neighbor=k, **facts) for k in (0, ratio))
    corrector = PLDCorrector(pair.tpf, neighbors=[])
    if ratio:
        with pytest.warns(DetrendingWarning, match=r"\d+ % of the light .* is of other stars"):
            lc = corrector.correct(transit_mask=signal < 1)
    else:
        lc = corrector.correct(transit_mask=signal < 1)
    inside = corrector.aperture_mask
    own, whole = (np.median(star.expected[:, inside].sum(axis=1)) for star in (alone, pair))
    assert corrector.result.crowding == pytest.approx(own / whole, abs=0.05)
    flux = lc.flux.value / np.median(lc.flux.value)
    depth = (np.median(flux[signal == 1]) - np.median(flux[signal < 1])) / 0.01
    assert depth == pytest.approx(own / whole, abs=0.015)
    assert corrector.result.survival(signal) == pytest.approx(depth, abs=0.05)


@pytest.mark.parametrize("depth", [0.003, 0.01])
def test_transits_are_no_outliers(fake_star, depth):
    """Of 3 h; two pairs of cadences that do not last, or brighten, are outliers as before."""
    signal = dips(600, depth)
    signal[[200, 400]] *= 0.97
    signal[[500, 501]] *= 1.03
    corrector = PLDCorrector(fake_star(600, seed=7, signal=signal).tpf)
    lc = corrector.correct()
    assert np.flatnonzero(corrector.outlier_mask).tolist() == [200, 400, 500, 501]
    result = corrector.result
    transit = dips(600) < 1
    assert not result.dips[~transit].any()
    assert not (result.dips & result.used).any()
    flux = lc[~corrector.outlier_mask].flux.value
    seen = np.median(flux[transit[~corrector.outlier_mask]]) / np.median(flux)
    assert 1 - seen == pytest.approx(depth, rel=0.04)


@pytest.mark.parametrize("wild", ["lost", "lost without POS_CORR", "POS_CORR alone"])
@pytest.mark.parametrize("fractions", ["predicted", "measured"])
def test_a_cadence_with_the_star_off_the_stamp_spoils_no_other(fake_star, wild, fractions):
    star = fake_star(400, seed=9)
    before = PLDCorrector(star.tpf).correct(fractions=fractions).flux.value
    table = star.tpf.hdu[1].data
    light = table["FLUX"][250].copy()
    table["POS_CORR1"][250] = np.nan if "without" in wild else 400.0
    if "lost" in wild:
        table["FLUX"][250] = np.abs(np.random.default_rng(1).normal(0, 1, light.shape))
    message = "1 cadences are left out: POS_CORR and light"
    expected_warning = pytest.warns(DetrendingWarning, match=message)
    with expected_warning if wild == "lost" else contextlib.nullcontext():
        corrector = PLDCorrector(star.tpf)
    lc = corrector.correct(fractions=fractions)
    after, error = lc.flux.value, lc.flux_err.value
    others = np.arange(400) != 250
    expected = star.expected.sum(axis=(1, 2))[others]
    scatter = [np.std(np.diff(flux[others])) / np.median(flux[others]) for flux in (before, after)]
    assert scatter[1] == pytest.approx(scatter[0], rel=0.005)
    truth = np.median(expected) if "alone" in wild else 0.0
    assert np.isnan(after[250]) or abs(after[250] - truth) < 5 * error[250]


def test_held_out_windows_may_hold_outliers(fake_star):
    """A window with outliers is predicted as by a fit at the same variances without it."""
    signal = np.ones(400)
    signal[[40, 45, 222]] *= [0.97, 1.02, 1.03]
    corrector = PLDCorrector(fake_star(400, seed=11, signal=signal).tpf)
    corrector.correct()
    everything, solution = np.ones(400, dtype=bool), corrector.result.solution
    residual, error, used = corrector.held_out(13, everything)
    assert used.tolist() == list(range(400))
    assert len(residual) == len(error) == 400 // 13
    window = slice(39, 52)
    use = solution.use.copy()
    use[window] = False
    without = replace(solution, use=use)
    rest = without.unexplained - without.process.predict(without.alpha, without.time)
    assert residual[3] == pytest.approx(rest[window].mean(), rel=1e-4)
    few = corrector.held_out()
    assert few[2].tolist() == np.flatnonzero(corrector.result.used).tolist()
    assert len(few[0]) == corrector.result.n_used // corrector.result.window
    assert error[10] == pytest.approx(few[1][10], rel=0.01)
    with pytest.raises(ValueError, match="`cadences` must have shape"):
        corrector.held_out(13, everything[1:])
    assert len(corrector.held_out(cadences=np.arange(400) < 20)[0]) == 2


def test_errors_of_held_out_windows_are_at_least_the_noise(star, monkeypatch):
    """Rounding can make the variance of windows of cadences without weight negative."""
    corrector = PLDCorrector(star.tpf)
    corrector.correct(order=1)
    result = corrector.result
    n = result.n_used // 13
    noise = result.solution.white_variance[result.used][: 13 * n].reshape(n, 13).sum(axis=1)
    for variance in (-1e-12, 0.0, 1.0):
        dense = np.zeros((n, 13)), np.full((n, 13, 13), variance)
        monkeypatch.setattr(type(result.solution), "held_out", lambda *_, found=dense: found)
        _, error, _ = corrector.held_out(13)
        np.testing.assert_allclose(error, np.sqrt(np.maximum(noise, 169 * variance)) / 13)


@pytest.mark.parametrize(
    ("seen", "match"),
    [
        ((4, 4), None),
        ((2, 2), r"holds \d+ % of the light in the pipeline's: compare `aperture_mask=\"pip"),
        ((4, 4, 40), r"has \d+\.\d times the noise of the pipeline's: compare"),
    ],
)
def test_a_worse_aperture_than_the_pipeline_s_is_reported(fake_star, monkeypatch, seen, match):
    """The pipeline sums the star; the aperture sums it, dark pixels, or noisy ones too."""
    star = fake_star(400, seed=3)
    y, x, *noise = seen
    rows, columns = np.indices((9, 9))
    star.tpf.hdu[2].data[:] = 1 + 2 * (np.hypot(rows - 4, columns - 4) < 2.2)
    table = star.tpf.hdu[1].data
    beside = np.hypot(rows - y, columns - x) > 2.2
    if noise:
        rng = np.random.default_rng(5)
        table["FLUX"][:, beside] += rng.normal(0, noise[0], (400, beside.sum()))
    chosen = ~beside if not noise else np.ones((9, 9), dtype=bool)
    monkeypatch.setattr(pixels_module, "choose_aperture", lambda *_: chosen)
    if noise:  # half of it is left
        left = np.nansum(table["FLUX"], axis=(1, 2)) ** 0.5
        left *= np.median(left)
        monkeypatch.setattr(PLDFit, "corrected", lambda *_, **__: (left, 0.01 * left))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DetrendingWarning)
        PLDCorrector(star.tpf).correct()
    assert bool(caught) == bool(match)
    assert not match or any(re.search(match, str(w.message)) for w in caught)


@pytest.mark.parametrize(("magnitude", "column"), [(12.0, 7.0), (14.0, 6.5)])
def test_an_aperture_on_another_star_is_reported(magnitude, column):
    """The images of both have one peak, of the star that is not the target."""
    stars = [Star(15.0, 5, 5), Star(magnitude, column, 5.5)]
    motion = Motion.k2_roll(300, seed=4)
    tpf = simulate(stars, Detector.k2(shape=(11, 11)), motion, seed=1).to_tpf()
    with pytest.warns(DetrendingWarning, match="brightest star .* is outside of the pipeline's"):
        assert not tpf.pipeline_mask[PLDCorrector(tpf).aperture_mask].all()
    PLDCorrector(tpf, "pipeline")


@pytest.mark.filterwarnings("ignore::scope_models.exceptions.DetrendingWarning")
def test_a_star_that_vanishes_beside_constant_light(fake_star):
    """Total eclipses: the light of the neighbor is constant, and nothing of the star is left."""
    n = 400
    eclipsed = (0.0204336 * np.arange(n)) % 1.3 < 0.2
    star = fake_star(n, 14, 0, signal=1 - 0.999 * eclipsed, neighbor=0.3, shape=(9, 11))
    corrector = PLDCorrector(star.tpf, np.ones((9, 11), dtype=bool))
    lc = corrector.correct()
    assert corrector.result.contamination > 0.1
    flux = lc.flux.value
    assert np.isfinite(flux[~eclipsed]).all()
    # Two solutions are nearly as good, and rounding chooses; in one a pixel seems to be hit twice.
    outside = ~eclipsed & ~corrector.outlier_mask
    assert outside.sum() > 0.99 * (~eclipsed).sum()
    assert np.std(flux[outside]) < 4e-4 * np.median(flux[outside])


def test_a_ghost_in_masked_cadences_changes_nothing_else(fake_star):
    star, mask = fake_star(400, seed=2), np.ones(400, dtype=bool)
    mask[150:220] = False
    before = PLDCorrector(star.tpf)
    plain = before.correct(cadence_mask=mask).flux.value[mask]
    rows, columns = np.indices((9, 9))
    ghost = 3e4 * np.exp(-((rows - 2) ** 2) - (columns - 6) ** 2)
    star.tpf.hdu[1].data["FLUX"][150:220] += ghost.astype(np.float32)
    again = PLDCorrector(star.tpf, before.aperture_mask)
    found = again.correct(cadence_mask=mask).flux.value[mask]
    assert np.std(found / np.median(found) - plain / np.median(plain)) < 1e-9
    assert again.result.neighbors is None


def test_survival_of_a_brightening_with_a_depth(star):
    corrector = PLDCorrector(star.tpf)
    corrector.correct()
    flare = 1 + 0.01 * (np.abs(np.arange(400) - 200) < 10)
    with pytest.raises(
        ValueError, match="`transit_model` must dim the star where `depth` is given"
    ):
        corrector.result.survival(flare, depth=0.01)


@pytest.mark.parametrize("fractions", ["predicted", "measured"])
def test_transits_are_put_into_the_light_that_was_chosen(fake_star, monkeypatch, fractions):
    corrector = PLDCorrector(fake_star(300, seed=5, mag=14).tpf)
    corrector.correct(fractions=fractions)
    fit, made = corrector.result, []
    original = PLDModel.from_pixels.__func__

    def from_pixels(cls, pixels, options, *arguments):
        made.append(options.fractions)
        return original(cls, pixels, options, *arguments)

    monkeypatch.setattr(PLDModel, "from_pixels", classmethod(from_pixels))
    assert 0.95 < fit.survival() < 1.05
    assert made == [fractions]


@pytest.mark.parametrize("stated", [0.97, 0.8, -1.0, 1.3])
def test_light_of_other_stars_in_the_header_counts(stated):
    """CROWDSAP is of the pipeline's aperture: a smaller one may hold less light of others."""
    tpf = simulate(Star(12.0), Detector.k2(), Motion.k2_roll(200, seed=1), seed=1).to_tpf()
    tpf.hdu[1].header["CROWDSAP"] = stated
    corrector = PLDCorrector(tpf, aperture_mask="pipeline")
    warned = pytest.warns(DetrendingWarning, match="about 20 % of the light in the aperture is of")
    with warned if stated == 0.8 else contextlib.nullcontext():
        corrector.correct()
    assert corrector.result.crowding == (stated if 0 < stated <= 1 else 1.0)
    smaller = tpf.pipeline_mask.copy()
    smaller.flat[np.flatnonzero(smaller)[0]] = False
    corrector = PLDCorrector(tpf, aperture_mask=smaller)
    corrector.correct()
    assert corrector.result.crowding == 1.0


def test_light_in_the_wings_of_other_stars_is_reported(star, monkeypatch):
    corrector = PLDCorrector(star.tpf)
    corrector.correct()
    assert corrector.result.remarks() == []
    monkeypatch.setitem(vars(corrector.result), "contrast_error", 0.3)  # their peaks are outside
    (remark,) = corrector.result.remarks()
    assert remark.startswith("about 30 % of the light in the aperture is of other stars")
