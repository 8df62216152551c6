r"""Effects on light in the telescope and in the pixels: where it falls, and the response to it.

Where the focus changes, all distances from the star's position scale with the relative width w,
and the flux stays: :math:`p_w(x, y) = p(x_0 + (x - x_0) / w, y_0 + (y - y_0) / w) / w^2`.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.polynomial import legendre

from scope_models._arrays import plain_array, plain_time
from scope_models._checks import integer, number
from scope_models._values import frozen
from scope_models.effects._noise import correlated
from scope_models.effects.base import (
    Drawn,
    Effect,
    Exposures,
    checked_series,
    number_of_events,
    per_cadence,
    series_of,
)

__all__ = ["Focus", "Gaps", "Jitter", "PixelShares", "SensitivityDropouts", "Throughput"]

_SLOW_DEGREE = 3  # the highest in position of terms that change in time


def _checked_times(name, values):
    return checked_series(name, plain_time(values, None, name), "day")


@dataclass(frozen=True, eq=False, repr=False)
class Focus(Effect):
    r"""The width of the PSF as a sinusoid, a thermal response to events, or a series.

    .. math:: w(t) = s(t) \left[1 + a \sin\left(2 \pi \left(\frac{t}{P} + \phi\right)\right)
              + h \sum_{t_i \le t} e^{-(t - t_i) / \tau}\right]

    Parameters
    ----------
    amplitude : float, optional
        Semi-amplitude a of the relative width. Widths of real K2 stars change by up to about 1 %
        over a campaign.
    period : float or Quantity, optional
        Period P, days.
    phase : float, optional
        Phase :math:`\phi` at time 0, in periods.
    thermal : float, optional
        Relative change h right after each event.
    thermal_time : float or Quantity, optional
        Time :math:`\tau` in which the change after an event decays, days.
    events : array_like or Quantity, optional
        Times :math:`t_i` of the events, as momentum dumps, days.
    series : array_like, optional
        Relative width s of each cadence; the default is 1.

    Notes
    -----
    The truth has the relative width of each cadence in the column FOCUS.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> from scope_models.effects import Focus
    >>> scene = Star(12.0), Detector.k2(), Motion.still(500)
    >>> truth = simulate(*scene, seed=1, effects=Focus(0.01, period=0.5)).truth
    >>> print(truth.columns["FOCUS"].max().round(3))
    1.01
    """

    amplitude: float = number(0.0, any_sign=True, below=1)
    period: float = number(1.0, "day", positive=True)
    phase: float = number(0.0, any_sign=True)
    thermal: float = number(0.0, any_sign=True)
    thermal_time: float = number(1.0, "day", positive=True)
    events: np.ndarray = field(default=(), metadata={"check": _checked_times})
    series: np.ndarray | None = field(default=None, metadata=per_cadence())

    def draw(self, conditions, generator):
        time = conditions.time
        width = 1 + self.amplitude * np.sin(2 * np.pi * (time / self.period + self.phase))
        for event in self.events:
            since = np.maximum(time - event, 0.0)
            width += self.thermal * np.exp(-since / self.thermal_time) * (time >= event)
        if self.series is not None:
            width *= series_of(self.series, time, "series", "width")
        return Drawn({"FOCUS": width})

    def width(self, drawn, conditions):
        return drawn.columns["FOCUS"]


@dataclass(frozen=True, eq=False, repr=False)
class Jitter(Effect):
    r"""Random motion of the pointing during exposures, white or with a correlation time.

    Along each axis the pointing is a stationary Gauss-Markov process of the variance
    :math:`\sigma^2` and the correlation time :math:`\tau`. Over a cadence of the length T its mean
    has the variance

    .. math:: \sigma_m^2 = 2 \sigma^2 r \left[1 - r \left(1 - e^{-1 / r}\right)\right],
              \qquad r = \tau / T,

    and is correlated from cadence to cadence. The rest, :math:`\sigma^2 - \sigma_m^2`, widens the
    image: exactly for Gaussian PSFs; others are rendered at Gauss-Hermite nodes.

    Parameters
    ----------
    rms : float or Quantity
        Standard deviation :math:`\sigma` along each axis, pixels.
    correlation_time : float or Quantity, optional
        Correlation time :math:`\tau`, s. 0 is white noise at the frame rate.
    nodes : int, optional
        Nodes per axis for PSFs that are not Gaussian, which are rendered at ``nodes**2`` places
        per cadence. 3 give all moments of the image up to the fifth.

    Notes
    -----
    The truth has the mean offset of each cadence in the columns JITTER_X and JITTER_Y, which the
    positions X1, Y1 of the stars contain, and the standard deviation within it in JITTER_BLUR;
    pixels.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> from scope_models.effects import Jitter
    >>> scene = Star(12.0), Detector.k2(), Motion.still(500)
    >>> truth = simulate(*scene, seed=1, effects=Jitter(0.05)).truth
    >>> print(truth.columns["JITTER_BLUR"].max().round(3))
    0.05
    """

    rms: float = number(unit="pix")
    correlation_time: float = number(0.0, "s")
    nodes: int = integer(3, 1)

    def draw(self, conditions, generator):
        n, length = len(conditions.time), conditions.cadence_days * 86400
        r = max(self.correlation_time / length, 0.5 / conditions.n_frames)
        kept = np.exp(-1 / r)
        variance = 2 * r * (1 - r * (1 - kept))
        # The mean of a cadence follows from the pointing at its ends, but for a part of its own.
        ends = r * (1 - kept) / (1 + kept)
        own = np.sqrt(max(variance - 2 * ends * r * (1 - kept), 0.0))
        offsets = {}
        for axis in "XY":
            pointing = correlated(generator, n + 1, r)
            mean = ends * (pointing[1:] + pointing[:-1]) + own * generator.standard_normal(n)
            offsets[f"JITTER_{axis}"] = self.rms * mean
        blur = self.rms * np.sqrt(max(1 - variance, 0.0))
        return Drawn(offsets | {"JITTER_BLUR": np.full(n, blur)})

    def exposures(self, drawn, conditions):
        x, y, blur = (drawn.columns[f"JITTER_{name}"][:, np.newaxis] for name in ("X", "Y", "BLUR"))
        return Exposures(x, y, np.ones(1), blur.item(0), self.nodes)


@dataclass(frozen=True, eq=False, repr=False)
class PixelShares(Effect):
    r"""Shares of a star's light in each pixel beyond its PSF: smooth in position and slow time.

    .. math:: S_p(x, y, t) = P_p(x, y) + \sum_{ijk} c_{p,ijk}\, L_i(u)\, L_j(v)\, L_k(w)

    with the PSF's (and sensitivity's) share P of unit flux, Legendre polynomials L, and the
    star's position and the time scaled to -1..1 as u, v and w; outside the ranges the nearest
    place or time counts. `fit_tpf(..., response="pixels") <scope_models.fit_tpf>` measures them.

    Parameters
    ----------
    coefficients : array_like of shape (k, ny, nx)
        Coefficients c, in the order of `terms`.
    x_range, y_range : tuple of float, optional
        Least and largest column and row of the star, pixels of the stamp.
    time_range : tuple of float, optional
        First and last time, days.
    degree, time_degree : int, optional
        Largest i + j, which is 3 at most if k > 0, and largest k.
    star : int, optional
        Number of the star in the scene.

    Notes
    -----
    A share that would be negative is zero in a simulation.

    Examples
    --------
    >>> import numpy as np
    >>> from scope_models.effects import PixelShares
    >>> moved = np.zeros((1, 11, 11))
    >>> moved[0, 0, 0], moved[0, 5, 5] = 0.01, -0.01
    >>> print(PixelShares(moved).changes([5.0], [5.0], [0.5])[0, 0, 0])
    0.01
    """

    coefficients: np.ndarray
    x_range: tuple[float, float] = number((0.0, 1.0), "pix")
    y_range: tuple[float, float] = number((0.0, 1.0), "pix")
    time_range: tuple[float, float] = number((0.0, 1.0), "day")
    degree: int = integer(0, 0)
    time_degree: int = integer(0, 0)
    star: int = integer(0, 0)

    def __post_init__(self):
        super().__post_init__()
        values = plain_array(self.coefficients, "", "coefficients")
        for name in ("x_range", "y_range", "time_range"):
            low, high = getattr(self, name)
            if not low < high:
                raise ValueError(f"`{name}` must increase, got {(low, high)}")
        if values.ndim != 3 or len(values) != len(self.terms) or not np.isfinite(values).all():
            wanted = f"finite, of shape ({len(self.terms)}, ny, nx)"
            raise ValueError(f"`coefficients` must be {wanted}, got {values.shape}")
        object.__setattr__(self, "coefficients", frozen(values))

    @property
    def terms(self):
        """Degrees i, j, k of the terms, shape ``(k, 3)``."""
        return polynomial_terms(self.degree, self.time_degree)

    def changes(self, x, y, time):
        """Return the difference between the shares and the PSF's.

        Parameters
        ----------
        x, y : array_like of shape (n,)
            Column and row of the star, pixels.
        time : array_like of shape (n,)
            Days.

        Returns
        -------
        ndarray of shape (n, ny, nx)
            Parts of the star's flux.
        """
        pairs = (x, self.x_range), (y, self.y_range), (time, self.time_range)
        scaled = (scaled_to(*pair) for pair in pairs)
        return np.tensordot(polynomials(self.terms, *scaled)[0], self.coefficients, axes=1)

    def shares(self, drawn, conditions, star):
        if star != self.star:
            return None
        own, wanted = self.coefficients.shape[1:], tuple(conditions.shape)
        if own != wanted:
            raise ValueError(f"`coefficients` must be for {wanted} pixels, got {own}")
        return lambda x, y, part: self.changes(x, y, conditions.time[part])


def polynomial_terms(degree, time_degree):
    """Return the degrees i, j, k of the terms, lowest first, ``(k, 3)``."""
    terms = []
    for k in range(time_degree + 1):
        for n in range((min(degree, _SLOW_DEGREE) if k else degree) + 1):
            terms += [(i, n - i, k) for i in range(n + 1)]
    return np.array(terms)


def scaled_to(values, limits):
    """Return values scaled to -1..1 between limits, and the nearest of these outside."""
    low, high = limits
    return np.clip(2 * (np.asarray(values, dtype=float) - low) / (high - low) - 1, -1.0, 1.0)


def polynomials(terms, u, v, w):
    """Return the products of Legendre polynomials, and their derivatives by u and v, ``(n, k)``."""
    degrees = terms.max(axis=0)
    tables = [legendre.legvander(x, n) for x, n in zip((u, v, w), degrees, strict=True)]
    columns, rows, times = (t[:, terms[:, axis]] for axis, t in enumerate(tables))
    by_u, by_v = (
        (tables[axis][:, : max(n, 1)] @ legendre.legder(np.eye(n + 1)))[:, terms[:, axis]]
        for axis, n in enumerate(degrees[:2])
    )
    return columns * rows * times, by_u * rows * times, columns * by_v * times


@dataclass(frozen=True, eq=False, repr=False)
class Throughput(Effect):
    r"""Response of all pixels that changes in time, as with the temperature.

    .. math:: s(t) = s_0(t) \left[1 + a \sin\left(2 \pi \left(\frac{t}{P} + \phi\right)\right)
              + d\,(t - t_m)\right]

    with the middle :math:`t_m` of the series. The background has the factor, too.

    Parameters
    ----------
    amplitude : float, optional
        Relative semi-amplitude a.
    period : float or Quantity, optional
        Period P, days.
    phase : float, optional
        Phase :math:`\phi` at time 0, in periods.
    drift : float or Quantity, optional
        Relative change d per day.
    series : array_like, optional
        Factor :math:`s_0` of each cadence, such as a temperature times its coefficient, plus 1.

    Notes
    -----
    The truth has the factor of each cadence in the column THROUGHPUT.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> from scope_models.effects import Throughput
    >>> scene = Star(12.0), Detector.k2(), Motion.still(500)
    >>> truth = simulate(*scene, seed=1, effects=Throughput(drift=-0.01)).truth
    >>> print(truth.columns["THROUGHPUT"].max().round(3))
    1.051
    """

    amplitude: float = number(0.0, any_sign=True)
    period: float = number(1.0, "day", positive=True)
    phase: float = number(0.0, any_sign=True)
    drift: float = number(0.0, "1 / day", any_sign=True)
    series: np.ndarray | None = field(default=None, metadata=per_cadence())

    def draw(self, conditions, generator):
        time = conditions.time
        factor = 1 + self.amplitude * np.sin(2 * np.pi * (time / self.period + self.phase))
        factor += self.drift * (time - (time[0] + time[-1]) / 2)
        if self.series is not None:
            factor *= series_of(self.series, time, "series", "factor")
        if np.any(factor < 0):
            raise ValueError(f"the response must not be negative, got {factor.min():g}")
        return Drawn({"THROUGHPUT": factor})

    def response(self, drawn, conditions, part):
        return drawn.columns["THROUGHPUT"][part, np.newaxis, np.newaxis]


@dataclass(frozen=True, eq=False, repr=False)
class SensitivityDropouts(Effect):
    r"""Sudden losses of single pixels' sensitivity that recover in part.

    After a dropout of the depth d at :math:`t_0`, the pixel's response has the factor

    .. math:: 1 - d \left[1 - k + k\, e^{-(t - t_0) / \tau}\right] .

    Parameters
    ----------
    rate : float or Quantity, optional
        Mean number of dropouts per pixel and day; the default is assumed.
    depth : float, optional
        Mean depth; depths are distributed exponentially, up to 1. The default is assumed.
    recovery : float, optional
        Part k of the depth that recovers.
    recovery_time : float or Quantity, optional
        Time :math:`\tau` of the recovery, days.

    Notes
    -----
    The truth has the list SENSITIVITYDROPOUTS with CADENCE (from 0), ROW, COLUMN and DEPTH.
    Cadences in which a dropout happens have the mission's quality bit, where it has one.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> from scope_models.effects import SensitivityDropouts
    >>> scene = Star(12.0), Detector.k2(), Motion.still(500)
    >>> truth = simulate(*scene, seed=1, effects=SensitivityDropouts(rate=0.005)).truth
    >>> len(truth.tables["SENSITIVITYDROPOUTS"])
    4
    """

    rate: float = number(1e-4, "1 / day")
    depth: float = number(0.005, at_most=1)
    recovery: float = number(0.5, at_most=1)
    recovery_time: float = number(0.1, "day", positive=True)

    def draw(self, conditions, generator):
        (ny, nx), n_cadences = conditions.shape, len(conditions.time)
        n = number_of_events(generator, self.rate * ny * nx * n_cadences * conditions.cadence_days)
        events = {
            "CADENCE": np.sort(generator.integers(n_cadences, size=n)),
            "ROW": generator.integers(ny, size=n),
            "COLUMN": generator.integers(nx, size=n),
            "DEPTH": np.minimum(self.depth * generator.standard_exponential(n), 1.0),
        }
        return Drawn(tables={"SENSITIVITYDROPOUTS": events})

    def response(self, drawn, conditions, part):
        time, events = conditions.time[part], drawn.tables["SENSITIVITYDROPOUTS"]
        factor = np.ones((len(time), *conditions.shape))
        for cadence, row, column, depth in zip(*events.values(), strict=True):
            since = np.maximum(time - conditions.time[cadence], 0.0)
            lasting = 1 - self.recovery + self.recovery * np.exp(-since / self.recovery_time)
            factor[:, row, column] *= 1 - depth * lasting * (time >= conditions.time[cadence])
        return factor

    def quality(self, drawn, conditions):
        flags, events = np.zeros(len(conditions.time), int), drawn.tables["SENSITIVITYDROPOUTS"]
        flags[events["CADENCE"]] = conditions.bit("sensitivity_dropout")
        return flags


@dataclass(frozen=True, eq=False, repr=False)
class Gaps(Effect):
    """Intervals in which nothing is recorded.

    Flux and errors are NaN, raw counts -1, and the mission's quality bit for cadences without
    data is set; where there is none, as with TESS, that for exclusion.

    Parameters
    ----------
    intervals : array_like or Quantity, shape (n, 2)
        Begin and end of each gap, days in the format of the motion.

    Notes
    -----
    The truth has 1 in the column GAPS for each cadence without data, else 0, and positions and
    light in all.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> from scope_models.effects import Gaps
    >>> scene = Star(12.0), Detector.k2(), Motion.still(500)
    >>> truth = simulate(*scene, seed=1, effects=Gaps([scene[2].time[2:4]])).truth
    >>> print(truth.columns["GAPS"].sum())
    2.0
    """

    intervals: np.ndarray

    def __post_init__(self):
        intervals = plain_array(self.intervals, "day", "intervals")
        if intervals.ndim != 2 or intervals.shape[1] != 2 or not np.all(np.isfinite(intervals)):
            shape = intervals.shape
            raise ValueError(f"`intervals` must be finite and of the shape (n, 2), got {shape}")
        plain_time(intervals[:, 0], None, "intervals")  # no Julian dates; an end may be far away
        if np.any(intervals[:, 1] < intervals[:, 0]):
            raise ValueError("`intervals` must not end before they begin")
        object.__setattr__(self, "intervals", frozen(intervals))

    def draw(self, conditions, generator):
        time = conditions.time[:, np.newaxis]
        inside = (time >= self.intervals[:, 0]) & (time <= self.intervals[:, 1])
        return Drawn({"GAPS": inside.any(axis=1).astype(float)})

    def missing(self, drawn, conditions):
        return drawn.columns["GAPS"] > 0

    def quality(self, drawn, conditions):
        bit = conditions.bit("no_data") or conditions.bit("manual_exclude")
        return bit * self.missing(drawn, conditions)
