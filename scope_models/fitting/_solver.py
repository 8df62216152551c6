"""Levenberg-Marquardt steps in which the parameters of the cadences are eliminated."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from scope_models.fitting._problem import LARGEST_MOVE, NormalEquations, Problem, State

__all__ = [
    "Errors", "Solution", "covariances", "deviation", "expected_gain", "psf_covariance", "solve",
    "star_columns",
]  # fmt: skip

# First damping, where less lets a PSF become a point, from which nothing leads back, and that from
# the result of a fit; its limits; the least one after a step that failed.
_FIRST_DAMPING, _LATER_DAMPING = 1e-1, 1e-6
_LEAST_DAMPING, _LARGEST_DAMPING, _SOBER = 1e-8, 1e8, 1e-5
# Gain of an undamped step where a fit ends, a tenth of a standard deviation of all parameters from
# the minimum: absolute, relative, and relative of a guess.
_ABSOLUTE, _RELATIVE, _LOOSE = 1e-2, 1e-6, 1e-4
# Relative eigenvalues of directions that are not determined, and whose gradients are rounding.
_FLOOR, _KNOWN = 1e-13, 1e-11


@dataclass(frozen=True, eq=False)
class Solution:
    problem: Problem
    state: State  # the best one
    equations: NormalEquations  # the expansion there
    converged: bool  # whether an undamped step would change next to nothing
    n_steps: int


@dataclass(frozen=True, eq=False)
class Errors:
    shared: np.ndarray  # (m, m): covariance of shared parameters and interpixel map
    cadence: np.ndarray  # (n, k, k): of the parameters of each cadence
    relative: np.ndarray  # (n, k, k): ... less their mean over all cadences
    mixed: np.ndarray  # (n, k, m): ... with the shared ones
    common: np.ndarray  # (stars, n or 1): relative error that fluxes have in common


def _outward(problem, shared, direction):
    """Which shared parameters a direction leads out of their bounds, ``(s,)``."""
    (lower, upper), direction = problem.bounds, direction[: problem.n_shared]
    return ((shared <= lower) & (direction < 0)) | ((shared >= upper) & (direction > 0))


def _directions(problem, held, only):
    """Directions of shared parameters and map that are free, ``(m, r)``."""
    response = problem.free_response
    if only is not None:
        held, response = held | ~only, response[:, :0]
    free = problem.free_shared
    return block_diag(free[:, ~held[: free.shape[1]]], response)


def _damped(matrix, damping):
    index = np.arange(matrix.shape[-1])
    # A cadence whose star has no flux does not constrain its position.
    diagonal = matrix[..., index, index] * ((1 + damping) * (1 + 1e-12))
    matrix = matrix.copy()
    matrix[..., index, index] = np.where(diagonal > 0, diagonal, 1.0)
    return matrix


def _eliminate(equations, damping=0.0):
    """Matrix and gradient of the shared parameters, and what gives those of the cadences."""
    factor = np.linalg.cholesky(_damped(equations.cadence, damping))
    right = np.concatenate([equations.mixed, equations.cadence_gradient[..., None]], axis=2)
    right = np.linalg.solve(factor, right)
    m = right.shape[2] - 1
    flat = right.reshape(-1, m + 1)
    product = flat.T @ flat
    matrix = equations.shared - product[:m, :m]
    return matrix, equations.shared_gradient - product[:m, m], factor, right


def _inverse(matrix, whole, basis, *, known=False):
    """Inverse of a reduced matrix in some directions, in the scales of the whole one.

    In these scales a direction that the cadences can imitate is a rounding error: it gets a huge
    variance, or none if only the ``known`` ones count.
    """
    if not basis.shape[1]:
        return np.zeros_like(matrix)
    diagonal = np.einsum("ir,ij,jr->r", basis, whole, basis, optimize=True)
    scaled = basis * np.where(diagonal > 0, np.maximum(diagonal, 1e-300) ** -0.5, 0.0)
    values, vectors = np.linalg.eigh(scaled.T @ matrix @ scaled)
    largest = max(values[-1], 1e-300)
    kept = values > _KNOWN * largest if known else slice(None)
    vectors = scaled @ vectors[:, kept]
    return (vectors / np.maximum(values[kept], _FLOOR * largest)) @ vectors.T


def expected_gain(problem, state, equations=None, only=None):
    """By how much an undamped step from a state would lower the cost, to second order."""
    equations = equations or problem.expand(state)
    try:
        matrix, gradient, _, right = _eliminate(equations)
    except np.linalg.LinAlgError:
        return np.inf
    basis = _directions(problem, _outward(problem, state.shared, gradient), only)
    inverse = _inverse(matrix, equations.shared, basis, known=True)
    return float(np.sum(right[..., -1] ** 2) + gradient @ inverse @ gradient)


def _step(problem, state, equations, only, damping):
    """The state after one damped step, or None, and its expected gain."""
    try:
        # The cadences follow the shared parameters, but far from the minimum.
        held = 0.0 if problem.options.positions == "path" else damping * min(damping, 1.0)
        matrix, gradient, factor, right = _eliminate(equations, held)
    except np.linalg.LinAlgError:
        return None, 0.0
    s, (lower, upper) = problem.n_shared, problem.bounds
    sizes = np.where([p.relative for p in problem.parameters], np.abs(state.shared), 1.0)
    reach = np.array([p.largest_step for p in problem.parameters]) * sizes
    brake = np.maximum(np.diag(matrix), _FLOOR * np.diag(equations.shared))
    brake[:s] += 1 / reach**2
    matrix = matrix + damping * np.diag(brake)
    held, more = _outward(problem, state.shared, gradient), True
    while np.any(more):
        basis = _directions(problem, held, only)
        shared = _inverse(matrix, equations.shared, basis) @ gradient
        more = _outward(problem, state.shared, shared) & ~held
        held = held | more
    room = np.where(shared[:s] < 0, state.shared - lower, upper - state.shared)
    moves = shared[:s] != 0
    part = np.min(np.minimum(reach, room)[moves] / np.abs(shared[:s][moves]), initial=1.0)
    shared *= part
    own = right[..., -1] - right[..., :-1] @ shared
    own = np.linalg.solve(factor.transpose(0, 2, 1), own[..., None])[..., 0]
    own[:, :2] = np.clip(own[:, :2], -LARGEST_MOVE, LARGEST_MOVE)
    cadence = state.cadence + own
    cadence[:, :2] = np.clip(cadence[:, :2], -1.0, problem.data.shape[::-1])
    new = np.clip(state.shared + shared[:s], lower, upper)
    trial = State(new, state.interpixel + shared[s:], cadence)
    if not all(np.isfinite(values).all() for values in vars(trial).values()):
        return None, 0.0
    own = cadence - state.cadence
    gain = 2 * (equations.shared_gradient @ shared + np.sum(equations.cadence_gradient * own))
    gain -= shared @ equations.shared @ shared + 2 * np.sum(own * (equations.mixed @ shared))
    return trial, gain - np.einsum("nk,nkl,nl->", own, equations.cadence, own)


def solve(problem, state, max_steps, report, *, n_steps=0, only=None, loosely=False):
    """Minimize the cost from a state; ``report`` is called with it after each step.

    With ``only``, the other shared parameters and the interpixel map wait; ``loosely``: the result
    is a start for what follows.
    """
    equations = problem.expand(state)
    if not np.isfinite(equations.cost):
        raise ValueError("the model is not finite at the starting values")
    damping, growth = _LATER_DAMPING if n_steps else _FIRST_DAMPING, 2.0

    def converged():
        gain = expected_gain(problem, state, equations, only)
        return gain < max(_ABSOLUTE, (_LOOSE if loosely else _RELATIVE) * equations.cost)

    near = converged()
    for _ in range(max_steps):
        if (near and loosely) or damping > _LARGEST_DAMPING:
            break
        trial, promise = _step(problem, state, equations, only, damping)
        expanded = problem.expand(trial) if trial else None
        gain = equations.cost - expanded.cost if trial else -np.inf
        if not gain > 0:
            if near:
                break
            damping, growth = max(damping * growth, _SOBER), growth * 2
            continue
        ratio = gain / promise if promise > 0 else 1.0
        damping *= max(0.1, 1 - (2 * min(ratio, 1.0) - 1) ** 3)
        damping, growth = max(damping, _LEAST_DAMPING), 2.0
        state, equations, n_steps = trial, expanded, n_steps + 1
        report(equations.cost)
        before, near = near, converged()
        if before:  # one more step, beyond the tolerance
            break
    return Solution(problem, state, equations, bool(near), n_steps)


def covariances(solution):
    """`Errors` as they are quoted, with the same weights of outliers."""
    problem, state = solution.problem, solution.state
    soft = problem.options.loss_scale * problem.error_scale / problem.misfit
    options = replace(problem.options, loss_scale=soft)
    problem = replace(problem, error_scale=problem.misfit, options=options)
    equations = problem.expand(state)
    matrix, gradient, *_ = _eliminate(equations)
    basis = _directions(problem, _outward(problem, state.shared, gradient), None)
    shared = _inverse(matrix, equations.shared, basis)
    alone = np.linalg.inv(_damped(equations.cadence, 0.0))
    along = alone @ equations.mixed
    mixed = -along @ shared
    cadence = alone - mixed @ along.transpose(0, 2, 1)
    along = along - along.mean(axis=0)
    relative = alone + (along @ shared) @ along.transpose(0, 2, 1)
    return Errors(shared, cadence, relative, mixed, np.zeros((len(problem.stars), 1)))


def psf_covariance(solution, response):
    """Covariance of shared parameters, fitted without the responses ``(p,)`` found later."""
    options, state = replace(solution.problem.options, interpixel=np.inf), solution.state
    problem = replace(solution.problem, options=options, error_scale=1.0)
    equations = problem.expand(replace(state, interpixel=np.zeros(problem.n_pixels)))
    matrix, s = _eliminate(equations)[0], problem.n_shared
    basis = np.eye(s)[:, ~problem.at_bounds(state)]
    covariance = _inverse(matrix[:s, :s], equations.shared[:s, :s], basis)
    # The shared parameters have taken up a part of the responses, which are of one variance.
    leak = covariance @ matrix[:s, s:]
    whole = np.trace(matrix[s:, s:])
    left = max(whole - np.sum(leak * matrix[:s, s:]), np.finfo(float).eps * whole, 1e-300)
    variance = response @ matrix[s:, s:] @ response / left
    covariance = covariance + variance * leak @ leak.T
    # No parameter is more uncertain than its prior; sums of squares stay positive.
    size = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    values, vectors = np.linalg.eigh(covariance / np.outer(size, size))
    root = size[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    prior = np.array([p.prior for p in problem.parameters])
    turn = np.linalg.svd(root / prior[:, None])
    root = root @ turn.Vh.T / np.hypot(1.0, turn.S)
    return root @ root.T


def star_columns(problem, state, errors, star):
    """Position and flux of a star, and their errors, by name."""
    n, k, m = errors.mixed.shape
    by = np.zeros((2, n, k + m))
    for axis, column, derivative in problem.position_terms(state, star):
        by[axis, :, column] = derivative
    own, common = by[..., :k], by[..., k:]
    variances = np.einsum("ani,nij,anj->an", own, errors.cadence, own)
    variances += 2 * np.einsum("ani,nij,anj->an", own, errors.mixed, common)
    variances += np.einsum("ani,ij,anj->an", common, errors.shared, common, optimize=True)
    (x, y), flux = problem.xy(state, star).T.copy(), np.array(problem.fluxes(state, star))
    x_err, y_err = np.sqrt(np.maximum(variances, 0.0))
    flux_err = np.hypot(deviation(errors, problem.flux_number(star)), flux * errors.common[star])
    return {"x": x, "y": y, "flux": flux, "x_err": x_err, "y_err": y_err, "flux_err": flux_err}


def deviation(errors, column):
    k = errors.cadence.shape[1]
    if column < k:
        return np.sqrt(np.maximum(errors.cadence[:, column, column], 0.0))
    return np.full(len(errors.cadence), max(errors.shared[column - k, column - k], 0.0) ** 0.5)
