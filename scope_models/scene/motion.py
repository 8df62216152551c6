"""Positions of a star at each cadence: read from real files, scaled, or generated."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from numbers import Integral, Real
from pathlib import Path
from types import MappingProxyType

import astropy.units as u
import numpy as np

from scope_models._arrays import PER_PIXEL, plain_tree
from scope_models._checks import checked_number
from scope_models._docstrings import documented
from scope_models._values import Value, html_table
from scope_models.io._atomic import atomic_path
from scope_models.io.pixels import positions_of
from scope_models.io.reading import read_positions
from scope_models.missions import MISSIONS
from scope_models.scene import _generators
from scope_models.scene._k2_roll import K2Campaign18, K2FinalCampaign, K2Roll
from scope_models.scene._motion_arrays import (
    MotionStatistics,
    as_int32,
    as_pixels,
    as_times,
    check_increasing,
    repair,
)
from scope_models.scene._pointing import (
    FailingWheels,
    GroundTracking,
    KeplerPointing,
    RandomWalk,
    TESSPointing,
)

__all__ = [
    "FailingWheels",
    "GroundTracking",
    "K2Campaign18",
    "K2FinalCampaign",
    "K2Roll",
    "KeplerPointing",
    "Motion",
    "MotionStatistics",
    "RandomWalk",
    "TESSPointing",
]


@dataclass(frozen=True, eq=False, repr=False)
class Motion(Value):
    """The positions of a star on the detector, cadence by cadence.

    Positions are offsets from a reference position and always finite. Usually one of the class
    methods makes the object: `from_file`, `from_tpf`, `from_arrays`, `still` or `k2_roll`.
    ``c * motion`` scales the offsets, ``motion[a:b]`` and ``motion[mask]`` choose cadences (an
    integer gives a motion of one cadence), and ``a + b`` joins two motions if the second one
    begins after the first (else see `concatenate`). Two motions are equal if all their values are.

    Parameters
    ----------
    time : array_like, Quantity or Time, shape (n,)
        Times in days, increasing strictly.
    x, y : array_like or Quantity, shape (n,)
        Offsets along columns (POS_CORR1) and rows (POS_CORR2) in pixels; `from_arrays` converts
        angles.
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
    ValueError
        If there are no cadences, if the arrays differ in length, if a number is not finite, or if
        times or cadence numbers do not increase.
    TypeError
        If flags or cadence numbers are not integers.

    Examples
    --------
    >>> from scope_models import Motion
    >>> motion = Motion(time=[0.0, 0.5, 1.0], x=[0.0, 0.1, 0.2], y=[0.0, 0.0, -0.1])
    >>> (5 * motion).x
    array([0. , 0.5, 1. ])
    >>> len(motion[1:])
    2
    >>> len(motion + Motion([2.0], [0.0], [0.0], cadenceno=[7]))
    4
    """

    time: np.ndarray
    x: np.ndarray
    y: np.ndarray
    quality: np.ndarray | None = None
    cadenceno: np.ndarray | None = None
    time_format: str = "bkjd"
    meta: Mapping = field(default_factory=dict)

    # numpy's scalars leave `scalar * motion` to this class.
    __array_ufunc__ = None

    def __post_init__(self):
        time = as_times(self.time, self.time_format)
        n = len(time)
        quality = np.zeros(n, dtype=np.int32) if self.quality is None else self.quality
        cadenceno = np.arange(1, n + 1) if self.cadenceno is None else self.cadenceno
        values = {"time": time}
        values |= {name: as_pixels(getattr(self, name), name, n) for name in ("x", "y")}
        for name, value in values.items():
            if not np.all(np.isfinite(value)):
                raise ValueError(
                    f"`{name}` must be finite, got {value[~np.isfinite(value)][0]}; "
                    "`Motion.from_arrays` interpolates or drops such cadences"
                )
        values["quality"] = as_int32(quality, "quality", n)
        values["cadenceno"] = as_int32(cadenceno, "cadenceno", n)
        check_increasing(values["time"], "time")
        check_increasing(values["cadenceno"], "cadenceno")
        for name, value in values.items():
            value.flags.writeable = False
            object.__setattr__(self, name, value)
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
            if not -len(self) <= item < len(self):
                raise IndexError(f"cadence {item} is out of range for {len(self)} cadences")
            item = [item]
        return self.replace(
            time=self.time[item],
            x=self.x[item],
            y=self.y[item],
            quality=self.quality[item],
            cadenceno=self.cadenceno[item],
        )

    def __mul__(self, factor):
        if isinstance(factor, u.Quantity) and factor.unit.is_equivalent(u.one) and factor.isscalar:
            factor = factor.to_value(u.one)[()]
        if not isinstance(factor, Real) or isinstance(factor, bool):
            return NotImplemented
        if not math.isfinite(factor):
            raise ValueError(f"the scale of a motion must be finite, got {factor}")
        scale = factor * self.meta.get("scale", 1)
        return self.replace(
            x=factor * self.x, y=factor * self.y, meta={**self.meta, "scale": scale}
        )

    __rmul__ = __mul__

    def __add__(self, other):
        if not isinstance(other, Motion):
            return NotImplemented
        return Motion.concatenate([self, other])

    @classmethod
    def from_arrays(
        cls,
        time,
        x,
        y,
        quality=None,
        *,
        cadenceno=None,
        time_format="bkjd",
        bad="interpolate",
        meta=None,
        pixel_scale=None,
    ):
        """Make a motion of arrays that may hold unusable values.

        A position is unusable if x or y is not finite, or is 50 px or more: archive files have
        such values where no position was measured. A time is unusable if it is not finite.

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
            What becomes of cadences with an unusable value. "interpolate" (the default) replaces
            it by a straight line in cadence number between its usable neighbors (before the first
            and after the last, positions stay and times go on at the same pace) and sets a
            quality flag that lightkurve's default bitmask rejects: "manual exclude" (256, in TESS
            times 128) for a position, "no data" (65536; in TESS times "manual exclude") for a
            time. "drop" leaves the cadence out, "error" raises.
        meta : mapping, optional
            What is known of the source; "n_bad", the number of cadences with unusable values,
            is added to it.
        pixel_scale : float, Quantity or Detector, optional
            Size of a pixel in arcsec, to convert offsets that are angles.

        Returns
        -------
        Motion
            The motion.

        Raises
        ------
        ValueError
            If the arrays differ in length, if no position is usable, if times do not increase or
            are Julian dates, if a unit does not convert, or if ``bad="error"`` and there are
            unusable values.

        Examples
        --------
        >>> import numpy as np
        >>> from scope_models import Motion
        >>> motion = Motion.from_arrays([0, 1, 2], [0.1, -548.1, 0.3], [0.0, -393.2, np.nan])
        >>> motion.x, motion.y
        (array([0.1, 0.1, 0.1]), array([0., 0., 0.]))
        >>> motion.quality
        array([  0, 256, 256], dtype=int32)
        >>> len(Motion.from_arrays([0, 1, 2], [0.1, -548.1, 0.3], [0, 0, 0], bad="drop"))
        2
        >>> import astropy.units as u
        >>> Motion.from_arrays([0, 24] * u.hour, [0, 7.96] * u.arcsec, [0, 0], pixel_scale=3.98).x
        array([0., 2.])
        """
        if pixel_scale is not None:
            pixel_scale = getattr(pixel_scale, "pixel_scale", pixel_scale)
            pixel_scale = _checked_scale(pixel_scale)
        *columns, n_bad = repair(
            time,
            x,
            y,
            quality,
            cadenceno,
            time_format=time_format,
            bad=bad,
            pixel_scale=pixel_scale,
        )
        return cls(*columns, time_format, {**(meta or {}), "n_bad": n_bad})

    @classmethod
    def from_file(cls, path, *, bad="interpolate", time_format=None):
        """Read the motion of a Kepler, K2 or TESS target pixel or light-curve file.

        The file's first table must have the columns TIME, POS_CORR1 and POS_CORR2; QUALITY (or
        SAP_QUALITY) and CADENCENO are read if they are there. No cadence is left out because of
        its quality flags.

        Parameters
        ----------
        path : str or path-like
            The file: .fits or .fits.gz.
        bad : {"interpolate", "drop", "error"}, optional
            What becomes of cadences with an unusable time or position: see `from_arrays`.
        time_format : {"bkjd", "btjd"}, optional
            Zero of the times. The default is that of the header, and "bkjd" if it has none.

        Returns
        -------
        Motion
            The motion; its ``meta`` has the header's mission, object, campaign, quarter
            or sector, position on the sky and detector, and the name of the file.

        Raises
        ------
        FileNotFoundError, IsADirectoryError
            If there is no such file, or it is a folder.
        ValueError
            If it cannot be read as a FITS file, if it lacks a column (both are named), or if its
            columns are refused by `from_arrays`.

        Examples
        --------
        >>> from astropy.table import Table
        >>> from scope_models import Motion
        >>> columns = {"TIME": [0.0, 0.02], "POS_CORR1": [0.0, 0.1], "POS_CORR2": [0.0, -0.2]}
        >>> Table(columns).write("motion.fits")
        >>> Motion.from_file("motion.fits")
        <Motion of 2 cadences, BKJD 0.0000 to 0.0200, x 0 to 0.1, y -0.2 to 0 px>
        """
        columns = read_positions(path)
        try:
            return cls._of_columns(columns, bad, time_format)
        except (ValueError, TypeError) as error:
            raise ValueError(f"{path}: {error}") from error

    @classmethod
    def from_tpf(cls, tpf, *, bad="interpolate"):
        """Take the motion of a lightkurve target pixel file or light curve.

        The cadences are those that the object has: lightkurve leaves out cadences by their quality
        flags when it reads a file, by default.

        Parameters
        ----------
        tpf : lightkurve.TargetPixelFile or lightkurve.LightCurve
            The object. Light curves have positions if they were read from archive files.
        bad : {"interpolate", "drop", "error"}, optional
            What becomes of cadences with an unusable time or position: see `from_arrays`.

        Returns
        -------
        Motion
            The motion.

        Raises
        ------
        TypeError
            If the object has no time, or no POS_CORR1 and POS_CORR2.
        ValueError
            If its values are refused by `from_arrays`.

        Examples
        --------
        >>> from lightkurve import LightCurve
        >>> from scope_models import Motion
        >>> lc = LightCurve(time=[1.0, 2.0], flux=[1.0, 1.0])
        >>> lc["pos_corr1"], lc["pos_corr2"] = [0.0, 0.2], [0.1, 0.1]
        >>> Motion.from_tpf(lc).x
        array([0. , 0.2])
        """
        return cls._of_columns(positions_of(tpf), bad)

    @classmethod
    def _of_columns(cls, columns, bad, time_format=None):
        """Return the motion of the columns of a file."""
        return cls.from_arrays(
            columns.time,
            columns.pos_corr1,
            columns.pos_corr2,
            columns.quality,
            cadenceno=columns.cadenceno,
            time_format=time_format or columns.time_format or "bkjd",
            bad=bad,
            meta=columns.meta,
        )

    still = classmethod(_generators.still)
    k2_roll = classmethod(_generators.k2_roll)
    kepler = classmethod(_generators.kepler)
    tess = classmethod(_generators.tess)
    k2_final_campaign = classmethod(_generators.k2_final_campaign)
    ground = classmethod(_generators.ground)
    random_walk = classmethod(_generators.random_walk)
    failing_wheels = classmethod(_generators.failing_wheels)

    @classmethod
    def concatenate(cls, motions, *, shift=False):
        """Join motions one after the other.

        Parameters
        ----------
        motions : iterable of Motion
            The motions, in order.
        shift : bool, optional
            If true, the times and cadence numbers of each motion after the first are shifted by
            a constant so that it begins one cadence (the median time between cadences of the
            motion before it, or its own) after the one before it.

        Returns
        -------
        Motion
            The motion; its ``meta`` is what all of them agree on.

        Raises
        ------
        ValueError
            If there are no motions, if their time formats differ, or, without ``shift``, if
            times or cadence numbers do not increase.

        Examples
        --------
        >>> from scope_models import Motion
        >>> motion = Motion.still(3)
        >>> len(motion[:1] + motion[1:])
        3
        >>> Motion.concatenate([motion, motion], shift=True).cadenceno
        array([1, 2, 3, 4, 5, 6], dtype=int32)
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
                    "times and cadence numbers must go on increasing from one motion to the next; "
                    "`Motion.concatenate(motions, shift=True)` shifts them"
                )
        columns = (
            np.concatenate([getattr(motion, name) for motion in joined])
            for name in ("time", "x", "y", "quality", "cadenceno")
        )
        common = {
            key: value
            for key, value in first.meta.items()
            if all(key in motion.meta and motion.meta[key] == value for motion in joined)
        }
        return cls(*columns, first.time_format, common)

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

    @documented()
    def write(self, path, overwrite=False):
        """Write the motion to a table in text, ECSV.

        Parameters
        ----------
        {write}

        Examples
        --------
        >>> from scope_models import Motion
        >>> motion = Motion.k2_roll(10)
        >>> Motion.read(motion.write("motion.ecsv")) == motion
        True
        """
        from astropy.table import QTable

        names = ("quality", "cadenceno")
        columns = {"time": self.time * u.day, "x": self.x * u.pix, "y": self.y * u.pix}
        table = QTable(columns | {name: getattr(self, name) for name in names})
        table.meta = {"time_format": self.time_format, "motion": plain_tree(self.meta)}
        with atomic_path(path, overwrite=overwrite) as temporary:
            table.write(temporary, format="ascii.ecsv", overwrite=True)
        return Path(path)

    @classmethod
    def read(cls, path):
        """Read a motion that `write` wrote.

        Parameters
        ----------
        path : str or path-like
            The file. Columns of other units convert.

        Returns
        -------
        Motion
            The motion.

        Raises
        ------
        OSError
            If the file cannot be opened.
        ValueError
            If it is no such table.

        Examples
        --------
        >>> from scope_models import Motion
        >>> Motion.read(Motion.still(3).write("still.ecsv")).x
        array([0., 0., 0.])
        """
        from astropy.table import QTable

        text = Path(path).read_text(encoding="utf-8")
        try:
            table = QTable.read(text.splitlines(), format="ascii.ecsv")
            columns = [table[name] for name in ("time", "x", "y")]
            flags = [np.asarray(table[name]) for name in ("quality", "cadenceno")]
            return cls(*columns, *flags, table.meta["time_format"], table.meta.get("motion") or {})
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"{path} is not a table of a motion: {error}") from error

    def statistics(self, pixel_scale=MISSIONS["K2"].pixel_scale, *, exclude=0):
        r"""Return how far the star is from its reference position.

        Mean, standard deviation and maximum are those of :math:`r = \sqrt{x^2 + y^2}`, as in
        table 1 of the paper [1]_; the extent is the largest distance between any two positions.

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
        ValueError
            If the pixel scale is not positive, or no cadence is left.

        References
        ----------
        .. [1] Saunders, N. et al., "The Pointing Limits of Transiting Exoplanet Light Curve
           Characterization with Pixel Level De-correlation", table 1.

        Examples
        --------
        >>> from scope_models import Motion
        >>> statistics = Motion([0, 1, 2], [0.0, 0.3, 0.0], [0.1, 0.4, -0.1]).statistics()
        >>> statistics.maximum, statistics.extent.round(3)
        (<Quantity 0.5 pix>, <Quantity 0.583 pix>)
        >>> statistics.in_arcsec().maximum
        <Quantity 1.99 arcsec>
        """
        pixel_scale = _checked_scale(pixel_scale)
        keep = (self.quality & exclude) == 0
        if not keep.any():
            raise ValueError(f"all cadences have quality flags of `exclude`, {exclude}")
        return MotionStatistics.of_positions(self.x[keep], self.y[keep], pixel_scale)


def _checked_scale(pixel_scale):
    """Return a pixel scale in arcsec."""
    return checked_number(
        "pixel_scale", pixel_scale, u.arcsec, positive=True, equivalencies=PER_PIXEL
    )


def _shifted(motion, before):
    """Return the motion shifted in time to begin one cadence after another one."""
    steps = np.diff(before.time) if len(before) > 1 else np.diff(motion.time)
    step = np.median(steps) if len(steps) else K2Roll.cadence
    number = motion.cadenceno.astype(np.int64)
    return motion.replace(
        time=motion.time - motion.time[0] + (before.time[-1] + step),
        cadenceno=number - number[0] + (before.cadenceno[-1] + 1),
    )
