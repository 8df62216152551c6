"""Correctors side by side on one star."""

import time as clock
import warnings
from dataclasses import dataclass

import astropy.units as u
import numpy as np
from astropy.table import QTable
from astropy.units.cds import ppm

from scope_models._checks import checked_cadences
from scope_models.correctors.pld import PLDCorrector
from scope_models.exceptions import DetrendingWarning
from scope_models.io import read_tpf
from scope_models.photometry import cdpp

__all__ = ["ComparisonResult", "compare_correctors"]

_NAMES = ("raw", "pld", "measured", "lightkurve")
#: Tolerance: the largest residuals of windows are left out: transits, flares and damaged pixels.
_KEPT_WINDOWS = 0.9
#: Columns of a comparison and their units.
_COLUMNS = {
    "cdpp_lightkurve": ppm,
    "cdpp_everest": ppm,
    "held_out": ppm,
    "held_out_pull": None,
    "transit_survival": None,
    "seconds": u.s,
}


@dataclass(frozen=True, eq=False, repr=False)
class ComparisonResult:
    """
    Correctors on one star.

    Parameters
    ----------
    table : `~astropy.table.QTable`
        One row per corrector: ``corrector``, the ``aperture``, the CDPP of 6.5 h in both
        conventions, ``held_out`` (mean size of the residuals of windows of 6.5 h that the model
        has not seen, the same for all, without the largest tenth), ``held_out_pull`` (their rms in
        units of the expected errors), ``transit_survival`` (part of an unmasked transit that is
        left) and the time that it took. NaN where a corrector does not provide a number.
    light_curves : dict
        `~lightkurve.LightCurve` by corrector, on the same cadences.
    correctors : dict
        The corrector objects, with all their results; none for "raw".

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> from scope_models.correctors import compare_correctors
    >>> observation = simulate(
    ...     Star(13, 4, 4), Detector.k2(shape=(9, 9)), Motion.k2_roll(300, seed=1), seed=1
    ... )
    >>> comparison = compare_correctors(observation.to_tpf(), ("raw", "pld"))
    >>> list(comparison.light_curves)
    ['raw', 'pld']
    """

    table: QTable
    light_curves: dict
    correctors: dict

    def __repr__(self):
        return f"<ComparisonResult of {', '.join(self.light_curves)}>"

    def _repr_html_(self):
        return self.table._repr_html_()

    def __str__(self):
        return "\n".join(self.table.pformat(max_width=-1, max_lines=-1))

    def plot(self):
        """
        Draw the light curves below each other, on one scale.

        Returns
        -------
        `~numpy.ndarray` of `~matplotlib.axes.Axes`
            One panel per corrector.
        """
        from scope_models.plotting.detrending import plot_comparison  # imports matplotlib

        time = next(iter(self.light_curves.values())).time
        fluxes = {name: lc.flux.value for name, lc in self.light_curves.items()}
        label = f"Time ({time.format.upper()})"
        return plot_comparison(time.value, fluxes, time_label=label)


def compare_correctors(
    tpf, correctors=_NAMES, *, aperture_mask=None, cadence_mask=None, transit_mask=None
):
    """
    Compare correctors on one star.

    Parameters
    ----------
    tpf : `~lightkurve.targetpixelfile.TargetPixelFile`, str or path-like
        Target pixel file.
    correctors : sequence of str, optional
        Of "raw" (the sum over the aperture), "pld", "measured" (`PLDCorrector` with measured
        pixel fractions, as pixel level decorrelation was published) and "lightkurve"
        (lightkurve's PLDCorrector).
    aperture_mask : array_like of bool, optional
        Pixels ``(ny, nx)`` that all of them sum, by default those that `PLDCorrector` chooses.
    cadence_mask, transit_mask : array_like of bool, optional
        True where cadences may be fitted, and during transits, as in `PLDCorrector.correct`.

    Returns
    -------
    ComparisonResult
        Table, light curves and correctors. The CDPP is that of the cadences that all light curves
        have, without those in transit.

    Raises
    ------
    TypeError, ValueError
        If an argument is outside its domain.

    Warns
    -----
    DetrendingWarning
        If a corrector fails or warns; the text begins with its name.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> from scope_models.correctors import compare_correctors
    >>> observation = simulate(
    ...     Star(13, 4, 4), Detector.k2(shape=(9, 9)), Motion.k2_roll(300, seed=1), seed=1
    ... )
    >>> comparison = compare_correctors(observation.to_tpf(), ("raw", "pld"))
    >>> raw, corrected = comparison.table["cdpp_everest"]
    >>> bool(corrected < raw)
    True
    """
    tpf = read_tpf(tpf)
    correctors = [correctors] if isinstance(correctors, str) else list(correctors)
    if unknown := [name for name in correctors if name not in _NAMES]:
        raise ValueError(f"`correctors` must be of {', '.join(_NAMES)}, got {unknown[0]!r}")
    if not correctors or len(set(correctors)) < len(correctors):
        raise ValueError("`correctors` must name each corrector once")
    pld = PLDCorrector(tpf, aperture_mask)
    options = {"cadence_mask": cadence_mask, "transit_mask": transit_mask}
    objects, curves, rows = {}, {}, {}
    for name in correctors:
        begin = clock.perf_counter()
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", DetrendingWarning)
            try:
                objects[name], curves[name] = _corrected(name, tpf, pld, aperture_mask, options)
                rows[name] = {"seconds": clock.perf_counter() - begin}
            except (ValueError, np.linalg.LinAlgError) as error:
                warnings.warn(f"fails: {error}", DetrendingWarning, stacklevel=2)
        for warning in caught:
            if issubclass(warning.category, DetrendingWarning):
                warnings.warn(f"{name}: {warning.message}", DetrendingWarning, stacklevel=2)
    if not curves:
        raise ValueError("none of `correctors` could correct the file")
    common = np.all([np.isfinite(lc.flux.value) for lc in curves.values()], axis=0)
    common &= ~checked_cadences("transit_mask", transit_mask, len(common), default=False)
    windows = common & checked_cadences("cadence_mask", cadence_mask, len(common), default=True)
    objects = {name: found for name, found in objects.items() if found is not None}
    models = {k: found for k, found in objects.items() if k != "lightkurve" and found.result}
    for name, scores in _held_out(models, windows).items():
        rows[name] |= scores
    for name, found in models.items():
        rows[name]["transit_survival"] = found.result.transit_survival
    table = QTable({"corrector": list(rows)})
    table["aperture"] = [f"{pld.aperture_mask.sum()} pixels"] * len(rows)
    for name, unit in _COLUMNS.items():
        if name.startswith("cdpp"):
            method = name.removeprefix("cdpp_")
            values = [cdpp(lc[common], method=method) for lc in curves.values()]
        else:
            values = [row.get(name, np.nan) for row in rows.values()]
        table[name] = values if unit is None else u.Quantity(values, unit)
        table[name].info.format = ".1f" if unit else ".3f"
    return ComparisonResult(table, curves, objects)


def _corrected(name, tpf, pld, aperture_mask, options):
    """Return the corrector and its light curve."""
    if name == "raw":
        return None, pld.original_lc
    if name == "lightkurve":
        return _lightkurve(tpf, pld.aperture_mask, options)
    found = pld if name == "pld" else PLDCorrector(tpf, aperture_mask)
    fractions = "predicted" if name == "pld" else "measured"
    return found, found.correct(fractions=fractions, **options)


def _lightkurve(tpf, aperture, options):
    """Return lightkurve's PLDCorrector after its default call, with a fixed random state."""
    from lightkurve.correctors import PLDCorrector as LightkurveCorrector

    n = len(tpf.time)
    use = checked_cadences("cadence_mask", options["cadence_mask"], n, default=True)
    use &= ~checked_cadences("transit_mask", options["transit_mask"], n, default=False)
    state = np.random.get_state()  # noqa: NPY002 (its principal components draw from it)
    np.random.seed(0)  # noqa: NPY002
    try:
        with warnings.catch_warnings(action="ignore"):
            found = LightkurveCorrector(tpf, aperture_mask=aperture)
            lc = found.correct(cadence_mask=use)
    finally:
        np.random.set_state(state)  # noqa: NPY002
    whole = tpf.to_lightcurve(aperture_mask=aperture)
    flux = np.full(len(whole), np.nan)
    flux[np.isin(whole["cadenceno"], lc["cadenceno"])] = lc.flux.value
    whole.flux = flux * whole.flux.unit
    return found, whole


def _held_out(models, cadences):
    """Return how each corrector predicts windows of cadences, the same for all."""
    width = max((model.result.window for model in models.values()), default=0)
    if not models or cadences.sum() < 2 * width:
        return {}
    found = {name: model.held_out(width, cadences)[:2] for name, model in models.items()}
    largest = np.max([np.abs(residual) for residual, _ in found.values()], axis=0)
    kept = np.argsort(largest)[: max(int(_KEPT_WINDOWS * len(largest)), 1)]
    return {
        name: {
            "held_out": 1e6 * np.abs(residual[kept]).mean(),
            "held_out_pull": np.sqrt(np.mean((residual / error) ** 2)),
        }
        for name, (residual, error) in found.items()
    }
