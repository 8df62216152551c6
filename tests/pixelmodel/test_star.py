"""Predicted pixel fractions, on stars whose images are integrals of Gaussians."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import erf

from scope_models.pixelmodel._smooth import Flow, Smoother, precise_aperture
from scope_models.pixelmodel._stamp import Columns
from scope_models.pixelmodel._star import IMAGE_ERROR, _without_other_causes, fit_star

pytestmark = pytest.mark.usefixtures("one_thread")

SIZE, SIGMA, FLUX = 9, 0.6, 1e5
TIME = 0.02 * np.arange(500)
GRID = np.stack(np.meshgrid(np.arange(SIZE), np.arange(SIZE)), axis=-1).reshape(-1, 2)


def image(x, y, sigma=SIGMA):
    """Return the share of a Gaussian star in each pixel, ``(n, n_pixels)``."""

    def axis(center):
        edges = np.arange(SIZE + 1) - 0.5
        cumulative = 0.5 * erf(
            (edges - np.reshape(center, (-1, 1))) / np.reshape(sigma, (-1, 1)) / 2**0.5
        )
        return np.diff(cumulative, axis=1)

    return (axis(y)[:, :, None] * axis(x)[:, None, :]).reshape(len(x), -1)


def pixels(grid):
    """Return the pixels as `Columns` of which none is full."""
    return Columns(grid, np.zeros(len(grid), dtype=bool))


def motion(seed=1):
    rng = np.random.default_rng(seed)
    x = 4.1 + 0.3 * (TIME / 0.245 % 1 - 0.5) + 0.02 * np.sin(TIME)
    y = 3.9 + 0.2 * (TIME / 0.245 % 1 - 0.5) ** 2 + 0.05 * np.cos(0.7 * TIME)
    measured = np.column_stack([x - 4.1, y - 3.9]) + 0.01 * rng.normal(size=(len(x), 2))
    return x, y, measured


def observed(light, seed=2, noise=2.0):
    rng = np.random.default_rng(seed)
    error = np.sqrt(noise**2 + np.maximum(light, 0) / 1600)
    return light + error * rng.normal(size=light.shape), error


def clean(light, measured, **options):
    flux, error = observed(light)
    return fit_star(TIME, flux, error, measured, GRID, np.ones(len(GRID), bool), **options)


def deviation(shares, true):
    """Return the rms error of all shares together, their constant parts taken off."""
    rest = shares - true
    return np.sqrt(((rest - rest.mean(axis=0)) ** 2).sum(axis=1).mean())


def widened(x, y):
    """Return the mean change of fractions with the relative width, ``(n_pixels,)``."""
    return (image(x, y, 1.001 * SIGMA) - image(x, y)).mean(axis=0) / 0.001


def test_fractions_of_a_star_with_focus_and_background():
    x, y, measured = motion()
    width = SIGMA * (1 + 0.004 * np.sin(2 * np.pi * TIME / 7))
    background = 5 * np.sin(TIME)
    true = image(x, y, width)
    found = clean(FLUX * true + background[:, None], measured)
    noise = np.sqrt((2.0**2 + FLUX * true / 1600).sum(axis=1).mean()) / FLUX  # of measured ones
    assert deviation(found.shares, true) < 0.5 * noise
    assert (found.background - background[:, None]).std() < 0.25
    # nothing is lost beside the stamp, but for the noise of its border
    np.testing.assert_allclose(found.shares.sum(axis=1), 1, atol=0.1 * noise)
    assert found.constant == 0
    assert deviation(found.still, true) < 0.15 * deviation(image(x, y), true)


def test_width_that_changes_as_the_star_drifts():
    """Only what moves with the roll, too, is an effect of the position."""
    x, y, measured = motion()
    slow = np.sin(2 * np.pi * TIME / 14)
    x, measured = x + 0.1 * slow, measured + 0.1 * slow[:, None] * [1, 0]
    true = image(x, y, SIGMA * (1 + 0.005 * slow))
    found = clean(FLUX * true, measured)
    assert np.corrcoef(found.focus, slow)[0, 1] > 0.99
    noise = np.sqrt((2.0**2 + FLUX * true / 1600).sum(axis=1).mean()) / FLUX
    assert deviation(found.shares, true) < 0.5 * noise
    moved = 0.005 * slow.std() * widened(x, y)
    leak = found.leaks()[1]["Relative width"]
    np.testing.assert_allclose(leak, moved, atol=0.2 * np.abs(moved).max())  # 0.14


def test_a_small_width_beside_a_large_motion_moves_little_light():
    """What the motion moves depends on it in ways that may resemble the width's course."""
    slow, roll = np.sin(2 * np.pi * TIME / 14), (TIME / 0.245 % 1 - 0.5) * np.cos(TIME / 4)
    x, y = 4.1 + 1.5 * roll + 0.1 * slow, 3.9 + roll + 0.05 * slow
    measured = np.column_stack([x - 4.1, y - 3.9])
    measured += 0.01 * np.random.default_rng(1).normal(size=measured.shape)
    found = clean(FLUX * image(x, y, SIGMA * (1 + 0.001 * slow)), measured)
    most = 0.001 * slow.std() * np.abs(widened(x, y)).max()
    assert np.abs(found.leaks()[1]["Relative width"]).max() < 1.2 * most


def test_slow_background_that_is_steeper_than_dark_pixels_show():
    """It follows the slow motion, and has half of its amplitude in a dark corner."""
    x, y, measured = motion()
    size = 1 + 0.1 * (GRID - 4).sum(axis=1)
    background = 20 * np.sin(TIME)[:, None] * size
    found = clean(1000 * image(x, y) + background, measured)
    slope = np.polyfit(np.sin(TIME), found.background @ size, 1)[0] / (20 * size @ size)
    np.testing.assert_allclose(slope, 1, atol=0.02)


def test_light_of_a_star_that_is_far_away_once():
    """Pixels there show it in one cadence alone: its profile says how bright it can be."""
    x, y, measured = motion()
    x[250] += 2.5
    measured[250, 0] += 2.5
    found = clean(FLUX * image(x, y), measured)
    assert abs(found.light[250] / np.median(found.light) - 1) < 0.0015


def test_light_that_the_focus_moves_over_the_border_is_put_back():
    x, y, measured = motion()
    width = SIGMA * (1 + 0.004 * np.sin(2 * np.pi * TIME / 7))
    flux, error = observed(FLUX * image(x, y, width))
    aperture = np.hypot(*(GRID - 4).T) < 1.2  # it holds 86 % of the light
    found = fit_star(TIME, flux, error, measured, GRID, aperture)

    def slope(light):
        columns = np.column_stack([x, y, x * x, x * y, y * y, width / SIGMA, np.ones(len(x))])
        return np.linalg.lstsq(columns, light / np.median(light), rcond=None)[0][5]

    assert abs(slope(found.light)) < 0.1 * abs(slope(flux[:, aperture].sum(axis=1)))


@pytest.mark.parametrize("star", [1e4, 1e5, 1e6])
def test_width_of_a_star_at_rest(star):
    """No motion shows how its image changes with position, and POS_CORR drifts."""
    x, y = np.random.default_rng(4).normal([[4.1], [3.9]], 1e-4, (2, len(TIME)))
    measured = np.random.default_rng(5).normal(0, 3e-3, (len(TIME), 2))
    measured += 0.006 * np.stack([np.sin(TIME / 0.8), np.cos(TIME / 1.1)], axis=1)
    width = SIGMA * (1 + 0.003 * np.sin(2 * np.pi * TIME / 4))
    flux, error = observed(star * image(x, y, width))
    aperture = np.hypot(*(GRID - 4).T) < 1.2  # light leaves it as the image widens
    focus = fit_star(TIME, flux, error, measured, GRID, aperture).focus
    np.testing.assert_allclose(np.polyfit(width / SIGMA - 1, focus, 1)[0], 1, atol=0.25)
    assert np.corrcoef(focus, width)[0, 1] > 0.99


def test_fractions_do_not_follow_a_transit():
    x, y, measured = motion()
    dip = np.where(TIME % 2 < 0.2, 0.99, 1.0)
    neighbor = 0.3 * FLUX * image(x + 2.4, y)
    found = clean(FLUX * dip[:, None] * image(x, y) + neighbor, measured)
    both = FLUX * image(x, y) + neighbor
    true = both / both.sum(axis=1, keepdims=True)
    inside = dip < 1
    rest = found.shares - true
    change = rest[inside].mean(axis=0) - rest[~inside].mean(axis=0)
    measured_change = 0.01 * 0.3 / 1.3 * 0.4  # what a measured fraction of the core would do
    assert np.abs(change).max() < measured_change


def test_shares_do_not_follow_a_variable_star_beside_a_constant_neighbor():
    x, y, measured = motion()
    bright = 1 + 0.15 * np.sin(2 * np.pi * TIME / 0.55)
    neighbor = 0.4 * FLUX * image(x + 3, y)
    found = clean(FLUX * bright[:, None] * image(x, y) + neighbor, measured)
    # five widths of the PSF apart, nearly all of the other light shows, less errors of 81 pixels
    assert 0.96 < (found.constant + 40.5 * IMAGE_ERROR) / (0.4 / 1.4) < 1
    slope = np.polyfit(bright, found.light / FLUX, 1)
    np.testing.assert_allclose(slope, [1, 0.4], atol=0.005)
    both = FLUX * image(x, y) + neighbor
    true = both / both.sum(axis=1, keepdims=True)
    follows = np.polyfit(bright, found.shares - true, 1)[0]
    assert np.abs(follows).max() < 2e-3  # measured fractions: 0.1


@pytest.mark.parametrize(("pixel", "charge"), [(40, 3000), (41, 2000), (50, 2000)])
def test_cosmic_rays_are_replaced(pixel, charge):
    """The brightest pixel, 40, has 35,000 e-/s, and the star's position follows it."""
    x, y, measured = motion()
    light = FLUX * image(x, y)
    light[200, pixel] += charge
    found = clean(light, measured)
    assert found.repaired[200, pixel]
    assert abs(found.light[200] / np.median(found.light) - 1) < 8e-4


def test_a_jump_within_an_exposure_is_no_cosmic_ray():
    """Nor do places that the star rarely visits, beside which it jumps, lose their images."""
    time = np.arange(220)
    y, rolls = 4 + 2 * (time / 12 % 1 - 0.5), np.arange(12, 220, 36)
    x = 4 + 0.1 * (y - 4)
    light = FLUX * image(x, y)
    light[rolls] = 0.5 * (light[rolls - 1] + light[rolls])
    rng = np.random.default_rng(8)
    measured = np.column_stack([x, y]) + 0.003 * rng.normal(size=(len(x), 2))
    flux, error = observed(light)
    found = fit_star(0.02 * time, flux, error, measured, GRID, np.ones(len(GRID), bool))
    assert found.repaired[rolls].mean() < 0.01
    assert np.abs(found.light / FLUX - 1)[rolls].max() < 5e-3
    assert np.std(np.delete(found.light, rolls) / FLUX) < 4e-4


def test_absurd_and_unknown_positions_do_no_harm():
    x, y, measured = motion()
    measured[::50] = np.nan
    measured[7::90] = 900.0
    true = image(x, y)
    found = clean(FLUX * true, measured)
    assert deviation(found.shares, true) < 1e-4
    unknown = clean(FLUX * true, np.full_like(measured, np.nan))
    assert deviation(unknown.shares, true) < 1e-4


def test_large_motion():
    _, _, measured = motion()
    x, y = 4 + 2 * np.sin(TIME * 3), 4 + 0.5 * np.cos(TIME)
    measured = np.column_stack([x, y]) + measured - measured.mean(axis=0)
    measured = np.column_stack([x, y]) + 0.01 * np.random.default_rng(4).normal(size=(len(x), 2))
    true = image(x, y)
    assert deviation(clean(FLUX * true, measured).shares, true) < 5e-4


def test_precise_aperture_leaves_out_dark_pixels_and_keeps_what_the_star_crosses():
    x, y, _ = motion()
    faint, error = observed(2e3 * image(x, y))
    mask = precise_aperture(faint, error**2, np.column_stack([x, y]), 13)
    assert 3 <= mask.sum() <= 25
    assert mask.reshape(SIZE, SIZE)[4, 4]
    bright, error = observed(1e6 * image(x, y))
    more = precise_aperture(bright, error**2, np.column_stack([x, y]), 13)
    assert more.sum() > mask.sum()


def test_precise_aperture_of_short_exposures_is_that_of_their_means():
    """Fifteen times as many cadences of 6.5 h, each with sqrt(15) times the error, are the same."""
    x, y, _ = motion()
    light, error = observed(2e4 * image(x, y))
    place = np.column_stack([x, y])
    whole = precise_aperture(light, error**2, place, 13)
    np.testing.assert_array_equal(precise_aperture(light, 15 * error**2, place, 15 * 13), whole)
    assert precise_aperture(light, 15 * error**2, place, 13).sum() < whole.sum()


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_precise_aperture_of_few_pixels_holds_all(n):
    """At least four are meant, also where the image has fewer."""
    x, y, _ = motion()
    light, error = observed(1e5 * image(x, y))
    brightest = np.argsort(-light.mean(axis=0))[:n]
    given = light[:, brightest], error[:, brightest] ** 2, np.column_stack([x, y])
    mask = precise_aperture(*given, 13)
    assert mask.all()


@pytest.mark.parametrize("scale", [0.3, 5.0])
def test_smoothing_takes_the_width_that_the_data_ask_for(scale):
    rng = np.random.default_rng(3)
    signal = np.sin(2 * np.pi * TIME / scale)
    noise = 0.3 * rng.normal(size=len(TIME))
    all_cadences = np.ones(len(TIME), dtype=bool)
    smooth, _ = Smoother(TIME, all_cadences)(signal + noise, np.full(len(TIME), 0.3))
    assert (smooth - signal).std() < (0.8 if scale < 1 else 0.35) * noise.std()


def test_smoothing_leaves_little_of_noise():
    noise = np.random.default_rng(4).normal(size=(20, len(TIME)))
    smoother = Smoother(TIME, np.ones(len(TIME), dtype=bool))
    left = [smoother(values, np.ones(len(TIME)))[0].std() for values in noise]
    # to nothing, mostly; the widest kernel leaves 0.077 on average
    assert np.median(left) < 1e-9


def test_cadences_without_weight_do_not_end_a_course():
    """Between them the course is unknown, but not elsewhere."""
    course, error = 30 * np.sin(8 * TIME), np.ones(len(TIME))
    error[200:240] = 1e4
    values = course + error * np.random.default_rng(5).normal(size=len(TIME))
    found, _ = Smoother(TIME, np.ones(len(TIME), dtype=bool))(values, error)
    assert np.std((found - course)[error == 1]) < 2


def test_rolling_bands_are_background():
    """Waves along the rows in a third of the cadences, ten times as strong as pixels' noise."""
    x, y, measured = motion()
    banded = TIME % 3 < 1
    rows = GRID[:, 1] / 9 + np.random.default_rng(7).uniform(size=(len(TIME), 1))
    bands = np.where(banded[:, None], 20 * np.sin(2 * np.pi * rows), 0.0)
    flux, error = observed(3000 * image(x, y) + bands)
    inside = image(x, y).mean(axis=0) > 1e-3
    found = fit_star(TIME, flux, error, measured, GRID, inside, use=~banded, banded=banded)
    part = found.light / np.median(found.light) - 1
    wave = bands[banded][:, inside].sum(axis=1) / 3000
    assert part[banded].std() < 1.3 * part[~banded].std() < 0.1 * wave.std()
    assert abs(part[banded].mean()) < 0.3 * part[~banded].std()


def test_light_where_nothing_is_learned_does_not_follow_a_guessed_focus():
    """A third of the cadences, between which the width of a bright star changes by 1 %."""
    x, y, measured = motion()
    width = SIGMA * (1 + 0.01 * np.sin(2 * np.pi * TIME / 1.5))
    use = TIME % 3 > 1
    found = clean(FLUX * image(x, y, width) + 5, measured, use=use)
    part = found.light / np.median(found.light) - 1
    assert part[~use].std() < 1.3 * part[use].std() < 2 * np.median(found.light_error) / FLUX
    assert abs(part[~use].mean()) < 0.3 * part[use].std()


def test_correlated_errors_do_not_make_a_width_follow_the_position():
    """A star moves slowly, and errors of its width have a correlation of 0.8 with those of x."""
    rng, time = np.random.default_rng(6), np.arange(3000)
    noise = rng.multivariate_normal([0, 0], 1e-6 * np.array([[1, 0.8], [0.8, 1]]), len(time)).T
    x, drift = np.sin(time / 50), 0.001 * np.cos(time / 90)
    position = np.column_stack([x + noise[0], 0.5 * x + 0.001 * rng.normal(size=len(time))])
    stamp = SimpleNamespace(use=np.ones(len(time), dtype=bool))
    states = SimpleNamespace(focus=drift, noisy=np.ones((len(time), 1)))
    focus, error = noise[1] + drift, np.full(len(time), 1e-3)
    left = _without_other_causes(stamp, focus, error, position, 0 * x, states)
    assert abs(np.polyfit(x, focus - left, 1)[0]) < 1e-4


def test_noise_does_not_hide_a_width_that_follows_a_slow_motion():
    """A faint star: changes from cadence to cadence are all noise."""
    rng, time = np.random.default_rng(6), np.arange(3000)
    position = np.column_stack([np.sin(time / 50), time / 3000])
    stamp = SimpleNamespace(use=np.ones(len(time), dtype=bool))
    none, error = np.zeros(len(time)), np.full(len(time), 0.03)
    states = SimpleNamespace(focus=none, noisy=np.ones((len(time), 1)))
    focus = error * rng.normal(size=len(time)) + position @ [0.0, 0.02]
    left = _without_other_causes(stamp, focus, error, position, none, states)
    assert abs(np.polyfit(time / 3000, left, 1)[0]) < 0.002


def test_what_the_images_miss_is_the_misfit():
    """Light goes back and forth between pixels of the aperture, much more than noise does."""
    x, y, measured = motion()
    moved = 0.02 * np.sin(2 * np.pi * TIME / 1.3)[:, None] * (GRID[:, 0] % 2 - 0.5)
    true = image(x, y)
    true = true * (1 + moved - (true * moved).sum(axis=1, keepdims=True))
    found = clean(FLUX * true, measured)
    np.testing.assert_allclose(found.misfit.sum(axis=1), 0, atol=1e-12)
    expected = true - image(x, y)
    bright = expected.std(axis=0) > 2e-3
    slopes = [
        np.polyfit(e, m, 1)[0]
        for e, m in zip(*(v.T[bright] for v in (expected, found.misfit)), strict=True)
    ]
    np.testing.assert_allclose(slopes, 1, atol=0.1)


def test_faint_noisy_star_is_not_taken_for_a_variable_one():
    x, y, measured = motion()
    flux, error = observed(300 * image(x, y) + 100 * image(x + 3, y))
    found = fit_star(TIME, flux, error, measured, GRID, np.ones(len(GRID), bool))
    assert found.constant == 0


@pytest.mark.parametrize("width", [3.0, 12.0, 60.0])
def test_local_lines_are_weighted_least_squares(width):
    rng = np.random.default_rng(5)
    use = rng.random(200) < 0.8
    time = np.cumsum(rng.choice([1.0, 2.0], 200))
    values, weight = 0.1 * time + rng.normal(size=200), np.where(use, 1.0, 1e-6)
    smooth, *_ = Smoother(time, use).lines(values, weight, width)
    for k in (0, 57, 199):
        kernel = np.exp(-0.5 * ((time - time[k]) / width) ** 2)
        kernel[np.abs(time - time[k]) > 3.5 * width + 1] = 0
        line = np.polynomial.Polynomial.fit(time - time[k], values, 1, w=np.sqrt(weight * kernel))
        np.testing.assert_allclose(smooth[k], line(0.0), rtol=1e-8)


def faint(seed=5):
    """Return the pixels of a faint star with many cosmic rays, its errors, and the rays."""
    x, y, measured = motion()
    flux, error = observed(1000 * image(x, y), noise=1.5)
    rng = np.random.default_rng(seed)
    rays = np.where(rng.random(flux.shape) < 0.005, rng.lognormal(np.log(20), 0.3, flux.shape), 0)
    return flux + rays, error, measured, rays


def test_light_of_a_faint_star_with_cosmic_rays():
    flux, error, measured, rays = faint()
    x, y, _ = motion()
    found = fit_star(TIME, flux, error, measured, GRID, np.ones(len(GRID), bool))
    shares = image(x, y)
    spread = 1.05 * np.median(np.abs(np.diff(found.light)))
    hit = (shares > 0.01) & (shares < 0.1) & (rays > 8 * error)
    assert found.repaired[hit].mean() > 0.9
    assert 0.8 * spread < np.median(found.light_error) < 1.25 * spread


@pytest.mark.parametrize("wing", [2.0, 3.0])
def test_light_that_a_wider_psf_loses_beside_the_stamp(wing):
    """Integrals of Gaussians with wings, of two widths."""
    x, y, _ = motion()

    def light(scale):
        return 0.9 * image(x, y, scale * SIGMA) + 0.1 * image(x, y, scale * wing)

    flow = Flow(pixels(GRID), np.ones(len(GRID), dtype=bool))
    lost = flow.lost(light(1.0), np.column_stack([x, y]))
    exact = (light(1 - 1e-3) - light(1 + 1e-3)).sum(axis=1) / 2e-3
    np.testing.assert_allclose(lost.mean(), exact.mean(), rtol=0.2)


def test_widening_of_a_column_of_pixels_does_not_depend_on_their_order():
    """None has pixels beside it along the rows."""
    x, y, _ = motion()
    column = np.flatnonzero(GRID[:, 0] == 4)
    light, center = image(x, y, 1.5)[:, column], np.column_stack([x, y])
    lost = [
        Flow(pixels(GRID[column[order]]), np.ones(len(order), bool)).lost(light[:, order], center)
        for order in (np.arange(len(column)), np.arange(len(column))[::-1])
    ]
    np.testing.assert_allclose(*lost, atol=1e-12)
