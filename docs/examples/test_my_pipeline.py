"""Tests of a pipeline with target pixel files whose truth is known."""

import lightkurve as lk
import numpy as np
import pytest

from scope_models import Detector, Motion, Star, TransitModel, read_truth, simulate

MAGNITUDE = 12.0


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """Write a star with a planet on K2's roll."""
    detector, motion = Detector.k2(shape=(9, 9)), Motion.k2_roll(200)
    planet = TransitModel.from_depth_duration(
        0.01, duration=0.2, period=2.0, t0=motion.time[50], exposure_time=detector.cadence_days
    )
    observation = simulate(Star(MAGNITUDE, signal=planet), detector, motion, seed=1)
    return observation.write(tmp_path_factory.mktemp("pixels") / "star.fits")


@pytest.fixture(scope="module")
def tpf(path):
    """Open it as the pipeline does."""
    file = lk.read(path, quality_bitmask="none")
    yield file
    file.hdu.close()


def test_centroids_follow_the_star(tpf, path):
    truth = read_truth(path).table
    columns, rows = tpf.estimate_centroids(aperture_mask="all")
    # Pixels respond differently within, so that centroids are off by some hundredths of a pixel.
    assert columns.value - tpf.column == pytest.approx(np.asarray(truth["X1"]), abs=0.05)
    assert rows.value - tpf.row == pytest.approx(np.asarray(truth["Y1"]), abs=0.05)


def test_flux_of_the_star(tpf, path):
    signal = np.asarray(read_truth(path).table["SIGNAL1"])
    expected = Detector.k2().flux_from_mag(MAGNITUDE) * signal
    flux = tpf.to_lightcurve(aperture_mask="all").flux.value
    # The response of the pixels takes up to 2.5 % away, and differs by 1 % between them.
    assert flux == pytest.approx(expected, rel=0.035)


def test_transits_are_where_they_were_put(tpf, path):
    in_transit = np.asarray(read_truth(path).table["SIGNAL1"]) < 0.995
    flux = tpf.to_lightcurve(aperture_mask="all").normalize().flux.value
    assert np.array_equal(flux < 0.995, in_transit)
