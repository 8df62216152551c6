"""The photometry that could be saved of K2's last campaigns, 18 and 19."""

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from scope_models.experiments._corrected import SURVIVALS, CorrectedStudy, curves
from scope_models.experiments._correctors import quiet
from scope_models.experiments.study import parameter
from scope_models.photometry import cdpp
from scope_models.scene import Detector, Motion, Star
from scope_models.simulation import simulate

__all__ = ["MISSION_CDPP", "PARTS", "LastCampaigns"]

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


@dataclass(frozen=True, kw_only=True)
class LastCampaigns(CorrectedStudy):
    """Noise of stars in the last campaigns of K2, part by part, before and after corrections.

    The stars move as `Motion.k2_final_campaign <scope_models.Motion.k2_final_campaign>`, or as a
    real file of campaign 18 shows, and have the mission's effects. Stamps have a halo of three
    pixels, as the mission's. Each part is corrected for itself.

    Examples
    --------
    >>> from scope_models.experiments.last_campaigns import LastCampaigns
    >>> study = LastCampaigns(magnitudes=(12,), parts=("C19 nominal",), stars=1)
    >>> [task["key"] for task in study.tasks()]
    ['c19-nominal-kp12-0']
    """

    name: ClassVar[str] = "last-campaigns"
    grid: ClassVar[dict] = {"index": "stars", "part": "parts", "mag": "magnitudes"}
    key: ClassVar[str] = "{part}-kp{mag:g}-{index}"
    cell: ClassVar[tuple] = ("part", "mag")
    columns: ClassVar[tuple] = ("kept", "seen", *SURVIVALS)

    magnitudes: tuple[float, ...] = parameter(
        (10.0, 12.0, 14.0, 16.0), "Magnitudes Kp.", different="values"
    )
    parts: tuple[str, ...] = parameter(
        tuple(PARTS),
        "Out of `PARTS`; of campaign 18 the first 1200 cadences are used.",
        different="values",
        among=PARTS,
    )
    stars: int = parameter(1, "Stars per magnitude and part.", least=1)
    motion: str = parameter(
        "",
        "A target pixel or light-curve file of campaign 18 whose motion is taken; by default it "
        "is generated.",
    )
    files: tuple[str, ...] = parameter(
        (),
        "Real target pixel files, which are corrected, too. Their noise is in EVEREST's "
        "convention.",
    )

    def tasks(self):
        """Return one task per star; "file" is empty for simulated ones."""
        tasks = [task | {"file": ""} for task in super().tasks()]
        for task in tasks:
            task["key"] = task["key"].replace(task["part"], task["part"].lower().replace(" ", "-"))
        return tasks + [
            {"key": f"file{n}", "part": "file", "mag": np.nan, "index": n, "file": file}
            for n, file in enumerate(self.files)
        ]

    def observation(self, task):
        """Return the pixels of a simulated star in its part of a campaign."""
        campaign, first, last = PARTS[task["part"]]
        rng = self.star_rng(task["key"])
        if campaign == 18 and self.motion:
            motion = Motion.from_file(self.motion)
        else:
            angle = rng.uniform(0, 2 * np.pi)
            distance = 6.9 * np.sqrt(rng.random())
            seed = self.star_seed(task["key"], "motion") % 2**31
            motion = Motion.k2_final_campaign(
                campaign=campaign, seed=seed,
                field=(distance * np.cos(angle), distance * np.sin(angle)),
            )  # fmt: skip
        motion = motion[(motion.cadenceno >= first) & (motion.cadenceno <= last)]
        if task["part"] == "C19 off target":
            # Its flags would take every cadence; the correctors are to be given a chance.
            motion = Motion(motion.time, motion.x, motion.y, cadenceno=motion.cadenceno)
        detector = Detector.k2_calibrated(shape=(9, 9))
        place = 4 + rng.uniform(-0.5, 0.5, 2)
        seed = self.star_seed(task["key"], "noise")
        with quiet():  # the star leaves its stamp
            return simulate(
                Star(task["mag"], *place), detector, motion, seed=seed, effects="mission"
            )

    def run_star(self, task):
        """Return the noise of a star in 6.5 h, simulated or real.

        That of real stars is in EVEREST's convention, which wild cadences hardly change, in the
        aperture of the file; what needs the truth is NaN.
        """
        if not task["file"]:
            return super().run_star(task)
        from scope_models.correctors import PLDCorrector, SceneCorrector  # they import lightkurve

        row = dict.fromkeys((*self.units, *SURVIVALS, "seen", "share"), np.nan)
        for name, make in (("pld", PLDCorrector), ("scene", SceneCorrector)):
            with quiet():
                corrector = make(task["file"])
                light_curve = corrector.correct()
            row["aperture"] = cdpp(corrector.original_lc, duration=self.hours, method="everest")
            row[name] = cdpp(light_curve, duration=self.hours, method="everest")
            row["kept"] = float(np.mean(np.isfinite(light_curve.flux.value)))
            row["pixels"] = int(corrector.aperture_mask.sum())
        return row

    def measure(self, task, observation):
        """Return the noise of a simulated star, and how much of it the stamp holds.

        As `TESSNoise.measure <scope_models.experiments.tess.TESSNoise>`, and "seen", the part of
        the cadences in which half of the star's light is on the stamp.
        """
        model = observation.model().sum(axis=(1, 2))
        flux = observation.detector.flux_from_mag(task["mag"])
        return super().measure(task, observation) | {"seen": float(np.mean(model > flux / 2))}

    def medians(self, table):
        """Return one row per part and magnitude, and one per file."""
        rows = super().medians(table[table["part"] != "file"])
        for row in table[table["part"] == "file"]:
            named = {"part": Path(row["file"]).name, "mag": row["mag"], "stars": 1}
            rows.append(named | {name: row[name] for name in (*self.columns, *self.units)})
        return rows

    def compare(self, table, summary):
        """Add "mission", the mission's own CDPP."""
        summary["mission"] = [
            MISSION_CDPP.get(part, {}).get(mag, np.nan)
            for part, mag in summary.iterrows("part", "mag")
        ]
        summary["mission"].unit = "ppm"

    def claims(self, summary):
        """Return the ratio of each claim to its limit."""
        parts = {part: summary[summary["part"] == part] for part in PARTS}
        best = {
            part: np.fmin(np.array(rows["pld"]), np.array(rows["scene"]))
            for part, rows in parts.items()
        }

        def over(part, column):
            ratio = best[part] / np.array(parts[part][column])
            return ratio[parts[part]["mission"] > 0] if column == "mission" else ratio

        return {
            "in campaign 18 the better corrector is below the mission's own noise": (
                over("C18", "mission")
            ),
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

    def draw(self, table, summary):
        """Draw noise against magnitude, a panel for each part."""
        from scope_models.plotting import plot_cdpp_panels  # imports matplotlib

        panels = {
            name: curves(summary[summary["part"] == name], mission="Mission") for name in self.parts
        }
        return next(iter(plot_cdpp_panels(panels).values())).figure
