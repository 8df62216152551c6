"""From a target pixel file to the file of a corrected light curve."""

from contextlib import suppress
from dataclasses import fields

import numpy as np
from astropy.io import fits

from scope_models.correctors._model import PLDOptions
from scope_models.correctors.pld import PLDCorrector
from scope_models.io import read_pixels
from scope_models.io._light_curves import archive_hdulist, make_light_curve_hdulist
from scope_models.io._opening import atomic_path, check_output, naming
from scope_models.io.tpf import write_hdulist
from scope_models.photometry import cdpp

__all__ = ["correct_file", "detrend_file", "make_archive_hdulist", "make_lightcurve_hdulist"]


def detrend_file(path, output, *, figure=None, overwrite=False, survival=False, **options):
    """Correct a target pixel file, and write the light curve to a FITS file.

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
    survival : bool, optional
        Whether the file has the card PLDSURV, `PLDFit.survival`: it takes a second correction.
    **options
        Arguments of `PLDCorrector` and its `correct`, and fields of `PLDOptions`; ``transits``, a
        mapping with the period, t0 (a mid-transit, as TIME) and duration of a planet in days, masks
        its transits; ``neighbors``, "find" or the file of a catalog with the columns ra and dec
        (degrees), or x and y (pixels, without the target), are stars whose light is taken off.

    Returns
    -------
    PLDCorrector
        The corrector, after the correction.

    Raises
    ------
    OSError
        If a file cannot be read or written, or exists and is not to be replaced.
    ValueError
        If a file that is written would be ``path`` itself, also through a link, the figure's format
        cannot be drawn, ``path`` is not a target pixel file, or the correction refuses its pixels.

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
    >>> corrector.result.groups[0]
    'order 1'
    """
    check_output(output, overwrite=overwrite, inputs=[path])
    if figure is not None:
        check_output(figure, overwrite=overwrite, inputs=[path, output])
        from scope_models.plotting._style import check_figure_format  # imports matplotlib

        check_figure_format(figure)
    with naming(path):
        corrector = correct_file(path, **options)
        hdus = make_lightcurve_hdulist(corrector, survival=survival)
    write_hdulist(hdus, output, overwrite=overwrite)
    if figure is not None:
        from scope_models.plotting._style import save_figure

        with atomic_path(figure, overwrite=overwrite) as temporary:
            save_figure(corrector.diagnose()[0].figure, temporary)
    return corrector


def correct_file(path, transits=None, aperture_mask=None, neighbors=None, **options):
    """Return a corrector after a correction; the options are those of `detrend_file`."""
    corrector = PLDCorrector(path, aperture_mask, neighbors)
    names = {item.name for item in fields(PLDOptions)} & options.keys()
    options["options"] = PLDOptions(**{name: options.pop(name) for name in names})
    if transits is not None:
        if missing := {"period", "t0", "duration"} - set(transits):
            raise ValueError(f"`transits` needs period, t0 and duration, got no {min(missing)}")
        period, t0, duration = (float(transits[name]) for name in ("period", "t0", "duration"))
        if not (period > 0 and duration > 0 and np.isfinite(t0)):
            raise ValueError(f"`transits` must have positive days, got {period} and {duration}")
        phase = np.mod(read_pixels(corrector.tpf).time - t0 + period / 2, period) - period / 2
        options["transit_mask"] = np.abs(phase) <= duration / 2
    corrector.correct(**options)
    return corrector


def make_lightcurve_hdulist(corrector, *, survival=False):
    """Make the FITS file of a corrected light curve; ``survival`` is that of `detrend_file`."""
    given = {"aperture": corrector.aperture_mask, "cards": _cards(corrector, survival)}
    return make_light_curve_hdulist(corrector.tpf, _columns(corrector), **given)


def make_archive_hdulist(corrector, path, collection, *, survival=False):
    """Make the FITS file of a corrected light curve as a `Collection` of an archive has them."""
    series, result = read_pixels(corrector.tpf), corrector.result
    cards = [("CDPPCONV", "lightkurve estimate_cdpp", "convention of CDPP and RAWCDPP")]
    if result is not None:
        cards += [
            ("CROWDING", result.crowding, "share of the target in the aperture, at most"),
            ("CONTAMIN", result.contamination, "light of neighbors taken off, share"),
            *_held_out(corrector),
        ]
    hdus = make_lightcurve_hdulist(corrector, survival=survival)
    return archive_hdulist(hdus, series, collection, path, cards)


def _held_out(corrector):
    """Return the cards of the scores on windows that the model has not seen."""
    residual, error, _ = corrector.held_out()
    scatter, pull = (float(np.sqrt(np.mean(x**2))) for x in (1e6 * residual, residual / error))
    return [
        ("HELDOUT", scatter, "[ppm] rms of held-out means of 6.5 h"),
        ("HELDPULL", pull, "rms of the same over their errors"),
    ]


def written(lc):
    """Return a light curve with the flux that a file holds, of 32 bits."""
    return type(lc)(time=lc.time, flux=lc.flux.astype(np.float32))


def _columns(corrector):
    """Return the columns of the light curve."""
    lc, original = corrector.corrected_lc, corrector.original_lc
    series, model = read_pixels(corrector.tpf), corrector.model
    quality = np.asarray(lc["quality"], dtype=np.int32)
    # NaN where there is none
    background, *states = np.full((4, len(series)), np.nan)
    if model and model.clean:
        for values, fitted in zip(
            states, (*model.clean.position.T, model.clean.focus), strict=True
        ):
            values[model.source.pixels.usable] = fitted
    if series.flux_bkg is not None:
        background = np.nansum(series.flux_bkg[:, corrector.aperture_mask], axis=1)
    if series.mission is None:
        raise ValueError("`tpf` names no known mission in MISSION or TELESCOP")
    flux = {"unit": "e-/s", "disp": "E14.7"}
    place = {"unit": "pixel", "disp": "F10.5"}
    return [
        fits.Column("TIME", "D", disp="D14.7", array=np.array(series.time)),
        fits.Column("CADENCENO", "J", disp="I10", array=np.array(series.cadenceno)),
        fits.Column("FLUX", "E", array=lc.flux.value, **flux),
        fits.Column("FLUX_ERR", "E", array=lc.flux_err.value, **flux),
        fits.Column(series.mission.quality_column, "J", array=quality),
        fits.Column("MOM_CENTR1", "D", array=np.asarray(lc["centroid_col"].value), **place),
        fits.Column("MOM_CENTR2", "D", array=np.asarray(lc["centroid_row"].value), **place),
        fits.Column("RAW_FLUX", "E", array=original.flux.value, **flux),
        fits.Column("RAW_FLUX_ERR", "E", array=original.flux_err.value, **flux),
        fits.Column("IN_FIT", "L", array=corrector.cadence_mask & ~corrector.outlier_mask),
        fits.Column("OUTLIER", "L", array=corrector.outlier_mask),
        fits.Column("BKG_FLUX", "E", array=background, **flux),
        fits.Column("POS_FIT1", "E", array=states[0], **place),
        fits.Column("POS_FIT2", "E", array=states[1], **place),
        fits.Column("WIDTH", "E", disp="E14.7", array=states[2]),
    ]


def _cards(corrector, survival):
    """Return keyword, value and comment of what the correction found."""
    result, cards = corrector.result, []
    if result is not None:
        cards += [
            ("PLDORDER", sum(group.startswith("order") for group in result.groups),
             "highest order of pixel fractions"),
            ("PLDNFIT", result.n_used, "cadences in the fit"),
            ("PLDNOUT", result.n_outliers, "cadences left out as outliers"),
            ("PLDNOISE", result.noise_scale, "white noise variance over FLUX_ERR^2"),
            ("PLDLNL", result.log_likelihood, "log marginal likelihood"),
            ("PLDDOF", sum(result.effective_parameters), "effective number of parameters"),
        ]  # fmt: skip
        if survival and np.isfinite(result.transit_survival):
            comment = "part of an unmasked transit that survives"
            cards.append(("PLDSURV", result.transit_survival, comment))
            cards.append(("PLDSURVE", result.transit_survival_err, "its standard deviation"))
    for name, lc in (("RAWCDPP", corrector.original_lc), ("CDPP", corrector.corrected_lc)):
        with suppress(ValueError):  # too few cadences
            cards.append((name, cdpp(written(lc)), "[ppm] 6.5-h CDPP, convention of lightkurve"))
    return cards
