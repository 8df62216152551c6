"""Positions of stars from other stars of their CCD."""

import numpy as np
import pytest

from scope_models import Detector, Motion, PLDCorrector, Star, read_pixels, simulate

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
