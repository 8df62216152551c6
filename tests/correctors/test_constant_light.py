"""Light of other stars in an aperture, on images that are integrals of Gaussians."""

import numpy as np
import pytest

from scope_models import Detector, Motion, Star, simulate
from scope_models.benchmark import make_sky, score
from scope_models.correctors import PLDCorrector
from scope_models.correctors._constant_light import constant_light

from .test_clean import GRID, TIME, image, motion

pytestmark = pytest.mark.usefixtures("one_thread")

NEIGHBOR = 2.6  # px along x
USE = np.ones(len(TIME), bool)


def slopes(x, y, step=1e-3):
    return [
        (image(x + a * step, y + b * step) - image(x - a * step, y - b * step)) / (2 * step)
        for a, b in ((1, 0), (0, 1))
    ]


@pytest.mark.parametrize("shift", [0.0, 0.004])
def test_constant_light_changes_with_position(shift):
    """Also if fitted positions follow the star's brightness."""
    x, y, _ = motion()
    inside = GRID[:, 0] < 7  # a third of the neighbor is within
    star, neighbor = image(x, y), 0.4 * image(x + NEIGHBOR, y)
    total = (star + neighbor)[:, inside].sum(axis=1, keepdims=True)
    # what varies is known up to a factor and a shift
    own = 0.9 * star + shift * slopes(x, y)[0]
    position = np.column_stack([x, y]) - [4.1, 3.9]
    found = constant_light(
        (star + neighbor) / total, own / total, slopes(x, y), position, GRID, inside, USE
    )
    true = (neighbor[:, inside].sum(axis=1, keepdims=True) / total)[:, 0]
    assert true.std() > 0.01
    assert np.abs(found - true).max() < 2e-3


@pytest.mark.slow
@pytest.mark.parametrize(
    "regime", ["k2-1x-rr-lyrae-neighbor", "k2-1x-eclipsing-neighbor", "k2-1x-neighbor-variable"]
)
@pytest.mark.filterwarnings("ignore::scope_models.exceptions.DetrendingWarning")
def test_other_stars_beside_variable_ones(regime):
    """Before: 44, 31 and 9 times the noise's floor."""
    sky = make_sky(regime, seed=6200)
    corrector = PLDCorrector(sky.to_tpf())
    found = score(corrector.correct(), sky)
    assert found.full < 5
    assert corrector.result.noise_scale < 2
    # FLUX_ERR also holds the uncertainty of amplitudes beside constant light, which is cautious
    assert 0.4 < found.pull < 1.5


@pytest.mark.parametrize("period", [0.6, 2.0])
def test_star_varies_beside_blended_light(period):
    """What the aperture holds of both stars is diluted; it does not follow a false focus."""
    motion = 2 * Motion.k2_roll(800)
    signal = 1 + 0.02 * np.sin(2 * np.pi * motion.time / period)
    stars = [Star(12.0, signal=signal), Star(13.0, 4.0, 5.0)]
    tpf = simulate(stars, Detector.k2(), motion, seed=5).to_tpf()
    corrector = PLDCorrector(tpf)
    corrected = corrector.correct()
    there = np.isin(motion.cadenceno, corrected.cadenceno)
    flux = corrected.flux.value / np.median(corrected.flux.value)
    slope = np.polyfit(signal[there], flux, 1)[0]
    assert slope == pytest.approx(1 / (1 + 10**-0.4), rel=0.01)


def test_a_slow_bump_shows_no_constant_light():
    """Of 50 % in 5 d; its amplitude was 1.036, of a light with 3.5 % less."""
    sky = make_sky("k2-1x-bump-50pct", seed=2001, n_cadences=1500)
    corrector = PLDCorrector(sky.to_tpf())
    found = score(corrector.correct(), sky)
    assert corrector.result.model.clean.constant == 0
    assert found.amplitude == pytest.approx(1, abs=0.002)
    assert found.full < 3
