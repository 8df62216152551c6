"""Transits that are put in, and what is found of them after de-trending."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from astropy.table import Table

from scope_models.experiments._correctors import transit_amplitude
from scope_models.experiments._search import (
    fit_shape,
    flattened,
    isolated,
    search_light_curve,
)
from scope_models.experiments._statistics import cells, on_grid, percentiles, values_of
from scope_models.experiments.populations import cached_motion, draw_star, stamp_around
from scope_models.experiments.study import Study, parameter
from scope_models.models import TransitModel
from scope_models.scene.detector import Detector
from scope_models.simulation import simulate

__all__ = ["Recovery"]

# The mask of a transit that a search has found, in its durations on either side of the middle.
_MASK_WIDTHS = 0.75


@dataclass(frozen=True, kw_only=True)
class Recovery(Study):
    """Injection and recovery of transits, over depth, magnitude and motion.

    Each star is drawn as `~scope_models.experiments.populations.draw_star` does, with a planet
    on an orbit of its own, simulated on the paper's detector, and de-trended by
    `~scope_models.correctors.PLDCorrector`, without a mask of the transits. A search by box
    least squares follows, without cadences that stand out from both neighbors. The planet is
    recovered if the strongest box is at least `threshold` times its error deep, and all boxes are
    within half a transit of true ones. Then what was found is masked, the star is de-trended
    again, and a transit is fitted.

    References
    ----------
    Kovacs, G., Zucker, S. & Mazeh, T. 2002, A&A, 391, 369: box least squares. Jenkins, J. M.,
    Caldwell, D. A. & Borucki, W. J. 2002, ApJ, 564, 495: the threshold.

    Examples
    --------
    >>> from scope_models.experiments.recovery import Recovery
    >>> study = Recovery(magnitudes=(12,), depths=(0, 1000), scales=(1,), stars=1)
    >>> [task["key"] for task in study.tasks()]
    ['kp12-x1-d0-0', 'kp12-x1-d1000-0']
    >>> bool(study.run_star(study.tasks()[1])["recovered"])
    True
    """

    name: ClassVar[str] = "recovery"
    units: ClassVar[dict] = {
        **dict.fromkeys(("period", "duration", "found_period", "found_duration"), "d"),
        "found_duration_error": "d",
        **dict.fromkeys(("depth", "found_depth", "found_depth_error"), "ppm"),
        **dict.fromkeys(("joint_depth", "joint_depth_error", "white_noise"), "ppm"),
    }

    grid: ClassVar[dict] = {
        "index": "stars", "scale": "scales", "depth": "depths", "mag": "magnitudes",
    }  # fmt: skip
    key: ClassVar[str] = "kp{mag:g}-x{scale:g}-d{depth:g}-{index}"

    magnitudes: tuple[float, ...] = parameter(
        (11.0, 12.0, 13.0, 14.0, 15.0), "Magnitudes Kp.", different="numbers"
    )
    depths: tuple[float, ...] = parameter(
        (0.0, 50.0, 100.0, 200.0, 400.0, 800.0),
        "Depths at mid-transit in ppm. 0 is a star without planet, and counts false alarms.",
        different="numbers",
    )
    scales: tuple[float, ...] = parameter(
        (1.0, 5.0), "Multiples of the motion.", different="numbers", positive=True
    )
    stars: int = parameter(2, "Stars per magnitude, depth and multiple.", least=1)
    cadences: int = parameter(1000, "Cadences per star.", least=100)
    motion: str = parameter(
        "k2_roll", "Motion, as `~scope_models.experiments.populations.motion_from_name` takes it."
    )
    order: int = parameter(2, "Order of PLD.", least=1)
    periods: tuple[float, ...] = parameter(
        (2.0, 6.0),
        "Shortest and longest period in days; their logarithms are distributed uniformly.",
    )
    durations: tuple[float, ...] = parameter(
        (0.1, 0.25), "Shortest and longest duration in days, distributed uniformly."
    )
    threshold: float = parameter(
        7.1,
        "Signal-to-noise ratio of a detection. The default is that of Kepler's pipeline.",
        positive=True,
    )

    def __post_init__(self):
        super().__post_init__()
        for depth in self.depths:
            if not 0 <= depth < 1e6:
                raise ValueError(f"`depths` must be at least 0 and below 1e6 ppm, got {depth}")
        if max(self.depths) == 0:
            raise ValueError("`depths` must hold one above 0")
        for name in ("periods", "durations"):
            values = getattr(self, name)
            if len(values) != 2 or not 0 < values[0] <= values[1]:
                raise ValueError(f"`{name}` must be the smallest and the largest, got {values}")
        if self.durations[1] > 0.25 * self.periods[0]:
            raise ValueError(
                f"`durations` must be at most a quarter of the shortest period, "
                f"{self.periods[0]:g} d, got {self.durations[1]:g} d"
            )

    def observation(self, task):
        """Return the pixels of a star with its planet."""
        motion = task["scale"] * cached_motion(self.motion, self.cadences)
        shape, x_0, y_0 = stamp_around(motion)
        detector = Detector.k2(shape=shape)
        signal = None
        if task["depth"]:
            signal = self._planet(task, motion.time, detector.cadence_days)[0]
        star = draw_star(
            self.star_rng(task["key"]), task["mag"], detector, x_0=x_0, y_0=y_0, signal=signal
        )
        return simulate(star, detector, motion, seed=self.star_seed(task["key"], "noise"))

    def _planet(self, task, time, exposure_time):
        """Return the transits of a star, and their duration; two of them at least are there."""
        rng = self.star_rng(task["key"], "planet")
        period = float(np.exp(rng.uniform(*np.log(self.periods))))
        duration = float(rng.uniform(*self.durations))
        t0 = time[0] + rng.uniform(0.5 * duration, period)
        if t0 + period > time[-1]:
            raise ValueError(
                f"`periods` must be at most half the time span of {np.ptp(time):.1f} d, so that "
                f"two transits are seen, got {self.periods[1]:g} d"
            )
        model = TransitModel.from_depth_duration(
            1e-6 * task["depth"], duration, period, t0, exposure_time=exposure_time
        )
        return model, duration

    def measure(self, task, observation):
        """Return what is found of the planet of a star.

        "white_noise", the least that a cadence can have (ppm), with the true image known; "snr",
        "sde", "found_period" of the strongest box; "detected", whether it is above the threshold,
        and "recovered", whether it is the planet too. Of a planet its "period" and "duration";
        "expected_snr", that of its transits in this noise; "survival", the part of its depth that
        the first de-trending leaves; and "joint_depth" with its error, fitted together with the
        systematics by the true shape. Of a recovered one "found_depth" and "found_duration" with
        their errors, by the shape that was found.
        """
        from scope_models.correctors import PLDCorrector  # imports lightkurve

        corrector = PLDCorrector(observation.to_tpf())
        lc = corrector.correct(order=self.order)
        time, flux, found = search_light_curve(lc, *self.durations)
        # If each pixel has the weight of its light.
        weighted = np.square(observation.model() / observation.flux_err).sum(axis=(1, 2))
        row = {
            "white_noise": 1e6 * float(np.median(1 / np.sqrt(weighted))),
            "snr": found.snr,
            "sde": found.sde,
            "found_period": found.period,
            "detected": found.snr >= self.threshold,
            "recovered": False,
        }
        if not task["depth"]:
            return row
        exposure = observation.detector.cadence_days
        planet, duration = self._planet(task, observation.time, exposure)
        drop = 1e6 * (1 - planet(time))
        matches = found.matches(planet.period.value, planet.t0.value, duration, np.ptp(time))
        row |= {
            "period": planet.period.value,
            "duration": duration,
            "expected_snr": np.sqrt(np.sum(drop**2)) / row["white_noise"],
            "survival": transit_amplitude(flux, planet(time)),
            "recovered": row["detected"] and matches,
        }
        if row["recovered"]:
            row |= self._shape(corrector, found, exposure)
        corrector.correct(order=self.order, transit_model=planet)
        result = corrector.result
        row["joint_depth"] = task["depth"] * result.transit_scale
        row["joint_depth_error"] = task["depth"] * result.transit_scale_err
        return row

    def _shape(self, corrector, found, exposure_time):
        """Return depth and duration of what was found, masked in a second de-trending."""
        mask = found.in_transit(corrector.original_lc.time.value, _MASK_WIDTHS)
        lc = corrector.correct(order=self.order, transit_mask=mask)
        good = np.isfinite(lc.flux.value)
        time, flux = lc.time.value[good], lc.flux.value[good]
        flux = flattened(time, flux, mask[good])
        error = 1.4826 * np.median(np.abs(flux[~mask[good]] - 1))
        keep = ~isolated(flux)
        model, *duration = fit_shape(time[keep], flux[keep], error, found, exposure_time)
        scale, scale_error = corrector.fit_transit(model)
        depth = 1e6 * model.depth
        return {
            "found_depth": depth * scale,
            "found_depth_error": depth * scale_error,
            "found_duration": duration[0],
            "found_duration_error": duration[1],
        }

    def summarize(self, table):
        """Return completeness and errors per motion, magnitude and depth.

        One row per motion, magnitude and depth: the number of stars, "completeness", the fraction
        that is recovered, and "expected", the fraction whose transits would be above the threshold
        in the least white noise; medians of both signal-to-noise ratios and of the survival; the
        median of found over true depth and duration of those that are recovered, with half the
        range from the 16th to the 84th percentile; and, of all, the median of the jointly fitted
        over the true depth, and of its error in units of its standard deviation.

        In ``meta``: "false_alarms", how many stars without planet have a detection;
        "half_complete", the depth (ppm) of 50 % completeness by motion and magnitude; and
        "by_motion", the statistics of all planets of a motion.
        """
        names = ("scale", "mag", "depth")
        found = list(cells(table, names))
        rows = [cell | self._cell(part) for cell, part in found if cell["depth"] > 0]
        empty = [part["detected"] for cell, part in found if cell["depth"] == 0]
        summary = Table(rows, names=None if rows else names)
        summary["depth"].unit = "ppm"
        alarms, stars = (sum(count(part) for part in empty) for count in (np.sum, len))
        summary.meta["false_alarms"] = f"{alarms} of {stars} stars without planet"
        summary.meta["half_complete"] = {
            f"{scale:g}x": {
                f"Kp {mag:g}": _half_complete(part["depth"], part["completeness"])
                for mag in sorted(set(table["mag"]))
                for part in [summary[(summary["scale"] == scale) & (summary["mag"] == mag)]]
            }
            for scale in sorted(set(table["scale"]))
        }
        summary.meta["by_motion"] = {
            f"{scale:g}x": _by_motion(
                table[(table["scale"] == scale) & (table["depth"] > 0)], self.threshold
            )
            for scale in sorted(set(table["scale"]))
        }
        return summary

    def _cell(self, rows):
        """Return the statistics of the stars of a cell."""
        recovered = np.array(rows["recovered"])
        row = {
            "stars": len(rows),
            "completeness": recovered.mean(),
            "expected": np.mean(values_of(rows, "expected_snr") >= self.threshold),
        }
        for name in ("snr", "expected_snr", "survival"):
            row[name] = np.median(values_of(rows, name))
        for name in ("depth", "duration"):
            ratio = (values_of(rows, f"found_{name}") / values_of(rows, name))[recovered]
            low, median, high = percentiles(ratio)
            row[f"{name}_ratio"] = median
            row[f"{name}_ratio_scatter"] = 0.5 * (high - low)
        depth, joint, error = (
            values_of(rows, name) for name in ("depth", "joint_depth", "joint_depth_error")
        )
        row["joint_ratio"] = np.median(joint / depth)
        row["joint_pull"] = np.median((joint - depth) / error)
        return row

    def draw(self, table, summary):
        """Draw maps of completeness and of found over true depth: a column of panels per motion."""
        from scope_models.plotting.recovery import plot_recovery  # imports matplotlib

        mags = sorted({float(mag) for mag in self.magnitudes})
        depths = sorted({float(depth) for depth in self.depths if depth > 0})
        panels = {}
        for scale in sorted(self.scales):
            part = summary[summary["scale"] == scale]
            axes = ("depth", depths), ("mag", mags)
            panels[f"{scale:g}x motion"] = np.array(
                [on_grid(part, *axes, name) for name in ("completeness", "depth_ratio")]
            )
        return plot_recovery(panels, depths, mags)


def _half_complete(depths, completeness):
    """Return the depth at which the completeness last rises above one half, in its logarithm.

    0 if it is above everywhere, infinite if it is below at the largest depth.
    """
    below = np.flatnonzero(np.asarray(completeness) < 0.5)
    if len(below) == 0:
        return 0.0
    last = int(below[-1])
    if last == len(depths) - 1:
        return float("inf")
    logarithms = np.log(depths[last : last + 2])
    ends = completeness[last : last + 2]
    return float(np.round(np.exp(np.interp(0.5, ends, logarithms)), 1))


def _by_motion(rows, threshold):
    """Return the statistics of all planets at one multiple of the motion.

    Numbers of planets: "planets", "recovered", "expected" (above the threshold in the least noise)
    and "false" (the strongest box is above the threshold and not the planet); weighted means of
    found over true values with their errors, of depth and duration of those recovered and of the
    jointly fitted depth of all; the standard deviations of their pulls; and the medians of the
    survival and of the found over the expected ratio, of planets above twice the threshold.
    """
    recovered, detected = (np.array(rows[name]) for name in ("recovered", "detected"))
    expected = values_of(rows, "expected_snr")
    clear = expected > 2 * threshold
    numbers = {
        "planets": len(rows),
        "recovered": int(recovered.sum()),
        "expected": int(np.sum(expected >= threshold)),
        "false": int(np.sum(detected & ~recovered)),
        "survival": _median(values_of(rows, "survival")[clear]),
        "snr_ratio": _median((values_of(rows, "snr") / expected)[clear]),
    }
    for found, true, use in (
        ("found_depth", "depth", recovered),
        ("joint_depth", "depth", np.ones(len(rows), dtype=bool)),
        ("found_duration", "duration", recovered),
    ):
        value, error, truth = (
            values_of(rows, name)[use] for name in (found, f"{found}_error", true)
        )
        if not len(value):
            continue
        weights = (truth / error) ** 2
        numbers[f"{found}_ratio"] = float(np.round(np.average(value / truth, weights=weights), 4))
        numbers[f"{found}_ratio_error"] = float(np.round(weights.sum() ** -0.5, 4))
        numbers[f"{found}_pulls"] = float(np.round(np.std((value - truth) / error), 2))
    return numbers


def _median(values):
    """Return the median, or NaN without values."""
    return float(np.round(np.median(values), 3)) if len(values) else float("nan")
