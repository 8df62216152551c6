"""Scores of PLDCorrector on simulated stars, against the truth and lightkurve's PLDCorrector.

The grid: magnitudes 10 to 15.5 by 0.5; K2 motion times 1, 2, 5 and 10; three real motions and a
generated one; the paper's detector and a harsher one; five stars per cell. Each star has transits,
of 1000 ppm and of 200 ppm. Run it as

    OMP_NUM_THREADS=1 python studies/pld_grid.py --data FOLDER --output grid.jsonl

Every star is a line of the output file; a second run goes on where the first one stopped.
``--report`` prints the tables of what is there, and ``--figure FILE`` draws them. Options choose
parts of the grid.
"""

import argparse
import itertools
import json
import warnings
from pathlib import Path

import numpy as np
from paper._correctors import CONVENTIONS, LIGHTKURVE_CORRECTORS, correct, score
from tqdm import tqdm

from scope_models import (
    BivariateGaussianPSF,
    Detector,
    Motion,
    SensitivityPolynomial,
    Star,
    simulate,
)
from scope_models.correctors import PLDCorrector
from scope_models.photometry import cdpp

MAGNITUDES = tuple(np.arange(10, 15.6, 0.5))
SCALES = (1, 2, 5, 10)
DETECTORS = ("paper", "harsh")
SERIES = {
    "WASP-47, C3": "ktwo206103150-c03_llc.fits",
    "EPIC 211117077, C4": "ktwo211117077-c04_llc.fits",
    "EPIC 211436265, C5": "ktwo211436265-c05_llc.fits",
    "generated": None,
}
DEPTHS = (1000e-6, 200e-6)
LARGEST_RESIDUAL = 1.10
TRANSIT = {"period": 97, "first": 40, "duration": 8}  # cadences


def make_motion(name, folder, n_cadences):
    """Return the first cadences that can be used, about their median."""
    if SERIES[name] is None:
        motion = Motion.k2_roll(n_cadences, seed=10)
    else:
        motion = Motion.from_file(folder / SERIES[name], bad="drop")
        bad = 1 | 2 | 4 | 8 | 16 | 32 | 128 | 2048 | 32768 | 65536 | 1048576
        near = np.hypot(motion.x - np.median(motion.x), motion.y - np.median(motion.y)) < 3
        motion = motion[((motion.quality & bad) == 0) & near][:n_cadences]
    x, y = motion.x - np.median(motion.x), motion.y - np.median(motion.y)
    return Motion.from_arrays(motion.time, x, y)


def make_star(detector, mag, scale, series, index, options):
    """Return the observation without its transit, as arguments of `simulate`."""
    motion = scale * make_motion(series, options.data, options.cadences)
    seed = int(1e6 * mag) + 1000 * scale + 100 * list(SERIES).index(series) + index
    rng = np.random.default_rng(seed)
    shift = rng.uniform(-0.2, 0.2, 2)
    sigma = 0.5 * (1 + rng.uniform(-0.1, 0.1, 2))
    psf = BivariateGaussianPSF(sigma_x=sigma[0], sigma_y=sigma[1], rho=rng.uniform(-0.4, 0.4))
    drop, scatter = -0.05, 0.01
    if detector == "harsh":
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
    star = Star(mag, shift[0] - low_x, shift[1] - low_y, psf=psf)
    return star, pixels, motion, seed


def transits(n, depth):
    """Return the relative flux with box-shaped transits."""
    signal = np.ones(n)
    for start in range(TRANSIT["first"], n - TRANSIT["duration"], TRANSIT["period"]):
        signal[start : start + TRANSIT["duration"]] -= depth
    return signal


def run_star(key, options):
    """Simulate and correct one star, and return its scores."""
    star, detector, motion, seed = make_star(*key, options)
    row = dict(zip(("detector", "mag", "scale", "series", "index"), key, strict=True))
    for depth in DEPTHS:
        signal = transits(len(motion), depth)
        observation = simulate(star.replace(signal=signal), detector, motion, seed=seed)
        tpf = observation.to_tpf()
        corrector = PLDCorrector(tpf)
        corrector.correct(order=options.order, transit_mask=signal < 1)
        name = f"{1e6 * depth:.0f}"
        if depth == DEPTHS[0]:
            row |= noise_scores(corrector, observation, signal)
            if not options.no_lightkurve:
                row["best_lightkurve"] = best_of_lightkurve(tpf, corrector, signal)
        if not options.no_transits:
            row |= depth_scores(corrector, signal, name, options)
        else:
            break
    return row


def noise_scores(corrector, observation, signal):
    mask = corrector.aperture_mask
    expected = observation.model()[:, mask].sum(axis=1)
    noise = (observation.flux[:, mask].sum(axis=1) - expected) / np.median(expected)
    scores = {k: float(v) for k, v in vars(score(corrector, signal, noise)).items()}
    means, errors, _ = corrector.held_out()
    known = errors < 1.5 * np.median(errors)
    scores["held_out_known_rms"] = scores["held_out_rms"] * np.std(means[known]) / np.std(means)
    scores["windows_unknown"] = float(np.mean(~known))
    lc = corrector.corrected_lc
    good = np.isfinite(lc.flux.value)
    corrected = lc.flux.value[good] / signal[good]
    for method in CONVENTIONS:
        scores[f"cdpp_{method}"] = cdpp(corrected, method=method)
        scores[f"raw_{method}"] = cdpp(
            corrector.original_lc.flux.value[good] / signal[good], method=method
        )
    return scores | {"pixels": int(mask.sum()), "survival": corrector.result.transit_survival}


def best_of_lightkurve(tpf, corrector, signal):
    """Return the lowest CDPP of orders 1 to 3, in our aperture and in lightkurve's own."""
    best = {}
    for setting in LIGHTKURVE_CORRECTORS["lightkurve_pld"]:
        flux = correct("lightkurve_pld", setting, tpf, corrector.aperture_mask, signal == 1)
        for method in CONVENTIONS if flux is not None else ():
            found = cdpp(flux / signal, method=method)
            best[method] = min(best.get(method, np.inf), found)
    return best


def depth_scores(corrector, signal, name, options):
    """Return measured over true depth, and its error: masked, jointly fitted, unmasked."""
    scale, error = corrector.fit_transit(signal)
    row = {f"masked_{name}": scale, f"masked_{name}_err": error}
    corrector.correct(order=options.order, transit_model=signal)
    result = corrector.result
    row |= {f"joint_{name}": result.transit_scale, f"joint_{name}_err": result.transit_scale_err}
    corrector.correct(order=options.order)
    lc = corrector.corrected_lc
    flux, weight = lc.flux.value / np.nanmedian(lc.flux.value), lc.flux_err.value**-2.0
    outside, inside = (np.average(flux[s], weights=weight[s]) for s in (signal == 1, signal < 1))
    return row | {f"unmasked_{name}": (outside - inside) / (1 - signal.min())}


def keys(options):
    """Return the stars of the grid, so that any beginning of it is a sample of all."""
    cells = itertools.product(
        range(options.first, options.first + options.stars),
        options.scales,
        options.detectors,
        options.series,
        options.mags,
    )
    return [(detector, mag, scale, series, k) for k, scale, detector, series, mag in cells]


def read(path):
    if not path.exists():
        return []
    return [json.loads(line) for line in path.read_text().splitlines()]


def run(options):
    done = {
        (r["detector"], r["mag"], r["scale"], r["series"], r["index"]) for r in read(options.output)
    }
    missing = [key for key in keys(options) if key not in done]
    with options.output.open("a") as file:
        for key in tqdm(missing, unit="star"):
            file.write(json.dumps(run_star(key, options)) + "\n")
            file.flush()


def column(rows, name):
    return np.array([row[name] for row in rows if name in row])


def report(rows):
    """Print the tables."""
    print(f"{len(rows)} stars\n")
    print(
        "motion    n   held-out: MAD    rms  rms, known windows  pull"
        "   residual: lk  everest  largest cell"
    )
    for scale in SCALES:
        part = [row for row in rows if row["scale"] == scale]
        if part:
            print_scale(scale, part)
    print_exceptions(rows)
    print_depths(rows)
    print_lightkurve(rows)


def print_scale(scale, rows):
    cells = {}
    for row in rows:
        cells.setdefault((row["detector"], row["mag"]), []).append(row)
    largest = max(
        np.median(column(cell, f"residual_{m}")) for cell in cells.values() for m in CONVENTIONS
    )
    names = ("held_out_mad", "held_out_rms", "held_out_known_rms", "held_out_pull",
             "residual_lightkurve", "residual_everest")  # fmt: skip
    mad, rms, known, pull, lk, everest = (np.median(column(rows, name)) for name in names)
    print(f"{scale:4d}x {len(rows):5d} {mad:14.3f} {rms:6.2f} {known:19.2f} {pull:5.2f}"
          f" {lk:14.3f} {everest:8.3f} {largest:13.3f}")  # fmt: skip


def print_exceptions(rows):
    """Print how many stars and cells do not reach what the corrector is made for."""
    cells = {}
    for row in rows:
        cells.setdefault(tuple(row[k] for k in ("detector", "mag", "scale", "series")), []).append(
            max(row["residual_lightkurve"], row["residual_everest"])
        )
    stars = np.concatenate(list(cells.values()))
    high = np.sum([np.median(cell) > LARGEST_RESIDUAL for cell in cells.values()])
    print(f"\nresidual CDPP, the larger of both conventions: above {LARGEST_RESIDUAL} in "
          f"{np.sum(stars > LARGEST_RESIDUAL)} of {len(stars)} stars, largest {stars.max():.2f}; "
          f"median of the cell in {high} of {len(cells)} cells")  # fmt: skip
    ratio = column(rows, "held_out_rms") / column(rows, "held_out_mad")
    print(f"held-out rms above 1.5 MAD in {np.sum(ratio > 1.5)} of {len(rows)} stars")


def print_depths(rows):
    for name in ("1000", "200"):
        rows_ = [row for row in rows if f"masked_{name}" in row]
        if not rows_:
            continue
        print(f"\ntransits of {name} ppm: measured over true depth, standard deviation of pulls")
        for low, high in ((10, 13), (13.5, 15.5)):
            part = [row for row in rows_ if low <= row["mag"] <= high]
            if not part:
                continue
            cells = []
            for how in ("masked", "joint"):
                values, errors = column(part, f"{how}_{name}"), column(part, f"{how}_{name}_err")
                mean = np.average(values, weights=errors**-2.0)
                sigma = np.sum(errors**-2.0) ** -0.5
                pull = np.std((values - 1) / errors)
                cells.append(f"{how} {mean:.4f} +- {sigma:.4f}, pulls {pull:.3f}")
            unmasked, error = column(part, f"unmasked_{name}"), column(part, f"masked_{name}_err")
            cells.append(f"unmasked {np.average(unmasked, weights=error**-2.0):.3f}")
            print(f"  Kp {low:g} to {high:g}: " + "; ".join(cells))


def print_lightkurve(rows):
    rows = [row for row in rows if row.get("best_lightkurve")]
    if not rows:
        return
    print("\nresidual CDPP of the best of lightkurve's orders 1 to 3 over ours")
    for method in CONVENTIONS:
        ratio = np.array([r["best_lightkurve"][method] / r[f"cdpp_{method}"] for r in rows])
        bright = np.array([r["mag"] <= 12 and r["scale"] >= 5 for r in rows])
        extra = (
            f", median {np.median(ratio[bright]):.2f} at 5x, 10x, Kp <= 12" if bright.any() else ""
        )
        print(f"  {method} convention: ours lower in {100 * np.mean(ratio > 1):.1f} % of stars, "
              f"median {np.median(ratio):.2f}{extra}")  # fmt: skip


def draw(rows, path):
    """Draw held-out scatter and residual CDPP against magnitude."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 3, figsize=(12, 4), layout="constrained")
    titles = ("Held-out MAD", "Residual CDPP, EVEREST", "CDPP, EVEREST; x: lightkurve's best")
    labels = ("in units of the noise's", "in units of the noise's", "CDPP (ppm)")
    for scale, shade, marker in zip(SCALES, ("0.65", "0.45", "0.25", "0"), "o^sD", strict=True):
        part = [row for row in rows if row["scale"] == scale]
        mags = sorted({row["mag"] for row in part})
        cells = [[row for row in part if row["mag"] == mag] for mag in mags]
        style = {"color": shade, "marker": marker, "ms": 4, "label": f"{scale}x"}
        axes[0].plot(mags, [np.median(column(c, "held_out_mad")) for c in cells], **style)
        axes[1].plot(mags, [np.median(column(c, "residual_everest")) for c in cells], **style)
        axes[2].semilogy(mags, [np.median(column(c, "cdpp_everest")) for c in cells], **style)
        best = [
            [r["best_lightkurve"]["everest"] for r in c if r.get("best_lightkurve")] for c in cells
        ]
        if all(best):
            axes[2].semilogy(mags, [np.median(b) for b in best], "x", color=shade, ms=5)
    for ax, title, label in zip(axes, titles, labels, strict=True):
        ax.set(title=title, xlabel="Kp (mag)", ylabel=label)
    axes[0].legend(title="motion")
    figure.savefig(path, dpi=120)


def parse(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument(
        "--data",
        type=Path,
        default=Path("../shared/data/poscorr"),
        metavar="FOLDER",
        help="folder of the light-curve files with the motions",
    )
    parser.add_argument(
        "--output", type=Path, required=True, metavar="FILE", help="one line per star"
    )
    parser.add_argument("--mags", type=float, nargs="+", default=MAGNITUDES)
    parser.add_argument("--scales", type=int, nargs="+", default=SCALES)
    parser.add_argument("--detectors", nargs="+", choices=DETECTORS, default=DETECTORS)
    parser.add_argument("--series", nargs="+", choices=tuple(SERIES), default=tuple(SERIES))
    parser.add_argument("--stars", type=int, default=5, help="stars per cell (default: 5)")
    parser.add_argument("--first", type=int, default=0, help="number of a cell's first star")
    parser.add_argument("--cadences", type=int, default=1000, help="(default: 1000)")
    parser.add_argument("--order", type=int, default=2, help="(default: 2)")
    parser.add_argument("--no-transits", action="store_true", help="do not measure depths")
    parser.add_argument("--no-lightkurve", action="store_true", help="do not compare")
    parser.add_argument("--report", action="store_true", help="print the tables, and run nothing")
    parser.add_argument("--figure", type=Path, metavar="FILE", help="draw, and run nothing")
    return parser.parse_args(arguments)


def main(arguments=None):
    options = parse(arguments)
    warnings.filterwarnings("ignore", ".*tpfmodel submodule is not available", UserWarning)
    if not (options.report or options.figure):
        run(options)
    rows = read(options.output)
    if options.figure:
        draw(rows, options.figure)
    report(rows)


if __name__ == "__main__":
    main()
