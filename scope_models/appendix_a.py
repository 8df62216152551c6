"""The paper's Appendix A: a simulated star whose parts are added one by one.

A thin layer over `~scope_models.Scene`, `~scope_models.simulate`, the corrector and the figures.
"""

import warnings
from functools import wraps
from operator import attrgetter

import astropy.units as u
import numpy as np

from scope_models._arrays import PER_PIXEL
from scope_models._checks import checked_integer, checked_mask, checked_number, checked_pair
from scope_models._docstrings import documented
from scope_models._values import value_key
from scope_models.effects.noise import check_seed, fresh_seed, noise_terms, stream
from scope_models.exceptions import LostLightWarning
from scope_models.models import PRF, TransitModel, sinusoidal_signal
from scope_models.photometry import (
    cdpp,
    circular_aperture,
    contamination_aperture,
    crowding,
    signal_to_noise_aperture,
    threshold_aperture,
)
from scope_models.scene.detector import Detector
from scope_models.scene.motion import Motion
from scope_models.scene.scene import Scene
from scope_models.scene.star import Star
from scope_models.simulation import Observation, simulate

__all__ = ["Target", "generate_target"]

_NCADENCES = 1000
# Parts of the docstrings of several methods.
_SAME = """Returns
-------
`Target`
    The same object."""


def generate_target(
    mag=12.0,
    roll=1.0,
    coords=None,
    background_level=None,
    neighbor_magdiff=1.0,
    ncadences=None,
    apsize=7,
    ID=None,
    transit=False,
    variable=False,
    neighbor=False,
    tpf_path=None,
    no_sensitivity_variation=False,
    signal=None,
    *,
    motion=None,
    psf=None,
    detector=None,
    noise=True,
    seed=None,
):
    """Simulate a star on a moving detector, as in the paper's Appendix A.

    Parameters
    ----------
    mag : float, optional
        Magnitude in the mission's band (Kp).
    roll : float, optional
        Factor on the motion; 1 is K2's, 0 stands still.
    coords : tuple of float, optional
        Reference position (column, row) in pixels from 0; by default the center of the stamp.
    background_level : float, optional
        Background in e-/s per pixel; by default that of the detector.
    neighbor_magdiff : float, optional
        Magnitude of the neighbor minus `mag`, for ``neighbor=True``.
    ncadences : int, optional
        Number of cadences; by default 1000, or all of a shorter motion.
    apsize : int, optional
        Rows and columns of the stamp; not used with a `detector`.
    ID : int, optional
        EPIC number of a K2 target whose motion is downloaded.
    transit, variable, neighbor : bool, optional
        Add a transit, variability or a neighbor with the defaults of `Target.add_transit`,
        `Target.add_variability` and `Target.add_neighbor`.
    tpf_path : str or path-like, optional
        A target pixel or light-curve file whose motion is taken.
    no_sensitivity_variation : bool, optional
        Let all pixels respond alike and evenly, as a control.
    signal : optional
        The star's own relative flux, see `Target.add_signal`.
    motion : `~scope_models.Motion`, optional
        The motion. By default, and without `ID` and `tpf_path`, the generated roll of
        `scope_models.Motion.k2_roll`.
    psf : `~astropy.modeling.Model`, optional
        PSF of the star; by default that of the detector.
    detector : `~scope_models.Detector`, optional
        The detector; by default ``Detector.k2()`` with a stamp of `apsize`.
    noise : bool or iterable of str, optional
        The noise terms, see `~scope_models.simulate`.
    seed : int, optional
        Seed of noise, interpixel map and random positions of neighbors; by default a new one, kept
        as ``Target.seed``.

    Returns
    -------
    `Target`
        The star.

    Raises
    ------
    ValueError
        If an argument is outside its domain, `ncadences` exceeds the length of the motion, more
        than one source of motion is given, or the EPIC number is unknown.
    TypeError
        If an option is misspelled or of the wrong kind.
    ConnectionError
        If the motion of an EPIC number cannot be downloaded.

    Warns
    -----
    LostLightWarning
        If the motion takes light off the stamp.

    Examples
    --------
    >>> import scope_models as scope
    >>> star = scope.generate_target(mag=12, ncadences=200, seed=1)
    >>> star.targetpixelfile.shape, star.lightcurve.shape
    ((200, 7, 7), (200,))
    >>> star.add_transit(depth=0.01, per=15, dur=0.5, t0=2).add_neighbor(magdiff=2)
    <Target of magnitude 12 with 1 transit and 1 neighbor: 200 cadences of 7 x 7 pixels, seed 1>
    """
    seed = fresh_seed() if seed is None else check_seed(seed)
    motion = _find_motion(motion, tpf_path, ID, ncadences)
    if detector is None:
        apsize = checked_integer("apsize", apsize, 1)
        detector = Detector.k2(shape=(apsize, apsize))
    elif not isinstance(detector, Detector):
        raise TypeError(f"`detector` must be a Detector, got {detector!r}")
    if background_level is not None:
        level = checked_number(
            "background_level", background_level, u.electron / u.s, equivalencies=PER_PIXEL
        )
        detector = detector.replace(background=level)
    if no_sensitivity_variation:
        detector = detector.without_sensitivity()
    ny, nx = detector.shape
    x_0, y_0 = (
        ((nx - 1) / 2, (ny - 1) / 2) if coords is None else checked_pair("coords", coords, u.pix)
    )
    if not _on_stamp(x_0, y_0, detector):
        raise ValueError(f"`coords` must be on the stamp of {ny} x {nx} pixels, got {coords!r}")
    star = Star(mag, x_0, y_0, psf)
    motion = checked_number("roll", roll, any_sign=True) * motion
    target = Target(star, detector, motion, seed=seed, noise=noise)
    if signal is not None:
        target.add_signal(signal)
    if transit:
        target.add_transit()
    if variable:
        target.add_variability()
    if neighbor:
        magdiff = checked_number("neighbor_magdiff", neighbor_magdiff, u.mag, any_sign=True)
        target.add_neighbor(magdiff=magdiff)
    return target


def _forwarded(name):
    """Return a method of the observation, by default with the aperture of the target."""
    method = getattr(Observation, name)

    @wraps(method)
    def forwarded(self, *arguments, **options):
        options = {"aperture_mask": self.aperture} | options
        return getattr(self.observation, name)(*arguments, **options)

    return forwarded


class Target:
    """A simulated star, its neighbors and its pixels.

    `generate_target` makes it. What is added changes the expected flux only: the noise of all else
    stays as it was, as every effect draws from its own stream of the seed. All attributes below may
    be changed: the next look at the pixels simulates what they are then.

    Parameters
    ----------
    star : `~scope_models.Star`
        The star; its position must be given.
    detector : `~scope_models.Detector`
        The pixels.
    motion : `~scope_models.Motion`
        The motion.
    seed : int, optional
        The seed; by default a new one.
    noise : bool or iterable of str, optional
        The noise terms, see `~scope_models.simulate`.

    Attributes
    ----------
    star : `~scope_models.Star`
        The star, with all signals that were added.
    neighbors : list of `~scope_models.Star`
        Its neighbors.
    transits : list of `~scope_models.TransitModel`
        The transits that were added.
    detector, motion, seed, noise
        See the parameters.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star
    >>> from scope_models import Target
    >>> star = Target(Star(12.0, 5, 5), Detector.k2(), Motion.still(100), seed=1)
    >>> star.add_transit(depth=0.01, per=15, dur=0.5, t0=1)
    <Target of magnitude 12 with 1 transit and 0 neighbors: 100 cadences of 11 x 11 pixels, seed 1>
    """

    def __init__(self, star, detector, motion, *, seed=None, noise=True):
        if star.x_0 is None or star.y_0 is None:
            raise ValueError("`star` must have a position (x_0, y_0)")
        self.star = star
        self.neighbors = []
        self.transits = []
        self.detector = detector
        self.motion = motion
        self.seed = fresh_seed() if seed is None else check_seed(seed)
        self.noise = noise_terms(noise)
        self._aperture = None  # as chosen by the user
        self._made = {}  # what was computed, with what it was computed of
        _ = self.observation  # errors and warnings come here, not at the first look

    def __repr__(self):
        ny, nx = self.detector.shape
        return (
            f"<Target of magnitude {self.star.mag:g} with {_plural(len(self.transits), 'transit')} "
            f"and {_plural(len(self.neighbors), 'neighbor')}: {len(self.motion)} cadences of "
            f"{ny} x {nx} pixels, seed {self.seed}>"
        )

    def _kept(self, name, make):
        """Return what was made of the scene as it is now, made again if the scene has changed."""
        key = value_key(self.scene)
        if self._made.get(name, (None,))[0] != key:
            self._made[name] = key, make()
        return self._made[name][1]

    # -- what is seen ----------------------------------------------------------------------------

    @property
    def scene(self):
        """The `~scope_models.Scene` of the star, its neighbors, the pixels and the motion."""
        stars = [self.star, *self.neighbors]
        return Scene(stars, self.detector, self.motion, seed=self.seed, noise=self.noise)

    @property
    def observation(self):
        """The `~scope_models.Observation`, with the truth."""
        return self._kept("observation", lambda: simulate(self.scene))

    time = property(
        attrgetter("motion.time"),
        doc="Times of the cadences in days, as the motion has them (BKJD).",
    )
    targetpixelfile = property(
        attrgetter("observation.flux"),
        doc="Flux without background in e-/s, shape ``(n_cadences, ny, nx)``.",
    )
    error = property(
        attrgetter("observation.flux_err"),
        doc="Standard deviation of the flux in e-/s, shape ``(n_cadences, ny, nx)``.",
    )

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
        """Share of the neighbors in the starlight of the aperture, 0 to 1.

        A signal of the star of depth d has the depth (1 - contamination) d in the light curve.
        """
        return 1 - crowding(*self._noise_free, self.aperture)

    @property
    def _noise_free(self):
        """Noise-free cubes of the star, and of all neighbors or None."""
        return self._kept(
            "noise-free", lambda: (self._alone([self.star]), self._alone(self.neighbors))
        )

    def _alone(self, stars):
        """Return the noise-free cube of some stars, None of none."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", LostLightWarning)  # the observation has warned
            return simulate(self.scene.replace(stars=stars, noise=False)).flux if stars else None

    @property
    def _detrended(self):
        """The light curve that `detrend` has made of the scene as it is now, or None."""
        key, light_curve = self._made.get("detrended", (None, None))
        return light_curve if key == value_key(self.scene) else None

    # -- what is added ---------------------------------------------------------------------------

    @documented(same=_SAME)
    def add_transit(self, depth=0.01, per=15.0, dur=0.5, t0=5.0, *, b=0.0, u1=0.4, u2=0.26):
        """Let a planet on a circular orbit transit the star.

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

        {same}

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
        per = checked_number("per", per, u.day, positive=True)
        dur = checked_number("dur", dur, u.day, positive=True)
        t0 = checked_number("t0", t0, u.day, any_sign=True)
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

    @documented(same=_SAME)
    def add_variability(self, var_amp=0.005, freq=0.25):
        """Let the star vary sinusoidally, by ``1 + var_amp * sin(freq * t)``.

        Parameters
        ----------
        var_amp : float, optional
            Relative semi-amplitude, between 0 and 1.
        freq : float, optional
            Angular frequency in radians per day, of the time t after the first cadence: the period
            is ``2 * pi / freq`` days.

        {same}

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
        var_amp = checked_number("var_amp", var_amp, positive=True)
        freq = checked_number("freq", freq, u.rad / u.day, positive=True)
        period = 2 * np.pi / freq
        return self.add_signal(sinusoidal_signal(var_amp, period, -self.time[0] / period))

    @documented(same=_SAME)
    def add_signal(self, signal):
        """Multiply the star's flux with a signal.

        Parameters
        ----------
        signal : `~astropy.modeling.Model` or callable or array_like
            Relative flux: a model or function of the times `time`, or an array ``(n_cadences,)``.

        {same}

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
        return self

    @documented(same=_SAME)
    def add_neighbor(
        self, magdiff=1.0, dist=1.7, *, angle=None, position=None, psf=None, signal=None
    ):
        """Put another star onto the stamp.

        Parameters
        ----------
        magdiff : float, optional
            Its magnitude minus that of the star: positive is fainter.
        dist : float, optional
            Its distance from the star in pixels; not used with `position`.
        angle : float, optional
            Direction in degrees from growing columns toward growing rows; by default random, drawn
            from the seed, and on the stamp.
        position : tuple of float, optional
            Its column and row, in place of `dist` and `angle`.
        psf : `~astropy.modeling.Model`, optional
            Its PSF; by default that of the detector.
        signal : optional
            Its own relative flux, as in `add_signal`: an eclipsing background binary is a deep
            `~scope_models.TransitModel`.

        {same}

        Raises
        ------
        ValueError
            If the neighbor is off the stamp.

        Examples
        --------
        >>> import scope_models as scope
        >>> star = scope.generate_target(ncadences=100, seed=1)
        >>> print(round(star.add_neighbor(magdiff=1, dist=1.7).contamination, 2))
        0.22
        """
        magdiff = checked_number("magdiff", magdiff, u.mag, any_sign=True)
        scale = {"pixel_scale": self.detector.pixel_scale}  # converts angles
        if position is None:
            dist = checked_number("dist", dist, u.pix, **scale)
            if angle is None:  # the first random one on the stamp
                generator = stream(self.seed, f"neighbor {len(self.neighbors)}")
                angles = generator.uniform(0, 2 * np.pi, 1000)
            else:
                angles = np.radians([checked_number("angle", angle, u.deg, any_sign=True)])
            x, y = self.star.x_0 + dist * np.cos(angles), self.star.y_0 + dist * np.sin(angles)
            places = list(zip(x, y, strict=True))
            found = (place for place in places if _on_stamp(*place, self.detector))
            x_0, y_0 = next(found, places[0])
        else:
            x_0, y_0 = checked_pair("position", position, u.pix, **scale)
        if not _on_stamp(x_0, y_0, self.detector):
            ny, nx = self.detector.shape
            raise ValueError(
                f"the neighbor at column {x_0:.2f}, row {y_0:.2f} is off the stamp of "
                f"{ny} x {nx} pixels"
            )
        neighbor = Star(self.star.mag + magdiff, x_0, y_0, psf, signal)
        neighbor.relative_flux(self.time)  # a signal that does not fit is an error here
        self.neighbors.append(neighbor)
        return self

    # -- what is measured -----------------------------------------------------------------

    def create_aperture(self, method="threshold", **options):
        """Choose the aperture.

        Parameters
        ----------
        method : {"threshold", "signal-to-noise", "contamination", "circular"}, optional
            Pixels that the noise-free star brightens at any cadence (the paper's); the highest
            signal-to-noise ratio; the star's pixels that neighbors do not dominate; a circle about
            the star's reference position.
        **options
            Options of `~scope_models.photometry.threshold_aperture`,
            `~scope_models.photometry.contamination_aperture` or
            `~scope_models.photometry.circular_aperture` (radius).

        Returns
        -------
        `~numpy.ndarray`
            Boolean mask ``(ny, nx)``, also kept as `aperture`.

        Raises
        ------
        ValueError
            If the method is unknown or the aperture has no pixels.
        TypeError
            If an option is misspelled.

        Examples
        --------
        >>> import scope_models as scope
        >>> star = scope.generate_target(ncadences=50, seed=1)
        >>> print(star.create_aperture("circular", radius=1.5).sum())
        9
        """
        own, others = self._noise_free
        detector = self.detector
        if method == "threshold":
            mask = threshold_aperture(own, **options)
        elif method == "signal-to-noise":
            options |= {"background": detector.background, "read_noise": detector.read_noise}
            options |= {"neighbors": others, "n_frames": detector.n_reads}
            mask = signal_to_noise_aperture(own, detector.exposure_time, **options)
        elif method == "contamination":
            others = np.zeros_like(own) if others is None else others
            mask = contamination_aperture(own, others, **options)
        elif method == "circular":
            mask = circular_aperture(detector.shape, self.star.x_0, self.star.y_0, **options)
        else:
            raise ValueError(
                '`method` must be "threshold", "signal-to-noise", "contamination" or "circular", '
                f"got {method!r}"
            )
        self._aperture = mask
        self._made.pop("detrended", None)
        return mask

    def estimate_cdpp(self, flux=None, duration=6.5, method="lightkurve"):
        """Estimate the noise on the time scale of a transit.

        Parameters
        ----------
        flux : array_like or `~lightkurve.LightCurve`, optional
            The light curve; by default `lightcurve`.
        duration : float, optional
            Time scale in hours.
        method : {"lightkurve", "everest"}, optional
            The convention, see `scope_models.photometry.cdpp`.

        Returns
        -------
        float
            CDPP in ppm.

        Examples
        --------
        >>> import scope_models as scope
        >>> 10 < scope.generate_target(roll=0, ncadences=500, seed=1).estimate_cdpp() < 30
        True
        """
        flux = self.lightcurve if flux is None else flux
        cadence = None if hasattr(flux, "time") else self.detector.cadence_days
        return cdpp(flux, duration, method, cadence=cadence)

    to_tpf, write = _forwarded("to_tpf"), _forwarded("write")

    def to_lightcurve(self, aperture_mask=None, **options):
        """Return lightkurve's light curve of an aperture.

        Parameters
        ----------
        aperture_mask : array_like of bool, or str, optional
            Mask ``(ny, nx)``, or a name of lightkurve's masks; by default `aperture`.
        **options
            Options of `to_tpf`.

        Returns
        -------
        `~lightkurve.KeplerLightCurve`
            The light curve.

        Raises
        ------
        ValueError
            If the aperture has no pixels.

        Examples
        --------
        >>> import scope_models as scope
        >>> star = scope.generate_target(ncadences=50, seed=1)
        >>> len(star.to_lightcurve(quality_bitmask="none"))
        50
        """
        mask = self.aperture if aperture_mask is None else aperture_mask
        if not isinstance(mask, str):
            mask = checked_mask("aperture_mask", mask, self.detector.shape)
        return self.to_tpf(**options).to_lightcurve(aperture_mask=mask)

    def detrend(self, *, mask_transits=True, **options):
        """De-trend the light curve of `aperture` by pixel-level decorrelation.

        Parameters
        ----------
        mask_transits : bool, optional
            Leave the cadences of the transits that were added out of the fit.
        **options
            Options of `scope_models.correctors.PLDCorrector.correct`, such as order or
            transit_mask.

        Returns
        -------
        `~lightkurve.LightCurve`
            The de-trended light curve, without the cadences that lightkurve's default quality mask
            drops. `plot` draws it too.

        Raises
        ------
        TypeError
            If an option is misspelled.

        Examples
        --------
        >>> import scope_models as scope
        >>> star = scope.generate_target(ncadences=300, seed=1)
        >>> star.estimate_cdpp(star.detrend()) < star.estimate_cdpp()
        True
        """
        from scope_models.correctors import PLDCorrector

        tpf = self.to_tpf()
        if mask_transits and self.transits:
            in_transit = np.any([planet(self.time) < 1 for planet in self.transits], axis=0)
            in_transit = in_transit[np.isin(self.motion.cadenceno, tpf.cadenceno)]
            options["transit_mask"] = in_transit | options.get("transit_mask", False)
        light_curve = PLDCorrector(tpf, aperture_mask=self.aperture).correct(**options)
        self._made["detrended"] = value_key(self.scene), light_curve
        return light_curve

    # -- what is drawn --------------------------------------------------------------------

    def display_detector(self, oversample=20, *, axes=None):
        """Draw sensitivity, PSF and pixels of the first cadence (the paper's figure 3).

        Parameters
        ----------
        oversample : int, optional
            Samples per pixel along each axis of the first two.
        axes : sequence of `~matplotlib.axes.Axes`, optional
            Three Axes to draw into; a new figure by default.

        Returns
        -------
        `~numpy.ndarray`
            The three Axes.

        Examples
        --------
        >>> import scope_models as scope
        >>> axes = scope.generate_target(ncadences=10, seed=1).display_detector()
        >>> [ax.get_title() for ax in axes]
        ['(a) Sensitivity', '(b) PSF on the detector', '(c) Pixel image']
        """
        from scope_models.plotting import plot_detector

        ny, nx = self.detector.shape
        y, x = (np.mgrid[: ny * oversample, : nx * oversample] + 0.5) / oversample - 0.5
        blocks = np.ones((oversample, oversample))
        sensitivity = np.kron(self.observation.truth.interpixel, blocks)
        if self.detector.sensitivity is not None:
            sensitivity = sensitivity * self.detector.sensitivity(x, y)
        truth = self.observation.truth
        light = np.zeros_like(x)
        for i, star in enumerate([self.star, *self.neighbors]):
            psf = self.detector.psf if star.psf is None else star.psf
            prf, flux = PRF(psf), truth.flux[i] * truth.relative_flux[i, 0]
            place = x - truth.x[i, 0] + prf.x_0.value, y - truth.y[i, 0] + prf.y_0.value
            light += flux * psf(*place) / prf.flux.value
        image = self.targetpixelfile[0]
        return plot_detector(
            sensitivity, light, image, oversample, aperture=self.aperture, axes=axes
        )

    @documented()
    def display_aperture(self, *, ax=None):
        """Draw the pixels of the first cadence with the outline of the aperture.

        Parameters
        ----------
        {draw}

        Examples
        --------
        >>> import scope_models as scope
        >>> scope.generate_target(ncadences=10, seed=1).display_aperture().get_title()
        'First cadence'
        """
        from scope_models.plotting import plot_pixels

        return plot_pixels(self.targetpixelfile[0], self.aperture, title="First cadence", ax=ax)

    @documented()
    def display_motion(self, *, ax=None):
        """Draw the track of the star over the pixels, colored by time.

        Parameters
        ----------
        {draw}

        Examples
        --------
        >>> import scope_models as scope
        >>> scope.generate_target(ncadences=10, seed=1).display_motion().get_xlabel()
        'Column (pixel)'
        """
        from scope_models.plotting import plot_motion

        truth, shape = self.observation.truth, self.detector.shape
        return plot_motion(
            self.time, truth.x[0], truth.y[0], shape, time_label=self._time_label, ax=ax
        )

    def plot(self):
        """Draw pixels, motion and light curves in one figure.

        The de-trended light curve is drawn after `Target.detrend` was called.

        Returns
        -------
        dict
            The Axes, see `scope_models.plotting.plot_summary`.

        Examples
        --------
        >>> import scope_models as scope
        >>> sorted(scope.generate_target(ncadences=50, seed=1).plot())
        ['image', 'light curve', 'motion']
        """
        from scope_models.plotting import plot_summary

        truth, corrected = self.observation.truth, self._corrected_flux()
        expected = 1 + (1 - self.contamination) * (truth.relative_flux[0] - 1)
        return plot_summary(
            self.time,
            self.targetpixelfile[0],
            self.lightcurve,
            truth.x[0],
            truth.y[0],
            corrected=corrected,
            aperture=self.aperture,
            cdpp=self.estimate_cdpp(),
            corrected_cdpp=None if corrected is None else self.estimate_cdpp(self._detrended),
            model=expected / np.median(expected),
            time_label=self._time_label,
            title=f"Simulated star, magnitude {self.star.mag:g}",
        )

    @documented()
    def plot_transit(self, number=0, *, window=None, ax=None):
        """Draw the light curve folded on a transit that was added.

        The star's other signals are divided out by their truth.

        Parameters
        ----------
        number : int, optional
            Which of `transits`.
        window : float, optional
            Hours to draw on either side of mid-transit; by default twice the transit's duration.
        {ax}

        Returns
        -------
        `~matplotlib.axes.Axes`
            The Axes; the light curve is the de-trended one after `Target.detrend` was called.

        Raises
        ------
        ValueError
            If there is no such transit.

        Examples
        --------
        >>> import scope_models as scope
        >>> star = scope.generate_target(transit=True, ncadences=400, seed=1)
        >>> star.plot_transit().get_xlabel()
        'Time from mid-transit (h)'
        """
        from scope_models.plotting import plot_fold

        if not 0 <= number < len(self.transits):
            raise ValueError(
                f"`number` must be below {len(self.transits)}, the number of transits, got {number}"
            )
        planet, own = self.transits[number], 1 - self.contamination
        flux = self.lightcurve if self._detrended is None else self._corrected_flux()
        others = self.star.relative_flux(self.time) / planet(self.time)
        flux = flux / (1 + own * (others - 1))
        return plot_fold(
            self.time,
            flux / np.nanmedian(flux),
            planet.period.value,
            planet.t0.value,
            model=1 + own * (planet(self.time) - 1),
            window=48 * planet.duration if window is None else window,
            title="Transit",
            ax=ax,
        )

    @documented()
    def animate(self, *, step=1, interval=50, ax=None):
        """Animate the pixels.

        Parameters
        ----------
        step : int, optional
            Draw every step-th cadence.
        interval : float, optional
            Milliseconds per frame.
        {ax}

        Returns
        -------
        `~matplotlib.animation.FuncAnimation`
            The animation; keep it, and show it or ``.save()`` it.

        Examples
        --------
        >>> import scope_models as scope
        >>> animation = scope.generate_target(ncadences=10, seed=1).animate(step=5)
        >>> html = animation.to_jshtml()
        """
        return self.observation.animate(self.aperture, step=step, interval=interval, ax=ax)

    @property
    def _time_label(self):
        return f"Time ({self.motion.time_format.upper()}, d)"

    def _corrected_flux(self):
        """Return the de-trended flux at all cadences, NaN where there is none, or None."""
        if self._detrended is None:
            return None
        flux = np.full(len(self.motion), np.nan)
        used = np.isin(self.motion.cadenceno, self._detrended.cadenceno)
        flux[used] = np.asarray(self._detrended.flux.value, dtype=float)
        return flux


def _find_motion(motion, tpf_path, epic, ncadences):
    """Return the motion of the one source that is given, with the right number of cadences."""
    sources = {"motion": motion, "tpf_path": tpf_path, "ID": epic}
    given = [name for name, value in sources.items() if value is not None]
    if len(given) > 1:
        raise ValueError(f"only one of `motion`, `tpf_path` and `ID` may be given, got {given}")
    if ncadences is not None:
        ncadences = checked_integer("ncadences", ncadences, 1)
    if not given:
        return Motion.k2_roll(_NCADENCES if ncadences is None else ncadences)
    if tpf_path is not None:
        motion = Motion.from_file(tpf_path)
    elif epic is not None:
        motion = _download_motion(checked_integer("ID", epic, 1))
    elif not isinstance(motion, Motion):
        raise TypeError(f"`motion` must be a Motion, got {motion!r}; `tpf_path` takes a file")
    if ncadences is None:
        ncadences = min(_NCADENCES, len(motion))
    if ncadences > len(motion):
        raise ValueError(
            f"`ncadences` must be at most {len(motion)}, the length of the motion, got {ncadences}"
        )
    return motion[:ncadences]


def _download_motion(epic):
    """Download the long-cadence target pixel file of a K2 target and return its motion."""
    import lightkurve

    try:
        found = lightkurve.search_targetpixelfile(f"EPIC {epic}", mission="K2", exptime="long")
        tpf = found[0].download(quality_bitmask="none") if len(found) else None
    except (OSError, lightkurve.search.SearchError) as error:
        raise ConnectionError(
            f"the motion of EPIC {epic} could not be downloaded ({type(error).__name__}); without "
            "a network give a target pixel or light-curve file as `tpf_path`, or neither for a "
            "generated motion"
        ) from error
    if tpf is None:
        raise ValueError(f"`ID` must be the EPIC number of a K2 target, {epic} is not known")
    return Motion.from_tpf(tpf)


def _on_stamp(x_0, y_0, detector):
    ny, nx = detector.shape
    return -0.5 <= x_0 <= nx - 0.5 and -0.5 <= y_0 <= ny - 0.5


def _plural(number, noun):
    return f"{number} {noun}{'' if number == 1 else 's'}"
