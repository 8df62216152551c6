"""Noise that correctors and apertures leave where the width of the PSF breathes."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from scope_models.effects import Focus
from scope_models.experiments._corrected import METHODS, SURVIVALS, CorrectedStudy
from scope_models.experiments._statistics import on_grid
from scope_models.experiments.populations import motion_from_name
from scope_models.experiments.study import parameter
from scope_models.scene import Detector, Star
from scope_models.simulation import simulate

__all__ = ["BreathingPSF"]


@dataclass(frozen=True, kw_only=True)
class BreathingPSF(CorrectedStudy):
    """Noise of stars whose PSF breathes while they move, before and after corrections.

    The relative width of the PSF is a sinusoid in time, beside a motion as K2's. What is left is
    compared with the noise of the light alone, without any filter in time.

    Examples
    --------
    >>> from scope_models.experiments.breathing import BreathingPSF
    >>> [task["key"] for task in BreathingPSF(amplitudes=(0.01,), periods=(1, 4), stars=1).tasks()]
    ['a0.01-p1-0', 'a0.01-p4-0']
    """

    name: ClassVar[str] = "breathing"
    grid: ClassVar[dict] = {"index": "stars", "amplitude": "amplitudes", "period": "periods"}
    key: ClassVar[str] = "a{amplitude:g}-p{period:g}-{index}"
    cell: ClassVar[tuple] = ("amplitude", "period")
    columns: ClassVar[tuple] = ("kept", *SURVIVALS)

    amplitudes: tuple[float, ...] = parameter(
        (0.001, 0.003, 0.01, 0.03),
        "Relative semi-amplitudes of the width.",
        different="numbers",
        positive=False,
    )
    periods: tuple[float, ...] = parameter(
        (0.25, 1.0, 4.0, 16.0), "Periods, days.", different="numbers", positive=True
    )
    mag: float = parameter(12.0, "Magnitude Kp.")
    motion: str = parameter(
        "k2_roll", "Motion, as `~scope_models.experiments.populations.motion_from_name` takes it."
    )
    stars: int = parameter(1, "Stars per cell.", least=1)
    cadences: int = parameter(1000, "Cadences per star.", least=200)

    def __post_init__(self):
        super().__post_init__()
        if max(self.amplitudes) >= 1:
            raise ValueError(f"`amplitudes` must be below 1, got {max(self.amplitudes)}")

    def observation(self, task):
        """Return the pixels of a star: the same star, motion and noise in all cells."""
        star = f"star{task['index']}"
        rng, detector = self.star_rng(star), Detector.k2_calibrated()
        place = 5 + rng.uniform(-0.5, 0.5, 2)
        focus = Focus(task["amplitude"], period=task["period"], phase=rng.random())
        motion = motion_from_name(self.motion, self.cadences)
        seed = self.star_seed(star, "noise")
        return simulate(Star(self.mag, *place), detector, motion, seed=seed, effects=focus)

    def compare(self, table, summary):
        """Add "_ratio", the unfiltered noise over that of the light."""
        for name in METHODS:
            floor = "floor_wide_full" if name == "wide" else "floor_full"
            ratio = np.array(summary[f"{name}_full"]) / np.array(summary[floor])
            summary[f"{name}_ratio"] = np.round(ratio, 3)

    def claims(self, summary):
        """Return the ratio of each claim to its limit."""
        real = summary[summary["amplitude"] <= 0.01]
        slow, strong = real[real["period"] >= 1], summary[summary["amplitude"] >= 0.01]
        return {
            "to 1 % PLD is within 1.5 times the noise of the light at all periods": (
                real["pld_ratio"] / 1.5
            ),
            "to 1 % the scene model is within 1.5 times the noise of the light at all periods": (
                real["scene_ratio"] / 1.5
            ),
            "to 1 % and from a day on the better corrector is within 2 times the noise": (
                np.fmin(np.array(slow["pld_ratio"]), np.array(slow["scene_ratio"])) / 2
            ),
            "from 1 % on a wider aperture alone halves the noise": (
                2 * np.array(strong["wide_full"] / strong["aperture_full"])
            ),
            "no aperture alone is within 2 times the noise": (
                2 / np.fmin(np.array(summary["aperture_ratio"]), np.array(summary["wide_ratio"]))
            ),
        }

    def draw(self, table, summary):
        """Draw maps of the noise that is left, over amplitude and period."""
        from scope_models.plotting.statistics import plot_maps  # imports matplotlib

        rows, columns = sorted(self.amplitudes), sorted(self.periods)
        axes = ("amplitude", rows), ("period", columns)
        maps = {label: on_grid(summary, *axes, f"{name}_ratio") for name, label in METHODS.items()}
        return plot_maps(
            maps, [100 * value for value in rows], columns,
            row_label="Amplitude of the width (%)", column_label="Period (d)",
            label="Noise over that of the light", text=".3g",
        )  # fmt: skip
