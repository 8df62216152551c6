"""Regressors of pixel level decorrelation: products of pixel fractions."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

__all__ = ["Regressors", "centre", "power_columns", "principal_columns", "shared_columns"]

#: Largest number of cadences of which the pivots of a factor are chosen.
_CANDIDATES = 4000


@dataclass(frozen=True)
class Regressors:
    """Columns that share a prior variance within each named group.

    Parameters
    ----------
    columns : ndarray
        Regressors, ``(n_cadences, n_columns)``.
    groups : ndarray of int
        Group of each column, an index into ``names``.
    names : tuple of str
        Names of the groups.
    """

    columns: np.ndarray
    groups: np.ndarray
    names: tuple

    @classmethod
    def join(cls, parts):
        """Join a mapping from names to columns, without the empty ones."""
        first = next(iter(parts.values()))
        parts = {name: columns for name, columns in parts.items() if columns.shape[1]}
        if not parts:
            return cls(np.empty((len(first), 0)), np.empty(0, dtype=int), ())
        sizes = [columns.shape[1] for columns in parts.values()]
        return cls(
            np.concatenate(list(parts.values()), axis=1),
            np.repeat(np.arange(len(sizes)), sizes),
            tuple(parts),
        )


def centre(columns, use):
    """Subtract from each column its mean over the cadences in use."""
    return columns - columns[use].mean(axis=0)


def principal_columns(columns, use, tolerance):
    """
    Rotate columns to their principal components, and drop those that are too small to matter.

    The rotation is orthogonal: a common prior variance means the same before and after.

    Parameters
    ----------
    columns : ndarray
        Centred columns ``(n, m)``.
    use : ndarray of bool
        Cadences that define the components.
    tolerance : float
        Components whose mean square is below this are dropped.
    """
    values, vectors = np.linalg.eigh(columns[use].T @ columns[use] / use.sum())
    keep = values > max(tolerance, 1e-14 * values[-1])
    return columns @ vectors[:, keep][:, ::-1]


def power_columns(fractions, order, use, tolerance, max_rank):
    r"""
    All products of ``order`` fractions, as few columns.

    The products, each weighted with the square root of its number of
    orderings, span the kernel :math:`(p_i \cdot p_j)^n`. A pivoted Cholesky
    factor of that kernel gives the same regression without forming them.

    Parameters
    ----------
    fractions : ndarray
        Pixel fractions, ``(n_cadences, n_pixels)``.
    order : int
        Number of factors.
    use : ndarray of bool
        Cadences that may become pivots; of very many, evenly spaced ones.
    tolerance : float
        The factor ends when the mean of what is left of the kernel's
        diagonal, over the cadences in use, is below this.
    max_rank : int
        Largest number of columns.

    Returns
    -------
    columns : ndarray
        ``(n_cadences, rank)``.
    rest : float
        Mean of what is left of the diagonal, over the cadences that could be pivots.
    """
    few = np.flatnonzero(use)
    few = few[:: -(-len(few) // _CANDIDATES)]
    pivots, factor, rest = _pivoted_cholesky(fractions[few], order, tolerance, max_rank)
    kernel = (fractions[few[pivots]] @ fractions.T) ** order
    columns = solve_triangular(factor, kernel, lower=True, overwrite_b=True, check_finite=False)
    return columns.T, rest


def _pivoted_cholesky(points, order, tolerance, max_rank):
    """Return the pivots, the triangular factor of their kernel, and the mean of what is left."""
    rest = np.einsum("ij,ij->i", points, points) ** order
    factor = np.zeros((min(max_rank, len(points)), len(points)))
    pivots = []
    for k in range(len(factor)):
        pivot = int(np.argmax(rest))
        if rest.mean() < tolerance or rest[pivot] <= 0:
            break
        column = (points @ points[pivot]) ** order - factor[:k, pivot] @ factor[:k]
        factor[k] = column / np.sqrt(rest[pivot])
        rest = np.maximum(rest - factor[k] ** 2, 0.0)
        pivots.append(pivot)
    return pivots, factor[: len(pivots), pivots].T, float(rest.mean())


def shared_columns(images, order, reach):
    r"""
    Products of neighbouring fractions, summed over all pixels.

    When all pixels have the same intra-pixel response, products of order n
    with the same offsets have the same coefficients: only their sums over
    the pixels count. For order 2 these are :math:`\sum_l p_l p_{l+d}` for
    all offsets :math:`d` up to ``reach``, for order n
    :math:`\sum_l p_l^{n-1} p_{l+d}`.

    Parameters
    ----------
    images : ndarray
        Images of the fractions ``(n_cadences, ny, nx)``, zero outside of the
        aperture.
    order : int
        Number of factors, at least 2.
    reach : int
        Largest offset in pixels along either axis.
    """
    powers = images ** (order - 1)
    padded = np.pad(images, ((0, 0), (reach, reach), (reach, reach)))
    ny, nx = images.shape[1:]
    columns = []
    for dy in range(-reach, reach + 1):
        for dx in range(-reach, reach + 1):
            if order == 2 and (dy, dx) < (0, 0):
                continue
            shifted = padded[:, reach + dy : reach + dy + ny, reach + dx : reach + dx + nx]
            columns.append(np.einsum("ijk,ijk->i", powers, shifted))
    return np.stack(columns, axis=1)
