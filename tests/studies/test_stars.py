"""Stars and motions of the studies."""

import numpy as np
import pytest
from _stars import draw_star, motion_from_name, stamp_around

from scope_models import BivariateGaussianPSF, Detector, Motion


@pytest.fixture(scope="module")
def stars():
    rng, detector = np.random.default_rng(5), Detector.k2()
    return [draw_star(rng, 12.0, detector) for _ in range(800)]


def test_stars_vary_as_in_the_paper(stars):
    for name, middle in (("x_0", 5.0), ("y_0", 5.0)):
        values = np.array([getattr(star, name) for star in stars]) - middle
        assert 0.198 < values.max() <= 0.2
        assert -0.2 <= values.min() < -0.198
    for name, low, high in (("sigma_x", 0.45, 0.55), ("sigma_y", 0.45, 0.55), ("rho", -0.4, 0.4)):
        values = np.array([getattr(star.psf, name).value for star in stars])
        assert low <= values.min() < low + 0.01 * (high - low)
        assert high >= values.max() > high - 0.01 * (high - low)


def test_draws_are_independent_of_each_other(stars):
    columns = [[s.x_0, s.y_0, s.psf.sigma_x.value, s.psf.sigma_y.value, s.psf.rho.value]
               for s in stars]  # fmt: skip
    correlation = np.corrcoef(np.transpose(columns)) - np.eye(5)
    assert np.abs(correlation).max() < 4 / np.sqrt(len(stars))


def test_components_of_a_psf_vary_together():
    core, wings = BivariateGaussianPSF(0.8), BivariateGaussianPSF(0.2, sigma_x=1.2, sigma_y=1.0)
    detector = Detector.k2(psf=core + wings)
    star = draw_star(np.random.default_rng(2), 12.0, detector)
    psf = star.psf
    assert psf.sigma_x_1.value / psf.sigma_x_0.value == pytest.approx(2.4)
    assert psf.sigma_y_1.value / psf.sigma_y_0.value == pytest.approx(2.0)
    assert psf.rho_0.value == psf.rho_1.value != 0
    assert detector.psf.sigma_x_0.value == 0.5  # the detector's own is left alone


def test_generated_motion_without_firings():
    motion = motion_from_name("k2_roll", 1200, seed=4)
    assert len(motion) == 1200
    assert not motion.quality.any()
    full = Motion.k2_roll(1500, seed=4)
    kept = np.isin(full.cadenceno, motion.cadenceno)
    assert np.array_equal(full.x[kept], motion.x)
    assert np.all(
        (full.quality[: np.flatnonzero(kept)[-1]] != 0) == ~kept[: np.flatnonzero(kept)[-1]]
    )


def test_missing_file(tmp_path):
    with pytest.raises(FileNotFoundError):
        motion_from_name(tmp_path / "absent.fits")


def test_motion_of_a_file_leaves_out_flagged_and_absurd_positions(tmp_path):
    from astropy.table import Table

    columns = {
        "TIME": np.arange(6.0),
        "POS_CORR1": [0.0, 0.1, 9.0, np.nan, 0.2, 0.3],
        "POS_CORR2": [0.0, 0.1, 0.1, 0.0, -0.2, 0.3],
        "QUALITY": np.array([0, 1048576, 0, 0, 524288, 0], dtype=np.int32),
    }
    Table(columns).write(tmp_path / "motion.fits")
    motion = motion_from_name(tmp_path / "motion.fits")
    assert motion.x.tolist() == [0.0, 0.2, 0.3]
    assert len(motion_from_name(str(tmp_path / "motion.fits"), 2)) == 2
    columns["QUALITY"] = np.full(6, 1048576, dtype=np.int32)
    Table(columns).write(tmp_path / "flagged.fits")
    with pytest.raises(ValueError, match="no cadence is without a quality flag"):
        motion_from_name(tmp_path / "flagged.fits")


def test_real_motions(shared_data):
    for path in sorted((shared_data / "poscorr").glob("*.fits")):
        motion = motion_from_name(path)
        assert len(motion) >= 500
        assert np.abs(motion.x).max() < 3


@pytest.mark.parametrize("scale", [1, 10])
def test_stamp_holds_the_star(scale):
    motion = scale * motion_from_name("k2_roll", field=(-6.7, 2.0))
    (ny, nx), x_0, y_0 = stamp_around(motion, margin=4)
    for middle, values, size in ((x_0, motion.x, nx), (y_0, motion.y, ny)):
        pixels = middle + np.rint(values)
        assert pixels.min() == 4
        assert pixels.max() == size - 5
