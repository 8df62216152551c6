"""Store what the page on calibration shows of the studies "no-motion" and "k2-motion".

``python docs/data/store_calibration.py NO_MOTION K2_MOTION GRID``: the results directories of
``studies/paper/no_motion.py`` and ``k2_motion.py``, and the k2_calibration.ecsv of
``studies/paper/calibrate_k2_motion.py``. Written are, beside this file, the summaries, the noise of
the stars at rest, and every other point of the grid.
"""

import csv
import sys
from pathlib import Path

import numpy as np
from _stamp import stamp
from astropy.table import Table

FOLDER = Path(__file__).parent
STARS = ("kp", "detector_cdpp", "cdpp")


def rounded(table):
    """Return a table with four digits of each number."""
    for name in table.colnames:
        if table[name].dtype.kind == "f":
            table[name] = [float(f"{value:.4g}") for value in table[name]]
    return table


def store(table, name, command):
    stamp(table, f"python studies/paper/{command}")
    rounded(table).write(FOLDER / f"{name}.ecsv", format="ascii.ecsv", overwrite=True)


def noise_table(summary):
    """Return one row per magnitude: campaign 3, the paper's sensitivity, the calibrated one."""
    paper, ours = (summary[summary["detector"] == name] for name in ("paper", "calibrated"))
    rows = [["Kp", "C03", "paper", "C03 / paper", "calibrated", "calibrated / C03", "white",
             "losses", "and within pixels", "and between pixels", "lightkurve"]]  # fmt: skip
    for first, second in zip(paper, ours, strict=True):
        error = second["noise_median_error"] / second["k2_median"]
        row = [f"{first['mag']:g}", f"{first['k2_median']:.0f}", f"{first['noise_median']:.0f}",
               f"{1 / first['noise_median_ratio']:.2f}", f"{second['noise_median']:.0f}",
               f"{second['noise_median_ratio']:.2f} ± {error:.2f}"]  # fmt: skip
        names = ("white", "losses", "intrapixel", "systematics", "cdpp_lightkurve")
        rows.append([*row, *(f"{second[name]:.0f}" for name in names)])
    return rows


def main():
    no_motion, k2_motion, grid = (Path(argument) for argument in sys.argv[1:4])
    store(Table.read(no_motion / "summary.ecsv"), "no_motion", "no_motion.py")
    stars = Table.read(no_motion / "results.ecsv")[list(STARS)]
    stars.meta.clear()
    store(stars, "no_motion_stars", "no_motion.py")
    summary = Table.read(k2_motion / "summary.ecsv")
    store(summary, "k2_motion", "k2_motion.py --stars 120 --cadences 3380")
    with (FOLDER / "k2_motion.csv").open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows(noise_table(summary))
    table = Table.read(grid)
    a_2, scatter = (np.unique(table[name])[::2] for name in ("a_2", "scatter"))
    every_other = np.isin(table["a_2"], a_2) & np.isin(table["scatter"], scatter)
    store(table[every_other], "k2_calibration", "calibrate_k2_motion.py")


if __name__ == "__main__":
    main()
