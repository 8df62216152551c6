"""Noise and saturation as pure functions of arrays of electrons and a random generator.

Every effect draws from its own stream (`stream`), and every draw uses up the same amount of random
numbers for any expected counts. Simulations with one seed therefore share their noise wherever
their expected counts are equal, whatever other effects are switched on.
"""

import secrets
import zlib
from collections.abc import Iterable

import numpy as np
from scipy.signal import lfilter
from scipy.special import ndtr

from scope_models._checks import checked_integer

__all__ = [
    "NOISE_TERMS", "add_quantization", "bleed", "correlated", "fresh_seed", "noise_terms",
    "poisson_counts", "poisson_quantile", "red_noise", "stream",
]  # fmt: skip

NOISE_TERMS = ("photon", "background", "read", "quantization")
_DEFAULT_TERMS = frozenset({"photon", "background", "read"})

_SEARCH_BELOW = 30.0  # mean from which the asymptotic quantile is used
# Beyond this deviate (probability 3e-14) double precision cannot distinguish 1 - u from zero.
_LARGEST_DEVIATE = 7.5
# A mean below _RARE gives a count only for a deviate above _RARE_DEVIATE.
_RARE, _RARE_DEVIATE = 1e-3, 3.09


def fresh_seed():
    """Return a seed from the operating system, below 2**53: JSON and FITS cards hold it exactly."""
    return secrets.randbits(53)


def noise_terms(noise):
    """Return the set of names of a ``noise`` argument: True, False, or names of `NOISE_TERMS`."""
    if isinstance(noise, (bool, np.bool_)):
        return _DEFAULT_TERMS if noise else frozenset()
    if isinstance(noise, str):
        noise = (noise,)
    if not isinstance(noise, Iterable):
        raise TypeError(f"`noise` must be True, False or names of noise terms, got {noise!r}")
    terms = frozenset(noise)
    if unknown := sorted(map(str, terms.difference(NOISE_TERMS))):
        known = ", ".join(NOISE_TERMS)
        raise ValueError(f"`noise` must hold names out of {known}, got {', '.join(unknown)}")
    return terms


def stream(seed, name):
    """Return the random generator of one named effect, independent of all others."""
    seed, key = checked_integer("seed", seed, 0), zlib.crc32(name.encode())
    sequence = np.random.SeedSequence(seed, spawn_key=(key,))
    return np.random.Generator(np.random.SFC64(sequence))


def correlated(generator, n, correlation):
    """Return normal noise of unit variance whose correlation decays by e in a number of samples."""
    kept = np.exp(-1 / correlation) if correlation > 0 else 0.0
    white = generator.standard_normal(n)
    white[1:] *= np.sqrt(1 - kept**2)
    return lfilter([1.0], [1.0, -kept], white)


def red_noise(generator, time, correlation_time):
    """Return a Gauss-Markov process of unit variance at any times, in the unit of its time."""
    values = generator.standard_normal(len(time))
    for i, part in enumerate(np.exp(-np.diff(time) / correlation_time), start=1):
        values[i] = part * values[i - 1] + np.sqrt(1 - part**2) * values[i]
    return values


def poisson_quantile(deviate, mean):
    """Return Poisson counts at the probability of standard normal deviates.

    Large means use the asymptotic inverse of the cumulative distribution function, which differs
    from the exact one, by one count, with a probability of 7e-5 at a mean of 30, 9e-6 at 100 and
    less than 2e-8 above 1000.
    """
    deviate, mean = np.asarray(deviate, dtype=float), np.asarray(mean, dtype=float)
    shape = np.broadcast_shapes(deviate.shape, mean.shape)
    deviate = np.broadcast_to(deviate, shape)
    large = mean >= _SEARCH_BELOW
    if large.all():
        return _asymptotic_quantile(deviate, mean)
    counts, mean, large = np.zeros(shape), *(np.broadcast_to(v, shape) for v in (mean, large))
    possible = ~large & ((mean >= _RARE) | (deviate > _RARE_DEVIATE))
    for quantile, chosen in ((_asymptotic_quantile, large), (_searched_quantile, possible)):
        counts[chosen] = quantile(deviate[chosen], mean[chosen])
    return counts


def _asymptotic_quantile(deviate, mean):
    """Return the integer part of a polynomial of the deviate, for means of any shape.

    Giles 2016, ACM Transactions on Mathematical Software, 42, 7, Algorithm 955.
    """
    root, inverse = np.sqrt(mean), 1.0 / mean
    inverse_root = root * inverse
    counts = deviate * (inverse / 270.0)
    for coefficient in (
        inverse_root * (-1.0 / 72.0),
        inverse * (7.0 / 810.0) + 1.0 / 6.0,
        root - inverse_root * (1.0 / 36.0),
    ):
        counts += coefficient
        counts *= deviate
    counts += mean + (1.0 / 3.0 - 8.0 / 405.0 * inverse)
    return np.floor(counts, out=counts)


def _searched_quantile(deviate, mean):
    """Return the exact quantile by adding up probabilities, for one-dimensional arrays."""
    counts, at, count = np.zeros(mean.shape), np.arange(mean.size), 0
    probability = ndtr(np.minimum(deviate, _LARGEST_DEVIATE))
    term = np.exp(-mean)
    total = term.copy()
    while at.size:
        found = np.full(at.size, count, np.int8)
        for _ in range(8):  # before what is found is left out
            count += 1
            beyond = probability > total
            found += beyond.view(np.int8)
            term *= mean / count
            total += term
        counts[at] = found
        remaining, kept = (at, mean, probability, term, total), beyond.nonzero()[0]
        at, mean, probability, term, total = (values.take(kept) for values in remaining)
    return counts


def poisson_counts(mean, generator, shape=None):
    """Return Poisson counts of means, electrons; each uses up one normal deviate of ``shape``."""
    shape = np.shape(mean) if shape is None else shape
    return poisson_quantile(generator.standard_normal(shape), mean)


def add_quantization(electrons, gain, n_reads, generator):
    """Digitize in place: each read is rounded to whole numbers of ``gain`` electrons.

    The errors of all reads but one are drawn together as normal noise, the last is the rounding of
    the sum itself. The variance is ``n_reads * gain**2 / 12``.
    """
    deviates = generator.standard_normal(electrons.shape)
    electrons += gain * np.sqrt((n_reads - 1) / 12.0) * deviates
    electrons /= gain
    np.rint(electrons, out=electrons)
    electrons *= gain
    return electrons


def bleed(charge, well_depth, background=0.0):
    """Let the charge ``(..., ny, nx)`` beyond the well depth bleed along the column, in place.

    Half of a pixel's excess moves up its column and half down, and fills every pixel that it meets;
    what passes the edge of the stamp is lost. The ``background`` is in the wells besides and stays.
    Transfer is taken as perfect; the flight pipeline's constant for Kepler is 0.9996 per pixel.
    """
    capacity = well_depth - np.asarray(background)
    full = np.any(charge > capacity, axis=-2)
    if not full.any():
        return charge
    columns = np.moveaxis(charge, -2, -1)[full]
    capacity = np.moveaxis(np.broadcast_to(capacity, charge.shape), -2, -1)[full]
    spilled = np.maximum(columns - capacity, 0.0)
    columns -= spilled
    spilled *= 0.5
    up_first, down_first = columns.copy(), columns
    for pixels, directions in ((up_first, (1, -1)), (down_first, (-1, 1))):
        for direction in directions:
            _fill(*(values[:, ::direction] for values in (pixels, spilled, capacity)))
    up_first += down_first
    up_first *= 0.5
    np.moveaxis(charge, -2, -1)[full] = up_first
    return charge


def _fill(columns, spilled, capacity):
    """Carry the spilled charge along the last axis and fill the wells on the way, in place."""
    stream = np.zeros(len(columns))
    for row in range(columns.shape[-1]):
        stream += spilled[:, row]
        taken = np.minimum(stream, capacity[:, row] - columns[:, row])
        columns[:, row] += taken
        stream -= taken
