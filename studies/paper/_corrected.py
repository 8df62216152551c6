"""Noise of a constant star in two apertures and after a correction, beside its floor."""

import numpy as np
from _correctors import quiet
from scipy.ndimage import binary_dilation

from scope_models import TransitModel, simulate
from scope_models.photometry import cdpp

__all__ = ["METHODS", "SURVIVALS", "UNITS", "amplitude", "corrected_noise", "curves"]

#: What is compared: the file's aperture, one that is a pixel wider, and the corrector.
METHODS = {
    "aperture": "Aperture",
    "wide": "Aperture + 1 pixel",
    "pld": "PLDCorrector",
}
#: Columns of the part of transits that is left.
SURVIVALS = ("pld_survival",)
_NOISE = ("floor", "floor_wide", *METHODS)
#: Units of the columns of noise.
UNITS = dict.fromkeys((*_NOISE, *(f"{name}_full" for name in _NOISE)), "ppm")
# Transits that are put in to see how much of them is left.
_DEPTH, _DURATION, _PERIOD = 0.01, 0.25, 3.1


def corrected_noise(observation, hours):
    """Return the noise of a star before and after a correction; no star of the scene varies.

    For each of `METHODS` the CDPP in lightkurve's convention, and, followed by "_full", the
    standard deviation of means of `hours` without any filter, both in ppm of the target's flux, NaN
    where the corrector refuses the data; the same of the noise of the light alone in both
    apertures, "floor" and "floor_wide"; "pld_survival", the part of the depth of transits of 1 %
    that is left if they are not masked, by which the noise of the corrector is divided.
    "pixels" and "share" are the number of pixels of the file's aperture and the target's share in
    its starlight; "kept" is the part of the cadences with a finite flux of PLD.
    """
    from scope_models import PLDCorrector  # imports lightkurve

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

    def target_flux(mask):
        share = observation.target_share(mask)[used]
        light = noiseless[used][:, mask].sum(axis=1, dtype=float)
        return np.median(light * share), np.median(share)

    def noise(change):
        """Return the CDPP, and the standard deviation of means without a filter, in ppm."""
        change = change[np.isfinite(change)]
        if len(change) < 2 * width:
            return np.nan, np.nan
        means = change[: len(change) // width * width].reshape(-1, width).mean(axis=1)
        return cdpp(1 + change, duration=hours, cadence=days), 1e6 * float(np.std(means))

    row = {"pixels": int(observation.aperture.sum())}
    for name, floor, mask in (
        ("aperture", "floor", observation.aperture),
        ("wide", "floor_wide", binary_dilation(observation.aperture)),
    ):
        total, still = (
            cube[used][:, mask].sum(axis=1, dtype=float) for cube in (observation.flux, noiseless)
        )
        flux, share = target_flux(mask)
        row.setdefault("share", float(share))
        row[floor], row[f"{floor}_full"] = noise((total - still) / flux)
        row[name], row[f"{name}_full"] = noise((total - np.median(total)) / flux)
    row["pld"] = row["pld_full"] = row["pld_survival"] = np.nan
    with quiet():
        try:
            correctors = [PLDCorrector(tpf) for tpf in files]
            plain, dimmed = (each.correct().flux.value for each in correctors)
        except ValueError:
            return row
    level = np.nanmedian(plain)
    flux = level if correctors[0].result.neighbors else target_flux(correctors[0].aperture_mask)[0]
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
