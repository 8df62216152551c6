"""Positions of stars from other stars of their CCD."""

import pickle
import warnings
from dataclasses import replace

import numpy as np
import pytest

from scope_models import (
    Detector,
    Motion,
    PLDCorrector,
    Scene,
    Star,
    fit_tpf,
    read_pixels,
    simulate,
)
from scope_models.exceptions import FitWarning
from scope_models.fitting._common import Track, fit_tracks
from scope_models.scene import CommonMotion

MOTION = Motion.k2_roll(300, seed=1)


@pytest.fixture(scope="module")
def series():
    observation = simulate(Star(12, 4, 4), Detector.k2(shape=(9, 9)), MOTION, seed=1)
    return read_pixels(observation.to_tpf())


def test_offsets_are_those_of_the_same_cadences(series):
    some = np.r_[3:100, 150:280]
    offsets, errors = MOTION[some].offsets(series)
    assert errors is None
    cadence = series.cadenceno - MOTION.cadenceno[0]
    expected = np.stack([MOTION.x, MOTION.y], axis=1)[cadence]
    expected[~np.isin(cadence, some)] = np.nan
    np.testing.assert_array_equal(offsets, expected)


def test_offsets_need_common_cadences(series):
    with pytest.raises(ValueError, match="none of the cadences"):
        MOTION.replace(time=MOTION.time + 100).offsets(series)
    with pytest.raises(ValueError, match="the motion are BTJD, those of the file BKJD"):
        MOTION.replace(time_format="btjd").offsets(series)


def test_a_motion_replaces_pos_corr():
    with_positions = simulate(Star(12, 4, 4), Detector.k2(shape=(9, 9)), MOTION, seed=1).to_tpf()
    expected = PLDCorrector(with_positions).correct(order=1).flux.value
    without = PLDCorrector(with_positions)
    without._series = without._series.replace(pos_corr=None)
    flux = without.correct(order=1, positions=MOTION).flux.value
    np.testing.assert_allclose(flux, expected, rtol=1e-9)


def truth(n):
    """Roll about the boresight, pointing and scale of each cadence, as a K2 channel has them."""
    roll = Motion.k2_roll(n, seed=2)
    slow = 1e-6 * np.sin(np.arange(n) / 40)
    rng = np.random.default_rng(5)
    zero = np.zeros(n)
    values = {"x": roll.x + 0.003 * rng.normal(size=n), "roll": roll.y / 5000, "scale": slow}
    names = "x_err", "y_err", "roll_err", "scale_err"
    arrays = {name: getattr(roll, name) for name in ("time", "y", "quality", "cadenceno")}
    return CommonMotion(**arrays, **values, **dict.fromkeys(names, zero), place=(550.0, 500.0))


def channel(motion):
    """Twenty stars of a channel: 5 without POS_CORR, 3 with twice its errors, 4 eclipsing."""
    rng, n = np.random.default_rng(8), len(motion)
    slow = 2 * np.pi * np.linspace(0, 1, n)[:, None]
    for k in range(20):
        column, row = rng.integers(50, 1000, 2).tolist()
        stars = [Star(rng.uniform(11, 15), *rng.uniform(3.6, 4.4, 2))]
        if 8 <= k < 12:
            dips = 1 - 0.3 * ((np.arange(n) // 7) % 4 == 0)
            stars[0] = stars[0].replace(signal=dips)
            stars.append(Star(stars[0].mag + 0.5, stars[0].x_0 + 1.8, stars[0].y_0 + 1.2))
        place = {"column": column, "row": row, "object_name": f"star {k}"}
        moved = motion.at(column + 4, row + 4)
        scene = Scene(stars, Detector.k2(shape=(9, 9)), moved, **place)
        tpf = simulate(scene, seed=k).to_tpf()
        series = read_pixels(tpf)
        # as of real files: 1 % in scale, 0.006 px slowly, and 0.003 px from one to the next
        error = 0.003 * rng.normal(size=(n, 2)) + 0.006 * np.sin(slow + rng.uniform(0, 6, 2))
        error += np.column_stack([moved.x, moved.y]) * 0.01 * rng.normal(size=2)
        known = np.isin(motion.cadenceno, series.cadenceno)
        pos_corr = np.column_stack([moved.x, moved.y]) + error * (2 if 5 <= k < 8 else 1)
        yield tpf, series.replace(pos_corr=None if k < 5 else pos_corr[known])


def left_after_a_map(found, expected):
    """Return what an offset and a linear map of positions leave of others."""
    design = np.column_stack([np.ones(len(found)), found])
    return expected - design @ np.linalg.lstsq(design, expected, rcond=None)[0]


def check_channel(n):
    motion = truth(n)
    tpfs, stars = zip(*channel(motion), strict=True)
    found = Motion.from_tpfs(stars)
    own = np.isin(motion.cadenceno, found.cadenceno)
    for column, row in ((100, 900), (500, 500), (1000, 300)):
        there, expected = found.at(column, row), motion.at(column, row)[own]
        expected = np.column_stack([expected.x, expected.y])
        rest = left_after_a_map(np.column_stack([there.x, there.y]), expected)
        error = np.column_stack([there.x_err, there.y_err])
        # POS_CORR is wrong by 5e-3 px, and the pixels of one star by 2e-4
        assert rest.std() < 1e-4
        assert 0.5 < np.sqrt(np.mean((rest / error) ** 2)) < 2.5
    return tpfs, stars, found


def test_motion_of_a_channel():
    _, stars, found = check_channel(75)
    assert found.meta["n_files"] == 20
    assert len(found.meta["stars"]) == 20
    # an eclipsing star beside a neighbor, without its POS_CORR
    series, motion = stars[9].replace(pos_corr=None), truth(75)
    moved, error = motion.offsets(series)
    assert not error.any()
    rest = []
    for positions in ("start", found):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FitWarning)  # of the fit without positions
            fit = fit_tpf(series, neighbors="find", positions=positions)
        used = np.isin(series.cadenceno, fit.cadenceno)
        rest.append(left_after_a_map(moved[used], np.column_stack([fit.x, fit.y])).std())
    assert rest[1] < 0.1 * rest[0]
    assert rest[1] < 2e-3


def tracks(n, rng):
    """Positions of six stars in a common motion, with errors of 0.001 px and maps near 1."""
    motion = truth(n)
    for k in range(6):
        place = tuple(rng.uniform(0, 1000, 2))
        moved = motion.at(*place)
        xy = np.column_stack([moved.x, moved.y]) @ (np.eye(2) + 0.1 * rng.normal(size=(2, 2)))
        xy += 0.001 * rng.normal(size=(n, 2))
        error = np.full((n, 2), 0.001)
        yield Track(f"{k}", "pixels", place, motion.cadenceno, motion.time, xy, error, 0.3)


def test_stars_that_disagree_are_left_out():
    rng = np.random.default_rng(1)
    good = list(tracks(200, rng))
    eclipses = replace(good[1], xy=good[1].xy + 0.3 * (rng.random((200, 1)) < 0.1))
    other = replace(good[2], xy=0.1 * rng.normal(size=(200, 2)))
    still = replace(good[3], xy=np.zeros((200, 2)), map_error=0.01)
    motion, left_out = fit_tracks([good[0], eclipses, other, still, *good[4:]])
    assert left_out == [False, False, True, True, False, False]
    expected = truth(200).at(*good[0].place)
    expected = np.column_stack([expected.x, expected.y])
    found = motion.at(*good[0].place)
    assert left_after_a_map(np.column_stack([found.x, found.y]), expected).std() < 1e-3


def test_all_count_where_none_agrees():
    rng, good = np.random.default_rng(1), list(tracks(100, np.random.default_rng(1)))[:2]
    alone = [replace(track, xy=0.1 * rng.normal(size=(100, 2))) for track in good]
    motion, left_out = fit_tracks(alone)
    assert left_out == [True, True]
    assert motion.x.std() > 0.01


def test_cadences_that_some_stars_lack():
    some = list(tracks(100, np.random.default_rng(2)))
    whole = fit_tracks(some)[0]
    short = [replace(some[0], xy=np.where(np.arange(100)[:, None] < 50, some[0].xy, np.nan))]
    motion = fit_tracks(short + some[1:])[0]
    assert len(motion) == 100
    assert motion.x_err[60:].mean() > motion.x_err[:40].mean()
    np.testing.assert_allclose(motion.x[60:], whole.x[60:], atol=5e-3)


def test_files_of_other_ccds_and_files_that_fail(series, tmp_path):
    def of(channel):
        return series.replace(header={**series.header, "CAMPAIGN": 5, "CHANNEL": channel})

    (tmp_path / "broken.fits").write_bytes(b"SIMPLE  =")
    files = [of(1), of(2), of(2), tmp_path / "broken.fits"]
    with pytest.warns(FitWarning, match=r"broken.fits: .*; c05 CCD 1 1765 s: another CCD than"):
        motion = Motion.from_tpfs(files)
    assert motion.meta["n_files"] == 2
    with pytest.warns(FitWarning, match="one file of c05 CCD 1 1765 s: no other star confirms it"):
        assert Motion.from_tpfs(of(1)) == Motion.from_tpfs([of(1)])
    with pytest.raises(ValueError, match=r"no file has positions: broken\.fits"):
        Motion.from_tpfs(str(files[3]))
    with pytest.raises(ValueError, match=r"`tpfs` is empty"):
        Motion.from_tpfs([])


def test_common_motions_are_values(tmp_path):
    motion = fit_tracks(list(tracks(50, np.random.default_rng(3))))[0].replace(
        meta={"stars": ["a"]}
    )
    assert Motion.read(motion.write(tmp_path / "motion.fits")) == motion
    assert pickle.loads(pickle.dumps(motion)) == motion  # noqa: S301 - written here
    assert len(motion[10:20].roll_err) == 10
    twice = -2 * motion
    np.testing.assert_array_equal(twice.roll, -2 * motion.roll)
    np.testing.assert_array_equal(twice.x_err, 2 * motion.x_err)
    with pytest.raises(ValueError, match="`x_err` must be finite, and no error below 0"):
        motion.replace(x_err=-motion.x_err)
    there = motion.at(motion.place[0] + 100, motion.place[1] - 50)
    np.testing.assert_allclose(there.y, motion.y - 50 * motion.scale + 100 * motion.roll)
    expected = np.sqrt(
        motion.x_err**2 + (100 * motion.scale_err) ** 2 + (50 * motion.roll_err) ** 2
    )
    np.testing.assert_allclose(there.x_err, expected)


def test_real_stars_have_the_motion_of_the_others(shared_data):
    """POS_CORR of each star is found from the six others."""
    files = sorted((shared_data / "kepler_q12_ch4").glob("tpf_*.fits.gz"))
    stars = [read_pixels(file)[:250] for file in files]
    taken = stars[3].replace(pos_corr=None)
    motion = Motion.from_tpfs([*stars[:3], taken, *stars[4:]])
    moved, _ = motion.offsets(taken)
    rest = left_after_a_map(moved, stars[3].pos_corr)
    # the pixels of single stars scatter by 2e-4 to 6e-4 px
    assert rest.std() < 5e-4
    assert rest.std() < 0.1 * stars[3].pos_corr.std(axis=0).max()


def test_twin_of_a_ccd():
    """The scenes of several fits have one motion, which their twins give again."""
    motion, stars = truth(60), []
    for k, (column, row) in enumerate([(100, 900), (900, 150), (400, 400)]):
        place = {"column": column, "row": row, "object_name": f"star {k}"}
        scene = Scene(
            Star(12 + k), Detector.k2(shape=(7, 7)), motion.at(column + 3, row + 3), **place
        )
        stars.append(read_pixels(simulate(scene, seed=k).to_tpf()).replace(pos_corr=None))
    common = Motion.from_tpfs(stars)
    scenes = [fit_tpf(star, psf=1).scene(positions=common) for star in stars]
    for scene, star in zip(scenes, stars, strict=True):
        moved, _ = common.offsets(star)
        rest = left_after_a_map(moved, np.column_stack([scene.motion.x, scene.motion.y]))
        assert np.abs(rest).max() < 1e-12
        expected, _ = motion.offsets(star)
        rest = left_after_a_map(expected, np.column_stack([scene.motion.x, scene.motion.y]))
        assert rest.std() < 5e-4
    again = Motion.from_tpfs([simulate(scene, seed=9).to_tpf() for scene in scenes])
    moved, _ = again.offsets(stars[2])
    assert left_after_a_map(moved, common.offsets(stars[2])[0]).std() < 5e-4
    with pytest.raises(ValueError, match="`positions` must be"):
        fit_tpf(stars[0], psf=1).scene(positions="guessed")


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::scope_models.exceptions.DetrendingWarning")
def test_eclipses_beside_neighbors_without_pos_corr():
    """The motion of the others keeps their depth; centroids mostly find the neighbors, too."""
    n = 600
    tpfs, stars, found = check_channel(n)
    depths = []
    for k in range(8, 12):
        corrector = PLDCorrector(tpfs[k])
        corrector._series = stars[k].replace(pos_corr=None)
        cadence = stars[k].cadenceno - found.cadenceno[0]
        dimmed = (cadence // 7) % 4 == 0
        for positions in (None, found):
            flux = corrector.correct(positions=positions).flux.value
            depths.append(1 - np.nanmedian(flux[dimmed]) / np.nanmedian(flux[~dimmed]))
    depths = np.reshape(depths, (4, 2)) / 0.3
    np.testing.assert_allclose(depths[:3, 0], 1, atol=0.01)
    np.testing.assert_allclose(depths[:, 1], 1, atol=0.01)
