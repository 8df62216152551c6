"""Integrals over pixels against numbers that were computed with fifty digits."""

from fractions import Fraction

import numpy as np
import pytest
from astropy.table import Table

from scope_models import BivariateGaussianPSF, SensitivityPolynomial, TabulatedPSF, integrate_pixels
from scope_models.models._gaussian import gaussian_pixels
from scope_models.models._series import ImageSeries

NAMES = ("x_0", "y_0", "sigma_x", "sigma_y", "rho")
# As in studies/fifty_digits.py, which wrote the table.
X_ROW, Y_ROW = (1.0, 0.1, -0.05, 0.2), (1.0, -0.2, -0.75)
PIXELS = np.arange(12.0)
# Largest errors, which the page on digits states.
LIMITS = {
    "test_integrals": 5e-15, "test_derivatives": 5e-13, "test_quadrature": 5e-14,
    "test_images_of_a_series": 2e-13, "test_tables_of_polynomials": 2e-13,
}  # fmt: skip


def hard_cases(repository):
    """Yield a pixel (row, column), the parameters, and the integral with its derivatives."""
    for row in Table.read(repository / "tests" / "data" / "fifty_digits.ecsv"):
        numbers = np.array(row["integral_and_slopes"].split(), dtype=float)
        yield (row["row"], row["column"]), [float(row[name]) for name in NAMES], numbers


def test_integrals(repository):
    cases = list(hard_cases(repository))
    assert len(cases) == 108
    for pixel, parameters, truth in cases:
        image = gaussian_pixels(PIXELS, PIXELS, *parameters, X_ROW, Y_ROW)
        assert abs(image[pixel] - truth[0]) < LIMITS["test_integrals"], (pixel, parameters)


def test_derivatives(repository):
    cases = [case for case in hard_cases(repository) if case[2].size > 1]
    assert len(cases) == 18
    for pixel, parameters, truth in cases:
        image = gaussian_pixels(PIXELS, PIXELS, *parameters, X_ROW, Y_ROW, derivatives=True)
        error = image[:, pixel[0], pixel[1]] - truth
        _, _, sigma_x, sigma_y, rho = parameters
        scale = np.array([1, sigma_x, sigma_y, sigma_x, sigma_y, 1 - rho**2])
        assert np.max(np.abs(error * scale)) < LIMITS["test_derivatives"], (pixel, parameters)


def test_quadrature(repository):
    """The rules that serve any density, where they may be used within reason."""
    cases = [c for c in hard_cases(repository) if c[1][2] >= 0.3 and abs(c[1][4]) < 0.95]
    assert len(cases) >= 30
    for (row, column), parameters, truth in cases[::3]:
        model = BivariateGaussianPSF(1, *parameters) * SensitivityPolynomial(X_ROW, Y_ROW)
        value = integrate_pixels(model, x=[column], y=[row], method="quadrature")
        assert abs(value[0] - truth[0]) < LIMITS["test_quadrature"], (row, column, parameters)


def test_images_of_a_series(repository):
    """The interpolated images of the simulator, among other positions."""
    rng = np.random.default_rng(1)
    cases = [c for c in hard_cases(repository) if c[0] == (3, 3) and abs(c[1][4]) < 0.99]
    assert len(cases) >= 20
    for pixel, (x_0, y_0, *shape), truth in cases:
        x, y = rng.uniform(2.5, 3.5, (2, 300))
        x[7], y[7] = x_0, y_0
        psf = BivariateGaussianPSF(1, 0, 0, *shape)
        series = ImageSeries(psf, SensitivityPolynomial(X_ROW, Y_ROW), (12, 12), x, y)
        rows, columns = series.window
        value = series(x, y)[7, pixel[0] - rows.start, pixel[1] - columns.start]
        assert abs(value - truth[0]) < LIMITS["test_images_of_a_series"], (x_0, y_0, shape)


def test_the_page_states_what_is_tested(repository):
    page = (repository / "docs" / "evaluation_digits.rst").read_text(encoding="utf-8")
    rows = [line for line in page.splitlines() if "``test_" in line]
    for (name, limit), row in zip(LIMITS.items(), rows, strict=True):
        assert name in globals()
        assert row.startswith(f"{limit:.0e} ")
        assert f"``{name}``" in row


def test_the_kept_numbers_repeat(repository):
    pytest.importorskip("mpmath")
    import mpmath
    from fifty_digits import exact

    cases = list(hard_cases(repository))
    for pixel, parameters, truth in cases[10::40]:
        value = exact(pixel[1], pixel[0], *map(mpmath.mpf, parameters))
        assert float(value) == pytest.approx(truth[0], rel=1e-15, abs=1e-300)


def polynomial_integral(powers, lows, highs):
    """Return the integral of a sum of monomials c x^n y^m over a rectangle, of fractions."""
    total = Fraction(0)
    for (n, m), c in powers.items():
        parts = [(high ** (k + 1) - low ** (k + 1)) / (k + 1)
                 for k, low, high in zip((n, m), lows, highs, strict=True)]  # fmt: skip
        total += Fraction(c) * parts[0] * parts[1]
    return total


@pytest.mark.parametrize("place", [(3.0, 3.0), (3.5, 2.5), (3.25, 2.8125), (0.4375, 3.0)])
def test_tables_of_polynomials(place):
    """A spline of degree 5 is the polynomial itself: its integrals are fractions."""
    powers = {(0, 0): 3.0, (1, 0): -0.5, (2, 3): 0.25, (5, 4): -0.125, (4, 5): 0.0625}
    y, x = np.mgrid[-12:13, -12:13] / 8
    samples = sum(c * x**n * y**m for (n, m), c in powers.items())
    image = integrate_pixels(TabulatedPSF(samples, 8, 1, *place), (7, 7))
    reach = Fraction(3, 2)
    for i in range(7):
        for j in range(7):
            center = [Fraction(p) - Fraction(c) for p, c in zip((i, j), place, strict=True)]
            lows = [max(c - Fraction(1, 2), -reach) for c in center]
            highs = [min(c + Fraction(1, 2), reach) for c in center]
            inside = all(low < high for low, high in zip(lows, highs, strict=True))
            exact = float(polynomial_integral(powers, lows, highs)) if inside else 0.0
            assert abs(image[j, i] - exact) < LIMITS["test_tables_of_polynomials"]


@pytest.mark.parametrize(("samples", "largest"), [(5, 1e-6), (9, 2e-8), (19, 2e-10)])
def test_tables_of_gaussians(samples, largest):
    """What 5, 9 and 19 samples per pixel leave of a density of 0.5 px."""
    half = 4 * samples
    y, x = np.mgrid[-half : half + 1, -half : half + 1] / samples
    shape = (0.5, 0.5, 0.3)
    table = TabulatedPSF(BivariateGaussianPSF(1, 0, 0, *shape)(x, y), samples, 1, 3.3, 3.4)
    image = integrate_pixels(table, (7, 7))
    exact = gaussian_pixels(PIXELS[:7], PIXELS[:7], 3.3, 3.4, *shape)
    assert np.max(np.abs(image - exact)[2:5, 2:5]) < largest
