"""`fit_tpf`: one model for all pixels and cadences of a target pixel file."""

from dataclasses import replace
from os import PathLike

import numpy as np
from astropy.modeling import Model

from scope_models._checks import checked_integer, checked_number
from scope_models.fitting._data import detector_of, read_data
from scope_models.fitting._gather import make_result, warn_of_fit
from scope_models.fitting._problem import FitOptions, Problem
from scope_models.fitting._solver import covariances, solve
from scope_models.fitting._start import linear_start, make_prf, starting_state
from scope_models.io.pixels import read_pixels

__all__ = ["fit_tpf"]

_BACKGROUNDS = ("cadence", "constant", "none")
_POSITIONS = ("free", "start", "prior", "path")
_LOSSES = ("linear", "soft_l1")
# How often errors are scaled, at most, where the model is not true.
_RESCALINGS = 8
# So many cadences give the first guess for those of a long series.
_FEW = 300


def fit_tpf(
    tpf,
    psf=2,
    sensitivity=None,
    *,
    empirical=0,
    interpixel=0.01,
    background="cadence",
    positions="start",
    position_error=0.01,
    loss="linear",
    loss_scale=3.0,
    flux_err=None,
    saturation=True,
    max_steps=200,
):
    r"""
    Fit one model to all pixels and cadences of a target pixel file at once.

    .. math:: f_{t,p} = b_p F_t \int_p P(x - x_t, y - y_t)\, s(u, v)\, dx\, dy + B_t

    with the shape of the PSF P, the sensitivity s and the response b of each pixel shared by all
    cadences, and position, flux and background for each of them. Levenberg-Marquardt steps with
    analytic derivatives; the parameters of the cadences are eliminated from each step, so that
    time and memory are linear in cadences.

    Parameters
    ----------
    tpf : `~lightkurve.targetpixelfile.TargetPixelFile`, str or path-like
        The pixels, without the background of its column FLUX_BKG: the object, or a file, whose
        cadences with bad quality flags are left out as lightkurve does.
    psf : int or `~astropy.modeling.Model`, optional
        1, 2 or 3 Gaussian components with free offsets; or a density or sum of densities, as for
        `~scope_models.PRF`; or a `~scope_models.PRF`. A model gives the starting values, and
        its ``fixed`` and ``bounds`` are kept.
    sensitivity : `~scope_models.SensitivityPolynomial`, optional
        Response within a pixel: starting values, and by its ``fixed`` what is fitted. The
        constants are always fixed, because they are the flux. None: the response is 1.
    empirical : int, optional
        Order of a `~scope_models.models.GaussHermitePSF` that is added to the PSF; 0 for none.
        Its width and its part of the flux are fixed, its coefficients have a prior of standard
        deviation 10. For another width, give the term as a part of ``psf``.
    interpixel : float, optional
        Standard deviation, before the fit, of the response between pixels; 0 fixes it at 1.
    background : {"cadence", "constant", "none"}, optional
        Background left in the pixels.
    positions : {"start", "free", "prior", "path"}, optional
        What POS_CORR is used for, through an affine map: the first guess of free positions,
        nothing, a prior, or the positions themselves. The map is fitted too for the last two.
    position_error : float, optional
        Standard deviation of the positions about the path, pixels, for "prior".
    loss : {"linear", "soft_l1"}, optional
        Least squares, or a loss that grows only linearly with residuals above ``loss_scale``,
        for data with cosmic rays.
    loss_scale : float, optional
        In standard deviations.
    flux_err : array_like or `~astropy.units.Quantity`, optional
        Errors of the pixels, e-/s, in place of those of the file.
    saturation : bool, optional
        Whether columns with pixels near the depth of their wells are left out.
    max_steps : int, optional
        Largest number of steps of each stage.

    Returns
    -------
    TPFFit
        The fit. It is returned, with a warning, even if it has not converged.

    Raises
    ------
    TypeError
        If an argument is of the wrong kind.
    ValueError
        If an argument is outside its domain, or the file holds nothing to fit.

    Warns
    -----
    FitWarning
        If data are left out, the fit has not converged, the motion does not constrain the
        sensitivity, or the model does not describe the pixels.

    Notes
    -----
    Conventions fix what the pixels do not constrain. The constants of the sensitivity are 1.
    The mean of b, weighted by the median image, is 1: the common response of the pixels is part
    of the flux. x and y are the position of the first component. Pixel values that are not
    finite, and cadences with too few of them, are left out.

    Where the model is not true, and the typical squared residual, from medians over cadences and
    pixels, is above 1.5 squared errors, all errors are scaled up by its root, the attribute
    ``error_scale``, so that priors keep their weight and the errors of the parameters grow.
    Chi-squared is always that of the given errors.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, fit_tpf, simulate
    >>> detector = Detector.k2(shape=(7, 7))
    >>> observation = simulate(Star(12.0), detector, Motion.k2_roll(100), seed=1)
    >>> fit = fit_tpf(observation.to_tpf(), psf=1)
    >>> print(f"{fit.values['sigma_x']:.2f} {fit.reduced_chi2:.1f}")
    0.50 1.0
    """
    options = FitOptions(
        empirical=checked_integer("empirical", empirical, 0),
        interpixel=_checked_width("interpixel", interpixel),
        background=_one_of("background", background, _BACKGROUNDS),
        positions=_one_of("positions", positions, _POSITIONS),
        position_error=checked_number("position_error", position_error, "pix", positive=True),
        loss=_one_of("loss", loss, _LOSSES),
        loss_scale=checked_number("loss_scale", loss_scale, positive=True),
        saturation=bool(saturation),
    )
    max_steps = checked_integer("max_steps", max_steps, 1)
    if not isinstance(psf, int | Model):
        raise TypeError(f"`psf` must be a number of components or a model, got {psf!r}")
    problem, series, detector = _make_problem(tpf, psf, sensitivity, flux_err, options)
    # What the shape of the PSF can imitate is freed when the shape is about right.
    early = np.array([p.kind != "response" for p in problem.parameters], dtype=bool)
    problem, solution = _minimise(problem, starting_state(problem), early, max_steps)
    fit = make_result(problem, solution, covariances(problem, solution), detector, series)
    warn_of_fit(fit, stacklevel=3)
    return fit


def _minimise(problem, state, early, max_steps):
    """Fit the shape, then everything, with errors that are scaled to the residuals."""
    every = len(problem.flux) // _FEW
    if every > 1:
        # What all cadences share is constrained nearly as well by some of them.
        few = problem.thinned(every)
        _, guess = _minimise(few, starting_state(few), early, max_steps)
        state = replace(state, shared=guess.state.shared, interpixel=guess.state.interpixel)
        state = linear_start(problem, state)
        problem = problem.rescaled(state)
        solution = solve(problem, state, max_steps, n_steps=guess.n_steps, loosely=True)
    else:
        # Scaled from the start: else all residuals are outliers to a robust loss.
        problem = problem.rescaled(state)
        solution = solve(problem, state, max_steps, only=early, loosely=True)
    for remaining in reversed(range(_RESCALINGS)):
        scaled = problem.rescaled(solution.state)
        changed = scaled is not problem and remaining > 0
        problem = scaled
        solution = solve(
            problem, solution.state, max_steps, n_steps=solution.n_steps, loosely=changed
        )
        if not changed:
            break
    return problem, solution


def _make_problem(tpf, psf, sensitivity, flux_err, options):
    """What is fitted, the pixels of the file, and the detector that recorded them."""
    series = read_pixels(tpf, quality_bitmask="default" if _is_path(tpf) else "none")
    prf = make_prf(psf, sensitivity, options.empirical)
    detector = detector_of(series)
    n_free = 1 + 2 * (options.positions != "path") + (options.background == "cadence")
    data = read_data(series, flux_err, detector, n_free, saturation=options.saturation)
    if data.pos_corr is None and options.positions in {"prior", "path"}:
        raise ValueError(f"`positions` is {options.positions!r}, but `tpf` has no POS_CORR")
    return Problem((data,), prf, options), series, detector


def _is_path(source):
    return isinstance(source, str | PathLike)


def _one_of(name, value, allowed):
    if value not in allowed:
        raise ValueError(f"`{name}` must be one of {', '.join(allowed)}, got {value!r}")
    return value


def _checked_width(name, value):
    """A number that is not negative; infinity is one."""
    return np.inf if value == np.inf else checked_number(name, value)
