"""Noise of a constant star in two apertures and after two corrections, beside its floor."""

import numpy as np
from scipy.ndimage import binary_dilation

from scope_models.experiments._correctors import quiet
from scope_models.models import TransitModel
from scope_models.photometry import cdpp
from scope_models.simulation import simulate

__all__ = ["METHODS", "SURVIVALS", "checked_claims", "corrected_noise", "medians_of", "noise_units"]

#: What is compared: the file's aperture, one that is a pixel wider, and the two correctors.
METHODS = {
    "aperture": "Aperture",
    "wide": "Aperture + 1 pixel",
    "pld": "PLDCorrector",
    "scene": "SceneCorrector",
}


#: Columns of the part of transits that is left.
SURVIVALS = ("pld_survival", "scene_survival")
# Transits that are put in to see how much of them is left.
_DEPTH, _DURATION, _PERIOD = 0.01, 0.25, 3.1


def noise_units():
    """Return the units of the columns of `corrected_noise` that are noise."""
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
        both apertures, "floor" and "floor_wide"; "pld_survival" and "scene_survival", the part of
        the depth of transits of 1 % that is left if they are not masked. The noise
        of correctors is divided by it. "pixels" and "share" are the number of pixels of the file's
        aperture and the target's share in its starlight; "kept" is the part of the cadences with
        a finite flux of PLD.
    """
    from scope_models.correctors import PLDCorrector, SceneCorrector  # they import lightkurve

    scene, days = observation.scene, observation.detector.cadence_days
    planet = TransitModel.from_depth_duration(
        _DEPTH, _DURATION, _PERIOD, observation.time[0] + 1.0, exposure_time=days
    )
    target, *neighbors = scene.stars
    with quiet():
        noiseless = simulate(scene, noise=False).flux
        transits = simulate(scene.replace(stars=[target.replace(signal=planet), *neighbors]))
        files = [each.to_tpf() for each in (observation, transits)]
    used = np.searchsorted(observation.cadenceno, files[0].cadenceno)
    width = max(round(hours / 24 / days), 1)
    row = {"pixels": int(observation.aperture.sum())}

    def target_flux(mask):
        share = observation.target_share(mask)[used]
        return np.median(noiseless[used][:, mask].sum(axis=1, dtype=float) * share), np.median(
            share
        )

    for name, floor, mask in (
        ("aperture", "floor", observation.aperture),
        ("wide", "floor_wide", binary_dilation(observation.aperture)),
    ):
        total, still = (
            cube[used][:, mask].sum(axis=1, dtype=float) for cube in (observation.flux, noiseless)
        )
        flux, share = target_flux(mask)
        row.setdefault("share", float(share))
        row[floor], row[f"{floor}_full"] = _noise((total - still) / flux, hours, width, days)
        change = (total - np.median(total)) / flux
        row[name], row[f"{name}_full"] = _noise(change, hours, width, days)
    for name, make in (("pld", PLDCorrector), ("scene", SceneCorrector)):
        row[name] = row[f"{name}_full"] = row[f"{name}_survival"] = np.nan
        with quiet():
            try:
                correctors = [make(tpf) for tpf in files]
                plain, dimmed = (each.correct().flux.value for each in correctors)
            except ValueError:
                continue
        level = np.nanmedian(plain)
        flux = target_flux(correctors[0].aperture_mask)[0] if name == "pld" else level
        survival = _amplitude((dimmed - plain) / flux, planet(observation.time[used]) - 1)
        row[f"{name}_survival"] = survival
        change = (plain - level) / flux / survival
        row[name], row[f"{name}_full"] = _noise(change, hours, width, days)
        if name == "pld":
            row["kept"] = float(np.isfinite(plain).sum() / len(observation.cadenceno))
    return row


def _amplitude(change, shape):
    """Return the least-squares amplitude of a shape, beside a constant."""
    good = np.isfinite(change)
    change, shape = (values[good] - values[good].mean() for values in (change, shape))
    return float(shape @ change / (shape @ shape))


def _noise(change, hours, width, days):
    """Return the CDPP, and the standard deviation of means without a filter, in ppm."""
    change = change[np.isfinite(change)]
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
