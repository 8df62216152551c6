"""Images of full columns do not depend on what has bled."""

import numpy as np
import pytest
from scipy.special import ndtr

from scope_models.effects._noise import bleed
from scope_models.pixelmodel._stamp import (
    find_row_centers,
    full_columns,
    rows_of_star,
    without_saturation,
)

FULL = 0.2  # of the light


def pixel_light(x, n, sigma=0.5):
    edges = (np.arange(n + 1) - 0.5 - np.asarray(x)[..., None]) / sigma
    return np.diff(ndtr(edges), axis=-1)


def make_images(x, y, *, tilt=0.0, response=None, light=1.0, full=FULL, shape=(17, 13)):
    """Images of a star at (x, y) that is tilted against the columns, and how they bleed."""
    ny, nx = shape
    rows = y[:, None] + tilt * (np.arange(nx) - x[:, None])
    images = light * pixel_light(x, nx, 0.7)[:, None, :] * pixel_light(rows, ny).swapaxes(1, 2)
    if response is not None:
        images = images * response
    return images, bleed(images.copy(), full)


@pytest.fixture
def track():
    """Positions that come to other columns and rows."""
    t = np.arange(400)
    x = 6 + 1.5 * np.sin(2 * np.pi * t / 97) + 0.1 * np.sin(t)
    return x, 8 + 1.2 * np.sin(2 * np.pi * t / 61)


def everything(images):
    return np.ones(images.shape[1:], dtype=bool), np.ones(len(images), dtype=bool)


def redrawn(images, saturation, aperture=None, use=None):
    every, all_used = everything(images)
    aperture, use = (every if aperture is None else aperture), (all_used if use is None else use)
    full = full_columns(np.where(aperture, images, 0.0), use, saturation)
    centers = find_row_centers(images, aperture, use, np.inf if saturation is None else saturation)
    return without_saturation(images, full, centers, aperture)


@pytest.mark.parametrize("tilt", [0.0, 0.3])
def test_row_centers(track, tilt):
    x, y = track
    images, bled = make_images(x, y, tilt=tilt)
    assert np.mean(bled.max(axis=(1, 2)) == pytest.approx(FULL)) > 0.9
    found = find_row_centers(bled, *everything(bled), FULL)
    sums = images.sum(axis=1)
    bright = sums > 0.05
    center = np.einsum("ijk,j->ik", images, np.arange(17))[bright] / sums[bright]
    # pixels of a narrow star move its center of light by a function of the place in the pixel
    scatter = np.std(found[bright] - center)
    assert scatter < 0.03
    # the center of all light in the full columns is off by more
    columns = bled[:, :, 5:8]
    light = np.einsum("ijk,j->i", columns, np.arange(17)) / columns.sum(axis=(1, 2))
    assert np.std(light - y) > 5 * scatter


def test_responses_hardly_move_the_row(track):
    """By less than their size in pixels: in fractions, times a response, this is second order."""
    x, y = track
    response = 1 + 0.03 * np.random.default_rng(0).standard_normal((17, 13))
    _, bled = make_images(x, y, response=response)
    found = find_row_centers(bled, *everything(bled), FULL)
    plain = find_row_centers(make_images(x, y)[1], *everything(bled), FULL)
    assert np.std((found - plain)[:, 6]) < 0.008


def test_cadences_without_light_have_no_row(track):
    images, _ = make_images(*track)
    images[7] = 0.0
    found = find_row_centers(images, *everything(images), FULL)
    assert np.isfinite(found).all()
    assert not redrawn(images, FULL)[7].any()


def test_full_columns_do_not_tell_the_brightness(track):
    x, y = track
    fractions = {}
    for light in (1.0, 0.99):
        _, bled = make_images(x, y, light=light)
        raw = bled / bled.sum(axis=(1, 2), keepdims=True)
        images = redrawn(bled, 0.9 * FULL)
        np.testing.assert_allclose(images.sum(axis=1), bled.sum(axis=1), rtol=1e-9, atol=1e-12)
        fractions[light] = images / images.sum(axis=(1, 2), keepdims=True), raw
    drawn, raw = (np.abs(a - b).max() for a, b in zip(*fractions.values(), strict=True))
    assert drawn < 5e-6
    assert raw > 500 * drawn


def test_columns_that_are_never_full_stay(track):
    x, y = track
    images, _ = make_images(x, y)
    aperture, use = everything(images)
    aperture[0, 0] = False
    for saturation in (None, 1e9):
        same = redrawn(images, saturation, aperture)
        np.testing.assert_array_equal(same[:, 0, 0], 0)
        np.testing.assert_array_equal(same[:, aperture], images[:, aperture])
    some = redrawn(images, FULL, aperture, use)
    np.testing.assert_array_equal(some[:, 1:, [0, 12]], images[:, 1:, [0, 12]])
    assert np.any(some[:, :, 6] != images[:, :, 6])


def test_cadences_that_are_not_used_do_not_count(track):
    x, y = track
    images, _ = make_images(x, y, light=0.4)
    aperture, use = everything(images)
    images[100:150] *= 10
    use[100:150] = False
    same = redrawn(images, FULL, aperture, use)
    np.testing.assert_array_equal(same, images)


def test_all_columns_full():
    """Where no column gives the row, the center of all light does."""
    y = 8 + np.linspace(-1, 1, 50)
    images = pixel_light(y, 17)[:, :, None] * np.ones(3)
    found = find_row_centers(images, *everything(images), 0.1)
    np.testing.assert_allclose(
        found - found.mean(), (y - y.mean())[:, None] * np.ones(3), atol=0.02
    )


def test_rows_of_a_star_that_varies_beside_another_one():
    """The center of light of both follows the star's brightness, and that of the star does not."""
    rng, time = np.random.default_rng(1), np.arange(600) / 49
    position = 0.3 * np.stack([time / 0.25 % 1 - 0.5, np.sin(2 * np.pi * time / 0.25)], axis=1)
    variable = 0.2 * np.sin(2 * np.pi * time / 0.63)
    star = 4 + position[:, 1:] + 0.02 * position[:, :1] + 1e-3 * rng.standard_normal((600, 2))
    part = 0.2 / (1.2 + variable)[:, None]
    centers = star + part * (2 - position[:, 1:])
    rows = rows_of_star(centers, position, variable, np.arange(600) % 3 > 0)
    shift = centers[:, 1] - rows[:, 1]
    assert np.std(centers[:, 1] - star[:, 1]) > 0.05
    follows = np.polyfit(variable, (rows - star)[:, 1], 1)[0] * variable.std()
    assert abs(follows) < 2e-4
    assert np.std(shift) > 0.04
    np.testing.assert_array_equal(rows_of_star(star, position, np.zeros(600), time > 0), star)
