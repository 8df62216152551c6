"""Noise before and after corrections, against its floor, of our corrector and lightkurve's."""

import itertools
import logging
import warnings
from contextlib import contextmanager

import numpy as np
from astropy.stats import mad_std
from lightkurve import correctors as rivals
from scipy.ndimage import binary_dilation

from scope_models import PLDCorrector, TransitModel, simulate
from scope_models.photometry import cdpp

#: What `corrected_noise` compares: the file's aperture, one a pixel wider, and the corrector.
METHODS = {"aperture": "Aperture", "wide": "Aperture + 1 pixel", "pld": "PLDCorrector"}
#: Columns of the part of transits that is left.
SURVIVALS = ("pld_survival",)
#: Units of the columns of noise.
UNITS = {
    f"{name}{end}": "ppm" for end in ("", "_full") for name in ("floor", "floor_wide", *METHODS)
}
#: The two conventions of the CDPP.
CONVENTIONS = ("everest", "lightkurve")
#: Settings of each corrector that are tried: aperture and order of PLD; number of windows of SFF.
LIGHTKURVE_CORRECTORS = {
    "lightkurve_pld": tuple(itertools.product(("whole", "pipeline"), (1, 2, 3))),
    "lightkurve_sff": ((5,), (10,), (20,)),
}
# Transits that are put in to see how much of them is left.
_DEPTH, _DURATION, _PERIOD = 0.01, 0.25, 3.1


def corrected_noise(observation, hours):
    """Return the noise of a star before and after a correction; no star of the scene varies.

    For each of `METHODS` and of the light alone in both apertures ("floor", "floor_wide") the CDPP
    in lightkurve's convention and, followed by "_full", the standard deviation of means of `hours`
    without any filter, both in ppm of the target's flux. That of the corrector, NaN where it
    refuses the data, is divided by "pld_survival", the part of the depth of unmasked transits of
    1 % that is left. "pixels" and "share": pixels of the file's aperture, and the target's share in
    its starlight; "kept": the part of the cadences with a flux of PLD.
    """
    scene, days = observation.scene, observation.detector.cadence_days
    orbit = _DEPTH, _DURATION, _PERIOD, observation.time[0] + 1.0
    planet = TransitModel.from_depth_duration(*orbit, exposure_time=days)
    target, *neighbors = scene.stars
    with quiet():
        noiseless = simulate(scene, noise=False).flux
        transits = simulate(scene.replace(stars=[target.replace(signal=planet), *neighbors]))
        files = [each.to_tpf() for each in (observation, transits)]
    used = np.searchsorted(observation.cadenceno, files[0].cadenceno)
    width = max(round(hours / 24 / days), 1)

    def summed(cube, mask):
        return cube[used][:, mask].sum(axis=1, dtype=float)

    def noise(change):
        """Return the CDPP, and the standard deviation of means without a filter, in ppm."""
        change = change[np.isfinite(change)]
        if len(change) < 2 * width:
            return np.nan, np.nan
        means = change[: len(change) // width * width].reshape(-1, width).mean(axis=1)
        return cdpp(1 + change, duration=hours, cadence=days), 1e6 * float(np.std(means))

    row = {"pixels": int(observation.aperture.sum())}
    wide = binary_dilation(observation.aperture)
    for name, end, mask in (("aperture", "", observation.aperture), ("wide", "_wide", wide)):
        total, still = (summed(cube, mask) for cube in (observation.flux, noiseless))
        share = observation.target_share(mask)[used]
        flux = np.median(still * share)
        row.setdefault("share", float(np.median(share)))
        row[f"floor{end}"], row[f"floor{end}_full"] = noise((total - still) / flux)
        row[name], row[f"{name}_full"] = noise((total - np.median(total)) / flux)
    row["pld"] = row["pld_full"] = row["pld_survival"] = np.nan
    with quiet():
        try:
            correctors = [PLDCorrector(tpf) for tpf in files]
            plain, dimmed = (each.correct().flux.value for each in correctors)
        except ValueError:
            return row
    mask, level = correctors[0].aperture_mask, np.nanmedian(plain)
    flux = np.median(summed(noiseless, mask) * observation.target_share(mask)[used])
    survival = amplitude((dimmed - plain) / flux, planet(observation.time[used]) - 1)
    row["pld_survival"] = survival
    row["pld"], row["pld_full"] = noise((plain - level) / flux / survival)
    row["kept"] = float(np.isfinite(plain).sum() / len(observation.cadenceno))
    return row


def amplitude(change, shape):
    """Return the least-squares amplitude of a shape, beside a constant."""
    good = np.isfinite(change)
    change, shape = (values[good] - values[good].mean() for values in (change, shape))
    return float(shape @ change / (shape @ shape))


def curves(part, **further):
    """Return noise against magnitude of each method and of further columns, for a panel."""
    names = {"floor": "Light alone"} | METHODS | further
    mag = np.array(part["mag"])
    return {label: (mag, np.array(part[name])) for name, label in names.items()}


def noise_of(corrector, flux, expected, width=13):
    """Score the last correction by a PLDCorrector of a star without signal and flagged cadences.

    `flux` are its pixels, and `expected` those without noise. CDPP in ppm, "raw", "pld" and
    "floor", that of the noise alone, and "residual", the ratio of the last two, each followed by
    the convention. Mean residuals of windows of `width` cadences that the model has not seen:
    "held_out_mad" and "held_out_rms", their scatter over that of the noise, which is white (it is
    better known from all cadences), and "held_out_pull", in units of their predicted errors.
    """
    mask = corrector.aperture_mask
    flux, expected = (cube[:, mask].sum(axis=1) for cube in (flux, expected))
    noise = (flux - expected) / np.median(expected)
    means, errors, used = corrector.held_out(width)
    floor = np.std(noise[used]) / np.sqrt(width)
    row = {"held_out_mad": float(mad_std(means) / floor)}
    row["held_out_rms"] = float(np.std(means) / floor)
    row["held_out_pull"] = float(np.sqrt(np.mean((means / errors) ** 2)))
    good = np.isfinite(corrector.corrected_lc.flux.value)
    for method in CONVENTIONS:
        row[f"raw_{method}"] = cdpp(corrector.original_lc, method=method)
        row[f"pld_{method}"] = cdpp(corrector.corrected_lc, method=method)
        row[f"floor_{method}"] = cdpp(1 + noise, method=method)
        same = cdpp(1 + noise[good], method=method)
        row[f"residual_{method}"] = row[f"pld_{method}"] / same
    return row


def transit_amplitude(flux, transit):
    """Return the least-squares amplitude of a transit, in units of the model's: 1 outside."""
    outside = np.isfinite(flux) & (transit == 1)
    return amplitude(flux / np.median(flux[outside]) - 1, transit - 1)


def correct(name, setting, tpf, aperture):
    """Return the flux that one of lightkurve's correctors makes of a target pixel file, or None.

    `name` is one of `LIGHTKURVE_CORRECTORS`, `setting` one of its settings, in which "whole" is
    `aperture`. SFF gets POS_CORR, which in simulations is the truth.
    """
    with quiet():
        try:
            if name == "lightkurve_pld":
                mask = aperture if setting[0] == "whole" else None
                corrector = rivals.PLDCorrector(tpf, aperture_mask=mask)
                lc = corrector.correct(pld_order=setting[1])
            else:
                light_curve = tpf.to_lightcurve(aperture_mask=aperture)
                corrector = rivals.SFFCorrector(light_curve)
                places = {"centroid_col": tpf.pos_corr1, "centroid_row": tpf.pos_corr2}
                lc = corrector.correct(**places, windows=setting[0])
        except (np.linalg.LinAlgError, ValueError):
            return None
    return np.asarray(lc.flux.value, dtype=float)


def best_setting(name, tpf, aperture):
    """Return the lowest CDPP by convention, and EVEREST's best setting; or empty and None."""
    lowest, best = {}, None
    for setting in LIGHTKURVE_CORRECTORS[name]:
        flux = correct(name, setting, tpf, aperture)
        if flux is not None and np.nanmedian(flux) > 0:
            found = {method: cdpp(flux, method=method) for method in CONVENTIONS}
            if found["everest"] < lowest.get("everest", np.inf):
                best = setting
            lowest = {name: min(noise, lowest.get(name, np.inf)) for name, noise in found.items()}
    return lowest, best


@contextmanager
def quiet():
    """Silence lightkurve and its libraries, and fix numpy's global state, from which it draws."""
    state = np.random.get_state()  # noqa: NPY002
    np.random.seed(0)  # noqa: NPY002
    logging.disable()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logging.disable(logging.NOTSET)
        np.random.set_state(state)  # noqa: NPY002
