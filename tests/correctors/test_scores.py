"""The scores of simulated stars with real motions."""

import numpy as np
import pytest
from _correctors import noise_of
from _study import cells
from astropy.table import Table
from motion import MotionTest, measure, tasks

from scope_models.correctors import PLDCorrector
from scope_models.photometry import cdpp


def test_score_of_a_star(star, corrected):
    mask = corrected.aperture_mask
    noise = star.noise[:, mask].sum(axis=1) / np.median(star.expected[:, mask].sum(axis=1))
    scores = noise_of(corrected, star.expected + star.noise, star.expected)
    # 30 windows: the scatter is known to 13 percent, and what is left of the noise to 10
    assert 0.6 < scores["held_out_mad"] < 1.4
    assert 0.7 < scores["held_out_rms"] < 1.3
    assert 0.7 < scores["held_out_pull"] < 1.3
    expected = cdpp(corrected.corrected_lc) / cdpp(1 + noise)
    assert scores["residual_lightkurve"] == pytest.approx(expected, rel=0.01)


def test_held_out_needs_windows(star):
    corrector = PLDCorrector(star.tpf)
    with pytest.raises(ValueError, match="call `correct` first"):
        corrector.held_out()
    corrector.correct(order=1)
    with pytest.raises(ValueError, match="`width` must be at most 200, got 300"):
        corrector.held_out(300)


MOTIONS = (
    "ktwo206103150-c03_llc.fits", "ktwo211117077-c04_llc.fits", "ktwo211436265-c05_llc.fits",
)  # fmt: skip
WINDOWS = 0.5  # three standard deviations of a scatter of 54 windows


@pytest.fixture(scope="module")
def stars(shared_data):
    """Return a function that measures stars with real motions on a detector of the motion test."""

    def run(detector, files, **options):
        rows = []
        for file in files:
            motion = str(shared_data / "poscorr" / file)
            study = MotionTest(detector=detector, motion=motion, stars=1, **options)
            rows += [task | measure(study, task) for task in tasks(study)]
        return Table(rows)

    return run


@pytest.mark.parametrize("detector", ["paper", pytest.param("calibrated", marks=pytest.mark.slow)])
def test_a_star_with_a_real_motion(stars, detector):
    options = {"magnitudes": (12.0,), "scales": (5.0,), "cadences": 700}
    (row,) = stars(detector, MOTIONS[:1], **options, lightkurve_sff=False)
    assert row["held_out_mad"] < 1 + WINDOWS
    assert row["residual_lightkurve"] < 1.10
    assert row["residual_everest"] < 1.10
    for how in ("masked", "joint"):
        assert abs(row[f"depth_{how}"] - 1000) < 3.5 * row[f"depth_{how}_error"]
    assert row["pld_lightkurve"] < row["lightkurve_pld_lightkurve"]


@pytest.mark.parametrize(
    ("detector", "motion", "magnitude", "scale"),
    [
        ("paper", MOTIONS[0], 10.5, 2.0),
        ("paper", MOTIONS[1], 10.0, 5.0),
        pytest.param("paper", MOTIONS[0], 10.5, 5.0, marks=pytest.mark.slow),
        pytest.param("calibrated", MOTIONS[1], 10.0, 5.0, marks=pytest.mark.slow),
    ],
)
def test_a_full_star_with_a_real_motion(stars, detector, motion, magnitude, scale):
    """Columns that are full by turns: rows of the star are those of the others."""
    options = {"magnitudes": (magnitude,), "scales": (scale,), "transit_scales": ()}
    (row,) = stars(detector, (motion,), **options, lightkurve_sff=False)
    # 36 and 67 with the profile of never full columns; 53 where bled charge is another star's; 2.2
    # if a pixel is as noisy while it holds light as it is typically
    assert row["residual_lightkurve"] < 2


@pytest.mark.filterwarnings("ignore::scope_models.exceptions.DetrendingWarning")  # of 20 px motion
@pytest.mark.slow
@pytest.mark.parametrize("detector", ["paper", "calibrated"])
def test_stars_of_all_magnitudes(stars, detector):
    """One star per magnitude and motion: what the corrector is to reach, scale by scale."""
    bounds = {1.0: 1.05, 2.0: 1.10, 5.0: 1.20, 10.0: 1.30}
    table = stars(detector, MOTIONS, scales=tuple(bounds), lightkurve_sff=False)
    for scale, largest in bounds.items():
        assert np.median(table["held_out_mad"][table["scale"] == scale]) <= largest
    for _, part in cells(table, ("scale", "mag")):
        for method in ("lightkurve", "everest"):
            assert np.median(part[f"residual_{method}"]) <= 1.10
    assert np.mean(table["pld_lightkurve"] < table["lightkurve_pld_lightkurve"]) >= 0.95
    bright = table[(table["mag"] <= 13) & (table["scale"] == 5.0)]
    weights = np.array(bright["depth_masked_error"], dtype=float) ** -2.0
    depth = np.average(np.array(bright["depth_masked"], dtype=float), weights=weights)
    assert depth == pytest.approx(1000, abs=4 * weights.sum() ** -0.5)
