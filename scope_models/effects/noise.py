"""Noise as pure functions of arrays and a random generator.

Every effect draws from its own stream (`stream`), and every draw uses up the same amount of random
numbers whatever the expected counts are. Two simulations with one seed therefore share their noise
wherever their expected counts are equal: a transit added to one star changes no other pixel, and
switching one effect off leaves the numbers of the others as they were.
"""

import secrets
import zlib
from collections.abc import Iterable
from numbers import Integral

import astropy.units as u
import numpy as np
from scipy.special import ndtr

from scope_models._arrays import DIGITAL, plain_array, plain_number, refuse_unit

__all__ = [
    "NOISE_TERMS", "add_quantization", "add_read_noise", "check_seed", "fresh_seed",
    "noise_terms", "poisson_counts", "poisson_quantile", "stream",
]  # fmt: skip

NOISE_TERMS = ("photon", "background", "read", "quantization")
_DEFAULT_TERMS = frozenset({"photon", "background", "read"})

# Below this mean the quantile is searched exactly; above, the asymptotic inverse picks another
# integer than the exact inverse in fewer than 1e-4 of all draws, and then its neighbor.
_SEARCH_BELOW = 30.0
# Beyond this deviate (probability 3e-14) double precision cannot distinguish 1 - u from zero.
_LARGEST_DEVIATE = 7.5
# A mean below _RARE gives a count only for a deviate above _RARE_DEVIATE.
_RARE, _RARE_DEVIATE = 1e-3, 3.09


def check_seed(seed):
    """Return a valid seed as an `int`.

    Parameters
    ----------
    seed : int
        The seed; not negative.

    Returns
    -------
    int
        The seed.

    Raises
    ------
    TypeError
        If the seed is not an integer.
    ValueError
        If the seed is negative.

    Examples
    --------
    >>> from scope_models.effects.noise import check_seed
    >>> check_seed(42)
    42
    """
    if isinstance(seed, bool) or not isinstance(seed, Integral):
        raise TypeError(f"`seed` must be an integer or None, got {seed!r}")
    if seed < 0:
        raise ValueError(f"`seed` must not be negative, got {seed}")
    return int(seed)


def fresh_seed():
    """Return a seed from the entropy of the operating system.

    Returns
    -------
    int
        A seed below 2**53, so that JSON and FITS cards hold it exactly.

    Examples
    --------
    >>> from scope_models.effects.noise import fresh_seed
    >>> 0 <= fresh_seed() < 2**53
    True
    """
    return secrets.randbits(53)


def noise_terms(noise):
    """Return the set of noise terms of a ``noise`` argument.

    Parameters
    ----------
    noise : bool or str or iterable of str
        True for photon, background and read noise, False for none, or names out of `NOISE_TERMS`.

    Returns
    -------
    frozenset of str
        The names.

    Raises
    ------
    ValueError
        If a name is unknown.
    TypeError
        If ``noise`` is none of the above.

    Examples
    --------
    >>> from scope_models.effects.noise import noise_terms
    >>> sorted(noise_terms(True))
    ['background', 'photon', 'read']
    >>> sorted(noise_terms("read"))
    ['read']
    """
    if isinstance(noise, (bool, np.bool_)):
        return _DEFAULT_TERMS if noise else frozenset()
    if isinstance(noise, str):
        noise = (noise,)
    if not isinstance(noise, Iterable):
        raise TypeError(f"`noise` must be True, False or names of noise terms, got {noise!r}")
    terms = frozenset(noise)
    unknown = sorted(str(term) for term in terms - set(NOISE_TERMS))
    if unknown:
        raise ValueError(
            f"`noise` must hold names out of {', '.join(NOISE_TERMS)}, got {', '.join(unknown)}"
        )
    return terms


def stream(seed, name):
    """Return the random generator of one named effect.

    The streams of different names are independent, and each depends on the seed and its own name
    only.

    Parameters
    ----------
    seed : int
        The seed of the observation; not negative.
    name : str
        The name of the effect, as "photon", "background", "read" or "interpixel".

    Returns
    -------
    numpy.random.Generator
        A new generator at the beginning of the stream.

    Examples
    --------
    >>> from scope_models.effects.noise import stream
    >>> bool(stream(1, "photon").random() == stream(1, "photon").random())
    True
    >>> bool(stream(1, "photon").random() == stream(1, "read").random())
    False
    """
    key = zlib.crc32(name.encode())
    sequence = np.random.SeedSequence(check_seed(seed), spawn_key=(key,))
    return np.random.Generator(np.random.SFC64(sequence))


def poisson_quantile(deviate, mean):
    r"""Return Poisson counts at the probability of standard normal deviates.

    For deviates :math:`w` that follow a standard normal distribution, the counts follow a Poisson
    distribution. A mean :math:`\lambda` of 30 or more uses the asymptotic inverse of its
    cumulative distribution function [1]_, the integer part of

    .. math::

        \lambda + \sqrt{\lambda}\,w + \frac{1}{3} + \frac{w^2}{6}
        - \frac{1}{\sqrt{\lambda}} \left(\frac{w}{36} + \frac{w^3}{72}\right)
        + \frac{1}{\lambda} \left(-\frac{8}{405} + \frac{7 w^2}{810} + \frac{w^4}{270}\right),

    which differs from the exact inverse, by one count, with a probability of 7e-5 at
    :math:`\lambda = 30`, 9e-6 at 100 and less than 2e-8 above 1000. Smaller means are searched
    for the exact quantile.

    Parameters
    ----------
    deviate : array_like
        Standard normal deviates.
    mean : array_like or Quantity
        Expected counts of electrons; not negative. Broadcast against ``deviate``.

    Returns
    -------
    ndarray of float
        Whole numbers, as floats.

    References
    ----------
    .. [1] Giles, M. B. 2016, ACM Transactions on Mathematical Software, 42, 7 (Algorithm 955).

    Examples
    --------
    >>> import numpy as np
    >>> from scope_models.effects.noise import poisson_quantile
    >>> poisson_quantile(np.array([-1.0, 0.0, 1.0]), 4.0)
    array([2., 4., 6.])
    """
    deviate = plain_array(deviate, u.one, "deviate")
    mean = plain_array(mean, u.electron, "mean")
    shape = np.broadcast_shapes(deviate.shape, mean.shape)
    deviate = np.broadcast_to(deviate, shape)
    counts = np.empty(shape)
    _asymptotic_quantile(deviate, mean, out=counts)
    small = mean < _SEARCH_BELOW
    if small.any():
        np.copyto(counts, 0.0, where=small)
        possible = np.flatnonzero(small & ((mean >= _RARE) | (deviate > _RARE_DEVIATE)))
        mean = np.broadcast_to(mean, shape)
        counts.ravel()[possible] = _searched_quantile(
            deviate.ravel()[possible], mean.ravel()[possible]
        )
    return counts


def _asymptotic_quantile(deviate, mean, out):
    """Write the asymptotic quantile to ``out``; meaningless for a small mean."""
    root = np.sqrt(np.maximum(mean, 1.0))
    inverse = 1.0 / root
    square = deviate * deviate
    np.multiply(square, 1.0 / 270.0, out=out)
    out += 7.0 / 810.0
    out *= square
    out -= 8.0 / 405.0
    out *= inverse
    # Now the square bracket of 1 / root, times w, is added to root: one pass less each.
    term = (square + 2.0) * (-1.0 / 72.0)
    term *= deviate
    out += term
    out *= inverse
    np.multiply(deviate, root, out=term)
    out += term
    square *= 1.0 / 6.0
    out += square
    out += mean + 1.0 / 3.0
    np.floor(out, out=out)
    return out


def _searched_quantile(deviate, mean):
    """Return the exact quantile by adding up probabilities, for one-dimensional arrays."""
    counts = np.zeros(mean.shape)
    open_ = np.arange(mean.size)
    probability = ndtr(np.minimum(deviate, _LARGEST_DEVIATE))
    term = np.exp(-mean)
    total = term.copy()
    count = 0
    while True:
        beyond = np.flatnonzero(probability > total)
        if not beyond.size:
            return counts
        count += 1
        open_, mean, probability = open_[beyond], mean[beyond], probability[beyond]
        term = term[beyond] * (mean / count)
        total = total[beyond] + term
        counts[open_] = count


def poisson_counts(mean, generator, shape=None):
    """Return Poisson counts of given means; each uses up one normal deviate.

    Parameters
    ----------
    mean : array_like or Quantity
        Expected counts of electrons; not negative.
    generator : numpy.random.Generator
        The stream of the effect.
    shape : tuple of int, optional
        Shape of the result, with which ``mean`` broadcasts; by default that of ``mean``.

    Returns
    -------
    ndarray of float
        Whole numbers, as floats.

    Examples
    --------
    >>> from scope_models.effects.noise import poisson_counts, stream
    >>> counts = poisson_counts(100.0, stream(1, "photon"), 10000)
    >>> bool(abs(counts.mean() - 100) < 0.4)
    True
    """
    return poisson_quantile(
        generator.standard_normal(np.shape(mean) if shape is None else shape), mean
    )


def add_read_noise(electrons, sigma, generator):
    """Add normal noise in place.

    Parameters
    ----------
    electrons : ndarray of float
        Electrons per cadence; changed in place.
    sigma : float or Quantity
        Standard deviation of all reads of a cadence together, electrons: the noise of one read
        times the square root of the number of reads.
    generator : numpy.random.Generator
        The stream of the effect.

    Returns
    -------
    ndarray
        ``electrons``.

    Examples
    --------
    >>> import numpy as np
    >>> from scope_models.effects.noise import add_read_noise, stream
    >>> noise = add_read_noise(np.zeros(10000), 90.0, stream(1, "read"))
    >>> bool(abs(noise.std() / 90 - 1) < 0.02)
    True
    """
    refuse_unit(electrons, "electrons")
    deviates = generator.standard_normal(electrons.shape)
    deviates *= plain_number(sigma, u.electron, "sigma")
    electrons += deviates
    return electrons


def add_quantization(electrons, gain, n_reads, generator):
    """Digitize in place: each read is rounded to whole numbers of ``gain`` electrons.

    The sum over the reads is a whole number of ``gain``. Its error has the variance
    ``n_reads * gain**2 / 12``: the errors of all reads but one are drawn together as normal
    noise, the last is the rounding of the sum itself.

    Parameters
    ----------
    electrons : ndarray of float
        Electrons per cadence; changed in place.
    gain : float or Quantity
        Electrons per digital number.
    n_reads : int
        Reads per cadence.
    generator : numpy.random.Generator
        The stream of the effect.

    Returns
    -------
    ndarray
        ``electrons``.

    Examples
    --------
    >>> import numpy as np
    >>> from scope_models.effects.noise import add_quantization, stream
    >>> float(add_quantization(np.array([344.0]), 110.0, 1, stream(1, "quantization"))[0])
    330.0
    """
    gain = plain_number(gain, u.electron / u.adu, "gain", equivalencies=DIGITAL)
    refuse_unit(electrons, "electrons")
    deviates = generator.standard_normal(electrons.shape)
    deviates *= gain * np.sqrt((n_reads - 1) / 12.0)
    electrons += deviates
    electrons /= gain
    np.rint(electrons, out=electrons)
    electrons *= gain
    return electrons
