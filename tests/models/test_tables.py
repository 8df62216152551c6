"""Tables of PSFs and PRFs: against exact models, photutils, and files of official formats."""

import copy
import pickle

import numpy as np
import pytest
from astropy import units as u
from astropy.io import fits
from astropy.modeling.models import Const2D
from astropy.table import Table
from photutils.psf import GaussianPRF, ImagePSF, PSFPhotometry

from scope_models import (
    PRF,
    BivariateGaussianPSF,
    Detector,
    Motion,
    SensitivityPolynomial,
    Star,
    TabulatedPSF,
    integrate_pixels,
    simulate,
)
from scope_models.models import PRFGrid, TabulatedPRF
from scope_models.models._description import describe_model, make_model

GAUSSIAN = BivariateGaussianPSF(1, 0, 0, 0.5, 0.55, 0.1)
SAMPLES = np.mgrid[-58:59, -58:59] / 9


@pytest.fixture(scope="module")
def table():
    """An exact PRF at 9 samples per pixel."""
    y, x = SAMPLES
    return TabulatedPRF(PRF(GAUSSIAN)(x, y), 9, uncertainty=np.full(x.shape, 1e-3))


def rms_ppm(images, expected):
    return 1e6 * np.sqrt(np.mean((images - expected)[:, 4:7, 4:7] ** 2))


def test_samples_come_back(table):
    y, x = SAMPLES
    np.testing.assert_allclose(table(x, y), table.array, atol=1e-12)
    assert table(6.6, 0.0) == 0.0


def test_accuracy_between_samples(table):
    x_0, y_0 = np.random.default_rng(1).uniform(4.5, 5.5, (2, 500))
    exact = PRF(GAUSSIAN).render((11, 11), x_0=x_0, y_0=y_0)
    assert rms_ppm(PRF(table).render((11, 11), x_0=x_0, y_0=y_0), exact) < 0.02


def test_density_times_sensitivity():
    """The spline's integral is exact: as good as the samples, and as adaptive quadrature."""
    y, x = SAMPLES
    psf, response = TabulatedPSF(GAUSSIAN(x, y), 9), SensitivityPolynomial((1, 0.05, -0.3))
    x_0, y_0 = np.random.default_rng(1).uniform(4.5, 5.5, (2, 60))
    prf = PRF(psf * response)
    exact = PRF(GAUSSIAN * response).render((11, 11), x_0=x_0, y_0=y_0)
    assert rms_ppm(prf.render((11, 11), x_0=x_0, y_0=y_0), exact) < 0.02
    moved = (psf * response).copy()
    moved.x_0_0, moved.y_0_0 = 2.03, 1.9
    one = {"x": [1.0], "y": [2.0]}
    np.testing.assert_allclose(
        integrate_pixels(moved, **one),
        integrate_pixels(moved, **one, method="quadrature"),
        atol=1e-10,
    )


@pytest.mark.parametrize("kind", ["density", "fluxes"])
def test_gradients_are_differences(kind, table):
    y, x = SAMPLES
    response = SensitivityPolynomial()
    prf = PRF(TabulatedPSF(GAUSSIAN(x, y), 9) * response if kind == "density" else table)
    place = {"x_0": np.array([3.1, 3.3]), "y_0": np.array([2.9, 3.07])}
    _, derivatives = prf.unit_images((7, 7), **place, derivatives=True)
    for name, value in place.items():
        high, low = (
            prf.unit_images((7, 7), **(place | {name: value + step})) for step in (1e-5, -1e-5)
        )
        np.testing.assert_allclose(derivatives[name], (high - low) / 2e-5, atol=1e-8)
    assert set(derivatives) == set(prf.param_names) - {"flux"}


def test_continuous_across_pixel_edges(table):
    """Nothing jumps where the star goes from one pixel to the next, nor does the gradient."""
    prf = PRF(table)
    images, derivatives = prf.unit_images(
        (9, 9), 4.5 + np.array([-1e-9, 1e-9]), 4.0, derivatives=True
    )
    assert np.abs(np.diff(images, axis=0)).max() < 1e-8
    assert np.abs(np.diff(derivatives["x_0"], axis=0)).max() < 1e-7


def test_in_a_simulation(table):
    detector = Detector.kepler(shape=(9, 9), sensitivity=None)
    star, motion = Star(12.0, 4.1, 3.9, psf=PRF(table)), 2 * Motion.k2_roll(30)
    cubes = [
        simulate(one, detector, motion, seed=1, noise=False).flux
        for one in (star, Star(12.0, 4.1, 3.9, psf=GAUSSIAN))
    ]
    np.testing.assert_allclose(cubes[0], cubes[1], atol=2e-6 * cubes[1].max())
    # The response of a detector is in the table already.
    other = simulate(star, Detector.kepler(shape=(9, 9)), motion, seed=1, noise=False).flux
    np.testing.assert_array_equal(other, cubes[0])


def test_photometry_with_photutils(table):
    rng = np.random.default_rng(5)
    position, flux = (20.3, 19.8), 1e5
    image = PRF(GAUSSIAN).render((40, 40), flux=flux, x_0=position[0], y_0=position[1])
    error = np.sqrt(image + 100)
    image = image + error * rng.normal(size=image.shape)
    start = Table({"x": [20.0], "y": [20.0], "flux": [9e4]})
    for model in (table, PRF(table), table.to_photutils()):
        result = PSFPhotometry(model, (7, 7), progress_bar=False)(
            image, error=error, init_params=start
        )
        for name, truth in (("x", position[0]), ("y", position[1]), ("flux", flux)):
            assert abs(result[f"{name}_fit"][0] - truth) < 4 * result[f"{name}_err"][0]


def test_to_and_from_photutils(table):
    moved = TabulatedPRF(table.array, 9, 7.0, 3.2, 2.9)
    y, x = np.mgrid[:7, :7]
    other = moved.to_photutils()
    np.testing.assert_allclose(other(x, y), moved(x, y), atol=7 * 2e-6)
    np.testing.assert_allclose(TabulatedPRF.from_photutils(other)(x, y), moved(x, y), atol=1e-12)
    with pytest.raises(TypeError, match="must be an ImagePSF"):
        TabulatedPRF.from_photutils(GaussianPRF())
    with pytest.raises(ValueError, match="integer `oversampling`"):
        TabulatedPRF(table.array, 9.5).to_photutils()
    with pytest.raises(ValueError, match=r"TabulatedPRF\.from_photutils"):
        PRF(ImagePSF(np.ones((7, 7))))


def test_uncertainty(table):
    star = TabulatedPRF(table.array, 9, 100.0, 3, 3, uncertainty=table.uncertainty)
    np.testing.assert_allclose(star.uncertainty_image((7, 7)), 0.1)
    with pytest.raises(ValueError, match="no uncertainty"):
        TabulatedPRF(table.array, 9).uncertainty_image((7, 7))


def test_as_text_and_copies(table):
    y, x = np.mgrid[:7, :7]
    table = TabulatedPRF(table.array, 9, 3.0, 3.1, 2.9, uncertainty=table.uncertainty)
    for other in (
        make_model(describe_model(table)), copy.deepcopy(table), pickle.loads(pickle.dumps(table))  # noqa: S301
    ):  # fmt: skip
        np.testing.assert_array_equal(other(x, y), table(x, y))
        np.testing.assert_array_equal(other.uncertainty, table.uncertainty)


def test_units(table):
    with_units = TabulatedPRF(table.array, 9, 5 * u.electron / u.s, 3 * u.pix, 2.9 * u.pix)
    plain = TabulatedPRF(table.array, 9, 5, 3, 2.9)
    values = with_units([2, 3] * u.pix, [3, 3] * u.pix)
    assert values.unit == u.electron / u.s
    np.testing.assert_allclose(values.value, plain([2, 3], [3, 3]))
    with pytest.raises(ValueError, match="`array` must be in a number without a unit"):
        TabulatedPRF(np.ones((7, 7)) * u.pix)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"array": np.ones((3, 9))}, "at least 6 samples"),
        ({"array": np.full((7, 7), np.nan)}, "`array` must be finite"),
        ({"array": np.ones((7, 7)), "oversampling": 0}, "`oversampling` must be positive"),
        ({"array": np.ones((7, 7)), "origin": 2}, "`origin` must be"),
        ({"array": np.ones((7, 7)), "uncertainty": np.ones((4, 4))}, "`uncertainty` must"),
        ({"array": np.ones((7, 7)), "flux": np.nan}, "`flux` must be finite"),
    ],
)
def test_bad_tables(arguments, message):
    with pytest.raises(ValueError, match=message):
        TabulatedPRF(**arguments)


@pytest.mark.parametrize("where", ["left", "sum"])
def test_table_times_sensitivity_is_refused(where, table):
    compound = table * SensitivityPolynomial()
    if where == "sum":
        compound = GAUSSIAN + compound
    with pytest.raises(ValueError, match="already integrated over pixels"):
        PRF(compound)
    with pytest.raises(ValueError, match="already integrated"):
        integrate_pixels(compound, (5, 5))


def test_sum_with_a_density(table):
    """A table, and a smooth surface on it."""
    prf = PRF(Const2D(0.9) * table + Const2D(0.1) * BivariateGaussianPSF(sigma_x=1.0))
    image = prf.render((9, 9), x_0=4, y_0=4)
    wide = PRF(BivariateGaussianPSF(sigma_x=1.0)).render((9, 9), x_0=4, y_0=4)
    np.testing.assert_allclose(image, 0.9 * PRF(table).render((9, 9), x_0=4, y_0=4) + 0.1 * wide)


class TestGrid:
    @staticmethod
    def grid(places):
        y, x = np.mgrid[-9:10, -9:10] / 3
        tables = []
        for c, r in places:
            psf = BivariateGaussianPSF(1, sigma_x=0.6 + c / 2000, sigma_y=0.6 + r / 4000)
            tables.append(TabulatedPRF(PRF(psf)(x, y), 3, uncertainty=np.full(x.shape, 0.1)))
        return PRFGrid(places, tables)

    def test_bilinear_as_photutils(self):
        grid = self.grid([(c, r) for r in (10, 110, 210) for c in (5, 105)])
        model = grid.to_photutils()
        y, x = np.mgrid[60:71, 40:51]
        at_place = grid.at(45.2, 65.1).to_photutils()
        at_place.x_0, at_place.y_0 = 45.2, 65.1
        np.testing.assert_allclose(model.evaluate(x, y, 1, 45.2, 65.1), at_place(x, y), atol=1e-12)
        again = PRFGrid.from_photutils(model)
        np.testing.assert_allclose(again.at(45.2, 65.1).array, grid.at(45.2, 65.1).array)

    def test_places_and_edges(self):
        grid = self.grid([(c, r) for r in (10, 110) for c in (5, 105)])
        np.testing.assert_array_equal(grid.at(5, 110).array, grid.tables[2].array)
        np.testing.assert_array_equal(grid.at(-3, 120).array, grid.tables[2].array)
        np.testing.assert_allclose(grid.weights(30 * u.pix, 60).sum(), 1)
        assert grid.at(55, 60).uncertainty.max() == pytest.approx(0.05)
        with pytest.raises(ValueError, match="must be near columns 5 to 105"):
            grid.at(300, 10)
        with pytest.raises(ValueError, match="there are tables of several places"):
            grid.at(column=5)
        alone = self.grid([(5, 10)])
        assert alone.at() is alone.tables[0]

    def test_bad_grids(self):
        with pytest.raises(ValueError, match="two tables have the same place"):
            self.grid([(1, 1), (1, 1)])
        tables = [TabulatedPRF(np.ones((n, 7))) for n in (7, 8)]
        with pytest.raises(ValueError, match="must have one shape"):
            PRFGrid([(1, 1), (2, 2)], tables)
        with pytest.raises(ValueError, match="on a rectangular grid"):
            self.grid([(0, 0), (10, 0), (0, 10), (10, 10), (5, 5)]).to_photutils()


def kepler_gaussians(shared_data):
    """The five PRFs of a Kepler channel as sums of Gaussians."""
    path = shared_data / "kepler_prf" / "kplr07.4_2011265_prf.mog.fits"
    prfs = []
    with fits.open(path) as hdus:
        for hdu in hdus[1:]:
            rows = [[float(value) for value in row] for row in hdu.data]
            prfs.append(rows)
    return prfs


def value_of(rows, x, y):
    total = 0.0
    for amplitude, x_0, y_0, xx, xy, yy in rows:
        determinant = xx * yy - xy**2
        dx, dy = x - x_0, y - y_0
        exponent = (yy * dx**2 - 2 * xy * dx * dy + xx * dy**2) / (2 * determinant)
        total = total + amplitude * np.exp(-exponent) / (2 * np.pi * np.sqrt(determinant))
    return total


def test_official_kepler_format(shared_data, tmp_path):
    """Gaussians whose truth is known, in a file of the official format, come back."""
    rows = kepler_gaussians(shared_data)
    places = [(12, 20), (1111, 20), (1111, 1043), (12, 1043), (561.5, 531.5)]
    offsets = (np.arange(550) - 274.5) * 0.02
    hdus = [fits.PrimaryHDU()]
    for (column, row), gaussians in zip(places, rows, strict=True):
        image = value_of(gaussians, offsets, offsets[:, np.newaxis])
        hdu = fits.ImageHDU(image.astype(np.float32))
        hdu.header.update(CRVAL1P=column, CRVAL2P=row, CDELT1P=0.02, CDELT2P=0.02)
        hdus.append(hdu)
    path = tmp_path / "kplr07.4_2011265_prf.fits"
    fits.HDUList(hdus).writeto(path)
    y, x = np.mgrid[:9, :9]
    for (column, row), gaussians in zip(places, rows, strict=True):
        image = PRF.from_kepler(path, column, row).render((9, 9), x_0=4.137, y_0=3.861)
        np.testing.assert_allclose(image, value_of(gaussians, x - 4.137, y - 3.861), atol=3e-8)
    # Half-way between the center and the middle of two corners.
    prf = PRF.from_kepler(path, 561.5, (20 + 531.5) / 2)
    weights = 0.25, 0.25, 0, 0, 0.5
    expected = sum(w * value_of(g, x - 4, y - 4) for w, g in zip(weights, rows, strict=True))
    np.testing.assert_allclose(prf.render((9, 9), x_0=4, y_0=4), expected, atol=3e-8)
    with pytest.raises(ValueError, match="`column` and `row` must be given"):
        PRF.from_kepler(path)


def test_official_tess_files(shared_data):
    folder = shared_data / "tess_prf"
    path = folder / "tess2019107181901-prf-2-3-row0513-col1069.fits.gz"
    with fits.open(path) as hdus:
        samples = hdus[0].data
    single, grid = PRF.from_tess(path), PRF.from_tess(folder, 2, 3, 1069, 513)
    # The phases of the file: the star moves against their index.
    for phase in (0, 3):
        shift = phase / 9
        image = single.render((13, 13), x_0=6 - shift, y_0=6 + 1 / 9)
        inside = image[1:-1, 1:-1]
        expected = samples[4 - 1 :: 9, 4 + phase :: 9][1:-1, 1:-1]
        np.testing.assert_allclose(
            inside, expected[: inside.shape[0], : inside.shape[1]], atol=1e-12
        )
    np.testing.assert_array_equal(single.table.array, grid.table.array)
    image, error = single.render((13, 13), x_0=6, y_0=6), single.table.uncertainty
    assert image.sum() == pytest.approx(1, abs=1e-5)
    assert error.max() > 0
    with pytest.raises(FileNotFoundError, match="no PRF of camera 1"):
        PRF.from_tess(folder, 1, 3, 100, 100)
    with pytest.raises(ValueError, match="near columns 45 to 2092"):
        PRF.from_tess(folder, 2, 3, 2500, 100)


def test_official_formats_are_checked(tmp_path):
    path = tmp_path / "tess-prf.fits"
    fits.PrimaryHDU(np.ones((7, 7))).writeto(path)
    with pytest.raises(ValueError, match="no card CAM"):
        PRF.from_tess(path)
    with pytest.raises(ValueError, match="no card CDELT1P"):
        PRF.from_kepler(path, 1, 1)
