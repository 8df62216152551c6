"""Noise of a constant star in two apertures and after two corrections, beside its floor."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from astropy.table import Table
from scipy.ndimage import binary_dilation

from scope_models.experiments._correctors import quiet
from scope_models.experiments._statistics import cells, checked_claims, values_of
from scope_models.experiments.study import Study
from scope_models.models import TransitModel
from scope_models.photometry import cdpp
from scope_models.simulation import simulate

__all__ = ["METHODS", "SURVIVALS", "CorrectedStudy", "amplitude", "corrected_noise", "curves"]

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
_NOISE = ("floor", "floor_wide", *METHODS)


@dataclass(frozen=True, kw_only=True)
class CorrectedStudy(Study):
    """Base of studies whose summary is medians of cells, and claims that are ratios to a limit.

    A cell is all rows with the same values of the columns `cell`; medians are taken of `columns`
    and of what has a unit.
    """

    units: ClassVar[dict] = dict.fromkeys((*_NOISE, *(f"{name}_full" for name in _NOISE)), "ppm")
    hours: ClassVar[float] = 6.5
    cell: ClassVar[tuple] = ()
    columns: ClassVar[tuple] = SURVIVALS

    def measure(self, task, observation):
        """Return the noise of a star without signal before and after corrections.

        For each of ``METHODS`` the CDPP in lightkurve's convention, and, followed by "_full", the
        standard deviation of means of `hours` without any filter, both in ppm of the target's
        flux, NaN where a corrector refuses the data; the same of the noise of the light alone in
        both apertures, "floor" and "floor_wide"; "pld_survival" and "scene_survival", the part of
        the depth of transits of 1 % that is left if they are not masked, by which the noise of
        correctors is divided. "pixels" and "share" are the number of pixels of the file's aperture
        and the target's share in its starlight; "kept" is the part of the cadences with a finite
        flux of PLD.
        """
        return corrected_noise(observation, self.hours)

    def medians(self, table):
        """Return the medians of the cells, as rows."""
        rows = []
        for cell, part in cells(table, self.cell):
            rows.append(cell | {"stars": len(part)})
            for name in (*self.columns, *self.units):
                values = values_of(part, name)
                finite = values[np.isfinite(values)]
                rows[-1][name] = float(np.median(finite)) if len(finite) else np.nan
        return rows

    def compare(self, table, summary):
        """Add columns to the summary; by default none."""

    def summarize(self, table):
        """Return medians per cell, and in ``meta`` the claims.

        "claims" has the verdicts, "claims_checked" the ratio to its limit that decides each.
        """
        summary = Table(self.medians(table))
        self.compare(table, summary)
        for name in self.units:
            summary[name].unit = "ppm"
        claims = self.claims(summary)
        summary.meta["claims"], summary.meta["claims_checked"] = checked_claims(claims)
        return summary


def curves(part, **further):
    """Return noise against magnitude of each method and of further columns, for a panel."""
    names = {"floor": "Light alone"} | METHODS | further
    mag = np.array(part["mag"])
    return {label: (mag, np.array(part[name])) for name, label in names.items()}


def corrected_noise(observation, hours):
    """Return what `CorrectedStudy.measure` does; neither the star nor a neighbor varies."""
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
        survival = amplitude((dimmed - plain) / flux, planet(observation.time[used]) - 1)
        row[f"{name}_survival"] = survival
        change = (plain - level) / flux / survival
        row[name], row[f"{name}_full"] = _noise(change, hours, width, days)
        if name == "pld":
            row["kept"] = float(np.isfinite(plain).sum() / len(observation.cadenceno))
    return row


def amplitude(change, shape):
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
