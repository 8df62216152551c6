"""The drop of the response within a pixel, from the flux of real stars against their place.

A response that depends on the place within the pixel scales all pixels of a star alike, and a fit
takes it for flux: a constant star is fainter between pixels. The amplitude is fitted beside what
looks similar: differences between the pixels (a prior of 1 %), light beyond the stamp, and slow
variability. Stars of one CCD have one drop, and nothing else in common: the weighted mean of the
seven stars of channel 4 in quarter 12, and of as many simulated stars of K2, of which it is known.

Run as ``OMP_NUM_THREADS=1 python studies/drop.py FOLDER [FIGURE.png]`` with the archive files.
"""

import sys
import warnings
from pathlib import Path

import numpy as np
from _rows import FILES
from astropy.stats import mad_std
from astropy.utils.exceptions import AstropyUserWarning
from matplotlib import pyplot as plt
from scipy.interpolate import BSpline

from scope_models import Detector, Motion, Star, fit_tpf, simulate

# Peak-to-peak ppm of all light of a Gaussian of 0.45 px that crosses a pixel along one axis.
ANCHORS = {
    "Saunders et al. (2019), drop 1.25 %": 187,
    "ETEM2, 500 nm, 2.3 %": 357,
    "ETEM2, 800 nm, 4 to 5 %": 762,
    "k2_calibrated, 12.5 %": 1942,
    "laboratory, 50 %": 8933,
}
SIGMA = 0.45
FLAT, LOSS, KNOTS, PARTS = 0.01, 0.5, 1.5, 8
SIGMAS = (0.35, 0.45, 0.5, 0.6)


def predicted(anchor, sigma):
    """Amplitude of an anchor for another width: that of the first harmonic of the pixels."""
    return anchor * np.exp(-2 * np.pi**2 * (sigma**2 - SIGMA**2))


def wave_of(x, y):
    """Half of the sum of the first harmonics of the pixels along both axes."""
    return 0.5 * (np.cos(2 * np.pi * x) + np.cos(2 * np.pi * y))


def amplitude(fit, keep):
    """Peak-to-peak amplitude along one axis, its error for white noise, and the residuals."""
    # The fitted background absorbs errors of the PSF's wings: the pipeline's is the better one.
    light = np.nansum(fit.observed, axis=(1, 2))
    shares = np.nan_to_num(fit.fitted - fit.background[:, None, None]).reshape(len(light), -1)
    held = fit.model.unit_images(fit.shape, fit.x, fit.y).sum(axis=(1, 2))[:, None]
    lost, shares = 1 - held, shares * held / shares.sum(axis=1, keepdims=True)
    columns = wave_of(fit.x, fit.y)[:, None], shares * FLAT, lost * LOSS
    columns = [each[keep] - each[keep].mean(axis=0) for each in columns]
    flux, time = (light / np.median(light))[keep], fit.time[keep]
    inner = np.linspace(time[0], time[-1], max(2, int(np.ptp(time) / KNOTS) + 1))
    knots = np.concatenate([[inner[0]] * 3, inner, [inner[-1]] * 3])
    slow = BSpline.design_matrix(time, knots, 3).toarray()
    columns = np.column_stack([*columns, slow])
    prior = np.concatenate([[0.0], np.ones(shares.shape[1] + 1), np.zeros(slow.shape[1])])
    noise, good = 1e-3, np.ones(len(flux), dtype=bool)
    for _ in range(8):
        design, right = columns[good] / noise, flux[good] / noise
        normal = design.T @ design + np.diag(prior) + 1e-9 * np.eye(len(prior))
        solution = np.linalg.solve(normal, design.T @ right)
        residual = flux - columns @ solution
        noise = mad_std(residual)
        good = np.abs(residual) < 4 * noise
    error = np.sqrt(np.linalg.inv(normal)[0, 0])
    return solution[0], error, residual + solution[0] * columns[:, 0], good


def measured(star, tpf):
    """Print the amplitude of a star; return it, its error and the width, and place and flux."""
    fit = fit_tpf(tpf, response="pixels")  # a response within pixels would hold the drop itself
    values = fit_tpf(tpf, 1, interpixel=0, positions="path").values
    sigma = np.sqrt(values["sigma_x"] * values["sigma_y"])
    value, error, clean, good = amplitude(fit, np.ones(len(fit.time), dtype=bool))
    part = np.arange(len(fit.time)) * PARTS // len(fit.time)
    others = [amplitude(fit, part != i)[0] for i in range(PARTS)]
    spread = np.sqrt((PARTS - 1) / PARTS * np.sum((others - np.mean(others)) ** 2))
    moved = np.ptp(fit.x[good]), np.ptp(fit.y[good])
    errors = f"+- {1e6 * error:.0f} (model) +- {1e6 * spread:.0f} (parts)"
    print(
        f"{star}: one Gaussian of {sigma:.2f} px, motion {moved[0]:.2f} and {moved[1]:.2f} px; "
        f"amplitude {1e6 * value:.0f} {errors} ppm"
    )
    return (value, np.hypot(error, spread), sigma), fit.x[good], clean[good], moved


def together(name, numbers):
    """Print the common amplitude of stars, given value, error and width of each, and its limit."""
    values, errors = np.array(numbers)[:, :2].T
    mean, error = np.average(values, weights=errors**-2), np.sum(errors**-2) ** -0.5
    scatter = np.sum(((values - mean) / errors) ** 2)
    limit = max(mean, 0) + 1.645 * error
    print(
        f"{name}: {1e6 * mean:.0f} +- {1e6 * error:.0f} ppm, chi-squared {scatter:.1f} of "
        f"{len(values) - 1}; below {1e6 * limit:.0f} ppm with 95 %"
    )
    for assumed in SIGMAS:
        drop = 0.0125 * 1e6 * limit / predicted(187, assumed)
        print(f"  drop for {assumed:.2f} px: below {drop:.2f}")


def simulated(number, motion):
    """Return the file of a star of one CCD of K2, and the amplitude of its flux."""
    rng, detector = np.random.default_rng([30, number]), Detector.k2_calibrated(shape=(11, 11))
    star = Star(12 + 3 * rng.uniform(), *(5 + rng.uniform(-0.5, 0.5, 2)))
    alike = detector.replace(interpixel=np.ones(detector.shape))
    light = simulate(star, alike, motion, noise=False).flux.sum(axis=(1, 2))
    wave = wave_of(star.x_0 + motion.x, star.y_0 + motion.y)
    slope = np.polyfit(wave, light / np.median(light), 1)[0]
    return simulate(star, detector, motion, seed=number).to_tpf(), slope


def one_ccd(folder, axes, n_stars=7):
    """Print and draw what stars of one CCD give together, real ones and simulated ones."""
    motion = Motion.k2_roll(1000, seed=1)
    motion = motion[motion.quality == 0]
    files = [(path.name, path) for path in sorted(Path(folder, "kepler_q12_ch4").glob("*.fits.gz"))]
    made, truths = zip(*(simulated(number, motion) for number in range(n_stars)), strict=True)
    for name, tpfs in {"real": files, "simulated": list(enumerate(made))}.items():
        found = [measured(f"{name} {star}", tpf) for star, tpf in tpfs]
        numbers, text = [one[0] for one in found], f"{len(found)} {name} stars of one CCD"
        together(text, numbers)
        moved, marker = [np.hypot(*one[3]) for one in found], "s^"[name == "real"]
        axes.loglog(moved, [1e6 * error for _, error, _ in numbers], marker, label=text)
    print(f"truth of the simulated stars: {1e6 * np.mean(truths):.0f} ppm")
    axes.axhline(1e6 * np.mean(truths), color="0.4", label="true amplitude, simulated")
    axes.set(xlabel="Motion (pixel)", ylabel="Error (ppm)", title="Amplitudes of stars of one CCD")


def report(folder):
    """Print what the stars give, and draw them beside the anchors; return the figure."""
    figure, (left, right, _) = plt.subplots(1, 3, figsize=(15, 4.5), layout="constrained")
    width = np.linspace(0.35, 0.62, 50)
    styles = ("-", "--", "-.", ":", (0, (1, 3)))
    for (name, value), style in zip(ANCHORS.items(), styles, strict=True):
        left.semilogy(width, predicted(value, width), ls=style, color="0.4", label=name)
    numbers = []
    for (star, file), marker in zip(FILES.items(), "osv", strict=False):
        found, x, clean, _ = measured(star, Path(folder) / file)
        if not star.startswith("EPIC"):
            continue
        numbers.append(found)
        limit = 1e6 * (max(found[0], 0) + 1.645 * found[1])
        options = {"fmt": f"k{marker}", "label": f"{star}, 95 % limit"}
        left.errorbar(found[2], limit, 0.5 * limit, uplims=True, **options)
        place = x - np.rint(x)
        index = np.digitize(place, np.linspace(-0.5, 0.5, 21))
        bins = [index == i for i in range(1, 21) if np.sum(index == i) > 20]
        at = [place[one].mean() for one in bins]
        mean = np.array([np.mean(1e6 * clean[one]) for one in bins])
        error = [np.std(1e6 * clean[one]) / np.sqrt(np.sum(one)) for one in bins]
        right.errorbar(at, mean - mean.mean(), error, fmt=f"k{marker}", ms=4, label=star)
    together("Both K2 stars", numbers)
    u = np.linspace(-0.5, 0.5, 101)
    for (name, value), style in zip(list(ANCHORS.items())[3:], styles[3:], strict=True):
        curve = 0.5 * predicted(value, 0.5) * np.cos(2 * np.pi * u)
        right.plot(u, curve, color="0.4", ls=style, label=f"{name}, PSF of 0.5 px")
    left.set(xlabel="Standard deviation of the PSF (pixel)", ylabel="Peak to peak (ppm)")
    right.set(xlabel="Column of the star within the pixel", ylabel="Relative flux (ppm)")
    left.set_title("Loss of light between pixels: published responses, limits")
    right.set_title("Flux against the position within the pixel")
    return figure


def main():
    """Run the study."""
    warnings.simplefilter("ignore", AstropyUserWarning)
    figure = report(sys.argv[1])
    one_ccd(sys.argv[1], figure.axes[2])
    for axes in figure.axes:
        axes.legend(fontsize="small", loc="upper center", bbox_to_anchor=(0.5, -0.15), ncols=2)
    figure.savefig(sys.argv[2] if len(sys.argv) > 2 else "drop.png", dpi=110)


if __name__ == "__main__":
    main()
