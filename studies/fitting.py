"""Fits of simulated stars: ``docs/data/store_fits.py`` stores the pulls of their parameters."""

from itertools import combinations

import numpy as np

from scope_models import Detector, Motion, Star, simulate
from scope_models.fitting import FitOptions, fit_tpf
from scope_models.models import BivariateGaussianPSF, SensitivityPolynomial


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
    pulls = {k: (fit.values[k] - v) / fit.errors[k] for k, v in (values | offsets).items()}
    some = np.linspace(0, len(fit.time) - 1, 5).astype(int)
    cadences = {}
    for k, star in enumerate((fit, *fit.neighbors)):
        flux = truth.flux[k] * truth.relative_flux[k][used]
        for name, expected in (("x", truth.x[k, used]), ("y", truth.y[k, used]), ("flux", flux)):
            error = getattr(star, f"{name}_err")
            cadences[f"{name}_{k}"] = ((getattr(star, name) - expected) / error)[some].tolist()
    return {
        "n_stars": n_stars, "seed": seed, "converged": fit.converged, "chi2": fit.reduced_chi2,
        "shared": {name: pulls[name] for name in values},
        "star": {name: pulls[name] for name in offsets}, "cadence": cadences,
    }  # fmt: skip
