"""Noise that correctors and apertures leave where the width of the PSF breathes.

    python studies/paper/breathing.py --workers 2

The relative width of the PSF is a sinusoid in time, beside a motion as K2's. What is left is
compared with the noise of the light alone, without any filter in time.
"""

import numpy as np
from _correctors import METHODS, SURVIVALS, UNITS, corrected_noise
from _figures import plot_maps
from _stars import motion_from_name
from _study import grid, largest, medians, parameters, study_of

from scope_models import Detector, Star, simulate
from scope_models.batch import star_rng, star_seed
from scope_models.effects import Focus


@parameters
class BreathingPSF:
    seed: int = 1
    amplitudes: tuple[float, ...] = (0.001, 0.003, 0.01, 0.03)  # relative, of the width
    periods: tuple[float, ...] = (0.25, 1.0, 4.0, 16.0)  # days
    mag: float = 12.0  # Kp
    stars: int = 1  # per cell
    cadences: int = 1000


tasks = grid(
    "a{amplitude:g}-p{period:g}-{index}", index="stars", amplitude="amplitudes", period="periods"
)


def measure(study, task):
    """Return the noise of a star: the same star, motion and noise in all cells."""
    star = f"star{task['index']}"
    rng, detector = star_rng(study.seed, star), Detector.k2_calibrated()
    place = 5 + rng.uniform(-0.5, 0.5, 2)
    focus = Focus(task["amplitude"], period=task["period"], phase=rng.random())
    motion = motion_from_name("k2_roll", study.cadences)
    seed = star_seed(study.seed, star, "noise")
    observation = simulate(Star(study.mag, *place), detector, motion, seed=seed, effects=focus)
    return corrected_noise(observation, hours=6.5)


def summarize(_, table):
    """Return medians, the unfiltered noise over that of the light ("_ratio"), and the claims."""
    summary = medians(table, ("amplitude", "period"), ("kept", *SURVIVALS, *UNITS))
    for name in METHODS:
        floor = "floor_wide_full" if name == "wide" else "floor_full"
        summary[f"{name}_ratio"] = np.round(summary[f"{name}_full"] / summary[floor], 3)
    real = summary[summary["amplitude"] <= 0.01]
    slow, strong = real[real["period"] >= 1], summary[summary["amplitude"] >= 0.01]
    summary.meta |= largest({
        "to 1 % PLD is within 1.5 times the noise of the light at all periods": (
            real["pld_ratio"] / 1.5
        ),
        "to 1 % and from a day on PLD is within 2 times the noise": slow["pld_ratio"] / 2,
        "from 1 % on a wider aperture alone halves the noise": (
            2 * strong["wide_full"] / strong["aperture_full"]
        ),
        "no aperture alone is within 2 times the noise": (
            2 / np.fmin(summary["aperture_ratio"], summary["wide_ratio"])
        ),
    })  # fmt: skip
    return summary


def draw(_, __, summary):
    """Draw maps of the noise that is left, over amplitude and period."""
    return plot_maps(
        summary, {label: f"{name}_ratio" for name, label in METHODS.items()},
        ("amplitude", "Amplitude of the width"), ("period", "Period (d)"),
        label="Noise / noise of the light alone", text=".3g",
    )  # fmt: skip


main = study_of("breathing", BreathingPSF, tasks, measure, summarize, draw, UNITS)

if __name__ == "__main__":
    main()
