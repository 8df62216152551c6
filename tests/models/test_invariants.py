"""Invariants of integrals over pixels that hold for all parameters, at random parameters."""

import numpy as np
import pytest

from scope_models import BivariateGaussianPSF, SensitivityPolynomial, TabulatedPSF, integrate_pixels
from scope_models.models._gaussian import gaussian_pixels

hypothesis = pytest.importorskip("hypothesis")
st = hypothesis.strategies

every = hypothesis.settings(
    derandomize=True, deadline=None, max_examples=80, database=None, print_blob=False
)
offsets = st.floats(-0.5, 0.5)
widths = st.floats(np.log(0.05), np.log(2.0)).map(np.exp)
shapes = st.tuples(widths, widths, st.floats(-0.97, 0.97))
rows = st.lists(st.floats(-1, 1), min_size=1, max_size=5)
PIXELS = np.arange(-20.0, 21.0)
# The series is cut at 1e-11 of the flux, and orders of 1e-13 remain of rounding errors.
TOLERANCE = 1e-12


def image(shape, x_0=0.0, y_0=0.0, x_row=(1,), y_row=(1,), pixels=PIXELS):
    return gaussian_pixels(pixels, pixels, x_0, y_0, *shape, x_row, y_row)


@every
@hypothesis.given(shapes, offsets, offsets)
def test_sum_over_pixels_is_the_flux(shape, x_0, y_0):
    assert abs(image(shape, x_0, y_0).sum() - 1) < TOLERANCE


@every
@hypothesis.given(shapes, offsets, offsets, rows, rows, st.integers(-9, 9), st.integers(-9, 9))
def test_whole_pixels_shift_the_image(shape, x_0, y_0, x_row, y_row, dx, dy):
    here = image(shape, x_0, y_0, x_row, y_row)
    there = image(shape, x_0 + dx, y_0 + dy, x_row, y_row)
    shifted = np.roll(here, (dy, dx), axis=(0, 1))
    assert np.max(np.abs(there - shifted)[9:-9, 9:-9]) < TOLERANCE


@every
@hypothesis.given(shapes, offsets, offsets, rows, rows)
def test_mirrors(shape, x_0, y_0, x_row, y_row):
    here = image(shape, x_0, y_0, x_row, y_row)
    signs = (-1.0) ** np.arange(len(x_row))
    mirrored = image((*shape[:2], -shape[2]), -x_0, y_0, signs * x_row, y_row)
    assert np.max(np.abs(mirrored[:, ::-1] - here)) < TOLERANCE
    swapped = image((shape[1], shape[0], shape[2]), y_0, x_0, y_row, x_row)
    assert np.max(np.abs(swapped.T - here)) < TOLERANCE


@every
@hypothesis.given(shapes, offsets, offsets, rows, rows, st.floats(0.1, 10), st.floats(-2, 2))
def test_linear_in_flux_and_response(shape, x_0, y_0, x_row, y_row, flux, factor):
    psf, bright = (BivariateGaussianPSF(f, x_0, y_0, *shape) for f in (1, flux))
    one = integrate_pixels(psf * SensitivityPolynomial(x_row, y_row), x=[0, 1], y=[0, -1])
    many = integrate_pixels(bright * SensitivityPolynomial(x_row, y_row), x=[0, 1], y=[0, -1])
    assert np.max(np.abs(many - flux * one)) < TOLERANCE * flux
    scaled = [factor * c for c in x_row]
    other = integrate_pixels(psf * SensitivityPolynomial(scaled, y_row), x=[0, 1], y=[0, -1])
    assert np.max(np.abs(other - factor * one)) < TOLERANCE


@every
@hypothesis.given(shapes, offsets, offsets)
def test_four_pixels_are_one_of_twice_the_size(shape, x_0, y_0):
    """Scaling: a star twice as wide and far on pixels half as small, four of which are summed."""
    small = image([2 * shape[0], 2 * shape[1], shape[2]], 2 * x_0 + 0.5, 2 * y_0 + 0.5)
    pairs = small[:-1, :-1].reshape(20, 2, 20, 2).sum(axis=(1, 3))
    large = image(shape, x_0, y_0)[10:-11, 10:-11]
    assert np.max(np.abs(pairs - large[: len(pairs), : len(pairs)])) < TOLERANCE


@hypothesis.settings(every, max_examples=40)  # of each of five derivatives
@hypothesis.given(shapes, offsets, offsets, rows, rows, st.floats(-0.1, 0.1))
def test_derivatives_add_up_to_the_difference(shape, x_0, y_0, x_row, y_row, part):
    """The integral of a derivative from one value to another is the difference of the images."""
    pixels = np.arange(-2.0, 3.0)
    start = np.array([x_0, y_0, *shape])
    nodes, weights = np.polynomial.legendre.leggauss(12)
    scale = min(*shape[:2]) * np.sqrt(1 - shape[2] ** 2)
    for k in range(5):
        step = part * (1 - shape[2] ** 2 if k == 4 else scale)
        path = np.repeat(start[:, np.newaxis], len(nodes), axis=1)
        path[k] += step * (nodes + 1) / 2
        slopes = gaussian_pixels(pixels, pixels, *path, x_row, y_row, derivatives=True)[1 + k]
        end = start.copy()
        end[k] += step
        ends = [gaussian_pixels(pixels, pixels, *p, x_row, y_row) for p in (start, end)]
        change = step / 2 * np.tensordot(weights, slopes, axes=1)
        assert np.max(np.abs(ends[1] - ends[0] - change)) < TOLERANCE


@every
@hypothesis.given(st.integers(0, 2**32 - 1), offsets, offsets, st.integers(-3, 3))
def test_tables_keep_their_sum_and_shift(seed, x_0, y_0, dx):
    samples = np.zeros((41, 41))
    samples[10:31, 10:31] = np.random.default_rng(seed).random((21, 21))
    images = [
        integrate_pixels(TabulatedPSF(samples, 5, 1, 10 + x_0 + d, 10 + y_0), (21, 21))
        for d in (0, dx)
    ]
    assert images[1] == pytest.approx(np.roll(images[0], dx, axis=1), abs=1e-12)
    centered = integrate_pixels(TabulatedPSF(samples, 5, 1, 10, 10), (21, 21))
    assert images[0].sum() == pytest.approx(centered.sum(), rel=1e-12)
