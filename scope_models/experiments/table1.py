"""Table 1 of the paper: how far the star moves."""

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
from astropy.table import Table

from scope_models.experiments.populations import motion_from_name
from scope_models.experiments.study import Study, parameter

__all__ = ["PAPER_PIXELS", "Table1"]

#: The paper's row of 1x motion in pixels: EPIC 205998445, campaign 3, 1000 cadences.
PAPER_PIXELS = {"mean": 0.17, "std": 0.12, "maximum": 0.59}
_PAPER_CADENCES = 1000


@dataclass(frozen=True, kw_only=True)
class Table1(Study):
    """Statistics of motions and their multiples beside the paper's table 1.

    The distance of the star from its reference position, r, has a mean, a standard deviation
    and a maximum; the extent is the largest distance between any two positions.

    References
    ----------
    Saunders, N. et al. 2019, "The Pointing Limits of Transiting Exoplanet Light Curve
    Characterization with Pixel Level De-correlation", table 1.

    Examples
    --------
    >>> from scope_models.experiments.table1 import Table1
    >>> study = Table1(scales=(1, 10))
    >>> [task["key"] for task in study.tasks()]
    ['motion0-x1', 'motion0-x10']
    """

    name: ClassVar[str] = "table1"
    units: ClassVar[dict] = {
        "mean": "pix", "std": "pix", "maximum": "pix", "extent": "pix",
        "mean_angle": "arcsec", "std_angle": "arcsec", "maximum_angle": "arcsec",
    }  # fmt: skip

    seed: int = parameter(1, "Not used: the motions have seeds of their own.", least=0)
    motions: tuple[str, ...] = parameter(
        ("k2_roll",),
        "Motions, as `~scope_models.experiments.populations.motion_from_name` takes them: files or "
        "generators.",
    )
    scales: tuple[float, ...] = parameter(
        (1.0, 2.0, 5.0, 10.0), "Factors on the motions.", positive=True
    )
    cadences: int = parameter(
        _PAPER_CADENCES,
        "Cadences of each motion, counted from its beginning; fewer if it is shorter.",
        least=2,
    )
    pixel_scale: float = parameter(3.98, "Size of a pixel in arcsec.", positive=True)

    def tasks(self):
        """Return one task per motion and scale."""
        return [
            {"key": f"motion{number}-x{scale:g}", "motion": motion, "scale": scale}
            for number, motion in enumerate(self.motions)
            for scale in self.scales
        ]

    def run_star(self, task):
        """Return the statistics of a motion in pixels and as angles."""
        motion = task["scale"] * motion_from_name(task["motion"], self.cadences)
        pixels = motion.statistics(self.pixel_scale)
        angles = pixels.in_arcsec()
        names = ("mean", "std", "maximum", "extent")
        row = {"cadences": len(motion)} | {name: getattr(pixels, name).value for name in names}
        return row | {f"{name}_angle": getattr(angles, name).value for name in names[:3]}

    def summarize(self, table):
        """Return our statistics beside the paper's.

        Per motion and scale: ours, the paper's, and the ratio, of mean, standard deviation and
        maximum; and the extent, which the paper does not have.
        """
        summary = Table(table["motion", "scale", "cadences"], copy=True, masked=False)
        for name, paper in PAPER_PIXELS.items():
            ours = np.asarray(table[name], dtype=float)
            summary[name] = table[name]
            summary[f"paper_{name}"] = np.round(paper * np.asarray(table["scale"]), 4)
            summary[f"paper_{name}"].unit = "pix"
            summary[f"ratio_{name}"] = ours / summary[f"paper_{name}"].value
        summary["extent"] = table["extent"]
        summary.meta.clear()
        return summary

    def draw(self, table, summary):
        """Draw the statistics against the scale."""
        from scope_models.plotting.statistics import plot_motion_statistics  # imports matplotlib

        names = ("scale", *PAPER_PIXELS)
        series = {}
        for motion in dict.fromkeys(summary["motion"]):
            rows = summary[summary["motion"] == motion]
            series[Path(motion).name] = {name: np.array(rows[name]) for name in names}
        scale = np.array([min(self.scales), max(self.scales)])
        paper = {"scale": scale} | {name: value * scale for name, value in PAPER_PIXELS.items()}
        return plot_motion_statistics(series, paper)
