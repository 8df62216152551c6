"""Images of columns with full pixels, drawn again without the charge that has bled."""

import numpy as np
from scipy.special import ndtr

__all__ = ["find_row_centers", "without_saturation"]

#: Prior: standard deviation in pixels of the Gaussian that stands for the star along a full column.
_DRAWN_WIDTH = 0.6
#: Branch: columns within so many pixels of the star constrain its row; so far reaches its tilt.
_REACH = 4
#: Branch: a column constrains the row if it holds this share of the light; with twice the share
#: fully.
_SMALLEST_SHARE = 5e-3
#: Branch: and no pixel is fuller than 1, with 0.8 fully.
_TAPER = 0.2
#: Prior: standard deviations: what a column's center of light does not follow the model by (pixel),
#: and the pixels' responses (relative).
_MISFIT, _RESPONSE = 1e-3, 0.05
#: Prior: standard deviation in pixels of the center of all light, where no column constrains the
#: row.
_FALLBACK = 0.5


def without_saturation(images, full, centers, aperture):
    """Return images in which full columns do not depend on the star's brightness.

    A full pixel stays full when the star dims: its share of the light follows the dimming, and
    must not be a regressor. Charge bleeds along the columns, so that a column's sum does not
    depend on it. The full columns, ``(nx,)``, are replaced by images of these alone: a Gaussian
    along the column about the row of their ``centers``, ``(n_cadences, nx)``, as bright as the
    column. The ``images``, ``(n_cadences, ny, nx)``, become zero outside of the ``aperture``.
    """
    images = np.where(aperture, images, 0.0)
    rows = np.arange(images.shape[1])
    low = (rows[:, None] - 0.5 - centers[:, None, full]) / _DRAWN_WIDTH
    profile = ndtr(low + 1 / _DRAWN_WIDTH) - ndtr(low)
    profile = np.where(aperture[:, full], np.maximum(profile, 1e-300), 0.0)
    profile /= profile.sum(axis=1, keepdims=True)
    images[:, :, full] = profile * images[:, :, full].sum(axis=1, keepdims=True)
    return images


def find_row_centers(images, aperture, use, saturation):
    r"""Return the row of the center of light of each column, ``(n_cadences, nx)``.

    They are those of a model of the columns without full pixels.

    The center of light of column c is

    .. math::

        m_c = y + h(c - x) + \sum_r \beta_{rc}\, q_{rc}\, (r - m_c),

    with the star's row y and column x (from the columns' sums), the tilt h of its image, a
    piecewise linear function, and the pixels' responses :math:`1 + \beta_{rc}`, which move the
    center in proportion to the pixel's share q of the column and its lever. One linear
    least-squares fit finds h and :math:`\beta` for all cadences: without them the row
    would jump when the star comes to other columns. The cadences in ``use`` determine it;
    ``saturation`` is the flux of a full pixel, in the unit of the ``images``.
    """
    images = np.where(aperture, images, 0.0)
    rows, columns = np.arange(images.shape[1]), np.arange(images.shape[2])
    sums = images.sum(axis=1)
    total = sums.sum(axis=1)
    distance = columns - (sums @ columns / total)[:, None]
    safe = np.where(sums > 0, sums, np.inf)
    share = images / safe[:, None, :]
    center = np.einsum("ijk,j->ik", share, rows)
    lever = rows[:, None] - center[:, None, :]
    weight = np.clip(sums / total[:, None] / _SMALLEST_SHARE - 1, 0, 1)
    weight *= np.clip((1 - images.max(axis=1) / saturation) / _TAPER, 0, 1)
    weight *= (np.abs(distance) < _REACH) / _MISFIT**2
    knots = np.arange(-_REACH, _REACH + 1)  # of piecewise linear functions of the distance
    tilt = np.clip(1 - np.abs(distance[..., None] - knots), 0, None)
    fallback = _FALLBACK**-2
    weights = weight.sum(axis=1) + fallback
    mean = np.sum(weight * center, axis=1) + fallback * (images.sum(axis=2) @ rows / total)
    mean /= weights
    row, column = np.nonzero(aperture & (weight[use] > 0).any(axis=0))
    pull = (share * lever)[:, row, column] * weight[:, column]
    summed = np.concatenate([np.einsum("ij,ijk->ik", weight, tilt), pull], axis=1)
    averaged = summed / weights[:, None]
    normal, right = _normal_equations(*(a[use] for a in (tilt, pull, center, weight)), column)
    normal -= summed[use].T @ averaged[use]
    right -= summed[use].T @ mean[use]
    prior = np.append(np.ones(tilt.shape[-1]), np.full(len(row), _RESPONSE**-2))
    normal.flat[:: len(prior) + 1] += prior
    coefficients = np.linalg.solve(normal, right)
    star = mean - averaged @ coefficients
    return star[:, None] + tilt @ coefficients[: tilt.shape[-1]]


def _normal_equations(tilt, pull, center, weight, column):
    """Return the normal equations of tilt and responses at given rows of the star."""
    k = tilt.shape[-1]
    normal = np.zeros((k + len(column), k + len(column)))
    normal[:k, :k] = np.einsum("ij,ija,ijb->ab", weight, tilt, tilt, optimize=True)
    right = np.einsum("ij,ijk->k", weight * center, tilt, optimize=True)
    right = np.append(right, np.einsum("ij,ij->j", pull, center[:, column]))
    for c in np.unique(column):  # a pixel moves the center of its own column alone
        here = np.flatnonzero(column == c)
        seen = weight[:, c] > 0
        part = pull[np.ix_(seen, here)]
        normal[np.ix_(k + here, k + here)] = part.T @ (part / weight[seen, c, None])
        normal[k + here, :k] = part.T @ tilt[seen, c]
        normal[:k, k + here] = normal[k + here, :k].T
    return normal, right
