"""The response of each pixel: shares of a star's light that are smooth in position and time.

Shares begin as those of a PSF that is fitted to some of the cadences. Each pixel's deviation is a
polynomial of the star's fitted position and slow time, with priors whose widths the data give.
Shares and cadences are fitted in turn, each by linear least squares. What all pixels have in common
is the star's flux or the pixels' response: the default correction separates these.
"""

import warnings
from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from astropy.stats import mad_std
from scipy.linalg import cho_factor, cho_solve

from scope_models.effects.light import PixelShares, polynomial_terms, polynomials, scaled_to
from scope_models.exceptions import FitWarning
from scope_models.fitting._problem import MEDIAN_SQUARE, UNTRUE, State, median_image
from scope_models.fitting._products import cadence_table, parameter_table
from scope_models.fitting._solver import Errors, psf_covariance
from scope_models.fitting._start import centroids, linear_start, solved
from scope_models.fitting.result import fitted_fields
from scope_models.pixelmodel._pixels import (
    aperture_pixels,
    at_rows,
    credible_flux,
)
from scope_models.pixelmodel._source import Source, can_predict, with_predicted_fractions
from scope_models.pixelmodel._stamp import POSITION_PRIOR
from scope_models.pixelmodel._star import MISFIT
from scope_models.regression._columns import (
    Regressors,
    fraction_columns,
    least_square,
    principal_columns,
)
from scope_models.regression._solution import DEFAULT, NothingToCorrectError, fit

__all__ = ["fit_response"]

# Degrees in position and time, in turn.
_LADDER = ((1, 1), (2, 2), (3, 3), (4, 4), (5, 6), (6, 8), (8, 8), (10, 8))
# Multiplications in all steps, half of them for the choice: 30 s, for one core makes 1e10 a second
# if a step's cadences take as many as the shares of 80 terms.
_MOST_WORK, _CADENCE_TERMS = 3e11, 80
# Steps on each rung; relative gain of held-out cadences from it.
_TRIAL_STEPS, _LEAST_GAIN = 4, 1e-2
# Every tenth cadence is held out, from the sixth on; fewest in all.
_EVERY, _FIRST, _FEWEST = 10, 5, 20
# Standard deviation of free positions, pixels.
_LOOSE = 10.0
# First standard deviation of a share, relative to it plus a part of all light; smallest one.
_FIRST_PRIOR, _EVERYWHERE, _LEAST_PRIOR = 0.3, 0.003, 1e-6
# Errors beyond which a pixel is hit, unless more than a part of its values is; robust standard
# deviations of chi-squared beyond which a cadence is an outlier.
_HIT, _MOST_HITS, _OUTLIER = 5.0, 0.02, 6.0
# Largest step of a position, pixels; change of the cost that is none, relative and in its scatter;
# most last steps.
_MOVE, _SAME, _SMALL, _MOST_STEPS = 0.1, 3e-4, 0.01, 80
# Reach of the polynomials beyond percentiles of positions, in parts of their range and pixels.
_PAD, _INSIDE = (0.05, 0.01), (0.2, 99.8)
# Motion up to which an image is of first order, pixels; cadences at once.
_TAYLOR, _CHUNK = 1e-3, 512
# Residual, in errors, from which the cost grows only linearly.
_SOFT = 3.0


@dataclass(eq=False)
class _Image:
    """A star in the ``p`` pixels of its file."""

    pixels: slice  # of all fitted ones
    psf: np.ndarray  # (3, n, p): unit image where the star was, and derivatives by place
    size: np.ndarray  # (p,): typical share
    unit: np.ndarray  # (p,): scale of its change, 0 where there is too little light to learn from
    parts: np.ndarray  # (p,): effect of a common factor
    values: np.ndarray  # (k, p): coefficients


class _Shares:
    """Images of all stars, with polynomials in all pixels, and the state of the cadences."""

    def __init__(self, problem, state, center, error):
        self.problem, self.state, self.weight = problem, state, problem.weight
        self.center, self.error = center, error
        # Masks of the cadences in use and of those that are held out.
        self.used, self.held = np.ones(len(center), dtype=bool), np.zeros(len(center), dtype=bool)
        self.held[_FIRST::_EVERY] = True
        low, high = np.percentile(center, _INSIDE, axis=0)
        pad, time = _PAD[0] * (high - low) + _PAD[1], problem.data.time
        last = max(time.max(), time.min() + 1)
        self.ranges = (*zip(low - pad, high + pad, strict=True), (time.min(), last))
        self.images, self.places = [], np.full((len(center), 2), np.inf)
        stamps = [star.stamp for star in problem.stars]
        self.firsts = [stamps.index(stamp) for stamp in range(len(problem.stamps))]
        for k, stamp in enumerate(stamps):
            typical = problem.unit_images(state, slice(None, None, _EVERY), k)
            size = np.maximum(np.median(typical, axis=0), 0.0)
            learns = (size >= _EVERYWHERE) | (k in self.firsts)
            parts = size * learns
            self.images.append(_Image(
                problem.slices[stamp], np.zeros((3, len(center), size.size)), size,
                (size + _EVERYWHERE) * learns, parts / parts.sum(), np.zeros((1, size.size)),
            ))  # fmt: skip
        self.degrees, self.terms = (0, 0), polynomial_terms(0, 0)
        self.width = np.array([_FIRST_PRIOR])
        # Corrected fluxes are given; other ones are fitted.
        self.given = np.zeros(state.cadence.shape, dtype=bool)
        self.flux_error = np.zeros((len(center), len(problem.stars)))

    @property
    def order(self):
        return self.terms.sum(axis=1)

    def richer(self, *degrees):
        other = copy(self)
        other.degrees, other.terms = degrees, polynomial_terms(*degrees)
        index = (other.terms == self.terms[:, np.newaxis]).all(axis=2).argmax(axis=1)
        other.images = []
        for image in self.images:
            values = np.zeros((len(other.terms), image.size.size))
            values[index] = image.values
            other.images.append(replace(image, values=values))
        more = other.order.max() + 1 - len(self.width)
        other.width = np.append(self.width, [self.width[-1]] * more)
        return other

    def basis(self):
        """Polynomials of the cadences, and derivatives by column and row, ``(n, k)``."""
        values = (*self.problem.xy(self.state).T, self.problem.data.time)
        scaled = [scaled_to(v, limits) for v, limits in zip(values, self.ranges, strict=True)]
        value, *slopes = polynomials(self.terms, *scaled)
        for axis in (0, 1):
            rate = np.where(np.abs(scaled[axis]) < 1, 2 / np.ptp(self.ranges[axis]), 0.0)
            slopes[axis] *= rate[:, np.newaxis]
        return value, *slopes

    def psf(self):
        """Unit images of the PSF, and derivatives by place, ``(3, n, p)`` per star."""
        xy = self.problem.xy(self.state)
        moved = np.flatnonzero(np.abs(xy - self.places).max(axis=1) > _TAYLOR)
        for start in range(0, len(moved), _CHUNK):
            some = moved[start : start + _CHUNK]
            for k, image in enumerate(self.images):
                value, by = self.problem.unit_images(self.state, some, k, derivatives=True)
                image.psf[:, some] = value, *by[:2]
        self.places[moved] = xy[moved]
        right, up = (xy - self.places).T[..., np.newaxis]
        psfs = (image.psf for image in self.images)
        return [(value + right * x + up * y, x, y) for value, x, y in psfs]

    def residual(self, *, slopes=False):
        """Data less model ``(n, p)``, and derivatives of the model by the cadences' columns."""
        problem, state, k = self.problem, self.state, len(self.problem.columns)
        residual = problem.flux.copy()
        design = np.zeros((*residual.shape, k if slopes else 0))
        basis = self.basis()[: 3 if slopes else 1]
        for number, (image, psf) in enumerate(zip(self.images, self.psf(), strict=True)):
            column, flux = problem.flux_number(number), problem.fluxes(state, number)[:, None]
            value, *by = (p + b @ image.values for p, b in zip(psf, basis, strict=False))
            residual[:, image.pixels] -= flux * value
            for axis, slope in enumerate(by):
                design[:, image.pixels, axis] += flux * slope
            if slopes and column < k:
                design[:, image.pixels, column] = value * ~self.given[:, [column]]
        for number, pixels in enumerate(problem.slices):
            residual[:, pixels] -= problem.backgrounds(state, number)[:, None]
            if slopes and problem.options.background == "cadence":
                design[:, pixels, problem.background_number(number)] = 1.0
        return (residual, design) if slopes else residual

    def pixels(self):
        """Yield each pixel's number, that in its file, and fluxes and images to learn from."""
        for pixels in self.problem.slices:
            own = [
                (self.problem.fluxes(self.state, k), image)
                for k, image in enumerate(self.images)
                if image.pixels == pixels
            ]
            for number, pixel in enumerate(range(pixels.start, pixels.stop)):
                yield pixel, number, [pair for pair in own if pair[1].unit[number]]

    def update(self):
        learned, order = self.used & ~self.held, self.order
        phi, rest = self.basis()[0][learned], self.residual()[learned]
        squares, counts = np.zeros_like(self.width), np.zeros_like(self.width)
        self.covariance, self.n_free = [], 0.0
        for pixel, number, stars in self.pixels():
            weight = self.weight[learned, pixel]
            values = np.concatenate([image.values[:, number] for _, image in stars])
            # No share changes by more than all of the light.
            widths = [self.width[order] * image.unit[number] for _, image in stars]
            scale = np.minimum(np.concatenate(widths), 1.0)
            # In units of the priors, all eigenvalues are 1 and more.
            light = [phi * (flux[learned] * weight)[:, None] for flux, _ in stars]
            weighted = np.hstack(light) * scale
            normal = weighted.T @ weighted
            right = weighted.T @ (weight * rest[:, pixel]) + normal @ (values / scale)
            normal[np.diag_indices_from(normal)] += 1.0
            factor = cho_factor(normal)
            values = scale * cho_solve(factor, right)
            covariance = cho_solve(factor, np.eye(len(values)))
            self.n_free += float(np.sum(1 - np.diag(covariance)))
            self.covariance.append(covariance * scale * scale[:, None])
            variances = np.diag(self.covariance[-1])
            parts = np.reshape((values, variances), (2, len(stars), -1)).transpose(1, 0, 2)
            for (_, image), (value, variance) in zip(stars, parts, strict=True):
                image.values[:, number] = value
                scaled = (value**2 + variance) / image.unit[number] ** 2
                squares += np.bincount(order, scaled, len(squares))
                counts += np.bincount(order, minlength=len(squares))
        self.width = np.maximum(np.sqrt(squares / counts), _LEAST_PRIOR)

    def responses(self):
        """Typical share of each pixel over the PSF's, less 1, ``(p,)``."""
        light = np.zeros((2, self.weight.shape[1]))
        for k, image in enumerate(self.images):
            flux = np.median(self.problem.fluxes(self.state, k))
            light[:, image.pixels] += flux * np.array([image.values[0], image.size])
        return light[0] / np.maximum(light[1], _LEAST_PRIOR)

    def equations(self):
        """Normal equations of the cadences, with the positions' prior, and derivatives."""
        residual, design = self.residual(slopes=True)
        weighted = design * self.weight[..., None]
        normal = weighted.transpose(0, 2, 1) @ weighted
        right = np.einsum("npk,np->nk", weighted, self.weight * residual)
        normal[:, [0, 1], [0, 1]] += self.error**-2
        right[:, :2] += (self.center - self.state.cadence[:, :2]) / self.error**2
        return normal, right[..., None], design

    def correct(self):
        """Give the stars their corrected fluxes: these are free of conventions of the shares.

        Return the positions of the correction, less the median, ``(n, 2)``, NaN where unknown.
        """
        problem, cadence, rest = self.problem, self.state.cadence.copy(), self.residual()
        moved = np.full_like(self.center, np.nan)
        for star in range(len(self.images)):
            column = problem.flux_number(star)
            if column >= cadence.shape[1] or not (found := _light(self, star, rest)):
                continue
            flux, error, known, position = found
            moved = moved if star else position
            level = np.median(cadence[known, column]) / np.median(flux[known])
            cadence[known, column] = level * flux[known]
            self.flux_error[known, star], self.given[:, column] = level * error[known], known
        self.state = replace(self.state, cadence=cadence)
        return moved

    def improve(self):
        normal, right, _ = self.equations()
        step = solved(normal, right)[..., 0]
        step[:, :2] = np.clip(step[:, :2], -_MOVE, _MOVE)
        self.state = replace(self.state, cadence=self.state.cadence + step)

    def costs(self, weight):
        """Cost of each cadence, which grows only linearly with large residuals."""
        squares = (weight * self.residual()) ** 2
        return np.sum(2 * _SOFT**2 * (np.sqrt(1 + squares / _SOFT**2) - 1), axis=1)

    def leave_out(self):
        """Leave out pixels that are hit, and cadences that the model does not describe."""
        good = self.problem.weight > 0
        squares = (self.problem.weight * self.residual()) ** 2
        typical = median_image(np.where(good, squares, np.nan))
        hit = squares > _HIT**2 * np.maximum(typical / MEDIAN_SQUARE, 1.0)
        hit &= hit[self.used].mean(axis=0) <= _MOST_HITS
        # Where many pixels are hit, the cadence is wrong and not the pixel.
        hit &= (hit.sum(axis=1) <= max(0.1 * good.shape[1], 2))[:, np.newaxis]
        self.weight = np.where(hit, 0.0, self.problem.weight)
        mean = np.sum(squares * ~hit, axis=1) / np.maximum((self.weight > 0).sum(axis=1), 1)
        self.used = mean <= np.median(mean) + _OUTLIER * mad_std(mean)

    def climb(self, steps, report):
        """Fit shares and cadences in turn; return whether the cost has settled, and the steps."""
        before, both = np.inf, [self.improve] * 2
        for number in range(1, steps + 1):
            for step in (self.update, *both, self.leave_out):
                step()
            cost = float(self.costs(self.weight)[self.used & ~self.held].sum())
            report(cost)
            small = max(_SAME * cost, _SMALL * np.sqrt(self.weight.size))
            if number > 3 and abs(before - cost) < small:
                return True, number
            before = cost
        return False, steps


def _choose(shares, report):
    """Add terms as long as they describe held-out cadences better."""
    given, held, steps, work = shares.problem.weight, shares.held, 0, 0.0
    crowd = max(np.bincount([star.stamp for star in shares.problem.stars]))

    def work_of_step(terms):  # multiplications
        return given.size * ((crowd * len(terms)) ** 2 + _CADENCE_TERMS**2)

    best, least = shares, np.full(held.sum(), np.inf)
    for degrees in _LADDER:
        trial = best.richer(*degrees)
        more = _TRIAL_STEPS * work_of_step(trial.terms)
        if work and work + more > _MOST_WORK / 2:
            break
        work += more
        steps += trial.climb(_TRIAL_STEPS, report)[1]
        cost = trial.costs(given)[held]
        both = trial.used[held] & best.used[held]
        if cost[both].sum() > (1 - _LEAST_GAIN) * least[both].sum():
            break
        best, least = trial, cost
    left = (_MOST_WORK - work) // work_of_step(best.terms)
    return best, steps, max(int(left), _TRIAL_STEPS)


def fit_response(problem, solution, fits, report):
    """Return a `TPFFit` per file with responses of pixels, from the fit of few cadences."""
    few, state = solution.problem, solution.state
    if (n := len(problem.flux)) < _FEWEST:
        raise ValueError(f'`tpf` has {n} cadences; response="pixels" needs {_FEWEST} or more')
    corr, center = problem.data.pos_corr, centroids(problem.data, *problem.places)
    given, error = problem.position_error, _LOOSE
    if corr is not None and problem.options.positions != "free":
        error = POSITION_PRIOR if given is None else given
        center = np.median(few.xy(state), axis=0) + corr - np.median(few.data.pos_corr, axis=0)
    problem = replace(few, stamps=problem.stamps, error_scale=1.0)
    cadence = np.zeros((len(center), len(problem.columns)))
    cadence[:, :2] = center
    start = linear_start(problem, State(state.shared, np.zeros(0), cadence))
    first = _Shares(problem, start, center, error)
    moved = first.correct()
    if given is None:  # positions begin at those, and stay near
        typical = np.median(problem.xy(first.state), axis=0)
        cadence[:, :2] = first.center = np.where(np.isfinite(moved), typical + moved, center)
        cadence[:, 2:] = first.state.cadence[:, 2:]
        first.state = replace(first.state, cadence=cadence)
    shares, steps, left = _choose(first, report)
    settled, more = shares.climb(min(_MOST_STEPS, left), report)
    if len(problem.stars) > 1:  # each has had the others' light of the start
        shares.correct()
    for step in (shares.update, shares.improve) * 3:
        step()
    errors, n_free = _errors(shares)
    psf = psf_covariance(solution, shares.responses())
    ended = {"converged": settled, "n_steps": steps + more}
    return [_result(shares, errors, psf, n_free, *pair, **ended) for pair in enumerate(fits)]


def _light(shares, number, rest):
    """Return a star's flux, its error, where they are known, and positions; None without light.

    That is the default correction of its pixels without other stars: what a model of them does not
    explain of their sum; or the sum itself if there are too few cadences or pixels for it.
    """
    problem, image = shares.problem, shares.images[number]
    stamp = problem.stars[number].stamp
    data, seen = problem.stamps[stamp], problem.weight[:, image.pixels] > 0
    background = problem.backgrounds(shares.state, stamp)
    light = shares.psf()[number][0] + shares.basis()[0] @ image.values
    light = problem.fluxes(shares.state, number)[:, None] * light + background[:, None]
    flux, error = data.light.copy(), np.full_like(data.flux, np.nan)
    flux[:, data.pixels] = light + np.where(seen, rest[:, image.pixels], 0.0)
    error[:, data.pixels] = 1 / np.where(seen, problem.weight[:, image.pixels], np.nan)
    corr = None if problem.options.positions == "free" else data.pos_corr
    own = data.aperture & (number == 0)
    series = data.replace(flux=flux, flux_err=error, pos_corr=corr, aperture=own)
    place = np.median(problem.xy(shares.state, number), axis=0)
    try:
        with warnings.catch_warnings(action="ignore"):
            pixels = aperture_pixels(series, None, place)
    except ValueError:
        return None
    try:
        return _corrected(pixels, series)
    except ValueError:
        message = (
            "too few cadences or pixels to correct a flux: it is a sum, and follows the motion"
        )
        warnings.warn(message, FitWarning, stacklevel=5)
        flux = pixels.total - background * pixels.aperture.sum()
        known = pixels.usable & (flux > 0)
        unknown = np.full((len(flux), 2), np.nan)
        return (flux, pixels.total_err, known, unknown) if known.any() else None


def _corrected(pixels, series):
    """Return the same after the correction, which may fail."""
    seen, learned = pixels.usable, pixels.usable & pixels.lit
    full, share = series.mission and series.mission.full_flux, Source(pixels, series, learned).share
    if not can_predict(pixels, full, learned):
        raise NothingToCorrectError
    with warnings.catch_warnings(action="ignore"):
        pixels, star = with_predicted_fractions(pixels, series.pos_corr, learned, full)
    if star is None:
        raise NothingToCorrectError
    known, more = pixels.usable, star.columns(share, learned[seen])
    total, use = pixels.total[known], learned[known]
    images = np.nan_to_num(pixels.flux[known]) / total[:, None, None]
    variance = (pixels.total_err[known] / total) ** 2
    least = least_square(variance[use])

    def regressors(use):
        groups = fraction_columns(images, pixels.aperture, use, least)
        for name, values in more.items():
            groups[name] = principal_columns(values[known[seen]], use, least)
        return Regressors.join(groups)

    given = series.time[known], np.log(total), variance, use, np.empty((len(total), 0)), DEFAULT
    solution = fit(regressors, *given, predicted=True)
    outside = (more["aperture"] - np.median(more["aperture"]))[known[seen], 0]
    variance = solution.variance_left(trend=False) + (MISFIT * outside) ** 2
    with np.errstate(all="ignore"), warnings.catch_warnings(action="ignore"):
        flux = total / np.exp(solution.systematics)
        flux, error = credible_flux(flux, flux * np.sqrt(variance), total, ~use)
    found = (at_rows(values, known) for values in (flux, error, star.position[known[seen]]))
    flux, error, position = found
    return flux, error, known, position


def _errors(shares):
    """`Errors` of the cadences, and how many of their parameters are free, ``(n,)``."""
    normal, _, design = shares.equations()
    k = normal.shape[1]
    covariance = solved(normal, np.broadcast_to(np.eye(k), normal.shape))
    own = np.diagonal(covariance[:, :2, :2], axis1=1, axis2=2)
    n_free = k - np.sum(own / np.square(shares.error), axis=1)
    # How the errors of the shares act on them, in their gauge.
    gain = covariance @ (design * shares.weight[..., None] ** 2).transpose(0, 2, 1)
    for image in (shares.images[star] for star in shares.firsts):
        part = gain[..., image.pixels]
        part -= (part @ image.parts)[..., None]
    phi, own = shares.basis()[0], np.arange(k)
    for pixel, _, stars in shares.pixels():
        columns = np.hstack([flux[:, None] * phi for flux, _ in stars])
        spread = np.sum((columns @ shares.covariance[pixel]) * columns, axis=1)
        covariance[:, own, own] += gain[..., pixel] ** 2 * spread[:, None]
    common = np.zeros((len(shares.images), len(phi)))
    for star, image in enumerate(shares.images):
        terms = phi * shares.width[shares.order] * np.linalg.norm(image.unit) / image.size.sum()
        common[star] = np.linalg.norm(terms, axis=1)
        if (column := shares.problem.flux_number(star)) < k:
            given = shares.given[:, column]
            common[star, given] = terms[given, 0]
            covariance[given, column], covariance[given, :, column] = 0.0, 0.0
            covariance[given, column, column] = shares.flux_error[given, star] ** 2
    s = shares.problem.n_shared
    mixed = np.zeros((*covariance.shape[:2], s))
    return Errors(np.zeros((s, s)), covariance, covariance, mixed, common), n_free


def _result(shares, errors, psf, n_free, number, fit, *, converged, n_steps):
    problem, used, held = shares.problem, shares.used, shares.held
    modeled = problem.flux - shares.residual()
    given = problem, shares.state, errors, number, modeled, shares.weight
    fields, columns, squares = fitted_fields(*given)
    squares[~used] = np.nan
    counts, out = np.isfinite(squares).sum(axis=(1, 2)), held & used
    n_data, chi2 = int(counts.sum()), float(np.nansum(squares))
    part = n_data / max(np.count_nonzero(shares.weight[used]), 1)
    n_parameters = round(part * (shares.n_free + n_free[used].sum()))
    mean = chi2 / max(n_data - n_parameters, 1)
    left = max(counts[out].sum() - part * n_free[out].sum(), 1)
    statistics = {
        "chi2": chi2, "n_data": n_data, "n_parameters": n_parameters,
        "error_scale": float(np.sqrt(mean)) if mean > UNTRUE else 1.0,
        "converged": converged and fit.converged and not fit.at_bounds, "n_steps": n_steps,
        "chi2_held_out": float(np.nansum(squares[out]) / left),
    }  # fmt: skip
    covariance = psf * statistics["error_scale"] ** 2
    kinds = {p.name: p.kind for p in problem.parameters}
    given = shares.state.shared, covariance, fit.at_bounds, statistics
    return fit.replace(
        **fields, parameters=parameter_table(fit.model, kinds, *given), covariance=covariance,
        cadences=cadence_table(columns | {"held_out": held, "outliers": ~used}),
        statistics=statistics, response=tuple(_effects(shares, number)),
    )  # fmt: skip


def _effects(shares, stamp):
    problem, state, pixels = shares.problem, shares.state, shares.problem.stamps[stamp].pixels
    stars = [k for k, star in enumerate(problem.stars) if star.stamp == stamp]
    for number, k in enumerate(stars):
        image = np.zeros((len(shares.terms), *pixels.shape))
        image[:, pixels] = shares.images[k].values
        # All polynomials are those of the first star's position.
        away = (problem.xy(state, k) - problem.xy(state))[0]
        columns, rows = (tuple(np.add(shares.ranges[i], away[i]).tolist()) for i in (0, 1))
        yield PixelShares(image, columns, rows, shares.ranges[2], *shares.degrees, star=number)
