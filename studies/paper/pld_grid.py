"""Scores of PLDCorrector on simulated stars, against the truth and lightkurve's PLDCorrector.

    python studies/paper/pld_grid.py --data ../shared/data/poscorr --workers 2

The grid: magnitudes 10 to 15.5 by 0.5; K2 motion times 1, 2, 5 and 10; three real motions and a
generated one; the paper's detector and a harsher one; five stars per cell. Each star has transits,
of 1000 ppm and of 200 ppm.
"""

from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from _correctors import CONVENTIONS, LIGHTKURVE_CORRECTORS, correct, score
from _study import cells, grid, medians, run
from astropy.table import Table

from scope_models import (
    BivariateGaussianPSF,
    Detector,
    Motion,
    SensitivityPolynomial,
    Star,
    simulate,
)
from scope_models._arrays import values_of
from scope_models.missions import MISSIONS
from scope_models.photometry import cdpp

NAME = "pld-grid"
#: Files of real motions, without flagged cadences, by the name of their star.
SERIES = {
    "wasp47-c3": "ktwo206103150-c03_llc.fits",
    "epic211117077-c4": "ktwo211117077-c04_llc.fits",
    "epic211436265-c5": "ktwo211436265-c05_llc.fits",
    "generated": None,
}
DEPTHS = {"1000": 1000e-6, "200": 200e-6}
LARGEST_RESIDUAL = 1.10
PERIOD, FIRST, DURATION = 97, 40, 8  # of the transits, cadences
SCORES = (
    "held_out_mad", "held_out_rms", "held_out_known_rms", "held_out_pull", "residual_lightkurve",
    "residual_everest", "cdpp_everest", "best_everest",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class PLDGrid:
    """The parameters."""

    data: str = "../shared/data/poscorr"  # folder of the files of `SERIES`
    magnitudes: tuple[float, ...] = tuple(10 + 0.5 * k for k in range(12))  # Kp
    scales: tuple[int, ...] = (1, 2, 5, 10)  # multiples of the motion
    detectors: tuple[str, ...] = ("paper", "harsh")
    series: tuple[str, ...] = tuple(SERIES)
    stars: int = 5  # per cell
    cadences: int = 1000
    order: int = 2
    transits: bool = True  # whether to measure depths
    lightkurve: bool = True  # whether to compare


def tasks(study):
    """Return one task per star, so that any beginning of them is a sample of all."""
    return grid(
        "{detector}-kp{mag:g}-x{scale}-{series}-{index}", index=study.stars, scale=study.scales,
        detector=study.detectors, series=study.series, mag=study.magnitudes,
    )  # fmt: skip


def make_motion(study, name):
    """Return the first cadences that can be used, about their median."""
    if SERIES[name] is None:
        motion = Motion.k2_roll(study.cadences, seed=10)
    else:
        motion = Motion.from_file(Path(study.data) / SERIES[name], bad="drop")
        near = np.hypot(motion.x - np.median(motion.x), motion.y - np.median(motion.y)) < 3
        good = (motion.quality & MISSIONS["K2"].quality.rejected) == 0
        motion = motion[good & near][: study.cadences]
    x, y = motion.x - np.median(motion.x), motion.y - np.median(motion.y)
    return Motion.from_arrays(motion.time, x, y)


def make_star(study, task):
    """Return the observation without its transits, as arguments of `simulate`, and its seed."""
    motion = task["scale"] * make_motion(study, task["series"])
    seed = int(1e6 * task["mag"]) + 1000 * task["scale"] + task["index"]
    seed += 100 * list(SERIES).index(task["series"])
    rng = np.random.default_rng(seed)
    shift = rng.uniform(-0.2, 0.2, 2)
    sigma = 0.5 * (1 + rng.uniform(-0.1, 0.1, 2))
    psf = BivariateGaussianPSF(sigma_x=sigma[0], sigma_y=sigma[1], rho=rng.uniform(-0.4, 0.4))
    drop, scatter = -0.05, 0.01
    if task["detector"] == "harsh":
        psf.flux = 0.8
        psf = psf + BivariateGaussianPSF(flux=0.2, sigma_x=1.2, sigma_y=1.2)
        drop, scatter = -0.5, 0.03
    pad = 5  # pixels around where the star goes
    low_x, low_y = (int(np.floor(values.min())) - pad for values in (motion.x, motion.y))
    nx = int(np.ceil(motion.x.max())) + pad - low_x + 1
    ny = int(np.ceil(motion.y.max())) + pad - low_y + 1
    sensitivity = SensitivityPolynomial((1, 0, drop), (1, 0, drop))
    pixels = Detector.k2(
        shape=(ny, nx), sensitivity=sensitivity, interpixel_scatter=scatter,
        interpixel_distribution="normal",
    )  # fmt: skip
    return Star(task["mag"], shift[0] - low_x, shift[1] - low_y, psf=psf), pixels, motion, seed


def measure(study, task):
    """Return scores of noise, and measured over true depth: masked, jointly fitted, unmasked."""
    from scope_models import PLDCorrector  # imports lightkurve

    star, detector, motion, seed = make_star(study, task)
    inside = (np.arange(len(motion)) - FIRST) % PERIOD < DURATION
    inside[:FIRST] = inside[len(motion) - DURATION :] = False
    row = {}
    for name, depth in DEPTHS.items() if study.transits else [("1000", DEPTHS["1000"])]:
        signal = 1 - depth * inside
        observation = simulate(star.replace(signal=signal), detector, motion, seed=seed)
        tpf = observation.to_tpf()
        corrector = PLDCorrector(tpf)
        corrector.correct(order=study.order, transit_mask=inside)
        if not row:
            row |= noise_scores(corrector, observation, signal)
            if study.lightkurve:
                row |= best_of_lightkurve(tpf, corrector, signal)
        if study.transits:
            row |= depth_scores(study, corrector, signal, name)
    return row


def noise_scores(corrector, observation, signal):
    """Return the scores of the last correction, and the CDPP before and after it."""
    mask = corrector.aperture_mask
    expected = observation.model()[:, mask].sum(axis=1)
    noise = (observation.flux[:, mask].sum(axis=1) - expected) / np.median(expected)
    scores = {k: float(v) for k, v in vars(score(corrector, signal, noise)).items()}
    means, errors, _ = corrector.held_out()
    known = errors < 1.5 * np.median(errors)
    scores["held_out_known_rms"] = scores["held_out_rms"] * np.std(means[known]) / np.std(means)
    good = np.isfinite(corrector.corrected_lc.flux.value)
    lcs = {"cdpp": corrector.corrected_lc, "raw": corrector.original_lc}
    for method in CONVENTIONS:
        for name, lc in lcs.items():
            scores[f"{name}_{method}"] = cdpp(lc.flux.value[good] / signal[good], method=method)
    return scores | {"pixels": int(mask.sum())}


def best_of_lightkurve(tpf, corrector, signal):
    """Return the lowest CDPP of orders 1 to 3, in our aperture and in lightkurve's own."""
    best = {}
    for setting in LIGHTKURVE_CORRECTORS["lightkurve_pld"]:
        flux = correct("lightkurve_pld", setting, tpf, corrector.aperture_mask, signal == 1)
        for method in CONVENTIONS if flux is not None else ():
            found = cdpp(flux / signal, method=method)
            best[f"best_{method}"] = min(best.get(f"best_{method}", np.inf), found)
    return best


def depth_scores(study, corrector, signal, name):
    """Return measured over true depth, and its error."""
    scale, error = corrector.fit_transit(signal)
    row = {f"masked_{name}": scale, f"masked_{name}_err": error}
    corrector.correct(order=study.order, transit_model=signal)
    result = corrector.result
    row |= {f"joint_{name}": result.transit_scale, f"joint_{name}_err": result.transit_scale_err}
    lc = corrector.correct(order=study.order)
    flux, weight = lc.flux.value / np.nanmedian(lc.flux.value), lc.flux_err.value**-2.0
    outside, inside = (np.average(flux[s], weights=weight[s]) for s in (signal == 1, signal < 1))
    return row | {f"unmasked_{name}": (outside - inside) / (1 - signal.min())}


def summarize(_, table):
    """Return medians of the scores by motion and magnitude.

    In ``meta``: "residual", in how many stars and cells the larger residual CDPP is above 1.1;
    "held_out", in how many the rms is above 1.5 MAD; "depths", the weighted mean of measured over
    true depth with its error and the standard deviation of the pulls; and "lightkurve", in which
    part of the stars ours is lower, and the median ratio.
    """
    summary = medians(table, ("scale", "mag"), SCORES)
    worse = np.fmax(*(values_of(table, f"residual_{method}") for method in CONVENTIONS))
    ratio = values_of(table, "held_out_rms") / values_of(table, "held_out_mad")
    table = Table(table, copy=True)
    table["worse"] = worse
    groups = [part["worse"] for _, part in cells(table, ("detector", "mag", "scale", "series"))]
    high = [np.median(part) > LARGEST_RESIDUAL for part in groups]
    summary.meta["residual"] = (
        f"above {LARGEST_RESIDUAL} in {np.sum(worse > LARGEST_RESIDUAL)} of {len(worse)} stars, "
        f"largest {worse.max():.2f}; median of the cell in {np.sum(high)} of {len(high)} cells"
    )
    summary.meta["held_out"] = f"rms above 1.5 MAD in {np.sum(ratio > 1.5)} of {len(ratio)} stars"
    summary.meta["depths"] = {}
    for low, most in ((10, 13), (13.5, 15.5)):
        part = table[(table["mag"] >= low) & (table["mag"] <= most)]
        for how in (f"{how}_{name}" for how in ("masked", "joint") for name in DEPTHS):
            values, errors = (values_of(part, f"{how}{end}") for end in ("", "_err"))
            if np.isfinite(values).any():
                mean, sigma = np.average(values, weights=errors**-2.0), np.sum(errors**-2.0) ** -0.5
                summary.meta["depths"][f"{how}, Kp {low:g} to {most:g}"] = (
                    f"{mean:.4f} +- {sigma:.4f}, pulls {np.std((values - 1) / errors):.3f}"
                )
    summary.meta["lightkurve"] = {}
    for method in CONVENTIONS:
        better = values_of(table, f"best_{method}") / values_of(table, f"cdpp_{method}")
        if np.isfinite(better).any():
            better = better[np.isfinite(better)]
            summary.meta["lightkurve"][method] = (
                f"ours lower in {100 * np.mean(better > 1):.1f} % of stars, median "
                f"{np.median(better):.2f}"
            )
    return summary


def draw(_, __, summary):
    """Draw held-out scatter and residual CDPP against magnitude."""
    figure, axes = plt.subplots(1, 3, figsize=(12, 4), layout="constrained")
    shades, markers = ("0.65", "0.45", "0.25", "0"), "o^sD"
    for number, (cell, part) in enumerate(cells(summary, ("scale",))):
        style = {"color": shades[number % 4], "marker": markers[number % 4], "ms": 4}
        mags = np.array(part["mag"])
        for ax, name in zip(
            axes, ("held_out_mad", "residual_everest", "cdpp_everest"), strict=True
        ):
            ax.plot(mags, np.array(part[name]), **style, label=f"{cell['scale']}x")
        axes[2].plot(mags, np.array(part["best_everest"]), "x", color=style["color"], ms=5)
    axes[2].set_yscale("log")
    titles = ("Held-out MAD", "Residual CDPP, EVEREST", "CDPP, EVEREST; x: lightkurve's best")
    labels = ("in units of the noise's", "in units of the noise's", "CDPP (ppm)")
    for ax, title, label in zip(axes, titles, labels, strict=True):
        ax.set(title=title, xlabel="Kp (mag)", ylabel=label)
    axes[0].legend(title="motion")
    return figure


def main(argv=None):
    """Run the study."""
    result = run(NAME, PLDGrid, tasks, measure, units={}, summarize=summarize, draw=draw, argv=argv)
    for name in ("residual", "held_out"):
        print(f"{name}: {result.summary.meta[name]}")
    for name in ("depths", "lightkurve"):
        for key, text in result.summary.meta[name].items():
            print(f"{key}: {text}")
    return result


if __name__ == "__main__":
    main()
