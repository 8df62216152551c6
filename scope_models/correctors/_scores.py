"""Scores of a correction against the truth of a simulation."""

from dataclasses import dataclass

import numpy as np

from scope_models.photometry import cdpp

__all__ = ["Scores", "residual_cdpp", "robust_scatter", "score"]


@dataclass(frozen=True)
class Scores:
    """
    Scores of a corrected light curve; 1 is what the noise alone gives.

    Parameters
    ----------
    held_out_mad, held_out_rms : float
        Scatter of the mean residuals of windows that the model has not seen, over the floor; from
        the median absolute deviation, and rms.
    held_out_pull : float
        Rms of the windows' mean residuals in units of their predicted errors.
    residual_lightkurve, residual_everest : float
        CDPP of corrected over true flux, over the CDPP of the noise, in both conventions.
    floor : float
        Standard deviation of the noise' window means, ppm. The noise is white, so that it is the
        noise' own over the square root of the window: better known than from a few windows.
    """

    held_out_mad: float
    held_out_rms: float
    held_out_pull: float
    residual_lightkurve: float
    residual_everest: float
    floor: float


def robust_scatter(values):
    """Return 1.4826 times the median absolute deviation."""
    values = np.asarray(values)
    return float(1.4826 * np.median(np.abs(values - np.median(values))))


def residual_cdpp(corrected, truth, noise, method):
    """
    Return the CDPP of corrected over true flux, over the CDPP of the noise alone.

    Parameters
    ----------
    corrected, truth, noise : ndarray
        Corrected flux, true relative flux and relative noise, ``(n,)``.
    method : {"lightkurve", "everest"}
        Convention of the CDPP.
    """
    return cdpp(corrected / truth, method=method) / cdpp(1 + noise, method=method)


def score(corrector, truth, noise, width=13):
    """
    Score the last correction of a corrector.

    Parameters
    ----------
    corrector : PLDCorrector
        After a call of `PLDCorrector.correct`.
    truth : ndarray
        True relative flux, ``(n_cadences,)``.
    noise : ndarray
        Noise of the sum over the aperture over its expected value, ``(n_cadences,)``.
    width : int, optional
        Cadences in a window.
    """
    means, errors, used = corrector.held_out(width)
    floor = float(np.std(noise[used]) / np.sqrt(width))
    good = np.isfinite(corrector.corrected_lc.flux.value)
    flux = corrector.corrected_lc.flux.value[good]
    residual = {
        method: residual_cdpp(flux, truth[good], noise[good], method)
        for method in ("lightkurve", "everest")
    }
    return Scores(
        held_out_mad=robust_scatter(means) / floor,
        held_out_rms=float(np.std(means) / floor),
        held_out_pull=float(np.sqrt(np.mean((means / errors) ** 2))),
        residual_lightkurve=residual["lightkurve"],
        residual_everest=residual["everest"],
        floor=1e6 * floor,
    )
