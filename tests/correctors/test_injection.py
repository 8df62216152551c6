"""What the whole chain leaves of a dimming, against pixels that other code has rendered."""

from dataclasses import replace

import numpy as np
import pytest

from scope_models.benchmark import REGIMES, make_sky, score
from scope_models.correctors import PLDCorrector
from scope_models.correctors._signals import box_signal
from scope_models.exceptions import DetrendingWarning
from scope_models.pixelmodel._source import star_share, stars_of

NOISY = pytest.mark.filterwarnings("ignore::scope_models.exceptions.DetrendingWarning")


def dips(n, depth):
    signal = np.ones(n)
    for start in range(40, n - 20, 97):
        signal[start : start + 8] -= depth
    return signal


def test_survival_is_that_of_a_dip_in_the_pixels(fake_star):
    """The same noise with and without the dips."""
    signal = dips(400, 2e-3)
    alone, dimmed = (fake_star(400, seed=5, signal=s) for s in (np.ones(400), signal))
    corrector = PLDCorrector(alone.tpf)
    before = corrector.correct().flux.value
    after = PLDCorrector(dimmed.tpf, corrector.aperture_mask).correct().flux.value
    slope = np.polyfit(signal, after / before, 1)[0]
    assert corrector.result.survival(signal) == pytest.approx(slope, abs=1e-3)  # 1e-4 apart
    assert corrector.result.survival() == pytest.approx(slope, abs=3e-3)  # 4e-4 apart
    with pytest.warns(DetrendingWarning, match="its event lies in a gap"):
        assert np.isnan(corrector.result.survival(np.ones_like))
    for depth in (0.0, 1.0):
        with pytest.raises(ValueError, match="`depth` must be"):
            corrector.result.survival(depth=depth)


def test_cadences_that_a_dip_leaves_without_light_are_not_used(fake_star):
    """Over-subtracted background: the star's light is more than the sum over the aperture."""
    corrector = PLDCorrector(fake_star(400, seed=5).tpf)
    corrector.correct()
    signal = np.ones(400)
    signal[50] = -0.1
    pixels = corrector.model.source.dimmed(signal, corrector.model.clean)
    assert np.flatnonzero(~pixels.usable).tolist() == [50]


def test_boxes_are_in_the_data_and_have_no_period():
    used = np.arange(900) % 100 > 20
    signal = box_signal(used, 13, 0.01)
    assert np.unique(signal).tolist() == [0.99, 1.0]
    assert used[signal < 1].all()
    assert (signal < 1).sum() == 13 * min(8, used.sum() // 104)
    starts = np.flatnonzero(np.diff(signal) < 0)
    assert np.ptp(np.diff(starts)) > 20
    assert (box_signal(np.ones(20, bool), 30, 0.1) < 1).all()


def test_the_star_s_share_of_a_typical_image():
    rows, columns = np.indices((9, 11))

    def star(x, y):  # a core and wings
        square = (columns - x) ** 2 + (rows - y) ** 2
        return np.exp(-square / 1.1) + 0.02 / (1 + square / 2) ** 2

    mine, others = star(3.2, 4.1), 0.6 * star(6.3, 4.4) + 0.15 * star(4.0, 7.9)
    core, nowhere = np.hypot(columns - 3, rows - 4) < 2, np.zeros(mine.shape, dtype=bool)
    places = stars_of(mine + others, core, nowhere)
    np.testing.assert_allclose(places, [(3.2, 4.1), (6.3, 4.4), (4.0, 7.9)], atol=0.1)
    share = star_share(mine + others, places)
    lit = mine + others > 0.02
    np.testing.assert_allclose((share * (mine + others))[lit], mine[lit], atol=0.015)
    for mask in (np.hypot(columns - 3, rows - 4) < 2, np.hypot(columns - 3, rows - 4) < 3.2):
        whole = (mine + others)[mask].sum()
        part = (share * (mine + others))[mask].sum() / whole
        assert part == pytest.approx(mine[mask].sum() / whole, abs=0.015)
    assert len(stars_of(mine, mine > 0.1, ~nowhere)) == 1


@NOISY
@pytest.mark.slow
@pytest.mark.parametrize("depth", [1e-3, 1e-2])
@pytest.mark.parametrize(
    "name",
    [
        "tess-crowded",
        "k2-1x-transits-neighbor",
        "k2-10x-constant",
        "k2-1x-kp14",
        "k2-1x-kp17",
        "k2-1x-kp10-saturated",
        "k2-1x-spots-5d",
    ],
)
def test_survival_in_hard_cases(name, depth):
    """The messy sky renders the transit into the pixels, with the same noise otherwise."""
    regime = replace(REGIMES[name], transit_period=3.1)
    for seed in (6110, 6112):
        alone, dimmed = (make_sky(replace(regime, depth=d), seed) for d in (0.0, depth))
        corrector = PLDCorrector(alone.to_tpf())
        before = corrector.correct()
        after = PLDCorrector(dimmed.to_tpf(), corrector.aperture_mask).correct()
        rows = np.searchsorted(alone.cadenceno, before["cadenceno"])
        # the ratio of both light curves has the transit alone, and next to no noise
        before.flux = after.flux / before.flux * np.nanmedian(before.flux)
        kept = score(before, replace(alone, true_flux=dimmed.transit, transit=dimmed.transit))
        survival = corrector.result.survival(dimmed.transit[rows])
        assert survival == pytest.approx(kept.depth, abs=0.03)


@NOISY
@pytest.mark.slow
@pytest.mark.parametrize("how", ["unmasked", "masked", "joint"])
@pytest.mark.parametrize(
    ("magnitude", "depth", "neighbors"),
    [(12.0, 1e-3, ()), (14.0, 1e-2, ()), (12.5, 1e-2, ((1, 3, 0),))],
)
def test_depths_of_messy_stars(how, magnitude, depth, neighbors):
    """Ten stars: the bounds of the pulls are three standard deviations of their size."""
    regime = replace(
        REGIMES["k2-1x-transits-1pct"], magnitude=magnitude, depth=depth, neighbors=neighbors
    )
    depths, pulls = [], []
    for seed in range(6120, 6130):
        sky = make_sky(regime, seed)
        tpf = sky.to_tpf()
        rows = np.searchsorted(sky.cadenceno, tpf.cadenceno)
        transit = sky.transit[rows]
        options = {"masked": {"transit_mask": transit < 1}, "joint": {"transit_model": transit}}
        corrector = PLDCorrector(tpf)
        corrector.correct(**options.get(how, {}))
        found, error = corrector.fit_transit(transit)
        if how == "joint":
            assert corrector.result.transit_scale == pytest.approx(found, abs=0.3 * error)
        assert len(corrector.result.neighbors or ()) == len(neighbors)  # their light is taken off
        depths.append(found)
        pulls.append((found - 1) / error)
    assert np.mean(depths) == pytest.approx(1, abs=0.01)
    assert 0.4 < np.sqrt(np.mean(np.square(pulls))) < 1.6


@NOISY
def test_errors_hold_other_light_in_the_aperture():
    """The neighbor dilutes transits, and the errors in transit are as large."""
    sky = make_sky(replace(REGIMES["k2-1x-transits-neighbor"], depth=0.05), 6102, n_cadences=400)
    corrector = PLDCorrector(sky.to_tpf(), "all", neighbors=[])
    lc = corrector.correct()
    rows = np.searchsorted(sky.cadenceno, lc["cadenceno"])
    others, mine = (light[rows].sum() for light in (sky.neighbor_light, sky.star_light))
    dilution = others / (mine + others)
    assert corrector.result.contrast_error == pytest.approx(dilution, rel=0.03)  # 0.5 % apart
    deep = sky.transit[rows] < 0.96
    inside, outside = (np.median((lc.flux_err / lc.flux).value[k]) for k in (deep, ~deep))
    seen = 0.05 * (1 - dilution)  # the depth in the light of both
    assert inside == pytest.approx(seen * dilution, rel=0.1)  # 5 % apart
    floor = (1 - dilution) * sky.floor()  # in the light of both
    assert floor < outside < 1.5 * floor  # 1.05


def test_a_star_alone_has_no_contrast_error(star):
    corrector = PLDCorrector(star.tpf)
    corrector.correct()
    assert corrector.result.contrast_error == 0


@pytest.mark.parametrize(
    ("made", "match"),
    [
        ("bursts", "cadences are left out of the fit as outliers"),
        ("flicker", r"the noise has \d+ times the variance of FLUX_ERR"),
    ],
)
def test_warnings_of_made_variability(fake_star, made, match):
    rng = np.random.default_rng(3)
    signal = {
        "bursts": 1 + 0.01 * np.isin(np.arange(400), rng.choice(400, 43, replace=False)),
        "flicker": 1 + 3e-4 * rng.normal(size=400),
    }[made]
    corrector = PLDCorrector(fake_star(400, seed=8, signal=signal).tpf)
    with pytest.warns(DetrendingWarning, match=match):
        corrector.correct()


def test_a_warning_of_a_neighbor_in_the_wings():
    sky = make_sky("k2-1x-transits-neighbor", 6111, n_cadences=400)
    near = np.hypot(*(np.indices((9, 9)) - 4)) < 3.2
    corrector = PLDCorrector(sky.to_tpf(), near, neighbors=[])
    with pytest.warns(DetrendingWarning, match="of the light in the aperture is of"):
        corrector.correct()


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [n for n in REGIMES if n.endswith("constant") or "spots" in n or "kp1" in n]
)
def test_clean_stars_have_no_warnings(name):
    """Neither in words nor as warnings, which are errors here."""
    corrector = PLDCorrector(make_sky(name, 6150).to_tpf())
    corrector.correct()
    assert corrector.result.remarks() == []
