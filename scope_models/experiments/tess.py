"""Noise of TESS stars against magnitude, alone and with neighbors, beside TESS's noise model."""

from dataclasses import dataclass, replace
from typing import ClassVar

import astropy.units as u
import numpy as np
from astropy.table import Table

from scope_models._arrays import plain_array
from scope_models._checks import checked_integer, checked_number
from scope_models.effects import ScatteredLight, mission_effects
from scope_models.experiments._corrected import (
    METHODS,
    SURVIVALS,
    checked_claims,
    corrected_noise,
    medians_of,
    noise_units,
)
from scope_models.experiments._correctors import quiet
from scope_models.experiments.study import Study
from scope_models.scene.detector import Detector
from scope_models.scene.motion import Motion
from scope_models.scene.star import Star
from scope_models.simulation import simulate

__all__ = ["TESSNoise", "tess_noise"]

_HOURS = 1.0
_SPAN, _SLOPE = 6.0, 0.3  # magnitudes of neighbors below the target, and slope of log counts
_CLEAR = 1.0  # px between the target and a neighbor, at least


def tess_noise(mag, pixels, hours=_HOURS, *, floor=60.0):
    r"""Return the noise that TESS's noise model predicts.

    .. math:: \sigma^2 = \frac{F + n (B + 10^2 / t_2)}{F^2\, t} + \frac{\sigma_s^2}{h}

    with the flux F, n pixels of background B, 10 electrons of read noise in each exposure of
    :math:`t_2` = 1.98 s, the exposure time t (80 % of the wall time), and a systematic floor of
    :math:`\sigma_s` = 60 ppm in one hour.

    Parameters
    ----------
    mag : array_like or Quantity
        Magnitudes T.
    pixels : array_like
        Pixels in the aperture.
    hours : float or Quantity, optional
        Time scale h, hours.
    floor : float or Quantity, optional
        Systematic floor, ppm in one hour.

    Returns
    -------
    ndarray
        Noise, ppm.

    References
    ----------
    Sullivan, P. W. et al. 2015, ApJ, 809, 77, section 6; Ricker, G. R. et al. 2015, JATIS, 1,
    014003.

    Examples
    --------
    >>> from scope_models.experiments.tess import tess_noise
    >>> print(tess_noise([8.0, 12.0], [30, 10]).round())
    [ 87. 515.]
    """
    detector = Detector.tess()
    hours = checked_number("hours", hours, u.hour, positive=True)
    floor = checked_number("floor", floor, u.Unit(1e-6))
    flux = detector.flux_from_mag(plain_array(mag, "mag", "mag"))
    seconds = hours * 3600 * detector.exposure_time / (86400 * detector.cadence_days)
    sky = detector.background + detector.read_noise**2 / detector.int_time
    light = (flux + plain_array(pixels, u.one, "pixels") * sky) / (flux**2 * seconds)
    return np.sqrt(1e12 * light + floor**2 / hours)


@dataclass(frozen=True, kw_only=True)
class TESSNoise(Study):
    """Noise of TESS stars in an hour, raw and corrected, beside the mission's noise model.

    Each star moves as `Motion.tess <scope_models.Motion.tess>` over a sector, has the mission's
    cosmic rays with their rejection, and scattered light of which a part is left. Half of the
    stars have neighbors, drawn from a law of counts and placed anywhere on the stamp.

    Parameters
    ----------
    seed : int, optional
        Seed of all random numbers.
    magnitudes : tuple of float, optional
        Magnitudes T.
    neighbors : tuple of int, optional
        Numbers of neighbors within six magnitudes of the target on the stamp.
    stars : int, optional
        Stars per magnitude and number of neighbors.
    cadence : str, optional
        Cadence of TESS.
    cadences : int, optional
        Cadences per star; 1268 are a sector of 1800 s.
    residual : float, optional
        Part of the scattered light that is left in the flux.

    Raises
    ------
    TypeError, ValueError
        If a field is of the wrong type or outside its domain.

    Examples
    --------
    >>> from scope_models.experiments.tess import TESSNoise
    >>> study = TESSNoise(magnitudes=(10,), neighbors=(0,), stars=1)
    >>> [task["key"] for task in study.tasks()]
    ['t10-n0-0']
    """

    name: ClassVar[str] = "tess"
    units: ClassVar[dict] = noise_units()

    magnitudes: tuple[float, ...] = (8.0, 9.0, 10.0, 11.0, 12.0, 13.0, 14.0)
    neighbors: tuple[int, ...] = (0, 10)
    stars: int = 1
    cadence: str = "1800 s"
    cadences: int = 1268
    residual: float = 0.002

    def __post_init__(self):
        super().__post_init__()
        checked_integer("stars", self.stars, 1)
        checked_integer("cadences", self.cadences, 200)
        checked_number("residual", self.residual)
        for number in self.neighbors:
            checked_integer("neighbors", number, 0)
        Detector.tess(cadence=self.cadence)
        for name in ("magnitudes", "neighbors"):
            values = getattr(self, name)
            if not values or len(set(values)) < len(values):
                raise ValueError(f"`{name}` must be one or more different numbers, got {values}")

    def tasks(self):
        """Return one task per star.

        Returns
        -------
        list of dict
            Keys "key", "mag", "neighbors" and "index".
        """
        return [
            {"key": f"t{mag:g}-n{number}-{index}", "mag": mag, "neighbors": number, "index": index}
            for index in range(self.stars)
            for number in self.neighbors
            for mag in self.magnitudes
        ]

    def observation(self, task):
        """Return the pixels of a star.

        Parameters
        ----------
        task : dict
            One of `tasks`.

        Returns
        -------
        Observation
            The observation.
        """
        rng = self.star_rng(task["key"])
        detector = Detector.tess(cadence=self.cadence)
        middle = [(n - 1) / 2 for n in detector.shape[::-1]]
        place = middle + rng.uniform(-0.5, 0.5, 2)
        stars = [Star(task["mag"], *place)]
        while len(stars) <= task["neighbors"]:
            at = rng.uniform(0, np.array(detector.shape[::-1]) - 1)
            counts = 10 ** (_SLOPE * _SPAN) - 1
            fainter = np.log10(1 + rng.random() * counts) / _SLOPE
            if np.hypot(*(at - place)) > _CLEAR:
                stars.append(Star(task["mag"] + fainter, *at))
        seed = self.star_seed(task["key"], "motion") % 2**31
        motion = Motion.tess(self.cadences, cadence=self.cadence, seed=seed)
        effects = [
            replace(effect, residual=self.residual)
            if isinstance(effect, ScatteredLight)
            else effect
            for effect in mission_effects(detector)
        ]
        seed = self.star_seed(task["key"], "noise")
        with quiet():  # neighbors at the edges lose light
            return simulate(stars, detector, motion, seed=seed, effects=effects)

    def measure(self, task, observation):
        """Return the noise of a star in an hour.

        Parameters
        ----------
        task : dict
            One of `tasks`.
        observation : Observation
            Its pixels.

        Returns
        -------
        dict
            CDPP in ppm of the file's aperture, "aperture", of one that is a pixel wider, "wide",
            of the correctors, "pld" and "scene", over the part of transits that they leave,
            "pld_survival" and "scene_survival", and of the light alone, "floor" and "floor_wide";
            the same without a filter, "_full"; "pixels", "share" and "kept".
        """
        return corrected_noise(observation, _HOURS)

    def summarize(self, table):
        """Return medians beside the noise model, and check what was expected.

        Parameters
        ----------
        table : astropy.table.Table
            The results.

        Returns
        -------
        astropy.table.Table
            One row per number of neighbors and magnitude: medians, and "model", the noise model
            with as many pixels. In ``meta`` "claims" and "claims_checked": verdicts, and the
            number that decides.
        """
        columns = ("pixels", "share", *SURVIVALS, *self.units)
        summary = Table(medians_of(table, ("neighbors", "mag"), columns))
        summary["model"] = tess_noise(np.array(summary["mag"]), np.array(summary["pixels"]))
        for name in (*self.units, "model"):
            summary[name].unit = "ppm"
        alone = summary[summary["neighbors"] == 0]
        crowded = summary[summary["neighbors"] > 0]
        best = np.fmin(np.array(alone["pld"]), np.array(alone["scene"]))
        bright, faint = alone[alone["mag"] <= 9], alone[alone["mag"] >= 13]
        claims = {
            "apertures of stars without neighbors are below the noise model with its 60 ppm": (
                np.array(alone["aperture"] / alone["model"])
            ),
            "the better corrector is within 30 % of the noise of the light without neighbors": (
                best / np.array(alone["floor"]) / 1.3
            ),
            "with neighbors the scene model is at most 10 % noisier than PLD": (
                np.array(crowded["scene"] / crowded["pld"]) / 1.1
            ),
            "to T 9 a wider aperture is less noisy without a filter": (
                np.array(bright["wide_full"] / bright["aperture_full"])
            ),
            "from T 13 on a wider aperture is noisier": (
                np.array(faint["aperture"] / faint["wide"])
            ),
        }
        summary.meta["claims"], summary.meta["claims_checked"] = checked_claims(claims)
        return summary

    def draw(self, table, summary):
        """Draw noise against magnitude, with and without neighbors.

        Parameters
        ----------
        table : astropy.table.Table
            The results.
        summary : astropy.table.Table
            The summary of them.

        Returns
        -------
        matplotlib.figure.Figure
            The figure.
        """
        from scope_models.plotting import plot_cdpp_panels  # imports matplotlib

        panels = {}
        for number in self.neighbors:
            part = summary[summary["neighbors"] == number]
            mag = np.array(part["mag"])
            series = {"Light alone": (mag, np.array(part["floor"]))}
            series |= {label: (mag, np.array(part[name])) for name, label in METHODS.items()}
            panels[f"{number} neighbors"] = series
        first = summary[summary["neighbors"] == self.neighbors[0]]
        model = {
            "mag": np.array(first["mag"]), "median": np.array(first["model"]),
            "label": "Noise model, 60 ppm",
        }  # fmt: skip
        axes = plot_cdpp_panels(panels, model)
        for ax in axes.values():
            ax.set(xlabel="Magnitude (T)", ylabel="1-h CDPP (ppm)")
        return next(iter(axes.values())).figure
