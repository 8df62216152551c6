"""The covariance of noise and long-term variability, in linear time."""

from functools import cached_property

import numpy as np
from celerite2 import backprop, driver

__all__ = ["FORGOTTEN", "Covariance"]

#: Tolerance: a random walk is pulled back within so many days, longer than files.
FORGOTTEN = 100.0


class Covariance:
    r"""White noise plus a smooth stochastic oscillator and a random walk, factorized by celerite2.

    The kernel of the oscillator is that of a stochastically driven, damped one of quality
    :math:`1/\sqrt{2}`, :math:`k(\tau) = \sigma^2 e^{-w|\tau|} (\cos w\tau + \sin w|\tau|)` with
    :math:`w = \sqrt{2}\,\pi/\rho`. The ``amplitude`` is the variance :math:`\sigma^2`, the
    ``period`` the undamped :math:`\rho`, ``walk`` half of the variance of the random walk's daily
    steps; times in days increase.
    """

    def __init__(self, time, variance, amplitude, period, walk=0.0):
        self.time, self.variance, self.amplitude = time, variance, amplitude
        self.rate, self.walk = np.sqrt(2) * np.pi / period, walk * FORGOTTEN
        self._a = variance + amplitude + self.walk
        self._u, self._v = self._generators(time)
        self._c = np.array([self.rate, self.rate, 1 / FORGOTTEN])
        try:
            self._d, self._w, self._state = backprop.factor_fwd(
                time, self._c, self._a, self._u, self._v,
                np.empty_like(self._a), np.empty_like(self._v), np.empty((len(time), 3, 3)),
            )  # fmt: skip
        except backprop.LinAlgError:
            self._d = np.array([np.nan])
        if not np.isfinite(self._d).all():
            raise np.linalg.LinAlgError("the covariance is not positive definite")
        self.log_determinant = float(np.sum(np.log(self._d)))

    def _generators(self, time):
        """Return the generators of the lower and the upper triangle, ``(n, 3)``."""
        phase, one = self.rate * time, np.ones_like(time)
        cos, sin = np.cos(phase), np.sin(phase)
        lower = np.stack([cos + sin, sin - cos, one], axis=1)
        lower *= self.amplitude, self.amplitude, self.walk
        return lower, np.stack([cos, sin, one], axis=1)

    def whiten(self, columns):
        """Return ``Z`` with ``Z.T @ Z = columns.T @ inv(K) @ columns``."""
        z = np.array(columns, order="C")
        z = driver.solve_lower(self.time, self._c, self._u, self._w, z, z)
        z /= np.sqrt(self._d)[:, None]
        return z

    def solve_whitened(self, whitened):
        """Return ``inv(K) @ columns`` from what `whiten` makes of them."""
        z = np.divide(whitened, np.sqrt(self._d)[:, None], order="C")
        return driver.solve_upper(self.time, self._c, self._u, self._w, z, z)

    def predict(self, residual, time):
        """Return the mean of the processes at other increasing times, from ``inv(K) @ rest``."""
        alpha, (u, v) = np.ascontiguousarray(residual[:, None]), self._generators(time)
        mean = np.zeros((len(time), 1))
        mean = driver.general_matmul_lower(time, self.time, self._c, u, self._v, alpha, mean)
        return driver.general_matmul_upper(time, self.time, self._c, v, self._u, alpha, mean)[:, 0]

    def gradient(self, whitened):
        """Differentiate ``f(C.T @ inv(K) @ C) + log det(K) / 2``.

        The derivative of f by its argument is F F^T / 2, and whitened is what `whiten` makes of the
        columns C, times F. With G = inv(K) C F, a change dK of K changes f by -G^T dK G / 2. Return
        slopes by the noise's variance, ``(n,)``, and the logarithms of amplitude, period and walk.
        """
        solved = self.solve_whitened(whitened)
        by_noise = 0.5 * np.einsum("ij,ij->i", solved, solved)
        variance_bar, amplitude_bar, period_bar, walk_bar = self._determinant_gradient
        u, v = np.ascontiguousarray(self._u[:, 2:]), np.ascontiguousarray(self._v[:, 2:])
        below = driver.matmul_lower(self.time, self._c[2:], u, v, solved, np.zeros_like(solved))
        by_walk = self.walk * by_noise.sum() + np.vdot(solved, below)
        # the process' part of K is K without the noise
        by_process = 0.5 * np.vdot(whitened, whitened) - by_noise @ self.variance - by_walk
        # the kernel's slope by log period is 2 sigma^2 w tau exp(-w tau) sin(w tau): tau is a
        # difference of times, so that four pairs of generators make it
        t, (cos, sin, _) = self.time, self._v.T
        u = 2 * self.amplitude * self.rate * np.stack([t * sin, t * cos, sin, cos], axis=1)
        v = np.stack([cos, -sin, -t * cos, t * sin], axis=1)
        below = driver.matmul_lower(t, np.full(4, self.rate), u, v, solved, np.zeros_like(solved))
        by_period = np.vdot(solved, below)
        slopes = amplitude_bar - by_process, period_bar - by_period, walk_bar - by_walk
        return variance_bar - by_noise, *slopes

    @cached_property
    def _determinant_bars(self):
        """Derivatives of half of log det K by the diagonal, the rates and the generators."""
        bars = [np.zeros_like(x) for x in (self.time, self._c, self._a, self._u, self._v)]
        arrays = self.time, self._c, self._a, self._u, self._v, self._d, self._w, self._state
        return backprop.factor_rev(*arrays, 0.5 / self._d, np.zeros_like(self._w), *bars)[1:]

    @property
    def _determinant_gradient(self):
        """Derivatives of half of log det K, as of `gradient`."""
        c_bar, a_bar, u_bar, v_bar = self._determinant_bars
        amplitude, (cos, sin, _) = self.amplitude, self._v.T
        by_generator = np.einsum("ij,ij->j", u_bar, self._u)
        amplitude_bar = amplitude * a_bar.sum() + by_generator[:2].sum()
        walk_bar = self.walk * a_bar.sum() + by_generator[2]
        # by the phase of the generators, which a longer period turns back
        du = amplitude * np.stack([cos - sin, cos + sin], axis=1)
        turned = u_bar[:, :2] * du + v_bar[:, :2] * np.stack([-sin, cos], axis=1)
        turned = np.sum(turned * (self.rate * self.time[:, None])) + self.rate * c_bar[:2].sum()
        return a_bar, float(amplitude_bar), float(-turned), float(walk_bar)

    def inverse_diagonal(self):
        """Return the diagonal of ``inv(K)``: the derivative of log det K by that of K."""
        return 2 * self._determinant_bars[1]

    def inverse_blocks(self, starts, width):
        """Return the diagonal blocks of ``inv(K)``, shape ``(n_blocks, width, width)``.

        With K = L D L^T, a column of inv(L) is a recursion through a state of three numbers: all
        rows below a block enter through one 3 x 3 matrix.
        """
        u, d, decay = self._u, self._d, self._decay
        rows = np.zeros((len(starts), width, width))
        tails = np.zeros((len(starts), width, 3))
        for k in range(width):
            here = starts + k
            columns = -(tails @ u[here, :, None])[:, :, 0]
            columns[:, k] = 1.0
            rows[:, :, k] = columns / np.sqrt(d[here, None])
            tails = decay[here, None] * (tails + columns[:, :, None] * self._w[here, None])
        outside = tails @ self._below[starts + width] @ tails.transpose(0, 2, 1)
        return rows @ rows.transpose(0, 2, 1) + outside

    @cached_property
    def _decay(self):
        """Decay of the states from each row to the next, ``(n, 3)``."""
        return np.append(np.exp(-self._c * np.diff(self.time)[:, None]), np.zeros((1, 3)), axis=0)

    @cached_property
    def _below(self):
        """S_m = u_m u_m^T / d_m + T_m^T S_(m+1) T_m with T = decay (1 - w u^T), and 0 below.

        Sums over twice as many rows follow from two of so many each.
        """
        u, rows = self._u, len(self._d)
        steps = self._decay[:, :, None] * (np.eye(3) - self._w[:, :, None] * u[:, None])
        sums = np.zeros((rows + 1, 3, 3))
        sums[:-1] = u[:, :, None] * u[:, None] / self._d[:, None, None]
        width = 1
        while width < rows:
            here = steps[:-1]
            sums[: rows - width] += here.transpose(0, 2, 1) @ sums[width:rows] @ here
            steps, width = steps[width:] @ steps[:-width], 2 * width
        return sums
