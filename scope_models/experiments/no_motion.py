"""Benchmark 1 of the paper: stars that do not move, against the noise of Kepler."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from astropy.table import Table
from scipy.special import ndtri

from scope_models.experiments._statistics import compared, holds
from scope_models.experiments.populations import draw_star
from scope_models.experiments.reference import PERCENTILES, read_reference
from scope_models.experiments.study import Study, parameter
from scope_models.models import stochastic_signal
from scope_models.photometry import cdpp
from scope_models.scene import Detector, Motion
from scope_models.simulation import simulate

__all__ = ["NoMotion", "noise_parts"]

# Cadences in the 6.5 hours of a CDPP.
_WIDTH = 13
# Magnitude at which `giant_fraction` holds.
_BRIGHT = 11.5
# Steps of an evenly spaced sequence in two dimensions: inverse powers of the plastic number.
_STEPS = np.array([0.7548776662466927, 0.5698402909980532])
_TOLERANCE = 0.1


@dataclass(frozen=True, kw_only=True)
class NoMotion(Study):
    r"""Noise of stars that do not move, beside that of Kepler (benchmark 1 of the paper).

    Photons, background and read noise are those of `~scope_models.Detector.kepler`. To these comes
    a *floor*, white noise in proportion to the flux that all stars have, and in a second light
    curve of each star its own variability, red noise
    (`~scope_models.models.stochastic_signal`) of a CDPP that is log-normal for dwarfs and, in
    another way, for giants. The part of giants is :math:`f_g e^{-\gamma (Kp - 11.5)}`.

    Notes
    -----
    The seven fitted numbers follow from the five percentiles of Kepler's table in the nine bins
    from Kp 11.5 to 15.5, with variability, and from its 10th percentiles with detector noise
    alone, by ``python studies/calibrate_no_motion.py``. Everything else is an instrument number
    of `~scope_models.Detector.kepler`.

    References
    ----------
    Saunders, N. et al. 2019, "The Pointing Limits of Transiting Exoplanet Light Curve
    Characterization with Pixel Level De-correlation", section 3; Gilliland, R. L. et al. 2011,
    ApJS 197, 6, who separate the noise of instrument and stars.

    Examples
    --------
    >>> from scope_models.experiments.no_motion import NoMotion
    >>> study = NoMotion(magnitudes=(12,), stars=1)
    >>> row = study.run_star(study.tasks()[0])
    >>> 13 < row["detector_cdpp"] < 21
    True
    """

    name: ClassVar[str] = "no-motion"
    units: ClassVar[dict] = {
        "kp": "mag", "detector_cdpp": "ppm", "detector_cdpp_lightkurve": "ppm", "cdpp": "ppm",
        "cdpp_lightkurve": "ppm", "photon": "ppm", "background": "ppm", "read": "ppm",
        "variability": "ppm",
    }  # fmt: skip

    grid: ClassVar[dict] = {"mag": "magnitudes", "index": "stars"}
    key: ClassVar[str] = "kp{mag:g}-{index}"

    magnitudes: tuple[float, ...] = parameter(
        tuple(float(mag) for mag in np.arange(11.5, 15.6, 0.5)), "Middles of the bins."
    )
    stars: int = parameter(
        100,
        "Stars per bin. The paper has 5, too few for a 10th percentile. The magnitudes within a "
        "bin and the probabilities of the variability are spread evenly over the stars.",
        least=1,
    )
    width: float = parameter(
        0.5,
        "Width of the bins: magnitudes are uniform within. The reference has bins of 0.5 mag. With "
        "0 all stars have the magnitude in the middle.",
        positive=False,
    )
    cadences: int = parameter(1000, "Long cadences per star.", least=100)
    floor: float = parameter(
        8.7,
        r"CDPP of the floor, ppm: its standard deviation per cadence over :math:`\sqrt{13}`. "
        "Fitted.",
        positive=False,
    )
    dwarf_cdpp: float = parameter(
        23.5,
        "Median of the CDPP (lightkurve's convention) of dwarfs' variability, ppm. Fitted.",
        positive=True,
    )
    dwarf_scatter: float = parameter(
        0.79, "Standard deviation of its natural logarithm. Fitted.", positive=False
    )
    giant_cdpp: float = parameter(
        209.0, "Median of the CDPP of giants' variability, ppm. Fitted.", positive=True
    )
    giant_scatter: float = parameter(0.38, "The scatter of giants. Fitted.", positive=False)
    giant_fraction: float = parameter(
        0.43, "Part of giants :math:`f_g` at Kp 11.5. Fitted.", positive=False
    )
    giant_decline: float = parameter(
        0.28, r"Its decline :math:`\gamma` per magnitude. Fitted.", positive=False
    )

    def __post_init__(self):
        super().__post_init__()
        if not self.magnitudes:
            raise ValueError("`magnitudes` must hold at least one number")
        if self.giant_fraction > 1:
            raise ValueError(f"`giant_fraction` must not be above 1, got {self.giant_fraction}")

    def observation(self, task):
        """Return the pixels of a star with its variability."""
        motion = Motion.still(self.cadences)
        star = self._star(task)
        level, _ = self._variability(task, star.mag)
        red = stochastic_signal(motion.time, level, seed=self.star_rng(task["key"], "red"))
        star = star.replace(signal=star.signal * red(motion.time))
        return simulate(star, Detector.kepler(), motion, seed=self.star_seed(task["key"], "pixels"))

    def measure(self, task, observation):
        """Return the noise of a star with its variability, and of the same star without it.

        CDPP with variability and with detector noise alone, in both conventions; the parts of
        photons, background and read noise; and what was drawn.
        """
        star = observation.stars[0]
        still = star.replace(signal=self._star(task).signal)
        quiet = simulate(observation.scene.replace(stars=[still]))
        aperture = observation.aperture
        level, giant = self._variability(task, star.mag)
        row = {"kp": star.mag, "giant": giant, "variability": level}
        row["n_pixels"] = int(aperture.sum())
        for prefix, source in (("", observation), ("detector_", quiet)):
            flux = source.flux[:, aperture].sum(axis=1, dtype=float)
            row[f"{prefix}cdpp"] = cdpp(flux, method="everest")
            row[f"{prefix}cdpp_lightkurve"] = cdpp(flux)
        return row | noise_parts(quiet, aperture)

    def _even(self, task):
        """Return two numbers within 0 and 1 that are evenly spread over the stars of a bin."""
        shift = self.star_rng(f"kp{task['mag']:g}", "shift").uniform(size=2)
        return np.clip((shift + task["index"] * _STEPS) % 1.0, 1e-4, 1 - 1e-4)

    def _star(self, task):
        """Return a star with the floor and without variability."""
        mag = task["mag"] + self.width * (self._even(task)[0] - 0.5)
        white = self.star_rng(task["key"], "floor").standard_normal(self.cadences)
        signal = 1 + 1e-6 * self.floor * _WIDTH**0.5 * white
        return draw_star(self.star_rng(task["key"]), mag, Detector.kepler(), signal=signal)

    def _variability(self, task, mag):
        """Return the CDPP of a star's variability in ppm, and whether the star is a giant."""
        fraction = min(self.giant_fraction * np.exp(-self.giant_decline * (mag - _BRIGHT)), 1.0)
        place = self._even(task)[1]
        giant = bool(place < fraction)
        if giant:
            deviate = ndtri(place / fraction)
            return float(self.giant_cdpp * np.exp(self.giant_scatter * deviate)), giant
        deviate = ndtri((place - fraction) / (1.0 - fraction))
        return float(self.dwarf_cdpp * np.exp(self.dwarf_scatter * deviate)), giant

    def summarize(self, table):
        """Return our percentiles beside Kepler's.

        Per bin: the 10th percentile and the median of detector noise alone, and all percentiles
        with variability, with Kepler's and the ratio to them; ``_error`` is the standard deviation
        under resampling of the stars. ``meta`` has what was fitted and what holds.
        """
        reference = read_reference("kepler")
        rows = []
        for mag in self.magnitudes:
            stars = table[np.asarray(table["mag"]) == mag]
            if not len(stars):
                continue
            row = {"mag": mag, "stars": len(stars)}
            row |= compared("detector", stars["detector_cdpp"], reference, mag, ("p10", "median"))
            row |= compared("star", stars["cdpp"], reference, mag, PERCENTILES)
            for name in ("photon", "background", "read", "n_pixels"):
                row[name] = float(np.median(stars[name]))
            rows.append(row)
        summary = Table(rows=rows)
        summary.meta["fitted"] = {
            name: getattr(self, name)
            for name in (
                "floor", "dwarf_cdpp", "dwarf_scatter", "giant_cdpp", "giant_scatter",
                "giant_fraction", "giant_decline",
            )
        }  # fmt: skip
        summary.meta["claims"] = {
            f"{text} within {100 * _TOLERANCE:.0f} % of Kepler's in every bin": holds(
                ratios, _TOLERANCE
            )
            for text, ratios in (
                ("10th percentile with detector noise alone", summary["detector_p10_ratio"]),
                ("median with variability", summary["star_median_ratio"]),
            )
        }
        return summary

    def draw(self, table, summary):
        """Draw our noise over Kepler's."""
        from scope_models.plotting.calibration import plot_no_motion  # imports matplotlib

        return plot_no_motion(table, summary, read_reference("kepler"))


def noise_parts(observation, aperture):
    """Return what photons, background and read noise contribute to the CDPP of an aperture.

    Parameters
    ----------
    observation : Observation
        The star.
    aperture : ndarray of bool
        The pixels.

    Returns
    -------
    dict
        "photon", "background" and "read": nominal 6.5-hour noise in ppm, the standard deviation per
        cadence over the root of 13.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> from scope_models.experiments.no_motion import noise_parts
    >>> observation = simulate(Star(12.0), Detector.kepler(), Motion.still(50), seed=1)
    >>> parts = noise_parts(observation, observation.aperture)
    >>> {name: round(value, 1) for name, value in parts.items()}
    {'photon': 16.6, 'background': 1.6, 'read': 4.4}
    """
    detector = observation.detector
    exposure = detector.exposure_time
    electrons = float(np.median(observation.flux[:, aperture].sum(axis=1, dtype=float))) * exposure
    pixels = aperture.sum()
    variances = {
        "photon": electrons,
        "background": pixels * detector.background * exposure,
        "read": pixels * detector.cadence_read_noise**2,
    }
    scale = 1e6 / electrons / _WIDTH**0.5
    return {name: float(scale * np.sqrt(value)) for name, value in variances.items()}
