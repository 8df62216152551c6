"""Diffuse light, of the sky in space and on the ground, and the residual of its subtraction."""

from dataclasses import dataclass, field

import numpy as np

from scope_models._arrays import plain_time
from scope_models._checks import checked_number, number
from scope_models.effects.base import Drawn, Effect, per_cadence, series_of

__all__ = ["Argabrightening", "Background", "NightSky", "ScatteredLight"]

_RATE = "electron / s"


class SkyEffect(Effect):
    """An effect whose truth has a level for each cadence and a plane over the stamp."""

    def pedestal(self, drawn, conditions, part, electrons):
        level = drawn.columns[self.name.upper()][part] * conditions.exposure_time
        added = level[:, np.newaxis, np.newaxis] * drawn.maps[f"{self.name.upper()}_SHAPE"]
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
    r"""Diffuse light besides the detector's background: level, drift and gradient.

    .. math:: B(x, y, t) = [l + d (t - t_m)] [1 + g_x (x - x_m) + g_y (y - y_m)]

    with the middles :math:`t_m, x_m, y_m` of series and stamp. Level and drift are photons that
    are detected, before the response of the pixels.

    Parameters
    ----------
    level : float or Quantity, optional
        Level l, e-/s per pixel. Kepler's zodiacal light is about 166 e-/s, K2's 284.
    drift : float or Quantity, optional
        Change of the level d, e-/s per pixel and day.
    gradient : tuple of float, optional
        Relative change :math:`g_x, g_y` of the level per pixel.
    residual : float, optional
        Part of the light that the subtraction of the background leaves in the flux; 0 subtracts
        all of it, 1 none.
    left : array_like or Quantity, optional
        What the subtraction leaves besides, by cadence, e-/s per pixel; negative where it
        subtracts too much.

    Notes
    -----
    The truth has the level of each cadence (e-/s per pixel) in the column BACKGROUND, and its
    relative shape in the map BACKGROUND_SHAPE.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> from scope_models.effects import Background
    >>> sky = Background(100.0, drift=20.0, gradient=(0.01, 0.0), residual=0.1)
    >>> scene = Star(12.0), Detector.k2().without_sensitivity(), Motion.still(3)
    >>> observation = simulate(*scene, noise=False, effects=[sky])
    >>> print(observation.flux[1, 0, 5].round(2), observation.flux_bkg[1, 0, 5].round(2))
    10.0 374.0
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


@dataclass(frozen=True, eq=False, repr=False)
class ScatteredLight(SkyEffect):
    r"""Light of Earth and Moon that rises toward the ends of TESS's orbits.

    .. math:: B(t) = p \left(e^{-d(t) / \tau} - e^{-P / 2 \tau}\right)

    with the time d to or since the nearest perigee, where one orbit ends and the next begins.

    Parameters
    ----------
    peak : float or Quantity, optional
        Light p at perigee, e-/s per pixel. The default is assumed: ten times the dark sky of
        `Detector.tess <scope_models.Detector.tess>`.
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
        Light from which cadences have the mission's quality bit, where it has one, e-/s per
        pixel; None sets none. TESS sets its bit 4096 where light of Earth or Moon is strong.

    Notes
    -----
    The truth has the light of each cadence (e-/s per pixel) in the column SCATTEREDLIGHT, and its
    relative shape in the map SCATTEREDLIGHT_SHAPE.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> from scope_models.effects import ScatteredLight
    >>> motion = Motion.still(28, cadence=0.5, start=1325.0, time_format="btjd")
    >>> scene = Star(10.0), Detector.tess(), motion
    >>> light = simulate(*scene, effects=[ScatteredLight()]).truth.columns["SCATTEREDLIGHT"]
    >>> print(light[[0, 2, 14, 27]].round(1))
    [1.3386e+03 4.9150e+02 2.0000e-01 1.0957e+03]
    """

    peak: float = number(1340.0, _RATE)
    time_scale: float = number(1.0, "day", positive=True)
    orbit: float = number(13.7, "day", positive=True)
    perigee: float | None = None
    gradient: tuple[float, float] = number((0.0, 0.0))
    residual: float = number(0.0, any_sign=True)
    flag_above: float | None = number(None, _RATE)

    def __post_init__(self):
        super().__post_init__()
        if self.perigee is not None:
            days = float(plain_time(self.perigee, None, "perigee"))
            object.__setattr__(self, "perigee", checked_number("perigee", days, any_sign=True))

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

    Each cadence has a flash with the same probability; flashes have exponentially distributed
    brightness. Cadences with a flash have the mission's quality bit, where it has one.

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
    >>> observation = simulate(*scene, seed=1, effects=[Argabrightening(rate=1.0)])
    >>> flashes = observation.truth.columns["ARGABRIGHTENING"] > 0
    >>> bool((observation.quality[flashes] == 64).all())
    True
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
