"""Record a corrector's scores on the messy sky, and compare two records.

    python studies/record.py new.ecsv --seeds 2001-2002 --positions wrong,exact
    python studies/record.py old.ecsv --tree ../other-checkout
    python studies/record.py new.ecsv --against docs/data/record_19e5c3d.ecsv

Each star is corrected three times: as it is, with another draw of its noise, and without its
transits (with transits of 6 h and ten floors where it has none), by the scope_models of ``--tree``;
this checkout makes and scores the stars. Rows are added to ``new.jsonl``, and a second call
continues. ``--method`` is "pld", the corrector, or "raw", the sum over the file's aperture.

Stars with neighbors are compared with the truth of the amplitude that the curve has, for it may
hold the neighbors' light; ``amplitude`` and ``undiluted`` compare with the star's own truth.
Leaks are slopes of the corrected over the true flux on the true width (ppm per 0.1 %), x and y
(ppm per 0.01 px), background (ppm per e-/s per pixel) and time (ppm per 10 d).
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
import warnings
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from itertools import product
from pathlib import Path

import numpy as np

if "--serve" not in sys.argv:  # the process of the corrector has the names of its own checkout
    from astropy.table import Table, join

    from scope_models.benchmark import REGIMES, make_sky
    from scope_models.benchmark.files import binned, outliers, score_light_curve, slope

NUISANCES = {"width": 1e-3, "x": 0.01, "y": 0.01, "background": 1.0, "drift": 10.0}
KEY = ("regime", "seed", "positions")
COLUMNS = ("cadenceno", "flux", "flux_err")
SCORES = ("full", "high_passed")
CADENCES, FEWEST = 1500, 100
# Shares and correlation times (days) of the slow noise of leaks.
SHARES, SCALES = (0.0, 0.2, 0.5, 0.8, 0.95, 0.99), (0.5, 1.0, 2.0, 4.0, 8.0, 16.0)


# In the process of the corrector.


def serve(method):
    """Correct the files that the lines of standard input name, a line of results for each."""
    for line in sys.stdin:
        paths, source = json.loads(line)
        found = [corrected(path, source, method) for path in paths]
        sys.__stdout__.write(json.dumps(found) + "\n")
        sys.__stdout__.flush()


def corrected(path, source, method):
    """Return the light curve of a file, its processor time, and warnings or the error."""
    import lightkurve

    from scope_models.correctors import PLDCorrector

    kind = lightkurve.TessTargetPixelFile if source == "TESS" else lightkurve.KeplerTargetPixelFile
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        tpf = kind(path)
        del caught[:]
        begin = time.process_time()
        try:
            raw = method == "raw"
            lc = tpf.to_lightcurve(aperture_mask="pipeline") if raw else PLDCorrector(tpf).correct()
        except Exception as error:  # noqa: BLE001 - each exception is a result
            return {"error": f"{type(error).__name__}: {error}"}
        seconds = time.process_time() - begin
    ours = [str(w.message) for w in caught if w.category.__module__.startswith("scope_models")]
    columns = {
        name: np.ma.filled(np.ma.asarray(getattr(lc[name], "value", lc[name]), float), np.nan)
        for name in COLUMNS
    }
    return {"seconds": seconds, "warnings": ours} | {k: v.tolist() for k, v in columns.items()}


# In the process that makes and scores the stars.

_WORKER = []


def start(tree, method):
    """Start the process of the corrector."""
    paths = os.pathsep.join([str(tree), os.environ.get("PYTHONPATH", "")])
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    command = [sys.executable, "-u", Path(__file__), "--serve", "--method", method]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    environment = os.environ | threads | {"PYTHONPATH": paths}
    _WORKER[:] = [subprocess.Popen(command, **pipes, env=environment)]


def ask(paths, mission):
    """Return what the corrector finds in files."""
    _WORKER[0].stdin.write(json.dumps([paths, mission]) + "\n")
    _WORKER[0].stdin.flush()
    line = _WORKER[0].stdout.readline()
    if not line:
        raise RuntimeError("the process of the corrector has ended")
    return json.loads(line)


def run(task):
    """Return the row of a star."""
    name, seed, positions = task
    regime = REGIMES[name]
    options = {"n_cadences": CADENCES, "positions": None if positions == "wrong" else positions}
    sky = make_sky(regime, seed, **options)
    if regime.depth:
        other = regime.replace(depth=0.0)
    else:
        per_bin = max(round(13 * 0.0204 / regime.cadence), 1)  # 6.5 h
        depth = float(np.clip(10 * sky.floor() / np.sqrt(per_bin), 1e-4, 0.1))
        other = regime.replace(depth=depth, duration=0.25)
    stars = [sky, make_sky(regime, seed, noise_seed=1, **options), make_sky(other, seed, **options)]
    with tempfile.TemporaryDirectory() as folder:
        paths = [str(Path(folder) / f"{i}.fits") for i in range(3)]
        for star, path in zip(stars, paths, strict=True):
            star.to_tpf(quality_bitmask="none").hdu.writeto(path)
        found = ask(paths, regime.mission)
    lights = sky.star_light, sky.neighbor_light
    own, others = (float(light[:, sky.aperture].sum()) for light in lights)
    row = dict(zip(KEY, task, strict=True)) | {
        "apart": regime.apart, "magnitude": regime.magnitude, "scale": regime.scale,
        "neighbors": len(regime.neighbors), "share": own / (own + others),
    }  # fmt: skip
    return row | rows_of(stars, found)


def rows_of(stars, found):
    """Return the scores of a star by its three corrections."""
    sky, _, other = stars
    row = {"error": next((one["error"] for one in found if "error" in one), "")}
    lc = sky.to_tpf().to_lightcurve(aperture_mask="pipeline")
    uncorrected = curve(sky, *(lc[name].value for name in COLUMNS))
    raw = compared(sky, *uncorrected)[0]
    row |= {"raw_full": raw.full, "raw_high_passed": raw.high_passed, "floor": raw.floor}
    if row["error"]:
        return row
    curves = [curve(sky, *(one[name] for name in COLUMNS)) for one in found]
    fluxes = [flux for flux, _ in curves]
    if min(np.isfinite(flux).sum() for flux in fluxes) < FEWEST:
        return row | {"error": f"fewer than {FEWEST} cadences have a flux"}
    row["seconds"] = float(np.median([one["seconds"] for one in found]))
    row["warnings"] = len(found[0]["warnings"])
    row["warning"] = " | ".join(text[:90] for text in found[0]["warnings"])
    cadences = sky.regime.cadence * np.arange(len(sky.time))
    seen, truth = compared(sky, *curves[0])
    kept = np.isfinite(fluxes[0]).sum() / np.isfinite(uncorrected[0]).sum()
    row |= asdict(seen) | {"kept": float(kept)}
    if sky.regime.neighbors:
        own = compared(sky, *curves[0], dilute=False)[0]
        row |= {"amplitude": own.amplitude, "depth": own.depth, "undiluted": own.full}
    transits = 0 if sky.regime.depth else 2
    star, flux, without = stars[transits], fluxes[transits], fluxes[2 - transits]
    relative = curves[0][1] / np.nanmedian(fluxes[0])
    ratio = deviation_of(flux, without * star.transit)
    row["rest_change"] = float(np.sqrt(np.nanmean((ratio / relative)[star.transit == 1] ** 2)))
    row["injected"] = max(sky.regime.depth, other.regime.depth)
    row["depth_kept"] = depth_difference(flux, without, star.true_flux, star.transit)
    first, second = (deviation_of(flux, truth) for flux in fluxes[:2])
    both = np.isfinite(first - second)
    if both.sum() < FEWEST:
        return row
    _, means, count = binned(cadences[both], (first - second)[both])
    rms = np.sqrt(np.average((means - np.average(means, weights=count)) ** 2, weights=count))
    row["noise_rms"] = float(1e6 * rms / np.sqrt(2) / raw.floor)
    light = sky.background_light.mean(axis=(1, 2))
    nuisances = np.array([sky.width, sky.x, sky.y, light, cadences])
    units = np.array(list(NUISANCES.values()))[:, None]
    slopes, slope_errors = leak_slopes(cadences, 1e6 * first, nuisances / units)
    for name, slope, error in zip(NUISANCES, slopes, slope_errors, strict=True):
        row |= {f"leak_{name}": float(slope), f"leak_{name}_error": float(error)}
    return row


def curve(sky, cadenceno, flux, flux_err):
    """Return flux and errors in all cadences of a star, NaN where there is none."""
    values = np.full((2, len(sky.time)), np.nan)
    values[:, np.asarray(cadenceno, int) - 1] = flux, flux_err
    return values


def compared(sky, flux, error, *, dilute=True):
    """Return the score of a curve, and the truth that it is compared with."""
    truth = sky.true_flux
    if sky.regime.neighbors and dilute:
        truth = diluted(flux, truth)
    read = np.isfinite(flux)
    cadences = sky.regime.cadence * np.arange(len(flux))
    columns = (cadences, flux, error, truth, sky.transit)
    return score_light_curve(*(column[read] for column in columns), sky.floor()), truth


def diluted(flux, truth):
    """Return the truth with the amplitude that the flux has: light of neighbors may stay in it."""
    good = np.isfinite(deviation_of(flux, truth))
    if truth[good].std() < 1e-9:
        return truth
    return 1 + slope(flux[good], truth[good]) * (truth / truth[good].mean() - 1)


def deviation_of(flux, truth):
    """Return the flux over the truth and its median, less 1; NaN for outliers."""
    good = np.flatnonzero(np.isfinite(flux / truth))
    deviation = np.full(len(flux), np.nan)
    ratio = flux[good] / truth[good]
    one = ratio / np.median(ratio) - 1
    fine = ~outliers(one)
    deviation[good[fine]] = one[fine]
    return deviation


def depth_difference(flux, without, truth, transit):
    """Return the part of a transit's depth that is kept: the difference of two runs.

    `flux` has the transits, `without` is of the same star and noise without them; `truth` has them.
    """
    alone = truth / transit
    columns = [one / np.nanmedian((one / alone)[transit == 1]) for one in (flux, without, truth)]
    seen, expected = columns[0] - columns[1], columns[2] - alone
    good = np.isfinite(seen)
    seen, expected = seen[good] - seen[good].mean(), expected[good] - expected[good].mean()
    return float(seen @ expected / (expected @ expected)) if expected.any() else float("nan")


def leak_slopes(time, deviation, nuisances):
    """Return slopes of the deviation's 6.5-h means on all nuisances together, and their errors.

    The noise of the means is white and an exponentially correlated process; their shares and the
    correlation time maximize the restricted likelihood. A nuisance that is constant has NaN.
    """
    good = np.isfinite(deviation) & np.isfinite(nuisances).all(axis=0)
    time, means, count = binned(time[good], np.array([deviation, *nuisances])[:, good])
    slopes = np.full((2, len(nuisances)), np.nan)
    if len(time) <= len(means) + 2:
        return slopes
    target, columns = means[0], means[1:] - means[1:].mean(axis=1, keepdims=True)
    sizes = columns.std(axis=1)
    changing = sizes > 1e-9
    scaled = columns[changing] / sizes[changing, None]
    design = np.column_stack([np.ones(len(time)), *scaled])
    white, lag = count.max() / count, np.abs(time[:, None] - time)
    best = np.inf
    for share, scale in product(SHARES, SCALES):
        root = np.linalg.cholesky(np.diag((1 - share) * white) + share * np.exp(-lag / scale))
        left, right = np.linalg.solve(root, design), np.linalg.solve(root, target)
        inverse = np.linalg.pinv(left.T @ left, hermitian=True)
        found = inverse @ left.T @ right
        square = np.sum((right - left @ found) ** 2) / (len(time) - design.shape[1])
        cost = (len(time) - design.shape[1]) * np.log(square) + 2 * np.log(np.diag(root)).sum()
        cost += np.linalg.slogdet(left.T @ left)[1]
        if cost < best:
            best, chosen = cost, (found, np.sqrt(square * np.diag(inverse)))
    slopes[:, changing] = np.array(chosen)[:, 1:] / sizes[changing]
    return slopes


def whole(table):
    """Return the numbers of a whole sky, as pairs of a text and a value."""
    alone = table[~np.asarray(table["apart"], bool)]
    failed = np.array([bool(error) for error in alone["error"]])
    stars = alone[~failed]
    col = {name: np.asarray(stars[name]) for name in stars.colnames}
    wrong_error = (col["pull"] < 0.7) | (col["pull"] > 1.5)
    bad = (col["full"] > 1.1 * col["raw_full"]) | (col["full"] > 5) | wrong_error
    warned = col["warnings"] > 0
    pulls = np.concatenate([col[f"leak_{n}"] / col[f"leak_{n}_error"] for n in NUISANCES])
    pulls = pulls[np.isfinite(pulls)]
    single = np.isfinite(col["amplitude"]) & (col["neighbors"] == 0)
    beside = np.isfinite(col["amplitude"]) & (col["neighbors"] > 0)
    kept = (col["amplitude"] > 0.99 * col["share"]) & (col["amplitude"] < 1.01)
    fast = col["scale"] >= 10
    deep = np.where(col["neighbors"] > 0, col["depth_kept"] / col["share"], col["depth_kept"])
    fine = col["full"] < 3
    return {
        "stars": len(alone),
        "exceptions": int(failed.sum()),
        "full score, median": np.median(col["full"]),
        "high-passed score, median": np.median(col["high_passed"]),
        "above 1.1 raw (goal 0.02)": np.mean(col["full"] > 1.1 * col["raw_full"]),
        "above 5 floors (0.10)": np.mean(col["full"] > 5),
        "pull outside 0.7-1.5 (0.10)": np.mean(wrong_error),
        "of these three with a warning (1)": mean(warned[bad]),
        "of the others with a warning (0.10)": mean(warned[~bad]),
        "leaks within 2 errors (0.95)": mean(np.abs(pulls) < 2),
        "leak of width, ppm per 0.1 %, median": np.nanmedian(np.abs(col["leak_width"])),
        "amplitude within 1 %, single stars (1)": mean(np.abs(col["amplitude"] - 1)[single] < 0.01),
        "amplitude between diluted and true, neighbors (1)": mean(kept[beside]),
        "depth kept above 0.97, up to 5x (0.95)": mean(deep[~fast] > 0.97),
        "depth kept above 0.90, 10x (0.95)": mean(deep[fast] > 0.9),
        "curve outside of transits with and without them, errors, 90 % (0.3)":
            np.nanquantile(col["rest_change"], 0.9),
        "another draw of noise, median where full < 3 (1.4)": np.median(col["noise_rms"][fine]),
        "another draw of noise, worst where full < 3 (2.5)": max(col["noise_rms"][fine], default=0),
        "processor seconds, median": np.median(col["seconds"]),
        "processor seconds, worst": np.max(col["seconds"]),
    }  # fmt: skip


def mean(values):
    return float(np.mean(values)) if len(values) else float("nan")


def regimes(table):
    """Yield positions, regime, marked if it is scored apart, and rows of each."""
    for positions in sorted(set(table["positions"])):
        for regime in dict.fromkeys(table["regime"]):
            rows = table[(table["positions"] == positions) & (table["regime"] == regime)]
            if len(rows):
                yield positions, regime + "*" * bool(rows["apart"][0]), rows


def medians(table):
    """Print medians per regime, and the numbers of the whole sky."""
    names = ("full", "high_passed", "pull", "amplitude", "depth_kept", "noise_rms", "leak_width")
    names = (*names, "raw_full", "seconds")
    print(f"{'regime':32}{'positions':10}" + "".join(f"{name[:10]:>11}" for name in names))
    for positions, regime, rows in regimes(table):
        failed = sum(bool(error) for error in rows["error"])
        text = "".join(f"{np.median(rows[name]):11.3f}" for name in names)
        print(f"{regime:32}{positions:10}{text}" + f"  {failed} failed" * bool(failed))
    for positions in sorted(set(table["positions"])):
        print(positions)
        for text, value in whole(table[table["positions"] == positions]).items():
            print(f"    {text:52}{value:10.3f}")


def against(table, base):
    """Print a table beside a base, per regime and as a whole; only stars of both."""
    keys = join(table[list(KEY)], base[list(KEY)], KEY)
    table, base = (join(keys, each, KEY) for each in (table, base))  # sorted alike
    print(f"{'ratios of medians':32}{'positions':10}{'full':>8}{'high':>8}{'new':>10}{'base':>10}")
    for (positions, regime, new), (*_, old) in zip(regimes(table), regimes(base), strict=True):
        medians = [[np.median(rows[name]) for rows in (new, old)] for name in SCORES]
        full, high = (new / old for new, old in medians)
        line = f"{regime:32}{positions:10}{full:8.2f}{high:8.2f}{medians[0][0]:10.2f}"
        print(f"{line}{medians[0][1]:10.2f}" + "  worse" * bool(full > 1.2 or high > 1.2))
    for positions in sorted(set(table["positions"])):
        pair = [each[each["positions"] == positions] for each in (table, base)]
        new, old = (each[~np.asarray(each["apart"], bool)] for each in pair)
        for name in (*SCORES, "seconds"):
            each = np.asarray(new[name]) / np.asarray(old[name])
            print(
                f"{positions}: {name}: ratio of medians "
                f"{np.median(new[name]) / np.median(old[name]):.3f}, median of ratios "
                f"{np.nanmedian(each):.3f}, better than 0.9 {np.mean(each < 0.9):.2f}, worse than "
                f"1.1 {np.mean(each > 1.1):.2f}"
            )
        new, old = (whole(each) for each in pair)
        for text, value in new.items():
            print(f"    {text:52}{value:10.3f}{old[text]:10.3f}")
    print("* scored apart: slow variability under slow motion")


def seeds(text):
    """Return the seeds of a text as 0-3 or 1,5."""
    first, _, last = text.partition("-")
    return list(range(int(first), int(last) + 1)) if last else [int(s) for s in text.split(",")]


def record(options):
    """Compute the missing rows and write the table."""
    lines = options.output.with_suffix(".jsonl")
    rows = [json.loads(line) for line in lines.read_text().splitlines()] if lines.exists() else []
    done = {tuple(row[name] for name in KEY) for row in rows}
    chosen = [name for name in REGIMES if name.startswith(tuple(options.regimes.split(",")))]
    tasks = [
        (name, seed, positions)
        for positions, seed, name in product(options.positions.split(","), options.seeds, chosen)
        if (positions == "wrong" or REGIMES[name].positions != "none")
        and (name, seed, positions) not in done
    ]
    arguments = (options.tree.resolve(), options.method)
    with ProcessPoolExecutor(options.workers, initializer=start, initargs=arguments) as pool:
        for task, row in zip(tasks, pool.map(run, tasks), strict=True):
            rows.append(row)
            with lines.open("a") as file:
                file.write(json.dumps(row) + "\n")
            print(*task, *(f"{row.get(name, np.nan):.2f}" for name in SCORES), flush=True)
    names = dict.fromkeys(name for row in rows for name in row)  # rows need not have all of them
    empty = dict.fromkeys(("regime", "positions", "error", "warning"), "")
    table = Table({n: [row.get(n, empty.get(n, np.nan)) for row in rows] for n in names})
    git = ["git", "-C", str(arguments[0]), "rev-parse", "--short", "HEAD"]
    version = subprocess.run(git, capture_output=True, text=True, check=False).stdout.strip()
    table.meta |= {
        "version": version, "date": time.strftime("%Y-%m-%d"), "method": options.method,
        "command": "python studies/record.py " + options.command, "cadences": CADENCES,
    }  # fmt: skip
    for name in table.colnames:
        if table[name].dtype.kind == "f":
            table[name] = [float(f"{value:.5g}") for value in table[name]]
    table.write(options.output, overwrite=True)
    return table


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("output", nargs="?", type=Path, help="table (ECSV); continued if it exists")
    parser.add_argument("--against", type=Path, help="table to compare with")
    parser.add_argument("--regimes", default="", help="beginnings of names, comma-separated")
    parser.add_argument("--seeds", default="2001-2002", type=seeds, help="as 0-3 or 1,5")
    parser.add_argument("--positions", default="wrong", help="wrong, exact, none, comma-separated")
    parser.add_argument("--method", default="pld", choices=("pld", "raw"))
    parser.add_argument("--tree", default=Path(__file__).parents[1], type=Path, help="checkout")
    parser.add_argument("--workers", default=1, type=int)
    parser.add_argument("--show", action="store_true", help="compute nothing more")
    parser.add_argument("--serve", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.serve:
        return serve(options.method)
    if options.output is None:
        parser.error("the following arguments are required: output")
    words = (word for word in sys.argv[1:] if word not in {str(options.tree), "--tree"})
    options.command = " ".join(Path(word).name if "/" in word else word for word in words)
    table = Table.read(options.output) if options.show else record(options)
    return against(table, Table.read(options.against)) if options.against else medians(table)


if __name__ == "__main__":
    main()
