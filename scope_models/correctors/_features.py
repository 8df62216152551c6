"""Regressors of pixel level decorrelation: products of pixel fractions, and their segments."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import helmert, solve_triangular

__all__ = [
    "Regressors",
    "center",
    "contrast_columns",
    "power_columns",
    "principal_columns",
    "shared_columns",
]

#: Tolerance: largest number of cadences of which the pivots of a factor are chosen.
_CANDIDATES = 4000


@dataclass(frozen=True)
class Regressors:
    """Columns that share a prior variance within each named group."""

    columns: np.ndarray  # (n_cadences, n_columns)
    groups: np.ndarray  # group of each column, an index into ``names``
    names: tuple

    @classmethod
    def join(cls, parts):
        """Join groups, from names to columns ``(n_cadences, m)``, without the empty ones."""
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


def center(columns, use):
    """Subtract from each column its mean over the cadences in use."""
    return columns - columns[use].mean(axis=0)


def principal_columns(columns, use, tolerance):
    """Rotate centered columns to principal components, and drop those that are too small to matter.

    The rotation is orthogonal: a common prior variance means the same before and after. The
    cadences in ``use`` define the components; those whose mean square is below ``tolerance`` go.
    """
    values, vectors = np.linalg.eigh(columns[use].T @ columns[use] / use.sum())
    keep = values > max(tolerance, 1e-14 * values[-1])
    return columns @ vectors[:, keep][:, ::-1]


def power_columns(fractions, order, use, tolerance, max_rank):
    r"""Return all products of ``order`` fractions ``(n_cadences, n_pixels)``, as few columns.

    The products, each weighted with the square root of its number of orderings, span the kernel
    :math:`(p_i \cdot p_j)^n`. A pivoted Cholesky factor of that kernel gives the same regression
    without forming them. Cadences in ``use`` may become pivots; of very many, evenly spaced ones.
    The factor ends at ``max_rank`` columns, or when the mean of what is left of the kernel's
    diagonal over these cadences, which comes second, is below ``tolerance``.
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
    pivots, precision = [], len(points) * np.finfo(float).eps * rest.max(initial=0.0)
    for k in range(len(factor)):
        pivot = int(np.argmax(rest))
        if rest.mean() < tolerance or rest[pivot] <= precision:
            break
        column = (points @ points[pivot]) ** order - factor[:k, pivot] @ factor[:k]
        factor[k] = column / np.sqrt(rest[pivot])
        rest = np.maximum(rest - factor[k] ** 2, 0.0)
        pivots.append(pivot)
    return pivots, factor[: len(pivots), pivots].T, float(rest.mean())


def shared_columns(images, reach):
    r"""Return products of two fractions, summed over all pixels.

    When all pixels have the same intra-pixel response, products with the same offset have the same
    coefficient: only the sums :math:`\sum_l p_l p_{l+d}` count, for all offsets :math:`d` up to
    ``reach`` pixels along either axis. The ``images`` of the fractions, ``(n_cadences, ny, nx)``,
    are zero outside of the aperture.
    """
    ny, nx = images.shape[1:]
    padded = np.pad(images, ((0, 0), (0, reach), (reach, reach)))
    columns = []
    for dy in range(reach + 1):
        for dx in range(-reach if dy else 0, reach + 1):
            shifted = padded[:, dy : dy + ny, reach + dx : reach + dx + nx]
            columns.append(np.einsum("ijk,ijk->i", images, shifted))
    return np.stack(columns, axis=1)


def contrast_columns(columns, time, breaks, use):
    """Return copies of the columns that differ between the segments and are the same in none.

    A common part of the coefficients is left to the columns themselves: of k segments, k - 1
    orthonormal contrasts remain.
    """
    segment = np.searchsorted(np.asarray(breaks), time, side="right")
    present = np.unique(segment[use])
    member = (segment[:, None] == present).astype(float)
    contrasts = member @ helmert(len(present)).T
    return (contrasts[:, :, None] * columns[:, None, :]).reshape(len(columns), -1)
