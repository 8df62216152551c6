"""Regressors against products formed one by one."""

from itertools import combinations_with_replacement, product

import numpy as np
import pytest

from scope_models.correctors._model import PLDModel, Settings
from scope_models.pixelmodel._pixels import Pixels
from scope_models.regression import _columns
from scope_models.regression._columns import (
    Regressors,
    contrast_columns,
    power_columns,
    principal_columns,
    shared_columns,
)

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture
def fractions():
    values = np.random.default_rng(0).uniform(0.5, 1.5, (80, 5))
    return values / values.sum(axis=1)[:, None]


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_power_columns_span_all_products(fractions, order):
    use = np.ones(80, dtype=bool)
    columns = power_columns(fractions, order, use, 1e-16, 80)
    products = np.stack(
        [fractions[:, list(c)].prod(axis=1) for c in product(range(5), repeat=order)], axis=1
    )
    np.testing.assert_allclose(columns @ columns.T, products @ products.T, rtol=1e-6)
    assert columns.shape[1] <= len(list(combinations_with_replacement(range(5), order)))


def test_pivots_of_some_cadences_are_enough(monkeypatch):
    place = np.sin(np.linspace(0, 30, 3000))
    fractions = np.exp(-0.5 * (place[:, None] - np.arange(-2, 3)) ** 2)
    fractions /= fractions.sum(axis=1)[:, None]
    use = np.arange(3000) % 3 > 0
    monkeypatch.setattr(_columns, "_CANDIDATES", 300)
    columns = power_columns(fractions, 2, use, 1e-12, 80)
    left = np.sum(fractions**2, axis=1) ** 2 - np.sum(columns**2, axis=1)
    assert columns.shape == (3000, len(columns.T))
    assert left.max() < 1e-9


def test_power_columns_stop_at_the_tolerance_and_the_rank(fractions):
    use = np.arange(80) < 60
    kernel = (fractions @ fractions.T) ** 2
    columns = power_columns(fractions, 2, use, 1e-4, 80)
    rest = np.diag(kernel - columns @ columns.T)[use].mean()
    assert 1e-5 < rest < 1e-4
    assert columns.shape[1] < 15  # all products of two
    assert power_columns(fractions, 2, use, 2 * rest, 80).shape[1] < columns.shape[1]
    assert power_columns(fractions, 2, use, 1e-6, 3).shape == (80, 3)


def test_principal_columns_keep_the_kernel(fractions):
    use = np.arange(80) < 60
    columns = fractions - fractions[use].mean(axis=0)
    rotated = principal_columns(fractions, use, 0.0)
    np.testing.assert_allclose(rotated[use].mean(axis=0), 0, atol=1e-16)
    assert rotated.shape == (80, 4)  # fractions add up to one
    np.testing.assert_allclose(rotated @ rotated.T, columns @ columns.T, atol=1e-15)
    large = principal_columns(fractions, use, np.mean(rotated[use, 1] ** 2) * 0.999)
    np.testing.assert_allclose(large, rotated[:, :2], atol=1e-15)


def test_shared_columns():
    images = np.random.default_rng(1).uniform(size=(3, 4, 5))
    offsets = [d for d in product((-1, 0, 1), repeat=2) if d >= (0, 0)]
    expected = np.zeros((3, len(offsets)))
    for k, (dy, dx) in enumerate(offsets):
        for y, x in product(range(4), range(5)):
            if 0 <= y + dy < 4 and 0 <= x + dx < 5:
                expected[:, k] += images[:, y, x] * images[:, y + dy, x + dx]
    np.testing.assert_allclose(shared_columns(images, 1), expected, rtol=1e-13)


def test_shared_columns_do_not_depend_on_the_place():
    image = np.zeros((2, 9, 9))
    star = np.random.default_rng(2).uniform(size=(3, 3))
    image[0, 2:5, 1:4] = star
    image[1, 3:6, 5:8] = star
    columns = shared_columns(image, 2)
    np.testing.assert_allclose(columns[0], columns[1], rtol=1e-14)


def test_regressors_join():
    joined = Regressors.join({"a": np.zeros((4, 2)), "b": np.ones((4, 3))})
    assert joined.names == ("a", "b")
    np.testing.assert_array_equal(joined.groups, [0, 0, 1, 1, 1])
    assert joined.columns.sum() == 12


def make_pixels(flux, flux_err, total, total_err):
    all_pixels, cadences = np.ones((1, 5), dtype=bool), np.ones(80, dtype=bool)
    return Pixels(
        np.arange(80.0), flux, flux_err, all_pixels, total, total_err, cadences, None, all_pixels,
        1.0, cadences, ~cadences, all_pixels, None,
    )  # fmt: skip


def test_segments_and_extra_groups(fractions):
    flux = 100 * fractions.reshape(80, 1, 5)
    extra = np.random.default_rng(3).normal(size=(80, 2))
    extra[5] = np.nan
    pixels = make_pixels(flux, 0.01 * flux, np.full(80, 100.0), np.full(80, 1e-3))
    use = np.arange(80) % 7 > 0
    model = PLDModel(pixels, Settings(order=1), None, None, None, (30.5,), {"extra": extra})
    found = model.regressors(use)
    assert found.names == ("order 1", "segments", "extra")
    np.testing.assert_array_equal(np.bincount(found.groups), [4, 4, 2])
    sign = np.where(np.arange(80) < 31, 1, -1)[:, None]
    np.testing.assert_allclose(found.columns[:, 4:8], sign * found.columns[:, :4] / 2**0.5)
    np.testing.assert_array_equal(found.columns[5, 8:], 0)


@pytest.mark.parametrize("breaks", [(), (30.5,), (10.5, 30.5), (200.0,)])
def test_contrasts_are_copies_without_their_common_part(fractions, breaks):
    """With the columns themselves they give the covariance of one copy per segment."""
    time = np.arange(80.0)
    columns = contrast_columns(fractions, time, breaks, np.ones(80, dtype=bool))
    segment = np.searchsorted(breaks, time)
    k = len(np.unique(segment))
    assert columns.shape == (80, 5 * (k - 1))
    kernel = fractions @ fractions.T
    copies = kernel * (segment[:, None] == segment)
    np.testing.assert_allclose(columns @ columns.T, copies - kernel / k, atol=1e-14)


@pytest.mark.parametrize(("predicted", "groups"), [(True, ()), (False, ("shared",))])
def test_shared_products_of_measured_fractions_are_a_group(fractions, predicted, groups):
    """They follow the width; those of predicted ones have the prior of all products."""
    error = np.full((80, 1, 5), 1e-3)
    pixels = make_pixels(fractions.reshape(80, 1, 5), error, np.ones(80), np.full(80, 1e-4))
    clean = object() if predicted else None
    model = PLDModel(pixels, Settings(order=2), None, clean, None, (), {})
    found = model.regressors(np.ones(80, dtype=bool))
    assert found.names == ("order 1", "order 2", *groups)
