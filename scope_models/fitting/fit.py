"""`fit_tpf`: one model for all pixels and cadences of a target pixel file."""

import warnings
from dataclasses import replace
from functools import partial, reduce
from itertools import chain

import numpy as np
from astropy.modeling import Model
from astropy.stats import mad_std

from scope_models._checks import checked_choice, solvable
from scope_models._threads import one_thread
from scope_models.exceptions import FitWarning
from scope_models.fitting import _start
from scope_models.fitting._problem import FitOptions, FitStar, Problem, Settings
from scope_models.fitting._response import fit_response
from scope_models.fitting._solver import covariances, expected_gain, solve
from scope_models.fitting.result import (
    CERTAIN,
    LARGEST_FLUX,
    LARGEST_SCATTER,
    doubts_of,
    is_measured,
    make_results,
)
from scope_models.io.pixels import read_pixels
from scope_models.scene.detector import Detector
from scope_models.scene.motion import Motion

__all__ = ["fit_tpf"]

# Prior of the response between pixels where the caller leaves it to the data.
_PRIOR = 0.01
# Largest numbers of steps, per stage, where all is left to the data: of simple models, of others.
_FEW_STEPS, _MANY_STEPS = 20, 60
# Standard deviations by which chi-squared may exceed a true model's.
_EXCESS = 5.0
# Standard deviations of positions, in parts of POS_CORR's, and of scale, where the PSF is wrong.
_POSITION_PART, _HELD = 0.1, 0.001
# Part of the light in the stamp below which a model has invented it; every so many cadences.
_LEAST_INSIDE, _SOME = 0.8, 10
# Seconds until a fit shows its progress; how often errors are scaled at most.
_PATIENCE, _RESCALINGS = 5.0, 8
# Images of stars and values of pixels at most, and cadences at least, of a first guess.
_FEW, _FEW_VALUES, _FEWEST = 300, 30_000, 50
# Cadences from which the response of each pixel is fitted where no PSF describes the pixels.
_ENOUGH = 100


def fit_tpf(
    tpf, psf=None, sensitivity=None, *, stars=None, neighbors=None, empirical=0, interpixel=None,
    positions="start", response="auto", flux_err=None, options=None, progress=None,
):  # fmt: skip
    r"""Fit one model to all pixels and cadences of a target pixel file at once.

    .. math:: f_{t,p} = b_p F_t \int_p P(x - x_t, y - y_t)\, s(u, v)\, dx\, dy + B_t

    with the PSF P, the sensitivity s and the response b of each pixel shared by all cadences, and
    position, flux F and background B of each cadence.

    Parameters
    ----------
    tpf : `~lightkurve.targetpixelfile.TargetPixelFile`, str or path-like, or a sequence of them
        The pixels, without the background of FLUX_BKG: the object, or a file, whose cadences with
        bad quality flags are left out as lightkurve does. Several files of one CCD share PSF,
        sensitivity, cadences, and the motion up to a linear map with a prior of 0.3 about 1.
    psf : int or `~astropy.modeling.Model`, optional
        1, 2 or 3 Gaussian components with free offsets; or a density or sum of densities, as for
        `~scope_models.PRF`; or a `~scope_models.PRF`. A model gives the starting values, and its
        ``fixed`` and ``bounds`` are kept. None: one or two components if they describe the pixels;
        else the better one, without a parameter at a bound, of these and one component with an
        empirical term of order 6, with positions near POS_CORR.
    sensitivity : `~scope_models.SensitivityPolynomial`, optional
        Response within a pixel: starting values, and by its ``fixed`` what is fitted; constants
        are always fixed, because they are the flux. None: 1; or, if ``psf`` is None too, of second
        order where only that describes the pixels, and the motion measures it to 1.25 % at a
        pixel's edge.
    stars : array_like, `~astropy.coordinates.SkyCoord`, Table or "find", optional
        Positions of all stars, the target first: columns and rows in pixels of the stamp, shape
        ``(k, 2)``; places on the sky; a table with the columns x and y, or ra and dec; "find":
        the local maxima of the median image above a twentieth of the brightest pixel and ten
        errors, the brightest first after the target. By default the target alone: the maximum in
        the pipeline's aperture, of several one at the file's coordinates. For several files, a
        sequence of them.
    neighbors : as ``stars``, optional
        Positions of the other stars only, even brighter ones, without a target among places on the
        sky. "find": the maxima more than 1.5 px from the target.
    empirical : int, optional
        Order of a `~scope_models.models.GaussHermitePSF` that is added to the PSF, with fixed width
        and part of the flux, and a prior of standard deviation 10 of its coefficients; 0 for none.
        For another width, give the term as a part of ``psf``. For a table of a PRF, the order of
        the smooth factor of a `~scope_models.models.CorrectedPRF`, with a prior of 0.1.
    interpixel : float, optional
        Standard deviation, before the fit, of the response b between pixels, whose mean, weighted
        by the median image, is 1; 0 fixes it at 1. None: 0.01 if the model then describes the
        pixels with a response that agrees with it; else 0.
    positions : {"start", "free", "prior", "path"} or Motion, optional
        What an affine map of POS_CORR is: the first guess of free positions, nothing, a prior, or
        the positions themselves. For the last two the map is fitted, with a prior of 0.02 about
        the scale 1. A motion is a prior in place of POS_CORR, with its errors or else
        ``position_error``.
    response : {"auto", "psf", "pixels"}, optional
        "psf": the pixels are those of PSF, sensitivity and b alone. "pixels": each pixel's share
        of a star's light is that plus a polynomial of fitted position and slow time, by least
        squares without ``sensitivity``, ``focus`` and ``interpixel``; the fluxes are those of the
        default correction. "auto": "pixels" for 100 cadences and more that no PSF describes, if
        these and ``psf`` are None; else "psf".
    flux_err : array_like or `~astropy.units.Quantity`, optional
        Errors of the pixels, e-/s, in place of those of the file.
    options : FitOptions, optional
        Background, focus, loss for cosmic rays, and other options that few fits need.
    progress : bool, optional
        Whether to show a progress bar. None: on a terminal, from the fifth second.

    Returns
    -------
    TPFFit or tuple of TPFFit
        The fit; for several files one of each. With a parameter at a bound it has not converged.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind, or outside its domain, or there is nothing to fit.

    Warns
    -----
    FitWarning
        If data are left out, no star is seen, the fit has not converged, the model does not
        describe the pixels, or flux or sensitivity are uncertain; or if one that is not in the
        model would lower chi-squared by more than 25.

    Notes
    -----
    Pixel values that are not finite, and cadences with too few of them, are left out.

    Where the typical squared residual of all pixels, or of those with light, from medians, is above
    1.5 squared errors, the larger one's root, ``error_scale``, scales all errors, but not
    chi-squared. With ``FitOptions(loss="soft_l1")`` all pixels alike scale the errors of the fit,
    and ``error_scale`` only those of the result.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, fit_tpf, simulate
    >>> detector = Detector.k2(shape=(7, 7))
    >>> observation = simulate(Star(12.0), detector, Motion.k2_roll(100), seed=1)
    >>> fit = fit_tpf(observation.to_tpf(), psf=1)
    >>> print(f"{fit.values['sigma_x']:.2f} {fit.reduced_chi2:.1f}")
    0.50 1.0
    """
    if not isinstance(options, FitOptions | None):
        raise TypeError(f"`options` must be FitOptions or None, got {options!r}")
    if not isinstance(progress, bool | None):
        raise TypeError(f"`progress` must be True, False or None, got {progress!r}")
    motion = positions if isinstance(positions, Motion) else None
    options = Settings(
        **vars(options or FitOptions()), empirical=empirical,
        interpixel=_PRIOR if interpixel is None else interpixel,
        positions=positions if motion is None else "prior",
    )  # fmt: skip
    psf = int(psf) if isinstance(psf, np.integer) else psf
    if psf is not None and not isinstance(psf, int | Model):
        raise TypeError(f"`psf` must be a number of components or a model, got {psf!r}")
    several = isinstance(tpf, list | tuple)
    files = list(tpf) if several else [tpf]
    if not files:
        raise ValueError("`tpf` must have at least one file")
    if checked_choice("response", response, ("auto", "psf", "pixels")) == "pixels":
        contained = {"sensitivity": sensitivity, "focus": options.focus, "interpixel": interpixel}
        for name, value in contained.items():
            if value not in {None, 0}:
                message = f'`{name}` must be left out with response="pixels", which contains it'
                raise ValueError(message)
    series = [read_pixels(file) for file in files]
    places = _start.read_places(stars, neighbors, series, several=several)
    prf = _start.make_prf(2 if psf is None else psf, sensitivity, options.empirical)
    # Whether the data choose the PSF, and the response between pixels.
    choice = {"any_psf": psf is None and not empirical, "any_response": interpixel is None}
    with one_thread, solvable(), _progress_bar(progress) as bar:
        problem, detectors = _make_problem(series, places, prf, flux_err, options, motion)
        report = partial(_report, bar)
        steps = partial(solve, report=report)
        response, tried, solution = _fit_psf(problem, response, sensitivity, steps, **choice)
        fits = make_results(solution, covariances(solution), detectors, series)
        if response == "pixels":
            fits = fit_response(problem, solution, fits, report)
    with one_thread:
        models = _of_models(response, tried, solution, fits[0])
        for doubt in chain(models, *map(doubts_of, fits)):
            warnings.warn(doubt, FitWarning, stacklevel=2)
    return tuple(fits) if several else fits[0]


def _fit_psf(problem, response, sensitivity, steps, *, any_psf, any_response):
    """Return the kind of response, solutions of all models of few cadences, and the best."""
    left = any_psf and any_response and sensitivity is None and problem.options.focus is None
    # Whether the flux where the fit starts is above the noise of a place.
    flux = problem.fluxes(_start.starting_state(problem))
    seen = np.median(flux) > CERTAIN * mad_std(flux) / np.sqrt(len(flux))
    simple = response == "auto" and left and len(problem.flux) >= _ENOUGH and seen
    if response != "pixels" or not seen:
        candidates = _candidates(problem, sensitivity, simple, any_psf, any_response)
        if not seen:  # no model is better than another
            candidates = [(next(candidates)[0], _FEW_STEPS)]
        tried = _tried(candidates, steps, few=any_psf, doubtful=any_psf and any_response)
        few = tried[0].problem
        if not simple or _is_true(tried[0], strictly=True):
            if len(few.flux) == len(problem.flux):
                return "psf", tried, tried[0]
            most = (_MANY_STEPS if any_psf else np.inf) if seen else 1
            found = _of_all(tried[0], problem, steps, most)
            if any_psf and _hidden_gain(found):
                other = _with_response(tried[0], steps, len(problem.flux))
                found = found if other is tried[0] else _of_all(other, problem, steps, most)
            return "psf", tried, found
    # The PSF from which the pixels deviate.
    prfs = [_start.make_prf(1, None, 0), *_start.make_rich_prfs(None)] if any_psf else [problem.prf]
    plain = {"interpixel": 0.0, "loss": "soft_l1", **_held(problem)}
    rough = [(_with(problem, prf, **plain), _MANY_STEPS) for prf in prfs]
    tried = _tried(rough, steps, few=True)
    return "pixels", tried, tried[0]


def _with(problem, prf=None, **options):
    return replace(problem, prf=prf or problem.prf, options=replace(problem.options, **options))


def _candidates(problem, sensitivity, simple, any_psf, any_response):
    """Models to try, the simplest first, and how many steps each is worth."""
    plain = {"interpixel": 0.0} if any_response else {}
    if not any_psf:
        yield problem, np.inf
        if any_response:
            yield _with(problem, **plain), np.inf
        return
    gaussians = [_start.make_prf(number, sensitivity, 0) for number in (1, 2)]
    # A model that is true converges fast.
    for prf in gaussians:
        yield _with(problem, prf), _FEW_STEPS
    if not simple:
        for prf in (gaussians[-1], *_start.make_rich_prfs(sensitivity)):
            yield _with(problem, prf, **plain, **_held(problem)), _MANY_STEPS


def _held(problem):
    """Options for positions near POS_CORR, because a wrong PSF absorbs motion."""
    options, pos_corr = problem.options, problem.data.pos_corr
    if options.positions != "start" or pos_corr is None or not pos_corr.std(axis=0).all():
        return {}
    error = min(options.position_error, _POSITION_PART * float(pos_corr.std(axis=0).min()))
    return {"positions": "prior", "position_error": error, "scale_error": _HELD}


def _tried(candidates, steps, *, few, doubtful=False):
    """Fit models to few cadences until one describes them; return the solutions by rank.

    A guess, without ``few``, has up to twice as many as a choice needs.
    """
    tried = []
    for problem, most in candidates:
        # A simpler model after a richer one takes its place if that one ends at a bound.
        if tried and problem.n_shared < tried[-1].problem.n_shared and not _ends(tried[-1]):
            continue
        values = _FEW_VALUES // problem.flux.shape[1]
        enough = max(min(_FEW // len(problem.stars), values), _FEWEST)
        every = max((len(problem.flux) + few * (enough - 1)) // enough, 1)
        thin = replace(problem, stamps=tuple(s[::every] for s in problem.stamps))
        tried.append(_fitted(thin, steps, most, doubtful=doubtful))
        if few and _hidden_gain(tried[-1]):
            tried[-1] = _with_response(tried[-1], steps, len(problem.flux))
        if _is_true(tried[-1], strictly=few) and not (few and _hidden_gain(tried[-1])):
            break
    return sorted(tried, key=_rank)


def _fitted(problem, steps, most, guess=None, *, doubtful=False):
    """Return the solution with errors that are scaled to the residuals, in ``most`` steps.

    ``guess`` is the solution for some of the cadences; ``doubtful``: a model that is not true with
    a response between pixels is given up, for it is better without.
    """
    steps = partial(steps, max_steps=min(problem.options.max_steps, most))
    if guess is None:
        state = _start.starting_state(problem)
        # What the shape of the PSF can imitate waits until that is about right.
        early = {"only": np.array([p.kind != "response" for p in problem.parameters], dtype=bool)}
    else:
        state = _start.continued_state(problem, guess)
        early, most = {"n_steps": guess.n_steps}, np.inf
    if guess is None or problem.options.loss == "soft_l1":
        problem = problem.rescaled(state)  # else all residuals are outliers to a robust loss
    solution = steps(problem, state, loosely=True, **early)
    for remaining in reversed(range(_RESCALINGS)):
        scaled = problem.rescaled(solution.state)
        given_up = doubtful and problem.n_pixels > 0 and remaining < _RESCALINGS - 2
        if given_up and solution.converged and scaled.misfit > 1:
            return replace(solution, problem=scaled)
        changed = scaled is not problem and remaining > 0 and solution.n_steps < most
        problem = scaled
        solution = steps(problem, solution.state, n_steps=solution.n_steps, loosely=changed)
        if not changed:
            break
    return solution


def _of_all(solution, problem, steps, most):
    return _fitted(replace(solution.problem, stamps=problem.stamps), steps, most, solution)


def _of_models(response, tried, solution, fit):
    if gain := response == "psf" and _hidden_gain(solution):
        yield (
            f"a response within pixels would lower chi-squared by {gain:.3g}, and without it the "
            "PSF is wrong by more than its errors: give a `sensitivity`, or another `psf`"
        )
    best, error = tried[0].problem, np.hypot(np.median(fit.flux_err), np.median(fit.flux_scatter))
    costs = [found.equations.cost * found.problem.error_scale**2 for found in tried]
    for found, cost in zip(tried, costs, strict=True):
        flux = np.median(found.problem.fluxes(found.state))
        as_good = abs(cost - costs[0]) < costs[0] * np.sqrt(2 / best.dof)
        if as_good and abs(flux - np.median(fit.flux)) > 3 * error and not _is_strange(found):
            yield (
                f"another model describes the pixels as well, with a flux of {flux:.4g} e-/s in "
                f"place of {np.median(fit.flux):.4g}: give the `psf`"
            )


def _with_response(solution, steps, n_cadences):
    """Return the fit with a response within pixels if so many cadences measure it.

    Else it cannot be distinguished from the width, and the flux would be uncertain.
    """
    guess = len(solution.problem.flux) < n_cadences
    own = {"n_steps": solution.n_steps, "max_steps": _MANY_STEPS}
    other = steps(*_richer(solution), **own, loosely=guess)
    powers, errors = other.problem.prf.response_powers, np.sqrt(np.diag(covariances(other).shared))
    errors = errors * np.sqrt(len(other.problem.flux) / n_cadences)
    measured = all(
        is_measured(powers[parameter.name], error)
        for parameter, error in zip(other.problem.parameters, errors, strict=False)
        if parameter.kind == "response"
    )
    return other if measured and _is_true(other, strictly=True) and not _ends(other) else solution


def _richer(solution):
    problem, state = solution.problem, solution.state
    richer = _with(problem, _start.with_response(problem.prf))
    values = {parameter.name: parameter.start for parameter in richer.parameters}
    values |= zip((p.name for p in problem.parameters), state.shared, strict=True)
    return richer, replace(state, shared=np.array([values[p.name] for p in richer.parameters]))


def _hidden_gain(solution):
    """By how much a response within pixels would lower chi-squared of a fit without one.

    0 if by chance, for a model that is not true, and with a focus, which is of first order.
    """
    prf, focus = solution.problem.prf, solution.problem.options.focus
    given = prf.sensitivity or prf.table or focus
    if given is not None or not _is_true(solution):
        return 0.0
    gain = expected_gain(*_richer(solution))
    return gain if gain > CERTAIN**2 else 0.0


def _is_true(solution, *, strictly=False):
    """Whether the model describes the pixels, with a response as its prior has it."""
    problem, prior = solution.problem, solution.problem.options.interpixel
    agrees = not prior or np.std(solution.state.interpixel) <= LARGEST_SCATTER * prior
    excess = solution.equations.cost / problem.dof - 1
    enough = solution.converged and excess < _EXCESS * np.sqrt(2 / problem.dof)
    return problem.misfit == 1.0 and agrees and (enough or not strictly)


def _ends(solution):
    return bool(solution.problem.at_bounds(solution.state).any()) or not solution.converged


def _is_strange(solution):
    problem, state = solution.problem, solution.state
    light = np.median(problem.flux[:, problem.slices[0]].sum(axis=1))
    images = problem.unit_images(state, slice(None, None, _SOME))
    inside = np.median(images.sum(axis=1)) >= _LEAST_INSIDE
    return not (inside and 0 < np.median(problem.fluxes(state)) < LARGEST_FLUX * abs(light))


def _rank(solution):
    problem = solution.problem
    # A response between pixels describes errors of a PSF that is wrong.
    absorbs = bool(problem.options.interpixel) and not _is_true(solution)
    information = solution.equations.cost + problem.n_shared * np.log(problem.n_data)
    return absorbs, _is_strange(solution), _ends(solution), problem.misfit, information


def _make_problem(series, places, prf, flux_err, options, motion):
    if options.focus is not None and "width" not in prf.parameter_kinds.values():
        raise ValueError("`focus` needs a PSF with a width: a Gaussian or an empirical term")
    n_free = 1 + 2 * (options.positions != "path") + (options.background == "cadence")
    detectors, stamps = [], []
    for item, (_, others, _) in zip(series, places, strict=True):
        changes = {} if item.mission else {"mission": "Kepler"}
        detectors.append(Detector.from_tpf(item, psf=None, sensitivity=None, **changes))
        moved = (item.pos_corr, None) if motion is None else motion.offsets(item)
        full = detectors[-1].full_flux if options.saturation else np.inf
        stamps.append(_start.read_data(item, flux_err, full, moved, n_free + len(others)))
    if stamps[0].pos_corr is None and options.positions in {"prior", "path"}:
        raise ValueError(f"`positions` is {options.positions!r}, but `tpf` has no POS_CORR")
    common = reduce(np.intersect1d, [stamp.cadenceno for stamp in stamps])
    if not common.size:
        raise ValueError("the files have no cadence in common")
    stamps = [stamp[np.isin(stamp.cadenceno, common)] for stamp in stamps]
    found = [_start.located(stamp, *item) for stamp, item in zip(stamps, places, strict=True)]
    stars, first = [], found[0][1]
    for number, (stamp, (_, center, others)) in enumerate(zip(stamps, found, strict=True)):
        stars.append(FitStar(*(center - first), number))
        for other in others:
            constant = options.neighbor_flux == "constant"
            if options.neighbor_flux == "auto":
                constant = _start.is_faint(stamp, center, other)
            stars.append(FitStar(*(other - first), number, constant))
    span = stamps[0].time[[0, -1]].tolist()
    if options.focus is not None and len(common) * options.focus < span[1] - span[0]:
        raise ValueError(f"`focus` is shorter than the cadences are apart, {options.focus:.3g} d")
    given = tuple(stamps), prf, options, tuple(stars), span, first.tolist(), found[0][::2]
    return Problem(*given), detectors


def _progress_bar(progress):
    from tqdm import tqdm

    # None hides the bar where no terminal is.
    shown = {"disable": None, "delay": _PATIENCE} if progress is None else {"disable": not progress}
    return tqdm(desc="fit_tpf", unit=" steps", **shown)


def _report(bar, cost):
    bar.set_postfix_str(f"cost {cost:.6g}", refresh=False)
    bar.update()
