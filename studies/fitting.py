"""Fits of target pixel files: errors that hold, and twins.

    python studies/fitting.py FOLDER

simulates the fits of the archive files in a folder, and prints the noise of stars and twins.
``docs/data/store_fits.py`` stores `scene_pulls`.
"""

import sys
import warnings
from itertools import combinations, product
from pathlib import Path

import lightkurve as lk
import numpy as np
from _rows import FILES
from astropy.utils.exceptions import AstropyUserWarning

from scope_models import (
    BivariateGaussianPSF,
    Detector,
    Motion,
    PLDCorrector,
    SensitivityPolynomial,
    Star,
    fit_tpf,
    simulate,
)
from scope_models.fitting import FitOptions
from scope_models.photometry import cdpp


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
    # Wells without end: stars above Kp 11.5 saturate.
    detector = Detector.k2(shape=(side, side), interpixel_scatter=0, well_depth=None)
    return simulate(stars, detector, 2 * Motion.k2_roll(60, seed=seed), seed=seed)


def scene_pulls(n_stars, seed):
    """Return the pulls of a scene by group: of what all share, of stars, and of cadences."""
    observation = make_scene(n_stars, seed)
    truth, psf = observation.truth, observation.stars[0].psf
    places = [(star.x_0, star.y_0) for star in observation.stars]
    curvature = SensitivityPolynomial(fixed={"ax1": True, "ay1": True})
    fit = fit_tpf(
        observation.to_tpf(quality_bitmask="none"), 1, curvature, stars=np.round(places, 1),
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


def report_twin(folder):
    """Print the noise of stars and of their twins in the same aperture and cadences."""
    print("Twins: 6.5-h CDPP (ppm), lightkurve's and EVEREST's convention")
    for star, name in FILES.items():
        path = Path(folder) / name
        fit = fit_tpf(path, response="pixels")
        twin = simulate(fit.scene().replace(seed=1)).to_tpf(quality_bitmask="none")
        used = fit.cadenceno[~fit.outliers]
        tpf, twin = (one[np.isin(one.cadenceno, used)] for one in (lk.read(path), twin))
        masks = {"pipeline": tpf.pipeline_mask, "PLD": PLDCorrector(tpf).aperture_mask}
        for label, kind in product(masks, ("real", "twin")):
            corrector = PLDCorrector(tpf if kind == "real" else twin, masks[label])
            curves = {"summed": corrector.original_lc, "de-trended": corrector.correct()}
            print(f"  {star} {label} aperture, {kind}:", *(
                f"{how} {cdpp(curve):.0f} {cdpp(curve, method='everest'):.0f}"
                for how, curve in curves.items()
            ), flush=True)  # fmt: skip


if __name__ == "__main__":
    warnings.simplefilter("ignore", AstropyUserWarning)
    report_twin(sys.argv[1])
