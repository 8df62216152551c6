"""The sky above a telescope on the ground: airglow, and moonlight that the air scatters."""

from dataclasses import dataclass

import astropy.units as u
import numpy as np
from astropy.coordinates import CartesianRepresentation, SkyCoord, get_body, get_sun
from astropy.time import Time

from scope_models._arrays import plain_time
from scope_models._checks import number
from scope_models.effects.atmosphere import AirEffect, horizon_altitude, of_date, sidereal_time
from scope_models.effects.background import SkyEffect
from scope_models.effects.base import series_of
from scope_models.missions import TIME_ZEROS

__all__ = ["NightSky", "moon_geometry"]

_DOMAINS = {"moon_altitude": (-90, 90), "moon_separation": (0, 180), "moon_phase": (0, 180)}


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
    moon, sun = get_body("moon", times, ephemeris="builtin"), get_sun(times)
    elongation = moon.separation(sun, origin_mismatch="ignore").rad
    sun_side = (sun.distance / moon.distance).to_value(u.one)
    phase = np.arctan2(sun_side * np.sin(elongation), 1 - sun_side * np.cos(elongation))
    # The observatory is up to an Earth's radius from the center: a degree of parallax.
    sidereal = np.radians(sidereal_time(days, location))
    radius, east = np.hypot(location.x, location.y), location.lon.rad + sidereal
    height = np.full(days.shape, location.z.to_value(u.m)) * u.m
    observatory = CartesianRepresentation(radius * np.cos(east), radius * np.sin(east), height)
    center = of_date(SkyCoord(moon.ra, moon.dec, moon.distance), days[0])
    seen = SkyCoord(center.cartesian - observatory, frame=star)
    return {
        "moon_altitude": horizon_altitude(days, seen, location),
        "moon_separation": seen.separation(star).deg,
        "moon_phase": np.degrees(np.abs(phase)),
    }


@dataclass(frozen=True, eq=False, repr=False)
class NightSky(AirEffect, SkyEffect):
    r"""Brightness of the sky by airmass and Moon.

    The detector's background is the dark sky at the zenith. Toward the horizon it has the factor
    :math:`X 10^{-0.4 k (X - 1)}`, and scattered moonlight adds, in nanolamberts [1]_,

    .. math:: B = f(\rho)\, 10^{-0.4 (3.84 + 0.026 \alpha + 4 \times 10^{-9} \alpha^4)}\,
              10^{-0.4 k X_m} \left(1 - 10^{-0.4 k X}\right) , \qquad
              f(\rho) = 10^{5.36} (1.06 + \cos^2 \rho) + 10^{6.15 - \rho / 40}

    with the angle :math:`\rho` from the Moon, its phase angle :math:`\alpha`, the airmass X of the
    star and :math:`X_m = (1 - 0.96 \sin^2 z_m)^{-1/2}` of the Moon at the zenith distance
    :math:`z_m`; the dark sky has :math:`34.08\, e^{20.7233 - 0.92104 V}` for V mag per square
    arcsecond. The formula is for the V band; in others moonlight is taken to have the same ratio
    to the dark sky.

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
    The truth has what the sky adds to the detector's background (e-/s per pixel) in the column
    NIGHTSKY, and its relative shape in the map NIGHTSKY_SHAPE. The model is good to 8 to 23 % [1]_.

    References
    ----------
    .. [1] Krisciunas, K. & Schaefer, B. E. 1991, PASP 103, 1033.
    .. [2] Patat, F. 2003, A&A 400, 1183.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> from scope_models.effects import NightSky
    >>> full = NightSky(moon_altitude=50.0, moon_separation=60.0, moon_phase=5.0)
    >>> detector = Detector.tess(background=10.0)
    >>> truth = simulate(Star(10.0), detector, Motion.ground(1), effects=full).truth
    >>> print(truth.columns["NIGHTSKY"].round(0))
    [96.]
    """

    airmass: float | np.ndarray = 1.0
    moon_altitude: float | np.ndarray = -90.0
    moon_separation: float | np.ndarray = 90.0
    moon_phase: float | np.ndarray = 180.0
    extinction: float = number(0.11, "mag")
    dark_sky: float = number(21.6, "mag")
    gradient: tuple[float, float] = number((0.0, 0.0))
    residual: float = number(0.0, any_sign=True)

    by_cadence = ("airmass", *_DOMAINS)

    def __post_init__(self):
        super().__post_init__()
        for name, (low, high) in _DOMAINS.items():
            self._check(name, u.deg, f"between {low} and {high} deg", low, high)

    def draw(self, conditions, generator):
        values = {name: getattr(self, name) for name in self.by_cadence}
        series = {name: series_of(v, conditions.time, name) for name, v in values.items()}
        factor = self._relative_brightness(**series)
        return self._drawn(conditions, conditions.background * (factor - 1))

    def _relative_brightness(self, airmass, moon_altitude, moon_separation, moon_phase):
        """Return the brightness of the sky relative to the dark sky at the zenith."""
        k = self.extinction
        dark = airmass * 10 ** (-0.4 * k * (airmass - 1))
        zenith = 34.08 * np.exp(20.7233 - 0.92104 * self.dark_sky)
        scattering = 10**5.36 * (1.06 + np.cos(np.radians(moon_separation)) ** 2)
        scattering += 10 ** (6.15 - moon_separation / 40)
        moon = 10 ** (-0.4 * (3.84 + 0.026 * moon_phase + 4e-9 * moon_phase**4))
        path = (1 - 0.96 * np.cos(np.radians(moon_altitude)) ** 2) ** -0.5
        light = scattering * moon * 10 ** (-0.4 * k * path) * (1 - 10 ** (-0.4 * k * airmass))
        return dark + np.where(moon_altitude > 0, light, 0.0) / zenith
