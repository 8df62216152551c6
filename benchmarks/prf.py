"""Fluxes of pixels of a star by this package and by others: first they agree, then the clock.

1000 positions of 9 x 9 pixels without noise and without a sensitivity. The error is the largest
difference from a rule of 40 x 40 nodes in each pixel, as part of the flux, at 20 of the positions;
the script ends if ours exceeds 1e-7. Times are processor times of single calls in turn, in caches
that hold the other's arrays; about half of "simulate" is then the setup of a scene. The ratio of
ten calls in a row is the one that simulate.py prints beside its goal. Memory is the largest that
Python held in a call. In each pair of columns ours comes first. GaussianPRF is
integrated over pixels since photutils 3.1.

lkprf, pandorapsf and GalSim are compared if they are installed: lkprf with a file of Kepler's
format that holds the PRF of a Gaussian, and a scene of pandorapsf with samples of a Gaussian, 40 in
a pixel. "simulate" is the whole simulation of a star that moves, with times, errors and quality;
GalSim draws one image after the other. The last lines are the error of a first-order shift of an
image (image plus offset times its derivative), by which scenes of pandorapsf follow motions within
half a pixel.

Run as ``OMP_NUM_THREADS=1 python benchmarks/prf.py``.
"""

import tempfile
from importlib.util import find_spec
from pathlib import Path

import astropy.units as u
import numpy as np
from _common import peak_memory, report_environment, seconds
from astropy.io import fits
from photutils.psf import CircularGaussianPRF, GaussianPRF, ImagePSF

from scope_models import (
    PRF,
    BivariateGaussianPSF,
    Detector,
    Motion,
    Star,
    integrate_pixels,
    simulate,
)
from scope_models.models import TabulatedPRF

N, SIZE, SIGMA, CHECKED = 1000, 9, 0.5, slice(None, None, 50)
FWHM = 2 * np.sqrt(2 * np.log(2))
AGREE = 1e-7  # error of tables, and of pixels with 32 bits


def exact(psf, x, y):
    """Return images of a density by a dense Gauss-Legendre rule."""
    nodes, weights = (part / 2 for part in np.polynomial.legendre.leggauss(40))
    at = (np.arange(SIZE)[:, None] + nodes).ravel()
    images = []
    for x_0, y_0 in zip(x, y, strict=True):
        density = psf(at - x_0, (at - y_0)[:, None]).reshape(SIZE, 40, SIZE, 40)
        images.append(np.einsum("jlik,l,k->ji", density, weights, weights))
    return np.array(images)


def simulation(x, y, psf):
    """Return a call that simulates a star of flux 1, in units of 1e6 e-/s, at these positions."""
    detector = Detector.kepler(
        shape=(SIZE, SIZE), psf=psf, zero_point=1e6, zero_point_mag=12.0, background=0.0,
        well_depth=None, effects=(),
    ).without_sensitivity()  # fmt: skip
    motion = Motion.from_arrays(120 + np.arange(N) / 48, x - SIZE // 2, y - SIZE // 2)
    return lambda: simulate(Star(12.0), detector, motion, noise=False).flux / 1e6


def cases(x, y):
    """Yield name of the rival, the density, our call and its call, for all positions."""
    rows, columns = np.mgrid[:SIZE, :SIZE].astype(float)
    arguments = np.tile(columns, (N, 1, 1)), np.tile(rows, (N, 1, 1)), 1.0
    places = x[:, None, None], y[:, None, None]
    for rho in (0.0, 0.4):
        psf = BivariateGaussianPSF(1, 0, 0, SIGMA, SIGMA, rho)
        ours = BivariateGaussianPSF(1, x, y, SIGMA, SIGMA, rho)
        if rho:
            long, short = (FWHM * SIGMA * np.sqrt(1 + s * rho) for s in (1, -1))
            model, shape = GaussianPRF(), (long, short, 45.0)
        else:
            model, shape = CircularGaussianPRF(), (FWHM * SIGMA,)
        yield (
            f"{type(model).__name__}, rho = {rho}", psf,
            lambda m=ours: integrate_pixels(m, (SIZE, SIZE)),
            lambda m=model, s=shape: m.evaluate(*arguments, *places, *s),
        )  # fmt: skip
        if not rho:
            yield (
                "simulate, CircularGaussianPRF", psf, simulation(x, y, psf),
                lambda m=model, s=shape: m.evaluate(*arguments, *places, *s),
            )  # fmt: skip
    half = 5 * SIZE
    y_at, x_at = np.mgrid[-half : half + 1, -half : half + 1] / SIZE
    psf = BivariateGaussianPSF(1, 0, 0, SIGMA, SIGMA)
    samples = PRF(psf)(x_at, y_at)
    table, image = TabulatedPRF(samples, SIZE), ImagePSF(samples, oversampling=SIZE)
    yield (
        "ImagePSF, 9 samples per pixel", psf, lambda: table.evaluate(*arguments, *places),
        lambda: image.evaluate(*arguments, *places),
    )  # fmt: skip


def lkprf_case(x, y, folder):
    """Return the case of lkprf: the table of a PRF in a file of Kepler's format."""
    from lkprf import KeplerPRF

    offsets = (np.arange(550) - 274.5) * 0.02
    psf = BivariateGaussianPSF(1, 0, 0, SIGMA, SIGMA)
    hdus = [fits.PrimaryHDU()]
    hdus[0].header["DATE"] = "2011-09-22"
    table = PRF(psf)(offsets, offsets[:, None])
    for column, row in ((12, 20), (1111, 20), (1111, 1043), (12, 1043), (561.5, 531.5)):
        hdus.append(fits.ImageHDU(table))
        hdus[-1].header.update(CRVAL1P=column, CRVAL2P=row, CDELT1P=0.02, CDELT2P=0.02)
    path = Path(folder) / "kplr07.4_2011265_prf.fits"
    fits.HDUList(hdus).writeto(path)
    theirs, ours = KeplerPRF(20, f"{folder}/"), PRF.from_kepler(path, 561, 531).table
    rows, columns = np.mgrid[:SIZE, :SIZE].astype(float)
    pixels = np.tile(columns, (N, 1, 1)), np.tile(rows, (N, 1, 1)), 1.0
    targets = [(531 + b, 561 + a) for a, b in zip(x.tolist(), y.tolist(), strict=True)]
    return (
        "lkprf, Kepler's format", psf,
        lambda: ours.evaluate(*pixels, x[:, None, None], y[:, None, None]),
        lambda: theirs.evaluate(targets, (531, 561), (SIZE, SIZE)),
    )  # fmt: skip


def pandora_case(x, y, _):
    """Return the case of a scene of pandorapsf."""
    import pandorapsf

    at = (np.arange(40 * (SIZE + 2)) - 20 * (SIZE + 2) + 0.5) / 40
    psf = BivariateGaussianPSF(1, 0, 0, SIGMA, SIGMA)
    samples = np.repeat(psf(at, at[:, None])[..., None], 2, axis=2)
    model = pandorapsf.PSF(
        "gaussian", [[1.0, 2.0] * u.um], samples, ["wavelength"], [u.um],
        1 * u.um / u.pix, 0.025 * u.um / u.pix, check_bounds=False,
    )  # fmt: skip
    middle = SIZE // 2
    scene = pandorapsf.Scene(np.full((1, 2), SIZE / 2), model, (SIZE, SIZE))  # from the corner
    moved = np.array([y - middle, x - middle])
    ours = BivariateGaussianPSF(1, x, y, SIGMA, SIGMA)
    return (
        "Scene of pandorapsf", psf, lambda: integrate_pixels(ours, (SIZE, SIZE)),
        lambda: scene.model(np.ones((1, N)), moved, quiet=True),
    )  # fmt: skip


def galsim_case(x, y, _):
    """Return the case of images that GalSim draws."""
    import galsim

    star, psf = galsim.Gaussian(sigma=SIGMA), BivariateGaussianPSF(1, 0, 0, SIGMA, SIGMA)
    offsets = np.column_stack([x, y]) - SIZE // 2

    def draw():
        images = [galsim.ImageD(SIZE, SIZE, scale=1.0) for _ in offsets]
        for image, offset in zip(images, offsets, strict=True):
            star.drawImage(image, offset=offset)
        return np.array([image.array for image in images])

    return "simulate, GalSim", psf, simulation(x, y, psf), draw


def installed_cases(x, y, folder):
    """Yield the cases of packages that are not dependencies, where they are installed."""
    for make in (lkprf_case, pandora_case, galsim_case):
        try:
            yield make(x, y, folder)
        except ImportError as error:
            print(f"{make.__name__.removesuffix('_case')}: {error}")


def report(name, psf, ours, theirs, x, y):
    """Print errors, times and memory of a case."""
    truth = exact(psf, x[CHECKED], y[CHECKED])
    errors = [np.abs(call()[CHECKED] - truth).max() for call in (ours, theirs)]
    if errors[0] > AGREE:
        raise SystemExit(f"{name}: our error is {errors[0]:.0e}, more than {AGREE:.0e} of the flux")
    times = seconds(ours, theirs)
    memory = [peak_memory(call) for call in (ours, theirs)]
    (error, time, peak), (error_2, time_2, peak_2) = zip(errors, times, memory, strict=True)
    print(
        f"{name:30} {error:8.0e} {error_2:8.0e} {1e3 * time:7.2f} {1e3 * time_2:7.2f} "
        f"{time / time_2:6.3f} {peak:6.2f} {peak_2:6.2f}"
    )


def main():
    """Print the environment, and errors, times and memory of both sides."""
    rivals = [name for name in ("lkprf", "pandorapsf", "galsim") if find_spec(name)]
    report_environment("photutils", *rivals)
    x, y = SIZE // 2 + np.random.default_rng(1).uniform(-0.5, 0.5, (2, N))
    print(f"{'':30} {'error':>17} {'time (ms)':>15} {'ratio':>6} {'memory (MB)':>13}")
    with tempfile.TemporaryDirectory() as folder:
        for case in (*cases(x, y), *installed_cases(x, y, folder)):
            report(*case, x, y)
    prf = PRF(Detector.k2_calibrated().psf)
    print("\nfirst-order shift of the PRF of Detector.k2_calibrated, without its response")
    middle, step = SIZE // 2, 1e-4
    for offset in (0.05, 0.1, 0.25, 0.5):
        here, low, high, there = (
            prf.render((SIZE, SIZE), flux=1, x_0=middle + d, y_0=middle)
            for d in (0, -step, step, offset)
        )
        shifted = here + offset * (high - low) / (2 * step)
        print(f"{offset:5.2f} px: {np.abs(shifted - there).max():.1e} of the flux in a pixel")


if __name__ == "__main__":
    main()
