"""The response of each pixel: shares of a star's light that are smooth in position and time.

A PSF that is fitted to some of the cadences gives the shares to begin with. Each pixel's deviation
from them is a polynomial of the star's fitted position and slow time, with priors whose widths the
data give. Shares and cadences are fitted in turn, each by linear least squares.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from scope_models.effects.shares import PixelShares, polynomial_terms, polynomials, scaled_to
from scope_models.fitting._parameters import FittedStar, cadence_table
from scope_models.fitting._problem import _UNTRUE, State
from scope_models.fitting._start import centroids, linear_start

__all__ = ["fit_response"]

# Degrees in position and time that are tried, one after the other.
_LADDER = ((1, 1), (2, 2), (3, 3), (4, 4), (5, 6), (6, 8), (8, 8), (10, 8))
# Coefficients in a pixel of many stars: time goes with their square.
_MOST_TERMS = 450
# Multiplications at most in all steps, about 30 s, half of them for the choice; the cadences of a
# step take as many as the shares of so many terms.
_MOST_WORK, _CADENCE_TERMS = 3e11, 80
# Steps on each rung, and by how much the next one must lower the cost of held-out cadences.
_TRIAL_STEPS, _LEAST_GAIN = 4, 1e-2
# Cost per pixel of the held-out cadences from which a model is far off.
_FAR = 2.0
# Every tenth cadence is held out, from the sixth on.
_EVERY, _FIRST = 10, 5
# Cadences that a response needs.
_FEWEST = 20
# Standard deviation of positions about POS_CORR: pixels, and parts of the motion, at most.
_POSITION_ERROR, _POSITION_PART = 0.1, 0.5
# ... where positions are the path, or free.
_TIGHT, _LOOSE = 1e-6, 10.0
# Standard deviations of the shares to begin with, relative to a pixel's share plus a part of all
# light that every pixel may hold; smallest one.
_FIRST_PRIOR, _EVERYWHERE, _LEAST_PRIOR = 0.3, 0.003, 1e-6
# Pixels beyond so many errors are hits, unless so large a part of the pixel's values is.
_HIT, _MOST_HITS = 5.0, 0.02
# Cadences beyond so many robust standard deviations of chi-squared are outliers.
_OUTLIER = 6.0
# Motion that agrees with POS_CORR so well is put on its scale.
_LEAST_R2, _SCALES = 0.5, (0.5, 2.0)
# Largest steps of a position, pixels; change of the cost that is none, relative and in parts of its
# own scatter; steps of the last rung at most, and those after which the priors stay.
_MOVE, _SAME, _SMALL, _MOST_STEPS, _WIDTH_STEPS = 0.1, 3e-4, 0.01, 80, 10
# Part of the range of positions and pixels by which the polynomials reach farther; percentiles.
_PAD, _INSIDE = (0.05, 0.01), (0.2, 99.8)
# Pixels whose light is less than so many errors hardly count in the sum that is the flux: wide sums
# of faint stars are noisy, and narrow ones of bright stars follow errors of the PSF and the focus.
_FAINT = 40.0
# A star that has moved by less has the image of first order, pixels; cadences at once.
_TAYLOR, _CHUNK = 1e-3, 512
# Residual, in errors, from which the cost grows only linearly.
_SOFT = 3.0


@dataclass(eq=False)
class _Cadences:
    """Cadences of a fit: values, weights, and a mask of those in use."""

    state: State
    weight: np.ndarray
    used: np.ndarray


class _Psf:
    """Images of the PSF of all stars, computed again where a cadence has moved."""

    def __init__(self, problem):
        self.problem = problem
        self.places = np.full((len(problem.flux), 2), np.inf)
        self.parts = [
            np.zeros((3, len(problem.flux), problem.stamps[star.stamp].pixels.sum()))
            for star in problem.stars
        ]

    def images(self, state):
        """Images of unit flux, and their derivatives by column and row, ``(3, n, p)`` per star."""
        moved = np.abs(self.problem.xy(state) - self.places).max(axis=1) > _TAYLOR
        index = np.flatnonzero(moved)
        for some in np.array_split(index, -(-len(index) // _CHUNK)) if len(index) else ():
            for k, part in enumerate(self.parts):
                image, by = self.problem.unit_images(state, some, k, derivatives=True)
                part[:, some] = image, *by[:2]
        self.places[index] = self.problem.xy(state)[index]
        away = (self.problem.xy(state) - self.places).T[..., np.newaxis]
        return [(p[0] + away[0] * p[1] + away[1] * p[2], p[1], p[2]) for p in self.parts]


class _Shares:
    """Polynomials of all pixels and stars, and their priors."""

    def __init__(self, psf, ranges, degree, time_degree, size, faint):
        self.psf, self.problem = psf, psf.problem
        self.ranges, self.degrees = ranges, (degree, time_degree)
        self.terms = polynomial_terms(degree, time_degree)
        self.order = self.terms.sum(axis=1)
        #: Share of each star that is typically in a pixel, what is faint, and by what it changes.
        self.size = size
        self.faint = faint
        #: ... 0 where another star than the first of its file has too little light to learn from.
        self.unit = [np.maximum(part, 0.0) + _EVERYWHERE for part in size]
        firsts = {star.stamp: k for k, star in reversed([*enumerate(self.problem.stars)])}
        for k, star in enumerate(self.problem.stars):
            if k != firsts[star.stamp]:
                self.unit[k][size[k] < _EVERYWHERE] = 0.0
        self.width = np.full(self.order.max() + 1, _FIRST_PRIOR)
        self.values = [np.zeros((len(self.terms), part.size)) for part in size]
        self.covariance = [None] * self.problem.slices[-1].stop
        self.n_free = 0.0

    def richer(self, degree, time_degree):
        """Return the same shares with more terms."""
        other = _Shares(self.psf, self.ranges, degree, time_degree, self.size, self.faint)
        place = {tuple(term): k for k, term in enumerate(other.terms.tolist())}
        index = [place[tuple(term)] for term in self.terms.tolist()]
        for mine, theirs in zip(self.values, other.values, strict=True):
            theirs[index] = mine
        other.width = np.resize(self.width, len(other.width))
        other.width[len(self.width) :] = self.width[-1]
        return other

    def basis(self, state):
        """Polynomials of the cadences, and their derivatives by column and row, ``(n, k)``."""
        values = (*self.problem.xy(state).T, self.problem.data.time)
        scaled = [scaled_to(v, limits) for v, limits in zip(values, self.ranges, strict=True)]
        value, *slopes = polynomials(self.terms, *scaled)
        for axis in (0, 1):
            low, high = self.ranges[axis]
            slopes[axis] *= np.where(np.abs(scaled[axis]) < 1, 2 / (high - low), 0.0)[:, np.newaxis]
        return value, *slopes

    def images(self, state, *, slopes=False):
        """Images of each star of unit flux, and their derivatives by column and row."""
        number = 3 if slopes else 1
        basis = self.basis(state)[:number]
        for k, parts in enumerate(self.psf.images(state)):
            yield [p + b @ self.values[k] for p, b in zip(parts[:number], basis, strict=True)]

    def model(self, state):
        """Model of all pixels, shape ``(n, p)``."""
        problem = self.problem
        model = np.zeros(problem.flux.shape)
        for k, (image,) in enumerate(self.images(state)):
            pixels = problem.slices[problem.stars[k].stamp]
            model[:, pixels] += problem.fluxes(state, k)[:, None] * image
        for i, pixels in enumerate(problem.slices):
            model[:, pixels] += problem.backgrounds(state, i)[:, None]
        return model

    def update(self, cadences, learned, *, widths=True):
        """Fit the polynomials of all pixels to the light of some cadences."""
        problem, state = self.problem, cadences.state
        phi = self.basis(state)[0][learned]
        fluxes = [problem.fluxes(state, k) for k in range(len(problem.stars))]
        rest = problem.flux - self.model(state)
        squares, counts, self.n_free = np.zeros_like(self.width), np.zeros_like(self.width), 0.0
        for stamp, pixels in enumerate(problem.slices):
            designs = [fluxes[k][learned, None] * phi for k in range(len(fluxes))]
            for number, pixel in enumerate(range(pixels.start, pixels.stop)):
                stars = self.stars_in(stamp, number)
                weight = cadences.weight[learned, pixel]
                values = np.concatenate([self.values[k][:, number] for k in stars])
                # No share changes by more than all of the light.
                widths = [np.minimum(self.width[self.order] * self.unit[k][number], 1.0)
                          for k in stars]  # fmt: skip
                scale = np.concatenate(widths)
                # In units of the priors, all eigenvalues are 1 and more.
                weighted = np.hstack([designs[k] for k in stars]) * weight[:, None] * scale
                normal = weighted.T @ weighted
                right = weighted.T @ (weight * rest[learned, pixel]) + normal @ (values / scale)
                normal[np.diag_indices_from(normal)] += 1.0
                factor = cho_factor(normal)
                values = scale * cho_solve(factor, right)
                covariance = cho_solve(factor, np.eye(len(values)))
                self.n_free += float(np.sum(1 - np.diag(covariance)))
                self.covariance[pixel] = covariance = covariance * scale * scale[:, None]
                variance = np.diag(covariance)
                parts = zip(np.split(values, len(stars)), np.split(variance, len(stars)),
                            strict=True)  # fmt: skip
                for k, (value, spread) in zip(stars, parts, strict=True):
                    self.values[k][:, number] = value
                    scaled = (value**2 + spread) / self.unit[k][number] ** 2
                    squares += np.bincount(self.order, scaled, len(squares))
                    counts += np.bincount(self.order, minlength=len(squares))
        self._fix_gauge()
        if widths:
            self.width = np.maximum(np.sqrt(squares / counts), _LEAST_PRIOR)

    def stars_in(self, stamp, pixel):
        """Return the stars of a file whose shares in one of its pixels are fitted."""
        stars = enumerate(self.problem.stars)
        return [k for k, star in stars if star.stamp == stamp and self.unit[k][pixel]]

    def gauge(self, star):
        """What a common factor changes, and the weights of the sum that stays that of the PSF."""
        parts = np.where(self.unit[star] > 0, np.maximum(self.size[star], 0.0), 0.0)
        weight = parts / (parts + self.faint[star])
        return parts / (parts @ weight), weight

    def common(self, basis, star):
        """
        Return the relative error of a star's flux from changes common to its pixels, ``(n,)``.

        The gauge fixes them, and no data constrain them: their error is that of the prior.
        """
        parts, weight = np.maximum(self.size[star], 0.0), self.gauge(star)[1]
        size = np.linalg.norm(weight * self.unit[star]) / (parts @ weight)
        return size * np.linalg.norm(basis * self.width[self.order], axis=1)

    def _fix_gauge(self):
        """Let a sum of the shares be that of the PSF, and no change be common to all pixels."""
        free_background = self.problem.options.background == "cadence"
        for k, (star, unit) in enumerate(zip(self.values, self.unit, strict=True)):
            if free_background:
                seen = unit > 0
                star[:, seen] -= (star[:, seen] @ unit[seen] ** -2 / np.sum(unit[seen] ** -2))[
                    :, None
                ]
            parts, weight = self.gauge(k)
            star[:] -= (star @ weight)[:, None] * parts


def _improve(shares, cadences, center, error, steps=2):
    """Fit flux, position and background of each cadence."""
    for _ in range(steps):
        cadence = cadences.state.cadence
        residual, design = _linearized(shares, cadences.state)
        deviation = center - cadence[:, :2]
        normal, right = _normal(design, residual, cadences.weight, deviation, error)
        step = _solved(normal, right[..., None])[..., 0]
        step[:, :2] = np.clip(step[:, :2], -_MOVE, _MOVE)
        cadences.state = replace(cadences.state, cadence=cadence + step)


def _linearized(shares, state):
    """Residuals, and derivatives of the model by the parameters of the cadences."""
    problem = shares.problem
    residual = problem.flux.copy()
    design = np.zeros((*residual.shape, len(problem.columns)))
    for k, (image, by_x, by_y) in enumerate(shares.images(state, slopes=True)):
        star = problem.stars[k]
        pixels, flux = problem.slices[star.stamp], problem.fluxes(state, k)[:, None]
        residual[:, pixels] -= flux * image
        design[:, pixels, 0] += flux * by_x
        design[:, pixels, 1] += flux * by_y
        if not star.constant:
            design[:, pixels, problem.index.fluxes[k]] = image
    for i, pixels in enumerate(problem.slices):
        residual[:, pixels] -= problem.backgrounds(state, i)[:, None]
        if problem.options.background == "cadence":
            design[:, pixels, problem.index.backgrounds[i]] = 1.0
    return residual, design


def _normal(design, residual, weight, deviation, error):
    """Normal equations of the cadences, with the prior of the positions."""
    weighted = design * weight[..., None]
    normal = weighted.transpose(0, 2, 1) @ weighted
    right = np.einsum("npk,np->nk", weighted, weight * residual)
    normal[:, [0, 1], [0, 1]] += error**-2
    right[:, :2] += deviation / error**2
    return normal, right


def _solved(normal, right):
    """Solve small systems whose diagonals are scaled to 1."""
    scale = 1 / np.sqrt(np.maximum(np.einsum("nkk->nk", normal), 1e-300))
    matrix = normal * scale[:, :, None] * scale[:, None, :]
    index = np.arange(normal.shape[1])
    matrix[:, index, index] = 1 + 1e-10
    return scale[:, :, None] * np.linalg.solve(matrix, scale[:, :, None] * right)


def _on_path(cadences, problem, center):
    """Put the positions on the scale of POS_CORR, where the motion agrees with it."""
    if problem.data.pos_corr is None or not problem.data.pos_corr.std(axis=0).all():
        return
    used, cadence = cadences.used, cadences.state.cadence.copy()
    basis = problem.basis
    for axis in (0, 1):
        away = cadence[:, axis] - center[:, axis]
        slopes = np.linalg.lstsq(basis[used], away[used], rcond=None)[0]
        rest = away[used] - basis[used] @ slopes
        agreement = 1 - rest.var() / max(cadence[used, axis].var(), 1e-300)
        if agreement > _LEAST_R2 and _SCALES[0] < 1 + slopes[1 + axis] < _SCALES[1]:
            cadence[:, axis] -= basis @ slopes
    cadences.state = replace(cadences.state, cadence=cadence)


def _squares(shares, cadences, weight=None):
    """Squared residuals in errors of all pixels, 0 where they are not used."""
    weight = cadences.weight if weight is None else weight
    return (weight * (shares.problem.flux - shares.model(cadences.state))) ** 2


def _costs(squares):
    """Cost of each cadence, which grows only linearly with large residuals."""
    return np.sum(2 * _SOFT**2 * (np.sqrt(1 + squares / _SOFT**2) - 1), axis=1)


def _leave_out(shares, cadences):
    """Leave out single pixels that are hit, and cadences that the model does not describe."""
    given = shares.problem.weight
    cadences.weight = given.copy()
    squares = _squares(shares, cadences)
    good = given > 0
    typical = np.array(
        [np.median(s[g]) if g.any() else 0.0 for s, g in zip(squares.T, good.T, strict=True)]
    )
    hit = squares > _HIT**2 * np.maximum(typical / 0.455, 1.0)
    hit &= hit[cadences.used].mean(axis=0) <= _MOST_HITS
    # Where many pixels are hit, the cadence is wrong and not the pixel.
    hit &= (hit.sum(axis=1) <= max(0.1 * given.shape[1], 2))[:, np.newaxis]
    cadences.weight[hit] = 0.0
    squares[hit] = 0.0
    mean = squares.sum(axis=1) / np.maximum((cadences.weight > 0).sum(axis=1), 1)
    middle = np.median(mean)
    spread = 1.4826 * np.median(np.abs(mean - middle))
    cadences.used = mean <= middle + _OUTLIER * spread


def _climb(shares, cadences, center, error, held, steps, report):
    """Fit shares and cadences in turn; return whether the cost has settled."""
    before = np.inf
    for number in range(steps):
        shares.update(cadences, cadences.used & ~held, widths=number < _WIDTH_STEPS)
        _improve(shares, cadences, center, error)
        _on_path(cadences, shares.problem, center)
        _leave_out(shares, cadences)
        cost = float(_costs(_squares(shares, cadences)[cadences.used & ~held]).sum())
        if report is not None:
            report(cost)
        if number > 2 and abs(before - cost) < max(
            _SAME * cost, _SMALL * np.sqrt(cadences.weight.size)
        ):
            return True, number + 1
        before = cost
    return False, steps


def _choose(problem, cadences, center, error, held, report):
    """Add terms as long as the cadences that are held out are described better."""
    sizes = [
        np.median(problem.unit_images(cadences.state, slice(None, None, 10), k), axis=0)
        for k in range(len(problem.stars))
    ]
    given, steps, work, best = problem.weight, 0, 0.0, None
    errors = np.array([1 / np.median(w[w > 0]) if w.any() else np.inf for w in given.T])
    faint = [
        _FAINT
        * errors[problem.slices[star.stamp]]
        / abs(np.median(problem.fluxes(cadences.state, k)))
        for k, star in enumerate(problem.stars)
    ]
    crowd = max(np.bincount([star.stamp for star in problem.stars]))
    for degrees in _LADDER:
        n_terms = crowd * len(polynomial_terms(*degrees))
        more = _TRIAL_STEPS * _work_of_step(given.size, n_terms)
        if best is not None and (n_terms > _MOST_TERMS or work + more > _MOST_WORK / 2):
            break
        work += more
        if best is None:
            shares = _Shares(_Psf(problem), _ranges(problem, center), *degrees, sizes, faint)
            trial = cadences
        else:
            shares, trial = best[0].richer(*degrees), replace(best[1])
        _, more = _climb(shares, trial, center, error, held, _TRIAL_STEPS, report)
        steps += more
        cost = _costs(_squares(shares, trial, given)[held])
        if best is not None:
            both = trial.used[held] & best[1].used[held]
            if cost[both].sum() > (1 - _LEAST_GAIN) * best[2][both].sum():
                # A model that is far off may need more terms at once.
                if np.median(best[2]) < _FAR * np.count_nonzero(given) / len(given):
                    break
                continue
        best = shares, trial, cost
    left = (_MOST_WORK - work) // _work_of_step(given.size, crowd * len(best[0].terms))
    return best[0], best[1], steps, max(int(left), _TRIAL_STEPS)


def _work_of_step(n_values, n_terms):
    """Return about how many multiplications a step takes."""
    return n_values * (n_terms**2 + _CADENCE_TERMS**2)


def _ranges(problem, center):
    """Ranges of columns, rows and times that the polynomials cover."""
    low, high = np.percentile(center, _INSIDE, axis=0)
    pad = _PAD[0] * (high - low) + _PAD[1]
    time = problem.data.time
    return (*zip(low - pad, high + pad, strict=True), (time.min(), max(time.max(), time.min() + 1)))


def _start(problem, state, few):
    """Positions before the fit, their error, and the cadences to begin with."""
    corr, middle = problem.data.pos_corr, np.median(few.xy(state), axis=0)
    cadence = np.zeros((len(problem.flux), len(problem.columns)))
    if corr is not None and few.options.positions != "free":
        center = middle + corr - np.median(few.data.pos_corr, axis=0)
    else:
        center = centroids(problem.data, problem.target)
    cadence[:, :2] = center
    start = linear_start(problem, State(state.shared, np.zeros(0), cadence))
    return center, _Cadences(start, problem.weight, np.ones(len(cadence), dtype=bool))


def fit_response(problem, few, state, fits, report=None):
    """Fit the response of each pixel in all cadences; return a `TPFFit` per file.

    ``few`` is the problem of some of the cadences, to which the PSF was fitted with the result
    ``state``, whose shared parameters are kept, and ``fits`` for each file.
    """
    if len(problem.flux) < _FEWEST:
        raise ValueError(
            f'`tpf` has {len(problem.flux)} cadences; response="pixels" needs {_FEWEST} or more'
        )
    asked = problem.options
    error = {"path": _TIGHT, "prior": asked.position_error, "free": _LOOSE}.get(asked.positions)
    if error is None:
        corr = problem.data.pos_corr
        moved = np.inf if corr is None else np.hypot(*corr.std(axis=0)) or np.inf
        error = min(_POSITION_ERROR, _POSITION_PART * moved)
    options = replace(few.options, positions="prior") if few.path else few.options
    problem = replace(few, stamps=problem.stamps, error_scale=1.0, options=options)
    center, cadences = _start(problem, state, few)
    held = np.zeros(len(center), dtype=bool)
    held[_FIRST::_EVERY] = True
    shares, cadences, steps, left = _choose(problem, cadences, center, error, held, report)
    most = min(max(_MOST_STEPS // len(problem.stars), _WIDTH_STEPS), left)
    settled, more = _climb(shares, cadences, center, error, held, most, report)
    _improve(shares, cadences, center, error, steps=3)
    errors = _errors(shares, cadences, error)
    ended = {"settled": settled, "n_steps": steps + more}
    return [
        _result(shares, cadences, held, errors, number, fit, **ended)
        for number, fit in enumerate(fits)
    ]


def _errors(shares, cadences, error):
    """Variances of the parameters of the cadences, ``(n, k)``, and how many are free, ``(n,)``."""
    problem, state, weight = shares.problem, cadences.state, cadences.weight
    _, design = _linearized(shares, state)
    normal, _ = _normal(design, 0 * weight, weight, 0.0, error)
    covariance = _solved(normal, np.broadcast_to(np.eye(normal.shape[1]), normal.shape))
    variance = np.einsum("nkk->nk", covariance).copy()
    n_free = variance.shape[1] - variance[:, :2].sum(axis=1) / error**2
    # How the errors of the shares act on them, in the gauge of the shares.
    gain = covariance @ (design * weight[..., None] ** 2).transpose(0, 2, 1)
    phi = shares.basis(state)[0]
    for stamp, pixels in enumerate(problem.slices):
        first = next(k for k, star in enumerate(problem.stars) if star.stamp == stamp)
        parts, share_weight = shares.gauge(first)
        own = gain[..., pixels]
        own = own - (own @ parts)[..., None] * share_weight
        for number, pixel in enumerate(range(pixels.start, pixels.stop)):
            stars = shares.stars_in(stamp, number)
            columns = np.hstack([problem.fluxes(state, k)[:, None] * phi for k in stars])
            spread = np.sum((columns @ shares.covariance[pixel]) * columns, axis=1)
            variance += own[..., number] ** 2 * spread[:, None]
    return variance, n_free


def _result(shares, cadences, held, errors, number, fit, *, settled, n_steps):
    """Return the fit of the PSF to a file with the response of its pixels."""
    problem, state, (variance, n_free) = shares.problem, cadences.state, errors
    data, pixels = problem.stamps[number], problem.slices[number]
    fitted = np.full(data.flux.shape, np.nan)
    fitted[:, data.pixels] = shares.model(state)[:, pixels]
    observed = data.flux.copy()
    observed[:, data.pixels] = np.where(
        cadences.weight[:, pixels] > 0, data.flux[:, data.pixels], np.nan
    )
    squares = ((observed - fitted) / data.flux_err) ** 2
    squares[~cadences.used] = np.nan
    n_data = np.isfinite(squares).sum(axis=(1, 2))
    part = n_data.sum() / max(np.count_nonzero(cadences.weight[cadences.used]), 1)
    free = n_free * part
    out = held & cadences.used
    stars = [k for k, star in enumerate(problem.stars) if star.stamp == number]
    values = [_of_star(problem, state, variance, k) for k in stars]
    scatter, basis = values[0]["flux_err"], shares.basis(state)[0]
    for k, value in zip(stars, values, strict=True):
        common = value["flux"] * shares.common(basis, k)
        value["flux_err"] = np.hypot(value["flux_err"], common)
    model = fit.model.copy()
    for name, key in (("x_0", "x"), ("y_0", "y"), ("flux", "flux")):
        setattr(model, name, float(np.median(values[0][key])))
    n_parameters = round(part * shares.n_free + free[cadences.used].sum())
    chi2 = float(np.nansum(squares))
    mean = chi2 / max(n_data.sum() - n_parameters, 1)
    error = np.zeros(len(held))
    if problem.options.background == "cadence":
        error = np.sqrt(variance[:, problem.index.backgrounds[number]])
    columns = {name: getattr(data, name) for name in ("time", "cadenceno", "quality", "pos_corr")}
    columns |= values[0] | {
        "flux_scatter": scatter,
        "background": problem.backgrounds(state, number),
        "background_err": error,
        "focus": np.ones(len(held)),
        "held_out": held,
        "outliers": ~cadences.used,
    }
    left = max(n_data[out].sum() - free[out].sum(), 1)
    statistics = {
        "chi2": chi2,
        "n_data": int(n_data.sum()),
        "n_parameters": n_parameters,
        "error_scale": float(np.sqrt(mean)) if mean > _UNTRUE else 1.0,
        "converged": settled and fit.converged and not fit.at_bounds,
        "n_steps": n_steps,
        "chi2_held_out": float(np.nansum(squares[out]) / left),
    }
    parameters = fit.parameters.copy()
    parameters["error"][np.isin(parameters["name"], list(model.response_powers))] = np.nan
    return replace(
        fit,
        model=model,
        parameters=parameters,
        cadences=cadence_table(columns),
        neighbors=tuple(FittedStar(**value) for value in values[1:]),
        observed=observed,
        observed_err=data.flux_err,
        fitted=np.where(np.isfinite(observed), fitted, np.nan),
        statistics=statistics,
        response=tuple(_effect(shares, state, k, place) for place, k in enumerate(stars)),
    )


def _of_star(problem, state, variance, star):
    """Position and flux of a star, and their errors, by name."""
    known = np.sqrt(variance).T
    constant = problem.stars[star].constant
    error = np.zeros(len(variance)) if constant else known[problem.index.fluxes[star]]
    errors = {"x_err": known[0], "y_err": known[1], "flux_err": error}
    values = problem.path_of(state, star) | errors
    return {name: np.array(value) for name, value in values.items()}


def _effect(shares, state, star, number):
    """The shares of a star as an effect of a scene."""
    problem = shares.problem
    stamp = problem.stamps[problem.stars[star].stamp]
    image = np.zeros((len(shares.terms), *stamp.shape))
    image[:, stamp.pixels] = shares.values[star]
    # The polynomials are those of the first star's position, wherever the others are.
    away = (problem.xy(state, star) - problem.xy(state))[0]
    columns, rows = (tuple(np.add(shares.ranges[i], away[i]).tolist()) for i in (0, 1))
    return PixelShares(image, columns, rows, shares.ranges[2], *shares.degrees, star=number)
