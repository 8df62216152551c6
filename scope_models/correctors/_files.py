"""From a target pixel file to the file of a corrected light curve."""

import warnings

import numpy as np
from astropy.io import fits

from scope_models._version import __version__
from scope_models.correctors.pld import PLDCorrector
from scope_models.io._atomic import atomic_path
from scope_models.missions import TIME_ZEROS
from scope_models.photometry import cdpp

__all__ = ["detrend_file", "make_lightcurve_hdulist"]


def detrend_file(path, output, *, figure=None, overwrite=False, **options):
    """
    Correct a target pixel file, and write the light curve to a FITS file.

    Parameters
    ----------
    path : str or path-like
        A target pixel file that lightkurve reads.
    output : str or path-like
        The light-curve file, which lightkurve reads.
    figure : str or path-like, optional
        Where to save the figure of `PLDCorrector.diagnose`; its suffix is the format.
    overwrite : bool, optional
        Whether files that exist are replaced.
    **options
        Arguments of `PLDCorrector.correct`.

    Returns
    -------
    PLDCorrector
        The corrector, after the correction.

    Raises
    ------
    OSError
        If a file cannot be read or written, or exists and is not to be replaced.
    ValueError
        If ``path`` is not a target pixel file, or the correction refuses its pixels.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> from scope_models.correctors import detrend_file
    >>> observation = simulate(Star(12), Detector.k2(), Motion.k2_roll(300), seed=1)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     star = observation.write(Path(folder) / "star.fits")
    ...     corrector = detrend_file(star, Path(folder) / "lc.fits", order=1)
    >>> corrector.result.groups
    ('order 1',)
    """
    corrector = PLDCorrector(path)
    corrector.correct(**options)
    with atomic_path(output, overwrite=overwrite) as temporary:
        make_lightcurve_hdulist(corrector).writeto(temporary, checksum=True)
    if figure is not None:
        with atomic_path(figure, overwrite=overwrite) as temporary:
            drawn = corrector.diagnose()[0].figure
            drawn.savefig(temporary, dpi=120)
            drawn.clear()
    return corrector


def make_lightcurve_hdulist(corrector):
    """
    Make the FITS file of a corrected light curve.

    Parameters
    ----------
    corrector : PLDCorrector
        After a correction.

    Returns
    -------
    `~astropy.io.fits.HDUList`
        lightkurve's file of the corrected light curve, with the measured flux, the systematics'
        masks and the result's numbers added.
    """
    from lightkurve import LightCurve

    lc, mask = corrector.corrected_lc, corrector.aperture_mask
    identity = _identity(lc, corrector.tpf)
    lc = lc.copy()
    lc.meta["TELESCOP"] = identity["TELESCOP"]  # lightkurve logs its absence
    with warnings.catch_warnings():
        # lightkurve 2.6 inverts bools with ~, of which Python 3.12 and later warn
        warnings.filterwarnings("ignore", "Bitwise inversion", DeprecationWarning)
        hdus = LightCurve.to_fits(lc, **identity)
    reference = int(TIME_ZEROS[lc.time.format])
    table = fits.BinTableHDU.from_columns(
        hdus[1].columns + fits.ColDefs(_columns(corrector)), name="LIGHTCURVE"
    )
    table.header["TUNIT1"] = f"BJD - {reference}"
    table.header["BJDREFI"] = (reference, "reference of TIME, integer part")
    table.header["BJDREFF"] = (0.0, "reference of TIME, fraction of the day")
    header = hdus[0].header
    header["PROCVER"] = (f"scope_models {__version__}", "software version")
    for keyword, value, comment in _cards(corrector):
        header[keyword] = (value, comment)
    # bit 1: collected, bit 2: in the aperture
    aperture = fits.ImageHDU((1 + 2 * mask).astype(np.int32), name="APERTURE")
    return fits.HDUList([hdus[0], table, aperture])


def _identity(lc, tpf):
    """Return the cards that say which star it is."""
    tess = lc.time.format == "btjd"
    values = {
        "TELESCOP": "TESS" if tess else "Kepler",
        "TICID" if tess else "KEPLERID": lc.meta.get("TARGETID"),
        "OBJECT": lc.meta.get("OBJECT"),
        "RA_OBJ": lc.meta.get("RA"),
        "DEC_OBJ": lc.meta.get("DEC"),
    }
    known = ("MISSION", "CHANNEL", "QUARTER", "CAMPAIGN", "SECTOR", "CAMERA", "CCD")
    values |= {name: lc.meta.get(name) for name in known}
    values["DATE-OBS"] = str(tpf.time[np.isfinite(tpf.time.value)][0].utc.isot)
    simple = (str, bool, int, float)
    return {k: v for k, v in values.items() if isinstance(v, simple)}


def _columns(corrector):
    """Return the columns beside time, flux and cadence number."""
    lc, original = corrector.corrected_lc, corrector.original_lc
    tess = lc.time.format == "btjd"
    quality = np.asarray(lc["quality"], dtype=np.int32)
    unit = "electron / s"
    return [
        fits.Column("QUALITY" if tess else "SAP_QUALITY", "J", array=quality),
        fits.Column("MOM_CENTR1", "D", unit="pixel", array=np.asarray(lc["centroid_col"].value)),
        fits.Column("MOM_CENTR2", "D", unit="pixel", array=np.asarray(lc["centroid_row"].value)),
        fits.Column("RAW_FLUX", "E", unit=unit, array=original.flux.value),
        fits.Column("RAW_FLUX_ERR", "E", unit=unit, array=original.flux_err.value),
        fits.Column("IN_FIT", "L", array=corrector.cadence_mask & ~corrector.outlier_mask),
        fits.Column("OUTLIER", "L", array=corrector.outlier_mask),
    ]


def _cards(corrector):
    """Return keyword, value and comment of what the correction found."""
    result = corrector.result
    cards = []
    if result is not None:
        cards += [
            ("PLDORDER", sum("shared" not in g for g in result.groups if g[:5] == "order"),
             "highest order of pixel fractions"),
            ("PLDNFIT", result.n_used, "cadences in the fit"),
            ("PLDNOUT", result.n_outliers, "cadences left out as outliers"),
            ("PLDNOISE", result.noise_scale, "white noise variance over FLUX_ERR^2"),
            ("PLDLNL", result.log_likelihood, "log marginal likelihood"),
            ("PLDDOF", sum(result.effective_parameters), "effective number of parameters"),
            ("PLDSURV", result.transit_survival, "part of an unmasked transit that survives"),
        ]  # fmt: skip
    for name, lc in (("RAWCDPP", corrector.original_lc), ("CDPP", corrector.corrected_lc)):
        try:
            value = cdpp(lc, method="everest")
        except ValueError:  # too few cadences
            continue
        cards.append((name, value, "[ppm] 6.5-h CDPP, convention of EVEREST"))
    return cards
