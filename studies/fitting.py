"""Fits of target pixel files: truth recovered, real pixels described, twins.

The targets: pulls of all parameters with a standard deviation of 0.9 to 1.1 over many stars; the
sensitivity at the Cramer-Rao bound; the response of the pixels that a star crosses with five times
the motion of K2 to 0.1 %; on real pixels a chi-squared per pixel below that of photutils'
GaussianPRF for each cadence.

Run as ``python studies/fitting.py``, with one of ``pulls``, ``real FOLDER`` and ``twin FOLDER``,
where FOLDER has the archive files; ``docs/data/store_fits.py`` stores `scene_pulls`.
"""

import sys
import time
import warnings
from itertools import combinations
from pathlib import Path

import lightkurve as lk
import numpy as np
from _rows import FILES
from astropy.modeling.fitting import TRFLSQFitter
from astropy.modeling.models import Const2D
from astropy.utils.exceptions import AstropyUserWarning

from scope_models import (
    BivariateGaussianPSF,
    Detector,
    Motion,
    SensitivityPolynomial,
    Star,
    fit_tpf,
    simulate,
)
from scope_models.correctors import PLDCorrector
from scope_models.fitting import FitOptions
from scope_models.photometry import cdpp

N_STARS = 250
N_CADENCES = 1000
SCENE_CADENCES = 60
N_PHOTUTILS = 100
MODELS = {
    "1 component": {"psf": 1},
    "2 components": {"psf": 2},
    "3 components": {"psf": 3},
    "1, empirical 6": {"psf": 1, "empirical": 6},
    "1, empirical 8": {"psf": 1, "empirical": 8},
    "2 components, b": {"psf": 2, "interpixel": 0.01},
    "1, empirical 6, b": {"psf": 1, "empirical": 6, "interpixel": 0.01},
    "1, empirical 8, b": {"psf": 1, "empirical": 8, "interpixel": 0.01},
}


def curvature():
    return SensitivityPolynomial(fixed={"ax1": True, "ay1": True})


def truth_of(observation, fit):
    """Return which cadences were fitted, and the response that belongs to the fluxes."""
    used = np.isin(observation.cadenceno, fit.cadenceno)
    weights = np.maximum(np.median(fit.observed, axis=0), 0)
    return used, np.sum(weights * observation.truth.interpixel) / weights.sum()


def one_star(seed, motion):
    """Return the pulls of one simulated star, and some of its errors."""
    generator = np.random.default_rng(seed)
    side = (7, 9, 11)[seed % 3]
    x, y = (side - 1) / 2 + generator.uniform(-0.5, 0.5, 2)
    sigma_x, sigma_y = generator.uniform(0.45, 0.55, 2)
    rho = generator.uniform(-0.4, 0.4)
    psf = BivariateGaussianPSF(sigma_x=sigma_x, sigma_y=sigma_y, rho=rho)
    # Wells without end: stars above Kp 11.5 saturate.
    detector = Detector.k2(shape=(side, side), interpixel_distribution="normal", well_depth=None)
    star = Star(generator.uniform(10, 13), x, y, psf=psf)
    observation = simulate(star, detector, motion, seed=seed)
    tpf = observation.to_tpf(quality_bitmask="none")
    fit = fit_tpf(tpf, 1, curvature(), options=FitOptions(saturation=False))
    used, response = truth_of(observation, fit)
    truth = {"sigma_x": sigma_x, "sigma_y": sigma_y, "rho": rho, "ax2": -0.05, "ay2": -0.05}
    pulls = {name: (fit.values[name] - value) / fit.errors[name] for name, value in truth.items()}
    t = seed % len(fit.time)
    pulls["x"] = (fit.x[t] - observation.truth.x[0, used][t]) / fit.x_err[t]
    pulls["y"] = (fit.y[t] - observation.truth.y[0, used][t]) / fit.y_err[t]
    pulls["flux"] = (fit.flux[t] - observation.truth.flux[0] * response) / fit.flux_err[t]
    error = fit.interpixel - observation.truth.interpixel / response
    crossed = np.zeros(fit.shape, dtype=bool)
    rows, columns = (np.clip(np.rint(p), 0, side - 1).astype(int) for p in (fit.y, fit.x))
    crossed[rows, columns] = True
    others = [error[crossed], fit.errors["ax2"], fit.errors["ay2"], fit.reduced_chi2]
    return pulls, others, fit.converged


def report_pulls(n_stars=N_STARS, n_cadences=N_CADENCES):
    motion = Motion.k2_roll(n_cadences, seed=1)
    for scale in (1, 5):
        begin = time.perf_counter()
        results = [one_star(s, scale * motion) for s in range(n_stars)]
        rows, others, converged = zip(*results, strict=True)
        print(
            f"{scale} x the motion of K2, {n_stars} stars of Kp 10 to 13, {n_cadences} cadences, "
            f"{time.perf_counter() - begin:.0f} s, {sum(converged)} converged"
        )
        for name in rows[0]:
            values = np.array([row[name] for row in rows])
            print(f"  {name:8s} mean {values.mean():6.2f}  standard deviation {values.std():5.2f}")
        errors = np.concatenate([row[0] for row in others])
        print(f"  b in {errors.size} crossed pixels: rms error {100 * errors.std():.3f} %")
        for i, name in ((1, "ax2"), (2, "ay2")):
            bound = [row[i] for row in others]
            print(
                f"  Cramer-Rao bound of {name}: median {np.median(bound):.4f}, "
                f"{min(bound):.4f} to {max(bound):.4f}"
            )
        print(f"  chi-squared per degree of freedom {np.mean([row[3] for row in others]):.4f}\n")


def make_scene(n_stars, seed):
    """Return an observation of stars at least 2.5 px apart, and their places."""
    generator = np.random.default_rng([n_stars, seed])
    side = {1: 7, 2: 9, 5: 13}[n_stars]
    apart = 0.0
    while apart < 2.5:
        places = generator.uniform(2.5, side - 3.5, (n_stars, 2))
        pairs = combinations(places, 2)
        apart = min((np.hypot(*(one - other)) for one, other in pairs), default=np.inf)
    psf = BivariateGaussianPSF(
        1, 0, 0, *generator.uniform(0.45, 0.6, 2), generator.uniform(-0.4, 0.4)
    )
    mags = np.sort(generator.uniform(11.5, 13.5, n_stars))
    stars = [Star(mag, *place, psf=psf) for mag, place in zip(mags, places, strict=True)]
    detector = Detector.k2(shape=(side, side), interpixel_scatter=0, well_depth=None)
    return simulate(stars, detector, 2 * Motion.k2_roll(SCENE_CADENCES, seed=seed), seed=seed)


def scene_pulls(n_stars, seed):
    """Return the pulls of a scene by group: of what all share, of stars, and of cadences."""
    observation = make_scene(n_stars, seed)
    truth, psf = observation.truth, observation.stars[0].psf
    places = [(star.x_0, star.y_0) for star in observation.stars]
    fit = fit_tpf(
        observation.to_tpf(quality_bitmask="none"), 1, curvature(), stars=np.round(places, 1),
        interpixel=0, options=FitOptions(neighbor_flux="cadence"),
    )  # fmt: skip
    used = np.isin(observation.cadenceno, fit.cadenceno)
    values = {name: float(getattr(psf, name).value) for name in ("sigma_x", "sigma_y", "rho")}
    values |= {"ax2": -0.05, "ay2": -0.05}
    place = np.array(places) - places[0]
    offsets = {f"{a}_star_{k}": place[k][i] for k in range(1, n_stars) for i, a in enumerate("xy")}

    def shared(expected):
        return {k: (fit.values[k] - v) / fit.errors[k] for k, v in expected.items()}

    some = np.linspace(0, len(fit.time) - 1, 5).astype(int)
    cadences = {}
    for k, star in enumerate((fit, *fit.neighbors)):
        flux = truth.flux[k] * truth.relative_flux[k][used]
        for name, expected in (("x", truth.x[k, used]), ("y", truth.y[k, used]), ("flux", flux)):
            error = getattr(star, f"{name}_err")
            cadences[f"{name}_{k}"] = ((getattr(star, name) - expected) / error)[some].tolist()
    return {
        "n_stars": n_stars, "seed": seed, "converged": fit.converged, "chi2": fit.reduced_chi2,
        "shared": shared(values), "star": shared(offsets), "cadence": cadences,
    }  # fmt: skip


def photutils_chi2(tpf):
    """Return the chi-squared of each pixel per degree of freedom: one GaussianPRF per cadence."""
    from photutils.psf import GaussianPRF

    some = np.linspace(0, len(tpf.flux) - 1, N_PHOTUTILS).astype(int)
    flux = tpf.flux.value[some].astype(float)
    error = tpf.flux_err.value[some].astype(float)
    y, x = np.mgrid[: flux.shape[1], : flux.shape[2]].astype(float)
    squares = []
    for data, sigma in zip(flux, error, strict=True):
        good = np.isfinite(data)
        if good.sum() <= 7:
            continue
        light = np.where(good & (data > 0.05 * np.nanmax(data)), data, 0)
        center = (light * x).sum() / light.sum(), (light * y).sum() / light.sum()
        best = None
        for width in (0.8, 1.2, 1.8):
            for theta in (0.0, 45.0):
                model = GaussianPRF(
                    flux=light.sum(), x_0=center[0], y_0=center[1], theta=theta,
                    x_fwhm=width, y_fwhm=width,
                )  # fmt: skip
                for name in ("x_fwhm", "y_fwhm", "theta"):
                    getattr(model, name).fixed = False
                model.x_fwhm.bounds = model.y_fwhm.bounds = (0.2, 6)
                fitted = TRFLSQFitter()(
                    model + Const2D(0.0), x[good], y[good], data[good], weights=1 / sigma[good]
                )
                square = ((data - fitted(x, y)) / sigma) ** 2
                if best is None or np.nansum(square) < np.nansum(best):
                    best = square
        squares.append(best)
    squares = np.array(squares)
    n = np.isfinite(squares).any(axis=0).sum()
    return some, np.nanmean(squares, axis=0) * n / (n - 7)


def report_real(folder):
    for star in FILES:
        tpf = lk.read(Path(folder) / FILES[star])
        some, chi2 = photutils_chi2(tpf)
        print(f"{star}: {tpf.flux.shape}")
        print(f"  photutils, {len(some)} cadences: median chi-squared {np.median(chi2):.4g}")
        for model, options in MODELS.items():
            begin = time.process_time()
            fit = fit_tpf(
                tpf, **({"interpixel": 0, "options": FitOptions(loss="soft_l1")} | options)
            )
            same = np.isin(fit.cadenceno, np.asarray(tpf.cadenceno)[some])
            part = ((fit.residual / fit.observed_err)[same] ** 2).mean(axis=0)
            part *= fit.n_data / fit.dof
            column, row = fit.path_r2()
            print(
                f"  {model:18s} median chi-squared per pixel {np.median(fit.chi2_pixels):8.4g} "
                f"(same cadences {np.median(part):8.4g}), all {fit.reduced_chi2:8.4g}, typical "
                f"cadence {np.median(fit.chi2_cadences):8.4g}; R2 {column:.4f} {row:.4f}; "
                f"rms b {100 * fit.interpixel.std():.2f} %; {time.process_time() - begin:.1f} s, "
                f"{fit.n_steps} steps{'' if fit.converged else ', not converged'}",
                flush=True,
            )
        tpf.hdu.close()
        print()


def light_curves(tpf, aperture):
    """Return the summed and de-trended light curves."""
    corrected = PLDCorrector(tpf, aperture_mask=aperture).correct()
    raw = tpf.to_lightcurve(aperture_mask=aperture)
    return [curve.remove_nans().normalize() for curve in (raw, corrected)]


def report_twin(folder):
    """Stars and their twins in the same aperture and cadences."""
    print("Twins: 6.5-h CDPP (ppm), lightkurve's and EVEREST's convention")
    for star, name in FILES.items():
        fit = fit_tpf(Path(folder) / name, response="pixels")
        tpf = lk.read(Path(folder) / name)
        used = fit.cadenceno[~fit.outliers]
        twin = simulate(fit.scene().replace(seed=1)).to_tpf(quality_bitmask="none")
        tpf, twin = (pixels[np.isin(pixels.cadenceno, used)] for pixels in (tpf, twin))
        own = PLDCorrector(tpf).aperture_mask
        for label, aperture in (("pipeline", tpf.pipeline_mask), ("PLD", own)):
            for kind, pixels in (("real", tpf), ("twin", twin)):
                pair = light_curves(pixels, aperture)
                row = [cdpp(curve, method=m) for curve in pair for m in ("lightkurve", "everest")]
                print(
                    f"  {star} {label} aperture, {kind}: summed {row[0]:.0f} {row[1]:.0f}, "
                    f"de-trended {row[2]:.0f} {row[3]:.0f}",
                    flush=True,
                )


def main():
    warnings.simplefilter("ignore", AstropyUserWarning)
    name, *arguments = sys.argv[1:] or ["pulls"]
    reports = {"pulls": report_pulls, "real": report_real, "twin": report_twin}
    reports[name](*arguments)


if __name__ == "__main__":
    main()
