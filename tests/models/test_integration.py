"""Pixel integrals against adaptive quadrature, closed forms and limits."""

import numpy as np
import pytest
from astropy import units as u
from astropy.modeling.models import Box2D, Const2D, Gaussian2D, Identity, Mapping, Moffat2D
from photutils.psf import (
    AiryDiskPSF,
    CircularGaussianPRF,
    CircularGaussianPSF,
    GaussianPRF,
    GaussianPSF,
    MoffatPSF,
)
from scipy.stats import norm

from scope_models import PRF, BivariateGaussianPSF, SensitivityPolynomial, integrate_pixels
from scope_models.exceptions import IntegrationWarning
from scope_models.models import _gaussian
from scope_models.models._gaussian import axis_table, gaussian_pixels, n_terms, uses_series


def adaptive(model, i, j, tolerance=1e-12):
    """Integral over pixel (i, j) of the point-wise model, by panels that double until it stays."""
    nodes, weights = np.polynomial.legendre.leggauss(12)
    before = np.inf
    for n in (3, 6, 12, 24, 48):
        places = (np.arange(n)[:, None] + 0.5 + nodes / 2).ravel() / n - 0.5
        left = np.tile(weights / 2 / n, n)
        values = model.evaluate(i + places, (j + places)[:, None], *model.parameters)
        total = left @ values @ left
        if abs(total - before) < tolerance + 1e-11 * abs(total):
            return total
        before = total
    raise AssertionError("the integral has not converged")


def dense(values, degree_x, degree_y, pixels):
    """Integrals by a rule of 12 x 30 nodes per axis, far more than any case needs."""
    x_0, y_0, sigma_x, sigma_y, rho = values
    nodes, weights = np.polynomial.legendre.leggauss(30)
    panels = (np.arange(12)[:, None] + 0.5 + nodes / 2).ravel() / 12 - 0.5
    weights = np.tile(weights / 24, 12)
    left = weights * np.polynomial.polynomial.polyval(panels, degree_y)
    right = weights * np.polynomial.polynomial.polyval(panels, degree_x)
    images = np.empty((pixels.size, pixels.size))
    for row, j in enumerate(pixels):
        for column, i in enumerate(pixels):
            z_x = (i + panels - x_0) / sigma_x
            z_y = ((j + panels - y_0) / sigma_y)[:, None]
            density = np.exp(-(z_x**2 - 2 * rho * z_x * z_y + z_y**2) / (2 * (1 - rho**2)))
            images[row, column] = left @ density @ right
    return images / (2 * np.pi * sigma_x * sigma_y * np.sqrt(1 - rho**2))


@pytest.mark.parametrize(
    ("sigma_x", "sigma_y", "rho"),
    [(0.15, 0.15, 0.0), (0.15, 0.3, 0.95), (0.5, 0.5, 0.4), (4.0, 3.0, -0.95), (1.0, 0.4, -0.6)],
)
def test_matches_adaptive_quadrature(sigma_x, sigma_y, rho):
    core = BivariateGaussianPSF(0.7, 3.21, 2.83, sigma_x, sigma_y, rho)
    wings = BivariateGaussianPSF(0.3, 3.1, 2.9, 2 * sigma_x, 1.5 * sigma_y, rho / 2)
    model = (core + wings) * SensitivityPolynomial((1, 0.1, -0.3), (1, -0.05, -0.05, 0.2, 0.1, 0.3))
    image = integrate_pixels(model, shape=(6, 7))
    for i, j in [(3, 3), (4, 2)]:
        assert abs(image[j, i] - adaptive(model, i, j)) < 1e-12


@pytest.mark.parametrize("seed", range(8))
def test_random_components(seed):
    """One to three components over the whole stated domain, within 1e-12 of a dense rule."""
    rng = np.random.default_rng(seed)
    pixels = np.arange(7.0)
    x_row, y_row = (rng.uniform(-1, 1, rng.integers(1, 7)) for _ in range(2))
    truth = np.zeros((7, 7))
    model = None
    for _ in range(rng.integers(1, 4)):
        sigma_x, sigma_y = np.exp(rng.uniform(np.log(0.15), np.log(4), 2))
        values = (*rng.uniform(1, 5, 2), sigma_x, sigma_y, rng.uniform(-0.95, 0.95))
        truth += dense(values, x_row, y_row, pixels)
        component = BivariateGaussianPSF(1, *values)
        model = component if model is None else model + component
    image = integrate_pixels(model * SensitivityPolynomial(x_row, y_row), shape=(7, 7))
    assert np.max(np.abs(image - truth)) < 1e-12


@pytest.mark.parametrize("method", ["auto", "quadrature"])
@pytest.mark.parametrize("offset", [-0.5, -0.499, 0.0, 0.3, 0.5])
def test_sub_pixel_positions(offset, method):
    values = (3 + offset, 3 - offset, 0.4, 0.6, 0.3)
    truth = dense(values, [1, 0, -0.05], [1, 0, -0.05], np.arange(7.0))
    model = BivariateGaussianPSF(1, *values) * SensitivityPolynomial()
    assert np.max(np.abs(integrate_pixels(model, (7, 7), method=method) - truth)) < 1e-12


@pytest.mark.parametrize("rho", [0.0, 0.3, 0.8, 0.93])
def test_series_and_line_rule_agree(rho):
    """The two engines are independent of each other; both must serve any correlation."""
    values = [np.array([v]) for v in (2.2, 1.9, 0.6, 0.5, rho)]
    rows = np.array([1.0, 0.2, -0.4]), np.array([1.0, 0.0, -0.05])
    pixels = np.arange(5.0)
    series, line = np.zeros((2, 1, 1, 5, 5))
    _gaussian._series_images(pixels, pixels, values, rows, series)
    _gaussian._line_images(pixels, pixels, values, rows, line)
    assert np.max(np.abs(series - line)) < 2e-13


def test_engine_is_chosen_by_cost():
    assert n_terms(np.array(0.0)) == 1
    assert uses_series(0.5, 0.4, 2)
    assert not uses_series(1.0, 0.95, 2)


@pytest.mark.parametrize("sigma", [0.15, 0.5, 1.1, 4.0])
@pytest.mark.parametrize("span", [1e-9, 0.3, 6.0])
def test_interpolated_positions_equal_direct_ones(sigma, span):
    """Many positions are interpolated; each must be what it is alone."""
    centers = 4 + span * np.linspace(-0.5, 0.5, 1001)
    row = np.array([1.0, 0.1, -0.05])
    pixels = np.arange(9.0)
    every = slice(None)
    together = axis_table(pixels, centers, np.array([sigma]), row, 20, rho=0.4)(every)
    alone = np.concatenate(
        [axis_table(pixels, centers[i : i + 50], np.array([sigma]), row, 20)(every)
         for i in range(0, 1001, 50)]
    )  # fmt: skip
    weight = 0.4 ** (0.5 * np.arange(20))[:, None]
    assert np.max(np.abs(together - alone) * weight) < 1e-12


def test_interpolation_holds_for_cubes():
    rng = np.random.default_rng(3)
    x, y = 4 + rng.normal(0, 0.3, (2, 600))
    rows = (1, 0, -0.05), (1, 0, -0.05)
    pixels = np.arange(9.0)
    cube = gaussian_pixels(pixels, pixels, x, y, 0.5, 0.45, 0.35, *rows)
    for i in (0, 17, 599):
        image = gaussian_pixels(pixels, pixels, x[i], y[i], 0.5, 0.45, 0.35, *rows)
        assert np.max(np.abs(cube[i] - image)) < 1e-12


@pytest.mark.parametrize(
    "psf",
    [
        MoffatPSF(flux=1.0, x_0=3.2, y_0=2.9, alpha=0.6, beta=2.5),
        AiryDiskPSF(flux=1.0, x_0=3.2, y_0=2.9, radius=1.5),
        GaussianPSF(flux=1.0, x_0=3.2, y_0=2.9, x_fwhm=0.8, y_fwhm=1.4, theta=25.0),
        CircularGaussianPSF(flux=1.0, x_0=3.2, y_0=2.9, fwhm=1.1),
        Gaussian2D(1.0, 3.2, 2.9, 0.4, 0.7, theta=0.4),
        Moffat2D(1.0, 3.2, 2.9, 0.5, 3.0),
    ],
    ids=lambda psf: type(psf).__name__,
)
def test_other_smooth_models(psf):
    model = psf * SensitivityPolynomial((1, 0, -0.3), (1, 0.1, -0.05))
    image = integrate_pixels(model, shape=(6, 7))
    for i, j in [(3, 3), (4, 3)]:
        assert abs(image[j, i] - adaptive(model, i, j)) < 1e-12
    by_nodes = integrate_pixels(model, shape=(6, 7), method="quadrature")
    assert np.max(np.abs(image - by_nodes)) < 1e-11


def test_gaussian_without_sensitivity_is_photutils_prf():
    sigma_to_fwhm = 2 * np.sqrt(2 * np.log(2))
    y, x = np.mgrid[:7, :7]
    ours = integrate_pixels(BivariateGaussianPSF(5, 3.1, 2.8, 0.5, 0.5), x=x, y=y)
    theirs = CircularGaussianPRF(flux=5, x_0=3.1, y_0=2.8, fwhm=0.5 * sigma_to_fwhm)(x, y)
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-13)


def test_joint_integral_is_not_the_product_of_integrals():
    """
    A star that moves by a pixel over s = 1 - 0.05 u^2 varies; as a product of integrals it cannot.

    u^2 is periodic with the Fourier series 1/12 + sum (-1)^k cos(2 pi k x) / (pi k)^2, which the
    Gaussian damps by exp(-2 (pi k sigma)^2).
    """
    sigma = 0.5
    x = np.linspace(7, 8, 41)
    psf = BivariateGaussianPSF(1.0, x, 7.0, sigma, sigma)
    joint = integrate_pixels(psf * SensitivityPolynomial((1, 0, -0.05), (1,)), (15, 15))
    k = np.arange(1, 6)
    terms = (-1.0) ** k / (np.pi * k) ** 2 * np.exp(-2 * (np.pi * k * sigma) ** 2)
    expected = 1 - 0.05 * (1 / 12 + np.cos(2 * np.pi * np.outer(x, k)) @ terms)
    np.testing.assert_allclose(joint.sum(axis=(1, 2)), expected, rtol=0, atol=1e-12)
    assert np.ptp(expected) * 1e6 == pytest.approx(72.9, abs=0.1)
    alone = integrate_pixels(psf, (15, 15)).sum(axis=(1, 2))
    assert np.ptp(alone) < 1e-14


def test_constant_integrates_to_itself():
    np.testing.assert_allclose(integrate_pixels(Const2D(3.0), (2, 3)), np.full((2, 3), 3.0))
    mean = (1 - 0.05 / 12) ** 2
    sensitivity = integrate_pixels(Const2D(2.0) * SensitivityPolynomial(), (2, 2))
    np.testing.assert_allclose(sensitivity, np.full((2, 2), 2 * mean), rtol=1e-15)


def test_sums_differences_and_constants_distribute():
    a, b = BivariateGaussianPSF(2, 1.1, 2.0), BivariateGaussianPSF(1, 2.0, 2.2, 0.8, 0.7)
    s, c = SensitivityPolynomial(), Const2D(3.0)
    parts = [integrate_pixels(m, (5, 5)) for m in (a * s, b * s)]
    whole = integrate_pixels(c * (a - b) * s, (5, 5))
    np.testing.assert_allclose(whole, 3 * (parts[0] - parts[1]), rtol=0, atol=1e-15)


def test_product_of_sensitivities():
    psf = BivariateGaussianPSF(1, 2.1, 2.0)
    first, second = SensitivityPolynomial((1, 0.1), (1,)), SensitivityPolynomial((1, 0, -1), (1, 2))
    together = SensitivityPolynomial(np.polymul([0.1, 1], [-1, 0, 1])[::-1], (1, 2))
    np.testing.assert_allclose(
        integrate_pixels(psf * first * second, (5, 5)),
        integrate_pixels(psf * together, (5, 5)),
        rtol=0, atol=1e-15,
    )  # fmt: skip


def test_points_and_grids_agree():
    model = BivariateGaussianPSF(1, 3.1, 2.2, 0.6, 0.5, 0.3) * SensitivityPolynomial()
    image = integrate_pixels(model, shape=(6, 8))
    y, x = np.mgrid[:6, :8]
    np.testing.assert_array_equal(integrate_pixels(model, x=x, y=y), image)
    np.testing.assert_array_equal(integrate_pixels(model, x=x.ravel(), y=y.ravel()), image.ravel())
    order = np.random.default_rng(1).permutation(48)[:11]
    some = integrate_pixels(model, x=x.ravel()[order], y=y.ravel()[order])
    np.testing.assert_allclose(some, image.ravel()[order], rtol=0, atol=1e-15)
    assert integrate_pixels(model, x=3, y=2).shape == ()
    np.testing.assert_array_equal(integrate_pixels(model, x=np.arange(8), y=y[:, :1]), image)


def test_scattered_points_between_pixels():
    """Off the integers the pixel is the unit square around the point, its own center at u = 0."""
    rng = np.random.default_rng(5)
    x, y = rng.uniform(0, 6, (2, 40))
    s = SensitivityPolynomial()
    values = integrate_pixels(BivariateGaussianPSF(1, 3.0, 3.0) * s, x=x, y=y)
    for k in (0, 7, 39):
        shifted = BivariateGaussianPSF(1, 3.0 - x[k], 3.0 - y[k]) * s
        assert values[k] == pytest.approx(integrate_pixels(shifted, x=0, y=0), abs=1e-14)


def test_array_parameters_give_cubes():
    x = np.linspace(2, 4, 5)
    flux = np.arange(1.0, 6.0)
    for leaf in (
        BivariateGaussianPSF(flux, x, 2.5, 0.5, np.linspace(0.3, 0.7, 5), 0.2),
        Gaussian2D(flux, x, 2.5, 0.5, 0.4),
        MoffatPSF(flux=flux, x_0=x, y_0=2.5, alpha=0.8, beta=2.5),
    ):
        cube = integrate_pixels(leaf * SensitivityPolynomial(), shape=(5, 6))
        assert cube.shape == (5, 5, 6)
        for i in range(5):
            values = {n: np.broadcast_to(getattr(leaf, n).value, 5)[i] for n in leaf.param_names}
            single = integrate_pixels(type(leaf)(**values) * SensitivityPolynomial(), (5, 6))
            np.testing.assert_allclose(cube[i], single, rtol=0, atol=1e-11)


def test_units():
    rate = u.electron / u.s
    psf = BivariateGaussianPSF(5 * rate, 2.1 * u.pix, 2 * u.pix, 0.5 * u.pix, 0.5 * u.pix)
    image = integrate_pixels(psf * SensitivityPolynomial(), shape=(5, 5))
    assert image.unit == rate
    plain = BivariateGaussianPSF(5, 2.1, 2) * SensitivityPolynomial()
    np.testing.assert_allclose(image.value, integrate_pixels(plain, shape=(5, 5)), rtol=1e-14)
    by_nodes = integrate_pixels(psf * SensitivityPolynomial(), shape=(5, 5), method="quadrature")
    np.testing.assert_allclose(by_nodes.to_value(rate), image.value, rtol=0, atol=1e-10)


@pytest.mark.parametrize("prf", [GaussianPRF(), CircularGaussianPRF(), PRF(BivariateGaussianPSF())])
def test_integrated_models_refuse_a_sensitivity(prf):
    with pytest.raises(ValueError, match=f"{type(prf).__name__} is already integrated over pixels"):
        integrate_pixels(prf * SensitivityPolynomial(), shape=(5, 5))
    with pytest.raises(ValueError, match="already integrated"):
        integrate_pixels(prf * BivariateGaussianPSF(), shape=(5, 5))
    with pytest.raises(ValueError, match="already integrated"):
        integrate_pixels(prf ** Const2D(2), shape=(5, 5))
    y, x = np.mgrid[:5, :5]
    np.testing.assert_allclose(integrate_pixels(prf, (5, 5)), prf(x, y), rtol=1e-12, atol=1e-16)
    flat = SensitivityPolynomial((2.0,), (0.5, 0.0))
    np.testing.assert_allclose(
        integrate_pixels(prf * flat, (5, 5)), prf(x, y), rtol=1e-12, atol=1e-16
    )


def test_a_step_within_a_pixel_converges_or_warns():
    box = Box2D(1.0, 2.0, 2.0, x_width=1.5, y_width=1.5)
    image = integrate_pixels(box, shape=(5, 5))
    expected = np.outer([0, 0.25, 1, 0.25, 0], [0, 0.25, 1, 0.25, 0])
    np.testing.assert_allclose(image, expected, atol=1e-12)
    odd = Box2D(1.0, 2.0, 2.0, x_width=1.37, y_width=1.5)
    with pytest.warns(IntegrationWarning, match="over 6 pixels has not converged") as caught:
        image = integrate_pixels(odd, shape=(5, 5))
    assert [warning.filename for warning in caught] == [__file__]
    assert image.sum() == pytest.approx(1.37 * 1.5, abs=1e-3)


def test_far_stars_are_not_missed_nor_invented():
    model = BivariateGaussianPSF(1, -3.0, 2.0, 0.5, 0.5, 0.3)
    image = integrate_pixels(model, shape=(5, 5))
    assert image[2, 0] == pytest.approx(adaptive(model, 0, 2, 1e-16), rel=1e-6, abs=1e-13)
    assert integrate_pixels(BivariateGaussianPSF(1, -50.0, 2.0), shape=(5, 5)).max() == 0


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ((5,), TypeError, "`model` must be an astropy model"),
        ((Identity(2),), ValueError, "two inputs, one output"),
        ((BivariateGaussianPSF(), None), ValueError, "give either `shape`, or both"),
        ((BivariateGaussianPSF(), 5), TypeError, "`shape` must be two integers"),
        ((BivariateGaussianPSF(), (0, 5)), ValueError, "`shape` must be at least 1"),
    ],
)
def test_bad_arguments(arguments, error, message):
    with pytest.raises(error, match=message):
        integrate_pixels(*arguments, **({"shape": (2, 2)} if len(arguments) == 1 else {}))


def test_bad_positions_and_methods():
    psf = BivariateGaussianPSF()
    with pytest.raises(ValueError, match="give either `shape`, or both"):
        integrate_pixels(psf, (2, 2), x=[1], y=[1])
    with pytest.raises(ValueError, match="give either `shape`, or both"):
        integrate_pixels(psf, x=[1])
    with pytest.raises(ValueError, match="must broadcast"):
        integrate_pixels(psf, x=[1, 2], y=[1, 2, 3])
    with pytest.raises(ValueError, match="must be finite"):
        integrate_pixels(psf, x=[1, np.nan], y=[1, 2])
    with pytest.raises(ValueError, match="at least one pixel"):
        integrate_pixels(psf, x=[], y=[])
    with pytest.raises(ValueError, match="`method` must be one of"):
        integrate_pixels(psf, (2, 2), method="oversample")
    with pytest.raises(ValueError, match="no closed form"):
        integrate_pixels(Moffat2D(), (2, 2), method="analytic")
    shifted = Mapping((0, 1)) | BivariateGaussianPSF(1, np.arange(3.0))
    with pytest.raises(ValueError, match="more than one value work in sums and products"):
        integrate_pixels(shifted, (2, 2))


def test_many_positions_beyond_the_reach():
    """A star that is only just within reach of the outermost pixel gives them next to nothing."""
    columns = -0.5 - 8 * 0.5 - np.linspace(0, 0.2, 101)
    psf = BivariateGaussianPSF(1.0, columns, 3.0, 0.5, 0.5)
    image = integrate_pixels(psf, shape=(7, 7))
    assert image.shape == (101, 7, 7)
    assert np.abs(image).max() < 1e-13
    cube = PRF(BivariateGaussianPSF()).render((7, 7), x_0=columns, y_0=3.0)
    assert np.abs(cube).max() < 1e-13


def test_densities_that_are_nearly_lines():
    """A series would need 10^9 terms, a tensor of nodes 30,000 along each axis of a pixel."""
    rho, s = 1 - 1e-8, 0.5
    pixels = np.arange(9.0)
    image = gaussian_pixels(pixels, pixels, 4.2, 4.2, s, s, rho)
    edges = norm.cdf((np.arange(10) - 0.5 - 4.2) / s)
    assert np.max(np.abs(np.diag(image) - np.diff(edges))) < 1e-4  # sqrt(1 - rho^2) at the corners
    assert image.sum() == pytest.approx(1, abs=1e-12)
