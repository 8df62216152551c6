"""Covariance of stochastic variability and white noise, solved in linear time."""

from functools import cached_property

import numpy as np
from celerite2 import backprop, driver

__all__ = ["Covariance", "Noise", "RandomWalk"]


class Noise:
    """White noise alone, of a variance ``(n,)``, with the interface of `Covariance`."""

    def __init__(self, variance):
        self.variance = variance
        self.log_determinant = float(np.sum(np.log(variance)))

    def whiten(self, columns):
        """Return ``Z`` with ``Z.T @ Z = columns.T @ inv(K) @ columns``."""
        return columns / np.sqrt(self.variance)[:, None]

    def solve(self, columns):
        """Return ``inv(K) @ columns``."""
        return columns / self.variance[:, None]

    def inverse_diagonal(self):
        """Return the diagonal of ``inv(K)``."""
        return 1 / self.variance

    def inverse_blocks(self, starts, width):
        """Return the diagonal blocks of ``inv(K)``, shape ``(n_blocks, width, width)``."""
        index = starts[:, None] + np.arange(width)
        blocks = np.zeros((len(starts), width, width))
        diagonal = np.arange(width)
        blocks[:, diagonal, diagonal] = 1 / self.variance[index]
        return blocks


class Covariance:
    r"""White noise plus a critically smooth stochastic oscillator, factorized by celerite2.

    The kernel is that of a stochastically driven, damped oscillator of quality
    :math:`1/\sqrt{2}`, :math:`k(\tau) = \sigma^2 e^{-w|\tau|} (\cos w\tau + \sin w|\tau|)` with
    :math:`w = \sqrt{2}\,\pi/\rho`. The ``amplitude`` is the variance :math:`\sigma^2`, the
    ``period`` the undamped :math:`\rho` in days; times in days ``(n,)`` increase, and ``variance``
    is that of the white noise. A LinAlgError is raised if the covariance is not positive definite
    to working precision.
    """

    def __init__(self, time, variance, amplitude, period):
        self.time, self.variance, self.amplitude = time, variance, amplitude
        self.rate, self._a = self._per_period / period, variance + amplitude
        self._u, self._v = self._generators(time)
        k = self._v.shape[1]
        self._c = np.full(k, self.rate)
        self._d, self._w, self._state = backprop.factor_fwd(
            time, self._c, self._a, self._u, self._v,
            np.empty_like(self._a), np.empty_like(self._v), np.empty((len(time), k, k)),
        )  # fmt: skip
        if not (np.isfinite(self._d).all() and (self._d > 0).all()):
            raise np.linalg.LinAlgError("the covariance is not positive definite")
        self.log_determinant = float(np.sum(np.log(self._d)))

    _per_period = np.sqrt(2) * np.pi

    def _generators(self, time):
        """Return the generators of the lower and the upper triangle, ``(n, 2)``."""
        phase = self.rate * time
        cos, sin = np.cos(phase), np.sin(phase)
        lower = self.amplitude * np.stack([cos + sin, sin - cos], axis=1)
        return lower, np.stack([cos, sin], axis=1)

    def whiten(self, columns):
        """Return ``Z`` with ``Z.T @ Z = columns.T @ inv(K) @ columns``."""
        z = np.array(columns, order="C")
        z = driver.solve_lower(self.time, self._c, self._u, self._w, z, z)
        z /= np.sqrt(self._d)[:, None]
        return z

    def solve(self, columns):
        """Return ``inv(K) @ columns``."""
        z = np.array(columns, order="C")
        z = driver.solve_lower(self.time, self._c, self._u, self._w, z, z)
        z /= self._d[:, None]
        return driver.solve_upper(self.time, self._c, self._u, self._w, z, z)

    def predict(self, residual, time):
        """Return the mean of the processes at other increasing times.

        The residual is ``inv(K) @ r`` of the data without their other components, ``(n,)``.
        """
        alpha, (u, v) = np.ascontiguousarray(residual[:, None]), self._generators(time)
        mean = np.zeros((len(time), 1))
        mean = driver.general_matmul_lower(time, self.time, self._c, u, self._v, alpha, mean)
        return driver.general_matmul_upper(time, self.time, self._c, v, self._u, alpha, mean)[:, 0]

    def gradient(self, columns, whitened, gram_bar):
        """Differentiate ``f(C.T @ inv(K) @ C) + log det(K) / 2``.

        With B = inv(K) C, a change dK of K changes the argument of f by -B^T dK B: no derivative
        has to be carried through the factorization's recursions for all columns.

        The columns are C, ``(n, r)``, whitened is what `whiten` makes of them, and ``gram_bar`` is
        the derivative of f by the elements of its argument, symmetric. Returned are the derivatives
        by the variance of the white noise, ``(n,)``, and by the logarithms of amplitude and period.
        """
        z = whitened / np.sqrt(self._d)[:, None]
        solved = driver.solve_upper(self.time, self._c, self._u, self._w, z, z)
        weighted = solved @ gram_bar
        by_noise = np.einsum("ij,ij->i", weighted, solved)
        variance_bar, amplitude_bar, period_bar = self._determinant_gradient
        # the process' part of K is K without the noise
        by_process = np.vdot(weighted, columns) - by_noise @ self.variance
        by_period = 2 * np.vdot(weighted, self._slope_below(solved))
        return variance_bar - by_noise, amplitude_bar - by_process, period_bar - by_period

    def _slope_below(self, columns):
        r"""Multiply the lower triangle of the kernel's derivative by log period with columns.

        The derivative is :math:`2 \sigma^2 w\tau e^{-w\tau} \sin w\tau`; the factor
        :math:`\tau` is a difference of times, so that four pairs of generators make it.
        """
        amplitude, rate, t = self.amplitude, self.rate, self.time
        cos, sin = self._v.T
        u = 2 * amplitude * rate * np.stack([t * sin, t * cos, sin, cos], axis=1)
        v = np.stack([cos, -sin, -t * cos, t * sin], axis=1)
        return driver.matmul_lower(t, np.full(4, rate), u, v, columns, np.zeros_like(columns))

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
        amplitude, (cos, sin) = self.amplitude, self._v.T
        amplitude_bar = amplitude * a_bar.sum() + np.sum(u_bar * self._u)
        # d/d(phase) of the generators; a longer period turns the phase back
        du = amplitude * np.stack([cos - sin, cos + sin], axis=1)
        dv = np.stack([-sin, cos], axis=1)
        turned = np.sum((u_bar * du + v_bar * dv) * (self.rate * self.time[:, None]))
        return a_bar, float(amplitude_bar), float(-turned - np.sum(c_bar * self._c))

    def inverse_diagonal(self):
        """Return the diagonal of ``inv(K)``: the derivative of log det K by that of K."""
        return 2 * self._determinant_bars[1]

    def inverse_blocks(self, starts, width):
        """Return the diagonal blocks of ``inv(K)``, shape ``(n_blocks, width, width)``.

        With K = L D L^T, a column of inv(L) is a recursion through a state of two numbers, so
        that all rows below a block enter through one 2 x 2 matrix, which is summed from the
        last row upwards.
        """
        u, d, decay = self._u, self._d, self._decay
        rows = np.zeros((len(starts), width, width))
        tails = np.zeros((len(starts), width, 2))
        for k in range(width):
            here = starts + k
            columns = -(tails @ u[here, :, None])[:, :, 0]
            columns[:, k] = 1.0
            rows[:, :, k] = columns / np.sqrt(d[here, None])
            tails = decay[here, None, None] * (tails + columns[:, :, None] * self._w[here, None])
        outside = tails @ self._below[starts + width] @ tails.transpose(0, 2, 1)
        return rows @ rows.transpose(0, 2, 1) + outside

    @cached_property
    def _decay(self):
        """Decay of the states from each row to the next."""
        return np.append(np.exp(-self._c[0] * np.diff(self.time)), 0.0)

    @cached_property
    def _below(self):
        """S_m = u_m u_m^T / d_m + T^T S_(m+1) T with T = decay (1 - w_m u_m^T), and 0 below."""
        s = np.zeros((len(self._d) + 1, 2, 2))
        s00 = s01 = s11 = 0.0
        arrays = self._u, self._w, self._d, self._decay**2, np.arange(len(self._d))
        rows = zip(*(array[::-1].tolist() for array in arrays), strict=True)
        for (u0, u1), (w0, w1), d, p, i in rows:
            a00, a01, a10, a11 = 1 - w0 * u0, -w0 * u1, -w1 * u0, 1 - w1 * u1
            x0, x1 = s00 * a00 + s01 * a10, s00 * a01 + s01 * a11
            y0, y1 = s01 * a00 + s11 * a10, s01 * a01 + s11 * a11
            s00, s01, s11 = (
                p * (a00 * x0 + a10 * y0) + u0 * u0 / d,
                p * (a00 * x1 + a10 * y1) + u0 * u1 / d,
                p * (a01 * x1 + a11 * y1) + u1 * u1 / d,
            )
            s[i] = ((s00, s01), (s01, s11))
        return s


class RandomWalk(Covariance):
    """White noise plus a random walk with a weak pull back: its kernel is an exponential.

    It falls by a factor e in a ``period``. Neither gradient nor blocks are those of this kernel.
    """

    _per_period = 1.0

    def _generators(self, time):
        ones = np.ones((len(time), 1))
        return self.amplitude * ones, ones
