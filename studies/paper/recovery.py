"""Injection and recovery of transits, over depth, magnitude and motion.

    python studies/paper/recovery.py --workers 4

Each star is drawn as the paper does, with a planet on an orbit of its own, simulated on the paper's
detector, and de-trended by PLDCorrector without a mask of the transits. A search by box least
squares follows (Kovacs, G., Zucker, S. & Mazeh, T. 2002, A&A, 391, 369), without cadences that
stand out from both neighbors. The planet is recovered if the strongest box is at least 7.1 times
its error deep, Kepler's threshold, and all boxes are within half a transit of true ones. Then what
was found is masked, the star is de-trended again, and a transit is fitted.
"""

from itertools import product

import numpy as np
from _correctors import transit_amplitude
from _figures import make_panels, plot_map
from _search import fit_shape, flattened, isolated, search_light_curve
from _stars import motion_from_name, observe_star
from _study import cells, grid, medians, parameters, percentiles, study_of
from astropy.stats import mad_std
from matplotlib.colors import Normalize

from scope_models import Detector, PLDCorrector, TransitModel
from scope_models._arrays import values_of
from scope_models.batch import star_rng
from scope_models.plotting._style import styled

DAYS = ("period", "duration", "found_period", "found_duration", "found_duration_error")
DEPTHS = ("depth", "found_depth", "found_depth_error", "joint_depth", "joint_depth_error")
UNITS = dict.fromkeys(DAYS, "d") | dict.fromkeys((*DEPTHS, "white_noise"), "ppm")
EXPOSURE = Detector.k2().cadence_days
MASK_WIDTHS = 0.75  # of a found transit, in its durations on either side of the middle


@parameters
class Recovery:
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


tasks = grid(
    "kp{mag:g}-x{scale:g}-d{depth:g}-{index}",
    index="stars", scale="scales", depth="depths", mag="magnitudes",
)  # fmt: skip


def make_planet(study, task, time):
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
    orbit = 1e-6 * task["depth"], duration, period, t0
    return TransitModel.from_depth_duration(*orbit, exposure_time=EXPOSURE), duration


def measure(study, task):
    """Return what is found of the planet of a star.

    "white_noise", the least that a cadence can have (ppm), with the true image known; "snr" and
    "found_period" of the strongest box; "detected", whether it is above the threshold, and
    "recovered", whether it is the planet too. Of a planet its "period" and "duration";
    "expected_snr", that of its transits in this noise; "survival", the part of its depth that the
    first de-trending leaves; and "joint_depth", fitted together with the systematics by the true
    shape. Of a recovered one "found_depth" and "found_duration", by the shape that was found.
    """
    motion = task["scale"] * motion_from_name(study.motion, study.cadences)
    planet, duration = make_planet(study, task, motion.time) if task["depth"] else (None, None)
    observation = observe_star(study, task, motion, signal=planet)
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
    drop, period = 1e6 * (1 - planet(time)), planet.period.value
    matches = found.matches(period, planet.t0.value, duration, np.ptp(time))
    row |= {
        "period": period, "duration": duration, "recovered": row["detected"] and matches,
        "expected_snr": np.sqrt(np.sum(drop**2)) / row["white_noise"],
        "survival": transit_amplitude(flux, planet(time)),
    }  # fmt: skip
    if row["recovered"]:
        row |= found_shape(study, corrector, found)
    corrector.correct(order=study.order, transit_model=planet)
    result = corrector.result
    scales = {"joint_depth": result.transit_scale, "joint_depth_error": result.transit_scale_err}
    return row | {name: task["depth"] * scale for name, scale in scales.items()}


def found_shape(study, corrector, found):
    """Return depth and duration of what was found, masked in a second de-trending."""
    mask = found.in_transit(corrector.original_lc.time.value, MASK_WIDTHS)
    lc = corrector.correct(order=study.order, transit_mask=mask)
    good = np.isfinite(lc.flux.value)
    time, flux = lc.time.value[good], lc.flux.value[good]
    flux = flattened(time, flux, mask[good])
    error = mad_std(flux[~mask[good]])
    keep = ~isolated(flux)
    model, duration, error = fit_shape(time[keep], flux[keep], error, found, EXPOSURE)
    depth, depth_error = 1e6 * model.depth * np.array(corrector.fit_transit(model))
    return {
        "found_depth": depth, "found_depth_error": depth_error,
        "found_duration": duration, "found_duration_error": error,
    }  # fmt: skip


def summarize(study, table):
    """Return completeness and ratios per motion, magnitude and depth.

    "completeness" is the fraction of the stars that is recovered; the others are medians: both
    signal-to-noise ratios, the survival, and depths and durations over the true ones. In ``meta``:
    "false_alarms", and "by_motion", the statistics of all planets of a motion.
    """
    cell, alone = ("scale", "mag", "depth"), table["detected"][table["depth"] == 0]
    planets = table[table["depth"] > 0]
    found = {"depth": "found_depth", "duration": "found_duration", "joint": "joint_depth"}
    for name, column in found.items():
        true = values_of(planets, column.partition("_")[2])
        planets[f"{name}_ratio"] = values_of(planets, column) / true
    names = ("snr", "expected_snr", "survival", *(f"{name}_ratio" for name in found))
    summary = medians(planets, cell, names)
    summary["completeness"] = [np.mean(part["recovered"]) for _, part in cells(planets, cell)]
    summary["depth"].unit = "ppm"
    summary.meta = {
        "false_alarms": f"{np.sum(alone)} of {len(alone)} stars without planet",
        "by_motion": {
            f"{cell['scale']:g}x": by_motion(part, study.threshold)
            for cell, part in cells(planets, ("scale",))
        },
    }
    return summary


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
    pairs = ("found_depth", "depth"), ("joint_depth", "depth"), ("found_duration", "duration")
    for found, true in pairs:
        columns = np.array([values_of(rows, name) for name in (found, f"{found}_error", true)])
        value, error, truth = columns[:, np.isfinite(columns[0])]
        if len(value):
            weights, ratio = (truth / error) ** 2, value / truth
            numbers[f"{found}_ratio"] = round(float(np.average(ratio, weights=weights)), 4)
            numbers[f"{found}_ratio_error"] = round(float(weights.sum() ** -0.5), 4)
            numbers[f"{found}_pulls"] = round(float(np.std((value - truth) / error)), 2)
    return numbers


@styled
def draw(_, __, summary):
    """Draw maps of completeness and of found over true depth: a row of panels per motion."""
    scales, mags, depths = (len(set(summary[name])) for name in ("scale", "mag", "depth"))
    figure, axes = make_panels(2 * scales, 2, (1.2, 2.0 + 0.5 * mags, 0, 1.3 + 0.3 * depths))
    largest = max(0.1, np.nanmax(np.abs(np.array(summary["depth_ratio"]) - 1), initial=0.0))
    columns = (
        ("completeness", "Completeness", Normalize(0, 1)),
        ("depth_ratio", "Found / true depth", Normalize(1 - largest, 1 + largest)),
    )
    panels = product(cells(summary, ("scale",)), columns)
    for ax, ((cell, part), (name, label, norm)) in zip(axes, panels, strict=True):
        plot_map(
            part, name, ("depth", "Depth (ppm)"), ("mag", "Kp (mag)"), label=label, norm=norm,
            title=f"{cell['scale']:g}x motion", ax=ax,
        )  # fmt: skip
    return figure


main = study_of("recovery", Recovery, tasks, measure, summarize, draw, UNITS)

if __name__ == "__main__":
    main()
