"""Noise of TESS stars in an hour, raw and corrected, beside the mission's noise model.

    python studies/paper/tess.py --workers 2

Each star moves as `Motion.tess` over a sector, has the mission's cosmic rays with their rejection,
and scattered light of which a part is left. Half of the stars have neighbors, drawn from a law of
counts and placed anywhere on the stamp.
"""

from dataclasses import replace

import numpy as np
from _correctors import SURVIVALS, UNITS, corrected_noise, curves, quiet
from _figures import plot_cdpp_panels
from _study import grid, largest, medians, parameters, study_of

from scope_models import Detector, Motion, Star, simulate
from scope_models.batch import star_rng, star_seed
from scope_models.effects import ScatteredLight, mission_effects

SPAN, SLOPE = 6.0, 0.3  # magnitudes of neighbors below the target, and slope of log counts
CLEAR = 1.0  # px between the target and a neighbor, at least


@parameters
class TESSNoise:
    seed: int = 1
    magnitudes: tuple[float, ...] = (8.0, 9.0, 10.0, 11.0, 12.0, 13.0, 14.0)  # T
    neighbors: tuple[int, ...] = (0, 10)  # within six magnitudes of the target on the stamp
    stars: int = 1  # per magnitude and number of neighbors
    cadence: str = "1800 s"
    cadences: int = 1268  # a sector of 1800 s
    residual: float = 0.002  # part of the scattered light that is left in the flux


def tess_noise(mag, pixels, hours=1.0, *, floor=60.0):
    r"""Return the noise in ppm that TESS's noise model predicts.

    .. math:: \sigma^2 = \frac{F + n (B + 10^2 / t_2)}{F^2\, t} + \frac{\sigma_s^2}{h}

    with the flux F, n pixels of background B, 10 electrons of read noise in each exposure of
    :math:`t_2` = 1.98 s, the exposure time t (80 % of the wall time), and a systematic floor of
    :math:`\sigma_s` = 60 ppm in one hour. See Sullivan, P. W. et al. 2015, ApJ, 809, 77, section 6.
    """
    detector = Detector.tess()
    flux = detector.flux_from_mag(np.asarray(mag))
    seconds = hours * 3600 * detector.exposure_time / (86400 * detector.cadence_days)
    sky = detector.background + detector.read_noise**2 / detector.int_time
    light = (flux + np.asarray(pixels) * sky) / (flux**2 * seconds)
    return np.sqrt(1e12 * light + floor**2 / hours)


tasks = grid(
    "t{mag:g}-n{neighbors}-{index}", index="stars", neighbors="neighbors", mag="magnitudes"
)


def measure(study, task):
    """Return the noise of a star with its neighbors, see `corrected_noise`."""
    rng = star_rng(study.seed, task["key"])
    detector = Detector.tess(cadence=study.cadence)
    place = [(n - 1) / 2 for n in detector.shape[::-1]] + rng.uniform(-0.5, 0.5, 2)
    stars = [Star(task["mag"], *place)]
    while len(stars) <= task["neighbors"]:
        at = rng.uniform(0, np.array(detector.shape[::-1]) - 1)
        fainter = np.log10(1 + rng.random() * (10 ** (SLOPE * SPAN) - 1)) / SLOPE
        if np.hypot(*(at - place)) > CLEAR:
            stars.append(Star(task["mag"] + fainter, *at))
    seed = star_seed(study.seed, task["key"], "motion") % 2**31
    motion = Motion.tess(study.cadences, cadence=study.cadence, seed=seed)
    effects = [
        replace(effect, residual=study.residual) if isinstance(effect, ScatteredLight) else effect
        for effect in mission_effects(detector)
    ]
    seed = star_seed(study.seed, task["key"], "noise")
    with quiet():  # neighbors at the edges lose light
        observation = simulate(stars, detector, motion, seed=seed, effects=effects)
    return corrected_noise(observation, hours=1.0)


def summarize(_, table):
    """Return medians beside "model", the noise model with as many pixels, and the claims."""
    columns = ("pixels", "share", *SURVIVALS, *UNITS)
    summary = medians(table, ("neighbors", "mag"), columns)
    summary["model"] = tess_noise(summary["mag"], summary["pixels"])
    summary["model"].unit = "ppm"
    alone = summary[summary["neighbors"] == 0]
    bright, faint = alone[alone["mag"] <= 9], alone[alone["mag"] >= 13]
    summary.meta |= largest({
        "apertures of stars without neighbors are below the noise model with its 60 ppm": (
            alone["aperture"] / alone["model"]
        ),
        "PLD is within 30 % of the noise of the light without neighbors": (
            alone["pld"] / alone["floor"] / 1.3
        ),
        "to T 9 a wider aperture is less noisy without a filter": (
            bright["wide_full"] / bright["aperture_full"]
        ),
        "from T 13 on a wider aperture is noisier": faint["aperture"] / faint["wide"],
    })  # fmt: skip
    return summary


def draw(study, _, summary):
    """Draw noise against magnitude, with and without neighbors."""
    parts = {number: summary[summary["neighbors"] == number] for number in study.neighbors}
    panels = {f"{number} neighbors": curves(part) for number, part in parts.items()}
    first = parts[study.neighbors[0]]
    model = {name: np.array(first[key]) for name, key in (("mag", "mag"), ("median", "model"))}
    figure = plot_cdpp_panels(panels, model | {"label": "Noise model, 60 ppm"})
    for ax in figure.axes:
        ax.set(xlabel="Magnitude (T)", ylabel="1-h CDPP (ppm)")
    return figure


main = study_of("tess", TESSNoise, tasks, measure, summarize, draw, UNITS)

if __name__ == "__main__":
    main()
