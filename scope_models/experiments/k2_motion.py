"""Benchmark 2 of the paper: stars that move as in K2, against the raw noise of campaign 3."""

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
from astropy.table import Table

from scope_models.experiments._statistics import compared, holds
from scope_models.experiments.no_motion import noise_parts
from scope_models.experiments.populations import draw_star, motion_from_name, stamp_around
from scope_models.experiments.reference import PERCENTILES, read_reference
from scope_models.experiments.study import Study, parameter
from scope_models.photometry import cdpp
from scope_models.scene.detector import Detector
from scope_models.simulation import simulate

__all__ = ["DETECTORS", "K2MotionNoise", "field_motion"]

#: Presets of the detector that the study compares.
DETECTORS = {"paper": Detector.k2, "calibrated": Detector.k2_calibrated}
# Largest distance from the boresight in degrees, 6278 px (arXiv:1512.06162).
_EDGE = 6.94
# Cadences of campaign 3, and what is generated at most.
_CAMPAIGN = 3380
_MARGIN = 7
_TOLERANCE = 0.15
_CLAIMED = (11.0, 14.5)
_GOLDEN = 0.6180339887498949
_LAW_MAGNITUDE = 14.0
_PARTS = ("cdpp_lightkurve", "white", "losses", "intrapixel", "systematics", "n_pixels")


def field_motion(number, cadences, *, place=None, rng=None):
    """Return the motion of a star somewhere in the field of view, at some time of a campaign.

    Parameters
    ----------
    number : int
        Seed of the motion.
    cadences : int
        Cadences without thruster firings, at most 3380.
    place : float, optional
        Part of the field, between 0 and 1, that is nearer to the boresight than the star. By
        default it is drawn.
    rng : numpy.random.Generator, optional
        Source of the direction and of the time within the campaign.

    Returns
    -------
    Motion
        The motion, about its median.

    Examples
    --------
    >>> from scope_models.experiments.k2_motion import field_motion
    >>> motion = field_motion(3, 500, place=0.5)
    >>> len(motion), round(float(abs(motion.x).max()), 1)
    (500, 0.2)
    """
    rng = np.random.default_rng(number) if rng is None else rng
    place = rng.uniform() if place is None else place
    distance, angle = _EDGE * np.sqrt(place), rng.uniform(0, 360)
    start = int(rng.integers(max(_CAMPAIGN - cadences, 0) + 1))
    name = f"k2_roll:seed={number},distance={distance:.4f},angle={angle:.2f}"
    motion = motion_from_name(name, _CAMPAIGN)[start : start + cadences]
    return _about_median(motion)


def _about_median(motion):
    """Return a motion about its median."""
    x, y = motion.x - np.median(motion.x), motion.y - np.median(motion.y)
    return type(motion).from_arrays(motion.time, x, y, time_format=motion.time_format)


@dataclass(frozen=True, kw_only=True)
class K2MotionNoise(Study):
    """Noise before de-trending of stars that move as in K2 (benchmark 2 of the paper).

    The paper's sensitivity and the calibrated one, `~scope_models.Detector.k2_calibrated`, beside
    the noise of K2 campaign 3. EVEREST's apertures follow the PRF; here the aperture holds the
    pixels in which the star alone has more than a threshold on average,
    :math:`T (F / F_{14})^g` for a flux F and :math:`F_{14}` at Kp 14. Stars with a pixel above 90 %
    of its well have a larger aperture, as EVEREST's.

    References
    ----------
    Saunders, N. et al. 2019, "The Pointing Limits of Transiting Exoplanet Light Curve
    Characterization with Pixel Level De-correlation", section 3; Luger, R. et al. 2018, AJ, 156, 99
    (EVEREST 2).

    Examples
    --------
    >>> from scope_models.experiments.k2_motion import K2MotionNoise
    >>> study = K2MotionNoise(magnitudes=(12,), stars=1, cadences=300)
    >>> row = study.run_star(study.tasks()[0])
    >>> row["cdpp"] > row["white"] > 15
    True
    """

    name: ClassVar[str] = "k2-motion"
    units: ClassVar[dict] = dict.fromkeys(
        ("cdpp", "cdpp_lightkurve", "white", "losses", "intrapixel", "systematics"), "ppm"
    )

    magnitudes: tuple[float, ...] = parameter(
        tuple(11 + 0.5 * k for k in range(9)), "Magnitudes Kp.", different="values"
    )
    detectors: tuple[str, ...] = parameter(
        ("paper", "calibrated"), "Out of `DETECTORS`.", different="values", among=DETECTORS
    )
    motions: tuple[str, ...] = parameter(
        ("field",),
        '``"field"``, a generated motion of each star\'s own, evenly spread over the field of view '
        "and over the time of a campaign, or motions as "
        "`~scope_models.experiments.populations.motion_from_name` takes them.",
        different="values",
    )
    stars: int = parameter(
        60,
        "Stars per magnitude, motion and detector. The paper has 5. The same stars, but for their "
        "magnitude, are in all bins.",
        least=1,
    )
    cadences: int = parameter(
        1000,
        "Long cadences per star, at a random time of the campaign, or all of a motion if it has "
        "fewer. A campaign has 3380.",
        least=100,
    )
    shift: float = parameter(
        0.5,
        "Largest distance of a star from the middle of a pixel along each axis. The paper has 0.2; "
        "real stars are anywhere.",
        positive=False,
    )
    threshold: float = parameter(
        140.0,
        "T in e-/s. Fitted. 0 takes the aperture of the highest signal-to-noise ratio.",
        positive=False,
    )
    exponent: float = parameter(0.5, "The exponent g. Fitted.", positive=False)
    saturated_part: float = parameter(
        1e-4,
        "Part of the flux of a saturated star that a pixel of its aperture has.",
        positive=False,
    )

    def tasks(self):
        """Return one task per star."""
        return [
            {
                "key": f"{detector}-motion{number}-kp{mag:g}-{index}",
                "detector": detector, "motion": motion, "mag": mag, "index": index,
                "star": f"motion{number}-{index}",
            }
            for detector in self.detectors
            for number, motion in enumerate(self.motions)
            for mag in self.magnitudes
            for index in range(self.stars)
        ]  # fmt: skip

    def observation(self, task):
        """Return the pixels of a star; both detectors see the same star and motion."""
        rng = self.star_rng(task["star"])
        if task["motion"] == "field":
            shift = self.star_rng("field", "shift").uniform()
            place = (shift + task["index"] * _GOLDEN) % 1.0
            number = self.star_seed(task["star"], "motion") % 2**31
            motion = field_motion(number, self.cadences, place=place, rng=rng)
        else:
            motion = _about_median(motion_from_name(task["motion"]))[: self.cadences]
        shape, x_0, y_0 = stamp_around(motion, _MARGIN)
        detector = DETECTORS[task["detector"]](shape=shape)
        star = draw_star(rng, task["mag"], detector, x_0=x_0, y_0=y_0, shift=self.shift)
        return simulate(star, detector, motion, seed=self.star_seed(task["star"], "pixels"))

    def measure(self, task, observation):
        """Return the noise of a star, and what contributes to it.

        CDPP in both conventions; in EVEREST's convention and without noise, that by light moving
        out of the aperture alone (``losses``), with the response within pixels (``intrapixel``),
        and with that between pixels (``systematics``); ``white``, the nominal noise of photons,
        background and reads; and what the aperture is.
        """
        detector, scene = observation.detector, observation.scene
        even = detector.replace(interpixel=np.ones(detector.shape))
        flat, intrapixel, systematics = (
            simulate(scene.replace(detector=pixels), noise=False).flux
            for pixels in (detector.without_sensitivity(), even, detector)
        )
        saturated = bool(np.percentile(flat, 97.5, axis=0).max() > detector.full_flux)
        aperture = self.aperture(observation, flat.mean(axis=0), saturated=saturated)
        cubes = {"losses": flat, "intrapixel": intrapixel, "systematics": systematics}
        flux = observation.flux[:, aperture].sum(axis=1, dtype=float)
        row = {"cdpp": cdpp(flux, method="everest"), "cdpp_lightkurve": cdpp(flux)}
        parts = noise_parts(observation, aperture)
        row["white"] = float(np.sqrt(sum(value**2 for value in parts.values())))
        for name, cube in cubes.items():
            row[name] = cdpp(cube[:, aperture].sum(axis=1, dtype=float), method="everest")
        row |= {"n_pixels": int(aperture.sum()), "saturated": saturated}
        statistics = observation.motion.statistics()
        return row | {"distance": float(statistics.mean.value)}

    def aperture(self, observation, image, *, saturated=False):
        """Return the pixels of the light curve.

        Parameters
        ----------
        observation : Observation
            The star.
        image : ndarray, shape (ny, nx)
            Mean image of the star on pixels that respond alike, e-/s.
        saturated : bool, optional
            Whether pixels are saturated.

        Returns
        -------
        ndarray of bool, shape (ny, nx)
            The pixels.
        """
        if self.threshold == 0:
            return observation.aperture
        flux = observation.truth.flux[0]
        threshold = self.saturated_part * flux
        if not saturated:
            relative = flux / observation.detector.flux_from_mag(_LAW_MAGNITUDE)
            threshold = self.threshold * relative**self.exponent
        return image > min(threshold, 0.5 * image.max())

    def summarize(self, table):
        """Return our noise beside that of campaign 3.

        Per detector, motion and magnitude: percentiles of the noise with errors by resampling,
        campaign 3's (saturated stars included, as they are in ours), the ratios, and medians of
        the contributions. ``meta`` has what was fitted and what holds.
        """
        reference = read_reference("k2_c03_raw", "all")
        rows = []
        for detector in self.detectors:
            for motion in self.motions:
                for mag in self.magnitudes:
                    chosen = (table["detector"] == detector) & (table["motion"] == motion)
                    stars = table[chosen & (np.asarray(table["mag"]) == mag)]
                    if not len(stars):
                        continue
                    row = {"detector": detector, "motion": Path(motion).name, "mag": mag}
                    row["stars"] = len(stars)
                    row |= compared("noise", stars["cdpp"], reference, mag, PERCENTILES, known="k2")
                    row |= {name: float(np.median(stars[name])) for name in _PARTS}
                    row["saturated"] = float(np.mean(stars["saturated"]))
                    rows.append(row)
        summary = Table(rows=rows)
        summary.meta["fitted"] = {
            "calibrated": "Detector.k2_calibrated", "threshold": self.threshold,
            "exponent": self.exponent,
        }  # fmt: skip
        mags = np.asarray(summary["mag"], dtype=float)
        bins = (summary["motion"] == "field") & (mags >= _CLAIMED[0]) & (mags <= _CLAIMED[1])
        summary.meta["claims"] = {
            f"{name} sensitivity: median within {100 * _TOLERANCE:.0f} % of K2 campaign 3 in every "
            f"bin, Kp {_CLAIMED[0]:g} to {_CLAIMED[1]:g}": holds(ratios, _TOLERANCE)
            for name in self.detectors
            if len(ratios := summary["noise_median_ratio"][bins & (summary["detector"] == name)])
        }
        return summary

    def draw(self, table, summary):
        """Draw our noise over that of campaign 3, and what contributes to it."""
        from scope_models.plotting.calibration import plot_k2_motion  # imports matplotlib

        motion = summary["motion"][0]
        series = {
            name: summary[(summary["detector"] == name) & (summary["motion"] == motion)]
            for name in self.detectors
        }
        return plot_k2_motion(series, read_reference("k2_c03_raw", "all"))
