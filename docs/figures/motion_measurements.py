"""Measure the parameters of the roll generator on real K2 files, and print them.

``python docs/figures/motion_measurements.py FOLDER``, where FOLDER has the folders poscorr and
k2_tpf of archive files. Each POS_CORR series is divided by the distance of its star from the
boresight, which gives the roll angle, and that is cut at its jumps into drifts.
"""

import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
from astropy.coordinates import SkyCoord
from astropy.io import fits
from astropy.stats import mad_std
from astropy.table import Table
from motion_series import principal_axes

from scope_models.scene.motion import Motion

# Boresights in degrees: campaign pages of the Kepler & K2 Science Center.
BORESIGHTS = {
    3: (336.6653464, -11.0966638),
    4: (59.0759116, 18.6605794),
    5: (130.1576478, 16.8296140),
    18: (130.1610170, 16.8278629),
}
ARCSEC = 206264.806
PIXEL = 3.98
# Cadences whose step differs by this from the steps around it, in arcsec, hold a reset.
JUMP = 2.2
SHORTEST = 9  # cadences in a drift


def running_median(values, width):
    """Return the median of the values around each of them."""
    padded = np.pad(values, width // 2, mode="edge")
    return np.median(np.lib.stride_tricks.sliding_window_view(padded, width), axis=1)


def white_noise(values):
    """Return the standard deviation of white noise, from second differences."""
    return mad_std(np.diff(values, 2)) / np.sqrt(6)


def drifts(roll):
    """Return begin, length, first and last angle, rate, acceleration and scatter of each drift."""
    steps = np.diff(roll)
    jumps = np.flatnonzero(np.abs(steps - running_median(steps, 9)) > JUMP) + 1
    edges = np.concatenate([[0], jumps, [len(roll)]])
    rows = []
    for first, end in pairwise(edges):
        if end - first < SHORTEST:
            continue
        cadence = np.arange(end - first)
        curve = np.polyfit(cadence, roll[first:end], 2)
        scatter = np.std(roll[first:end] - np.polyval(curve, cadence))
        rows.append(
            (first, end - first, roll[first], roll[end - 1], curve[1], 2 * curve[0], scatter)
        )
    return np.array(rows).T


def measure(path):
    """Return the measured parameters of a file by name."""
    motion = Motion.from_file(path)
    header = fits.getheader(path)
    center = SkyCoord(*BORESIGHTS[header["CAMPAIGN"]], unit="deg")
    distance = SkyCoord(header["RA_OBJ"], header["DEC_OBJ"], unit="deg").separation(center).deg
    along, across = principal_axes(motion)
    roll = along / (distance * 3600 / PIXEL) * ARCSEC
    first, length, begin, end, rate, acceleration, scatter = drifts(roll)
    hours = 24 * np.median(np.diff(motion.time))
    mean_rate = (end - begin) / (length - 1)
    smooth = running_median(mean_rate, 15)
    sense = np.sign(mean_rate)
    fast = np.abs(smooth) > np.percentile(np.abs(smooth), 30)
    days = first * hours / 24
    smooth_sense = np.sign(smooth)
    turns = days[1:][np.diff(smooth_sense) != 0]
    lobes = [
        np.percentile(np.abs(smooth[part]), 90) / hours
        for part in (smooth_sense > 0, smooth_sense < 0)
    ]
    return {
        "campaign": header["CAMPAIGN"],
        "distance, deg": round(distance, 2),
        "rate of both senses, arcsec/h": np.round(lobes, 1),
        "reversals, d": np.round(turns, 1),
        "growth per hour": round(np.median(acceleration[fast] / rate[fast]) / hours, 3),
        "jitter of rate": round(
            1.4826 * np.median(np.abs(mean_rate - smooth)[fast] / np.abs(smooth[fast])), 3
        ),
        "angle before reset, 5 %": round(np.percentile(sense * end, 5), 1),
        "angle after reset, mean": round(np.mean(sense * begin), 1),
        "angle after reset, std": round(np.std(begin), 1),
        "residual roll, arcsec": round(np.median(scatter), 2),
        "residual pointing, arcsec": round(PIXEL * white_noise(across), 4),
    }


def main(folder):
    """Write the parameters of all files to ``docs/data/motion_files.ecsv``."""
    data = Path(__file__).parents[1] / "data"
    sys.path.append(str(data))
    from _stamp import stamp

    folder = Path(folder)
    files = [*folder.glob("poscorr/ktwo*.fits"), *folder.glob("k2_tpf/ktwo*.fits.gz")]
    rows = []
    for path in sorted(files, key=lambda path: path.name):
        values = {name: np.atleast_1d(value) for name, value in measure(path).items()}
        texts = {name: ", ".join(f"{one:g}" for one in value) for name, value in values.items()}
        rows.append({"file": path.name.partition("_")[0]} | texts)
    table = Table(rows)
    stamp(table, "python docs/figures/motion_measurements.py FOLDER")
    table.write(data / "motion_files.ecsv", overwrite=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
