"""Processor time of integrals over pixels, beside photutils' pixel-integrated Gaussians.

1000 cadences of 9 x 9 pixels: ours multiplied by a sensitivity, photutils' called once on the same
81,000 pixels. The targets: rho = 0 at most 0.12 times CircularGaussianPRF, rho != 0 at most 0.10
times its rotated GaussianPRF (photutils >= 3.1). Then the largest error against a dense rule.

Run as ``OMP_NUM_THREADS=1 python benchmarks/pixel_integration.py``.
"""

import numpy as np
from _common import report_environment, seconds
from photutils.psf import CircularGaussianPRF, GaussianPRF, MoffatPSF

from scope_models import BivariateGaussianPSF, SensitivityPolynomial, integrate_pixels

N_CADENCES, SIZE = 1000, 9
SIGMA = 0.5
FWHM = 2 * np.sqrt(2 * np.log(2))
# Blocks in turn, and calls in each, of which the shortest counts.
PAIRS, CALLS = 9, 5


def paired_seconds(ours, theirs):
    """Return the medians of both times and of their ratio, from blocks of calls in turn."""
    times = np.array(
        [[seconds(function, repeats=CALLS) for function in (ours, theirs)] for _ in range(PAIRS)]
    )
    return *np.median(times, axis=0), np.median(times[:, 0] / times[:, 1])


def rotated(rho):
    """Return sigma_x, sigma_y of a Gaussian with this correlation, and photutils' parameters."""
    sigma_x, sigma_y = SIGMA, 0.9 * SIGMA
    covariance = rho * sigma_x * sigma_y
    values, vectors = np.linalg.eigh([[sigma_x**2, covariance], [covariance, sigma_y**2]])
    angle = np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1]))
    return sigma_x, sigma_y, FWHM * np.sqrt(values[1]), FWHM * np.sqrt(values[0]), angle


def error_of(model, cube, x, y):
    """Return the largest difference of a few images of a cube from single ones by quadrature."""
    largest = 0.0
    for i in range(0, N_CADENCES, 250):
        single = model.copy()
        single.x_0, single.y_0 = x[i], y[i]
        image = integrate_pixels(
            single * SensitivityPolynomial(), (SIZE, SIZE), method="quadrature"
        )
        largest = max(largest, np.max(np.abs(cube[i] - image)))
    return largest


def main():
    """Print the environment, the times, their ratios and the errors."""
    report_environment("photutils")
    rng = np.random.default_rng(1)
    x, y = SIZE // 2 + rng.uniform(-0.5, 0.5, (2, N_CADENCES))
    rows, columns = np.mgrid[:SIZE, :SIZE].astype(float)
    pixel_x, pixel_y = (np.tile(p.ravel(), N_CADENCES) for p in (columns, rows))
    star_x, star_y = np.repeat(x, SIZE**2), np.repeat(y, SIZE**2)
    print(f"{'case':34s} {'ours':>9s} {'photutils':>10s} {'ratio':>7s} {'error':>9s}")
    for rho in (0.0, 0.2, 0.4, 0.6):
        sigma_x, sigma_y, *axes = rotated(rho) if rho else (SIGMA, SIGMA)
        model = BivariateGaussianPSF(1.0, x, y, sigma_x, sigma_y, rho) * SensitivityPolynomial()
        if rho:
            name, theirs = "GaussianPRF", GaussianPRF()
            shape = axes
        else:
            name, theirs = "CircularGaussianPRF", CircularGaussianPRF()
            shape = [FWHM * SIGMA]
        ours_time, theirs_time, ratio = paired_seconds(
            lambda model=model: integrate_pixels(model, (SIZE, SIZE)),
            lambda t=theirs, s=shape: t.evaluate(pixel_x, pixel_y, 1.0, star_x, star_y, *s),
        )
        one = BivariateGaussianPSF(1.0, 0, 0, sigma_x, sigma_y, rho)
        error = error_of(one, integrate_pixels(model, (SIZE, SIZE)), x, y)
        print(
            f"{f'rho = {rho}, against {name}':34s} {ours_time * 1e3:6.2f} ms "
            f"{theirs_time * 1e3:7.2f} ms {ratio:7.3f} {error:9.1e}"
        )
    moffat = MoffatPSF(flux=1.0, x_0=x, y_0=y, alpha=0.8, beta=2.5) * SensitivityPolynomial()
    elapsed = seconds(lambda: integrate_pixels(moffat, (SIZE, SIZE)), repeats=1)
    print(f"\nphotutils' MoffatPSF with sensitivity, by quadrature: {elapsed:.2f} s")


if __name__ == "__main__":
    main()
