"""Hyper-parameters by the closed-form leave-one-out score."""

from dataclasses import replace

import numpy as np
from scipy.optimize import minimize

from scope_models.correctors._regression import Posterior

__all__ = ["fit_leave_one_out", "leave_one_out"]


def leave_one_out(data, hyper, *, gradient=False):
    r"""
    Logarithm of the predictive density of each datum given all others, summed.

    With the inverse :math:`Q` of the covariance of everything and
    :math:`\alpha = Q y`, the datum i is predicted with the error
    :math:`\alpha_i / Q_{ii}` and the variance :math:`1 / Q_{ii}`.

    Parameters
    ----------
    data : Data
        The problem.
    hyper : Hyperparameters
        Where to evaluate it.
    gradient : bool, optional
        Whether to return the derivatives by the logarithms of a factor of noise and
        long-term process alike, and of the groups' variances.
    """
    process = hyper.process(data.time, data.variance)
    solved, diagonal = process.solve(data.stacked), process.inverse_diagonal()
    return _score(data, solved, diagonal, hyper, gradient=gradient)


def _score(data, solved, diagonal, hyper, *, gradient, scale=1.0):
    prior = hyper.prior(data)
    gram = data.stacked.T @ solved / scale
    posterior = Posterior(gram, prior)
    solved = solved / scale
    alpha = solved[:, -1] - solved[:, :-1] @ posterior.mean
    through = solved[:, :-1] @ posterior.covariance
    q = diagonal / scale - np.einsum("ij,ij->i", through, solved[:, :-1])
    value = 0.5 * np.sum(np.log(q) - alpha**2 / q - np.log(2 * np.pi))
    if not gradient:
        return value
    # columns times the inverse of everything
    qx = solved[:, :-1] - through @ gram[:-1, :-1]
    xa = posterior.mean / prior
    slopes = np.empty(data.n_groups + 1)
    z_alpha, zq = alpha.copy(), q.copy()
    members = [np.flatnonzero(data.groups == g) for g in range(data.n_groups)]
    members.append(np.arange(len(data.groups), len(prior)))
    for g, columns in enumerate(members):
        part = qx[:, columns] * np.sqrt(prior[columns])
        g_alpha = part @ (np.sqrt(prior[columns]) * xa[columns])
        gq = np.einsum("ij,ij->i", part, part)
        if g < data.n_groups:
            slopes[g + 1] = _slope(alpha, q, g_alpha, gq)
        z_alpha -= g_alpha
        zq -= gq
    slopes[0] = _slope(alpha, q, z_alpha, zq)
    return value, slopes


def _slope(alpha, q, z_alpha, zq):
    """Derivative of the score when alpha changes by -z_alpha and q by -zq."""
    return float(np.sum((alpha * z_alpha - 0.5 * (1 + alpha**2 / q) * zq) / q))


def fit_leave_one_out(data, hyper):
    """Maximise the leave-one-out score over the columns' variances and the noise."""
    process = hyper.process(data.time, data.variance)
    solved = process.solve(data.stacked)
    diagonal = process.inverse_diagonal()

    def objective(theta):
        trial = replace(hyper, variances=np.exp(theta[1:]))
        value, slope = _score(data, solved, diagonal, trial, gradient=True, scale=np.exp(theta[0]))
        return -value, -slope

    start = np.concatenate([[0.0], np.log(hyper.variances)])
    bounds = [(-3.0, 3.0), *((s - 12, s + 12) for s in start[1:])]
    result = minimize(
        objective,
        start,
        jac=True,
        method="L-BFGS-B",
        bounds=bounds,
        options={"maxiter": 40, "ftol": 1e-8},
    )
    factor = float(np.exp(result.x[0]))
    return replace(
        hyper,
        noise_scale=hyper.noise_scale * factor,
        amplitude=None if hyper.amplitude is None else hyper.amplitude * factor,
        variances=np.exp(result.x[1:]),
    )
