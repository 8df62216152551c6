"""Positions of a star at each cadence: read from real files, scaled, or generated."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from numbers import Integral, Real
from types import MappingProxyType

import astropy.units as u
import numpy as np
from astropy.table import QTable

from scope_models._arrays import PER_PIXEL, plain_array, plain_time
from scope_models._checks import checked_choice, checked_int32, checked_integer, checked_number
from scope_models._docstrings import documented
from scope_models._values import Value, frozen, html_table
from scope_models.io._light_curves import ccd_name
from scope_models.io._opening import read_positions
from scope_models.io.pixels import (
    LARGEST_OFFSET,
    place_of,
    positions_of,
    read_pixels,
    usable_positions,
)
from scope_models.missions import MISSIONS, TIME_ZEROS
from scope_models.scene import _storage
from scope_models.scene._pointing import (
    FailingWheels,
    GroundTracking,
    K2Campaign18,
    K2FinalCampaign,
    K2Roll,
    KeplerPointing,
    RandomWalk,
    TESSPointing,
    first_time,
    generate,
)

__all__ = [
    "FailingWheels", "GroundTracking", "K2Campaign18", "K2FinalCampaign", "K2Roll",
    "KeplerPointing", "Motion", "MotionStatistics", "RandomWalk", "TESSPointing",
]  # fmt: skip


_KEPLER, _K2, _TESS = (MISSIONS[name] for name in ("Kepler", "K2", "TESS"))
# Flags of the mission that has a time format.
_QUALITY = {mission.time_format: mission.quality for mission in MISSIONS.values()}
_LONG = K2Roll.cadence  # days
_COLUMNS = ("time", "x", "y", "quality", "cadenceno")
_LAST = {18: K2Campaign18, 19: K2FinalCampaign}
_LONGER = "A longer series begins like a shorter one."
_BY_NAME = """cadence : str, float or Quantity, optional
    A cadence of the mission, by its name or length in seconds.
"""
_INTERVAL = """cadence : float or Quantity, optional
    Time between cadences, """


def _given(kind, number, further=""):
    """Return the arguments of a generator for its docstring."""
    return f"""Parameters
----------
n_cadences : int, optional
    Number of {number}
{further}seed : int or None, optional
    Seed of all random numbers; None takes a new one, which ``meta["seed"]`` holds.
start : float, Quantity or Time, optional
    Time of the first cadence, BKJD (`tess`, `ground`: BTJD); by default that of a campaign.
**parameters
    Fields of `~scope_models.scene.motion.{kind}` that differ from their defaults.

Returns
-------
Motion
    The motion.

Raises
------
TypeError, ValueError
    If an argument is of the wrong kind or out of its range.
"""


@dataclass(frozen=True)
class MotionStatistics(Value):
    """The row of a motion in a table of motions.

    Attributes
    ----------
    mean, std, maximum : ~astropy.units.Quantity
        Mean, standard deviation and maximum of the distance from the reference position, pixels.
    extent : ~astropy.units.Quantity
        Largest distance between any two positions, pixels.
    pixel_scale : ~astropy.units.Quantity
        Size of a pixel.
    n_cadences : int
        Number of cadences.

    Examples
    --------
    >>> from scope_models import Motion
    >>> Motion([0, 1], [0.0, 0.3], [0.0, 0.4]).statistics().maximum
    <Quantity 0.5 pix>
    """

    mean: u.Quantity
    std: u.Quantity
    maximum: u.Quantity
    extent: u.Quantity
    pixel_scale: u.Quantity
    n_cadences: int

    def __str__(self):
        unit = "px" if self.mean.unit == u.pix else str(self.mean.unit)
        return (
            f"{self.mean.value:.3f} +- {self.std.value:.3f} {unit}, "
            f"max {self.maximum.value:.3f} {unit}, extent {self.extent.value:.2f} {unit}"
        )

    def in_arcsec(self):
        """Return the same statistics as angles.

        Returns
        -------
        MotionStatistics
            Those with mean, std, maximum and extent in arcsec.
        """
        names, scale = ("mean", "std", "maximum", "extent"), u.pixel_scale(self.pixel_scale)
        return self.replace(**{name: getattr(self, name).to(u.arcsec, scale) for name in names})

    def to_table(self):
        """Return the statistics as a table of one row.

        Returns
        -------
        astropy.table.QTable
            The attributes, with units.
        """
        return QTable([vars(self)])


@dataclass(frozen=True, eq=False, repr=False)
class Motion(Value):
    """The positions of a star on the detector, cadence by cadence.

    Positions are offsets from a reference position and always finite; class methods read or
    generate them. ``c * motion`` scales the offsets, ``motion[a:b]``, ``motion[mask]`` and
    ``motion[i]`` choose cadences, and ``a + b`` joins motions, as `concatenate`.

    Parameters
    ----------
    time : array_like, Quantity or Time, shape (n,)
        Times in days, increasing strictly.
    x, y : array_like or Quantity, shape (n,)
        Offsets along columns (POS_CORR1) and rows (POS_CORR2) in pixels.
    quality : array_like of int, shape (n,), optional
        Quality flags; the default is 0.
    cadenceno : array_like of int, shape (n,), optional
        Cadence numbers, increasing strictly; the default is 1, 2, ... n.
    time_format : {"bkjd", "btjd"}, optional
        Zero of the times: BJD - 2454833 (Kepler, K2) or BJD - 2457000 (TESS).
    meta : mapping, optional
        What is known of the source.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or out of its range, or arrays differ in length.

    Examples
    --------
    >>> from scope_models import Motion
    >>> motion = Motion(time=[0.0, 0.5, 1.0], x=[0.0, 0.1, 0.2], y=[0.0, 0.0, -0.1])
    >>> (5 * motion[1:]).x
    array([0.5, 1. ])
    """

    time: np.ndarray
    x: np.ndarray
    y: np.ndarray
    quality: np.ndarray | None = None
    cadenceno: np.ndarray | None = None
    time_format: str = "bkjd"
    meta: Mapping = field(default_factory=dict)

    #: Standard deviations of x and y, pixels, if they are known.
    x_err = y_err = None
    # Arrays that a scale multiplies, and their standard deviations.
    offsets_of, errors_of = ("x", "y"), ()
    # numpy's scalars leave `scalar * motion` to this class.
    __array_ufunc__ = None

    def __post_init__(self):
        given = (getattr(self, name) for name in _COLUMNS)
        values = _checked_arrays(*given, self.time_format)
        for name, value in zip(_COLUMNS, values, strict=True):
            if not np.all(np.isfinite(value)):
                raise ValueError(
                    f"`{name}` must be finite, got {value[~np.isfinite(value)][0]}; "
                    "`Motion.from_arrays` interpolates or drops such cadences"
                )
            object.__setattr__(self, name, frozen(value))
        _check_increasing(self.time, "time")
        object.__setattr__(self, "meta", MappingProxyType(dict(self.meta)))

    def __repr__(self):
        first, last = self.time[0], self.time[-1]
        return (
            f"<Motion of {len(self)} cadences, {self.time_format.upper()} {first:.4f} to "
            f"{last:.4f}, x {self.x.min():.3g} to {self.x.max():.3g}, "
            f"y {self.y.min():.3g} to {self.y.max():.3g} px>"
        )

    def _repr_html_(self):
        known = {key: value for key, value in self.meta.items() if key != "generator"}
        return html_table(repr(self), {"distance": self.statistics(), **known})

    def __len__(self):
        return len(self.time)

    def __getitem__(self, item):
        if isinstance(item, Integral) and not isinstance(item, bool | np.bool_):
            item = [item]
        names = dict.fromkeys((*_COLUMNS, *self.offsets_of, *self.errors_of))
        return self.replace(**{name: getattr(self, name)[item] for name in names})

    def __mul__(self, factor):
        if isinstance(factor, u.Quantity) and factor.unit.is_equivalent(u.one) and factor.isscalar:
            factor = factor.to_value(u.one)[()]
        if not isinstance(factor, Real) or isinstance(factor, bool):
            return NotImplemented
        if not math.isfinite(factor):
            raise ValueError(f"the scale of a motion must be finite, got {factor}")
        scale = factor * self.meta.get("scale", 1)
        scaled = {name: factor * getattr(self, name) for name in self.offsets_of}
        scaled |= {name: abs(factor) * getattr(self, name) for name in self.errors_of}
        return self.replace(**scaled, meta={**self.meta, "scale": scale})

    __rmul__ = __mul__

    def __add__(self, other):
        if not isinstance(other, Motion):
            return NotImplemented
        return Motion.concatenate([self, other])

    @classmethod
    def from_arrays(
        cls, time, x, y, quality=None, *, cadenceno=None, time_format="bkjd", bad="interpolate",
        meta=None, pixel_scale=None,
    ):  # fmt: skip
        """Make a motion of arrays that may hold unusable values.

        Values that are not finite are unusable, and positions of 50 px or more, as archive files
        have where none was measured.

        Parameters
        ----------
        time : array_like, Quantity or Time, shape (n,)
            Times in days; a Time becomes days since the zero of ``time_format``.
        x, y : array_like or Quantity, shape (n,)
            Offsets along columns and rows in pixels, or angles with a ``pixel_scale``.
        quality : array_like of int, shape (n,), optional
            Quality flags; the default is 0.
        cadenceno : array_like of int, shape (n,), optional
            Cadence numbers, increasing strictly; the default is 1, 2, ... n.
        time_format : {"bkjd", "btjd"}, optional
            Zero of the times: BJD - 2454833 (Kepler, K2) or BJD - 2457000 (TESS).
        bad : {"interpolate", "drop", "error"}, optional
            "interpolate" (the default) replaces unusable values by a straight line in cadence
            number between usable neighbors (at the ends, positions stay and times go on at the
            same pace) and sets a quality flag that lightkurve's default bitmask rejects: "manual
            exclude" for a position, "no data" for a time if the mission has that bit. "drop" leaves
            the cadence out, "error" raises.
        meta : mapping, optional
            What is known of the source; "n_bad", the number of unusable cadences, is added.
        pixel_scale : float, Quantity or Detector, optional
            Size of a pixel in arcsec, to convert offsets that are angles.

        Returns
        -------
        Motion
            The motion.

        Raises
        ------
        TypeError, ValueError
            If an argument is of the wrong kind or out of its range, arrays differ in length, no
            value is usable, or one is not and ``bad`` is "error".

        Examples
        --------
        >>> from scope_models import Motion
        >>> motion = Motion.from_arrays([0, 1, 2], [0.1, -548.1, 0.3], [0.0, -393.2, 0.1])
        >>> motion.x, motion.quality
        (array([0.1, 0.2, 0.3]), array([  0, 256,   0], dtype=int32))
        """
        if pixel_scale is not None:
            pixel_scale = _checked_scale(getattr(pixel_scale, "pixel_scale", pixel_scale))
        checked_choice("bad", bad, ("interpolate", "drop", "error"))
        columns = _checked_arrays(time, x, y, quality, cadenceno, time_format, pixel_scale)
        lost, timeless = _unusable(*columns[:3], allowed=bad != "error")
        unusable = lost | timeless
        if bad == "drop":
            columns = [values[~unusable] for values in columns]
        else:
            columns = _interpolated(*columns, lost, timeless, _QUALITY[time_format])
        return cls(*columns, time_format, {**(meta or {}), "n_bad": int(unusable.sum())})

    @classmethod
    def from_file(cls, path, *, bad="interpolate", time_format=None):
        """Read the motion of a Kepler, K2 or TESS target pixel or light-curve file.

        The first table must have the columns TIME, POS_CORR1 and POS_CORR2; QUALITY (or
        SAP_QUALITY) and CADENCENO are read if they are there. Flagged cadences stay.

        Parameters
        ----------
        path : str or path-like
            The file: .fits or .fits.gz.
        bad : {"interpolate", "drop", "error"}, optional
            What becomes of unusable times and positions: see `from_arrays`.
        time_format : {"bkjd", "btjd"}, optional
            Zero of the times; by default that of the header, and "bkjd" if it has none.

        Returns
        -------
        Motion
            The motion; its ``meta`` has the name of the file and facts of its header.

        Raises
        ------
        OSError
            If the file cannot be opened.
        ValueError
            If it is no FITS file, lacks a column, or `from_arrays` refuses its columns.

        Examples
        --------
        >>> from scope_models import Detector, Motion, Star, simulate
        >>> path = simulate(Star(12.0), Detector.k2(), Motion.still(3), seed=1).write("star.fits")
        >>> Motion.from_file(path).x
        array([0., 0., 0.])
        """
        columns = read_positions(path)
        columns["time_format"] = time_format or columns["time_format"] or "bkjd"
        try:
            return cls.from_arrays(**columns, bad=bad)
        except (ValueError, TypeError) as error:
            raise ValueError(f"{path}: {error}") from error

    @classmethod
    def from_tpf(cls, tpf, *, bad="interpolate"):
        """Take the motion of a lightkurve target pixel file or light curve.

        The cadences are the object's: by default lightkurve leaves out flagged ones of a file.

        Parameters
        ----------
        tpf : lightkurve.TargetPixelFile or lightkurve.LightCurve
            The object; a light curve of an archive file.
        bad : {"interpolate", "drop", "error"}, optional
            What becomes of unusable times and positions: see `from_arrays`.

        Returns
        -------
        Motion
            The motion.

        Raises
        ------
        TypeError, ValueError
            If the object lacks a column, or `from_arrays` refuses its columns.

        Examples
        --------
        >>> from scope_models import Detector, Motion, Star, simulate
        >>> tpf = simulate(Star(12.0), Detector.k2(), Motion.still(3), seed=1).to_tpf()
        >>> Motion.from_tpf(tpf).x
        array([0., 0., 0.])
        """
        columns = positions_of(tpf)
        columns["time_format"] = columns["time_format"] or "bkjd"
        return cls.from_arrays(**columns, bad=bad)

    @classmethod
    def from_tpfs(cls, tpfs):
        """Find the motion that the stars of a CCD share.

        The positions of each star are those in its pixels, from a fit of one Gaussian and of the
        neighbors that are found, and POS_CORR where the file has it. They are an offset and a
        linear map of pointing, roll and scale of the cadence, at the star's place, with residuals
        of Student's t. Stars that the motion of the others explains no better than noise are left
        out, unless all are.

        Parameters
        ----------
        tpfs : lightkurve.TargetPixelFile, str or path-like, or a sequence of them
            Files with the same cadences. Those of the CCD with the most files are used.

        Returns
        -------
        scope_models.scene.common.CommonMotion
            The motion, about the place where it is known best. Its ``meta`` has ``stars``, the
            files that count, and ``left_out``, the reasons against others.

        Raises
        ------
        ValueError
            If no file has positions.

        Warns
        -----
        FitWarning
            If files are left out, or one file is all there is.

        Examples
        --------
        >>> from scope_models import Detector, Motion, Star, simulate
        >>> motion, detector = Motion.k2_roll(60, seed=1), Detector.k2(shape=(7, 7))
        >>> tpfs = [simulate(Star(11), detector, motion, seed=i).to_tpf() for i in range(3)]
        >>> bool(Motion.from_tpfs(tpfs).x_err.max() < 0.001)
        True
        """
        from scope_models.fitting._common import common_motion

        return common_motion(tpfs)

    @classmethod
    def still(cls, n_cadences, *, start=_K2.start, cadence=_LONG, time_format="bkjd"):
        """Make a motion that stays at the reference position.

        Parameters
        ----------
        n_cadences : int
            Number of cadences.
        start : float, Quantity or Time, optional
            Time of the first cadence, days; by default the beginning of K2 campaign 3.
        cadence : float or Quantity, optional
            Time between cadences, days; by default Kepler's long cadence.
        time_format : {"bkjd", "btjd"}, optional
            Zero of the times.

        Returns
        -------
        Motion
            The motion.

        Raises
        ------
        TypeError, ValueError
            If an argument is of the wrong kind or out of its range.

        Examples
        --------
        >>> from scope_models import Motion
        >>> Motion.still(3).x
        array([0., 0., 0.])
        """
        n = checked_integer("n_cadences", n_cadences, 1)
        cadence = checked_number("cadence", cadence, u.day, positive=True)
        time = first_time(start, time_format) + cadence * np.arange(n)
        return cls(time, np.zeros(n), np.zeros(n), time_format=time_format)

    @classmethod
    @documented(given=_given("K2Roll", f"long cadences. {_LONGER}"))
    def k2_roll(cls, n_cadences=1000, *, seed=10, start=_K2.start, **parameters):
        """Generate the motion of a K2 star while the spacecraft rolls about its boresight.

        By default it is that of EPIC 205998445 in campaign 3, with the first seed for which the
        statistics of 1000 cadences are those of the paper [1]_ within 5 %. Cadences in which
        thrusters fire are flagged.

        {given}

        References
        ----------
        .. [1] Saunders, N. et al., "The Pointing Limits of Transiting Exoplanet Light Curve
           Characterization with Pixel Level De-correlation", table 1.

        Examples
        --------
        >>> from scope_models import Motion
        >>> print(Motion.k2_roll().statistics())
        0.170 +- 0.118 px, max 0.595 px, extent 1.07 px
        """
        return cls(**generate(K2Roll(**parameters), n_cadences, _LONG, start, seed, _K2))

    @classmethod
    @documented(
        given=_given("KeplerPointing", "cadences; a quarter has about 4500 long ones.", _BY_NAME)
    )
    def kepler(cls, n_cadences=4500, *, cadence="long", seed=1, start=_KEPLER.start, **parameters):
        """Generate the motion of a Kepler star over a quarter, by default that of Kepler-62.

        {given}

        Examples
        --------
        >>> from scope_models import Motion
        >>> len(Motion.kepler(100))
        100
        """
        days = _KEPLER.cadence_days(cadence)
        return cls(**generate(KeplerPointing(**parameters), n_cadences, days, start, seed, _KEPLER))

    @classmethod
    @documented(given=_given("TESSPointing", "cadences; by default a sector.", _BY_NAME))
    def tess(cls, n_cadences=None, *, cadence="120 s", seed=1, start=_TESS.start, **parameters):
        """Generate the motion of a TESS star over a sector of two orbits.

        {given}

        Examples
        --------
        >>> from scope_models import Motion
        >>> motion = Motion.tess(cadence="1800 s")
        >>> len(motion), motion.time_format
        (1268, 'btjd')
        """
        pointing, days = TESSPointing(**parameters), _TESS.cadence_days(cadence)
        n = 2 * round(pointing.orbit_time / days) if n_cadences is None else n_cadences
        return cls(**generate(pointing, n, days, start, seed, _TESS, cadence=days))

    @classmethod
    @documented(
        given=_given(
            "K2FinalCampaign`, or `~scope_models.scene.motion.K2Campaign18",
            "long cadences; by default the whole campaign.",
            "campaign : {18, 19}, optional\n    The campaign.\n",
        )
    )
    def k2_final_campaign(cls, n_cadences=None, *, campaign=19, seed=1, start=None, **parameters):
        """Generate the motion of a star in one of K2's last campaigns.

        Cadences have the mission's numbers. Along the roll, stars of campaign 18 move by 9 to 21 %
        less than EPIC 211983544.

        {given}

        Examples
        --------
        >>> from scope_models import Motion
        >>> print(Motion.k2_final_campaign(campaign=18).statistics(exclude=4))
        0.127 +- 0.083 px, max 0.550 px, extent 0.92 px
        """
        if campaign not in _LAST:
            raise ValueError(f"`campaign` must be 18 or 19, got {campaign!r}")
        pointing = _LAST[campaign](**parameters)
        first, every = pointing.cadences
        n = every if n_cadences is None else n_cadences
        start = pointing.start if start is None else start
        motion = cls(**generate(pointing, n, _LONG, start, seed, _K2))
        number, meta = first + np.arange(len(motion)), {**motion.meta, "campaign": campaign}
        return motion.replace(cadenceno=number, meta=meta)

    @classmethod
    @documented(given=_given("GroundTracking", "exposures.", f"{_INTERVAL}s.\n"))
    def ground(cls, n_cadences=1000, *, cadence=60.0, seed=1, start=_TESS.start, **parameters):
        """Generate the motion of a star on a ground-based telescope, night by night.

        {given}

        Examples
        --------
        >>> from scope_models import Motion
        >>> len(Motion.ground(100, night=6.0))
        100
        """
        days = checked_number("cadence", cadence, u.s, positive=True) / 86400
        return cls(**generate(GroundTracking(**parameters), n_cadences, days, start, seed, _TESS))

    @classmethod
    @documented(given=_given("RandomWalk", f"cadences. {_LONGER}", f"{_INTERVAL}days.\n"))
    def random_walk(cls, n_cadences=1000, *, cadence=_LONG, seed=1, start=_K2.start, **parameters):
        """Generate a random walk for tests of correctors; no mission moves like this.

        {given}

        Examples
        --------
        >>> from scope_models import Motion
        >>> len(Motion.random_walk(100))
        100
        """
        days = checked_number("cadence", cadence, u.day, positive=True)
        return cls(**generate(RandomWalk(**parameters), n_cadences, days, start, seed, _K2))

    @classmethod
    @documented(given=_given("FailingWheels", f"cadences. {_LONGER}", f"{_INTERVAL}days.\n"))
    def failing_wheels(
        cls, n_cadences=1000, *, cadence=_LONG, seed=1, start=_K2.start, **parameters
    ):
        """Generate a drift with growing jumps for tests of correctors; no mission moves like this.

        {given}

        Examples
        --------
        >>> from scope_models import Motion
        >>> len(Motion.failing_wheels(100))
        100
        """
        days = checked_number("cadence", cadence, u.day, positive=True)
        return cls(**generate(FailingWheels(**parameters), n_cadences, days, start, seed, _K2))

    @classmethod
    def concatenate(cls, motions, *, shift=False):
        """Join motions one after the other.

        Parameters
        ----------
        motions : iterable of Motion
            The motions, in order.
        shift : bool, optional
            Whether times and cadence numbers are shifted so that each motion begins one (median)
            cadence after the one before.

        Returns
        -------
        Motion
            The motion; its ``meta`` is what all of them agree on.

        Raises
        ------
        ValueError
            If there are no motions, time formats differ, or times or cadence numbers do not
            increase.

        Examples
        --------
        >>> from scope_models import Motion
        >>> Motion.concatenate([Motion.still(2), Motion.still(2)], shift=True).cadenceno
        array([1, 2, 3, 4], dtype=int32)
        """
        motions = list(motions)
        if not motions:
            raise ValueError("`motions` is empty")
        first = motions[0]
        if any(motion.time_format != first.time_format for motion in motions):
            raise ValueError("`motions` must have one time format, got BKJD and BTJD")
        joined = [first]
        for motion in motions[1:]:
            joined.append(_shifted(motion, joined[-1]) if shift else motion)
            before, after = joined[-2:]
            if not (before.time[-1] < after.time[0] and before.cadenceno[-1] < after.cadenceno[0]):
                raise ValueError(
                    "times and cadence numbers must increase from one motion to the next; "
                    "`Motion.concatenate(motions, shift=True)` shifts them"
                )
        columns = (np.concatenate([getattr(m, name) for m in joined]) for name in _COLUMNS)
        metas = [motion.meta for motion in joined]
        common = {k: v for k, v in first.meta.items() if all(k in m and m[k] == v for m in metas)}
        return Motion(*columns, first.time_format, common)

    def offsets(self, tpf):
        """Return the offsets of the star of a file, in the cadences of the file.

        Parameters
        ----------
        tpf : lightkurve.TargetPixelFile, str, path-like or scope_models.io.PixelSeries
            The file.

        Returns
        -------
        offsets : ndarray of shape (n, 2)
            Along columns and rows, px; NaN in cadences that the motion lacks.
        errors : ndarray of shape (n, 2) or None
            Their standard deviations, px; None if the motion has none.

        Raises
        ------
        ValueError
            If the motion has none of the cadences, another zero of time, or is of another CCD.

        Examples
        --------
        >>> from scope_models import Detector, Motion, Star, simulate
        >>> motion = Motion.k2_roll(20, seed=1)
        >>> tpf = simulate(Star(12.0), Detector.k2(), motion[5:], seed=1).to_tpf()
        >>> motion.offsets(tpf)[0].shape
        (15, 2)
        """
        series = read_pixels(tpf)
        stamp = series.header, series.flux.shape[1:]
        return offsets_at(self, series.time, series.time_format, *stamp)

    @documented()
    def plot(self, ax=None, **options):
        """Draw the motion as a track, colored by time.

        Parameters
        ----------
        {ax}
        **options
            Arguments of `~scope_models.plotting.plot_motion`.

        {axes}

        Examples
        --------
        >>> from scope_models import Motion
        >>> Motion.k2_roll(100).plot().get_xlabel()
        'Column (pixel)'
        """
        from scope_models.plotting import plot_motion

        label = {"time_label": f"Time ({self.time_format.upper()})"}
        return plot_motion(self.time, self.x, self.y, ax=ax, **(label | options))

    read, write = classmethod(_storage.read), _storage.write

    def statistics(self, pixel_scale=_K2.pixel_scale, *, exclude=0):
        r"""Return how far the star is from its reference position.

        Mean, standard deviation and maximum are those of :math:`r = \sqrt{x^2 + y^2}`, as in
        table 1 of the paper [1]_.

        Parameters
        ----------
        pixel_scale : float or Quantity, optional
            Size of a pixel in arcsec; the default is Kepler's.
        exclude : int, optional
            Cadences with any of these quality flags are left out.

        Returns
        -------
        MotionStatistics
            The statistics.

        Raises
        ------
        TypeError, ValueError
            If an argument is of the wrong kind or out of its range, or no cadence is left.

        References
        ----------
        .. [1] Saunders, N. et al., "The Pointing Limits of Transiting Exoplanet Light Curve
           Characterization with Pixel Level De-correlation", table 1.

        Examples
        --------
        >>> from scope_models import Motion
        >>> print(Motion([0, 1, 2], [0.0, 0.3, 0.0], [0.1, 0.4, -0.1]).statistics())
        0.233 +- 0.189 px, max 0.500 px, extent 0.58 px
        """
        pixel_scale = _checked_scale(pixel_scale)
        keep = (self.quality & exclude) == 0
        if not keep.any():
            raise ValueError(f"all cadences have quality flags of `exclude`, {exclude}")
        x, y = self.x[keep], self.y[keep]
        r = np.hypot(x, y)
        values = (r.mean(), r.std(), r.max(), largest_distance(x, y))
        pixel = pixel_scale * u.arcsec / u.pix
        return MotionStatistics(*(float(value) * u.pix for value in values), pixel, len(r))


def _checked_scale(pixel_scale):
    options = {"positive": True, "equivalencies": PER_PIXEL}
    return checked_number("pixel_scale", pixel_scale, u.arcsec, **options)


def _cadence_of(*motions):
    """Return the median time between cadences of the first motion that has several, days."""
    return next((np.median(np.diff(motion.time)) for motion in motions if len(motion) > 1), _LONG)


def _shifted(motion, before):
    """Return the motion shifted in time to begin one cadence after another one."""
    first = before.time[-1] + _cadence_of(before, motion)
    number = motion.cadenceno.astype(np.int64) - motion.cadenceno[0] + (before.cadenceno[-1] + 1)
    return motion.replace(time=motion.time - motion.time[0] + first, cadenceno=number)


def as_pixels(value, name, n, pixel_scale=None):
    """Return a new one-dimensional array of n offsets in pixels."""
    return _of_length(plain_array(value, "pix", name, pixel_scale=pixel_scale), name, n)


def _of_length(values, name, n):
    if values.ndim != 1:
        raise ValueError(f"`{name}` must be one-dimensional, got shape {values.shape}")
    if len(values) != n:
        raise ValueError(f"`{name}` must have the length of `time`, {n}, got {len(values)}")
    return np.array(values)


def _checked_arrays(time, x, y, quality, cadenceno, time_format, pixel_scale=None):
    """Return new arrays of days, pixels, flags and growing numbers, all of one length."""
    checked_choice("time_format", time_format, TIME_ZEROS)
    time = plain_time(time, time_format, "time")
    n = time.size
    if n == 0:
        raise ValueError("`time` is empty: a motion must have at least one cadence")
    time = _of_length(time, "time", n)
    x, y = as_pixels(x, "x", n, pixel_scale), as_pixels(y, "y", n, pixel_scale)
    quality = checked_int32("quality", np.zeros(n, int) if quality is None else quality)
    number = checked_int32("cadenceno", np.arange(n) + 1 if cadenceno is None else cadenceno)
    quality, number = _of_length(quality, "quality", n), _of_length(number, "cadenceno", n)
    _check_increasing(number, "cadenceno")
    return time, x, y, quality, number


def _check_increasing(values, name):
    steps = np.flatnonzero(~(np.diff(values) > 0))
    if len(steps):
        i = steps[0] + 1
        found = f"{values[i]} after {values[i - 1]} at index {i}"
        raise ValueError(f"`{name}` must increase strictly, got {found}")


def _unusable(time, x, y, *, allowed):
    """Return where positions and where times are unusable; refuse them unless they are allowed."""
    lost, timeless = ~usable_positions(np.column_stack([x, y])), ~np.isfinite(time)
    unusable = lost | timeless
    limit = f"NaN or at least {LARGEST_OFFSET:g} px"
    for noun, wrong, reason in (("position", lost, limit), ("time", timeless, "NaN")):
        if wrong.all():
            raise ValueError(f"no usable {noun}: all of {len(time)} are {reason}")
    if unusable.all():
        raise ValueError("no cadence with both a usable time and a usable position")
    if unusable.any() and not allowed:
        raise ValueError(
            f"{lost.sum()} positions are {limit}, and {timeless.sum()} times are NaN, "
            f"the first of them at index {np.flatnonzero(unusable)[0]}"
        )
    return lost, timeless


def _interpolated(time, x, y, flags, number, lost, timeless, bits):
    """Interpolate in cadence number, and flag; beyond the ends times go on at the median pace."""
    flags[lost] |= bits.manual_exclude
    flags[timeless] |= bits.no_data or bits.manual_exclude
    x, y = (np.interp(number, number[~lost], values[~lost]) for values in (x, y))
    if timeless.any():
        known, values = number[~timeless].astype(float), time[~timeless]
        _check_increasing(values, "time")
        if len(values) == 1:
            raise ValueError("`time` must have at least two usable values to interpolate others")
        pace = np.median(np.diff(values) / np.diff(known))
        filled = np.interp(number, known, values)
        filled += pace * (np.minimum(number - known[0], 0) + np.maximum(number - known[-1], 0))
        time = np.where(timeless, filled, time)
    return time, x, y, flags, number


def offsets_at(motion, time, time_format, cards, shape):
    """Return what `Motion.offsets` does, for the cards and the shape of a stamp."""
    if time_format != motion.time_format:
        times = f"{motion.time_format.upper()}, those of the file {time_format.upper()}"
        raise ValueError(f"the times of the motion are {times}")
    if (ccd := motion.meta.get("ccd")) and (other := ccd_name(cards)) not in {"", ccd}:
        raise ValueError(f"the motion belongs to {ccd}, the file to {other}")
    middles = (motion.time[1:] + motion.time[:-1]) / 2
    at = np.searchsorted(middles, time)
    known = np.abs(time - motion.time[at]) < _cadence_of(motion) / 2
    if not known.any():
        raise ValueError("the motion has none of the cadences of the file")
    place = place_of(cards, shape)
    moved = motion.at(*place) if place is not None and hasattr(motion, "at") else motion
    pairs = [(moved.x, moved.y), (moved.x_err, moved.y_err)]
    return tuple(None if x is None else np.where(known, [x[at], y[at]], np.nan).T for x, y in pairs)


def largest_distance(x, y):
    """Return the largest distance between any two points, both corners of the hull."""
    # Imported here, because it takes as long as a third of the package.
    from scipy.spatial import ConvexHull, QhullError
    from scipy.spatial.distance import pdist

    points = np.column_stack([x, y])
    points = points - points.mean(axis=0)
    try:
        hull = points[ConvexHull(points).vertices]
    except QhullError:
        # All points lie on a line, or there are fewer than three.
        along = points @ np.linalg.svd(points, full_matrices=False)[2][0]
        return float(np.ptp(along))
    return float(pdist(hull).max())
