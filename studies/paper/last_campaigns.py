"""The photometry that could be saved of K2's last campaigns, 18 and 19.

    python studies/paper/last_campaigns.py --workers 2

The stars move as `Motion.k2_final_campaign`, or as a real file of campaign 18 shows, and have the
mission's effects. Stamps have a halo of three pixels, as the mission's. Each part is corrected for
itself.
"""

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from _correctors import SURVIVALS, UNITS, corrected_noise, curves, quiet
from _figures import plot_cdpp_panels
from _study import grid, largest, medians, run

from scope_models import Detector, Motion, Star, simulate
from scope_models.batch import star_rng, star_seed
from scope_models.photometry import cdpp

NAME = "last-campaigns"
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
HOURS = 6.5
COLUMNS = ("kept", "seen", *SURVIVALS, *UNITS)


@dataclass(frozen=True, kw_only=True)
class LastCampaigns:
    """The parameters."""

    seed: int = 1
    magnitudes: tuple[float, ...] = (10.0, 12.0, 14.0, 16.0)  # Kp
    parts: tuple[str, ...] = tuple(PARTS)  # of campaign 18 the first 1200 cadences are used
    stars: int = 1  # per magnitude and part
    motion: str = ""  # a file of campaign 18 whose motion is taken; by default it is generated
    files: tuple[str, ...] = ()  # real files, which are corrected, too


def tasks(study):
    """Return one task per star; "file" is empty for simulated ones."""
    found = [
        task | {"key": task["key"].replace(task["part"], task["part"].lower().replace(" ", "-"))}
        for task in grid(
            "{part}-kp{mag:g}-{index}", index=study.stars, part=study.parts, mag=study.magnitudes
        )
    ]
    return [task | {"file": ""} for task in found] + [
        {"key": f"file{n}", "part": "file", "mag": np.nan, "index": n, "file": file}
        for n, file in enumerate(study.files)
    ]


def measure(study, task):
    """Return the noise of a star in 6.5 h, see `corrected_noise`.

    "seen" is the part of the cadences in which half of the star's light is on the stamp.
    """
    if task["file"]:
        return measure_file(task["file"])
    campaign, first, last = PARTS[task["part"]]
    rng = star_rng(study.seed, task["key"])
    if campaign == 18 and study.motion:
        motion = Motion.from_file(study.motion)
    else:
        angle = rng.uniform(0, 2 * np.pi)
        distance = 6.9 * np.sqrt(rng.random())
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
    return corrected_noise(observation, HOURS) | {"seen": seen}


def measure_file(file):
    """Return the noise of a real star in EVEREST's convention, which wild cadences hardly change.

    The aperture is that of the file; what needs the truth is NaN.
    """
    from scope_models import PLDCorrector  # imports lightkurve

    row = dict.fromkeys((*UNITS, *SURVIVALS, "seen", "share"), np.nan)
    with quiet():
        corrector = PLDCorrector(file)
        light_curve = corrector.correct()
    row["aperture"] = cdpp(corrector.original_lc, duration=HOURS, method="everest")
    row["pld"] = cdpp(light_curve, duration=HOURS, method="everest")
    row["kept"] = float(np.mean(np.isfinite(light_curve.flux.value)))
    row["pixels"] = int(corrector.aperture_mask.sum())
    return row


def summarize(_, table):
    """Return medians, a row per part and magnitude and one per file, and the claims.

    "mission" is the mission's own CDPP.
    """
    real = table["part"] == "file"
    files = [
        {"part": Path(row["file"]).name, "mag": row["mag"], "stars": 1}
        | {name: row[name] for name in COLUMNS}
        for row in table[real]
    ]
    summary = medians(table[~real], ("part", "mag"), COLUMNS, files)
    summary["mission"] = [
        MISSION_CDPP.get(part, {}).get(mag, np.nan) for part, mag in summary.iterrows("part", "mag")
    ]
    summary["mission"].unit = "ppm"
    parts = {part: summary[summary["part"] == part] for part in PARTS}

    def over(part, column):
        rows = parts[part]
        ratio = np.array(rows["pld"]) / np.array(rows[column])
        return ratio[rows["mission"] > 0] if column == "mission" else ratio

    summary.meta |= largest(
        {
            "in campaign 18 PLD is below the mission's own noise": (over("C18", "mission")),
            "in the nominal week of campaign 19 it is below the mission's own noise": (
                over("C19 nominal", "mission")
            ),
            "in the nominal week it is within 1.5 times the noise of the light": (
                over("C19 nominal", "floor") / 1.5
            ),
            "in the erratic part it is within 3 times the noise of the light": (
                over("C19 erratic", "floor") / 3
            ),
            "in the erratic part a quarter of the cadences is kept": (
                0.25 / np.array(parts["C19 erratic"]["kept"])
            ),
            "off target less than a tenth of the cadences has half of the light": (
                10 * np.array(parts["C19 off target"]["seen"])
            ),
        }
    )
    return summary


def draw(study, _, summary):
    """Draw noise against magnitude, a panel for each part."""
    panels = {
        name: curves(summary[summary["part"] == name], mission="Mission") for name in study.parts
    }
    return next(iter(plot_cdpp_panels(panels).values())).figure


main = partial(run, NAME, LastCampaigns, tasks, measure, summarize, draw, UNITS)

if __name__ == "__main__":
    main()
