"""Injection and recovery of transits, over depth, magnitude and motion.

    python studies/paper/recovery.py --workers 4

Each star is drawn as the paper does, with a planet on an orbit of its own, simulated on the paper's
detector, and de-trended by PLDCorrector without a mask of the transits. A search by box least
squares follows (Kovacs, G., Zucker, S. & Mazeh, T. 2002, A&A, 391, 369), without cadences that
stand out from both neighbors. The planet is recovered if the strongest box is at least 7.1 times
its error deep, Kepler's threshold, and all boxes are within half a transit of true ones. Then what
was found is masked, the star is de-trended again, and a transit is fitted.
"""

from dataclasses import dataclass
from functools import partial

import matplotlib.pyplot as plt
import numpy as np
from _correctors import transit_amplitude
from _figures import plot_map
from _search import fit_shape, flattened, isolated, search_light_curve
from _stars import cached_motion, draw_star, stamp_around
from _study import cells, grid, on_grid, percentiles, run
from astropy.stats import mad_std
from astropy.table import Table

from scope_models import Detector, TransitModel, simulate
from scope_models._arrays import values_of
from scope_models.batch import star_rng, star_seed
from scope_models.plotting._style import styled

NAME = "recovery"
UNITS = dict.fromkeys(
    ("period", "duration", "found_period", "found_duration", "found_duration_error"), "d"
) | dict.fromkeys(
    ("depth", "found_depth", "found_depth_error", "joint_depth", "joint_depth_error",
     "white_noise"), "ppm",
)  # fmt: skip
MASK_WIDTHS = 0.75  # of a found transit, in its durations on either side of the middle


@dataclass(frozen=True, kw_only=True)
class Recovery:
    """The parameters."""

    seed: int = 1
    magnitudes: tuple[float, ...] = (11.0, 12.0, 13.0, 14.0, 15.0)  # Kp
    # ppm at mid-transit; 0 is a star without planet, and counts false alarms
    depths: tuple[float, ...] = (0.0, 50.0, 100.0, 200.0, 400.0, 800.0)
    scales: tuple[float, ...] = (1.0, 5.0)  # multiples of the motion
    stars: int = 2  # per magnitude, depth and multiple
    cadences: int = 1000
    motion: str = "k2_roll"  # see `motion_from_name`
    order: int = 2  # of PLD
    periods: tuple[float, ...] = (2.0, 6.0)  # days, of which the logarithms are uniform
    durations: tuple[float, ...] = (0.1, 0.25)  # days
    threshold: float = 7.1  # signal-to-noise ratio of a detection


def tasks(study):
    """Return one task per star."""
    return grid(
        "kp{mag:g}-x{scale:g}-d{depth:g}-{index}", index=study.stars, scale=study.scales,
        depth=study.depths, mag=study.magnitudes,
    )  # fmt: skip


def make_planet(study, task, time, exposure_time):
    """Return the transits of a star, and their duration; two of them at least are there."""
    rng = star_rng(study.seed, task["key"], "planet")
    period = float(np.exp(rng.uniform(*np.log(study.periods))))
    duration = float(rng.uniform(*study.durations))
    t0 = time[0] + rng.uniform(0.5 * duration, period)
    if t0 + period > time[-1]:
        raise ValueError(
            f"`periods` must be at most half the time span of {np.ptp(time):.1f} d, so that two "
            f"transits are seen, got {study.periods[1]:g} d"
        )
    model = TransitModel.from_depth_duration(
        1e-6 * task["depth"], duration, period, t0, exposure_time=exposure_time
    )
    return model, duration


def observe(study, task):
    """Return the pixels of a star with its planet."""
    motion = task["scale"] * cached_motion(study.motion, study.cadences)
    shape, x_0, y_0 = stamp_around(motion)
    detector = Detector.k2(shape=shape)
    signal = None
    if task["depth"]:
        signal = make_planet(study, task, motion.time, detector.cadence_days)[0]
    rng = star_rng(study.seed, task["key"])
    star = draw_star(rng, task["mag"], detector, x_0=x_0, y_0=y_0, signal=signal)
    return simulate(star, detector, motion, seed=star_seed(study.seed, task["key"], "noise"))


def measure(study, task):
    """Return what is found of the planet of a star.

    "white_noise", the least that a cadence can have (ppm), with the true image known; "snr" and
    "found_period" of the strongest box; "detected", whether it is above the threshold, and
    "recovered", whether it is the planet too. Of a planet its "period" and "duration";
    "expected_snr", that of its transits in this noise; "survival", the part of its depth that the
    first de-trending leaves; and "joint_depth", fitted together with the systematics by the true
    shape. Of a recovered one "found_depth" and "found_duration", by the shape that was found.
    """
    from scope_models import PLDCorrector  # imports lightkurve

    observation = observe(study, task)
    corrector = PLDCorrector(observation.to_tpf())
    lc = corrector.correct(order=study.order)
    time, flux, found = search_light_curve(lc, *study.durations)
    # If each pixel has the weight of its light.
    weighted = np.square(observation.model() / observation.flux_err).sum(axis=(1, 2))
    row = {
        "white_noise": 1e6 * float(np.median(1 / np.sqrt(weighted))),
        "snr": found.snr, "found_period": found.period,
        "detected": found.snr >= study.threshold, "recovered": False,
    }  # fmt: skip
    if not task["depth"]:
        return row
    exposure = observation.detector.cadence_days
    planet, duration = make_planet(study, task, observation.time, exposure)
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
        row |= found_shape(study, corrector, found, exposure)
    corrector.correct(order=study.order, transit_model=planet)
    row["joint_depth"] = task["depth"] * corrector.result.transit_scale
    row["joint_depth_error"] = task["depth"] * corrector.result.transit_scale_err
    return row


def found_shape(study, corrector, found, exposure_time):
    """Return depth and duration of what was found, masked in a second de-trending."""
    mask = found.in_transit(corrector.original_lc.time.value, MASK_WIDTHS)
    lc = corrector.correct(order=study.order, transit_mask=mask)
    good = np.isfinite(lc.flux.value)
    time, flux = lc.time.value[good], lc.flux.value[good]
    flux = flattened(time, flux, mask[good])
    error = mad_std(flux[~mask[good]])
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


def summarize(study, table):
    """Return completeness and errors per motion, magnitude and depth.

    "completeness" is the fraction of the stars that is recovered, "expected" that whose transits
    would be above the threshold in the least white noise; medians of both signal-to-noise ratios
    and of the survival; the median of found over true depth and duration of those that are
    recovered, with half the range from the 16th to the 84th percentile; and of all the median of
    the jointly fitted over the true depth, and of its pull. In ``meta``: "false_alarms",
    "half_complete", the depth (ppm) of 50 % completeness, and "by_motion", the statistics of all
    planets of a motion.
    """
    names = ("scale", "mag", "depth")
    found = list(cells(table, names))
    rows = [cell | cell_of(study, part) for cell, part in found if cell["depth"] > 0]
    empty = [part["detected"] for cell, part in found if cell["depth"] == 0]
    summary = Table(rows, names=None if rows else names)
    summary["depth"].unit = "ppm"
    alarms, stars = (sum(count(part) for part in empty) for count in (np.sum, len))
    summary.meta["false_alarms"] = f"{alarms} of {stars} stars without planet"
    scales = sorted(set(table["scale"]))
    summary.meta["half_complete"] = {
        f"{scale:g}x": {
            f"Kp {mag:g}": half_complete(part["depth"], part["completeness"])
            for mag in sorted(set(table["mag"]))
            for part in [summary[(summary["scale"] == scale) & (summary["mag"] == mag)]]
        }
        for scale in scales
    }
    planets = table[table["depth"] > 0]
    summary.meta["by_motion"] = {
        f"{scale:g}x": by_motion(planets[planets["scale"] == scale], study.threshold)
        for scale in scales
    }
    return summary


def cell_of(study, rows):
    """Return the statistics of the stars of a cell."""
    recovered = np.array(rows["recovered"])
    row = {
        "stars": len(rows),
        "completeness": recovered.mean(),
        "expected": np.mean(values_of(rows, "expected_snr") >= study.threshold),
    }
    for name in ("snr", "expected_snr", "survival"):
        row[name] = np.median(values_of(rows, name))
    for name in ("depth", "duration"):
        ratio = (values_of(rows, f"found_{name}") / values_of(rows, name))[recovered]
        low, row[f"{name}_ratio"], high = percentiles(ratio)
        row[f"{name}_ratio_scatter"] = 0.5 * (high - low)
    depth, joint, error = (
        values_of(rows, name) for name in ("depth", "joint_depth", "joint_depth_error")
    )
    row["joint_ratio"] = np.median(joint / depth)
    row["joint_pull"] = np.median((joint - depth) / error)
    return row


def half_complete(depths, completeness):
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


def by_motion(rows, threshold):
    """Return the statistics of all planets at one multiple of the motion.

    Numbers of planets: "planets", "recovered", "expected" (above the threshold in the least noise)
    and "false" (the strongest box is above the threshold and not the planet); weighted means of
    found over true values with their errors, and the standard deviations of their pulls; and the
    medians of the survival and of the found over the expected ratio, of planets above twice the
    threshold.
    """
    recovered, detected = (np.array(rows[name]) for name in ("recovered", "detected"))
    expected = values_of(rows, "expected_snr")
    clear = expected > 2 * threshold
    numbers = {
        "planets": len(rows), "recovered": int(recovered.sum()),
        "expected": int(np.sum(expected >= threshold)), "false": int(np.sum(detected & ~recovered)),
        "survival": round(percentiles(values_of(rows, "survival")[clear])[1], 3),
        "snr_ratio": round(percentiles((values_of(rows, "snr") / expected)[clear])[1], 3),
    }  # fmt: skip
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


@styled
def draw(study, _, summary):
    """Draw maps of completeness and of found over true depth: a row of panels per motion."""
    mags = sorted({float(mag) for mag in study.magnitudes})
    depths = sorted({float(depth) for depth in study.depths if depth > 0})
    ratios = np.array(summary["depth_ratio"], dtype=float)
    largest = max(0.1, np.nanmax(np.abs(ratios - 1), initial=0.0))
    columns = (
        ("completeness", "Completeness", (0, 1)),
        ("depth_ratio", "Found / true depth", (1 - largest, 1 + largest)),
    )
    size = 1.2 + 2 * (2.0 + 0.5 * len(mags)), len(study.scales) * (1.3 + 0.3 * len(depths))
    figure, axes = plt.subplots(
        len(study.scales), 2, figsize=size, squeeze=False, layout="constrained"
    )
    for row, scale in zip(axes, sorted(study.scales), strict=True):
        part = summary[summary["scale"] == scale]
        for ax, (name, label, span) in zip(row, columns, strict=True):
            plot_map(
                on_grid(part, ("depth", depths), ("mag", mags), name), depths, mags,
                row_label="Depth (ppm)", column_label="Kp (mag)", label=label, span=span,
                title=f"{scale:g}x motion", ax=ax,
            )  # fmt: skip
    return figure


main = partial(run, NAME, Recovery, tasks, measure, summarize, draw, UNITS)

if __name__ == "__main__":
    main()
