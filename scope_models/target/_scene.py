"""The scene of a target: what is on the stamp, and what is seen of it."""

import warnings

import numpy as np

from scope_models._checks import checked_number, checked_pair
from scope_models.effects.noise import check_seed, fresh_seed, stream
from scope_models.exceptions import LostLightWarning
from scope_models.models import TransitModel, sinusoidal_signal
from scope_models.photometry import crowding, threshold_aperture
from scope_models.scene.star import Star
from scope_models.simulation import simulate

__all__ = ["TargetScene"]


class TargetScene:
    """What is on the stamp; see `Target`."""

    def __init__(self, star, detector, motion, *, seed=None, noise=True):
        if star.x_0 is None or star.y_0 is None:
            raise ValueError("`star` must have a position (x_0, y_0)")
        self.star = star
        self.neighbors = []
        self.transits = []
        self.detector = detector
        self.motion = motion
        self.seed = fresh_seed() if seed is None else check_seed(seed)
        self._noise = noise
        self._aperture = None  # as chosen by the user
        self._forget()
        _ = self.observation  # errors and warnings come here, not at the first look

    def __repr__(self):
        ny, nx = self.detector.shape
        return (
            f"<Target of magnitude {self.star.mag:g} with {_plural(len(self.transits), 'transit')} "
            f"and {_plural(len(self.neighbors), 'neighbour')}: {len(self.motion)} cadences of "
            f"{ny} x {nx} pixels, seed {self.seed}>"
        )

    def _forget(self):
        """Drop what was computed of the scene."""
        self._observation = self._images = self._detrended = None

    # -- what is seen ----------------------------------------------------------------------------

    @property
    def observation(self):
        """The `~scope_models.Observation`, with the truth."""
        if self._observation is None:
            stars = [self.star, *self.neighbors]
            self._observation = self._simulate(stars, self._noise)
        return self._observation

    def _simulate(self, stars, noise):
        return simulate(stars, self.detector, self.motion, seed=self.seed, noise=noise)

    @property
    def time(self):
        """Times of the cadences in days, as the motion has them (BKJD)."""
        return self.motion.time

    @property
    def targetpixelfile(self):
        """Flux without background in e-/s, shape ``(n_cadences, ny, nx)``."""
        return self.observation.flux

    @property
    def error(self):
        """Standard deviation of the flux in e-/s, shape ``(n_cadences, ny, nx)``."""
        return self.observation.flux_err

    @property
    def lightcurve(self):
        """Sum of the flux in `aperture` in e-/s, shape ``(n_cadences,)``."""
        return self.targetpixelfile[:, self.aperture].sum(axis=1, dtype=float)

    @property
    def aperture(self):
        """Mask ``(ny, nx)`` that `create_aperture` made, the paper's by default."""
        if self._aperture is None:
            return threshold_aperture(self._noise_free[0])
        return self._aperture

    @property
    def contamination(self):
        """Share of the neighbours in the starlight of the aperture, 0 to 1.

        A signal of the star of depth d has the depth (1 - contamination) d in the light curve.
        """
        return 1 - crowding(*self._noise_free, self.aperture)

    @property
    def _noise_free(self):
        """Noise-free cubes of the star, and of all neighbours or None."""
        if self._images is None:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", LostLightWarning)  # told by the observation
                own = self._simulate(self.star, noise=False).flux
                others = self._simulate(self.neighbors, False).flux if self.neighbors else None
            self._images = own, others
        return self._images

    # -- what is added ---------------------------------------------------------------------------

    def add_transit(self, depth=0.01, per=15.0, dur=0.5, t0=5.0, *, b=0.0, u1=0.4, u2=0.26):
        """
        Let a planet on a circular orbit transit the star.

        Parameters
        ----------
        depth : float, optional
            Relative drop at mid-transit, between 0 and 1.
        per : float, optional
            Orbital period in days.
        dur : float, optional
            Time from first to fourth contact in days.
        t0 : float, optional
            Time of a mid-transit in days after the first cadence.
        b : float, optional
            Impact parameter in stellar radii.
        u1, u2 : float, optional
            Coefficients of quadratic limb darkening.

        Returns
        -------
        `Target`
            The same object.

        Raises
        ------
        ValueError
            If an argument is outside its domain.

        Examples
        --------
        >>> import scope_models as scope
        >>> star = scope.generate_target(ncadences=500, seed=1)
        >>> planet = star.add_transit(depth=0.01, per=15, dur=0.5, t0=5).transits[0]
        >>> print(f"{planet.depth:.4f} {planet.duration:.4f}")
        0.0100 0.5000
        """
        _require_positive(per=per, dur=dur)
        checked_number("t0", t0, any_sign=True)
        planet = TransitModel.from_depth_duration(
            depth,
            dur,
            per,
            self.time[0] + t0,
            b=b,
            u1=u1,
            u2=u2,
            exposure_time=self.detector.cadence_days,
        )
        self.add_signal(planet)
        self.transits.append(planet)
        return self

    def add_variability(self, var_amp=0.005, freq=0.25):
        """
        Let the star vary sinusoidally, by ``1 + var_amp * sin(freq * t)``.

        Parameters
        ----------
        var_amp : float, optional
            Relative semi-amplitude, between 0 and 1.
        freq : float, optional
            Angular frequency in radians per day, of the time t after the
            first cadence: the period is ``2 * pi / freq`` days.

        Returns
        -------
        `Target`
            The same object.

        Raises
        ------
        ValueError
            If an argument is outside its domain.

        See Also
        --------
        Target.add_signal : Variability of any kind.

        Examples
        --------
        >>> import scope_models as scope
        >>> star = scope.generate_target(ncadences=500, seed=1)
        >>> varied = star.add_variability(var_amp=0.005, freq=0.25).observation.truth.relative_flux
        >>> print(f"{varied.min():.3f} {varied.max():.3f}")
        1.000 1.005
        """
        _require_positive(var_amp=var_amp, freq=freq)
        period = 2 * np.pi / freq
        return self.add_signal(sinusoidal_signal(var_amp, period, -self.time[0] / period))

    def add_signal(self, signal):
        """
        Multiply the star's flux with a signal.

        Parameters
        ----------
        signal : `~astropy.modeling.Model` or callable or array_like
            Relative flux: a model or function of the times `time`, or an
            array ``(n_cadences,)``.

        Returns
        -------
        `Target`
            The same object.

        Raises
        ------
        ValueError
            If the signal has another length, or is negative or not finite.

        Examples
        --------
        >>> import scope_models as scope
        >>> from scope_models.models import stochastic_signal
        >>> star = scope.generate_target(ncadences=500, seed=1)
        >>> granulation = stochastic_signal(star.time, cdpp=50, seed=2)
        >>> star.add_signal(granulation).estimate_cdpp() > 40
        True
        """
        more = Star(self.star.mag, signal=signal).relative_flux(self.time)
        self.star = self.star.replace(signal=self.star.relative_flux(self.time) * more)
        self._forget()
        return self

    def add_neighbor(
        self, magdiff=1.0, dist=1.7, *, angle=None, position=None, psf=None, signal=None
    ):
        """
        Put another star onto the stamp.

        Parameters
        ----------
        magdiff : float, optional
            Its magnitude minus that of the star: positive is fainter.
        dist : float, optional
            Its distance from the star in pixels; not used with `position`.
        angle : float, optional
            Direction in degrees from growing columns towards growing rows;
            by default random, drawn from the seed, and on the stamp.
        position : tuple of float, optional
            Its column and row, in place of `dist` and `angle`.
        psf : `~astropy.modeling.Model`, optional
            Its PSF; by default that of the detector.
        signal : optional
            Its own relative flux, as in `add_signal`: an eclipsing
            background binary is a deep `~scope_models.TransitModel`.

        Returns
        -------
        `Target`
            The same object.

        Raises
        ------
        ValueError
            If the neighbour is off the stamp.

        Examples
        --------
        >>> import scope_models as scope
        >>> star = scope.generate_target(ncadences=100, seed=1)
        >>> print(round(star.add_neighbor(magdiff=1, dist=1.7).contamination, 2))
        0.22
        """
        magdiff = checked_number("magdiff", magdiff, any_sign=True)
        if position is None:
            x_0, y_0 = self._direction(checked_number("dist", dist), angle)
        else:
            x_0, y_0 = checked_pair("position", position)
        if not self._on_stamp(x_0, y_0):
            ny, nx = self.detector.shape
            raise ValueError(
                f"the neighbour at column {x_0:.2f}, row {y_0:.2f} is off the stamp of "
                f"{ny} x {nx} pixels"
            )
        neighbor = Star(self.star.mag + magdiff, x_0, y_0, psf, signal)
        neighbor.relative_flux(self.time)  # a signal that does not fit is an error here
        self.neighbors.append(neighbor)
        self._forget()
        return self

    def _direction(self, dist, angle):
        """Return the position at a distance; the first random one on the stamp."""
        if angle is None:
            generator = stream(self.seed, f"neighbor {len(self.neighbors)}")
            angles = generator.uniform(0, 2 * np.pi, 1000)
        else:
            angles = np.radians([checked_number("angle", angle, any_sign=True)])
        places = [
            (self.star.x_0 + dist * np.cos(phi), self.star.y_0 + dist * np.sin(phi))
            for phi in angles
        ]
        return next((place for place in places if self._on_stamp(*place)), places[0])

    def _on_stamp(self, x_0, y_0):
        ny, nx = self.detector.shape
        return -0.5 <= x_0 <= nx - 0.5 and -0.5 <= y_0 <= ny - 0.5


def _require_positive(**values):
    for name, value in values.items():
        checked_number(name, value, positive=True)


def _plural(number, noun):
    return f"{number} {noun}{'' if number == 1 else 's'}"
