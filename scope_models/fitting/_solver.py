"""Levenberg-Marquardt steps in which the parameters of the cadences are eliminated."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import null_space

from scope_models.fitting._problem import State

__all__ = ["Solution", "covariances", "solve"]

# Less damping at the start lets a PSF that starts far off become a point, from which nothing leads
# back.
_FIRST_DAMPING, _LEAST_DAMPING, _LARGEST_DAMPING = 1e-1, 1e-8, 1e8
# Damping where the start is the result of a fit.
_LATER_DAMPING = 1e-3
# Damping that makes a difference after a step that failed.
_SOBER = 1e-5
# A fit ends where an undamped step would lower the cost by less than this, absolutely or
# relatively: all parameters together are within a tenth of a standard deviation of the minimum.
_ABSOLUTE, _RELATIVE = 1e-2, 1e-6
# ... the latter for a first guess.
_LOOSE = 1e-4
# Directions of the scaled matrix below this are not determined at all.
_FLOOR = 1e-13
# ... and below this their gradient is a rounding error.
_KNOWN = 1e-11


@dataclass(frozen=True, eq=False)
class Solution:
    """The state after the last iteration."""

    state: State  # the best parameters
    equations: object  # the expansion there
    converged: bool  # whether an undamped step would change next to nothing
    n_steps: int
    distance: float  # by how much an undamped step would lower the cost


class _Walls:
    """Bounds of the shared parameters, and the linear constraint of the interpixel map."""

    def __init__(self, problem, only=None):
        self.lower, self.upper = problem.limits.lower, problem.limits.upper
        self.gauge, self.only = problem.limits.gauge, only
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
    # A cadence whose star has no flux does not constrain its position.
    diagonal = matrix[..., index, index]
    matrix[..., index, index] = np.where(diagonal > 0, diagonal * (1 + 1e-12), 1.0)
    return matrix


@dataclass(frozen=True, eq=False)
class _Reduced:
    """Equations of the shared parameters alone, and what back-substitution needs."""

    matrix: np.ndarray
    gradient: np.ndarray
    factor: np.ndarray
    right: np.ndarray

    @property
    def cadence_gain(self):
        """By how much steps of the cadences alone would lower the cost."""
        return float(np.sum(self.right[..., -1] ** 2))


def _eliminate(equations, damping=0.0):
    """Eliminate the parameters of the cadences."""
    factor = np.linalg.cholesky(_damped(equations.cadence, damping))
    n, k, m = equations.mixed.shape
    right = np.concatenate([equations.mixed, equations.cadence_gradient[..., None]], axis=2)
    right = np.linalg.solve(factor, right)
    flat = right.reshape(n * k, m + 1)
    product = flat.T @ flat
    matrix = equations.shared - product[:m, :m]
    return _Reduced(matrix, equations.shared_gradient - product[:m, m], factor, right)


def _spectrum(matrix, whole):
    """
    Scales, eigenvalues and vectors of a reduced matrix in the scales of the whole one.

    What is left of a direction that the cadences can imitate is a rounding error in these scales.
    """
    diagonal = np.diag(whole)
    scale = np.where(diagonal > 0, 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0)), 0.0)
    values, vectors = np.linalg.eigh(matrix * scale[:, None] * scale)
    return scale, values, vectors


def _inverse(matrix, whole):
    """Inverse of a positive matrix; directions that are not determined get huge variances."""
    if matrix.shape[0] == 0:
        return matrix
    scale, values, vectors = _spectrum(matrix, whole)
    values = np.maximum(values, _FLOOR * max(values[-1], 1e-300))
    return ((vectors / values) @ vectors.T) * scale[:, None] * scale


def _distance(equations, walls, shared):
    """By how much an undamped step would lower the cost."""
    try:
        reduced = _eliminate(equations)
    except np.linalg.LinAlgError:
        return np.inf
    basis = walls.basis(walls.outward(shared, reduced.gradient))
    if not basis.shape[1]:
        return reduced.cadence_gain
    matrix = basis.T @ reduced.matrix @ basis
    scale, values, vectors = _spectrum(matrix, basis.T @ equations.shared @ basis)
    known = values > _KNOWN * values[-1]
    gradient = (vectors.T @ (scale * (basis.T @ reduced.gradient)))[known]
    return reduced.cadence_gain + float(np.sum(gradient**2 / values[known]))


def _step(problem, state, equations, walls, damping):
    """The state after one damped step and its expected gain, or None if there is no step."""
    try:
        # The cadences follow the shared parameters; only far from the minimum are they held too.
        reduced = _eliminate(equations, damping * min(damping, 1.0))
    except np.linalg.LinAlgError:
        return None, 0.0
    reach = problem.limits.reach(state.shared)
    brake = np.maximum(np.diag(reduced.matrix), _FLOOR * np.diag(equations.shared))
    brake[: len(reach)] += 1 / reach**2
    matrix = reduced.matrix + damping * np.diag(brake)
    held = walls.outward(state.shared, reduced.gradient)
    while True:
        basis = walls.basis(held)
        inverse = _inverse(basis.T @ matrix @ basis, basis.T @ equations.shared @ basis)
        shared = basis @ (inverse @ (basis.T @ reduced.gradient))
        more = walls.outward(state.shared, shared) & ~held
        if not more.any():
            break
        held |= more
    m = len(shared)
    shared *= min(
        1.0, np.min(reach / np.maximum(np.abs(shared[: len(reach)]), 1e-300), initial=1.0)
    )
    shared *= walls.part_inside(state.shared, shared)
    change = reduced.right[..., m] - reduced.right[..., :m] @ shared
    change = np.linalg.solve(reduced.factor.transpose(0, 2, 1), change[..., None])[..., 0]
    limits = problem.limits
    change = np.clip(change, -limits.cadence_step, limits.cadence_step)
    cadence = np.clip(state.cadence + change, limits.cadence_lower, limits.cadence_upper)
    new = np.clip(state.shared + shared[: problem.n_shared], limits.lower, limits.upper)
    interpixel = state.interpixel + shared[problem.n_shared :]
    if not all(np.isfinite(values).all() for values in (new, interpixel, cadence)):
        return None, 0.0
    return State(new, interpixel, cadence), _promise(equations, shared, cadence - state.cadence)


def _promise(equations, shared, cadence):
    """By how much a step would lower the cost if the equations held everywhere."""
    gradient = equations.shared_gradient @ shared + np.sum(equations.cadence_gradient * cadence)
    bend = shared @ equations.shared @ shared
    bend += 2 * np.sum(cadence * (equations.mixed @ shared))
    bend += np.einsum("nk,nkl,nl->", cadence, equations.cadence, cadence)
    return float(2 * gradient - bend)


def solve(problem, state, max_steps, *, n_steps=0, only=None, loosely=False, report=None):
    """Minimize the cost from a state.

    With ``only``, the other shared parameters and the interpixel map wait; ``loosely``: the result
    is a start for what follows. ``report`` is called with the cost after each step.
    """
    walls = _Walls(problem, only)
    equations = problem.expand(state)
    if not np.isfinite(equations.cost):
        raise ValueError("the model is not finite at the starting values")
    relative = _LOOSE if loosely else _RELATIVE
    damping, growth = _LATER_DAMPING if n_steps else _FIRST_DAMPING, 2.0
    distance = _distance(equations, walls, state.shared)
    for _ in range(max_steps):
        converged = distance < max(_ABSOLUTE, relative * equations.cost)
        if (converged and loosely) or damping > _LARGEST_DAMPING:
            break
        trial, promise = _step(problem, state, equations, walls, damping)
        expanded = problem.expand(trial) if trial is not None else None
        gain = -np.inf if expanded is None else equations.cost - expanded.cost
        if not gain > 0:
            if converged:
                break
            damping, growth = max(damping * growth, _SOBER), growth * 2
            continue
        ratio = gain / promise if promise > 0 else 1.0
        damping *= max(0.1, 1 - (2 * min(ratio, 1.0) - 1) ** 3)
        damping, growth = max(damping, _LEAST_DAMPING), 2.0
        state, equations, n_steps = trial, expanded, n_steps + 1
        if report is not None:
            report(equations.cost)
        distance = _distance(equations, walls, state.shared)
        if converged:  # one more step, beyond the tolerance
            break
    converged = distance < max(_ABSOLUTE, relative * equations.cost)
    return Solution(state, equations, bool(converged), n_steps, float(distance))


def covariances(problem, solution):
    """Covariances of the shared parameters ``(m, m)`` and of each cadence's own ``(n, k, k)``.

    Each holds the uncertainty of the other. The third is that of the parameters of a cadence less
    their mean over all cadences, the last, ``(n, k, m)``, that of a cadence's with the shared ones.
    """
    equations = problem.quoted().expand(solution.state)
    walls = _Walls(problem)
    reduced = _eliminate(equations)
    basis = walls.basis(walls.outward(solution.state.shared, reduced.gradient))
    inverse = _inverse(basis.T @ reduced.matrix @ basis, basis.T @ equations.shared @ basis)
    shared = basis @ inverse @ basis.T
    alone = np.linalg.inv(_damped(equations.cadence, 0.0))
    along = alone @ equations.mixed
    mixed = -along @ shared
    cadence = alone - mixed @ along.transpose(0, 2, 1)
    along = along - along.mean(axis=0)
    relative = alone + (along @ shared) @ along.transpose(0, 2, 1)
    return shared, cadence, relative, mixed
