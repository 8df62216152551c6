"""The paper's motion test: de-trended noise against magnitude at multiples of K2's motion."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from astropy.table import Table

from scope_models.experiments._claims import (
    CLAIMS,
    TRANSIT_CLAIM,
    TRANSIT_DEFINITION,
    check_transits,
    kepler_like_to,
    paper_limit,
)
from scope_models.experiments._correctors import (
    CONVENTIONS,
    best_setting,
    correct,
    noise_of,
    transit_amplitude,
)
from scope_models.experiments._statistics import cells, percentiles, values_of
from scope_models.experiments.k2_motion import DETECTORS
from scope_models.experiments.populations import cached_motion, draw_star, stamp_around
from scope_models.experiments.reference import read_reference, reference_noise
from scope_models.experiments.study import Study, parameter
from scope_models.models import TransitModel
from scope_models.simulation import simulate

__all__ = ["MotionTest"]

_CORRECTORS = ("pld", "lightkurve_pld", "lightkurve_sff")
_TITLES = {
    "pld": "PLD (scope_models)",
    "lightkurve_pld": "PLD (lightkurve, best order)",
    "lightkurve_sff": "SFF (lightkurve)",
}
_COLUMNS_IN_PPM = (
    *(f"{name}_{method}" for name in ("raw", "floor", *_CORRECTORS) for method in CONVENTIONS),
    *(f"depth_{name}" for name in ("masked", "masked_error", "joint", "joint_error")),
    *(f"depth_{name}" for name in _CORRECTORS[1:]),
)
_WITH_PERCENTILES = [f"{name}_everest" for name in _CORRECTORS]
_KEPLER_COLUMNS = ("kepler_median", "kepler_p10", "kepler_p90")
_MARGINS = {"paper": 5, "calibrated": 8}  # pixels; the calibrated PSF has wings
_TRANSIT_SCALE = 5.0  # of the paper's claim on transits
_PERIOD, _DURATION = 3.1, 0.25  # of the transits, days


@dataclass(frozen=True, kw_only=True)
class MotionTest(Study):
    """De-trended noise of stars that move as K2's, and by multiples of it: the paper's figure 5.

    Each star of the grid is drawn as `~scope_models.experiments.populations.draw_star` does, is
    simulated, and is de-trended by
    `~scope_models.correctors.PLDCorrector` and, if wanted, by lightkurve's correctors in the same
    aperture. At some motions a second simulation, with the same noise, has transits.

    References
    ----------
    Saunders, N. et al. 2019, "The Pointing Limits of Transiting Exoplanet Light Curve
    Characterization with Pixel Level De-correlation", figure 5.

    Examples
    --------
    >>> from scope_models.experiments.motion import MotionTest
    >>> study = MotionTest(stars=1, magnitudes=(12,), scales=(1, 5), cadences=300)
    >>> [task["key"] for task in study.tasks()]
    ['kp12-x1-0', 'kp12-x5-0']
    """

    name: ClassVar[str] = "motion"
    units: ClassVar[dict] = dict.fromkeys(_COLUMNS_IN_PPM, "ppm")
    grid: ClassVar[dict] = {"index": "stars", "scale": "scales", "mag": "magnitudes"}
    key: ClassVar[str] = "kp{mag:g}-x{scale:g}-{index}"

    magnitudes: tuple[float, ...] = parameter(
        tuple(10 + 0.5 * k for k in range(12)), "Magnitudes Kp.", different="numbers"
    )
    scales: tuple[float, ...] = parameter(
        (1.0, 2.0, 4.0, 5.0, 10.0), "Multiples of the motion.", different="numbers", positive=True
    )
    stars: int = parameter(5, "Stars per magnitude and multiple.", least=1)
    cadences: int = parameter(1000, "Cadences per star.", least=100)
    motion: str = parameter(
        "k2_roll", "Motion, as `~scope_models.experiments.populations.motion_from_name` takes it."
    )
    detector: str = parameter(
        "paper",
        "`Detector.k2 <scope_models.Detector.k2>` with the paper's response, or "
        "`Detector.k2_calibrated <scope_models.Detector.k2_calibrated>`, which has K2's noise.",
        among=DETECTORS,
    )
    order: int = parameter(2, "Order of our PLD.", least=1)
    transit_depth: float = parameter(1000.0, "Depth of the transits that are put in, ppm.")
    transit_scales: tuple[float, ...] = parameter(
        (_TRANSIT_SCALE,),
        "Multiples of the motion at which transits are put in; those that are not in `scales` are "
        "passed over.",
        positive=True,
    )
    lightkurve_pld: bool = parameter(
        True, "Whether to run lightkurve's PLD too, with the best of orders 1 to 3, two apertures."
    )
    lightkurve_sff: bool = parameter(
        True,
        "Whether to run lightkurve's SFF too, with the best of 5, 10 and 20 windows and the true "
        "positions.",
    )

    def __post_init__(self):
        super().__post_init__()
        known = read_reference("kepler")["mag"]
        if min(self.magnitudes) < known.min() or max(self.magnitudes) > known.max():
            raise ValueError(
                f"`magnitudes` must be within {known.min():g} and {known.max():g}, where Kepler's "
                f"noise is known, got {self.magnitudes}"
            )
        if not 0 < self.transit_depth < 1e6:
            raise ValueError(
                f"`transit_depth` must be between 0 and 1e6 ppm, got {self.transit_depth}"
            )

    def observation(self, task):
        """Return the pixels of a star without transits."""
        motion = task["scale"] * cached_motion(self.motion, self.cadences)
        shape, x_0, y_0 = stamp_around(motion, _MARGINS[self.detector])
        detector = DETECTORS[self.detector](shape=shape)
        star = draw_star(self.star_rng(task["key"]), task["mag"], detector, x_0=x_0, y_0=y_0)
        return simulate(star, detector, motion, seed=self.star_seed(task["key"], "noise"))

    def measure(self, task, observation):
        """Return the noise of a star before and after de-trending, and depths of transits.

        CDPP in ppm in both conventions: "raw", "floor" (of the noise alone in the aperture's sum)
        and of each corrector, followed by the convention; "residual", that of ours over the floor;
        the scores "held_out_mad" and "held_out_rms", see the page on PLD; and the number of pixels
        in the aperture. At `transit_scales` the depths in ppm, of ours with the transits masked
        and jointly fitted, and the part of the depth that each corrector leaves if the transits
        are not masked.
        """
        from scope_models.correctors import PLDCorrector  # imports lightkurve

        tpf = observation.to_tpf()
        corrector = PLDCorrector(tpf)
        corrector.correct(order=self.order)
        aperture = corrector.aperture_mask
        row = {"pixels": int(aperture.sum())} | noise_of(corrector, observation)
        settings = {}
        for name in _CORRECTORS[1:]:
            if getattr(self, name):
                lowest, best = best_setting(name, tpf, aperture)
                row |= {f"{name}_{method}": value for method, value in lowest.items()}
                if best is not None:
                    settings[name] = best
        if task["scale"] in self.transit_scales:
            row |= self._depths(task, observation, aperture, settings)
        return row

    def _depths(self, task, observation, aperture, settings):
        """Return the depths of transits, of which the first one is anywhere within a period."""
        from scope_models.correctors import PLDCorrector

        first = self.star_rng(task["key"], "transit").uniform(0, _PERIOD)
        planet = TransitModel.from_depth_duration(
            1e-6 * self.transit_depth, _DURATION, _PERIOD, observation.time[0] + first,
            exposure_time=observation.detector.cadence_days,
        )  # fmt: skip
        star = observation.stars[0].replace(signal=planet)
        tpf = simulate(observation.scene.replace(stars=[star])).to_tpf()
        transit = planet(tpf.time.value)
        outside = transit == 1
        corrector = PLDCorrector(tpf, aperture_mask=aperture)
        corrector.correct(order=self.order, transit_mask=~outside)
        found = {"masked": corrector.fit_transit(transit)}
        corrector.correct(order=self.order, transit_model=transit)
        result = corrector.result
        found["joint"] = result.transit_scale, result.transit_scale_err
        row = {
            f"depth_{name}{end}": value * self.transit_depth
            for name, values in found.items()
            for end, value in zip(("", "_error"), values, strict=True)
        }
        flux = corrector.correct(order=self.order).flux.value
        row["survival_pld"] = transit_amplitude(flux, transit)
        for name, setting in settings.items():
            ways = ("survival", None, 1), ("depth", outside, self.transit_depth)
            for column, mask, unit in ways:
                flux = correct(name, setting, tpf, aperture, mask)
                if flux is not None:
                    row[f"{column}_{name}"] = unit * transit_amplitude(flux, transit)
        return row

    def summarize(self, table):
        """Return medians per motion and magnitude beside Kepler's, and check the paper's claims.

        One row per motion and magnitude: medians of the columns of `measure`, and the 16th and
        84th percentile of the CDPP in EVEREST's convention; Kepler's median, 10th and 90th
        percentile, and our CDPP over Kepler's median; and "below_paper", the limit that the paper
        states over our CDPP. In ``meta``, "claims" has, for each claim of the paper, by its name,
        whether it holds for ours; "claims_checked" has its definition, and for each corrector
        whether it holds and by which number; "kepler_like_to" has the faintest magnitude to which
        each multiple of the motion is Kepler-like; "survival" has the median, 16th and 84th
        percentile of the part of a transit's depth that is left.
        """
        summary = Table([_medians(cell, rows) for cell, rows in cells(table, ("scale", "mag"))])
        mags = np.array(summary["mag"])
        for name in _KEPLER_COLUMNS:
            noise = reference_noise("kepler", mags, name.removeprefix("kepler_"))
            summary[name] = np.round(noise, 2)
        summary["over_kepler"] = summary["pld_everest"] / summary["kepler_median"]
        limits = [paper_limit(scale, mag) for scale, mag in summary.iterrows("scale", "mag")]
        summary["below_paper"] = np.array(limits) / summary["pld_everest"]
        checked = self._checked_claims(table, summary)
        summary.meta["claims"] = {name: claim["pld"]["verdict"] for name, claim in checked.items()}
        summary.meta["claims_checked"] = checked
        summary.meta["survival"] = {
            name: dict(zip(("low", "median", "high"), percentiles(values), strict=True))
            for name in _CORRECTORS
            for values in [values_of(table, f"survival_{name}")]
            if np.isfinite(values).any()
        }
        summary.meta["kepler_like_to"] = {
            name: kepler_like_to(part["mag"], part["pld_everest"], part["kepler_median"])
            for name, part in _by_scale(summary).items()
        }
        for name in summary.colnames:
            if name.removesuffix("_low").removesuffix("_high") in (*self.units, *_KEPLER_COLUMNS):
                summary[name].unit = "ppm"
        return summary

    def _checked_claims(self, table, summary):
        """Return each claim by its name: its definition, and the result of each corrector."""
        scale, mag, kepler = (np.array(summary[k]) for k in ("scale", "mag", "kepler_median"))
        claims = {}
        for claim in CLAIMS:
            claims[claim.name] = {"definition": claim.definition}
            for name in _present(summary):
                found = claim.check(scale, mag, np.array(summary[f"{name}_everest"]), kepler)
                claims[claim.name][name] = found
        claims[TRANSIT_CLAIM] = {"definition": TRANSIT_DEFINITION}
        rows = table[table["scale"] == _TRANSIT_SCALE]
        for name, how in (("pld", "masked"), ("pld_joint", "joint")):
            depth, error = (values_of(rows, f"depth_{how}{end}") for end in ("", "_error"))
            claims[TRANSIT_CLAIM][name] = check_transits(depth, error, self.transit_depth)
        return claims

    def draw(self, table, summary):
        """Draw CDPP against magnitude: a panel per corrector, a curve per motion."""
        from scope_models.plotting import plot_cdpp_panels  # imports matplotlib

        parts = _by_scale(summary)
        panels = {}
        for name in _present(summary):
            columns = ["mag", *(f"{name}_everest{end}" for end in ("", "_low", "_high"))]
            panels[_TITLES[name]] = {
                scale: [np.array(part[k]) for k in columns] for scale, part in parts.items()
            }
        mags = np.array(read_reference("kepler")["mag"])  # also beside the stars, if they are few
        mags = mags[(mags >= min(summary["mag"]) - 0.5) & (mags <= max(summary["mag"]) + 0.5)]
        kepler = {"mag": mags, "label": "Kepler, median", "band_label": "Kepler, 10 % to 90 %"}
        for key, column in (("median", "median"), ("low", "p10"), ("high", "p90")):
            kepler[key] = reference_noise("kepler", mags, column)
        limits = [
            (claim.faintest, claim.limit, f"paper, {claim.scale:g}x")
            for claim in CLAIMS
            if claim.limit and f"{claim.scale:g}x" in parts and "caption" not in claim.name
        ]
        residuals = {
            scale: (np.array(part["mag"]), np.array(part["residual_everest"]))
            for scale, part in parts.items()
            if "residual_everest" in summary.colnames
        }
        axes = plot_cdpp_panels(panels, kepler, limits=limits, residuals=residuals)
        if residuals:
            axes["Residual over noise"].set_title(f"{_TITLES['pld']}, residual over noise")
        return axes[_TITLES["pld"]].figure


def _medians(cell, rows):
    """Return the medians of all columns of the stars of a cell, and some percentiles."""
    cell = {name: float(value) for name, value in cell.items()} | {"stars": len(rows)}
    for name in rows.colnames:
        if name not in {"key", "index", "scale", "mag", "stars"}:
            low, cell[name], high = percentiles(values_of(rows, name))
            if name in _WITH_PERCENTILES:
                cell[f"{name}_low"], cell[f"{name}_high"] = low, high
    return cell


def _by_scale(summary):
    """Return the rows of each multiple of the motion, as "5x"."""
    scales = sorted(set(summary["scale"]))
    return {f"{scale:g}x": summary[summary["scale"] == scale] for scale in scales}


def _present(summary):
    """Return the correctors of which there are results."""
    return [name for name in _CORRECTORS if f"{name}_everest" in summary.colnames]
