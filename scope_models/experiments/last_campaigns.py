"""The photometry that could be saved of K2's last campaigns, 18 and 19."""

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
from astropy.table import Table

from scope_models._checks import checked_integer
from scope_models.experiments._corrected import (
    METHODS,
    SURVIVALS,
    checked_claims,
    corrected_noise,
    medians_of,
    noise_units,
)
from scope_models.experiments._correctors import quiet
from scope_models.experiments.study import Study
from scope_models.photometry import cdpp
from scope_models.scene.detector import Detector
from scope_models.scene.motion import Motion
from scope_models.scene.star import Star
from scope_models.simulation import simulate

__all__ = ["MISSION_CDPP", "PARTS", "LastCampaigns"]

_HOURS = 6.5
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
class LastCampaigns(Study):
    """Noise of stars in the last campaigns of K2, part by part, before and after corrections.

    The stars move as `Motion.k2_final_campaign <scope_models.Motion.k2_final_campaign>`, or as a
    real file of campaign 18 says, and have the mission's effects. Stamps have a halo of three
    pixels, as the mission's. Each part is corrected for itself.

    Parameters
    ----------
    seed : int, optional
        Seed of all random numbers.
    magnitudes : tuple of float, optional
        Magnitudes Kp.
    parts : tuple of str, optional
        Out of `PARTS`; of campaign 18 the first 1200 cadences are used.
    stars : int, optional
        Stars per magnitude and part.
    motion : str, optional
        A target pixel or light-curve file of campaign 18 whose motion is taken; by default it is
        generated.
    files : tuple of str, optional
        Real target pixel files, which are corrected, too. Their noise is in EVEREST's convention.

    Raises
    ------
    TypeError, ValueError
        If a field is of the wrong type or outside its domain.

    Examples
    --------
    >>> from scope_models.experiments.last_campaigns import LastCampaigns
    >>> study = LastCampaigns(magnitudes=(12,), parts=("C19 nominal",), stars=1)
    >>> [task["key"] for task in study.tasks()]
    ['c19-nominal-kp12-0']
    """

    name: ClassVar[str] = "last-campaigns"
    units: ClassVar[dict] = noise_units()

    magnitudes: tuple[float, ...] = (10.0, 12.0, 14.0, 16.0)
    parts: tuple[str, ...] = tuple(PARTS)
    stars: int = 1
    motion: str = ""
    files: tuple[str, ...] = ()

    def __post_init__(self):
        super().__post_init__()
        checked_integer("stars", self.stars, 1)
        for name in ("magnitudes", "parts"):
            values = getattr(self, name)
            if not values or len(set(values)) < len(values):
                raise ValueError(f"`{name}` must be one or more different values, got {values}")
        for part in self.parts:
            if part not in PARTS:
                raise ValueError(f"`parts` must be among {', '.join(PARTS)}, got {part!r}")

    def tasks(self):
        """Return one task per star.

        Returns
        -------
        list of dict
            Keys "key", "part", "mag", "index" and "file", which is empty for simulated stars.
        """
        simulated = [
            {
                "key": f"{part.lower().replace(' ', '-')}-kp{mag:g}-{index}",
                "part": part, "mag": mag, "index": index, "file": "",
            }
            for index in range(self.stars)
            for part in self.parts
            for mag in self.magnitudes
        ]  # fmt: skip
        return simulated + [
            {"key": f"file{n}", "part": "file", "mag": np.nan, "index": n, "file": file}
            for n, file in enumerate(self.files)
        ]

    def observation(self, task):
        """Return the pixels of a simulated star.

        Parameters
        ----------
        task : dict
            One of `tasks`.

        Returns
        -------
        Observation
            The observation of its part of a campaign.
        """
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

        Parameters
        ----------
        task : dict
            One of `tasks`.

        Returns
        -------
        dict
            As `measure`.
        """
        return _real_noise(task["file"]) if task["file"] else super().run_star(task)

    def measure(self, task, observation):
        """Return the noise of a simulated star in 6.5 h.

        Parameters
        ----------
        task : dict
            One of `tasks`.
        observation : Observation
            Its pixels.

        Returns
        -------
        dict
            As in `~scope_models.experiments.tess.TESSNoise.measure`, and "seen", the part of the
            cadences in which half of the star's light is on the stamp.
        """
        model = observation.model().sum(axis=(1, 2))
        flux = observation.detector.flux_from_mag(task["mag"])
        return corrected_noise(observation, _HOURS) | {"seen": float(np.mean(model > flux / 2))}

    def summarize(self, table):
        """Return medians per part and magnitude, and check what was expected.

        Parameters
        ----------
        table : astropy.table.Table
            The results.

        Returns
        -------
        astropy.table.Table
            One row per part and magnitude, with the mission's own CDPP, and one per file. In
            ``meta`` "claims" and "claims_checked": verdicts, and the number that decides.
        """
        made = table[table["part"] != "file"]
        rows = medians_of(made, ("part", "mag"), ("kept", "seen", *SURVIVALS, *self.units))
        for row in table[table["part"] == "file"]:
            named = {"part": Path(row["file"]).name, "mag": row["mag"], "stars": 1}
            rows.append(
                named | {name: row[name] for name in ("kept", "seen", *SURVIVALS, *self.units)}
            )
        for row in rows:
            row["mission"] = MISSION_CDPP.get(row["part"], {}).get(row["mag"], np.nan)
        summary = Table(rows)
        for name in (*self.units, "mission"):
            summary[name].unit = "ppm"
        parts = {part: summary[summary["part"] == part] for part in PARTS}
        best = {
            part: np.fmin(np.array(rows["pld"]), np.array(rows["scene"]))
            for part, rows in parts.items()
        }
        known = {part: rows["mission"] > 0 for part, rows in parts.items()}
        nominal, erratic = (
            best[part] / np.array(parts[part]["floor"]) for part in ("C19 nominal", "C19 erratic")
        )
        claims = {
            "in campaign 18 the better corrector is below the mission's own noise": (
                best["C18"][known["C18"]] / np.array(parts["C18"]["mission"])[known["C18"]]
            ),
            "in the nominal week of campaign 19 it is below the mission's own noise": (
                best["C19 nominal"][known["C19 nominal"]]
                / np.array(parts["C19 nominal"]["mission"])[known["C19 nominal"]]
            ),
            "in the nominal week it is within 1.5 times the noise of the light": nominal / 1.5,
            "in the erratic part it is within 3 times the noise of the light": erratic / 3,
            "in the erratic part a quarter of the cadences is kept": (
                0.25 / np.array(parts["C19 erratic"]["kept"])
            ),
            "off target less than a tenth of the cadences has half of the light": (
                10 * np.array(parts["C19 off target"]["seen"])
            ),
        }
        summary.meta["claims"], summary.meta["claims_checked"] = checked_claims(claims)
        return summary

    def draw(self, table, summary):
        """Draw noise against magnitude, a panel for each part.

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
        from scope_models.plotting import plot_cdpp_panels  # imports matplotlib

        panels = {}
        for name in self.parts:
            part = summary[summary["part"] == name]
            mag = np.array(part["mag"])
            series = {"Light alone": (mag, np.array(part["floor"]))}
            series |= {label: (mag, np.array(part[key])) for key, label in METHODS.items()}
            series["Mission"] = (mag, np.array(part["mission"]))
            panels[name] = series
        return next(iter(plot_cdpp_panels(panels).values())).figure


def _real_noise(path):
    """Return the noise of a real star in EVEREST's convention, which wild cadences hardly change.

    The aperture is the file's. What needs the truth is NaN.
    """
    from scope_models.correctors import PLDCorrector, SceneCorrector  # they import lightkurve

    row = dict.fromkeys((*noise_units(), *SURVIVALS, "seen", "share"), np.nan)
    for name, make in (("pld", PLDCorrector), ("scene", SceneCorrector)):
        with quiet():
            corrector = make(path)
            light_curve = corrector.correct()
        row["aperture"] = cdpp(corrector.original_lc, duration=_HOURS, method="everest")
        row[name] = cdpp(light_curve, duration=_HOURS, method="everest")
        row["kept"] = float(np.mean(np.isfinite(light_curve.flux.value)))
        row["pixels"] = int(corrector.aperture_mask.sum())
    return row
