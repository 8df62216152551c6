"""Noise of TESS stars against magnitude, alone and with neighbors, beside TESS's noise model."""

from dataclasses import dataclass, replace
from typing import ClassVar

import astropy.units as u
import numpy as np

from scope_models._arrays import plain_array
from scope_models._checks import checked_number
from scope_models.effects import ScatteredLight, mission_effects
from scope_models.experiments._corrected import SURVIVALS, CorrectedStudy, curves
from scope_models.experiments._correctors import quiet
from scope_models.experiments.study import parameter
from scope_models.scene import Detector, Motion, Star
from scope_models.simulation import simulate

__all__ = ["TESSNoise", "tess_noise"]

_SPAN, _SLOPE = 6.0, 0.3  # magnitudes of neighbors below the target, and slope of log counts
_CLEAR = 1.0  # px between the target and a neighbor, at least


def tess_noise(mag, pixels, hours=1.0, *, floor=60.0):
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
class TESSNoise(CorrectedStudy):
    """Noise of TESS stars in an hour, raw and corrected, beside the mission's noise model.

    Each star moves as `Motion.tess <scope_models.Motion.tess>` over a sector, has the mission's
    cosmic rays with their rejection, and scattered light of which a part is left. Half of the
    stars have neighbors, drawn from a law of counts and placed anywhere on the stamp.

    Examples
    --------
    >>> from scope_models.experiments.tess import TESSNoise
    >>> study = TESSNoise(magnitudes=(10,), neighbors=(0,), stars=1)
    >>> [task["key"] for task in study.tasks()]
    ['t10-n0-0']
    """

    name: ClassVar[str] = "tess"
    grid: ClassVar[dict] = {"index": "stars", "neighbors": "neighbors", "mag": "magnitudes"}
    key: ClassVar[str] = "t{mag:g}-n{neighbors}-{index}"
    hours: ClassVar[float] = 1.0
    cell: ClassVar[tuple] = ("neighbors", "mag")
    columns: ClassVar[tuple] = ("pixels", "share", *SURVIVALS)

    magnitudes: tuple[float, ...] = parameter(
        (8.0, 9.0, 10.0, 11.0, 12.0, 13.0, 14.0), "Magnitudes T.", different="numbers"
    )
    neighbors: tuple[int, ...] = parameter(
        (0, 10),
        "Numbers of neighbors within six magnitudes of the target on the stamp.",
        different="numbers",
        least=0,
    )
    stars: int = parameter(1, "Stars per magnitude and number of neighbors.", least=1)
    cadence: str = parameter("1800 s", "Cadence of TESS.")
    cadences: int = parameter(1268, "Cadences per star; 1268 are a sector of 1800 s.", least=200)
    residual: float = parameter(
        0.002, "Part of the scattered light that is left in the flux.", positive=False
    )

    def __post_init__(self):
        super().__post_init__()
        Detector.tess(cadence=self.cadence)

    def observation(self, task):
        """Return the pixels of a star and its neighbors."""
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

    def compare(self, table, summary):
        """Add "model", the noise model with as many pixels."""
        summary["model"] = tess_noise(np.array(summary["mag"]), np.array(summary["pixels"]))
        summary["model"].unit = "ppm"

    def claims(self, summary):
        """Return the ratio of each claim to its limit."""
        alone = summary[summary["neighbors"] == 0]
        crowded = summary[summary["neighbors"] > 0]
        bright, faint = alone[alone["mag"] <= 9], alone[alone["mag"] >= 13]
        best = np.fmin(np.array(alone["pld"]), np.array(alone["scene"]))
        return {
            "apertures of stars without neighbors are below the noise model with its 60 ppm": (
                alone["aperture"] / alone["model"]
            ),
            "the better corrector is within 30 % of the noise of the light without neighbors": (
                best / np.array(alone["floor"]) / 1.3
            ),
            "with neighbors the scene model is at most 10 % noisier than PLD": (
                crowded["scene"] / crowded["pld"] / 1.1
            ),
            "to T 9 a wider aperture is less noisy without a filter": (
                bright["wide_full"] / bright["aperture_full"]
            ),
            "from T 13 on a wider aperture is noisier": faint["aperture"] / faint["wide"],
        }

    def draw(self, table, summary):
        """Draw noise against magnitude, with and without neighbors."""
        from scope_models.plotting import plot_cdpp_panels  # imports matplotlib

        parts = {number: summary[summary["neighbors"] == number] for number in self.neighbors}
        panels = {f"{number} neighbors": curves(part) for number, part in parts.items()}
        first = parts[self.neighbors[0]]
        model = {name: np.array(first[key]) for name, key in (("mag", "mag"), ("median", "model"))}
        axes = plot_cdpp_panels(panels, model | {"label": "Noise model, 60 ppm"})
        for ax in axes.values():
            ax.set(xlabel="Magnitude (T)", ylabel="1-h CDPP (ppm)")
        return next(iter(axes.values())).figure
