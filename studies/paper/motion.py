"""The paper's figure 5: de-trended noise against magnitude at multiples of K2's motion.

    python studies/paper/motion.py --workers 4 --stars 5

Each star is drawn as the paper does, simulated, and de-trended by PLDCorrector and, if wanted, by
lightkurve's correctors in the same aperture. At some motions a second simulation, with the same
noise, has transits. Saunders et al. (2019) claim limits on the noise, which are checked.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np
from _correctors import CONVENTIONS, best_setting, correct, noise_of, transit_amplitude
from _figures import plot_cdpp_panels
from _reference import read_reference, reference_noise
from _stars import cached_motion, draw_star, stamp_around
from _study import cells, grid, percentiles, run
from astropy.table import Table

from scope_models import Detector, TransitModel, simulate
from scope_models._arrays import values_of
from scope_models.batch import star_rng, star_seed

NAME = "motion"
TITLES = {
    "pld": "PLD (scope_models)",
    "lightkurve_pld": "PLD (lightkurve, best order)",
    "lightkurve_sff": "SFF (lightkurve)",
}
UNITS = dict.fromkeys(
    (
        *(f"{name}_{method}" for name in ("raw", "floor", *TITLES) for method in CONVENTIONS),
        *(f"depth_{name}" for name in ("masked", "masked_error", "joint", "joint_error")),
        *(f"depth_{name}" for name in list(TITLES)[1:]),
    ),
    "ppm",
)
DETECTORS = {"paper": Detector.k2, "calibrated": Detector.k2_calibrated}
MARGINS = {"paper": 5, "calibrated": 8}  # pixels; the calibrated PSF has wings
KEPLER = {"kepler_median": "median", "kepler_p10": "p10", "kepler_p90": "p90"}
PERIOD, DURATION = 3.1, 0.25  # of the transits, days
TRANSIT_SCALE = 5.0  # of the paper's claim on transits
#: Name, multiple of the motion, faintest magnitude and limit (ppm, None for the median of Kepler's
#: stars) of the claims. The text and the caption of the paper's figure differ in one magnitude.
CLAIMS = (
    ("2x is Kepler-like to Kp 13", 2, 13, None),
    ("2x is below 200 ppm to Kp 15", 2, 15, 200),
    ("5x is below 400 ppm to Kp 15.5", 5, 15.5, 400),
    ("5x is below 400 ppm to Kp 14.5 (caption)", 5, 14.5, 400),
    ("10x is below 1000 ppm", 10, 15.5, 1000),
)
TRANSIT_CLAIM = "transits are retrievable at 5x"


@dataclass(frozen=True, kw_only=True)
class MotionTest:
    """The parameters."""

    seed: int = 1
    magnitudes: tuple[float, ...] = tuple(10 + 0.5 * k for k in range(12))  # Kp
    scales: tuple[float, ...] = (1.0, 2.0, 4.0, 5.0, 10.0)  # multiples of the motion
    stars: int = 5  # per magnitude and multiple
    cadences: int = 1000
    motion: str = "k2_roll"  # see `motion_from_name`
    detector: str = "paper"  # or "calibrated", which has K2's noise
    order: int = 2  # of our PLD
    transit_depth: float = 1000.0  # ppm
    transit_scales: tuple[float, ...] = (TRANSIT_SCALE,)  # multiples at which transits are put in
    lightkurve_pld: bool = True  # the best of orders 1 to 3 and two apertures
    lightkurve_sff: bool = True  # the best of 5, 10 and 20 windows, with the true positions


def tasks(study):
    """Return one task per star."""
    return grid(
        "kp{mag:g}-x{scale:g}-{index}", index=study.stars, scale=study.scales, mag=study.magnitudes
    )


def observe(study, task):
    """Return the pixels of a star without transits."""
    motion = task["scale"] * cached_motion(study.motion, study.cadences)
    shape, x_0, y_0 = stamp_around(motion, MARGINS[study.detector])
    detector = DETECTORS[study.detector](shape=shape)
    rng = star_rng(study.seed, task["key"])
    star = draw_star(rng, task["mag"], detector, x_0=x_0, y_0=y_0)
    return simulate(star, detector, motion, seed=star_seed(study.seed, task["key"], "noise"))


def measure(study, task):
    """Return the noise of a star before and after de-trending, and depths of transits.

    CDPP in ppm in both conventions: "raw", "floor" (of the noise alone in the aperture's sum) and
    of each corrector; "residual", that of ours over the floor; "held_out_mad" and "held_out_rms",
    see the page on PLD. At `transit_scales` the depths in ppm, of ours with the transits masked and
    jointly fitted, and the part of the depth that each corrector leaves without a mask.
    """
    from scope_models import PLDCorrector  # imports lightkurve

    observation = observe(study, task)
    tpf = observation.to_tpf()
    corrector = PLDCorrector(tpf)
    corrector.correct(order=study.order)
    aperture = corrector.aperture_mask
    row = {"pixels": int(aperture.sum())} | noise_of(corrector, observation)
    settings = {}
    for name in list(TITLES)[1:]:
        if getattr(study, name):
            lowest, best = best_setting(name, tpf, aperture)
            row |= {f"{name}_{method}": value for method, value in lowest.items()}
            if best is not None:
                settings[name] = best
    if task["scale"] in study.transit_scales:
        row |= depths(study, task, observation, aperture, settings)
    return row


def depths(study, task, observation, aperture, settings):
    """Return the depths of transits, of which the first one is anywhere within a period."""
    from scope_models import PLDCorrector

    first = star_rng(study.seed, task["key"], "transit").uniform(0, PERIOD)
    planet = TransitModel.from_depth_duration(
        1e-6 * study.transit_depth, DURATION, PERIOD, observation.time[0] + first,
        exposure_time=observation.detector.cadence_days,
    )  # fmt: skip
    star = observation.stars[0].replace(signal=planet)
    tpf = simulate(observation.scene.replace(stars=[star])).to_tpf()
    transit = planet(tpf.time.value)
    outside = transit == 1
    corrector = PLDCorrector(tpf, aperture_mask=aperture)
    corrector.correct(order=study.order, transit_mask=~outside)
    found = {"masked": corrector.fit_transit(transit)}
    corrector.correct(order=study.order, transit_model=transit)
    found["joint"] = corrector.result.transit_scale, corrector.result.transit_scale_err
    row = {}
    for name, (depth, error) in found.items():
        row[f"depth_{name}"] = depth * study.transit_depth
        row[f"depth_{name}_error"] = error * study.transit_depth
    flux = corrector.correct(order=study.order).flux.value
    row["survival_pld"] = transit_amplitude(flux, transit)
    for name, setting in settings.items():
        ways = ("survival", None, 1), ("depth", outside, study.transit_depth)
        for column, mask, unit in ways:
            flux = correct(name, setting, tpf, aperture, mask)
            if flux is not None:
                row[f"{column}_{name}"] = unit * transit_amplitude(flux, transit)
    return row


def summarize(study, table):
    """Return medians per motion and magnitude beside Kepler's, and check the paper's claims.

    Beside the medians of all columns: 16th and 84th percentiles of the correctors' CDPP, Kepler's
    percentiles, our CDPP over Kepler's median, and the limit that the paper states over our CDPP.
    In ``meta``, "claims" has the verdicts for ours, "claims_checked" definitions and numbers of all
    correctors, "survival" the part of a transit's depth that is left, and "kepler_like_to" the
    faintest magnitude to which each multiple of the motion is at most Kepler's median.
    """
    summary = Table([middle(cell, rows) for cell, rows in cells(table, ("scale", "mag"))])
    for name, column in KEPLER.items():
        summary[name] = np.round(reference_noise("kepler", np.array(summary["mag"]), column), 2)
    summary["over_kepler"] = summary["pld_everest"] / summary["kepler_median"]
    limits = [paper_limit(scale, mag) for scale, mag in summary.iterrows("scale", "mag")]
    summary["below_paper"] = np.array(limits) / summary["pld_everest"]
    checked = checked_claims(study, table, summary)
    summary.meta["claims"] = {name: claim["pld"]["verdict"] for name, claim in checked.items()}
    summary.meta["claims_checked"] = checked
    summary.meta["survival"] = {
        name: dict(zip(("low", "median", "high"), percentiles(values), strict=True))
        for name in TITLES
        for values in [values_of(table, f"survival_{name}")]
        if np.isfinite(values).any()
    }
    summary.meta["kepler_like_to"] = {
        name: kepler_like_to(part["mag"], part["pld_everest"], part["kepler_median"])
        for name, part in by_scale(summary).items()
    }
    for name in summary.colnames:
        if name.removesuffix("_low").removesuffix("_high") in (*UNITS, *KEPLER):
            summary[name].unit = "ppm"
    return summary


def middle(cell, rows):
    """Return the medians of all columns of the stars of a cell, and some percentiles."""
    cell = {name: float(value) for name, value in cell.items()} | {"stars": len(rows)}
    for name in rows.colnames:
        if name not in {"key", "index", "scale", "mag", "stars"}:
            low, cell[name], high = percentiles(values_of(rows, name))
            if name in [f"{corrector}_everest" for corrector in TITLES]:
                cell[f"{name}_low"], cell[f"{name}_high"] = low, high
    return cell


def by_scale(summary):
    """Return the rows of each multiple of the motion, as "5x"."""
    scales = sorted(set(summary["scale"]))
    return {f"{scale:g}x": summary[summary["scale"] == scale] for scale in scales}


def present(summary):
    """Return the correctors of which there are results."""
    return [name for name in TITLES if f"{name}_everest" in summary.colnames]


def checked_claims(study, table, summary):
    """Return each claim by its name: its definition, and the result of each corrector."""
    scale, mag, kepler = (np.array(summary[k]) for k in ("scale", "mag", "kepler_median"))
    claims = {}
    for name, multiple, faintest, ppm in CLAIMS:
        text = "the median of Kepler's stars" if ppm is None else f"{ppm:g} ppm"
        claims[name] = {
            "definition": f"the median CDPP (EVEREST's convention) of the stars with {multiple:g}x "
            f"motion is at most {text} in every bin to Kp {faintest:g}"
        }
        limit = kepler if ppm is None else np.full(mag.shape, float(ppm))
        used = (scale == multiple) & (mag <= faintest)
        for corrector in present(summary):
            cdpp = np.array(summary[f"{corrector}_everest"])
            claims[name][corrector] = check_limit(used, faintest, mag, cdpp, limit)
    rows = table[table["scale"] == TRANSIT_SCALE]
    claims[TRANSIT_CLAIM] = {
        "definition": "the depth is at least 7.1 of its errors deep and within 3 errors of the "
        "truth in 90 % of the stars"
    }
    for name, how in (("pld", "masked"), ("pld_joint", "joint")):
        depth, error = (values_of(rows, f"depth_{how}{end}") for end in ("", "_error"))
        claims[TRANSIT_CLAIM][name] = check_transits(depth, error, study.transit_depth)
    return claims


def check_limit(used, faintest, mag, cdpp, limit):
    """Return a verdict on noise below a limit in all used cells, and the cell nearest to it.

    A grid without the faintest magnitude, or without the noise of one of its bins, is not checked.
    """
    ratio = np.where(used, cdpp / limit, -np.inf)
    if not np.any(used & (mag == faintest)) or np.isnan(ratio).any():
        return {"verdict": "not checked"}
    worst = int(np.argmax(ratio))
    return {
        "verdict": "holds" if ratio[worst] <= 1 else "does not hold",
        "mag": float(mag[worst]),
        "cdpp_ppm": float(cdpp[worst]),
        "limit_ppm": float(limit[worst]),
        "times_below": float(1 / ratio[worst]),
    }


def check_transits(depth, error, true):
    """Return a verdict on retrieved transits, and weighted mean and pulls of the depths.

    7.1 is Kepler's threshold of detection.
    """
    known = np.isfinite(depth) & np.isfinite(error)
    if not known.any():
        return {"verdict": "not checked"}
    depth, error = depth[known], error[known]
    pull = (depth - true) / error
    share = float(np.mean((depth >= 7.1 * error) & (np.abs(pull) <= 3)))
    weight = error**-2.0
    return {
        "verdict": "holds" if share >= 0.9 else "does not hold",
        "share": share,
        "stars": len(depth),
        "ratio": float(np.sum(weight * depth) / np.sum(weight) / true),
        "ratio_error": float(np.sum(weight) ** -0.5 / true),
        "pull": float(np.std(pull)),
    }


def paper_limit(scale, mag):
    """Return the lowest limit in ppm that the paper states at a motion and magnitude, or NaN."""
    limits = [
        ppm
        for _, multiple, faintest, ppm in CLAIMS
        if ppm and multiple == scale and mag <= faintest
    ]
    return float(min(limits, default=np.nan))


def kepler_like_to(mag, cdpp, kepler):
    """Return the faintest magnitude to which every bin is at most Kepler's median, or None."""
    faintest = None
    for where in np.argsort(mag):
        if not cdpp[where] <= kepler[where]:
            break
        faintest = float(mag[where])
    return faintest


def draw(_, __, summary):
    """Draw CDPP against magnitude: a panel per corrector, a curve per motion."""
    parts = by_scale(summary)
    panels = {}
    for name in present(summary):
        columns = ["mag", *(f"{name}_everest{end}" for end in ("", "_low", "_high"))]
        panels[TITLES[name]] = {
            scale: [np.array(part[k]) for k in columns] for scale, part in parts.items()
        }
    mags = np.array(read_reference("kepler")["mag"])  # also beside the stars, if they are few
    mags = mags[(mags >= min(summary["mag"]) - 0.5) & (mags <= max(summary["mag"]) + 0.5)]
    kepler = {"mag": mags, "label": "Kepler, median", "band_label": "Kepler, 10 % to 90 %"}
    for key, column in (("median", "median"), ("low", "p10"), ("high", "p90")):
        kepler[key] = reference_noise("kepler", mags, column)
    limits = [
        (faintest, ppm, f"paper, {scale:g}x")
        for name, scale, faintest, ppm in CLAIMS
        if ppm and f"{scale:g}x" in parts and "caption" not in name
    ]
    residuals = {
        scale: (np.array(part["mag"]), np.array(part["residual_everest"]))
        for scale, part in parts.items()
    }
    axes = plot_cdpp_panels(panels, kepler, limits=limits, residuals=residuals)
    axes["Residual over noise"].set_title(f"{TITLES['pld']}, residual over noise")
    return axes[TITLES["pld"]].figure


main = partial(run, NAME, MotionTest, tasks, measure, summarize, draw, UNITS)

if __name__ == "__main__":
    main()
