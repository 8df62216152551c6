"""Motions, variability and images of messy stars, without what simulator, correctors and fits use.

In the images the PSF is a Fourier series on a periodic field, the response of each pixel an
oversampled map. The light of a pixel is the sum over the modes of the PSF's coefficient, the phase
of the star's position, and the transform of the pixel's map. Positions enter exactly, without
interpolation.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np

from scope_models.effects._noise import red_noise

__all__ = [
    "LIGHTS", "MOTIONS", "PixelResponse", "bleed", "make_psf", "make_response", "make_transit",
    "render",
]  # fmt: skip

_MARGIN = 4  # pixels around the stamp until the field repeats
_OVERSAMPLING = 12
_HIGHEST = 2.5  # cycles per pixel: the narrowest component has exp(-25) of its light there
_CHUNK = 300


def _roll(rng, time):
    """Sawtooth of 6 h along a short arc, whose sense reverses, and a slow drift."""
    span = time[-1]
    reversal = rng.uniform(0.25, 0.75) * span
    rate = 1.5 * rng.uniform(0.6, 1.3) * np.sin(np.pi * (reversal - time) / 35)
    period = 0.2452
    roll, firing = np.empty(len(time)), np.zeros(len(time), bool)
    angle, last, speed = rng.normal(0, 0.1), 0, 1.0
    for i, now in enumerate(time):
        step = now - time[i - 1] if i else 0.0
        angle += rate[i] * speed * step
        if int(now / period) > last:
            last = int(now / period)
            if abs(angle) > 0.1:
                angle, speed = rng.normal(0, 0.06), rng.normal(1, 0.15)
                firing[i] = True
        roll[i] = angle
    direction = rng.uniform(0, 2 * np.pi)
    along = roll + 0.003 * red_noise(rng, time, 0.06)
    drift = rng.normal(0, 0.05, 2) * (time / span - 0.5)[:, None]
    across = 0.03 * roll**2 + 0.002 * rng.normal(size=len(time))
    c, s = np.cos(direction), np.sin(direction)
    return c * along - s * across + drift[:, 0], s * along + c * across + drift[:, 1], firing


def _drift(rng, time):
    """Velocity aberration, the wheels' temperature every 3 d, and jitter."""
    phase = time / time[-1] - 0.5
    offsets = []
    for _ in range(2):
        slope, bend = rng.normal(0, 0.25), rng.normal(0, 0.1)
        heater = rng.uniform(0.001, 0.004) * np.sin(2 * np.pi * time / 3 + rng.uniform(0, 6))
        offsets.append(slope * phase + bend * phase**2 + heater + rng.normal(0, 4e-4, len(time)))
    return *offsets, np.zeros(len(time), bool)


def _orbits(rng, time):
    """Jitter, a drift within each orbit of 13.7 d, and momentum dumps."""
    dumps = 2.5 + 0.2 * rng.uniform()
    number = (time / dumps).astype(int)
    firing = np.diff(number, prepend=0) > 0
    offsets = []
    for _ in range(2):
        jumps = rng.normal(0, 0.01, number[-1] + 1)[number]
        orbit = rng.normal(0, 0.04) * ((time % 13.7) / 13.7 - 0.5) ** 2 * 4
        jitter = 0.006 * red_noise(rng, time, 0.08) + 0.004 * rng.normal(size=len(time))
        offsets.append(jumps + orbit + jitter)
    return *offsets, firing


def _walk(rng, time):
    """Random steps with a weak pull to the middle."""
    return *(0.3 * red_noise(rng, time, 4.0) for _ in range(2)), np.zeros(len(time), bool)


def _wheels(rng, time):
    """Wheels that fail: a drift that grows, slow oscillations and jumps."""
    phase = time / time[-1]
    offsets = []
    jumps = np.sort(rng.uniform(0, time[-1], 8))
    firing = np.zeros(len(time), bool)
    firing[np.minimum(np.searchsorted(time, jumps), len(time) - 1)] = True
    for _ in range(2):
        level = np.concatenate([[0], rng.normal(0, 0.25, 8)])[np.searchsorted(jumps, time)]
        swing = 0.3 * phase**2 * np.sin(2 * np.pi * time / rng.uniform(0.7, 2) + rng.uniform(0, 6))
        drift = rng.normal(0, 0.4) * phase**2
        offsets.append(level * phase + swing + drift + 0.01 * red_noise(rng, time, 0.1))
    return *offsets, firing


def _jitter(rng, time, size=0.0035, slow=0.0035):
    """White noise and noise over hours, pixels."""
    white = rng.normal(0, size, (2, len(time)))
    return *(one + slow * red_noise(rng, time, 0.1) for one in white), np.zeros(len(time), bool)


#: Offsets in pixels along x and y, and the cadences in which thrusters fire, by the kind of motion.
#: Times are in days from the beginning.
MOTIONS = {
    "k2": _roll, "kepler": _drift, "tess": _orbits, "walk": _walk, "wheels": _wheels,
    "rest": partial(_jitter, size=1e-4, slow=0.0), "jitter": _jitter,
}  # fmt: skip


def _wave(rng, time, period):
    return np.sin(2 * np.pi * time / period + rng.uniform(0, 2 * np.pi))


def _spots(rng, time, period, amplitude):
    """Two groups of spots whose sizes evolve over several rotations."""
    values = np.zeros(len(time))
    for harmonic, part in ((1, 1.0), (2, 0.5)):
        angle = 2 * np.pi * harmonic * time / period + rng.uniform(0, 2 * np.pi)
        size = 1 + 0.4 * _smooth(rng, time, 2 * period)
        values += part * size * np.sin(angle + 0.4 * _smooth(rng, time, 3 * period))
    return 1 + amplitude * values


def _smooth(rng, time, scale):
    """Return a smooth process of about unit variance."""
    nodes = np.arange(-4 * scale, time[-1] + 5 * scale, scale)
    kernel = np.exp(-0.5 * ((time[:, None] - nodes) / scale) ** 2)
    return kernel @ rng.normal(size=len(nodes)) / np.sqrt((kernel**2).sum(axis=1))


def _rr_lyrae(rng, time, period, amplitude):
    """A steep rise and a slow decline."""
    phase = 2 * np.pi * (time / period + rng.uniform())
    harmonics = np.arange(1, 8)
    shape = (np.sin(np.outer(phase, harmonics)) / harmonics * 0.85**harmonics).sum(axis=1)
    return 1 + amplitude * shape / np.ptp(shape) * 2


def _delta_scuti(rng, time, period, amplitude):
    values = np.zeros(len(time))
    for part in (1.0, 0.6, 0.4, 0.2):
        values += part * _wave(rng, time, period * rng.uniform(0.7, 1.4))
    return 1 + amplitude * values / 2.2


def _eclipsing(rng, time, period, amplitude):
    """Two eclipses of soft shape, and ellipsoidal variations."""
    phase = (time / period + rng.uniform()) % 1
    half = 0.035 * rng.uniform(0.8, 1.5)
    primary = _dip((phase + 0.5) % 1 - 0.5, half)
    secondary = _dip(phase - 0.5, half)
    ellipsoidal = 0.01 * np.cos(4 * np.pi * phase)
    return (1 - amplitude * primary - 0.4 * amplitude * secondary) * (1 - ellipsoidal)


def _dip(x, half):
    """Return a dip of depth 1 with soft shoulders."""
    return np.clip(1.5 * (1 - np.abs(x / half) ** 2.5), 0, 1)


def _flaring(rng, time, period, amplitude):
    """Fast rises with exponential decays, one every `period` days, and weak spots."""
    values = _spots(rng, time, 3.7, 0.002)
    for _ in range(rng.poisson(time[-1] / period) + 1):
        since = time - rng.uniform(0, time[-1])
        decay = rng.uniform(0.02, 0.08)
        values += amplitude * rng.pareto(1.5) * 0.5 * (since > 0) * np.exp(-np.abs(since) / decay)
    return np.minimum(values, 2.0)


def _bump(rng, time, period, amplitude):
    """One Gaussian rise and fall."""
    since = (time - rng.uniform(0.3, 0.7) * time[-1]) / period
    return 1 + amplitude * np.exp(-4 * np.log(2) * since**2)


def _rise(rng, time, period, amplitude):
    """One smooth rise that begins on the first day."""
    phase = np.clip((time - rng.uniform()) / period, 0, 1)
    return 1 + amplitude * np.sin(np.pi / 2 * phase) ** 2


#: Relative flux of a star without transits, near 1, by the kind of variability. The period is in
#: days, the amplitude about half the range; of an eclipsing binary, the depth.
LIGHTS = {
    "constant": lambda rng, time, period, amplitude: np.ones(len(time)),  # noqa: ARG005
    "sine": lambda rng, time, period, amplitude: 1 + amplitude * _wave(rng, time, period),
    "walk": lambda rng, time, period, amplitude: 1 + amplitude * red_noise(rng, time, period),
    "spots": _spots, "rr_lyrae": _rr_lyrae, "delta_scuti": _delta_scuti, "eclipsing": _eclipsing,
    "flaring": _flaring, "bump": _bump, "rise": _rise,
}  # fmt: skip


def make_transit(rng, time, period, duration):
    """Return the shape of transits, 0 outside and 1 at most; period and duration are in days."""
    phase = rng.uniform(0.35, 0.65)
    if np.isinf(period):  # a single one
        since = time - phase * time[-1]
    else:
        since = (time - phase * period + period / 2) % period - period / 2
    return np.clip(1.3 * (1 - np.abs(2 * since / duration) ** 4), 0, 1)


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
