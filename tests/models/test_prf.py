"""The pixel-integrated model: its parameters, its images, and fits with it."""

import numpy as np
import pytest
from astropy import units as u
from astropy.modeling.fitting import TRFLSQFitter
from astropy.modeling.models import Const2D, Gaussian2D
from astropy.table import Table
from photutils.psf import GaussianPRF, MoffatPSF, PSFPhotometry, SourceGrouper

from scope_models import PRF, BivariateGaussianPSF, SensitivityPolynomial, integrate_pixels


def two_components(x=3.2, y=2.9):
    core = BivariateGaussianPSF(0.8, x, y, 0.5, 0.45, 0.2)
    wings = BivariateGaussianPSF(0.2, x + 0.1, y - 0.05, 1.2, 1.1)
    return (core + wings) * SensitivityPolynomial()


def test_is_the_integral_of_its_compound():
    compound = two_components()
    y, x = np.mgrid[:7, :7]
    np.testing.assert_allclose(
        PRF(compound)(x, y), integrate_pixels(compound, (7, 7)), rtol=0, atol=1e-15
    )


def test_parameters():
    prf = PRF(two_components(), flux=50.0)
    assert prf.param_names == (
        "flux", "x_0", "y_0", "sigma_x_0", "sigma_y_0", "rho_0", "sigma_x_1", "sigma_y_1", "rho_1",
        "flux_fraction_1", "x_offset_1", "y_offset_1", "ax0", "ax1", "ax2", "ay0", "ay1", "ay2",
    )  # fmt: skip
    assert prf.flux == 50
    assert prf.flux_fraction_1 == pytest.approx(0.2)
    assert prf.x_offset_1 == pytest.approx(0.1)
    alone = PRF(BivariateGaussianPSF(4.0, 1, 2) * SensitivityPolynomial((1,), (1,)))
    assert alone.param_names == ("flux", "x_0", "y_0", "sigma_x", "sigma_y", "rho", "ax0", "ay0")
    assert (alone.flux, alone.x_0, alone.y_0) == (4, 1, 2)


def test_constraints_come_from_the_components():
    psf = BivariateGaussianPSF(fixed={"rho": True}, bounds={"sigma_x": (0.2, 0.9)})
    prf = PRF(psf * SensitivityPolynomial())
    assert prf.fixed["rho"]
    assert not prf.fixed["sigma_x"]
    assert prf.bounds["sigma_x"] == (0.2, 0.9)
    assert all(prf.fixed[name] for name in ("ax0", "ax1", "ax2", "ay0", "ay1", "ay2"))
    assert not any(prf.tied.values())
    with pytest.raises(ValueError, match="`sigma_x` must be positive"):
        prf.sigma_x = -1


def test_moves_and_scales_as_a_whole():
    prf = PRF(two_components())
    y, x = np.mgrid[:9, :9]
    moved = prf.copy()
    moved.x_0, moved.y_0, moved.flux = 4.2, 3.9, 10
    image = prf(x[:-1, :-1], y[:-1, :-1])
    np.testing.assert_allclose(moved(x, y)[1:, 1:], 10 * image, rtol=0, atol=1e-14)


def test_constants_and_shared_sensitivities():
    """c * (a * s + b * s) with one s has the parameters of s once."""
    s = SensitivityPolynomial((1, 0, -0.3), (1,))
    a, b = BivariateGaussianPSF(1.0, 2, 2), BivariateGaussianPSF(3.0, 2, 2, 1.0, 1.0)
    compound = Const2D(2.0) * (a * s + b * s)
    prf = PRF(compound)
    assert prf.param_names[-4:] == ("ax0", "ax1", "ax2", "ay0")
    assert prf.flux == 8
    y, x = np.mgrid[:5, :5]
    np.testing.assert_allclose(prf(x, y), integrate_pixels(compound, (5, 5)), rtol=1e-13)
    other = SensitivityPolynomial((1,), (1,))
    several = PRF(a * s + b * s * other)
    assert several.param_names[-6:] == ("ax0_s0", "ax1_s0", "ax2_s0", "ay0_s0", "ax0_s1", "ay0_s1")
    np.testing.assert_allclose(
        several(x, y), integrate_pixels(a * s + b * s * other, (5, 5)), rtol=1e-13
    )


def test_render():
    prf = PRF(two_components())
    x = np.linspace(3, 3.5, 200)
    y = np.linspace(3, 2.9, 200)
    flux = np.linspace(100, 90, 200)
    cube = prf.render((7, 8), flux=flux, x_0=x, y_0=y)
    assert cube.shape == (200, 7, 8)
    rows, columns = np.mgrid[:7, :8]
    for i in (0, 50, 199):
        one = prf.copy()
        one.flux, one.x_0, one.y_0 = flux[i], x[i], y[i]
        np.testing.assert_allclose(cube[i], one(columns, rows), rtol=0, atol=1e-10)
    assert prf.render((7, 8)).shape == (7, 8)
    with_units = PRF(two_components(), flux=5 * u.electron / u.s).render((5, 5), x_0=[2, 3])
    assert with_units.unit == u.electron / u.s
    assert with_units.shape == (2, 5, 5)


def test_one_star_per_pixel():
    """photutils evaluates with an array of positions, one per pixel."""
    prf = PRF(BivariateGaussianPSF() * SensitivityPolynomial())
    x, y = np.arange(4.0), np.array([1.0, 1, 2, 2])
    x_0 = np.array([0.1, 1.2, 2.0, 2.6])
    flux = np.arange(1.0, 5.0)
    values = prf.evaluate(x, y, flux, x_0, 1.4, *prf.parameters[3:])
    for i in range(4):
        single = prf.evaluate(x[i], y[i], flux[i], x_0[i], 1.4, *prf.parameters[3:])
        assert values[i] == pytest.approx(single, rel=1e-12)


def test_other_densities():
    moffat = MoffatPSF(flux=3.0, x_0=3.1, y_0=2.9, alpha=0.8, beta=2.5)
    prf = PRF(moffat * SensitivityPolynomial())
    assert prf.param_names[:5] == ("flux", "x_0", "y_0", "alpha", "beta")
    y, x = np.mgrid[:7, :7]
    image = prf(x, y)
    np.testing.assert_allclose(
        image, integrate_pixels(moffat * SensitivityPolynomial(), (7, 7)), atol=1e-10
    )
    if prf.fit_deriv is not None:
        derivative = prf.fit_deriv(x, y, *prf.parameters)[1]
        step = np.zeros(prf.parameters.size)
        step[1] = 1e-5
        high = prf.evaluate(x, y, *(prf.parameters + step))
        low = prf.evaluate(x, y, *(prf.parameters - step))
        np.testing.assert_allclose(derivative, (high - low) / 2e-5, atol=1e-8)
    start = prf.copy()
    start.x_0, start.flux, start.alpha = 3.0, 2.5, 0.9
    for name in ("alpha", "beta"):
        getattr(start, name).fixed = False
    fitted = TRFLSQFitter()(start, x, y, image)
    np.testing.assert_allclose(fitted.parameters[:5], prf.parameters[:5], rtol=1e-5)


@pytest.mark.parametrize(
    ("compound", "message"),
    [
        (Gaussian2D(), "Gaussian2D has no parameter `flux`"),
        (GaussianPRF(), "GaussianPRF is already integrated over pixels"),
        (SensitivityPolynomial(), "one density times sensitivities, got nothing"),
        (BivariateGaussianPSF() * BivariateGaussianPSF(), "one density times sensitivities"),
        (BivariateGaussianPSF(0.0), "add up to a positive sum, got 0"),
        (BivariateGaussianPSF(1.0) - BivariateGaussianPSF(2.0), "add up to a positive sum"),
        (BivariateGaussianPSF(1.0, [1, 2]), "more than one value"),
        (BivariateGaussianPSF(tied={"sigma_y": lambda m: m.sigma_x}), "`sigma_y` is tied"),
    ],
)
def test_bad_compounds(compound, message):
    with pytest.raises(ValueError, match=message):
        PRF(compound)


def test_bad_values():
    prf = PRF(BivariateGaussianPSF())
    with pytest.raises(ValueError, match="`x_0` must be finite"):
        prf.render((3, 3), x_0=[1, np.nan])
    with pytest.raises(ValueError, match="must have the same length"):
        prf.render((3, 3), x_0=[1, 2], y_0=[1, 2, 3])
    with pytest.raises(TypeError, match="`shape` must be two integers"):
        prf.render(3)
    with pytest.raises(TypeError):
        PRF(BivariateGaussianPSF(), sigma_z=1)


def pulls(values, errors, truth):
    values, errors, truth = (np.asarray(a, dtype=float) for a in (values, errors, truth))
    return (values - truth) / errors


def assert_calibrated(pull, name):
    """Mean within 4 sigma of 0, standard deviation within 0.1 of 1 or twice its own error."""
    assert abs(pull.mean()) < 4 / np.sqrt(pull.size), name
    assert abs(pull.std() - 1) < max(0.1, np.sqrt(2 / pull.size)), (name, pull.std())


def quick_and(name, quick, whole):
    """Parametrize a test by a small number, and by a large one where time does not matter."""
    return pytest.mark.parametrize(name, [quick, pytest.param(whole, marks=pytest.mark.slow)])


@quick_and("n", 50, 400)
def test_fits_of_noisy_images_are_calibrated(n):
    """astropy's fitter, free shape, on noise realizations at random sub-pixel positions."""
    rng = np.random.default_rng(12)
    y, x = np.mgrid[:9, :9]
    start = PRF(BivariateGaussianPSF(9e4, 4, 4) * SensitivityPolynomial())
    fitter = TRFLSQFitter(calc_uncertainties=True)
    collected = []
    for _ in range(n):
        truth = start.copy()
        truth.flux = 1e5
        truth.x_0, truth.y_0 = rng.uniform(3.5, 4.5, 2)
        truth.sigma_x, truth.sigma_y, truth.rho = 0.55, 0.5, 0.15
        error = np.sqrt(truth(x, y) + 400)
        fitted = fitter(start, x, y, truth(x, y) + error * rng.normal(size=x.shape),
                        weights=1 / error)  # fmt: skip
        sigma = np.sqrt(np.diag(fitter.fit_info["param_cov"]))
        collected.append((fitted.parameters[:6] - truth.parameters[:6]) / sigma)
    collected = np.array(collected)
    for i, name in enumerate(start.param_names[:6]):
        assert_calibrated(collected[:, i], name)


def star_field(rng, positions, fluxes, model, shape, noise):
    image = np.zeros(shape)
    for (x_0, y_0), flux in zip(positions, fluxes, strict=True):
        image += model.render(shape, flux=flux, x_0=x_0, y_0=y_0)
    error = np.sqrt(image + noise**2)
    return image + error * rng.normal(size=shape), error


@quick_and("n_side", 6, 16)
@pytest.mark.parametrize("free", [False, True], ids=["fixed shape", "free shape"])
def test_photutils_single_stars(free, n_side):
    rng = np.random.default_rng(21)
    model = PRF(BivariateGaussianPSF(1.0, 0, 0, 0.6, 0.55, 0.2) * SensitivityPolynomial())
    for name in ("sigma_x", "sigma_y", "rho"):
        getattr(model, name).fixed = not free
    grid = np.arange(n_side) * 11 + 6.0
    positions = np.stack(np.meshgrid(grid, grid), -1).reshape(-1, 2)
    positions += rng.uniform(-0.5, 0.5, positions.shape)
    fluxes = rng.uniform(2e4, 1e5, len(positions))
    image, error = star_field(rng, positions, fluxes, model, (11 * n_side + 4,) * 2, 20)
    start = Table({"x": positions[:, 0] + 0.1, "y": positions[:, 1] - 0.1, "flux": fluxes * 0.9})
    photometry = PSFPhotometry(model, (9, 9), progress_bar=False)
    result = photometry(image, error=error, init_params=start)
    for name, truth in (("flux", fluxes), ("x", positions[:, 0]), ("y", positions[:, 1])):
        assert_calibrated(pulls(result[f"{name}_fit"], result[f"{name}_err"], truth), name)
    if free:
        assert_calibrated(pulls(result["sigma_x_fit"], result["sigma_x_err"], 0.6), "sigma_x")
    residual = photometry.make_residual_image(image, psf_shape=(11, 11)) / error
    assert residual.std() == pytest.approx(1, abs=0.1)


def blended_pairs(rng, n_side):
    """Positions of pairs of stars 2 px apart, each pair alone in its surroundings."""
    grid = np.arange(n_side) * 15 + 8.0
    first = np.stack(np.meshgrid(grid, grid), -1).reshape(-1, 2)
    first = first + rng.uniform(-0.5, 0.5, first.shape)
    angle = rng.uniform(0, 2 * np.pi, len(first))
    second = first + 2.0 * np.stack([np.cos(angle), np.sin(angle)], -1)
    return first, second


@quick_and("n_side", 4, 10)
def test_photutils_blended_groups(n_side):
    """
    Unbiased in groups; the errors are photutils' own.

    Its group fits count the pixels that several cutouts share once per cutout, so that errors come
    out too small, by a factor of 1.3 to 1.5 in this field for its CircularGaussianPRF as for ours.
    The next test shows that the same pairs are calibrated where every pixel counts once.
    """
    rng = np.random.default_rng(22)
    model = PRF(two_components(0, 0))
    for name in model.param_names[3:]:
        getattr(model, name).fixed = True
    positions = np.concatenate(blended_pairs(rng, n_side))
    fluxes = rng.uniform(3e4, 1e5, len(positions))
    image, error = star_field(rng, positions, fluxes, model, (15 * n_side + 10,) * 2, 20)
    start = Table({"x": positions[:, 0], "y": positions[:, 1], "flux": fluxes})
    photometry = PSFPhotometry(model, (7, 7), grouper=SourceGrouper(4.0), progress_bar=False)
    result = photometry(image, error=error, init_params=start)
    assert np.all(result["group_size"] == 2)
    order = np.argsort(result["id"])
    for name, truth in (("flux", fluxes), ("x", positions[:, 0]), ("y", positions[:, 1])):
        values, errors = result[f"{name}_fit"][order], result[f"{name}_err"][order]
        pull = pulls(values, errors, truth)
        assert abs(pull.mean()) < 4 * pull.std() / np.sqrt(pull.size), name
        assert pull.std() < 1.7, name


@quick_and("n", 25, 120)
def test_blended_pairs_are_calibrated_with_astropy(n):
    rng = np.random.default_rng(23)
    model = PRF(two_components(0, 0))
    for name in model.param_names[3:]:
        getattr(model, name).fixed = True
    fitter = TRFLSQFitter(calc_uncertainties=True)
    y, x = np.mgrid[:11, :11]
    collected = []
    for _ in range(n):
        first = rng.uniform(3.5, 4.5, 2)
        angle = rng.uniform(0, 2 * np.pi)
        second = first + 2.0 * np.array([np.cos(angle), np.sin(angle)])
        fluxes = rng.uniform(3e4, 1e5, 2)
        image, error = star_field(rng, [first, second], fluxes, model, x.shape, 20)
        pair = [model.copy(), model.copy()]
        for star, position, flux in zip(pair, (first, second), fluxes, strict=True):
            star.flux, star.x_0, star.y_0 = flux, *position
        start = pair[0] + pair[1]
        fitted = fitter(start, x, y, image, weights=1 / error)
        sigma = np.sqrt(np.diag(fitter.fit_info["param_cov"]))
        free = [i for i, name in enumerate(start.param_names) if not start.fixed[name]]
        collected.append((fitted.parameters[free] - start.parameters[free]) / sigma)
    collected = np.array(collected)
    for i in range(3):
        assert_calibrated(collected[:, [i, i + 3]].ravel(), model.param_names[i])


def test_render_as_astropy_does():
    """With an image, or without a shape, it is astropy's own method."""
    prf = PRF(BivariateGaussianPSF(7.0, 6.2, 5.9))
    image = prf.render(np.ones((13, 13)))
    np.testing.assert_allclose(image, 1 + prf.render((13, 13)), atol=1e-9)
    y, x = np.mgrid[:13, :13]
    np.testing.assert_allclose(prf.render(coords=(y, x)), prf.render((13, 13)), atol=1e-9)


def test_parts():
    sensitivity = SensitivityPolynomial((1, 0.1, -0.05))
    prf = PRF(two_components() * sensitivity * SensitivityPolynomial((1, 0, -0.2), (1,)))
    assert prf.n_components == 2
    assert prf.response_powers["ax2_s1"] == ("x", 2)
    kinds = prf.parameter_kinds
    assert kinds["sigma_x_0"] == "width"
    assert kinds["rho_1"] == "correlation"
    assert kinds["flux_fraction_1"] == "fraction"
    assert kinds["y_offset_1"] == "offset"
    assert kinds["ay1_s0"] == "response"
    again = PRF(prf.psf * prf.sensitivity, flux=prf.flux.value)
    np.testing.assert_allclose(again.render((7, 7)), prf.render((7, 7)), atol=1e-13)
    with pytest.raises(ValueError, match="`values` has no parameter sigma"):
        prf.unit_images((3, 3), values={"sigma": 1})
