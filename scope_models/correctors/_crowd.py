r"""The pixels of a star and its neighbors: one PRF, learned from all of them.

.. math:: F_p(t) = b_p \sum_k a_k P(p - x_t - d_k; w_t) + c_t, \quad P = P_0 + \sum_j \pi_j \phi_j

with a first guess :math:`P_0`, Gaussians :math:`\phi` whose sum is a Gaussian process, gains b of
the pixels, fluxes a and distances d of the stars, of which only the target varies, and position x,
relative width w and background c of each cadence. Gauss-Newton steps improve what all cadences
share, with the states of the cadences eliminated.
"""

from dataclasses import dataclass, replace

import numpy as np

from scope_models.models import PRF
from scope_models.pixelmodel._position import BLOCK
from scope_models.pixelmodel._smoothing import CLIP

__all__ = ["PLACE", "WIDTH", "Crowd", "CrowdPixels", "learn", "track"]

#: Prior: standard deviation of the PRF about the first guess, in units of that made so many times
#: as broad. Official PRFs of TESS (camera 2, CCD 3) differ from sums of Gaussians by three times as
#: much or less: 0.1 of the peak in the core, 0.03 at 2.5 px and 0.001 at 5 px.
_PRF, _BROAD = 0.03, 2.0
#: Prior: width and places (px) of the Gaussians. The process has sqrt(2) times this scale, for
#: those PRFs are correlated by 0.93 over 0.5 px and by 0.7 over 1 px.
_SIGMA, _CENTERS = 0.5**0.5, np.arange(-4, 4.5, 0.5)
#: Prior: standard deviations of gains, and of a neighbor's flux (relative) and a place (px) about
#: the first guess; and of relative widths.
_GAIN, _FLUX, PLACE, WIDTH = 0.015, 0.3, 0.3, 0.01
#: Tolerance: number of steps; a sixth one changes shares of the light by 1e-4.
_STEPS = 5


@dataclass(frozen=True)
class CrowdPixels:
    """Pixels and priors of cadences."""

    flux: np.ndarray  # (n, ny, nx)
    error: np.ndarray  # infinite where there are no data
    expected: np.ndarray  # flux, column, row, width and background, (n, 5)
    sigma: np.ndarray  # their standard deviations

    def __getitem__(self, which):
        return CrowdPixels(*(values[which] for values in vars(self).values()))


@dataclass(frozen=True)
class Crowd:
    """What all cadences share."""

    prf: PRF  # first guess
    change: np.ndarray  # coefficients of the Gaussians, rows and columns
    gains: np.ndarray  # (ny, nx)
    fluxes: np.ndarray  # of the neighbors, (k,)
    away: np.ndarray  # their distances from the target, columns and rows, (k, 2)

    @classmethod
    def first(cls, prf, shape, fluxes, away):
        """Return the first guess."""
        return cls(prf, np.zeros((len(_CENTERS),) * 2), np.ones(shape), fluxes, away)

    def images(self, x, y, width):
        """Return images of unit flux ``(n, ny, nx)`` and their derivatives by the arguments."""
        image, by = self.prf.unit_images(self.gains.shape, x, y, derivatives=True)
        (columns, by_column), (rows, by_row) = self.waves(x, y)
        along = self.change @ columns.transpose(0, 2, 1)
        image = image + rows @ along
        by_x = by["x_0"] - rows @ (self.change @ by_column.transpose(0, 2, 1))
        by_y = by["y_0"] - by_row @ along
        u, v = (np.arange(image.shape[axis]) - at[:, None] for axis, at in ((2, x), (1, y)))
        wider = u[:, None, :] * by_x + v[:, :, None] * by_y - 2 * image
        return image + width[:, None, None] * wider, (by_x, by_y, wider)

    def waves(self, x, y):
        """Return factors of the Gaussians along columns and rows ``(n, size, m)``, and slopes."""
        for size, center in zip(self.gains.shape[::-1], (x, y), strict=True):
            away = (np.arange(size) - center[:, None])[:, :, None] - _CENTERS
            values = np.exp(-0.5 * (away / _SIGMA) ** 2)
            yield values, -away / _SIGMA**2 * values

    def stars(self, states):
        """Yield flux with gains, column and row, image and derivatives of all stars."""
        flux, x, y, width, _ = states.T
        for one, (dx, dy) in zip([flux, *self.fluxes], [(0, 0), *self.away], strict=True):
            light = np.broadcast_to(one, x.shape)[:, None, None] * self.gains
            yield light, x + dx, y + dy, *self.images(x + dx, y + dy, width)

    def sum_and_center(self):
        """Return the PRF's sum over pixels, and its center of light relative to its place, px."""
        wide, at = replace(self, gains=np.ones((41, 41))), np.array([20.0])
        image = wide.images(at, at, np.zeros(1))[0][0]
        center = np.array([np.sum(image.sum(axis=axis) * np.arange(41)) for axis in (0, 1)])
        return image.sum(), center / image.sum() - 20

    def others(self, states):
        """Return the light of the neighbors, ``(n, ny, nx)``."""
        _, *neighbors = self.stars(states)
        return sum(light * image for light, _, _, image, _ in neighbors)

    @property
    def values(self):
        """All parameters but the gains, ``(m,)``."""
        return np.concatenate([self.change.ravel(), self.fluxes, self.away.ravel()])

    def with_values(self, values, gains):
        """Return the same with other parameters."""
        m, k = self.change.size, len(self.fluxes)
        change, fluxes, away = np.split(values, [m, m + k])
        shaped = change.reshape(self.change.shape), gains, fluxes, away.reshape(k, 2)
        return Crowd(self.prf, *shaped)

    def sizes(self):
        """Return prior standard deviations of the parameters but the gains."""
        x, y = np.meshgrid(_CENTERS / _BROAD, _CENTERS / _BROAD)
        size = _PRF * self.prf.unit_images((1, 1), -x.ravel(), -y.ravel()).ravel()
        size *= np.diff(_CENTERS)[0] / (_SIGMA * np.sqrt(np.pi))  # squares of many add up
        return np.concatenate([size, _FLUX * self.fluxes, np.full(self.away.size, PLACE)])


def _cadences(crowd, states, pixels):
    """Return what pixels show of the states of cadences.

    These are weights of the pixels, residuals of pixels and priors ``(n, n_pixels + 5)``, and an
    orthonormal basis of the states' effects on these with its factor; all of unit variance.
    """
    n, stars = len(states), list(crowd.stars(states))
    image = crowd.gains * stars[0][3]
    light = sum(flux * one for flux, _, _, one, _ in stars)
    slopes = sum(flux * np.array(by) for flux, _, _, _, by in stars)
    rest = pixels.flux - light - states[:, 4, None, None]
    # the model errs by a part of the light; what is far off counts little, as cosmic rays
    seen = light > CLIP * pixels.error
    part = ((1.4826 * rest[seen]) ** 2 - pixels.error[seen] ** 2) / light[seen] ** 2
    part = max(np.median(part), 0.0) if part.size else 0.0
    root = 1 / np.sqrt(pixels.error**2 + part * light**2 + (rest / CLIP) ** 2)
    effects = np.stack([image, *slopes, np.ones_like(image)], axis=-1) * root[..., None]
    priors = np.eye(5) / pixels.sigma[:, None]
    basis, factor = np.linalg.qr(np.concatenate([effects.reshape(n, -1, 5), priors], axis=1))
    away = (pixels.expected - states) / pixels.sigma
    return root, np.concatenate([(rest * root).reshape(n, -1), away], axis=1), basis, factor


def _moved(states, factor, seen):
    """Return states after a step."""
    step = np.linalg.solve(factor, seen[..., None])[..., 0]
    step[:, 1:3] = np.clip(step[:, 1:3], -PLACE, PLACE)
    return states + step


def learn(first, pixels):
    """Return a crowd that describes the pixels of some cadences."""
    crowd, states, m = first, pixels.expected, first.change.size
    sizes = np.append(first.sizes(), np.full(first.gains.size, _GAIN))
    whole = np.where(np.arange(len(sizes)) < m, sizes, 0.0)  # of the PRF, which stays
    for _ in range(_STEPS):
        root, rest, basis, factor = _cadences(crowd, states, pixels)
        n, p = len(states), crowd.gains.size
        root, (effects, light) = root.reshape(n, p), _effects(crowd, states)
        effects, light = effects * root[..., None], light * root
        # gains act on one pixel each
        own = basis[:, :p].transpose(0, 2, 1)
        inside = np.concatenate([own @ effects, own * light[:, None]], axis=2).reshape(5 * n, -1)
        seen = (basis.transpose(0, 2, 1) @ rest[..., None])[..., 0]
        flat, rest = effects.reshape(n * p, -1), rest[:, :p]
        cross = np.einsum("npm,np->mp", effects, light)
        gram = np.block([[flat.T @ flat, cross], [cross.T, np.diag(np.sum(light**2, axis=0))]])
        right = np.append(flat.T @ rest.ravel(), np.sum(light * rest, axis=0))
        away = np.append(crowd.values - first.values, crowd.gains.ravel() - 1)
        gram = (gram - inside.T @ inside) * sizes[:, None] * sizes + np.eye(len(sizes))
        right = sizes * (right - inside.T @ seen.ravel()) - away / sizes
        gram = np.block([[gram, whole[:, None]], [whole, 0.0]])
        step = sizes * np.linalg.solve(gram, np.append(right, 0.0))[:-1]
        states = _moved(states, factor, seen - (inside @ step).reshape(n, 5))
        gains = crowd.gains + step[-p:].reshape(crowd.gains.shape)
        crowd = crowd.with_values(crowd.values + step[:-p], gains)
    mean = np.average(gains.ravel(), weights=np.abs(light).mean(axis=0))
    return replace(crowd, gains=gains / mean, fluxes=mean * crowd.fluxes)


def _effects(crowd, states):
    """Return effects of the parameters on all pixels ``(n, n_pixels, m)``, and the light."""
    n, waves, total, fluxes, places = len(states), 0.0, 0.0, [], []
    for light, x, y, image, by in crowd.stars(states):
        (columns, _), (rows, _) = crowd.waves(x, y)
        one = rows[:, :, None, :, None] * columns[:, None, :, None, :]
        waves = waves + light[..., None, None] * one
        total = total + light * image
        fluxes.append(crowd.gains * image)
        places += [light * by[0], light * by[1]]
    others = np.stack([*fluxes[1:], *places[2:]], axis=-1)
    effects = np.concatenate([waves.reshape(*others.shape[:3], -1), others], axis=3)
    return effects.reshape(n, -1, effects.shape[3]), (total / crowd.gains).reshape(n, -1)


def track(crowd, pixels):
    """Return states of all cadences, and the light of the neighbors in all pixels."""
    states, light = pixels.expected.copy(), np.empty(pixels.flux.shape)
    for start in range(0, len(states), BLOCK):
        part = slice(start, start + BLOCK)
        for _ in range(_STEPS):
            _, rest, basis, factor = _cadences(crowd, states[part], pixels[part])
            seen = (basis.transpose(0, 2, 1) @ rest[..., None])[..., 0]
            states[part] = _moved(states[part], factor, seen)
        light[part] = crowd.others(states[part])
    return states, light
