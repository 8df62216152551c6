"""The sky: its light, and the atmosphere above a telescope on the ground."""

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

__all__ = [
    "Argabrightening", "Background", "Extinction", "NightSky", "ScatteredLight", "Scintillation",
    "Seeing", "airmass", "moon_geometry",
]  # fmt: skip

_RATE = "electron / s"
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
    """Return the airmass of a star, by the formula of Kasten & Young (1989).

    The barycentric times are taken as those of the observatory; they differ by up to 8 minutes.

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
    """Return the place of the Moon in the sky of an observatory.

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
        ``moon_phase``, the angle between Sun and Earth at the Moon; deg, without refraction.

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
    The truth has X and f in the columns AIRMASS and EXTINCTION. The background is that on the
    ground, and stays. Stars of all colors have the same coefficient.

    References
    ----------
    Patat, F. 2003, A&A 400, 1183, table A.1.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> from scope_models.effects import Extinction
    >>> scene = Star(10.0), Detector.tess(), Motion.ground(3)
    >>> truth = simulate(*scene, seed=1, effects=Extinction(0.1, airmass=[1.0, 1.5, 2.0])).truth
    >>> print(truth.columns["EXTINCTION"].round(3))
    [0.912 0.871 0.832]
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

    with the exposure t (s) [1]_, for exposures that are long against the time in which the
    turbulence crosses the aperture. The noise is white, and each star has its own; that stars
    closer than some arcseconds share some of it is neglected.

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
    The truth has the log-normal factor of each cadence and star, with a mean of 1, in the column
    SCINTILLATION.

    References
    ----------
    .. [1] Osborn, J. et al. 2015, MNRAS 452, 1707.

    Examples
    --------
    >>> from scope_models.effects import Scintillation
    >>> print(Scintillation(3.5, altitude=2788.0).rms(60.0).round(6))
    0.000195
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

    with the airmass X, as for Kolmogorov turbulence, and a Gauss-Markov process g of unit
    variance. The detector's PSF is the one of w = 1.

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


class SkyEffect(Effect):
    """An effect whose truth has a level for each cadence and a plane over the stamp."""

    def pedestal(self, drawn, conditions, part, electrons):
        (level,), (plane,) = drawn.columns.values(), drawn.maps.values()
        added = np.multiply.outer(level[part] * conditions.exposure_time, plane)
        return added, added * (1 - self.residual)

    def _drawn(self, conditions, level):
        """Return the truth of a level for each cadence: it, and 1 plus the gradient."""
        y, x = (np.arange(n) - (n - 1) / 2 for n in conditions.shape)
        plane = 1 + self.gradient[0] * x + self.gradient[1] * y[:, np.newaxis]
        if np.any(plane < 0):
            raise ValueError(f"`gradient` makes the light of some pixels negative: {self.gradient}")
        name = self.name.upper()
        return Drawn({name: level}, {f"{name}_SHAPE": plane})


@dataclass(frozen=True, eq=False, repr=False)
class Background(SkyEffect):
    r"""Diffuse light besides the detector's background.

    .. math:: B(x, y, t) = [l + d (t - t_m)] [1 + g_x (x - x_m) + g_y (y - y_m)]

    with the middles :math:`t_m, x_m, y_m` of series and stamp, in photons that are detected,
    before the response of the pixels.

    Parameters
    ----------
    level : float or Quantity, optional
        Level l, e-/s per pixel. Kepler's zodiacal light is about 166 e-/s, K2's 284.
    drift : float or Quantity, optional
        Change of the level d, e-/s per pixel and day.
    gradient : tuple of float, optional
        Relative change :math:`g_x, g_y` of the level per pixel.
    residual : float, optional
        Part of the light that the subtraction of the background leaves in the flux.
    left : array_like or Quantity, optional
        What it leaves besides, by cadence, e-/s per pixel; negative where it subtracts too much.

    Notes
    -----
    The truth has the level of each cadence (e-/s per pixel) in the column BACKGROUND, and its
    relative shape in the map BACKGROUND_SHAPE.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> from scope_models.effects import Background
    >>> scene = Star(12.0), Detector.k2(), Motion.still(500)
    >>> truth = simulate(*scene, seed=1, effects=Background(100.0, drift=2.0)).truth
    >>> print(truth.columns["BACKGROUND"].max().round(1))
    110.2
    """

    level: float = number(0.0, _RATE)
    drift: float = number(0.0, "electron / (s day)", any_sign=True)
    gradient: tuple[float, float] = number((0.0, 0.0))
    residual: float = number(0.0, any_sign=True)
    left: np.ndarray | None = field(default=None, metadata=per_cadence(_RATE))

    def draw(self, conditions, generator):
        time = conditions.time
        level = self.level + self.drift * (time - (time[0] + time[-1]) / 2)
        if np.any(level < 0):
            raise ValueError(f"`drift` makes the background negative, {level.min():g} e-/s")
        series_of(0.0 if self.left is None else self.left, time, "left")
        return self._drawn(conditions, level)

    def pedestal(self, drawn, conditions, part, electrons):
        added, subtracted = super().pedestal(drawn, conditions, part, electrons)
        if self.left is not None:
            left = self.left[part] * conditions.exposure_time
            subtracted = subtracted - left[:, np.newaxis, np.newaxis]
        return added, subtracted


def _checked_time(name, value):
    return checked_number(name, float(plain_time(value, None, name)), any_sign=True)


@dataclass(frozen=True, eq=False, repr=False)
class ScatteredLight(SkyEffect):
    r"""Light of Earth and Moon that rises toward the ends of TESS's orbits.

    .. math:: B(t) = p \left(e^{-d(t) / \tau} - e^{-P / 2 \tau}\right)

    with the time d to or since the nearest perigee, where one orbit ends and the next begins.

    Parameters
    ----------
    peak : float or Quantity, optional
        Light p at perigee, e-/s per pixel. The default is assumed: ten times TESS's dark sky.
    time_scale : float or Quantity, optional
        Time :math:`\tau` in which it falls by e, days; the default is assumed.
    orbit : float or Quantity, optional
        Period P of the orbit, days.
    perigee : float or Quantity, optional
        Time of a perigee, days; None is the first cadence.
    gradient : tuple of float, optional
        Relative change of the light per pixel along x and y.
    residual : float, optional
        Part of the light that the subtraction of the background leaves in the flux.
    flag_above : float or Quantity, optional
        Light above which cadences have the mission's quality bit, where it has one (TESS: 4096),
        e-/s per pixel; None sets none.

    Notes
    -----
    The truth has the light of each cadence (e-/s per pixel) in the column SCATTEREDLIGHT, and its
    relative shape in the map SCATTEREDLIGHT_SHAPE.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> from scope_models.effects import ScatteredLight
    >>> scene = Star(10.0), Detector.tess(), Motion.still(3)
    >>> truth = simulate(*scene, seed=1, effects=ScatteredLight()).truth
    >>> print(truth.columns["SCATTEREDLIGHT"].max().round(1))
    1338.6
    """

    peak: float = number(1340.0, _RATE)
    time_scale: float = number(1.0, "day", positive=True)
    orbit: float = number(13.7, "day", positive=True)
    perigee: float | None = field(default=None, metadata={"check": _checked_time})
    gradient: tuple[float, float] = number((0.0, 0.0))
    residual: float = number(0.0, any_sign=True)
    flag_above: float | None = number(None, _RATE)

    def draw(self, conditions, generator):
        time = conditions.time
        since = (time - (time[0] if self.perigee is None else self.perigee)) % self.orbit
        nearest = np.minimum(since, self.orbit - since)
        least = np.exp(-self.orbit / 2 / self.time_scale)
        return self._drawn(conditions, self.peak * (np.exp(-nearest / self.time_scale) - least))

    def quality(self, drawn, conditions):
        if self.flag_above is None:
            return None
        strong = drawn.columns["SCATTEREDLIGHT"] > self.flag_above
        return conditions.bit("scattered_light") * strong


@dataclass(frozen=True, eq=False, repr=False)
class Argabrightening(SkyEffect):
    """Flashes of diffuse light in single cadences, as of debris from the spacecraft.

    Their brightness is distributed exponentially. Cadences with a flash have the mission's
    quality bit, where it has one.

    Parameters
    ----------
    rate : float or Quantity, optional
        Mean number of flashes per day.
    brightness : float or Quantity, optional
        Mean brightness of a flash, e-/s per pixel.
    gradient : tuple of float, optional
        Relative change of the light per pixel along x and y.
    residual : float, optional
        Part of the light that the subtraction of the background leaves in the flux.

    Notes
    -----
    The truth has the light of each cadence (e-/s per pixel) in the column ARGABRIGHTENING, and
    its relative shape in the map ARGABRIGHTENING_SHAPE. The defaults are assumed.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> from scope_models.effects import Argabrightening
    >>> scene = Star(12.0), Detector.k2(), Motion.still(500)
    >>> truth = simulate(*scene, seed=1, effects=Argabrightening(rate=1.0)).truth
    >>> print((truth.columns["ARGABRIGHTENING"] > 0).sum())
    9
    """

    rate: float = number(0.05, "1 / day")
    brightness: float = number(100.0, _RATE)
    gradient: tuple[float, float] = number((0.0, 0.0))
    residual: float = number(0.0, any_sign=True)

    def draw(self, conditions, generator):
        n = len(conditions.time)
        chance, brightness = generator.random(n), generator.standard_exponential(n)
        flash = chance < -np.expm1(-self.rate * conditions.cadence_days)
        return self._drawn(conditions, np.where(flash, self.brightness * brightness, 0.0))

    def quality(self, drawn, conditions):
        return conditions.bit("argabrightening") * (drawn.columns["ARGABRIGHTENING"] > 0)


@dataclass(frozen=True, eq=False, repr=False)
class NightSky(SkyEffect):
    r"""Brightness of the sky by airmass and Moon.

    The detector's background is the dark sky at the zenith. Toward the horizon it has the factor
    :math:`X 10^{-0.4 k (X - 1)}`, and scattered moonlight adds, in nanolamberts [1]_,

    .. math:: B = f(\rho)\, 10^{-0.4 (3.84 + 0.026 \alpha + 4 \times 10^{-9} \alpha^4)}\,
              10^{-0.4 k X_m} \left(1 - 10^{-0.4 k X}\right) , \qquad
              f(\rho) = 10^{5.36} (1.06 + \cos^2 \rho) + 10^{6.15 - \rho / 40}

    with the angle :math:`\rho` from the Moon, its phase angle :math:`\alpha`, the airmass X of the
    star and :math:`X_m = (1 - 0.96 \sin^2 z_m)^{-1/2}` of the Moon at the zenith distance
    :math:`z_m`; the dark sky has :math:`34.08\, e^{20.7233 - 0.92104 V}` for V mag per square
    arcsecond. Other bands than V are taken to have the same ratio of moonlight to dark sky.

    Parameters
    ----------
    airmass : float or array_like, optional
        Airmass of the star, 1 or more, for all cadences or for each.
    moon_altitude, moon_separation, moon_phase : float, array_like or Quantity, optional
        Altitude of the Moon, its separation from the star and its phase angle (0 is full, 180
        new), deg, for all cadences or for each: `moon_geometry` computes them. Below the horizon
        the Moon gives no light.
    extinction : float or Quantity, optional
        Coefficient k, mag per airmass; the default is that of V at Paranal [2]_.
    dark_sky : float or Quantity, optional
        Brightness V of the dark sky at the zenith, mag per square arcsecond; Paranal [2]_.
    gradient : tuple of float, optional
        Relative change of the light per pixel along x and y.
    residual : float, optional
        Part of the light that the subtraction of the background leaves in the flux.

    Notes
    -----
    The truth has what is added to the detector's background (e-/s per pixel) in the column
    NIGHTSKY, and its relative shape in the map NIGHTSKY_SHAPE. It is good to 8 to 23 % [1]_.

    References
    ----------
    .. [1] Krisciunas, K. & Schaefer, B. E. 1991, PASP 103, 1033.
    .. [2] Patat, F. 2003, A&A 400, 1183.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> from scope_models.effects import NightSky
    >>> full = NightSky(moon_altitude=50.0, moon_separation=60.0, moon_phase=5.0)
    >>> scene = Star(10.0), Detector.tess(background=10.0), Motion.ground(3)
    >>> truth = simulate(*scene, seed=1, effects=full).truth
    >>> print(truth.columns["NIGHTSKY"].round(0))
    [96. 96. 96.]
    """

    airmass: float | np.ndarray = field(default=1.0, metadata=per_cadence(low=1))
    moon_altitude: float | np.ndarray = field(default=-90.0, metadata=per_cadence("deg", -90, 90))
    moon_separation: float | np.ndarray = field(default=90.0, metadata=per_cadence("deg", 0, 180))
    moon_phase: float | np.ndarray = field(default=180.0, metadata=per_cadence("deg", 0, 180))
    extinction: float = number(0.11, "mag")
    dark_sky: float = number(21.6, "mag")
    gradient: tuple[float, float] = number((0.0, 0.0))
    residual: float = number(0.0, any_sign=True)

    def draw(self, conditions, generator):
        airmass, moon_altitude, moon_separation, moon_phase = (
            series_of(getattr(self, name), conditions.time, name) for name in self.by_cadence
        )
        k = self.extinction
        dark = airmass * 10 ** (-0.4 * k * (airmass - 1))
        zenith = 34.08 * np.exp(20.7233 - 0.92104 * self.dark_sky)
        scattering = 10**5.36 * (1.06 + np.cos(np.radians(moon_separation)) ** 2)
        scattering += 10 ** (6.15 - moon_separation / 40)
        moon = 10 ** (-0.4 * (3.84 + 0.026 * moon_phase + 4e-9 * moon_phase**4))
        path = (1 - 0.96 * np.cos(np.radians(moon_altitude)) ** 2) ** -0.5
        light = scattering * moon * 10 ** (-0.4 * k * path) * (1 - 10 ** (-0.4 * k * airmass))
        factor = dark + np.where(moon_altitude > 0, light, 0.0) / zenith
        return self._drawn(conditions, conditions.background * (factor - 1))
