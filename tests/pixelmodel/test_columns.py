"""Full columns do not depend on what has bled."""

import numpy as np
import pytest
from scipy.special import ndtr

from scope_models.effects._noise import bleed
from scope_models.pixelmodel._stamp import Columns, full_columns
from scope_models.pixelmodel._star import fit_star

pytestmark = pytest.mark.usefixtures("one_thread")

FULL = 0.2  # of the light


def pixel_light(x, n, sigma=0.5):
    edges = (np.arange(n + 1) - 0.5 - np.asarray(x)[..., None]) / sigma
    return np.diff(ndtr(edges), axis=-1)


def test_sums_of_columns():
    """Full columns are one, the others stay; drawn again, the sums are the same."""
    grid = np.stack(np.meshgrid(np.arange(4), np.arange(9)), axis=-1).reshape(-1, 2)
    columns = Columns(grid, np.isin(grid[:, 0], [1, 2]))
    cube = np.random.default_rng(1).uniform(1, 2, (5, 9, 4))
    sums = columns.summed(cube.reshape(5, -1))
    assert sums.shape == (5, 2 + 18)
    for column in (1, 2):
        here = ~columns.single & (columns.places[:, 0] == column)
        np.testing.assert_allclose(sums[:, here][:, 0], cube[:, :, column].sum(axis=1))
        np.testing.assert_array_equal(columns.places[here, 1], 4)
    drawn = columns.drawn(sums).reshape(cube.shape)
    np.testing.assert_array_equal(drawn[:, :, [0, 3]], cube[:, :, [0, 3]])
    np.testing.assert_allclose(drawn.sum(axis=1), cube.sum(axis=1))
    changes = columns.drawn(np.sin(sums), sums).reshape(cube.shape)
    np.testing.assert_allclose(changes[:, :, [0, 3]], np.sin(cube[:, :, [0, 3]]))
    ratio = changes[:, :, 1] / drawn[:, :, 1]
    np.testing.assert_allclose(ratio, np.repeat(ratio[:, :1], 9, axis=1))
    ratio = drawn[:, :, 1] / cube[:, :, [0, 3]].sum(axis=2)
    np.testing.assert_allclose(ratio, np.repeat(ratio[:, :1], 9, axis=1))


def test_light_of_a_star_with_full_columns():
    """Sums of full columns follow position and brightness as pixels do, full pixels do not."""
    rng = np.random.default_rng(3)
    time = 0.02 * np.arange(600)
    x = 6.1 + 0.4 * (time / 0.245 % 1 - 0.5) + 0.05 * np.sin(time)
    y = 8.2 + 0.5 * (time / 0.245 % 1 - 0.5) ** 2 + 0.05 * np.cos(0.7 * time)
    response = 1 + 0.02 * rng.normal(size=(17, 13))
    signal = 1 + 0.02 * np.sin(2 * np.pi * time / 0.9)
    images = pixel_light(y, 17)[:, :, None] * pixel_light(x, 13, 0.7)[:, None, :] * response
    images *= signal[:, None, None]
    images = 1e7 * bleed(images, FULL)
    total = images.sum(axis=(1, 2))
    true = images.sum(axis=1) / total[:, None]
    error = np.sqrt(1e2 + images / 1600)
    images += error * rng.normal(size=images.shape)
    grid = np.stack(np.meshgrid(np.arange(13), np.arange(17)), axis=-1).reshape(-1, 2)
    position = np.column_stack([x - x.mean(), y - y.mean()])
    position += 0.003 * rng.normal(size=position.shape)
    flux, error = images.reshape(600, -1), error.reshape(600, -1)
    full = full_columns(images, np.ones(600, dtype=bool), 0.9 * FULL * 1e7)
    assert 1 < full.sum() < 5
    data = time, flux, error, position, grid, np.ones(len(grid), dtype=bool)
    noise = np.sqrt((error**2).sum(axis=1)) / total
    errors = []
    for part in (full[grid[:, 0]], None):
        model = fit_star(*data, full=part)
        assert np.std((model.light / total - 1) / noise) < 1.1
        columns = model.still.reshape(images.shape).sum(axis=1) - true
        errors.append(np.std(columns - columns.mean(axis=0)) / np.median(noise))
    assert errors[0] < 0.2  # 0.09, and 4.2
    assert errors[1] > 1
