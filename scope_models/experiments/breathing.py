"""Noise that correctors and apertures leave where the width of the PSF breathes."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from astropy.table import Table

from scope_models._checks import checked_integer, checked_number
from scope_models.effects import Focus
from scope_models.experiments._corrected import (
    METHODS,
    SURVIVALS,
    checked_claims,
    corrected_noise,
    medians_of,
    noise_units,
)
from scope_models.experiments.populations import motion_from_name
from scope_models.experiments.study import Study
from scope_models.scene.detector import Detector
from scope_models.scene.star import Star
from scope_models.simulation import simulate

__all__ = ["BreathingPSF"]

_HOURS = 6.5


@dataclass(frozen=True, kw_only=True)
class BreathingPSF(Study):
    """Noise of stars whose PSF breathes while they move, before and after corrections.

    The relative width of the PSF is a sinusoid in time, beside a motion as K2's. What is left is
    compared with the noise of the light alone, without any filter in time.

    Parameters
    ----------
    seed : int, optional
        Seed of all random numbers.
    amplitudes : tuple of float, optional
        Relative semi-amplitudes of the width.
    periods : tuple of float, optional
        Periods, days.
    mag : float, optional
        Magnitude Kp.
    motion : str, optional
        Motion, as `~scope_models.experiments.populations.motion_from_name` takes it.
    stars : int, optional
        Stars per cell.
    cadences : int, optional
        Cadences per star.

    Raises
    ------
    TypeError, ValueError
        If a field is of the wrong type or outside its domain.

    Examples
    --------
    >>> from scope_models.experiments.breathing import BreathingPSF
    >>> [task["key"] for task in BreathingPSF(amplitudes=(0.01,), periods=(1, 4), stars=1).tasks()]
    ['a0.01-p1-0', 'a0.01-p4-0']
    """

    name: ClassVar[str] = "breathing"
    units: ClassVar[dict] = noise_units()

    amplitudes: tuple[float, ...] = (0.001, 0.003, 0.01, 0.03)
    periods: tuple[float, ...] = (0.25, 1.0, 4.0, 16.0)
    mag: float = 12.0
    motion: str = "k2_roll"
    stars: int = 1
    cadences: int = 1000

    def __post_init__(self):
        super().__post_init__()
        checked_integer("stars", self.stars, 1)
        checked_integer("cadences", self.cadences, 200)
        for name in ("amplitudes", "periods"):
            values = getattr(self, name)
            if not values or len(set(values)) < len(values):
                raise ValueError(f"`{name}` must be one or more different numbers, got {values}")
            for value in values:
                checked_number(name, value, positive=name == "periods")
        if max(self.amplitudes) >= 1:
            raise ValueError(f"`amplitudes` must be below 1, got {max(self.amplitudes)}")

    def tasks(self):
        """Return one task per star.

        Returns
        -------
        list of dict
            Keys "key", "amplitude", "period" and "index".
        """
        return [
            {
                "key": f"a{amplitude:g}-p{period:g}-{index}",
                "amplitude": amplitude, "period": period, "index": index,
            }
            for index in range(self.stars)
            for amplitude in self.amplitudes
            for period in self.periods
        ]  # fmt: skip

    def observation(self, task):
        """Return the pixels of a star: the same star, motion and noise in all cells.

        Parameters
        ----------
        task : dict
            One of `tasks`.

        Returns
        -------
        Observation
            The observation.
        """
        star = f"star{task['index']}"
        rng, detector = self.star_rng(star), Detector.k2_calibrated()
        place = 5 + rng.uniform(-0.5, 0.5, 2)
        focus = Focus(task["amplitude"], period=task["period"], phase=rng.random())
        motion = motion_from_name(self.motion, self.cadences)
        seed = self.star_seed(star, "noise")
        return simulate(Star(self.mag, *place), detector, motion, seed=seed, effects=focus)

    def measure(self, task, observation):
        """Return the noise of a star in 6.5 h.

        Parameters
        ----------
        task : dict
            One of `tasks`.
        observation : Observation
            Its pixels.

        Returns
        -------
        dict
            As in `~scope_models.experiments.tess.TESSNoise.measure`.
        """
        return corrected_noise(observation, _HOURS)

    def summarize(self, table):
        """Return medians per cell, and check what was expected.

        Parameters
        ----------
        table : astropy.table.Table
            The results.

        Returns
        -------
        astropy.table.Table
            One row per amplitude and period: medians, and for each aperture and corrector the
            unfiltered noise over that of the light, "_ratio". In ``meta`` "claims" and
            "claims_checked": verdicts, and the number that decides.
        """
        summary = Table(
            medians_of(table, ("amplitude", "period"), ("kept", *SURVIVALS, *self.units))
        )
        for name in METHODS:
            floor = "floor_wide_full" if name == "wide" else "floor_full"
            ratio = np.array(summary[f"{name}_full"]) / np.array(summary[floor])
            summary[f"{name}_ratio"] = np.round(ratio, 3)
        for name in self.units:
            summary[name].unit = "ppm"
        real = summary[summary["amplitude"] <= 0.01]
        slow, strong = real[real["period"] >= 1], summary[summary["amplitude"] >= 0.01]
        both = np.array(strong["wide_full"] / strong["aperture_full"])
        claims = {
            "to 1 % PLD is within 1.5 times the noise of the light at all periods": (
                np.array(real["pld_ratio"]) / 1.5
            ),
            "to 1 % the scene model is within 1.5 times the noise of the light at all periods": (
                np.array(real["scene_ratio"]) / 1.5
            ),
            "to 1 % and from a day on the better corrector is within 2 times the noise": (
                np.fmin(np.array(slow["pld_ratio"]), np.array(slow["scene_ratio"])) / 2
            ),
            "from 1 % on a wider aperture alone halves the noise": 2 * both,
            "no aperture alone is within 2 times the noise": (
                2 / np.fmin(np.array(summary["aperture_ratio"]), np.array(summary["wide_ratio"]))
            ),
        }
        summary.meta["claims"], summary.meta["claims_checked"] = checked_claims(claims)
        return summary

    def draw(self, table, summary):
        """Draw maps of the noise that is left, over amplitude and period.

        Parameters
        ----------
        table : astropy.table.Table
            The results.
        summary : astropy.table.Table
            The summary of them.

        Returns
        -------
        matplotlib.figure.Figure
            The figure.
        """
        from scope_models.plotting.statistics import plot_maps  # imports matplotlib

        rows, columns = sorted(self.amplitudes), sorted(self.periods)
        maps = {}
        for name, label in METHODS.items():
            values = np.full((len(rows), len(columns)), np.nan)
            for row in summary:
                place = rows.index(row["amplitude"]), columns.index(row["period"])
                values[place] = row[f"{name}_ratio"]
            maps[label] = values
        return plot_maps(
            maps, [100 * value for value in rows], columns,
            row_label="Amplitude of the width (%)", column_label="Period (d)",
            label="Noise over that of the light", text=".3g",
        )  # fmt: skip
