"""lightkurve's correctors on a simulated star, in their own best setting."""

import itertools
import logging
import warnings
from contextlib import contextmanager

import numpy as np

from scope_models.experiments._detrended import CONVENTIONS
from scope_models.photometry import cdpp

__all__ = ["LIGHTKURVE_CORRECTORS", "best_setting", "correct"]

#: Settings of each corrector that are tried: aperture and order of PLD; number of windows of SFF.
LIGHTKURVE_CORRECTORS = {
    "lightkurve_pld": tuple(itertools.product(("whole", "pipeline"), (1, 2, 3))),
    "lightkurve_sff": ((5,), (10,), (20,)),
}


def correct(name, setting, tpf, aperture, cadence_mask=None):
    """
    Correct a target pixel file with one of lightkurve's correctors.

    Parameters
    ----------
    name : str
        One of `LIGHTKURVE_CORRECTORS`.
    setting : tuple
        One of its settings. "whole" is `aperture`, "pipeline" that of the file. SFF gets
        the light curve of `aperture` and the columns POS_CORR, which in simulations are the truth.
    tpf : lightkurve.KeplerTargetPixelFile
        The pixels.
    aperture : ndarray of bool
        The aperture that holds the star wherever it goes.
    cadence_mask : ndarray of bool, optional
        True where a cadence may be used in the fit.

    Returns
    -------
    ndarray
        The corrected flux, or None if the corrector fails.
    """
    from lightkurve.correctors import PLDCorrector, SFFCorrector

    with _quiet(), _fixed_randomness():
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
    """
    Return the lowest CDPP of all settings in each convention, and EVEREST's setting.

    Parameters
    ----------
    name : str
        One of `LIGHTKURVE_CORRECTORS`.
    tpf : lightkurve.KeplerTargetPixelFile
        The pixels.
    aperture : ndarray of bool
        See `correct`.

    Returns
    -------
    lowest : dict
        CDPP in ppm by the name of the convention; empty if the corrector always fails.
    setting : tuple
        The setting with the lowest CDPP in EVEREST's convention, or None.
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
def _quiet():
    """Silence lightkurve's logger and its libraries' warnings."""
    logger = logging.getLogger("lightkurve")
    level = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.setLevel(level)


@contextmanager
def _fixed_randomness():
    """Make lightkurve's PLDCorrector reproducible: it draws from numpy's global state."""
    state = np.random.get_state()  # noqa: NPY002
    np.random.seed(0)  # noqa: NPY002
    try:
        yield
    finally:
        np.random.set_state(state)  # noqa: NPY002
