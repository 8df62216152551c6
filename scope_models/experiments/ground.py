"""Pixel-level de-correlation of stars from the ground, beside differential photometry."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from scope_models.effects import DarkCurrent, Extinction, Scintillation, Seeing
from scope_models.experiments._corrected import CorrectedStudy, amplitude
from scope_models.experiments._correctors import quiet
from scope_models.experiments._statistics import cells, on_grid
from scope_models.experiments.study import parameter
from scope_models.io.tpf import make_tpf_hdulist
from scope_models.models import TransitModel, moffat_psf
from scope_models.scene import Detector, Motion, Star
from scope_models.simulation import simulate

__all__ = ["GroundPLD"]

# Target and comparison stars, far from each other; the cut for PLD is about the target.
_SHAPE, _TARGET, _HALF = (57, 57), (28.0, 28.0), 8
_COMPARISONS = ((11.0, 11.0), (45.0, 11.0), (11.0, 45.0))
_RADIUS = 6.0  # px, 2.4 FWHM of the median seeing
_NIGHT, _CADENCE, _EXPOSURE = 6.0, 180.0, 60.0  # h, s, s
_ALTITUDE, _EXTINCTION, _CLOUDS = 2400.0, 0.07, 0.02
_MEANS = 10  # cadences of the means: 30 minutes
_DEPTH, _DURATION = 0.01, 0.1
_METHODS = {
    "raw": "Aperture alone",
    "raw_pld": "PLD alone",
    "differential": "Differential photometry",
    "differential_pld": "PLD on differential pixels",
    "differential_predicted": "PLD, predicted fractions",
}
_SURVIVALS = tuple(f"{name}_survival" for name in _METHODS if name.startswith("differential"))


@dataclass(frozen=True, kw_only=True)
class GroundPLD(CorrectedStudy):
    """Noise of stars from the ground with and without pixel-level de-correlation.

    A telescope with seeing, extinction, thin clouds and scintillation follows a field for some
    nights. Apertures follow the stars; the sum of three comparison stars is the reference of
    differential photometry. PLD, with pixel fractions as they are measured, gets the target's
    pixels as they are, and divided by the reference; and the latter with the fractions that a
    model of the pixels predicts, whose width is smooth in time.

    Examples
    --------
    >>> from scope_models.experiments.ground import GroundPLD
    >>> [task["key"] for task in GroundPLD(flats=(0.01,), stars=1).tasks()]
    ['flat0.01-drift0.03-0', 'flat0.01-drift0.15-0']
    """

    name: ClassVar[str] = "ground"
    units: ClassVar[dict] = dict.fromkeys(("floor", *_METHODS), "ppm")
    grid: ClassVar[dict] = {"index": "stars", "flat": "flats", "drift": "drifts"}
    key: ClassVar[str] = "flat{flat:g}-drift{drift:g}-{index}"
    cell: ClassVar[tuple] = ("flat", "drift")
    columns: ClassVar[tuple] = ("floor", *_METHODS, *_SURVIVALS)

    flats: tuple[float, ...] = parameter(
        (0.002, 0.01),
        "Standard deviation of the pixels' response after flat-fielding.",
        different="numbers",
        positive=False,
    )
    drifts: tuple[float, ...] = parameter(
        (0.03, 0.15),
        "Standard deviation of the drift of the tracking, arcsec/h.",
        different="numbers",
        positive=False,
    )
    aperture: float = parameter(1.0, "Diameter of the telescope, m.", positive=True)
    mag: float = parameter(
        14.5, "Magnitude R of the target; the comparison stars are 0.3 mag brighter."
    )
    stars: int = parameter(3, "Fields per cell.", least=1)
    cadences: int = parameter(360, "Exposures of 60 s, 120 in a night.", least=120)

    def observation(self, task, signal=None):
        """Return the pixels of a field: the same stars and weather in all cells.

        The signal is that of the target.
        """
        field = f"field{task['index']}"
        seed = self.star_seed(field, "noise")
        motion = Motion.ground(
            self.cadences, cadence=_CADENCE, night=_NIGHT, drift=task["drift"],
            aperture=self.aperture, seed=seed,
        )  # fmt: skip
        # The stars cross the zenith in the middle of each night.
        days = motion.time - motion.time[0]
        hours = 24 * (days - np.floor(days + 1e-9))
        airmass = 1 / np.cos(np.radians(14 * (hours - _NIGHT / 2)))
        effects = (
            Extinction(_EXTINCTION, airmass, scatter=_CLOUDS, correlation_time=0.05),
            Scintillation(self.aperture, _ALTITUDE, airmass),
            Seeing(airmass=airmass),
            DarkCurrent(0.1),
        )
        detector = Detector.ground(
            self.aperture, shape=_SHAPE, int_time=_EXPOSURE, read_time=_CADENCE - _EXPOSURE,
            interpixel_scatter=task["flat"], effects=effects, psf=moffat_psf(2.5, n_components=5),
        )  # fmt: skip
        shifts = self.star_rng(field).uniform(-0.5, 0.5, (4, 2))
        places = np.array([_TARGET, *_COMPARISONS]) + shifts
        stars = [Star(self.mag - 0.3 * (i > 0), *place) for i, place in enumerate(places)]
        stars[0] = stars[0].replace(signal=signal)
        return simulate(stars, detector, motion, seed=seed)

    def measure(self, task, observation):
        """Return the noise of a target, without any filter in time.

        Standard deviation of means of 30 minutes in ppm: of the aperture alone ("raw"), of the
        aperture over the comparison stars ("differential"), the same after PLD ("_pld",
        "_predicted"), and of the noise of photons, sky, detector and scintillation that
        differential photometry cannot avoid ("floor"); the part of the depth of transits of 1 %
        that is left, "_survival", by which the noise is divided.
        """
        time = observation.time
        planet = TransitModel.from_depth_duration(
            _DEPTH, _DURATION, 0.9, time[0] + 0.125, exposure_time=_EXPOSURE / 86400
        )
        still = _photometry(observation)
        dimmed = _photometry(self.observation(task, planet))
        row = {"floor": _floor(observation)}
        for name in _METHODS:
            survival = 1.0
            if f"{name}_survival" in _SURVIVALS:
                survival = amplitude(dimmed[name] - still[name], planet(time) - 1)
                row[f"{name}_survival"] = survival
            row[name] = _noise(still[name]) / abs(survival)
        return row

    def compare(self, table, summary):
        """Add "ratio", the noise of PLD on differential pixels over that without, and its error.

        It is the median over the fields, and "ratio_error" its standard error.
        """
        ratios = [
            np.array(part["differential_pld"] / part["differential"], dtype=float)
            for _, part in cells(table, self.cell)
        ]
        summary["ratio"] = [np.median(ratio) for ratio in ratios]
        # 1.25 sigma / sqrt(n): the standard error of a median of normal numbers.
        summary["ratio_error"] = [
            1.2533 * np.std(ratio, ddof=1) / np.sqrt(len(ratio)) if len(ratio) > 1 else np.nan
            for ratio in ratios
        ]

    def claims(self, summary):
        """Return the ratio of each claim to its limit."""
        good, poor = (summary["flat"] <= 0.002), (summary["flat"] >= 0.01)
        ratio = np.array(summary["ratio"])
        return {
            "PLD alone is 3 times noisier than differential photometry": (
                3 * np.array(summary["differential"] / summary["raw_pld"])
            ),
            "with flats of 1 % PLD lowers the noise of differential photometry by 10 %": (
                ratio[poor] / 0.9
            ),
            "with flats of 0.2 % PLD changes it by less than 10 %": (
                1 + np.abs(ratio[good] - 1) - 0.1
            ),
            "PLD on differential pixels keeps 90 % of the depth of transits": (
                0.9 / np.array(summary["differential_pld_survival"])
            ),
        }

    def draw(self, table, summary):
        """Draw maps of the noise of each method."""
        from scope_models.plotting.statistics import plot_maps  # imports matplotlib

        rows, columns = sorted(self.flats), sorted(self.drifts)
        axes = ("flat", rows), ("drift", columns)
        maps = {label: on_grid(summary, *axes, name) for name, label in _METHODS.items()}
        return plot_maps(
            maps, [100 * value for value in rows], columns,
            row_label="Response between pixels (%)", column_label="Drift (arcsec/h)",
            label="Noise in 30 min (ppm)", text=".0f",
        )  # fmt: skip


def _photometry(observation):
    """Return the relative flux of the target by each method, less 1."""
    from lightkurve import TessTargetPixelFile

    from scope_models.correctors import PLDCorrector

    sums = _sums(observation, observation.flux)
    reference = sums[1:].sum(axis=0)
    reference /= np.median(reference)
    found = {"raw": sums[0], "differential": sums[0] / reference}
    x, y = (round(value) for value in _TARGET)
    cut = np.s_[:, y - _HALF : y + _HALF + 1, x - _HALF : x + _HALF + 1]
    for name, fractions, divisor in (
        ("raw_pld", "measured", np.ones_like(reference)),
        ("differential_pld", "measured", reference),
        ("differential_predicted", "predicted", reference),
    ):
        flux, error = (
            cube[cut] / divisor[:, np.newaxis, np.newaxis]
            for cube in (observation.flux, observation.flux_err)
        )
        hdus = make_tpf_hdulist(
            metadata="Ground", time=observation.time, flux=flux, flux_err=error,
            pos_corr1=observation.motion.x, pos_corr2=observation.motion.y,
        )  # fmt: skip
        with quiet():
            corrector = PLDCorrector(TessTargetPixelFile(hdus, quality_bitmask="none"))
            corrected = corrector.correct(fractions=fractions)
        found[name] = np.full(len(reference), np.nan)
        used = np.searchsorted(observation.time, corrected.time.value - 1e-6)
        found[name][used] = corrected.flux.value
    return {name: flux / np.nanmedian(flux) - 1 for name, flux in found.items()}


def _sums(observation, cube):
    """Return the flux of all stars in apertures that follow them, shape (n_stars, n_cadences)."""
    from photutils.aperture import CircularAperture

    x, y = observation.truth.x, observation.truth.y
    return np.array(
        [
            CircularAperture(np.column_stack([x[:, i], y[:, i]]), _RADIUS).do_photometry(image)[0]
            for i, image in enumerate(cube.astype(float))
        ]
    ).T


def _floor(observation):
    """Return the noise that differential photometry cannot avoid, ppm in 30 minutes."""
    factor = observation.truth.columns["SCINTILLATION"].T
    light = _sums(observation, observation.model())
    variance = _sums(observation, observation.flux_err**2) / light**2 + factor.var(axis=1)[:, None]
    # The reference is the sum of stars of about the same brightness.
    total = np.mean(variance[0] + variance[1:].mean(axis=0) / len(_COMPARISONS))
    return float(1e6 * np.sqrt(total / _MEANS))


def _noise(change):
    """Return the standard deviation of means of cadences, ppm."""
    means = change[: len(change) // _MEANS * _MEANS].reshape(-1, _MEANS)
    with np.errstate(invalid="ignore"):
        counts = np.isfinite(means).sum(axis=1)
    kept = means[counts > _MEANS / 2]
    return float(1e6 * np.std(np.nanmean(kept, axis=1)))
