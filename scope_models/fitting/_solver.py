"""Levenberg-Marquardt steps in which the parameters of the cadences are eliminated."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import null_space

from scope_models.fitting._problem import State

__all__ = ["Solution", "covariances", "solve"]

_FIRST_DAMPING, _LEAST_DAMPING, _LARGEST_DAMPING = 1e-2, 1e-9, 1e8
# A fit ends when a step lowers the cost by less than this, absolutely or relatively.
_ABSOLUTE, _RELATIVE = 0.05, 1e-7
# Directions of the scaled matrix below this are not determined at all.
_FLOOR = 1e-13
_LARGEST_MOVE = 0.3
# With more damping than this a small gain does not mean that the end is near.
_CALM = 1e-2


@dataclass(frozen=True, eq=False)
class Solution:
    """
    Where the iterations ended.

    Parameters
    ----------
    state : State
        The best parameters.
    equations : NormalEquations
        Expansion there.
    converged : bool
        Whether the last step changed nothing.
    n_steps : int
        Number of accepted steps.
    """

    state: State
    equations: object
    converged: bool
    n_steps: int


class _Limits:
    """Bounds of the shared parameters, and the linear constraint of the interpixel map."""

    def __init__(self, problem, lower, upper, gauge, only=None):
        self.lower, self.upper = lower, upper
        self.gauge, self.only = gauge, only
        self.n_shared, self.n_pixels = problem.n_shared, problem.n_pixels

    def outward(self, shared, direction):
        """Which parameters are at a bound and would leave it in a direction."""
        direction = direction[: self.n_shared]
        below, above = shared <= self.lower, shared >= self.upper
        return (below & (direction < 0)) | (above & (direction > 0))

    def part_inside(self, shared, step):
        """Largest part of a step that stays within the bounds."""
        step = step[: self.n_shared]
        bound = np.where(step < 0, self.lower, self.upper)
        with np.errstate(divide="ignore", invalid="ignore"):
            parts = (bound - shared) / step
        return min(1.0, np.min(parts[step != 0], initial=1.0))

    def basis(self, held):
        """Directions in which parameters and the map may move, but for the held ones, (m, r)."""
        if self.only is not None:
            held = held | ~self.only
        free = np.eye(self.n_shared + self.n_pixels)[:, : self.n_shared][:, ~held]
        if self.gauge is None or self.only is not None:
            return free
        inside = null_space(self.gauge[None, :])
        basis = np.zeros((self.n_shared + len(self.gauge), free.shape[1] + inside.shape[1]))
        basis[:, : free.shape[1]] = free
        basis[self.n_shared :, free.shape[1] :] = inside
        return basis


def _damped(matrix, damping):
    """A matrix, or a stack of them, with its diagonal enlarged."""
    matrix = matrix.copy()
    index = np.arange(matrix.shape[-1])
    matrix[..., index, index] *= 1 + damping
    # A cadence whose star has no flux knows nothing of its position.
    diagonal = matrix[..., index, index]
    matrix[..., index, index] = np.where(diagonal > 0, diagonal * (1 + 1e-12), 1.0)
    return matrix


def _eliminate(equations, damping):
    """Reduced matrix and gradient of the shared parameters, and what back-substitution needs."""
    factor = np.linalg.cholesky(_damped(equations.cadence, damping))
    n, k, m = equations.mixed.shape
    right = np.concatenate([equations.mixed, equations.cadence_gradient[..., None]], axis=2)
    right = np.linalg.solve(factor, right)
    flat = right.reshape(n * k, m + 1)
    product = flat.T @ flat
    matrix = equations.shared.copy()
    matrix[np.arange(m), np.arange(m)] *= 1 + damping
    matrix -= product[:m, :m]
    return matrix, equations.shared_gradient - product[:m, m], factor, right


def _inverse(matrix):
    """Inverse of a positive matrix; directions that are not determined get huge variances."""
    if matrix.shape[0] == 0:
        return matrix
    diagonal = np.diag(matrix)
    known = diagonal > 0  # rounding errors leave less of what is not determined
    scale = np.where(known, 1 / np.sqrt(np.where(known, diagonal, 1.0)), 0.0)
    values, vectors = np.linalg.eigh(matrix * scale[:, None] * scale)
    values = np.maximum(values, _FLOOR * max(values[-1], 1e-300))
    return ((vectors / values) @ vectors.T) * scale[:, None] * scale


def _reach(problem, state):
    """How far the parameters of the PRF may move in one step, ``(s,)``."""
    reach = np.full(len(problem.names), np.inf)
    for i, name in enumerate(problem.names):
        if name.startswith("sigma"):
            reach[i] = _LARGEST_MOVE * state.shared[i]
        elif name.startswith(("rho", "flux_fraction", "x_offset", "y_offset")):
            reach[i] = _LARGEST_MOVE
    return reach


def _step(problem, state, equations, limits, damping):
    """The state after one damped step, or None where rounding errors leave no step."""
    try:
        matrix, gradient, factor, right = _eliminate(equations, damping)
    except np.linalg.LinAlgError:
        return None
    held = limits.outward(state.shared, gradient)
    while True:
        basis = limits.basis(held)
        shared = basis @ (_inverse(basis.T @ matrix @ basis) @ (basis.T @ gradient))
        more = limits.outward(state.shared, shared) & ~held
        if not more.any():
            break
        held |= more
    m, reach = len(shared), _reach(problem, state)
    with np.errstate(divide="ignore"):
        shared *= min(1.0, np.min(reach / np.abs(shared[: len(reach)]), initial=1.0))
    shared *= limits.part_inside(state.shared, shared)
    change = right[..., m] - right[..., :m] @ shared
    change = np.linalg.solve(factor.transpose(0, 2, 1), change[..., None])[..., 0]
    if not problem.path:
        np.clip(change[:, :2], -_LARGEST_MOVE, _LARGEST_MOVE, out=change[:, :2])
    cadence = state.cadence + change
    if not problem.path:
        ny, nx = problem.data.shape
        np.clip(cadence[:, :2], [-1, -1], [nx, ny], out=cadence[:, :2])
    new = np.clip(state.shared + shared[: problem.n_shared], limits.lower, limits.upper)
    interpixel = state.interpixel + shared[problem.n_shared :]
    finite = all(np.isfinite(values).all() for values in (new, interpixel, cadence))
    return State(new, interpixel, cadence) if finite else None


def solve(problem, state, lower, upper, gauge, max_steps, n_steps=0, only=None):
    """
    Minimise the cost.

    Parameters
    ----------
    problem : Problem
        What is fitted.
    state : State
        Start.
    lower, upper : ndarray of shape (s,)
        Bounds of the shared parameters.
    gauge : ndarray of shape (p,) or None
        Weights of the fitted pixels whose mean response is held at 1.
    max_steps : int
        Largest number of steps.
    n_steps : int, optional
        Steps taken before.
    only : ndarray of bool, shape (s,), optional
        Shared parameters that are free while the others, and the interpixel map, wait.

    Returns
    -------
    Solution
        The best state.
    """
    limits = _Limits(problem, lower, upper, gauge, only)
    equations = problem.expand(state)
    if not np.isfinite(equations.cost):
        raise ValueError("the model is not finite at the starting values")
    damping, converged, streak = _FIRST_DAMPING, False, 2
    for _ in range(max_steps):
        trial = _step(problem, state, equations, limits, damping)
        expanded = problem.expand(trial) if trial is not None else None
        gain = -np.inf if expanded is None else equations.cost - expanded.cost
        small = max(_ABSOLUTE, _RELATIVE * equations.cost)
        if gain >= 0:
            state, equations, n_steps = trial, expanded, n_steps + 1
            converged = gain < small and damping <= _CALM
            # Soon after a step that failed, more courage would only fail again.
            damping = max(damping / (10 if streak > 1 else 1.5), _LEAST_DAMPING)
            streak += 1
        else:
            # Rounding errors: no step lowers the cost any more.
            converged = bool(-gain < 1e-3 * small) and damping <= _CALM
            damping, streak = max(damping * 4, 1e-5), 0
        if converged or damping > _LARGEST_DAMPING:
            break
    return Solution(state, equations, bool(converged), n_steps)


def covariances(problem, solution, lower, upper, gauge):
    """
    Covariance of the shared parameters and of each cadence's own.

    Parameters
    ----------
    problem : Problem
        What was fitted.
    solution : Solution
        The result.
    lower, upper, gauge
        As for `solve`.

    Returns
    -------
    shared : ndarray of shape (m, m)
        With the uncertainty of the parameters of the cadences.
    cadence : ndarray of shape (n, k, k)
        Likewise, with that of the shared ones.
    relative : ndarray of shape (n, k, k)
        Likewise, of the parameters of a cadence less their mean over all cadences.
    """
    equations = solution.equations
    limits = _Limits(problem, lower, upper, gauge)
    matrix, gradient, _, _ = _eliminate(equations, 0.0)
    basis = limits.basis(limits.outward(solution.state.shared, gradient))
    shared = basis @ _inverse(basis.T @ matrix @ basis) @ basis.T
    alone = np.linalg.inv(_damped(equations.cadence, 0.0))
    along = alone @ equations.mixed
    cadence = alone + (along @ shared) @ along.transpose(0, 2, 1)
    along -= along.mean(axis=0)
    return shared, cadence, alone + (along @ shared) @ along.transpose(0, 2, 1)
