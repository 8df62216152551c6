"""Scores of corrections against the truth, and lightkurve's correctors in their best setting."""

import itertools
import logging
import warnings
from contextlib import contextmanager

import numpy as np
from astropy.stats import mad_std

from scope_models.photometry import cdpp

__all__ = [
    "CONVENTIONS", "LIGHTKURVE_CORRECTORS", "best_setting", "correct", "noise_of", "quiet", "score",
    "transit_amplitude",
]  # fmt: skip

#: The two conventions of the CDPP.
CONVENTIONS = ("everest", "lightkurve")
#: Settings of each corrector that are tried: aperture and order of PLD; number of windows of SFF.
LIGHTKURVE_CORRECTORS = {
    "lightkurve_pld": tuple(itertools.product(("whole", "pipeline"), (1, 2, 3))),
    "lightkurve_sff": ((5,), (10,), (20,)),
}


def score(corrector, noise, width=13):
    """Score the last correction of a star without signal by a PLDCorrector.

    `noise` is that of the sum over the aperture over its expected value. CDPP in ppm, "raw", "pld"
    and "floor", that of the noise alone, and "residual", the ratio of the last two, each followed
    by the convention. "held_out_mad" and "held_out_rms" are the scatter of the mean residuals of
    windows of `width` cadences that the model has not seen, over that of the noise, which is white:
    better known from all cadences than from a few windows; "held_out_pull" is the rms of these
    residuals in units of their predicted errors.
    """
    means, errors, used = corrector.held_out(width)
    floor = np.std(noise[used]) / np.sqrt(width)
    row = {
        "held_out_mad": float(mad_std(means) / floor),
        "held_out_rms": float(np.std(means) / floor),
        "held_out_pull": float(np.sqrt(np.mean((means / errors) ** 2))),
    }
    good = np.isfinite(corrector.corrected_lc.flux.value)
    for method in CONVENTIONS:
        row[f"raw_{method}"] = cdpp(corrector.original_lc, method=method)
        row[f"pld_{method}"] = cdpp(corrector.corrected_lc, method=method)
        row[f"floor_{method}"] = cdpp(1 + noise, method=method)
        same = cdpp(1 + noise[good], method=method)
        row[f"residual_{method}"] = row[f"pld_{method}"] / same
    return row


def noise_of(corrector, observation):
    """Return the scores of the last correction of an observation without flagged cadences."""
    mask = corrector.aperture_mask
    expected = observation.model()[:, mask].sum(axis=1)
    return score(
        corrector, (observation.flux[:, mask].sum(axis=1) - expected) / np.median(expected)
    )


def transit_amplitude(flux, transit):
    """Return the least-squares amplitude of a transit in a light curve, in units of the model's.

    `transit` is the relative flux of the model, 1 outside of transits.
    """
    good = np.isfinite(flux)
    shape = transit[good] - 1
    relative = flux[good] / np.median(flux[good & (transit == 1)]) - 1
    shape = shape - shape.mean()
    return float(shape @ relative / (shape @ shape))


def correct(name, setting, tpf, aperture, cadence_mask=None):
    """Return the flux that one of lightkurve's correctors makes of a target pixel file, or None.

    `name` is one of `LIGHTKURVE_CORRECTORS`, `setting` one of its settings. "whole" is `aperture`,
    "pipeline" that of the file. SFF gets the light curve of `aperture` and the columns POS_CORR,
    which in simulations are the truth. `cadence_mask` is True where a cadence may be used in the
    fit.
    """
    from lightkurve.correctors import PLDCorrector, SFFCorrector

    with quiet():
        try:
            if name == "lightkurve_pld":
                mask = aperture if setting[0] == "whole" else None
                corrector = PLDCorrector(tpf, aperture_mask=mask)
                lc = corrector.correct(pld_order=setting[1], cadence_mask=cadence_mask)
            else:
                corrector = SFFCorrector(tpf.to_lightcurve(aperture_mask=aperture))
                lc = corrector.correct(
                    centroid_col=tpf.pos_corr1, centroid_row=tpf.pos_corr2, windows=setting[0],
                    cadence_mask=cadence_mask,
                )  # fmt: skip
        except (np.linalg.LinAlgError, ValueError):
            return None
    return np.asarray(lc.flux.value, dtype=float)


def best_setting(name, tpf, aperture):
    """Return the lowest CDPP of all settings by convention, and the best setting in EVEREST's.

    They are empty and None if the corrector always fails.
    """
    lowest, best = {}, None
    for setting in LIGHTKURVE_CORRECTORS[name]:
        flux = correct(name, setting, tpf, aperture)
        if flux is None or not np.nanmedian(flux) > 0:
            continue
        found = {method: cdpp(flux, method=method) for method in CONVENTIONS}
        if found["everest"] < lowest.get("everest", np.inf):
            best = setting
        lowest = {method: min(value, lowest.get(method, np.inf)) for method, value in found.items()}
    return lowest, best


@contextmanager
def quiet():
    """Silence lightkurve and its libraries, and fix numpy's global state, from which it draws."""
    logger, state = logging.getLogger("lightkurve"), np.random.get_state()  # noqa: NPY002
    level = logger.level
    logger.setLevel(logging.CRITICAL)
    np.random.seed(0)  # noqa: NPY002
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.setLevel(level)
        np.random.set_state(state)  # noqa: NPY002
