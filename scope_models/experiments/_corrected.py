"""Noise of a constant star in two apertures and after two corrections, beside its floor."""

import warnings

import numpy as np
from scipy.ndimage import binary_dilation

from scope_models.exceptions import ScopeModelsWarning
from scope_models.photometry import cdpp
from scope_models.simulation import simulate

__all__ = ["METHODS", "checked_claims", "corrected_noise", "medians_of", "noise_units"]

#: What is compared: the file's aperture, one that is a pixel wider, and the two correctors.
METHODS = {
    "aperture": "Aperture",
    "wide": "Aperture + 1 pixel",
    "pld": "PLDCorrector",
    "scene": "SceneCorrector",
}


def noise_units():
    """Return the units of the columns of `corrected_noise`."""
    names = ("floor", "floor_wide", *METHODS)
    return dict.fromkeys((*names, *(f"{name}_full" for name in names)), "ppm")


def corrected_noise(observation, hours):
    """
    Return the noise of a star without signal before and after corrections.

    Parameters
    ----------
    observation : Observation
        The star and its neighbors, none of which varies.
    hours : float
        Time scale of the noise.

    Returns
    -------
    dict
        For each of `METHODS` the CDPP in lightkurve's convention, and, followed by "_full", the
        standard deviation of means of `hours` without any filter, both in ppm of the target's
        flux, NaN where a corrector refuses the data; the same of the noise of the light alone in
        both apertures, "floor" and "floor_wide"; "pixels" and "share", number of pixels of the
        aperture and share of the target in its starlight; "kept", the part of the cadences with a
        finite flux of PLD.
    """
    from scope_models.correctors import PLDCorrector, SceneCorrector  # they import lightkurve

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ScopeModelsWarning)
        quiet = simulate(observation.scene, noise=False).flux
    tpf = observation.to_tpf()
    used = np.searchsorted(observation.cadenceno, tpf.cadenceno)
    days = observation.detector.cadence_days
    width = max(round(hours / 24 / days), 1)
    row, targets = {"pixels": int(observation.aperture.sum())}, {}
    wide = binary_dilation(observation.aperture)
    for name, floor, mask in (
        ("aperture", "floor", observation.aperture),
        ("wide", "floor_wide", wide),
    ):
        total, still = (
            cube[used][:, mask].sum(axis=1, dtype=float) for cube in (observation.flux, quiet)
        )
        share = observation.target_share(mask)[used]
        targets[name] = np.median(still * share)
        row[floor], row[f"{floor}_full"] = _noise(total - still, targets[name], hours, width, days)
        change = total - np.median(total)
        row[name], row[f"{name}_full"] = _noise(change, targets[name], hours, width, days)
        row.setdefault("share", float(np.median(share)))
    for name, corrector in (("pld", PLDCorrector), ("scene", SceneCorrector)):
        row[name] = row[f"{name}_full"] = np.nan
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ScopeModelsWarning)
            try:
                flux = corrector(tpf).correct().flux.value
            except ValueError:
                continue
        level = np.nanmedian(flux)
        target = targets["aperture"] if name == "pld" else level
        row[name], row[f"{name}_full"] = _noise(flux - level, target, hours, width, days)
        if name == "pld":
            row["kept"] = float(np.isfinite(flux).sum() / len(observation.cadenceno))
    return row


def _noise(change, target, hours, width, days):
    """Return the CDPP, and the standard deviation of means without a filter, in ppm."""
    change = change[np.isfinite(change)] / target
    if len(change) < 2 * width:
        return np.nan, np.nan
    means = change[: len(change) // width * width].reshape(-1, width).mean(axis=1)
    return cdpp(1 + change, duration=hours, cadence=days), 1e6 * float(np.std(means))


def medians_of(table, keys, columns):
    """
    Return the medians of columns in each cell of a grid.

    Parameters
    ----------
    table : astropy.table.Table
        The results.
    keys : sequence of str
        Columns whose values make a cell.
    columns : iterable of str
        Columns of which medians are taken, NaN left out.

    Returns
    -------
    list of dict
        One row per cell, sorted, with the number of its "stars".
    """
    cells = {}
    for number, cell in enumerate(zip(*(table[key] for key in keys), strict=True)):
        cells.setdefault(cell, []).append(number)
    rows = []
    for cell in sorted(cells):
        part = table[cells[cell]]
        row = dict(zip(keys, cell, strict=True)) | {"stars": len(part)}
        for name in columns:
            values = np.ma.filled(np.ma.asarray(part[name], dtype=float), np.nan)
            finite = values[np.isfinite(values)]
            row[name] = float(np.median(finite)) if len(finite) else np.nan
        rows.append(row)
    return rows


def checked_claims(claims):
    """
    Return the verdicts on claims that are ratios to a limit.

    Parameters
    ----------
    claims : mapping of str to array_like
        For each claim, which the text states, the ratios that must be at most 1; NaN where one
        could not be measured, empty if nothing was.

    Returns
    -------
    verdicts, checked : dict
        "holds", "does not hold" or "not checked" by claim, and the largest ratio of each.
    """
    verdicts, checked = {}, {}
    for claim, values in claims.items():
        ratios = np.atleast_1d(np.asarray(values, dtype=float))
        if not ratios.size or np.isnan(ratios).any():
            verdicts[claim] = "not checked"
            continue
        verdicts[claim] = "holds" if ratios.max() <= 1 else "does not hold"
        checked[claim] = float(ratios.max())
    return verdicts, checked
