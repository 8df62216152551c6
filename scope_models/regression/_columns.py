"""Regressors from pixel fractions: their products, as few columns."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import helmert, solve_triangular

from scope_models.pixelmodel._smooth import pivoted_cholesky

__all__ = [
    "Regressors", "contrast_columns", "fraction_columns", "least_square", "power_columns",
    "principal_columns", "shared_columns",
]  # fmt: skip

#: Tolerance: columns are dropped when coefficients of one could not change chi-squared by this, or
#: those of 30, which real stars have, by about one; and their largest number.
_TOLERANCE, _MAX_RANK = 1e-3, 300
#: Prior: products with pixels so far apart have common coefficients (px).
_REACH = 2
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
        sizes = np.array([columns.shape[1] for columns in parts.values()])
        names = tuple(name for name, size in zip(parts, sizes, strict=True) if size)
        groups = np.repeat(np.arange(len(names)), sizes[sizes > 0])
        return cls(np.concatenate(list(parts.values()), axis=1), groups, names)


def least_square(variance):
    """Return the least mean square of a column for a flux with such relative variances."""
    return _TOLERANCE * float(np.median(variance)) / len(variance)


def fraction_columns(images, mask, use, least, *, order=2, most=None, predicted=True):
    """Return products of pixel fractions up to an ``order``, ``most`` columns per group, by name.

    The ``images`` ``(n, ny, nx)``, zero outside of the mask, are `principal_columns` with at
    ``least`` a mean square. In ``predicted`` ones those that pixels have in common are no group of
    their own.
    """
    fractions = images[:, mask]
    products = {"order 1": fractions}
    for n in range(2, order + 1):
        products[f"order {n}"] = power_columns(fractions, n, use, least, _MAX_RANK)
        if n == 2:
            products["shared"] = shared_columns(images, _REACH)
    if predicted and "shared" in products:  # responses within pixels have much in common
        both = products["order 2"], products.pop("shared")
        products["order 2"] = np.concatenate(both, axis=1)
    return {name: principal_columns(p, use, least)[:, :most] for name, p in products.items()}


def principal_columns(columns, use, tolerance):
    """Rotate columns to principal components, and drop those that are too small to matter.

    The rotation is orthogonal: a common prior variance means the same before and after. The
    cadences in ``use`` define means and components; those whose mean square is below ``tolerance``
    go. A gap is filled with the mean.
    """
    known = np.isfinite(columns).all(axis=1)
    use = use & known
    if not use.any():
        return np.empty((len(columns), 0))
    columns = np.where(known[:, None], columns - columns[use].mean(axis=0), 0.0)
    values, vectors = np.linalg.eigh(columns[use].T @ columns[use] / use.sum())
    keep = values > max(tolerance, 1e-14 * values[-1])
    return columns @ vectors[:, keep][:, ::-1]


def power_columns(fractions, order, use, tolerance, max_rank):
    r"""Return all products of ``order`` fractions ``(n_cadences, n_pixels)``, as few columns.

    The products, each weighted with the square root of its number of orderings, span the kernel
    :math:`(p_i \cdot p_j)^n`. A pivoted Cholesky factor of that kernel gives the same regression
    without forming them. Cadences in ``use`` may become pivots. The factor ends at ``max_rank``
    columns, or when the mean of what is left of the kernel's diagonal is below ``tolerance``.
    """
    points = fractions[use]
    points = points[:: -(-len(points) // _CANDIDATES)]
    diagonal = np.einsum("ij,ij->i", points, points) ** order
    precision = len(points) * np.finfo(float).eps * diagonal.max()

    def ends(rest):
        return rest.mean() < tolerance or rest.max() <= precision

    def column(k):
        return (points @ points[k]) ** order

    pivots, rows = pivoted_cholesky(diagonal, column, ends, min(max_rank, len(points)))
    kernel = (points[pivots] @ fractions.T) ** order
    factor = rows[:, pivots].T
    return solve_triangular(factor, kernel, lower=True, overwrite_b=True, check_finite=False).T


def shared_columns(images, reach):
    r"""Return products of two fractions, summed over all pixels.

    When all pixels have the same intra-pixel response, products with the same offset have the same
    coefficient: only the sums :math:`\sum_l p_l p_{l+d}` count, for all offsets :math:`d` up to
    ``reach`` pixels along either axis. The ``images`` are zero outside of the aperture.
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

    Of k segments, k - 1 orthonormal contrasts remain.
    """
    segment = np.searchsorted(np.asarray(breaks), time, side="right")
    present = np.unique(segment[use])
    member = (segment[:, None] == present).astype(float)
    contrasts = member @ helmert(len(present)).T
    return (contrasts[:, :, None] * columns[:, None, :]).reshape(len(columns), -1)
