"""The simulator: stars, a detector and a motion give pixels, and the truth behind them."""

import warnings
from collections.abc import Iterable

import numpy as np

from scope_models._checks import checked_integer
from scope_models.effects.noise import (
    add_quantization,
    add_read_noise,
    check_seed,
    fresh_seed,
    noise_terms,
    poisson_counts,
    stream,
)
from scope_models.exceptions import LostLightWarning
from scope_models.scene.detector import Detector
from scope_models.scene.motion import Motion
from scope_models.scene.star import Star
from scope_models.simulation._light import Light
from scope_models.simulation.observation import Observation, Truth

__all__ = ["simulate"]

# A star that loses more of its light off the stamp than this raises a warning.
_LARGEST_LOSS = 0.05
_LARGEST_COUNT = np.iinfo(np.int32).max
# Standard deviation of the rounding of a number near 1 to single precision.
_ROUNDING = float(np.finfo(np.float32).eps) / 12**0.5


def simulate(
    stars, detector, motion, *, seed=None, noise=True, n_sub=1, keep_model=False, chunk_size=None
):
    """Simulate what a detector records of moving stars.

    The expected electrons of all stars come first: each PSF times the sensitivity of the pixels
    is integrated over them at the star's position, times the relative flux and the interpixel
    map; what the wells do not hold bleeds along the columns. Noise comes last: photons of stars
    and background (Poisson), read noise (normal), digitisation.

    Parameters
    ----------
    stars : Star or sequence of Star
        The stars; the first is the target.
    detector : Detector
        The pixels.
    motion : Motion
        The motion that all stars share.
    seed : int, optional
        The seed of the interpixel map and of all noise, which the truth of the observation holds.
        None takes one from the operating system.
    noise : bool or str or iterable of str, optional
        True for photon, background and read noise, False for none, or names out of "photon",
        "background", "read" and "quantization". The level of the background is subtracted in any
        case.
    n_sub : int, optional
        Exposures within a cadence over which the motion is averaged. Positions are interpolated
        between the middles of the cadences by straight lines, and stay before the first and after
        the last. The relative flux is a mean over the cadence in any case.
    keep_model : bool, optional
        Whether the truth keeps the noise-free cube.
    chunk_size : int, optional
        Cadences per piece of work; the default is a size that suits the processor's cache. It
        does not change the result.

    Returns
    -------
    Observation
        The pixels and the truth.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or outside its domain.

    Warns
    -----
    LostLightWarning
        If a star loses more than 5 % of its light off the stamp where the motion takes it
        farthest, or more than 5 % of the charge of a cadence bleeds off the stamp.

    Notes
    -----
    The same seed gives the same noise, whatever other effects are switched on, however many
    cadences follow, and wherever the expected electrons of a pixel are the same: a transit
    changes only the pixels of its star.

    Fluxes are stored in single precision: their errors are at least those of the rounding, so
    that they are positive even without noise.

    Pixels at the depth of their wells keep the noise of the light that they hold; real ones
    have less.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> stars = [Star(12.0), Star(14.5, x_0=8.0, y_0=3.0)]
    >>> observation = simulate(stars, Detector.k2(), Motion.k2_roll(100), seed=7)
    >>> observation.flux.shape
    (100, 11, 11)
    >>> observation.truth.x.shape
    (2, 100)
    """
    stars = _checked_stars(stars)
    for name, value, kind in (("detector", detector, Detector), ("motion", motion, Motion)):
        if not isinstance(value, kind):
            raise TypeError(f"`{name}` must be a {kind.__name__}, got {value!r}")
    seed = fresh_seed() if seed is None else check_seed(seed)
    terms = noise_terms(noise)
    n_sub = checked_integer("n_sub", n_sub, 1)
    if chunk_size is not None:
        chunk_size = checked_integer("chunk_size", chunk_size, 1)
    light = Light(stars, detector, motion, seed, n_sub)
    lost = light.lost_fractions()
    _warn_of_lost_light(light.positions, lost, detector.shape)
    cubes = _record(light, terms, seed, light.pieces(chunk_size), keep_model)
    _warn_of_spilled_charge(light.largest_spill, detector.shape)
    truth = _truth(light, seed, terms, lost, cubes.pop("model"))
    background = (light.background / detector.exposure_time).astype(np.float32)
    cubes["flux_bkg"] = np.broadcast_to(background, cubes["flux"].shape)
    return Observation(stars=stars, detector=detector, motion=motion, truth=truth, **cubes)


def _record(light, terms, seed, pieces, keep_model):
    """Return the cubes of an observation, made piece by piece."""
    detector = light.detector
    shape = (len(light.motion), *detector.shape)
    streams = {term: stream(seed, term) for term in terms}
    cubes = {
        "flux": np.empty(shape, np.float32),
        "flux_err": np.empty(shape, np.float32),
        "raw_cnts": np.empty(shape, np.int32),
        "model": np.empty(shape) if keep_model else None,
    }
    for part in pieces:
        expected = light.electrons(part)
        if keep_model:
            np.divide(expected, detector.exposure_time, out=cubes["model"][part])
        electrons = _detect(expected, light.background, detector, streams)
        cubes["raw_cnts"][part] = _digital_numbers(electrons, detector)
        electrons -= light.background
        electrons /= detector.exposure_time
        cubes["flux"][part] = electrons
        error = _variance(expected, light.background, detector, terms)
        np.sqrt(error, out=error)
        error /= detector.exposure_time
        rounding = np.maximum(np.abs(electrons, out=electrons), 1.0, out=electrons)
        rounding *= _ROUNDING
        np.maximum(error, rounding, out=error)
        cubes["flux_err"][part] = error
    return cubes


def _detect(expected, background, detector, streams):
    """Return the electrons that are read out, with the background."""
    if "photon" in streams:
        electrons = poisson_counts(expected, streams["photon"])
    else:
        electrons = expected.copy()
    if "background" in streams:
        electrons += poisson_counts(background, streams["background"], expected.shape)
    else:
        electrons += background
    if "read" in streams:
        add_read_noise(electrons, detector.cadence_read_noise, streams["read"])
    if "quantization" in streams:
        add_quantization(electrons, detector.gain, detector.n_reads, streams["quantization"])
    return electrons


def _variance(expected, background, detector, terms):
    """Return the variance of the electrons; ``expected`` may be used up."""
    constant = np.zeros(background.shape)
    if "background" in terms:
        constant += background
    if "read" in terms:
        constant += detector.cadence_read_noise**2
    if "quantization" in terms:
        constant += detector.n_reads * detector.gain**2 / 12.0
    if "photon" not in terms:
        return np.broadcast_to(constant, expected.shape).copy()
    expected += constant
    return expected


def _digital_numbers(electrons, detector):
    """Return raw counts: digital numbers above the fixed offset."""
    counts = electrons / detector.gain
    counts += detector.fixed_offset
    np.rint(counts, out=counts)
    return np.minimum(counts, _LARGEST_COUNT, out=counts)


def _truth(light, seed, terms, lost, model):
    """Return what lies behind the pixels."""
    x, y = (offsets.mean(axis=1) for offsets in light.offsets(slice(None)))
    positions = np.array(light.positions)
    truth = Truth(
        x=positions[:, :1] + x,
        y=positions[:, 1:] + y,
        relative_flux=light.relative_flux,
        flux=np.array(light.fluxes),
        lost_fraction=lost,
        interpixel=light.interpixel,
        detector=light.detector,
        seed=seed,
        noise=terms,
        n_sub=light.n_sub,
        model=model,
    )
    for value in vars(truth).values():
        if isinstance(value, np.ndarray):
            value.flags.writeable = False
    return truth


def _checked_stars(stars):
    """Return one star or several as a tuple."""
    if isinstance(stars, Star):
        return (stars,)
    if not isinstance(stars, Iterable):
        raise TypeError(f"`stars` must be a Star or a sequence of them, got {stars!r}")
    stars = tuple(stars)
    if not stars:
        raise ValueError("`stars` must hold at least one star")
    for star in stars:
        if not isinstance(star, Star):
            raise TypeError(f"`stars` must hold Star objects, got {star!r}")
    return stars


def _warn_of_lost_light(positions, lost, shape):
    """Warn of stars whose light falls off the stamp."""
    for (x_0, y_0), fraction in zip(positions, lost, strict=True):
        if fraction > _LARGEST_LOSS:
            warnings.warn(
                f"the star at x_0 = {x_0:g}, y_0 = {y_0:g} loses up to {100 * fraction:.1f} % of "
                f"its light off the stamp of {shape[0]} x {shape[1]} pixels",
                LostLightWarning,
                stacklevel=3,
            )


def _warn_of_spilled_charge(fraction, shape):
    """Warn of full columns whose charge bleeds off the stamp."""
    if fraction > _LARGEST_LOSS:
        warnings.warn(
            f"up to {100 * fraction:.1f} % of the charge of a cadence bleeds off the stamp of "
            f"{shape[0]} x {shape[1]} pixels along full columns",
            LostLightWarning,
            stacklevel=3,
        )
