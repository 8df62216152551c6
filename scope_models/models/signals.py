"""Signals: relative flux of a star against time, as one-dimensional astropy models.

A signal is 1 where nothing happens. Signals compose: ``planet_b * planet_c * spots``.
"""

import astropy.units as u
import numpy as np
from astropy import constants
from astropy.modeling import Fittable1DModel, Parameter
from astropy.time import Time
from exoplanet_core import kepler, quad_limbdark_light_curve
from scipy.optimize import brentq

from scope_models._arrays import LARGEST_DAY, plain_array, plain_number
from scope_models._checks import checked_number
from scope_models.models._parameters import Domain, check_model_parameters, value_of

__all__ = ["TransitModel"]

#: Gauss-Legendre nodes over an exposure.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(101)

_ORBIT = ("period", "a", "inc", "ecc", "omega")
_DENSITY = u.g / u.cm**3
_UNITS = {"period": u.day, "t0": u.day, "inc": u.deg, "omega": u.deg}


class TransitModel(Fittable1DModel):
    r"""Relative flux of a star that a planet transits.

    The star is a disc with quadratic limb darkening,
    :math:`I(\mu) = 1 - u_1 (1 - \mu) - u_2 (1 - \mu)^2`, the planet an opaque
    disc on a Keplerian orbit. The drop is the exact integral over the overlap of the discs
    (exoplanet-core, Agol et al. 2020 [1]_), averaged over the exposure by Gauss-Legendre quadrature
    with 101 nodes: the average is within 1 ppm of the exact one for drops up to 2.5 % and exposures
    up to an hour.

    Parameters
    ----------
    period, t0 : float or `~astropy.units.Quantity`
        Orbital period, and time of inferior conjunction (mid-transit), in days.
    rp, a : float
        Radius of the planet, and semi-major axis, in stellar radii.
    inc : float or `~astropy.units.Quantity`
        Inclination of the orbit in degrees; 90 is edge-on.
    ecc : float
        Eccentricity, at least 0 and below 1.
    omega : float or `~astropy.units.Quantity`
        Argument of periastron of the star's orbit in degrees.
    u1, u2 : float
        Coefficients of quadratic limb darkening.
    exposure_time : float or `~astropy.units.Quantity`, optional
        Length of an exposure in days, centered on each time; 0 gives
        instantaneous values. An attribute, not a fitted parameter.
    **kwargs : dict
        Name, bounds, fixed and so on, see `~astropy.modeling.Model`.

    Raises
    ------
    ValueError
        If a parameter or the exposure time is outside its domain, also when it is set later, or
        its unit does not convert.

    See Also
    --------
    scope_models.models.sinusoidal_signal, scope_models.models.stochastic_signal

    References
    ----------
    .. [1] Agol, Luger & Foreman-Mackey 2020, AJ 159, 123.

    Examples
    --------
    >>> import numpy as np
    >>> from scope_models import TransitModel
    >>> planet = TransitModel(period=3, t0=1, rp=0.1, a=9, u1=0.4, u2=0.3, exposure_time=0.0204)
    >>> print(np.round(planet(np.array([0.0, 0.95, 1.0])), 5))
    [1.      0.99451 0.9878 ]

    Two planets are a product:

    >>> both = planet * TransitModel(period=7, t0=1, rp=0.05, a=16)
    >>> print(round(float(both(1.0)), 5))
    0.98495
    """

    period = Parameter(default=10.0, bounds=(1e-6, None), description="orbital period in days")
    t0 = Parameter(default=0.0, description="time of mid-transit in days")
    rp = Parameter(default=0.1, bounds=(0, None), description="planet radius in stellar radii")
    a = Parameter(default=20.0, bounds=(1, None), description="semi-major axis in stellar radii")
    inc = Parameter(default=90.0, bounds=(0, 180), description="inclination in degrees")
    ecc = Parameter(default=0.0, bounds=(0, 0.999), description="eccentricity")
    omega = Parameter(default=90.0, description="argument of periastron in degrees")
    u1 = Parameter(default=0.3, description="linear limb-darkening coefficient")
    u2 = Parameter(default=0.2, description="quadratic limb-darkening coefficient")
    period.validator(Domain("period", "positive"))
    rp.validator(Domain("rp", "at least 0"))
    a.validator(Domain("a", "positive"))
    ecc.validator(Domain("ecc", "at least 0 and below 1"))

    _input_units_allow_dimensionless = True

    def __init__(self, *args, exposure_time=0.0, **kwargs):
        for name, value in (*zip(self.param_names, args, strict=False), *kwargs.items()):
            if isinstance(value, Time):
                raise TypeError(f"`{name}` must be in days since an epoch of your own, got a Time")
        super().__init__(*args, **kwargs)
        if len(self.parameters) != len(self.param_names):
            raise ValueError("the parameters of a TransitModel must be scalars")
        check_model_parameters(self)
        self._in_units()
        days = plain_number(exposure_time, u.day, "exposure_time")
        _require(np.isfinite(days) and days >= 0, "exposure_time", "at least 0", exposure_time)
        self.exposure_time = days

    @property
    def arguments(self):
        """Arguments of an equal model, without its parameters (dict)."""
        return {"exposure_time": self.exposure_time}

    def prepare_inputs(self, *inputs, **options):
        """Check the inputs as astropy's models do, and refuse a Time, whose zero is unknown."""
        if any(isinstance(value, Time) for value in inputs):
            raise TypeError("times must be days with the zero of `t0`, as `time.value`, got a Time")
        return super().prepare_inputs(*inputs, **options)

    def _in_units(self):
        """Return the value of each parameter in its documented unit."""
        return {name: _number(name, value_of(getattr(self, name))) for name in self.param_names}

    @classmethod
    def from_depth_duration(
        cls, depth, duration, period, t0=0.0, *, b=0.0, u1=0.3, u2=0.2, exposure_time=0.0
    ):
        """Make a transit on a circular orbit from what is seen of it.

        Parameters
        ----------
        depth : float or `~astropy.units.Quantity`
            Relative drop at mid-transit with limb darkening and for a short
            exposure, between 0 and 1.
        duration, period : float or `~astropy.units.Quantity`
            Time from first to fourth contact, and orbital period, in days.
        t0 : float or `~astropy.units.Quantity`, optional
            Time of mid-transit in days.
        b : float, optional
            Impact parameter in stellar radii, at least 0 and below 1.
        u1, u2 : float, optional
            Coefficients of quadratic limb darkening.
        exposure_time : float, optional
            Length of an exposure in days.

        Returns
        -------
        `TransitModel`
            A model with this depth and duration.

        Raises
        ------
        ValueError
            If an argument is outside its domain.

        Examples
        --------
        >>> from scope_models import TransitModel
        >>> planet = TransitModel.from_depth_duration(0.01, 0.5, period=15, t0=5)
        >>> print(f"{planet.depth:.4f} {planet.duration:.4f} {planet(5.0):.4f}")
        0.0100 0.5000 0.9900
        """
        depth = plain_number(depth, u.one, "depth")
        duration = plain_number(duration, u.day, "duration")
        period, t0 = plain_number(period, u.day, "period"), plain_number(t0, u.day, "t0")
        b, u1, u2 = (plain_number(v, u.one, n) for v, n in ((b, "b"), (u1, "u1"), (u2, "u2")))
        _require(0 < depth < 1, "depth", "between 0 and 1", depth)
        _require(period > 0, "period", "positive", period)
        _require(0 < duration < period / 2, "duration", "above 0 and below half a period", duration)
        _require(0 <= b < 1, "b", "at least 0 and below 1", b)

        def excess(rp):
            return -_drop(b, rp, u1, u2) - depth

        rp = brentq(excess, 0, 1 + b, xtol=1e-14)  # the largest covers the whole star
        sine = np.sin(np.pi * duration / period)
        a = np.sqrt(b**2 + ((1 + rp) ** 2 - b**2) / sine**2)
        inc = np.degrees(np.arccos(b / a))
        return cls(period, t0, rp, a, inc, 0, 90, u1, u2, exposure_time=exposure_time)

    @classmethod
    def from_orbit(
        cls, period, t0=0.0, rp=0.1, *, a=None, density=None, inc=None, b=None, ecc=0.0, omega=90.0,
        u1=0.3, u2=0.2, exposure_time=0.0,
    ):  # fmt: skip
        r"""Make a transit from `a` or the star's density, and `inc` or `b`.

        The density gives :math:`a / R_* = (G \rho P^2 / 3 \pi)^{1/3}`, and
        the impact parameter the inclination by
        :math:`b = a \cos i\, (1 - e^2) / (1 + e \sin\omega)`.

        Parameters
        ----------
        period, t0 : float or `~astropy.units.Quantity`
            Period and time of mid-transit in days.
        rp, a : float, optional
            Radius of the planet, and semi-major axis, in stellar radii.
        density : float or `~astropy.units.Quantity`, optional
            Mean density of the star in g/cm3, in place of `a`.
        inc : float or `~astropy.units.Quantity`, optional
            Inclination in degrees; 90 if neither it nor `b` is given.
        b : float, optional
            Impact parameter in stellar radii, in place of `inc`.
        ecc : float, optional
            Eccentricity.
        omega : float or `~astropy.units.Quantity`, optional
            Argument of periastron in degrees.
        u1, u2 : float, optional
            Coefficients of quadratic limb darkening.
        exposure_time : float, optional
            Length of an exposure in days.

        Returns
        -------
        `TransitModel`
            The model.

        Raises
        ------
        ValueError
            If an argument is outside its domain, or not exactly one of `a`
            and `density`, or both `inc` and `b` are given.

        Examples
        --------
        >>> from scope_models import TransitModel
        >>> earth = TransitModel.from_orbit(365.25, rp=0.00917, density=1.41, b=0.2)
        >>> print(f"{earth.a.value:.1f} {earth.impact_parameter:.2f}")
        215.0 0.20
        """
        if (a is None) == (density is None):
            raise ValueError("exactly one of `a` and `density` must be given")
        if inc is not None and b is not None:
            raise ValueError("only one of `inc` and `b` may be given")
        period, t0 = plain_number(period, u.day, "period"), plain_number(t0, u.day, "t0")
        omega, ecc = plain_number(omega, u.deg, "omega"), plain_number(ecc, u.one, "ecc")
        _require(period > 0, "period", "positive", period)
        _require(0 <= ecc < 1, "ecc", "at least 0 and below 1", ecc)
        inc = 90.0 if inc is None else plain_number(inc, u.deg, "inc")
        if density is None:
            a = plain_number(a, u.one, "a")
        else:
            density = checked_number("density", density, _DENSITY, positive=True) * _DENSITY
            cube = constants.G * density * (period * u.day) ** 2 / (3 * np.pi)
            a = float(np.cbrt(cube.to_value(u.one)))
        if b is not None:
            b = plain_number(b, u.one, "b")
            cosine = b * (1 + ecc * np.sin(np.radians(omega))) / (a * (1 - ecc**2))
            _require(b >= 0 and cosine <= 1, "b", "at least 0 and within the orbit", b)
            inc = np.degrees(np.arccos(cosine))
        return cls(period, t0, rp, a, inc, ecc, omega, u1, u2, exposure_time=exposure_time)

    @property
    def impact_parameter(self):
        """Distance of the planet from the star's center at `t0`, in stellar radii."""
        p = self._in_units()
        ecc, sine = p["ecc"], np.sin(np.radians(p["omega"]))
        cosine = np.cos(np.radians(p["inc"]))
        return float(p["a"] * cosine * (1 - ecc**2) / (1 + ecc * sine))

    @property
    def depth(self):
        """Relative drop at `t0` for a short exposure."""
        p = self._in_units()
        return float(-_drop(abs(self.impact_parameter), p["rp"], p["u1"], p["u2"]))

    @property
    def duration(self):
        """Time from first to fourth contact in days, 0 without a transit."""
        p = self._in_units()
        reach = 1 + p["rp"]
        args = tuple(p[name] for name in _ORBIT)

        def separation(time):
            return _separation(np.array([time]), *args)[0] - reach

        if not separation(0.0) < 0:
            return 0.0
        step = reach / _fastest(*args[:2], args[3])
        contacts = []
        for sign in (-1, 1):
            end = sign * step
            while separation(end) < 0:
                end += sign * step
            contacts.append(brentq(separation, end - sign * step, end, xtol=1e-12))
        return contacts[1] - contacts[0]

    @property
    def stellar_density(self):
        """Mean density of the star in g/cm3 that the period and `a` imply."""
        p = self._in_units()
        density = 3 * np.pi * p["a"] ** 3 / (constants.G * (p["period"] * u.day) ** 2)
        return float(density.to_value(_DENSITY))

    @property
    def input_units(self):
        """Unit of times: days; plain numbers are taken as days."""
        return {self.inputs[0]: u.day}

    def _parameter_units_for_data_units(self, _inputs_unit, _outputs_unit):
        return dict(_UNITS)  # astropy's fitters convert times to `input_units`

    def evaluate(self, x, period, t0, rp, a, inc, ecc, omega, u1, u2):
        """Relative flux, 1 outside transits, at times of mid-exposure in days, of any shape."""
        given = zip(self.param_names, (period, t0, rp, a, inc, ecc, omega, u1, u2), strict=True)
        p = {name: _number(name, value) for name, value in given}
        _require(p["rp"] >= 0, "rp", "at least 0", p["rp"])  # also where `rp.value` was set
        x = plain_array(x, u.day, "x")
        if p["t0"] > LARGEST_DAY and np.any(np.abs(x) <= LARGEST_DAY):
            raise ValueError(f"`t0` must have the zero of the times, got the date {p['t0']:.1f}")
        orbit = tuple(p[name] for name in _ORBIT)
        time = x.ravel() - p["t0"]
        flux = np.where(np.isfinite(time), 1.0, np.nan)
        # no cadence is lost: the planet cannot move farther within half an exposure
        travel = _fastest(p["period"], p["a"], p["ecc"]) * self.exposure_time / 2
        near = np.flatnonzero(_separation(time, *orbit, margin=travel) < 1 + p["rp"] + travel)
        if near.size:
            nodes, weights = (_NODES, _WEIGHTS) if self.exposure_time > 0 else ([0.0], [2.0])
            inner = time[near, np.newaxis] + self.exposure_time / 2 * np.asarray(nodes)
            drop = _drop(_separation(inner, *orbit), p["rp"], p["u1"], p["u2"])
            flux[near] = 1 + drop @ np.asarray(weights) / 2
        return flux.reshape(x.shape)


def _require(condition, name, domain, value):
    if not condition:
        raise ValueError(f"`{name}` must be {domain}, got {value}")


def _number(name, value):
    """Return a parameter as one plain number, from a scalar, an array of one or a Quantity."""
    return plain_array(value, _UNITS.get(name, u.one), name).item()


def _fastest(period, a, ecc):
    """Highest orbital speed (at periastron) in stellar radii per day."""
    return 2 * np.pi * a / period * np.sqrt((1 + ecc) / (1 - ecc))


def _separation(time, period, a, inc, ecc, omega, margin=0.0):
    """Sky distance of the centers in stellar radii, infinite where the planet is behind.

    `time` counts from conjunction; a planet less than `margin` behind is taken as in front.
    """
    inc, omega = np.radians(inc), np.radians(omega)
    half = np.pi / 4 - omega / 2
    anomaly = 2 * np.arctan2(np.sqrt(1 - ecc) * np.sin(half), np.sqrt(1 + ecc) * np.cos(half))
    mean = 2 * np.pi * time / period + anomaly - ecc * np.sin(anomaly)
    sin_f, cos_f = kepler(np.mod(mean + np.pi, 2 * np.pi) - np.pi, ecc)
    radius = a * (1 - ecc**2) / (1 + ecc * cos_f)
    along = cos_f * np.cos(omega) - sin_f * np.sin(omega)
    toward = sin_f * np.cos(omega) + cos_f * np.sin(omega)
    distance = radius * np.hypot(along, toward * np.cos(inc))
    return np.where(radius * toward * np.sin(inc) > -margin, distance, np.inf)


def _drop(separation, rp, u1, u2):
    """Change of relative flux, at most 0, by a planet at a distance from the center."""
    drop = np.zeros(np.shape(separation))
    overlap = np.asarray(separation) < 1 + rp
    if rp > 0 and np.any(overlap):
        drop[overlap] = quad_limbdark_light_curve(u1, u2, np.asarray(separation)[overlap], rp)
    return drop
