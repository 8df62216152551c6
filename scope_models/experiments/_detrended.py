"""What de-trending has left of the noise and of a transit, measured with the truth."""

import numpy as np

from scope_models.photometry import cdpp

__all__ = ["CONVENTIONS", "noise_of", "transit_amplitude"]

#: The two conventions of the CDPP.
CONVENTIONS = ("everest", "lightkurve")


def noise_of(corrector, observation):
    """
    Return the noise of a star without signal before and after de-trending.

    Parameters
    ----------
    corrector : PLDCorrector
        After a call of `PLDCorrector.correct`.
    observation : Observation
        The pixels that it has corrected, no cadence of which is flagged.

    Returns
    -------
    dict
        CDPP in ppm, "raw", "pld" and "floor", that of the noise alone in the aperture's sum, and
        "residual", the ratio of the last two, each followed by the convention; and the scores
        "held_out_mad" and "held_out_rms".
    """
    from scope_models.correctors._scores import score  # its package imports lightkurve

    mask = corrector.aperture_mask
    expected = observation.model()[:, mask].sum(axis=1)
    noise = (observation.flux[:, mask].sum(axis=1) - expected) / np.median(expected)
    scores = score(corrector, np.ones(len(noise)), noise)
    row = {"held_out_mad": scores.held_out_mad, "held_out_rms": scores.held_out_rms}
    for method in CONVENTIONS:
        row[f"raw_{method}"] = cdpp(corrector.original_lc, method=method)
        row[f"pld_{method}"] = cdpp(corrector.corrected_lc, method=method)
        row[f"floor_{method}"] = cdpp(1 + noise, method=method)
        row[f"residual_{method}"] = getattr(scores, f"residual_{method}")
    return row


def transit_amplitude(flux, transit):
    """
    Return the amplitude of a transit in a light curve.

    Parameters
    ----------
    flux : ndarray
        The light curve.
    transit : ndarray
        Relative flux of the model, 1 outside of transits.

    Returns
    -------
    float
        Least-squares amplitude in units of the model's.
    """
    good = np.isfinite(flux)
    shape = transit[good] - 1
    relative = flux[good] / np.median(flux[good & (transit == 1)]) - 1
    shape = shape - shape.mean()
    return float(shape @ relative / (shape @ shape))
