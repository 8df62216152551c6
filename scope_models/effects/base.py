"""Base of all effects: parameters, a truth that is drawn once, and a method for each stage."""

import inspect
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields

import numpy as np

from scope_models._arrays import plain_array
from scope_models._checks import check_fields
from scope_models._values import Value, frozen
from scope_models.missions import MISSIONS

__all__ = ["Conditions", "Drawn", "Effect", "Exposures"]

# Events of one observation: cosmic rays take some 100 bytes each.
_MOST_EVENTS = 1e8
_RAISES = """
Raises
------
TypeError, ValueError
    If an argument is of the wrong kind or outside its domain.
"""


@dataclass(frozen=True, eq=False, repr=False)
class Conditions(Value):
    """Properties of a scene that effects use.

    Parameters
    ----------
    time : ndarray of shape (n_cadences,)
        Middle of each cadence, days.
    shape : tuple of int
        Rows and columns of the stamp.
    mission : str
        Name of the mission.
    cadence_days : float
        Length of a cadence, days.
    exposure_time : float
        Time in which a cadence gathers light, s.
    int_time, read_time : float
        Exposure and read-out of one frame, s.
    n_frames, n_reads : int
        Frames of a cadence, and those that are summed.
    read_noise : float
        Standard deviation of one read, electrons.
    background : float
        Background of the detector, e-/s per pixel.
    n_stars : int, optional
        Number of stars.

    Examples
    --------
    >>> import numpy as np
    >>> from scope_models import Detector
    >>> from scope_models.effects.base import Conditions
    >>> Conditions.of(Detector.k2(), np.arange(3.0)).bit("argabrightening")
    64
    """

    time: np.ndarray
    shape: tuple
    mission: str
    cadence_days: float
    exposure_time: float
    int_time: float
    read_time: float
    n_frames: int
    n_reads: int
    read_noise: float
    background: float
    n_stars: int = 1

    @classmethod
    def of(cls, detector, time, n_stars=1):
        """Return the conditions of a detector at the times of a motion.

        Parameters
        ----------
        detector : Detector
            The detector.
        time : ndarray of shape (n_cadences,)
            The times, days.
        n_stars : int, optional
            Number of stars.

        Returns
        -------
        Conditions
            The conditions.
        """
        names = {item.name for item in fields(cls)} - {"time", "n_stars"}
        return cls(time=time, n_stars=n_stars, **{n: getattr(detector, n) for n in names})

    def bit(self, name):
        """Return a quality bit of the mission.

        Parameters
        ----------
        name : str
            Field of `~scope_models.missions.QualityBits`.

        Returns
        -------
        int
            The bit, 0 where the mission has none.
        """
        mission = MISSIONS.get(self.mission)
        return 0 if mission is None else getattr(mission.quality, name)


@dataclass(frozen=True, eq=False, repr=False)
class Exposures(Value):
    """Offsets of a star within each cadence.

    Parameters
    ----------
    x, y : ndarray of shape (n_cadences, k)
        Offsets in pixels.
    weights : ndarray of shape (k,)
        Parts of the exposure, whose sum is 1.
    blur : float, optional
        Standard deviation of a normal distribution about each offset, pixels.
    nodes : int, optional
        Gauss-Hermite nodes per axis for PSFs that are not Gaussian.

    Examples
    --------
    >>> import numpy as np
    >>> from scope_models.effects.base import Exposures
    >>> Exposures(np.zeros((3, 1)), np.zeros((3, 1)), np.ones(1), blur=0.1).expanded().x.shape
    (3, 9)
    """

    x: np.ndarray
    y: np.ndarray
    weights: np.ndarray
    blur: float = 0.0
    nodes: int = 3

    def joined(self, other):
        """Return all sums of two offsets.

        Parameters
        ----------
        other : Exposures
            The other offsets.

        Returns
        -------
        Exposures
            The sums; the variances of the blur add up.
        """
        pairs = (self.x, other.x), (self.y, other.y)
        x, y = ((a[:, :, np.newaxis] + b[:, np.newaxis]).reshape(len(a), -1) for a, b in pairs)
        weights = np.outer(self.weights, other.weights).ravel()
        blur = float(np.hypot(self.blur, other.blur))
        return Exposures(x, y, weights, blur, max(self.nodes, other.nodes))

    def expanded(self):
        """Return exposures without blur.

        Returns
        -------
        Exposures
            With ``nodes**2`` offsets in the place of each.
        """
        if not self.blur:
            return self
        nodes, weights = np.polynomial.hermite_e.hermegauss(self.nodes)
        weights = weights / weights.sum()
        x, y = (self.blur * a.ravel() for a in np.meshgrid(nodes, nodes))
        grid = Exposures(x[np.newaxis], y[np.newaxis], np.outer(weights, weights).ravel())
        return Exposures(self.x, self.y, self.weights).joined(grid)


@dataclass(frozen=True, eq=False, repr=False)
class Drawn(Value):
    """The truth of an effect in one observation.

    Parameters
    ----------
    columns : mapping of str to ndarray of shape (n_cadences, ...)
        Values at each cadence.
    maps : mapping of str to ndarray of shape (ny, nx)
        Images.
    tables : mapping of str to mapping of str to ndarray
        Columns of any length by their names.

    Examples
    --------
    >>> import numpy as np
    >>> from scope_models.effects.base import Drawn
    >>> Drawn({"FOCUS": np.ones(3)}).columns["FOCUS"]
    array([1., 1., 1.])
    """

    columns: Mapping = field(default_factory=dict)
    maps: Mapping = field(default_factory=dict)
    tables: Mapping = field(default_factory=dict)


@dataclass(frozen=True, eq=False, repr=False)
class Effect(Value):
    """Something that sky, telescope or detector do to light or charge.

    An effect is a frozen dataclass of physical parameters. The simulator draws its truth once
    (`draw`), from its own stream of random numbers, and then calls the methods that it implements:

    1. light of the stars: `width`, `exposures`, `shares`, `starlight` and `response`;
    2. other light: `pedestal`;
    3. charge, after photon noise: `charge`;
    4. readout, before read noise and digitization: `readout`;
    5. calibration (not in RAW_CNTS), in reverse order: `calibrate`;
    6. `quality` and `missing` of the cadences.

    Within a stage the order given does not matter: effects act by `place`, then name, then
    parameters. ``drawn`` is what `draw` has returned, ``part`` a slice of the cadences.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> from scope_models.effects import Effect
    >>> @dataclass(frozen=True)
    ... class Dimming(Effect):
    ...     factor: float = 0.5
    ...     def response(self, drawn, conditions, part):
    ...         return self.factor
    >>> scene = Star(12.0), Detector.k2(), Motion.still(3)
    >>> simulate(*scene, effects=Dimming()).scene.effects
    (Dimming(factor=0.5),)
    """

    #: Whether the pedestal is light, to which the pixels respond.
    is_light = True
    #: Place among the effects of a stage.
    place = 0

    def __init_subclass__(cls, **options):
        """Add what all effects raise to the docstring."""
        super().__init_subclass__(**options)
        text = inspect.cleandoc(cls.__doc__ or "")
        if "\nParameters\n---" in text and "\nRaises\n---" not in text:
            end = re.search(r"(?=\n(Notes|References|Examples)\n---)|\Z", text).start()
            cls.__doc__ = f"{text[:end]}{_RAISES}{text[end:]}\n"

    def __post_init__(self):
        check_fields(self)

    @property
    def name(self):
        """Name of the effect's stream of random numbers, and of its truth."""
        return type(self).__name__

    @property
    def by_cadence(self):
        """Names of the parameters that have, or may have, one value for each cadence."""
        return [f.name for f in fields(self) if f.metadata.get("check") is checked_series]

    def at(self, time, new):
        """Return the effect at other times; its values per cadence are interpolated.

        Parameters
        ----------
        time : ndarray of shape (n_cadences,)
            Times of the cadences, days, that increase.
        new : ndarray of shape (m,)
            Other times; the nearest value holds outside.

        Returns
        -------
        Effect
            The effect.
        """
        values = {name: getattr(self, name) for name in self.by_cadence}
        return self.replace(**{n: np.interp(new, time, v) for n, v in values.items() if np.ndim(v)})

    def draw(self, conditions, generator):
        """Return what is drawn or follows, a `~scope_models.effects.base.Drawn`."""
        return Drawn()

    def width(self, drawn, conditions):
        """Return a factor on the width of the PSF, shape (n_cadences,), or None."""

    def exposures(self, drawn, conditions):
        """Return offsets in each cadence, `~scope_models.effects.base.Exposures`, or None."""

    def shares(self, drawn, conditions, star):
        """Return a function of columns, rows (m,) and a slice, or None.

        It returns what is added to images of unit flux, (m, ny, nx), of the star of this number.
        """

    def starlight(self, drawn, conditions):
        """Return a factor on the stars' light, (n_cadences,) or (n_stars, n_cadences), or None."""

    def response(self, drawn, conditions, part):
        """Return a factor on all light that broadcasts to (m, ny, nx), or None."""

    def pedestal(self, drawn, conditions, part, electrons):
        """Return charge that is added, and what of it is subtracted, or None.

        Both are expected electrons that broadcast to (m, ny, nx), as is ``electrons`` of the stars.
        """

    def charge(self, drawn, conditions, part, electrons):
        """Change the charge of each pixel, (m, ny, nx), in place."""

    def readout(self, drawn, conditions, part, electrons):
        """Change the charge while it is read, (m, ny, nx), in place."""

    def calibrate(self, drawn, conditions, part, electrons):
        """Calibrate the charge of each pixel, (m, ny, nx), in place."""

    def quality(self, drawn, conditions):
        """Return quality flags to set, shape (n_cadences,), or None."""

    def missing(self, drawn, conditions):
        """Return which cadences have no data, shape (n_cadences,), or None."""


def checked_several(name, values, kind):
    """Return one value of a class, or several, as a tuple."""
    if isinstance(values, kind):
        return (values,)
    if not isinstance(values, Iterable) or not getattr(values, "shape", True):
        raise TypeError(f"`{name}` must be {kind.__name__} or a sequence of them, got {values!r}")
    values = tuple(values)
    for value in values:
        if not isinstance(value, kind):
            raise TypeError(f"`{name}` must hold {kind.__name__} objects, got {value!r}")
    return values


def per_cadence(unit="", low=None, high=np.inf):
    """Mark a field of an effect: one value for each cadence, or for all if there are limits."""
    return {"check": checked_series, "unit": unit, "low": low, "high": high}


def checked_series(name, values, unit, low=None, high=np.inf):
    """Return a finite array in a unit; if there are limits, an array or a number within them."""
    values = plain_array(values, unit, name)
    if low is None:
        right, wanted = values.ndim == 1, "a finite one-dimensional array"
    else:
        right = values.ndim <= 1 and np.all((values >= low) & (values <= high))
        wanted = f"{low} or more" if high == np.inf else f"between {low} and {high} {unit}"
        wanted += ", one number or one for each cadence"
    if not right or not np.all(np.isfinite(values)):
        raise ValueError(f"`{name}` must be {wanted}")
    return frozen(values) if values.ndim else float(values)


def number_of_events(generator, expected):
    """Return a Poisson number of events, which memory must hold."""
    if not expected <= _MOST_EVENTS:
        raise ValueError(f"`rate` makes {expected:.3g} events; at most {_MOST_EVENTS:g} are drawn")
    return generator.poisson(expected)


def series_of(value, time, name, noun="number"):
    """Return one value for each cadence, of one for all or for each."""
    if np.ndim(value) and np.shape(value) != time.shape:
        wanted = f"one {noun} for each of the {len(time)} cadences"
        raise ValueError(f"`{name}` must give {wanted}, got {len(value)}")
    return np.broadcast_to(value, time.shape)
