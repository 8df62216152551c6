"""Images of messy stars: a rendering that neither simulator nor correctors nor fits use.

The PSF is a Fourier series on a periodic field, the response of each pixel an oversampled map.
The light of a pixel is the sum over the modes of the PSF's coefficient, the phase of the star's
position, and the transform of the pixel's map. Positions enter exactly, without interpolation.
"""

from dataclasses import dataclass

import numpy as np

__all__ = ["PixelResponse", "bleed", "make_psf", "make_response", "render"]

_MARGIN = 4  # pixels around the stamp until the field repeats
_OVERSAMPLING = 12
_HIGHEST = 2.5  # cycles per pixel: the narrowest component has exp(-25) of its light there
_CHUNK = 300


@dataclass(frozen=True)
class PixelResponse:
    """The transforms of all pixels' response maps."""

    shape: tuple  # of the stamp
    transforms: np.ndarray  # complex, (modes, pixels); no negative modes of columns
    size: int  # pixels of the periodic field


def _modes(size):
    """Return angular frequencies of rows and of columns, radians per pixel."""
    highest, unit = int(_HIGHEST * size), 2 * np.pi / size
    return unit * np.arange(-highest, highest + 1), unit * np.arange(highest + 1)


def make_psf(rng, width):
    """Return a density of Gaussians off the center, a Moffat wing and spikes, not normalized."""
    cores = [
        (part, *rng.normal(0, 0.25 * width, 2), width * rng.uniform(0.85, 1.5), rng.uniform(0.8, 1))
        for part in (0.5, 0.3, 0.2)
    ]
    wing = rng.uniform(0.12, 0.25), width * rng.uniform(1.3, 1.8), rng.uniform(2.2, 3.0)
    angle, spikes = rng.uniform(0, np.pi), rng.uniform(0.01, 0.03)

    def density(x, y):
        value = 0.0
        for part, x_0, y_0, sigma, ratio in cores:
            square = ((x - x_0) / sigma) ** 2 + ((y - y_0) / (ratio * sigma)) ** 2
            value = value + part * np.exp(-square / 2) / (2 * np.pi * ratio * sigma**2)
        part, alpha, beta = wing
        moffat = (beta - 1) / (np.pi * alpha**2) * (1 + (x**2 + y**2) / alpha**2) ** -beta
        value = value + part * moffat
        for turn in (angle, angle + np.pi / 2):
            along = x * np.cos(turn) + y * np.sin(turn)
            across = y * np.cos(turn) - x * np.sin(turn)
            square = (along / (4 * width)) ** 2 + (across / (0.9 * width)) ** 2
            value = value + spikes * np.exp(-square / 2) / (2 * np.pi * 3.6 * width**2)
        return value

    return density


def make_response(rng, shape, *, drop, scatter):
    """Return the `PixelResponse` of pixels with a mean `drop` to their edges and a `scatter`."""
    ny, nx = shape
    u = (np.arange(_OVERSAMPLING) + 0.5) / _OVERSAMPLING - 0.5
    n = ny * nx
    drops = drop * rng.normal(1, 0.2, (2, n, 1))
    maps = (1 - drops[0] * 4 * u**2)[:, :, None] * (1 - drops[1] * 4 * u**2)[:, None, :]
    waves = np.cos(np.pi * np.arange(4)[:, None] * (u + 0.5))
    order = np.add.outer(np.arange(4), np.arange(4))
    sizes = np.where(order > 0, 0.3 * drop / np.maximum(order, 1), 0)
    maps += np.einsum("pab,ai,bj->pij", rng.normal(0, 1, (n, 4, 4)) * sizes, waves, waves)
    maps *= rng.normal(1, scatter, n)[:, None, None]
    size = max(shape) + 2 * _MARGIN
    rows, columns = _modes(size)
    # The maps are constant within each of their cells, whose transform is a sinc.
    cell = 2 * np.pi * _OVERSAMPLING
    phase_y = np.exp(1j * np.outer(rows, u)) * np.sinc(rows / cell)[:, None]
    phase_x = np.exp(1j * np.outer(columns, u)) * np.sinc(columns / cell)[:, None]
    local = np.einsum("ki,pij,lj->pkl", phase_y, maps, phase_x, optimize=True) / len(u) ** 2
    place_y = np.exp(1j * np.outer(np.arange(ny), rows)).repeat(nx, axis=0)
    place_x = np.tile(np.exp(1j * np.outer(np.arange(nx), columns)), (ny, 1))
    local *= place_y[:, :, None] * place_x[:, None, :]
    return PixelResponse(shape, local.reshape(n, -1).T.copy(), size)


def render(response, psf, x, y, width):
    """Return the light ``(n, ny, nx)`` of a star of flux 1 at positions and widths by cadence."""
    # The series is a polynomial of the width through Chebyshev nodes.
    middle, half = (width.max() + width.min()) / 2, max(np.ptp(width) / 2, 1e-6)
    nodes = np.polynomial.chebyshev.chebpts1(3 + int(np.ceil(25 * half)))
    series = np.array([_series(response, psf, middle + half * node) for node in nodes])
    degree = len(nodes) - 1
    values = np.polynomial.chebyshev.chebvander((width - middle) / half, degree)
    shares = values @ np.linalg.inv(np.polynomial.chebyshev.chebvander(nodes, degree))
    rows, columns = _modes(response.size)
    images = np.empty((len(x), response.transforms.shape[1]))
    for first in range(0, len(x), _CHUNK):
        part = slice(first, first + _CHUNK)
        light = np.tensordot(shares[part], series, 1)
        light *= np.exp(-1j * np.outer(y[part], rows))[:, :, None]
        light *= np.exp(-1j * np.outer(x[part], columns))[:, None, :]
        light = light.reshape(len(light), -1)
        images[part] = light.real @ response.transforms.real
        images[part] -= light.imag @ response.transforms.imag
    return images.reshape(len(x), *response.shape)


def _series(response, psf, width):
    """Return Fourier coefficients of a PSF whose light on the field is 1."""
    samples = np.arange(response.size * _OVERSAMPLING) / _OVERSAMPLING
    place = (samples + response.size / 2) % response.size - response.size / 2
    x, y = np.meshgrid(place / width, place / width)
    values = psf(x, y)
    values /= values.sum()
    rows, columns = _modes(response.size)
    left = np.exp(-1j * np.outer(rows, samples))
    right = np.exp(-1j * np.outer(columns, samples))
    coefficients = left @ values @ right.T
    coefficients[:, 1:] *= 2  # for those of negative columns, which are their conjugates
    return coefficients / response.size**2


def bleed(electrons, well):
    """Return images whose pixels above the well have spilled along columns, half each way."""
    images = electrons.copy()
    full = (images > well).any(axis=(0, 1))
    columns = images[:, :, full]
    for _ in range(60 * images.shape[1]):
        excess = np.maximum(columns - well, 0)
        if not np.any(excess > 1e-6 * well):
            break
        columns -= excess
        columns[:, 1:] += excess[:, :-1] / 2
        columns[:, :-1] += excess[:, 1:] / 2
    images[:, :, full] = columns
    return images
