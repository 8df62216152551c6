"""The paper's figure 5: de-trended noise against magnitude at multiples of K2's motion.

    python studies/paper/motion.py --workers 4 --stars 5

Each star is drawn as the paper does, simulated, and de-trended by PLDCorrector and, if wanted, by
lightkurve's correctors in the same aperture. At some motions a second simulation, with the same
noise, has transits. The limits on the noise that Saunders et al. (2019) state are in the figure.
"""

import numpy as np
from _correctors import CONVENTIONS, best_setting, correct, noise_of, transit_amplitude
from _figures import plot_cdpp_panels
from _reference import noise_band, read_reference, reference_noise
from _stars import motion_from_name, observe_star
from _study import cells, grid, medians, parameters, percentiles, study_of

from scope_models import PLDCorrector, TransitModel, simulate
from scope_models._arrays import values_of
from scope_models.batch import star_rng

TITLES = {
    "pld": "PLD (scope_models)",
    "lightkurve_pld": "PLD (lightkurve, best order)",
    "lightkurve_sff": "SFF (lightkurve)",
}
NOISE = [f"{name}_{method}" for name in ("raw", "floor", *TITLES) for method in CONVENTIONS]
DEPTHS = "depth_masked", "depth_masked_error", "depth_joint", "depth_joint_error"
UNITS = dict.fromkeys((*NOISE, *DEPTHS), "ppm")
KEPLER = {"kepler_median": "median", "kepler_p10": "p10", "kepler_p90": "p90"}
PERIOD, DURATION = 3.1, 0.25  # of the transits, days
#: Multiple of the motion, faintest magnitude, and the limit (ppm) that the paper's text states.
LIMITS = ((2, 15, 200), (5, 15.5, 400), (10, 15.5, 1000))


@parameters
class MotionTest:
    seed: int = 1
    magnitudes: tuple[float, ...] = tuple(10 + 0.5 * k for k in range(12))  # Kp
    scales: tuple[float, ...] = (1.0, 2.0, 4.0, 5.0, 10.0)  # multiples of the motion
    stars: int = 5  # per magnitude and multiple
    cadences: int = 1000
    motion: str = "k2_roll"  # see `motion_from_name`
    detector: str = "paper"  # or "calibrated", which has K2's noise
    order: int = 2  # of our PLD
    transit_depth: float = 1000.0  # ppm
    transit_scales: tuple[float, ...] = (5.0,)  # multiples at which transits are put in
    lightkurve_pld: bool = True  # the best of orders 1 to 3 and two apertures
    lightkurve_sff: bool = True  # the best of 5, 10 and 20 windows, with the true positions


tasks = grid("kp{mag:g}-x{scale:g}-{index}", index="stars", scale="scales", mag="magnitudes")


def observe(study, task):
    """Return the pixels of a star without transits."""
    motion = task["scale"] * motion_from_name(study.motion, study.cadences)
    margin = 8 if study.detector == "calibrated" else 5  # its PSF has wings
    return observe_star(study, task, motion, detector=study.detector, margin=margin)


def measure(study, task):
    """Return the noise of a star before and after de-trending, and depths of transits.

    CDPP in ppm in both conventions: "raw", "floor" (of the noise alone in the aperture's sum) and
    of each corrector; "residual", that of ours over the floor; "held_out_mad" and "held_out_rms",
    see the page on PLD. At `transit_scales` the depths in ppm, of ours with the transits masked and
    jointly fitted, and the part of the depth that each corrector leaves without a mask.
    """
    observation = observe(study, task)
    tpf = observation.to_tpf()
    corrector = PLDCorrector(tpf)
    corrector.correct(order=study.order)
    aperture = corrector.aperture_mask
    row = {"pixels": int(aperture.sum())}
    row |= noise_of(corrector, observation.flux, observation.model())
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
    first = star_rng(study.seed, task["key"], "transit").uniform(0, PERIOD)
    planet = TransitModel.from_depth_duration(
        1e-6 * study.transit_depth, DURATION, PERIOD, observation.time[0] + first,
        exposure_time=observation.detector.cadence_days,
    )  # fmt: skip
    star = observation.stars[0].replace(signal=planet)
    tpf = simulate(observation.scene.replace(stars=[star])).to_tpf()
    transit = planet(tpf.time.value)
    corrector = PLDCorrector(tpf, aperture_mask=aperture)
    corrector.correct(order=study.order, transit_mask=transit < 1)
    found = {"masked": corrector.fit_transit(transit)}
    corrector.correct(order=study.order, transit_model=transit)
    found["joint"] = corrector.result.transit_scale, corrector.result.transit_scale_err
    row = {
        f"depth_{name}{end}": value * study.transit_depth
        for name, pair in found.items() for end, value in zip(("", "_error"), pair, strict=True)
    }  # fmt: skip
    flux = corrector.correct(order=study.order).flux.value
    row["survival_pld"] = transit_amplitude(flux, transit)
    for name, setting in settings.items():
        flux = correct(name, setting, tpf, aperture)
        if flux is not None:
            row[f"survival_{name}"] = transit_amplitude(flux, transit)
    return row


def summarize(_, table):
    """Return medians per motion and magnitude beside Kepler's and the limits of the paper.

    Beside the medians of all columns: 16th and 84th percentiles of the correctors' CDPP, Kepler's
    percentiles, our CDPP over Kepler's median, and the limit that the paper states over our CDPP.
    ``meta`` has "survival", the part of a transit's depth that is left.
    """
    columns = [name for name in table.colnames if name not in {"key", "index", "scale", "mag"}]
    everest = [f"{name}_everest" for name in TITLES]
    summary = medians(table, ("scale", "mag"), columns, everest)
    for name, column in KEPLER.items():
        summary[name] = np.round(reference_noise("kepler", np.array(summary["mag"]), column), 2)
    noise = np.array(summary["pld_everest"])
    summary["over_kepler"] = noise / summary["kepler_median"]
    summary["below_paper"] = np.nan
    for scale, faintest, ppm in LIMITS:
        part = (summary["scale"] == scale) & (summary["mag"] <= faintest)
        summary["below_paper"][part] = ppm / noise[part]
    summary.meta["survival"] = {
        name: dict(zip(("low", "median", "high"), percentiles(values), strict=True))
        for name in TITLES
        for values in [values_of(table, f"survival_{name}")]
        if np.isfinite(values).any()
    }
    for name in summary.colnames:
        if name.removesuffix("_low").removesuffix("_high") in (*UNITS, *KEPLER):
            summary[name].unit = "ppm"
    return summary


def draw(_, __, summary):
    """Draw CDPP against magnitude: a panel per corrector, a curve per motion."""
    parts = {f"{cell['scale']:g}x": part for cell, part in cells(summary, ("scale",))}

    def curves(*columns):
        return {scale: [np.array(part[k]) for k in columns] for scale, part in parts.items()}

    panels = {
        title: curves("mag", *(f"{name}_everest{end}" for end in ("", "_low", "_high")))
        for name, title in TITLES.items() if f"{name}_everest" in summary.colnames
    }  # fmt: skip
    mags = np.array(read_reference("kepler")["mag"])  # also beside the stars, if they are few
    mags = mags[(mags >= min(summary["mag"]) - 0.5) & (mags <= max(summary["mag"]) + 0.5)]
    limits = [
        (faintest, ppm, f"paper, {scale}x") for scale, faintest, ppm in LIMITS
        if f"{scale}x" in parts
    ]  # fmt: skip
    figure = plot_cdpp_panels(
        panels, noise_band("kepler", "Kepler", mags), limits=limits,
        residuals=curves("mag", "residual_everest"),
    )  # fmt: skip
    figure.axes[-1].set_title(f"{TITLES['pld']}, residual over noise")
    return figure


main = study_of("motion", MotionTest, tasks, measure, summarize, draw, UNITS)

if __name__ == "__main__":
    main()
