"""Table 1 of the paper: how far the star moves, at multiples of K2's motion.

    python studies/paper/table1.py --scales 1 2 5 10

The distance of the star from its reference position has a mean, a standard deviation and a maximum;
the extent is the largest distance between any two positions. Beside it is table 1 of Saunders et
al. (2019).
"""

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from _figures import plot_motion_statistics
from _stars import motion_from_name
from _study import run
from astropy.table import Table

NAME = "table1"
UNITS = dict.fromkeys(("mean", "std", "maximum", "extent"), "pix") | dict.fromkeys(
    ("mean_angle", "std_angle", "maximum_angle"), "arcsec"
)
#: The paper's row of 1x motion in pixels: EPIC 205998445, campaign 3, 1000 cadences.
PAPER_PIXELS = {"mean": 0.17, "std": 0.12, "maximum": 0.59}


@dataclass(frozen=True, kw_only=True)
class Table1:
    """The parameters."""

    seed: int = 1  # not used: the motions have seeds of their own
    motions: tuple[str, ...] = ("k2_roll",)  # files or generators, see `motion_from_name`
    scales: tuple[float, ...] = (1.0, 2.0, 5.0, 10.0)
    cadences: int = 1000  # from the beginning of each motion
    pixel_scale: float = 3.98  # arcsec


def tasks(study):
    """Return one task per motion and scale."""
    return [
        {"key": f"motion{number}-x{scale:g}", "motion": motion, "scale": scale}
        for number, motion in enumerate(study.motions)
        for scale in study.scales
    ]


def measure(study, task):
    """Return the statistics of a motion in pixels and as angles."""
    motion = task["scale"] * motion_from_name(task["motion"], study.cadences)
    pixels = motion.statistics(study.pixel_scale)
    angles = pixels.in_arcsec()
    names = ("mean", "std", "maximum", "extent")
    row = {"cadences": len(motion)} | {name: getattr(pixels, name).value for name in names}
    return row | {f"{name}_angle": getattr(angles, name).value for name in names[:3]}


def summarize(_, table):
    """Return our statistics, the paper's, and the ratio."""
    summary = Table(table["motion", "scale", "cadences"], copy=True, masked=False)
    for name, paper in PAPER_PIXELS.items():
        summary[name] = table[name]
        summary[f"paper_{name}"] = np.round(paper * np.asarray(table["scale"]), 4)
        summary[f"ratio_{name}"] = np.asarray(table[name]) / summary[f"paper_{name}"]
        summary[f"paper_{name}"].unit = "pix"
    summary["extent"] = table["extent"]
    summary.meta.clear()
    return summary


def draw(study, _, summary):
    """Draw the statistics against the scale."""
    series = {
        Path(motion).name: summary[summary["motion"] == motion]
        for motion in dict.fromkeys(summary["motion"])
    }
    scale = np.array([min(study.scales), max(study.scales)])
    paper = {"scale": scale} | {name: value * scale for name, value in PAPER_PIXELS.items()}
    return plot_motion_statistics(series, paper)


main = partial(run, NAME, Table1, tasks, measure, summarize, draw, UNITS)

if __name__ == "__main__":
    main()
