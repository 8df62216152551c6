"""The photometry that could be saved of K2's last campaigns, 18 and 19.

    python studies/paper/last_campaigns.py --workers 2

The stars move as `Motion.k2_final_campaign`, and have the mission's effects. Stamps have a halo of
three pixels, as the mission's. Each part is corrected for itself.
"""

import numpy as np
from _correctors import SURVIVALS, UNITS, corrected_noise, curves, quiet
from _figures import plot_cdpp_panels
from _study import grid, largest, medians, parameters, study_of

from scope_models import Detector, Motion, Star, simulate
from scope_models.batch import star_rng, star_seed

#: Parts of the campaigns by name: campaign, first and last long cadence (K2 data release notes).
PARTS = {
    "C18": (18, 161969, 163168),
    "C19 nominal": (19, 167743, 168097),
    "C19 erratic": (19, 168098, 168481),
    "C19 off target": (19, 167333, 167742),
}
#: Median 6.5-h CDPP of dwarfs after the mission's own corrections, ppm, by part and magnitude
#: (tables of the K2 data release notes).
MISSION_CDPP = {
    "C18": {10.0: 56.0, 12.0: 83.8, 14.0: 158.0},
    "C19 nominal": {10.0: 50.1, 12.0: 64.5, 14.0: 140.0},
}
COLUMNS = ("kept", "seen", *SURVIVALS, *UNITS)


@parameters
class LastCampaigns:
    seed: int = 1
    magnitudes: tuple[float, ...] = (10.0, 12.0, 14.0, 16.0)  # Kp
    parts: tuple[str, ...] = tuple(PARTS)  # of campaign 18 the first 1200 cadences are used
    stars: int = 1  # per magnitude and part


tasks = grid("{part}-kp{mag:g}-{index}", index="stars", part="parts", mag="magnitudes")


def measure(study, task):
    """Return the noise of a star in 6.5 h, see `corrected_noise`.

    "seen" is the part of the cadences in which half of the star's light is on the stamp.
    """
    campaign, first, last = PARTS[task["part"]]
    rng = star_rng(study.seed, task["key"])
    angle, distance = rng.uniform(0, 2 * np.pi), 6.9 * np.sqrt(rng.random())
    motion = Motion.k2_final_campaign(
        campaign=campaign, seed=star_seed(study.seed, task["key"], "motion") % 2**31,
        field=(distance * np.cos(angle), distance * np.sin(angle)),
    )  # fmt: skip
    motion = motion[(motion.cadenceno >= first) & (motion.cadenceno <= last)]
    if task["part"] == "C19 off target":
        # Its flags would take every cadence; the correctors are to be given a chance.
        motion = Motion(motion.time, motion.x, motion.y, cadenceno=motion.cadenceno)
    detector = Detector.k2_calibrated(shape=(9, 9))
    star = Star(task["mag"], *(4 + rng.uniform(-0.5, 0.5, 2)))
    seed = star_seed(study.seed, task["key"], "noise")
    with quiet():  # the star leaves its stamp
        observation = simulate(star, detector, motion, seed=seed, effects="mission")
    light = observation.model().sum(axis=(1, 2))
    seen = float(np.mean(light > detector.flux_from_mag(task["mag"]) / 2))
    return corrected_noise(observation, hours=6.5) | {"seen": seen}


def summarize(_, table):
    """Return medians beside "mission", the mission's own CDPP, and the claims."""
    summary = medians(table, ("part", "mag"), COLUMNS)
    summary["mission"] = [
        MISSION_CDPP.get(part, {}).get(mag, np.nan) for part, mag in summary.iterrows("part", "mag")
    ]
    summary["mission"].unit = "ppm"
    part = {name: summary[summary["part"] == name] for name in PARTS}

    def over(name, column):
        ratio = np.array(part[name]["pld"] / part[name][column])
        return ratio[np.isfinite(part[name][column])]

    summary.meta |= largest({
        "in campaign 18 PLD is below the mission's own noise": over("C18", "mission"),
        "in the nominal week of campaign 19 it is below the mission's own noise": over(
            "C19 nominal", "mission"
        ),
        "in the nominal week it is within 1.5 times the noise of the light": over(
            "C19 nominal", "floor"
        ) / 1.5,
        "in the erratic part it is within 3 times the noise of the light": over(
            "C19 erratic", "floor"
        ) / 3,
        "in the erratic part a quarter of the cadences is kept": 0.25 / part["C19 erratic"]["kept"],
        "off target less than a tenth of the cadences has half of the light": (
            10 * part["C19 off target"]["seen"]
        ),
    })  # fmt: skip
    return summary


def draw(study, _, summary):
    """Draw noise against magnitude, a panel for each part."""
    panels = {
        name: curves(summary[summary["part"] == name], mission="Mission") for name in study.parts
    }
    return plot_cdpp_panels(panels)


main = study_of("last-campaigns", LastCampaigns, tasks, measure, summarize, draw, UNITS)

if __name__ == "__main__":
    main()
