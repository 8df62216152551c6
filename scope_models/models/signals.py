"""Signals: relative flux of a star against time, as one-dimensional astropy models.

A signal is 1 where nothing happens, or has the mean 1.
"""

from functools import partial
from types import SimpleNamespace

import astropy.units as u
import numpy as np
from astropy import constants
from astropy.modeling import Fittable1DModel, Parameter
from astropy.modeling.models import Const1D, Sine1D, Tabular1D
from astropy.time import Time
from celerite2 import GaussianProcess, terms
from exoplanet_core import kepler, quad_limbdark_light_curve
from scipy.optimize import brentq
from scipy.signal import savgol_coeffs

from scope_models._arrays import LARGEST_DAY, plain_array, plain_number, plain_time
from scope_models._checks import checked_number
from scope_models.missions import MISSIONS
from scope_models.models.integration import value_of
from scope_models.models.psf import check_domain, check_model_parameters

__all__ = ["TransitModel", "sinusoidal_signal", "stochastic_signal", "tabulated_signal"]

# Gauss-Legendre nodes over an exposure.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(101)
_DENSITY = u.g / u.cm**3
_UNITS = {"period": u.day, "t0": u.day, "inc": u.deg, "omega": u.deg}
_PPM = u.Unit(1e-6)
# Savitzky-Golay filter of lightkurve's CDPP: span (101 long cadences) and order.
_FILTER_DAYS, _FILTER_ORDER = 101 * MISSIONS["Kepler"].cadence_days("long"), 2


class TransitModel(Fittable1DModel):
    r"""Relative flux of a star that a planet transits.

    The star is a disc with quadratic limb darkening,
    :math:`I(\mu) = 1 - u_1 (1 - \mu) - u_2 (1 - \mu)^2`, the planet an opaque disc on a Keplerian
    orbit. The drop is exact (exoplanet-core [1]_); its average over the exposure, by 101 nodes, is
    within 1 ppm for drops up to 2.5 % and exposures up to an hour.

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
        Length of an exposure in days, centered on each time. An attribute, not a fitted parameter.
    **kwargs
        Keywords of `~astropy.modeling.Model`, such as ``fixed``, ``bounds`` and ``name``.

    Raises
    ------
    ValueError
        If a parameter or the exposure time is outside its domain, also when it is set later, or
        has another unit.

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
    period.validator(partial(check_domain, "period", "positive"))
    rp.validator(partial(check_domain, "rp", "at least 0"))
    a.validator(partial(check_domain, "a", "positive"))
    ecc.validator(partial(check_domain, "ecc", "at least 0 and below 1"))

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
        self.exposure_time = checked_number("exposure_time", exposure_time, u.day)

    @property
    def arguments(self):
        """Arguments of an equal model (dict)."""
        return {"exposure_time": self.exposure_time}

    def __call__(self, *args, **kwargs):
        """Evaluate the model at times in days."""
        if any(isinstance(value, Time) for value in args):
            raise TypeError("times must be days with the zero of `t0`, as `time.value`, got a Time")
        return super().__call__(*args, **kwargs)

    def _in_units(self, *values):
        """Return the parameters, or values of them, in their documented units."""
        values = values or [value_of(getattr(self, name)) for name in self.param_names]
        given = zip(self.param_names, values, strict=True)
        plain = {name: plain_array(v, _UNITS.get(name, u.one), name).item() for name, v in given}
        return SimpleNamespace(**plain)

    @classmethod
    def from_depth_duration(
        cls, depth, duration, period, t0=0.0, *, b=0.0, u1=0.3, u2=0.2, exposure_time=0.0
    ):
        """Make a transit on a circular orbit.

        Parameters
        ----------
        depth : float or `~astropy.units.Quantity`
            Relative drop at mid-transit, limb darkened and for a short exposure, between 0 and 1.
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
            The model.

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
        depth, b = plain_number(depth, u.one, "depth"), plain_number(b, u.one, "b")
        u1, u2 = plain_number(u1, u.one, "u1"), plain_number(u2, u.one, "u2")
        duration, t0 = plain_number(duration, u.day, "duration"), plain_number(t0, u.day, "t0")
        period = checked_number("period", period, u.day, positive=True)
        _require(0 < depth < 1, "depth", "between 0 and 1", depth)
        _require(0 < duration < period / 2, "duration", "above 0 and below half a period", duration)
        _require(0 <= b < 1, "b", "at least 0 and below 1", b)
        # The largest planet covers the whole star.
        rp = brentq(lambda rp: -_drop(b, rp, u1, u2) - depth, 0, 1 + b, xtol=1e-14)
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

        The density gives :math:`a / R_* = (G \rho P^2 / 3 \pi)^{1/3}`, the impact parameter
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
            If an argument is outside its domain, or not exactly one of `a` and `density`, or both
            `inc` and `b` are given.

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
        period = checked_number("period", period, u.day, positive=True)
        t0, omega = plain_number(t0, u.day, "t0"), plain_number(omega, u.deg, "omega")
        ecc = plain_number(ecc, u.one, "ecc")
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
        """Distance of the centers at `t0`, in stellar radii."""
        p = self._in_units()
        cosine, sine = np.cos(np.radians(p.inc)), np.sin(np.radians(p.omega))
        return float(p.a * cosine * (1 - p.ecc**2) / (1 + p.ecc * sine))

    @property
    def depth(self):
        """Relative drop at `t0` for a short exposure."""
        p = self._in_units()
        return float(-_drop(abs(self.impact_parameter), p.rp, p.u1, p.u2))

    @property
    def duration(self):
        """Time from first to fourth contact in days, 0 without a transit."""
        p = self._in_units()
        reach = 1 + p.rp

        def beyond(time):
            return _separation(np.array([time]), p)[0] - reach

        if not beyond(0.0) < 0:
            return 0.0
        contacts = []
        for step in np.array([-1, 1]) * reach / _fastest(p):
            end = step
            while beyond(end) < 0:
                end += step
            contacts.append(brentq(beyond, end - step, end, xtol=1e-12))
        return contacts[1] - contacts[0]

    @property
    def stellar_density(self):
        """Mean density of the star in g/cm3 that the period and `a` imply."""
        p = self._in_units()
        density = 3 * np.pi * p.a**3 / (constants.G * (p.period * u.day) ** 2)
        return float(density.to_value(_DENSITY))

    @property
    def input_units(self):
        """Unit of times: days, also of plain numbers."""
        return {self.inputs[0]: u.day}

    def _parameter_units_for_data_units(self, _inputs_unit, _outputs_unit):
        return dict(_UNITS)  # astropy's fitters convert times to `input_units`

    def evaluate(self, x, period, t0, rp, a, inc, ecc, omega, u1, u2):
        """Relative flux at times of mid-exposure in days, of any shape."""
        p = self._in_units(period, t0, rp, a, inc, ecc, omega, u1, u2)
        _require(p.rp >= 0, "rp", "at least 0", p.rp)  # also where `rp.value` was set
        x = plain_array(x, u.day, "x")
        if p.t0 > LARGEST_DAY and np.any(np.abs(x) <= LARGEST_DAY):
            raise ValueError(f"`t0` must have the zero of the times, got the date {p.t0:.1f}")
        time = x.ravel() - p.t0
        flux = np.where(np.isfinite(time), 1.0, np.nan)
        # The farthest that the planet moves within half an exposure.
        travel = _fastest(p) * self.exposure_time / 2
        near = np.flatnonzero(_separation(time, p, margin=travel) < 1 + p.rp + travel)
        if near.size:
            nodes, weights = (_NODES, _WEIGHTS) if self.exposure_time > 0 else np.array([[0], [2]])
            inner = time[near, np.newaxis] + self.exposure_time / 2 * nodes
            drop = _drop(_separation(inner, p), p.rp, p.u1, p.u2)
            flux[near] = 1 + drop @ weights / 2
        return flux.reshape(x.shape)


def _require(condition, name, domain, value):
    if not condition:
        raise ValueError(f"`{name}` must be {domain}, got {value}")


def _fastest(orbit):
    """Speed at periastron in stellar radii per day."""
    speed = 2 * np.pi * orbit.a / orbit.period
    return speed * np.sqrt((1 + orbit.ecc) / (1 - orbit.ecc))


def _separation(time, orbit, margin=0.0):
    """Sky distance of the centers, infinite where the planet is behind by more than `margin`.

    `time` counts from conjunction; lengths are stellar radii.
    """
    ecc, inc, omega = orbit.ecc, np.radians(orbit.inc), np.radians(orbit.omega)
    half = np.pi / 4 - omega / 2
    anomaly = 2 * np.arctan2(np.sqrt(1 - ecc) * np.sin(half), np.sqrt(1 + ecc) * np.cos(half))
    mean = 2 * np.pi * time / orbit.period + anomaly - ecc * np.sin(anomaly)
    sin_f, cos_f = kepler(np.mod(mean + np.pi, 2 * np.pi) - np.pi, ecc)
    radius = orbit.a * (1 - ecc**2) / (1 + ecc * cos_f)
    along = cos_f * np.cos(omega) - sin_f * np.sin(omega)
    toward = sin_f * np.cos(omega) + cos_f * np.sin(omega)
    distance = radius * np.hypot(along, toward * np.cos(inc))
    return np.where(radius * toward * np.sin(inc) > -margin, distance, np.inf)


def _drop(separation, rp, u1, u2):
    """Change of relative flux by a planet at a distance from the center."""
    separation = np.asarray(separation)
    drop, overlap = np.zeros(separation.shape), separation < 1 + rp
    if rp > 0 and np.any(overlap):
        drop[overlap] = quad_limbdark_light_curve(u1, u2, separation[overlap], rp)
    return drop


class _OfTime:
    """Mixin of signals: times become days, or are refused."""

    def evaluate(self, x, *parameters):
        return super().evaluate(plain_array(x, u.day, "time"), *parameters)


class SineSignal(_OfTime, Sine1D):
    """A sine of the time in days."""


class TabulatedSignal(_OfTime, Tabular1D):
    """A table of the time in days."""

    @property
    def arguments(self):
        """Arguments of an equal model (dict)."""
        return {"points": self.points[0], "lookup_table": self.lookup_table}


def sinusoidal_signal(amplitude, period, phase=0.0):
    r"""Make a sinusoidal signal, :math:`1 + A \sin 2\pi (t / P + \phi)`.

    Parameters
    ----------
    amplitude : float
        Relative semi-amplitude :math:`A`, between 0 and 1.
    period : float or `~astropy.units.Quantity`
        Period :math:`P` in days.
    phase : float or `~astropy.units.Quantity`, optional
        Phase :math:`\phi` at time 0 in cycles.

    Returns
    -------
    `~astropy.modeling.CompoundModel`
        ``Const1D + Sine1D``.

    Raises
    ------
    ValueError
        If an argument is outside its domain.

    Examples
    --------
    >>> from scope_models.models import sinusoidal_signal
    >>> print(sinusoidal_signal(0.01, period=4)(1.0))
    1.01
    """
    amplitude = plain_number(amplitude, u.one, "amplitude")
    period = checked_number("period", period, u.day, positive=True)
    phase = plain_number(phase, u.cycle, "phase")
    _require(0 <= amplitude < 1, "amplitude", "at least 0 and below 1", amplitude)
    return Const1D(1.0) + SineSignal(amplitude, 1 / period, phase)


def tabulated_signal(time, flux):
    """Make a signal of given values, linear between them.

    Parameters
    ----------
    time : array_like or `~astropy.units.Quantity`
        Times ``(n,)`` in days, increasing.
    flux : array_like or `~astropy.units.Quantity`
        Relative flux ``(n,)`` at these times, not negative.

    Returns
    -------
    `~astropy.modeling.models.Tabular1D`
        The signal. Outside `time` the first and the last value hold.

    Raises
    ------
    ValueError
        If the arrays do not match or hold values outside their domain.

    Examples
    --------
    >>> from scope_models.models import tabulated_signal
    >>> print(tabulated_signal([0, 1, 2], [1, 0.9, 1])([0.5, 1, 5]))
    [0.95 0.9  1.  ]
    """
    time, flux = _checked_times(time), plain_array(flux, u.one, "flux")
    if flux.shape != time.shape:
        raise ValueError(f"`flux` must have the shape {time.shape} of `time`, got {flux.shape}")
    if not (np.isfinite(flux).all() and flux.min() >= 0):
        raise ValueError("`flux` must be finite and not negative")
    # On either side a point that no time lies beyond.
    points = np.concatenate([[-1e12], time, [1e12]])
    table = np.concatenate([flux[:1], flux, flux[-1:]])
    return TabulatedSignal(points, table, method="linear")


def stochastic_signal(time, cdpp, *, timescale=0.25, quality=0.5**0.5, duration=6.5, seed=None):
    r"""Draw red noise, such as granulation, whose CDPP has a stated expected value.

    The noise is a Gaussian process of a damped, stochastically driven harmonic oscillator
    (celerite2's ``SHOTerm`` [1]_): with the default quality :math:`1/\sqrt{2}` its power is flat at
    low frequency and falls as the fourth power of the frequency, as granulation's does. Clipping
    and edges of lightkurve's estimator raise the mean CDPP by up to 3 %.

    Parameters
    ----------
    time : array_like or `~astropy.units.Quantity`
        Times ``(n,)`` in days, increasing, at which it is drawn; linear in between.
    cdpp : float or `~astropy.units.Quantity`
        Expected CDPP in ppm.
    timescale : float or `~astropy.units.Quantity`, optional
        Period of the oscillator in days.
    quality : float, optional
        Its quality factor; well above 1 for quasi-periodic variability.
    duration : float or `~astropy.units.Quantity`, optional
        Time scale of the CDPP in hours.
    seed : int or `~numpy.random.Generator`, optional
        Seed of the draw.

    Returns
    -------
    `~astropy.modeling.models.Tabular1D`
        The signal.

    Raises
    ------
    ValueError
        If an argument is outside its domain.

    References
    ----------
    .. [1] Foreman-Mackey et al. 2017, AJ 154, 220.

    Examples
    --------
    >>> import numpy as np
    >>> from scope_models.models import stochastic_signal
    >>> from scope_models.photometry import cdpp
    >>> time = np.arange(4000) * 0.0204336
    >>> print(f"{cdpp(stochastic_signal(time, cdpp=50, seed=1)(time)):.0f}")
    51
    """
    time = _checked_times(time)
    cdpp = checked_number("cdpp", cdpp, _PPM, positive=True)
    timescale = checked_number("timescale", timescale, u.day, positive=True)
    quality = checked_number("quality", quality, positive=True)
    duration = checked_number("duration", duration, u.hour, positive=True)
    kernel = terms.SHOTerm(sigma=1.0, w0=2 * np.pi / timescale, Q=quality)
    sigma = 1e-6 * cdpp / _unit_cdpp(kernel, np.median(np.diff(time)), duration)
    process = GaussianProcess(kernel)
    process.compute(time, diag=np.full(len(time), 1e-12))
    noise = process.dot_tril(np.random.default_rng(seed).standard_normal(len(time)))
    return tabulated_signal(time, 1 + sigma * noise)


def _unit_cdpp(kernel, cadence, duration):
    """Root mean square of the filtered running mean of a process."""
    width = max(1, round(duration / 24 / cadence))
    length = max(3, 2 * int(_FILTER_DAYS / cadence // 2) + 1)
    high_pass = -savgol_coeffs(length, _FILTER_ORDER)
    high_pass[length // 2] += 1
    weights = np.convolve(high_pass, np.full(width, 1 / width))
    products = np.correlate(weights, weights, mode="full")[len(weights) - 1 :]
    covariance = kernel.get_value(cadence * np.arange(len(weights)))
    return np.sqrt(products[0] * covariance[0] + 2 * products[1:] @ covariance[1:])


def _checked_times(time):
    time = plain_time(time, None, "time")
    if time.ndim != 1 or len(time) < 2 or not (np.diff(time) > 0).all():
        raise ValueError("`time` must be one-dimensional and increasing, with at least two values")
    return time
