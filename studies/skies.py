"""Compare correctors on the messy test sky: medians per regime and the worst star.

    python studies/skies.py --methods raw,lightkurve,pld --regimes k2-1x,kepler --seeds 0-1

Regimes are chosen by the beginnings of their names. lightkurve's PLDCorrector gets the best of its
orders 1 to 3 and of two apertures (the file's and the whole stamp), chosen by the truth for each
score alone: no user could do better. Scores are in floors; see `scope_models.benchmark`.
"""

import argparse
import sys
import time
import warnings
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from itertools import product

import numpy as np
from paper._correctors import LIGHTKURVE_CORRECTORS
from paper._correctors import correct as correct_by_lightkurve

from scope_models.benchmark import REGIMES, make_sky, score

COLUMNS = ("full", "high_passed", "amplitude", "depth", "pull", "kept", "seconds")


def raw(tpf, sky):
    return score(tpf.to_lightcurve(aperture_mask="pipeline"), sky)


def pld(tpf, sky):
    from scope_models.correctors import PLDCorrector

    return score(PLDCorrector(tpf).correct(), sky)


def scene(tpf, sky):
    from scope_models.correctors import SceneCorrector

    return score(SceneCorrector(tpf).correct(), sky)


def lightkurve(tpf, sky):
    lc = tpf.to_lightcurve(aperture_mask="pipeline")
    found = []
    for setting in LIGHTKURVE_CORRECTORS["lightkurve_pld"]:
        flux = correct_by_lightkurve(
            "lightkurve_pld", setting, tpf, np.ones(sky.regime.shape, bool)
        )
        if flux is not None:
            lc.flux = flux * lc.flux.unit
            found.append(asdict(score(lc, sky)))
    if not found:
        raise ValueError("lightkurve failed in all settings")
    best = dict(min(found, key=lambda one: one["full"]))
    best["high_passed"] = min(one["high_passed"] for one in found)
    return best


def chosen(tpf, sky):
    """Return the scores of the corrector that the rule chooses, and its name on standard error."""
    from scope_models.correctors import choose_corrector

    corrector = choose_corrector(tpf)
    print(f"# {sky.regime.name} {sky.seed}: {type(corrector).__name__}", file=sys.stderr)
    return score(corrector.corrected_lc, sky)


METHODS = {"raw": raw, "lightkurve": lightkurve, "pld": pld, "scene": scene, "chosen": chosen}


def run(task):
    """Return the scores of one star by all methods."""
    name, seed, n_cadences, methods = task
    sky = make_sky(name, seed, n_cadences=n_cadences)
    tpf = sky.to_tpf()
    rows = []
    for method in methods:
        begin = time.perf_counter()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                found = METHODS[method](tpf, sky)
            except (ValueError, np.linalg.LinAlgError) as error:
                print(f"# {name} {seed} {method}: {error}", file=sys.stderr)
                found = {"full": np.inf, "high_passed": np.inf}
        found = dict(found if isinstance(found, dict) else asdict(found))
        found["seconds"] = time.perf_counter() - begin
        rows.append((name, seed, method, found))
    return rows


def table(rows, methods):
    """Print medians per regime and method, and the worst star."""
    print(f"{'regime':27}{'method':11}" + "".join(f"{c[:9]:>10}" for c in COLUMNS) + "  worst")
    for name, method in product(dict.fromkeys(row[0] for row in rows), methods):
        mine = [row for row in rows if row[0] == name and row[2] == method]
        values = [[row[3].get(column, np.nan) for row in mine] for column in COLUMNS]
        medians = [np.median(v) for v in values]
        worst = max(mine, key=lambda row: row[3]["full"])
        print(
            f"{name:27}{method:11}" + "".join(f"{v:10.3f}" for v in medians)
            + f"  {worst[3]['full']:.1f} (seed {worst[1]})"
        )  # fmt: skip
    summary(rows, methods)


def summary(rows, methods):
    """Print in how many stars each method is worse than raw, and better than lightkurve."""
    stars = {}
    for name, seed, method, found in rows:
        stars.setdefault((name, seed), {})[method] = found
    for method in methods:
        line = f"# {method}: {len(stars)} stars"
        if "raw" in methods:
            worse = [s for s in stars.values() if s[method]["full"] > 1.1 * s["raw"]["full"]]
            line += f", full above 1.1 raw in {len(worse)}"
        if "lightkurve" in methods:
            for column in ("full", "high_passed"):
                less = [s for s in stars.values() if s[method][column] <= s["lightkurve"][column]]
                line += f", {column} not above lightkurve's best in {len(less)}"
        print(line)


def seeds(text):
    """Return the seeds of a text as 0-3 or 1,5."""
    first, _, last = text.partition("-")
    return list(range(int(first), int(last) + 1)) if last else [int(s) for s in text.split(",")]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--regimes", default="", help="beginnings of names, comma-separated")
    parser.add_argument("--seeds", default="0-1", type=seeds, help="as 0-3 or 1,5")
    parser.add_argument("--cadences", default=1100, type=int)
    parser.add_argument("--methods", default="raw,pld", help=", ".join(METHODS))
    parser.add_argument("--processes", default=1, type=int)
    options = parser.parse_args()
    methods = options.methods.split(",")
    unknown = set(methods) - set(METHODS)
    if unknown:
        parser.error(f"unknown methods: {', '.join(sorted(unknown))}")
    names = [name for name in REGIMES if name.startswith(tuple(options.regimes.split(",")))]
    tasks = [(name, seed, options.cadences, methods) for name in names for seed in options.seeds]
    if options.processes > 1:
        with ProcessPoolExecutor(options.processes) as pool:
            rows = [row for part in pool.map(run, tasks) for row in part]
    else:
        rows = [row for task in tasks for row in run(task)]
    table(rows, methods)


if __name__ == "__main__":
    main()
