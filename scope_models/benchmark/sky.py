"""Messy stars: pixels with all that real skies do, and their truth.

Neither simulator nor correctors nor fits use this rendering. The PSF is a Fourier series on a
periodic field, the response of a pixel an oversampled map, the light in it the sum over the modes
of the PSF's coefficient, the phase of the star's position, and the transform of the map.
"""

from collections import namedtuple
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.polynomial.chebyshev import chebpts1, chebvander

from scope_models._checks import checked_choice, checked_integer
from scope_models._threads import one_thread
from scope_models._values import Value
from scope_models.benchmark.regimes import LIGHTS, MOTIONS, REGIMES, SkyRegime, make_transit
from scope_models.effects._noise import red_noise
from scope_models.io.tpf import TPFMetadata, make_tpf_hdulist
from scope_models.missions import MISSIONS
from scope_models.scene.motion import K2Roll

__all__ = ["MessyStar", "make_sky"]

_LONG = K2Roll.cadence  # days
# Errors of POS_CORR in real files: of the scale; over days and of each cadence, pixels.
_SCALE_ERROR, _SLOW_ERROR, _SLOW_SCALE, _WHITE_ERROR = 0.01, 0.006, 5.0, 0.003
_SAMPLES = 9  # of the light of an exposure: a jump within it is right to 1/18

_MARGIN = 4  # pixels around the stamp until the field repeats
_OVERSAMPLING = 12
_HIGHEST = 2.5  # cycles per pixel: the narrowest component has exp(-25) of its light there
_CHUNK = 300

# From the missions' handbooks: zero point (e-/s of a star of magnitude 12), seconds of exposure,
# read noise per cadence (e-), sky background (e-/s per pixel), full well (e-/s), PSF's width (px).
_Photometer = namedtuple("_Photometer", "zero_point exposure read_noise background well width")
_KEPLER = _Photometer(1.74e5, 1625.3, 1479.0, 166.0, 1.79e5, 0.55)
_TESS = _Photometer(2379.0, 1425.6, 268.0, 120.0, 1.0e5, 0.65)
_PHOTOMETERS = {"K2": _KEPLER, "Kepler": _KEPLER, "TESS": _TESS}


@dataclass(frozen=True, eq=False, repr=False)
class MessyStar(Value):
    """A star of the messy sky: its pixels as a pipeline would deliver them, and the truth.

    Cadences without data are there too; fluxes are in e-/s.

    Attributes
    ----------
    regime : SkyRegime
        What kind of star it is.
    seed, noise_seed, positions : int, int, str
        As in `make_sky`.
    time, cadenceno, quality : ndarray, shape (n,)
        Times in days, NaN where there are no data, numbers and flags of the cadences.
    flux, flux_err : ndarray, shape (n, ny, nx)
        Pixels after the pipeline's subtraction of its background, and their formal errors.
    pos_corr1, pos_corr2 : ndarray, shape (n,)
        Offsets, pixels.
    x, y, width : ndarray, shape (n,)
        True positions in the stamp, pixels, NaN where the star is off it; and true relative width
        of the PSF.
    true_flux, transit : ndarray, shape (n,)
        True relative flux of the star, averaged over exposures; and the transits alone.
    star_light, neighbor_light, background_light, sky : ndarray, shape (n, ny, nx)
        Light without noise, before full pixels spill: of the star, of its neighbors, the background
        that is left in `flux`, and what the pipeline took off.
    aperture : ndarray of bool, shape (ny, nx)
        The file's aperture: the pixels whose sum, uncorrected, is expected to scatter least.
    noise : ndarray, shape (n, ny, nx)
        Expected photon, background and read noise of each pixel.

    Examples
    --------
    >>> from scope_models.benchmark import make_sky
    >>> sky = make_sky("tess-crowded", seed=1, n_cadences=100)
    >>> sky.to_tpf().mission, sky.true_flux.shape
    ('TESS', (100,))
    """

    regime: SkyRegime
    seed: int
    noise_seed: int | None
    positions: str
    time: np.ndarray
    cadenceno: np.ndarray
    quality: np.ndarray
    flux: np.ndarray = field(repr=False)
    flux_err: np.ndarray = field(repr=False)
    pos_corr1: np.ndarray = field(repr=False)
    pos_corr2: np.ndarray = field(repr=False)
    x: np.ndarray = field(repr=False)
    y: np.ndarray = field(repr=False)
    width: np.ndarray = field(repr=False)
    true_flux: np.ndarray = field(repr=False)
    transit: np.ndarray = field(repr=False)
    star_light: np.ndarray = field(repr=False)
    neighbor_light: np.ndarray = field(repr=False)
    background_light: np.ndarray = field(repr=False)
    sky: np.ndarray = field(repr=False)
    aperture: np.ndarray = field(repr=False)
    noise: np.ndarray = field(repr=False)

    def floor(self):
        """Return the expected relative noise of a cadence of a light curve of only the star.

        Returns
        -------
        float
            Median over cadences of `noise` over starlight in `aperture`.
        """
        mask, here = self.aperture, np.isfinite(self.x)
        noise = np.sqrt((self.noise[here][:, mask] ** 2).sum(axis=1))
        return float(np.median(noise / self.star_light[here][:, mask].sum(axis=1)))

    def to_tpf(self, quality_bitmask="default"):
        """Return lightkurve's target pixel file.

        Parameters
        ----------
        quality_bitmask : str or int, optional
            Which flagged cadences lightkurve leaves out.

        Returns
        -------
        lightkurve.KeplerTargetPixelFile or lightkurve.TessTargetPixelFile
            The file, without truth.
        """
        import lightkurve

        mission, cadence = self.regime.mission, self.regime.cadence
        frames = (1.98, 0.02, 900) if mission == "TESS" else (6.0198, 0.5189, 270)
        metadata = TPFMetadata(
            mission=mission, target_id=self.seed + 1, magnitude=self.regime.magnitude,
            int_time=frames[0], read_time=frames[1], n_frames=round(frames[2] * cadence / _LONG),
            time_delta=cadence,
        )  # fmt: skip
        columns = "time", "cadenceno", "flux", "flux_err", "quality", "pos_corr1", "pos_corr2"
        hdulist = make_tpf_hdulist(
            metadata=metadata, flux_bkg=self.sky, flux_bkg_err=0.01 * self.sky,
            aperture=self.aperture, **{name: getattr(self, name) for name in columns},
        )  # fmt: skip
        kind = getattr(lightkurve, MISSIONS[mission].tpf_class)
        return kind(hdulist, quality_bitmask=quality_bitmask)


@one_thread
def make_sky(regime, seed=0, *, n_cadences=1100, positions=None, noise_seed=None):
    """Make a messy star.

    Parameters
    ----------
    regime : SkyRegime or str
        The kind of star, or its name in `REGIMES`.
    seed : int, optional
        Seed of everything that is random.
    n_cadences : int, optional
        Length in long cadences, at least 100; shorter where the regime is.
    positions : {"wrong", "exact", "none"}, optional
        POS_CORR of the file: with errors as in real files, true, or NaN; by default that of the
        regime.
    noise_seed : int, optional
        Seed of another draw of the photon, background and read noise alone.

    Returns
    -------
    MessyStar
        Pixels and truth.

    Raises
    ------
    ValueError
        If there is no such regime or kind of positions, or `n_cadences` is below 100.

    Examples
    --------
    >>> from scope_models.benchmark import make_sky, score
    >>> sky = make_sky("k2-1x-constant", seed=1, n_cadences=300)
    >>> lc = sky.to_tpf().to_lightcurve(aperture_mask="pipeline")
    >>> bool(score(lc, sky).full > 3)
    True
    """
    if not isinstance(regime, SkyRegime):
        regime = REGIMES[checked_choice("regime", regime, REGIMES)]
    given = positions or regime.positions
    positions = checked_choice("positions", given, ("wrong", "exact", "none"))
    part = regime.cadence / _LONG
    n = min(round(checked_integer("n_cadences", n_cadences, 100) / part), regime.longest)
    rngs = _generators(regime, seed)
    if noise_seed is not None:
        rngs["noise"] = np.random.default_rng([noise_seed, seed, *regime.name.encode()])
    photometer = _PHOTOMETERS[regime.mission]
    exposure, read_noise = photometer.exposure * part, photometer.read_noise * np.sqrt(part)
    time = regime.cadence * np.arange(n)
    true_flux, transit, outside = _variability(regime, rngs["star"], n)
    own, others, (x, y), width, offsets, firing = _field(
        regime.replace(depth=0.0, transit_period=1.0, duration=1.0), seed, n
    )
    lost = rngs["positions"].permutation(n)[: regime.lost]
    on = ~np.isin(np.arange(n), lost)
    x, y, others = np.where(on, x, np.nan), np.where(on, y, np.nan), others * on[:, None, None]
    star_light = own * (true_flux * on)[:, None, None]
    quality, missing, flash = _events(regime, rngs["events"], firing, n)
    residual, sky = _background(regime, photometer, rngs["sky"], time)
    sky = sky + flash[:, None, None]
    light = bleed((star_light + others + residual + sky) * exposure, photometer.well * exposure)
    noise = np.sqrt(light + read_noise**2)
    electrons = light + noise * rngs["noise"].normal(size=light.shape)
    hits = rngs["rays"].uniform(size=light.shape) < regime.cosmic_rays * part
    electrons[hits] += 3000 * rngs["rays"].lognormal(0, 1, hits.sum())  # that the pipeline missed
    # A star with and without transits has the same aperture.
    seen = (light / exposure - sky - others - residual) / true_flux[:, None, None]
    plain = outside & on
    aperture = _best_aperture(seen[plain], noise[plain] / exposure, part)
    given = rngs["positions"], time, quality, lost, positions
    pos_corr1, pos_corr2 = (_measured(offset, *given) for offset in offsets)
    flux = (electrons / exposure - sky).astype(np.float32)
    flux[missing] = np.nan
    return MessyStar(
        regime, seed, noise_seed, positions, time=np.where(missing, np.nan, 2144.1 + time),
        cadenceno=np.arange(1, n + 1), quality=quality, flux=flux,
        flux_err=(noise / exposure).astype(np.float32), pos_corr1=pos_corr1, pos_corr2=pos_corr2,
        x=x, y=y, width=width, true_flux=true_flux, transit=transit, star_light=star_light,
        neighbor_light=others, background_light=residual, sky=sky, aperture=aperture,
        noise=noise / exposure,
    )  # fmt: skip


def _variability(regime, rng, n):
    """Return the relative flux of a star, transits alone and where there are none, by exposure."""
    time = regime.cadence * ((np.arange(n * _SAMPLES) + 0.5) / _SAMPLES - 0.5)
    light = LIGHTS[regime.star](rng, time, regime.period, regime.amplitude)
    inside = make_transit(rng, time, regime.transit_period, regime.duration)
    flux, alone, inside = (
        values.reshape(n, -1).mean(axis=1)
        for values in (light * (1 - regime.depth * inside), light, inside)
    )
    return flux, flux / alone, inside == 0


def _generators(regime, seed):
    names = ("motion", "star", "optics", "sky", "noise", "events", "rays", "positions")
    seeds = np.random.SeedSequence([seed, *regime.name.encode()]).spawn(len(names))
    return dict(zip(names, map(np.random.default_rng, seeds), strict=True))


@lru_cache(maxsize=1)
def _field(regime, seed, n):
    """Return all that does not depend on transits and noise: the last star is kept."""
    rngs, time = _generators(regime, seed), regime.cadence * np.arange(n)
    dx, dy, firing = MOTIONS[regime.motion](rngs["motion"], time)
    offsets = regime.scale * dx, regime.scale * dy
    width = _width(regime, rngs["optics"], time)
    light = _starlight(regime, _PHOTOMETERS[regime.mission], rngs["optics"], time, offsets, width)
    return *light, width, offsets, firing


def _width(regime, rng, time):
    """Return a focus that swings, drifts and follows the temperature a little, and the seeing."""
    swing = np.sin(2 * np.pi * time / regime.focus_period + rng.uniform(0, 2 * np.pi))
    slow = 0.3 * red_noise(rng, time, 20.0)
    fast = 0.02 * red_noise(rng, time, 0.15)
    width = 1 + regime.focus * np.clip(0.8 * swing + slow + fast, -1.3, 1.3)
    return width * np.exp(regime.seeing * red_noise(rng, time, 0.04)) if regime.seeing else width


def _starlight(regime, photometer, rng, time, offsets, width):
    """Return the star's image at flux 1 in its units, the neighbors' light, and its positions."""
    ny, nx = regime.shape
    middle = np.array([nx // 2, ny // 2]) + rng.uniform(-0.5, 0.5, 2)
    x, y = (place + offset for place, offset in zip(middle, offsets, strict=True))
    psf = make_psf(rng, photometer.width * rng.uniform(0.85, 1.15))
    drop, scatter = rng.uniform(0.04, 0.18), rng.uniform(0.006, 0.012)
    response = make_response(rng, regime.shape, drop=drop, scatter=scatter)
    flux = photometer.zero_point * 10 ** (-0.4 * (regime.magnitude - 12))
    own = flux * render(response, psf, x, y, width)
    others = np.zeros_like(own)
    for difference, distance, amplitude in regime.neighbors:
        angle, phase = rng.uniform(0, 2 * np.pi, 2)
        varied = 1 + amplitude * np.sin(2 * np.pi * time / 1.1 + phase)
        u, v = distance * np.cos(angle), distance * np.sin(angle)
        image = render(response, psf, x + u, y + v, width)
        others += (flux * 10 ** (-0.4 * difference) * varied)[:, None, None] * image
    return own, others, (x, y)


def _background(regime, photometer, rng, time):
    """Return the background that stays in the pixels, and the subtracted one."""
    ny, nx = regime.shape
    v, u = np.mgrid[:ny, :nx] / max(regime.shape) - 0.5
    level = 0.5 + 0.4 * np.sin(2 * np.pi * time / rng.uniform(8, 30) + rng.uniform(0, 6))
    level += 0.1 * red_noise(rng, time, 1.0)
    tilt = rng.normal(0, 0.5, 2)
    residual = regime.background * level[:, None, None] * (1 + tilt[0] * u + tilt[1] * v)
    drift = 1 + 0.1 * (time / time[-1] - 0.5) + 0.01 * np.sin(2 * np.pi * time / 13.7)
    return residual, photometer.background * drift[:, None, None] * np.ones(regime.shape)


def _events(regime, rng, firing, n):
    """Return flags, cadences without data, and the light of argabrightenings per pixel."""
    quality = np.zeros(n, dtype=np.int32)
    bits = MISSIONS[regime.mission].quality
    quality[firing] |= bits.thruster_firing or bits.desaturation
    missing = rng.uniform(size=n) < 0.003
    start = rng.integers(n // 4, 3 * n // 4)
    missing[start : start + rng.integers(20, 70)] = True
    flash = np.zeros(n)
    bright = rng.choice(n, 2, replace=False)
    flash[bright] = rng.uniform(100, 2000, 2)
    if regime.mission != "TESS":
        quality[bright] |= 4096  # argabrightening on the CCD
    return quality, missing, flash


def _measured(offset, rng, time, quality, lost, positions):
    """Return POS_CORR along an axis; far off where the star is off the stamp."""
    scale = 1 + _SCALE_ERROR * rng.choice([-1, 1])
    errors = _SLOW_ERROR * red_noise(rng, time, _SLOW_SCALE)
    errors += _WHITE_ERROR * rng.normal(size=len(time))
    absurd = (quality > 0) & (rng.uniform(size=len(time)) < 0.2)
    nonsense = rng.choice([np.nan, 900.0, -50.0], len(time))
    measured = offset - np.median(offset)
    if positions == "wrong":
        measured = np.where(absurd, nonsense, scale * measured + errors)
    measured[lost] = rng.uniform(200, 900, len(lost))
    return np.full(len(time), np.nan) if positions == "none" else measured


def _best_aperture(light, noise, part):
    """Return the pixels whose sum scatters least in 6.5 h; a cadence is a `part` of a long one."""
    n = len(light)
    light, variance = light.reshape(n, -1), (noise**2).mean(axis=0).ravel()
    order = np.argsort(-np.quantile(light, 0.98, axis=0) / variance)
    inside = np.cumsum(light[:, order], axis=1)
    level = inside.mean(axis=0)
    scatter = inside.var(axis=0) + np.cumsum(variance[order]) * part / 13
    mask = np.zeros(len(order), dtype=bool)
    mask[order[: np.argmin(scatter / np.where(level > 0, level, np.inf) ** 2) + 1]] = True
    return mask.reshape(noise.shape[1:])


def _modes(shape):
    """Return the periodic field's size, and frequencies of rows and columns, radians per pixel."""
    size = max(shape) + 2 * _MARGIN
    highest, unit = int(_HIGHEST * size), 2 * np.pi / size
    return size, unit * np.arange(-highest, highest + 1), unit * np.arange(highest + 1)


def _phases(places, frequencies):
    return np.exp(1j * np.outer(places, frequencies))


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
            value += part * np.exp(-square / 2) / (2 * np.pi * ratio * sigma**2)
        part, alpha, beta = wing
        moffat = (beta - 1) / (np.pi * alpha**2) * (1 + (x**2 + y**2) / alpha**2) ** -beta
        value += part * moffat
        for turn in (angle, angle + np.pi / 2):
            along = x * np.cos(turn) + y * np.sin(turn)
            across = y * np.cos(turn) - x * np.sin(turn)
            square = (along / (4 * width)) ** 2 + (across / (0.9 * width)) ** 2
            value += spikes * np.exp(-square / 2) / (2 * np.pi * 3.6 * width**2)
        return value

    return density


def make_response(rng, shape, *, drop, scatter):
    """Return the transforms ``(rows, columns, ny, nx)`` of the response maps of pixels.

    They have a mean `drop` to their edges and a `scatter`. Of columns there are no negative modes.
    """
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
    _, rows, columns = _modes(shape)
    # The maps are constant within each of their cells, whose transform is a sinc.
    cell = 2 * np.pi * _OVERSAMPLING
    phase_y = _phases(rows, u) * np.sinc(rows / cell)[:, None]
    phase_x = _phases(columns, u) * np.sinc(columns / cell)[:, None]
    local = np.einsum("ki,pij,lj->pkl", phase_y, maps, phase_x, optimize=True) / len(u) ** 2
    place_y = _phases(np.arange(ny), rows).repeat(nx, axis=0)
    place_x = np.tile(_phases(np.arange(nx), columns), (ny, 1))
    local *= place_y[:, :, None] * place_x[:, None, :]
    return np.moveaxis(local, 0, -1).reshape(len(rows), len(columns), ny, nx)


def render(response, psf, x, y, width):
    """Return the light ``(n, ny, nx)`` of a star of flux 1 at positions and widths by cadence."""
    # The series is a polynomial of the width through Chebyshev nodes.
    middle, half = (width.max() + width.min()) / 2, max(np.ptp(width) / 2, 1e-6)
    nodes, shape = chebpts1(3 + int(np.ceil(25 * half))), response.shape[2:]
    series = np.array([_series(shape, psf, middle + half * node) for node in nodes])
    degree = len(nodes) - 1
    values = chebvander((width - middle) / half, degree)
    shares = values @ np.linalg.inv(chebvander(nodes, degree))
    _, rows, columns = _modes(shape)
    transforms = response.reshape(-1, np.prod(shape))
    images = np.empty((len(x), transforms.shape[1]))
    for first in range(0, len(x), _CHUNK):
        part = slice(first, first + _CHUNK)
        light = np.tensordot(shares[part], series, 1)
        light *= _phases(-y[part], rows)[:, :, None]
        light *= _phases(-x[part], columns)[:, None, :]
        light = light.reshape(len(light), -1)
        images[part] = light.real @ transforms.real
        images[part] -= light.imag @ transforms.imag
    return images.reshape(len(x), *shape)


def _series(shape, psf, width):
    """Return Fourier coefficients of a PSF whose light on the field is 1."""
    size, rows, columns = _modes(shape)
    samples = np.arange(size * _OVERSAMPLING) / _OVERSAMPLING
    place = (samples + size / 2) % size - size / 2
    x, y = np.meshgrid(place / width, place / width)
    values = psf(x, y)
    values /= values.sum()
    coefficients = _phases(rows, -samples) @ values @ _phases(columns, -samples).T
    coefficients[:, 1:] *= 2  # for those of negative columns, which are their conjugates
    return coefficients / size**2


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
