"""The atmosphere above a telescope on the ground, and the places of star and Moon in its sky."""

from dataclasses import dataclass, field

import astropy.units as u
import numpy as np
from astropy import coordinates
from astropy.time import Time

from scope_models._arrays import plain_time
from scope_models._checks import checked_number, number
from scope_models.effects._noise import red_noise
from scope_models.effects.base import Drawn, Effect, per_cadence, series_of
from scope_models.missions import TIME_ZEROS

__all__ = ["Extinction", "Scintillation", "Seeing", "airmass", "moon_geometry"]

_TDB_MINUS_UTC = 69.184  # s, since 2017; 1 s is 15 arcsec of hour angle


def of_date(coord, day):
    """Return a coordinate at the equinox of a time, BTJD."""
    if not isinstance(coord, coordinates.SkyCoord):
        raise TypeError(f"`coord` must be a SkyCoord, got {coord!r}")
    if any(getattr(coord.frame, name, 0) is None for name in ("obstime", "location")):
        raise TypeError("`coord` must be on the sky, as ICRS, or have obstime and location")
    equinox = Time(TIME_ZEROS["btjd"], day, format="jd", scale="tdb")
    return coord.transform_to(coordinates.FK5(equinox=equinox))


def sidereal_time(days, location):
    """Return the mean sidereal time of Greenwich, deg, at times in days of BTJD."""
    if not isinstance(location, coordinates.EarthLocation):
        raise TypeError(f"`location` must be an EarthLocation, got {location!r}")
    utc = days - _TDB_MINUS_UTC / 86400 + (TIME_ZEROS["btjd"] - 2451545.0)
    return 280.46061837 + 360.98564736629 * utc  # Astronomical Almanac; UT1 - UTC is below 0.9 s


def horizon_altitude(days, place, location):
    """Return the altitude above the horizon, deg, of a place of date at times in days of BTJD."""
    hour_angle = np.radians(sidereal_time(days, location) + location.lon.deg - place.ra.deg)
    latitude, dec = location.lat.rad, place.dec.rad
    sine = np.sin(latitude) * np.sin(dec) + np.cos(latitude) * np.cos(dec) * np.cos(hour_angle)
    return np.degrees(np.arcsin(np.clip(sine, -1, 1)))


def airmass(time, coord, location):
    """Return the airmass of a star.

    By the formula of Kasten & Young (1989). The barycentric times are taken as those of the
    observatory, from which they differ by up to 8 minutes.

    Parameters
    ----------
    time : array_like or Time
        Times, BTJD.
    coord : SkyCoord
        The star.
    location : EarthLocation
        The observatory.

    Returns
    -------
    ndarray of shape (n,)
        At least 1.

    Raises
    ------
    TypeError
        If an argument is of the wrong kind.
    ValueError
        If the star is below the horizon at any of the times.

    References
    ----------
    Kasten, F. & Young, A. T. 1989, Applied Optics 28, 4735.

    Examples
    --------
    >>> from astropy.coordinates import EarthLocation, SkyCoord
    >>> from scope_models.effects import airmass
    >>> paranal = EarthLocation.from_geodetic(-70.40, -24.63, 2635)
    >>> star = SkyCoord("01h00m00s -24d38m00s")
    >>> print(airmass([1400.6, 1400.7], star, paranal).round(2))
    [1.15 1.  ]
    """
    days = np.atleast_1d(plain_time(time, "btjd", "time"))
    altitude = horizon_altitude(days, of_date(coord, days[0]), location)
    if below := np.sum(altitude <= 0):
        times = f"{below} of {days.size} times at which it is below"
        raise ValueError(f"`coord` must be above the horizon, got {times}")
    sine = np.sin(np.radians(altitude))
    return np.maximum(1 / (sine + 0.50572 * (altitude + 6.07995) ** -1.6364), 1.0)


def moon_geometry(time, coord, location):
    """Return where the Moon is, seen from the star and from the observatory.

    Parameters
    ----------
    time : array_like or Time
        Times, BTJD.
    coord : SkyCoord
        The star.
    location : EarthLocation
        The observatory.

    Returns
    -------
    dict of str to ndarray
        Fields of `NightSky`: ``moon_altitude``, ``moon_separation`` from the star and
        ``moon_phase``, the angle between Sun and Earth at the Moon; deg. Altitude and separation
        are those at the observatory, without refraction.

    Raises
    ------
    TypeError
        If an argument is of the wrong kind.

    Examples
    --------
    >>> from astropy.coordinates import EarthLocation, SkyCoord
    >>> from scope_models.effects import moon_geometry
    >>> paranal = EarthLocation.from_geodetic(-70.40, -24.63, 2635)
    >>> moon = moon_geometry([1386.7], SkyCoord("06h -20d"), paranal)  # 2018-09-25, full Moon
    >>> bool(moon["moon_phase"] < 10)
    True
    """
    days = np.atleast_1d(plain_time(time, "btjd", "time"))
    star = of_date(coord, days[0])
    times = Time(TIME_ZEROS["btjd"], days, format="jd", scale="tdb")
    moon, sun = coordinates.get_body("moon", times, ephemeris="builtin"), coordinates.get_sun(times)
    elongation = moon.separation(sun, origin_mismatch="ignore").rad
    sun_side = (sun.distance / moon.distance).to_value(u.one)
    phase = np.arctan2(sun_side * np.sin(elongation), 1 - sun_side * np.cos(elongation))
    # The observatory is up to an Earth's radius from the center: a degree of parallax.
    east = (location.lon.rad + np.radians(sidereal_time(days, location))) * u.rad
    place = np.hypot(location.x, location.y), east, location.z
    observatory = coordinates.CylindricalRepresentation(*place).to_cartesian()
    center = of_date(coordinates.SkyCoord(moon.ra, moon.dec, moon.distance), days[0])
    seen = coordinates.SkyCoord(center.cartesian - observatory, frame=star)
    return {
        "moon_altitude": horizon_altitude(days, seen, location),
        "moon_separation": seen.separation(star).deg,
        "moon_phase": np.degrees(np.abs(phase)),
    }


@dataclass(frozen=True, eq=False, repr=False)
class Extinction(Effect):
    r"""Light of the stars that the atmosphere absorbs and scatters.

    .. math:: f(t) = 10^{-0.4 [k X(t) + c(t)]}

    with the coefficient k, the airmass X, and the changes c of the transparency, a Gauss-Markov
    process that all stars share.

    Parameters
    ----------
    coefficient : float or Quantity, optional
        Coefficient k, mag per airmass. 0.11, 0.07 and 0.05 in V, R and I: Paranal (Patat 2003).
    airmass : float or array_like, optional
        Airmass X, 1 or more, for all cadences or for each: `airmass` computes it.
    scatter : float or Quantity, optional
        Standard deviation of c, mag.
    correlation_time : float or Quantity, optional
        Correlation time of c, days; the default is assumed.

    Notes
    -----
    The truth has the airmass and the factor on the light of the stars in the columns AIRMASS and
    EXTINCTION. The background is that on the ground, and stays. Stars of all colors have the same
    coefficient.

    References
    ----------
    Patat, F. 2003, A&A 400, 1183, table A.1.

    Examples
    --------
    >>> import numpy as np
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> from scope_models.effects import Extinction
    >>> effect = Extinction(0.1, airmass=np.array([1.0, 1.5, 2.0]))
    >>> scene = Star(10.0), Detector.tess(), Motion.ground(3)
    >>> truth = simulate(*scene, noise=False, effects=effect).truth
    >>> print(-2.5 * np.log10(truth.columns["EXTINCTION"]))
    [0.1  0.15 0.2 ]
    """

    coefficient: float = number(0.07, "mag")
    airmass: float | np.ndarray = field(default=1.0, metadata=per_cadence(low=1))
    scatter: float = number(0.0, "mag")
    correlation_time: float = number(0.1, "day", positive=True)

    def draw(self, conditions, generator):
        time = conditions.time
        column = series_of(self.airmass, time, "airmass")
        change = self.scatter * red_noise(generator, time, self.correlation_time)
        factor = 10 ** (-0.4 * (self.coefficient * column + change))
        return Drawn({"AIRMASS": np.array(column), "EXTINCTION": factor})

    def starlight(self, drawn, conditions):
        return drawn.columns["EXTINCTION"]


@dataclass(frozen=True, eq=False, repr=False)
class Scintillation(Effect):
    r"""Changes of the stars' light by turbulence high above the telescope.

    .. math:: \sigma^2 = 10^{-5} C_Y^2 D^{-4/3} t^{-1} X^3 e^{-2 h / H}

    with the aperture D (m), the exposure t (s), the airmass X and the altitude h of the telescope
    [1]_. The formula holds for exposures that are long against the time in which the turbulence
    crosses the aperture; the noise is then white. Each star has its own: stars that are closer
    than some arcseconds share some of it, which is neglected.

    Parameters
    ----------
    aperture, altitude : float or Quantity, optional
        Diameter D and altitude h of the telescope, m.
    airmass : float or array_like, optional
        Airmass X, 1 or more, for all cadences or for each.
    coefficient : float, optional
        Coefficient :math:`C_Y`, :math:`\mathrm{m}^{2/3}\,\mathrm{s}^{1/2}`; the default is about
        the median of observatories [1]_.
    scale_height : float or Quantity, optional
        Scale height H of the turbulence, m [1]_.

    Notes
    -----
    The truth has the factor of each cadence and star, log-normally distributed with a mean of 1,
    in the column SCINTILLATION.

    References
    ----------
    .. [1] Osborn, J. et al. 2015, MNRAS 452, 1707.

    Examples
    --------
    >>> import astropy.units as u
    >>> from scope_models.effects import Scintillation
    >>> print(f"{1e6 * Scintillation(3.5 * u.m, altitude=2788).rms(60.0):.0f} ppm")
    195 ppm
    """

    aperture: float = number(1.0, "m", positive=True)
    altitude: float = number(2400.0, "m")
    airmass: float | np.ndarray = field(default=1.0, metadata=per_cadence(low=1))
    coefficient: float = number(1.56)
    scale_height: float = number(8000.0, "m", positive=True)

    def rms(self, exposure):
        """Return the standard deviation of the relative flux.

        Parameters
        ----------
        exposure : float or Quantity
            Length of the exposure, s.

        Returns
        -------
        float or ndarray
            One number, or one for each airmass.

        Raises
        ------
        ValueError
            If the exposure is not positive.
        """
        exposure = checked_number("exposure", exposure, "s", positive=True)
        height = np.exp(-self.altitude / self.scale_height)
        size = self.coefficient * self.aperture ** (-2 / 3)
        return np.sqrt(1e-5 / exposure) * size * height * np.asarray(self.airmass) ** 1.5

    def draw(self, conditions, generator):
        sigma = series_of(self.rms(conditions.exposure_time), conditions.time, "airmass")
        log_variance = np.log1p(sigma**2)
        each = [g.standard_normal(len(sigma)) for g in generator.spawn(conditions.n_stars)]
        factor = np.exp(np.sqrt(log_variance) * each - log_variance / 2)
        return Drawn({"SCINTILLATION": factor.T})

    def starlight(self, drawn, conditions):
        return drawn.columns["SCINTILLATION"].reshape(-1, conditions.n_stars).T


@dataclass(frozen=True, eq=False, repr=False)
class Seeing(Effect):
    r"""The width of the PSF with the seeing.

    .. math:: w(t) = X(t)^{3/5} e^{s\,g(t)}

    with the airmass X and a Gauss-Markov process g of unit variance. The exponent of X is that of
    Kolmogorov turbulence. The detector's PSF is the one of w = 1.

    Parameters
    ----------
    scatter : float, optional
        Standard deviation s of the logarithm of the width; the default is assumed.
    correlation_time : float or Quantity, optional
        Correlation time of g, days; the default is assumed.
    airmass : float or array_like, optional
        Airmass X, 1 or more, for all cadences or for each.

    Notes
    -----
    The truth has the relative width of each cadence in the column SEEING.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> from scope_models.effects import Seeing
    >>> scene = Star(10.0), Detector.tess(), Motion.ground(3)
    >>> truth = simulate(*scene, seed=1, effects=Seeing(0.0, airmass=2.0)).truth
    >>> print(truth.columns["SEEING"].round(3))
    [1.516 1.516 1.516]
    """

    scatter: float = number(0.15)
    correlation_time: float = number(0.02, "day", positive=True)
    airmass: float | np.ndarray = field(default=1.0, metadata=per_cadence(low=1))

    def draw(self, conditions, generator):
        time = conditions.time
        change = self.scatter * red_noise(generator, time, self.correlation_time)
        return Drawn({"SEEING": series_of(self.airmass, time, "airmass") ** 0.6 * np.exp(change)})

    def width(self, drawn, conditions):
        return drawn.columns["SEEING"]
