"""Store what the pages show of the study "motion": ``python docs/data/store_motion.py RESULTS``.

RESULTS is the directory of ``python studies/paper/motion.py --directory RESULTS``. Written are,
beside this file, the summary and the tables of the page on the paper.
"""

import csv
import sys
from pathlib import Path

import numpy as np
from _stamp import stamp
from astropy.table import Table

FOLDER = Path(__file__).parent
CORRECTORS = {
    "pld": "ours",
    "lightkurve_pld": "lightkurve's PLD",
    "lightkurve_sff": "lightkurve's SFF",
}


#: Multiple of the motion, faintest magnitude, and ppm (None: as Kepler) of the paper's claims.
CLAIMS = {
    "2x is Kepler-like to Kp 13": (2, 13, None),
    "2x is below 200 ppm to Kp 15": (2, 15, 200),
    "5x is below 400 ppm to Kp 14.5 (caption)": (5, 14.5, 400),
    "5x is below 400 ppm to Kp 15.5": (5, 15.5, 400),
    "10x is below 1000 ppm": (10, 15.5, 1000),
}


def claims(summary):
    """Return one row per claim: the bin nearest to its limit, and each corrector's CDPP there."""
    rows = [["claim", "limit (ppm)", "at Kp", *(f"{name} (ppm)" for name in CORRECTORS.values())]]
    for name, (scale, faintest, ppm) in CLAIMS.items():
        bins = summary[(summary["scale"] == scale) & (summary["mag"] <= faintest)]
        limit = np.array(bins["kepler_median"]) if ppm is None else np.full(len(bins), float(ppm))
        worst = np.argmax(bins["pld_everest"] / limit)
        cells = [f"{bins[f'{key}_everest'][worst]:.3g}" for key in CORRECTORS]
        rows.append([name, f"{limit[worst]:.4g}", f"{bins['mag'][worst]:g}", *cells])
    return rows


def noise(summary):
    """Return one row per magnitude: Kepler, ours at each multiple, and lightkurve's at the last."""
    scales = sorted(set(summary["scale"]))
    header = ["Kp", "Kepler 50 %", "Kepler 10 %", *(f"ours {s:g}x" for s in scales)]
    rows = [[*header, *(f"{name} {scales[-1]:g}x" for name in ("PLD", "SFF"))]]
    for mag in sorted(set(summary["mag"])):
        part = {row["scale"]: row for row in summary[summary["mag"] == mag]}
        first = part[scales[0]]
        values = [first["kepler_median"], first["kepler_p10"]]
        values += [part[s]["pld_everest"] for s in scales]
        for name in ("lightkurve_pld", "lightkurve_sff"):
            values.append(part[scales[-1]][f"{name}_everest"])
        rows.append([f"{mag:g}", *(f"{value:.3g}" for value in values)])
    return rows


def survival(survived):
    """Return one row per corrector: which part of a transit's depth is left."""
    rows = [["corrector", "median", "16 % to 84 %"]]
    for name, title in CORRECTORS.items():
        median, low, high = (
            f"{100 * survived[name][key]:.0f} %" for key in ("median", "low", "high")
        )
        rows.append([title, median, f"{low} to {high}"])
    return rows


def tables(summary):
    """Return the rows of all tables by their names."""
    return {
        "claims": claims(summary),
        "noise": noise(summary),
        "survival": survival(summary.meta["survival"]),
    }


def main(results):
    """Write the tables."""
    summary = Table.read(Path(results, "summary.ecsv"))
    for name in summary.colnames:
        if summary[name].dtype.kind == "f":
            summary[name][:] = [float(f"{value:.5g}") for value in np.array(summary[name])]
    stamp(summary, "python studies/paper/motion.py")
    summary.write(FOLDER / "motion.ecsv", overwrite=True)
    for name, rows in tables(summary).items():
        with (FOLDER / f"motion_{name}.csv").open("w", newline="", encoding="utf-8") as file:
            csv.writer(file, lineterminator="\n").writerows(rows)


if __name__ == "__main__":
    main(sys.argv[1])
