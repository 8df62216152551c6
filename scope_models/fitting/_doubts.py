"""What is doubtful about a fit."""

import numpy as np
from scipy.stats import f as f_distribution

from scope_models.fitting._products import SMOOTHING_DAYS, light_of, smoothed
from scope_models.fitting._start import APART, find_stars

__all__ = ["CERTAIN", "LARGEST_FLUX", "LARGEST_SCATTER", "doubts_of", "followed", "is_measured"]

# Error of a sensitivity at a pixel's edge from which it is not measured: the paper's is lower by
# this there than in the center.
_LARGEST_EDGE_ERROR = 0.0125
# Scatter, in standard deviations of its prior or its error, that has another cause.
LARGEST_SCATTER = 3.0
# Fitted motion over that of POS_CORR that is not in doubt; least motion, pixels.
_SCALES, _LEAST_MOTION = (0.9, 1.1), 0.01
# Flux, in parts of the light in the pixels, that a model has invented.
LARGEST_FLUX = 2.0
# Errors beyond which a flux is negative, or light; probability of what is not by chance.
CERTAIN, _CHANCE = 5.0, 0.01
# Cadences from which the flux is compared with the position.
_FEWEST = 20


def doubts_of(fit):
    """Return a message for each doubt about a fit."""
    return [*_of_parameters(fit), *_of_pixels(fit), *_of_positions(fit), *_of_flux(fit)]


def is_measured(power, error):
    """Whether the error of a coefficient, of an axis and power, is small enough."""
    return error * 0.5 ** power[1] < _LARGEST_EDGE_ERROR


def _of_parameters(fit):
    if not fit.converged and not fit.at_bounds:
        yield (
            f"the fit has not converged after {fit.n_steps} steps: chi-squared {fit.chi2:.6g}, "
            f"{fit.reduced_chi2:.4g} per degree of freedom; the best parameters are kept"
        )
    powers = fit.model.response_powers
    others = [f"{name} = {fit.values[name]:.3g}" for name in fit.at_bounds if name not in powers]
    if others:
        ended = f"the fit ends at bounds, {', '.join(others)}"
        yield f"{ended}: the model does not describe the pixels; try another `psf`"
    for name in filter(powers.get, fit.names):
        axis, value, error = powers[name][0], fit.values[name], fit.errors[name]
        if name in fit.at_bounds:
            yield (
                f"the sensitivity is at its bound, {name} = {value:.3g}: it describes "
                "errors of the PSF, and is not measured"
            )
        elif np.isnan(error):
            yield (
                f"the sensitivity is not measured: the PSF is wrong by {fit.error_scale:.2g} times "
                f"the noise (chi-squared {fit.reduced_chi2:.3g}), and {name} = {value:.3g} "
                "describes that"
            )
        elif not is_measured(powers[name], error):
            yield (
                f"the motion ({np.std(getattr(fit, axis)):.2g} px rms along {axis}) does not "
                f"constrain the sensitivity: {name} = {value:.3g} +- {error:.2g}"
            )


def _of_pixels(fit):
    prior, scatter = fit.options["interpixel"], np.std(fit.interpixel - 1)
    if prior and scatter > LARGEST_SCATTER * prior:
        yield (
            f"the response between pixels scatters by {100 * scatter:.2g} %, but its prior is "
            f"{100 * prior:.2g} %: it describes errors of the PSF; interpixel=0 leaves it out"
        )
    light, invented = np.median(light_of(fit, fit.observed)), np.median(fit.flux)
    if invented > LARGEST_FLUX * light > 0:
        yield (
            f"the flux is {invented:.4g} e-/s, but the pixels hold {light:.4g}: the PSF has most "
            "of its light outside of them, or two of its terms cancel"
        )
    if fit.error_scale > 1:
        row, column = np.unravel_index(np.nanargmax(fit.chi2_pixels), fit.chi2_pixels.shape)
        yield (
            f"the model does not describe the pixels: chi-squared per degree of freedom is "
            f"{fit.reduced_chi2:.4g}, and largest in column {column}, row {row}; all errors are "
            f"{fit.error_scale:.3g} times those of the noise"
            + ("" if fit.response else '; response="pixels" fits the share of each pixel')
        )
    if fit.error_scale > 1 or fit.response:  # which takes up the light of any star
        stars = np.array([np.median([star.x, star.y], axis=1) for star in (fit, *fit.neighbors)])
        away = np.linalg.norm(find_stars(fit.observed)[:, None] - stars, axis=2).min(axis=1)
        if others := np.sum(away > APART):
            yield (
                f"{others} other maxi{'mum' if others == 1 else 'ma'} of the median image may be "
                'other stars: neighbors="find" fits them'
            )


def _described(fit):
    """Cadences that are no outliers."""
    return np.ones(len(fit.time), dtype=bool) if fit.outliers is None else ~fit.outliers


def _of_positions(fit):
    remedy = "" if fit.options["positions"] == "path" else 'positions="path" or '
    for axis, slope, size in zip("xy", fit.path_scale(), fit.shape[::-1], strict=True):
        position, error = getattr(fit, axis), np.median(getattr(fit, f"{axis}_err"))
        if not _SCALES[0] < slope < _SCALES[1] and np.isfinite(slope):
            path = fit.pos_corr[:, "xy".index(axis)].std()
            differs = abs(slope - 1) * path > 3 * error / len(fit.x) ** 0.5
            if differs and path * max(1.0, abs(slope)) > _LEAST_MOTION:
                yield (
                    f"the fitted motion along {axis} is {slope:.2g} times that of POS_CORR: the "
                    f"PSF may have absorbed it; {remedy}a richer PSF prevents it"
                )
        if not 0 <= np.median(position) <= size - 1:
            yield f"the star is at the edge of the pixels: {axis} = {np.median(position):.2f}"
        if lost := np.sum((position <= -1) | (position >= size)):
            yield f"in {lost} cadences the fitted {axis} ends at its bounds, off the pixels"


def _of_flux(fit):
    # A PSF that leaves the whole flux open, as on a small stamp, hides no star.
    light, error = np.mean(fit.flux), np.sqrt(np.mean(fit.flux_scatter**2) / len(fit.flux))
    if abs(light) < LARGEST_SCATTER * error:
        yield f"no star is seen: its mean flux is {light:.3g} +- {error:.2g} e-/s"
    for number, star in enumerate((fit, *fit.neighbors)):
        if negative := np.sum(star.flux < -CERTAIN * star.flux_err):
            name = f"neighbor {number}" if number else "the star"
            yield f"the flux of {name} is negative in {negative} cadences"
    if fit.response and fit.neighbors:
        yield (
            'response="pixels" divides the light of several stars between them by the PSF: the '
            "fluxes of the fainter ones have larger errors than those given"
        )
    seen = np.isfinite(fit.observed)
    whole = seen.sum(axis=(1, 2)) == seen.any(axis=0).sum()
    fluxes = np.column_stack([fit.flux, light_of(fit, fit.observed)])
    steps = np.diff(fluxes[whole & _described(fit)], axis=0)
    ours, pixels = np.sqrt(np.sum(steps**2, axis=0) / max(len(steps), 1))
    error = float(np.sqrt(np.mean(fit.flux_scatter**2)))
    if ours > LARGEST_FLUX * np.hypot(pixels, error):
        yield (
            f"the flux changes by {ours:.3g} e-/s from cadence to cadence, and the light in "
            f"the pixels by {pixels:.3g}: the data allow several solutions"
        )
    if (explained := followed(fit)) > LARGEST_SCATTER * error:
        yield (
            f"the flux varies with the position of the star by {explained:.3g} e-/s rms, but its "
            f"error is {error:.3g}: the model does not separate the two"
        )


def followed(fit):
    """Return the rms of fast flux that a quadratic form of the position explains, 0 if by chance.

    Spans of the smoothing count as independent.
    """
    good = _described(fit)
    if good.sum() < _FEWEST:
        return 0.0
    time, x, y, flux = (values[good] for values in (fit.time, fit.x, fit.y, fit.flux))
    x, y = x - x.mean(), y - y.mean()
    columns = [values - smoothed(time, values) for values in (flux, x, y, x * x, x * y, y * y)]
    fast, *terms = (column - column.mean() for column in columns)
    terms = np.column_stack(terms)
    part = terms @ np.linalg.lstsq(terms, fast, rcond=None)[0]
    free = max(min(np.ptp(time) / SMOOTHING_DAYS, len(time)) - terms.shape[1] - 1, 1)
    noise = np.mean(fit.flux_scatter[good] ** 2)
    rest = max(np.mean((fast - part) ** 2) - noise, 0.0)
    expected = terms.shape[1] * (noise / len(time) + rest / free)
    ratio = np.mean(part**2) / max(expected, 1e-300)
    by_chance = f_distribution.sf(ratio, terms.shape[1], free) >= _CHANCE
    return 0.0 if by_chance else float(part.std())
