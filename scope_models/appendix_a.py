"""The paper's Appendix A: a simulated star whose parts are added one by one."""

import inspect
import warnings
from functools import wraps
from operator import attrgetter

import numpy as np

import scope_models as sm
from scope_models import _checks
from scope_models._arrays import PER_PIXEL
from scope_models._docstrings import documented
from scope_models.effects._noise import fresh_seed, noise_terms, stream

__all__ = ["Target", "generate_target"]


def generate_target(
    mag=12.0, roll=1.0, coords=None, background_level=None, neighbor_magdiff=1.0, ncadences=None,
    apsize=7, ID=None, transit=False, variable=False, neighbor=False, tpf_path=None,
    no_sensitivity_variation=False, signal=None, *, noise=True, seed=None, motion=None, psf=None,
    detector=None,
):  # fmt: skip
    """Simulate a star on a moving detector, as in the paper's Appendix A.

    Parameters
    ----------
    mag, roll : float, optional
        Magnitude in the mission's band, and factor on the motion, 0 for rest.
    coords : tuple of float, optional
        Reference position (column, row) in pixels from 0; by default the center of the stamp.
    background_level, neighbor_magdiff : float, optional
        Background in e-/s per pixel, by default the detector's; and magnitude of a neighbor minus
        `mag`.
    ncadences, apsize, ID : int, optional
        Number of cadences, by default 1000, or all of a shorter motion; rows and columns of the
        stamp without a `detector`; EPIC number of a K2 target whose motion is downloaded.
    transit, variable, neighbor : bool, optional
        Add a transit, variability or a neighbor with the defaults of the methods of `Target`.
    tpf_path : str or path-like, optional
        A target pixel or light-curve file whose motion is taken.
    no_sensitivity_variation : bool, optional
        Let all pixels respond alike and evenly, as a control.
    signal, noise, seed : optional
        See `Target.add_signal` and `Target`.
    motion : `~scope_models.Motion`, optional
        The motion; without it, `ID` and `tpf_path` it is `scope_models.Motion.k2_roll`.
    psf, detector : `~astropy.modeling.Model`, `~scope_models.Detector`, optional
        PSF of the star, by default the detector's, and detector, by default ``Detector.k2()``.

    Returns
    -------
    `Target`
        The star.

    Raises
    ------
    TypeError, ValueError, ConnectionError
        If an argument is of the wrong kind or outside its domain, or the motion is given twice, too
        short, or cannot be found or downloaded.

    Examples
    --------
    >>> import scope_models as scope
    >>> star = scope.generate_target(mag=12, ncadences=200, seed=1)
    >>> star.targetpixelfile.shape, star.lightcurve.shape
    ((200, 7, 7), (200,))
    """
    motion = _find_motion(motion, tpf_path, ID, ncadences)
    if detector is None:
        detector = sm.Detector.k2(shape=2 * (_checks.checked_integer("apsize", apsize, 1),))
    elif not isinstance(detector, sm.Detector):
        raise TypeError(f"`detector` must be a Detector, got {detector!r}")
    if background_level is not None:
        given = "background_level", background_level, "electron / s"
        level = _checks.checked_number(*given, equivalencies=PER_PIXEL)
        detector = detector.replace(background=level)
    if no_sensitivity_variation:
        detector = detector.without_sensitivity()
    ny, nx = detector.shape
    place = ((nx - 1) / 2, (ny - 1) / 2) if coords is None else coords
    if not _checks.on_stamp(place := _checks.checked_pair("coords", place, "pix"), detector.shape):
        raise ValueError(f"`coords` must be on the stamp of {ny} x {nx} pixels, got {coords!r}")
    motion = _checks.checked_number("roll", roll, any_sign=True) * motion
    target = Target(sm.Star(mag, *place, psf), detector, motion, seed=seed, noise=noise)
    if signal is not None:
        target.add_signal(signal)
    if transit:
        target.add_transit()
    if variable:
        target.add_variability()
    if neighbor:
        given = "neighbor_magdiff", neighbor_magdiff, "mag"
        target.add_neighbor(_checks.checked_number(*given, any_sign=True))
    return target


def _forwarded(method):
    """Return a method of the observation, with aperture and light curve of the target."""

    @wraps(method)
    def forwarded(self, *arguments, **options):
        given = inspect.signature(method).bind(self.observation, *arguments, **options)
        given.arguments.setdefault("aperture_mask", self.aperture)
        if "corrected" in given.signature.parameters:
            given.arguments.setdefault("corrected", self._corrected.get(self.scene))
        return method(*given.args, **given.kwargs)

    return forwarded


@documented(same="Returns\n-------\n`Target`\n    The same object.")
class Target:
    """A simulated star, its neighbors and its pixels.

    `generate_target` makes it. Additions leave the noise of all else as it was. Attributes may be
    changed: the next look at the pixels simulates them again. Methods raise ValueError if an
    argument is outside its domain, and TypeError if an option is misspelled.

    Parameters
    ----------
    star : `~scope_models.Star`
        The star, with all signals that were added; its position must be given.
    detector, motion : `~scope_models.Detector`, `~scope_models.Motion`
        The pixels and the motion.
    seed, noise : int, bool or iterable of str, optional
        The seed, by default a new one; and the noise terms, see `~scope_models.simulate`.

    Attributes
    ----------
    neighbors, transits : list of `~scope_models.Star`, list of `~scope_models.TransitModel`
        What was added. The parameters are attributes, too.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, Target
    >>> star = Target(Star(12.0, 5, 5), Detector.k2(), Motion.still(100), seed=1)
    >>> star.add_transit(depth=0.01, per=15, dur=0.5, t0=1).add_neighbor(magdiff=2)
    <Target of magnitude 12 with 1 transit and 1 neighbor: 100 cadences of 11 x 11 pixels, seed 1>
    """

    def __init__(self, star, detector, motion, *, seed=None, noise=True):
        if star.x_0 is None or star.y_0 is None:
            raise ValueError("`star` must have a position (x_0, y_0)")
        self.star, self.detector, self.motion = star, detector, motion
        self.neighbors, self.transits, self.noise = [], [], noise_terms(noise)
        self.seed = fresh_seed() if seed is None else _checks.checked_integer("seed", seed, 0)
        self._aperture, self._corrected, self._made = None, {}, {}
        _ = self.observation  # errors and warnings come here, not at the first look

    def __repr__(self):
        (ny, nx), n, m = self.detector.shape, len(self.transits), len(self.neighbors)
        added = f"{n} transit{'s' * (n != 1)} and {m} neighbor{'s' * (m != 1)}"
        size = f"{len(self.motion)} cadences of {ny} x {nx} pixels"
        return f"<Target of magnitude {self.star.mag:g} with {added}: {size}, seed {self.seed}>"

    def _simulated(self, scene):
        if scene not in self._made:  # the last two are kept
            self._made = dict([*self._made.items()][-1:]) | {scene: sm.simulate(scene)}
        return self._made[scene]

    @property
    def scene(self):
        """The `~scope_models.Scene` of the star, its neighbors, the pixels and the motion."""
        stars = [self.star, *self.neighbors]
        return sm.Scene(stars, self.detector, self.motion, seed=self.seed, noise=self.noise)

    @property
    def observation(self):
        """The `~scope_models.Observation`, with the truth."""
        return self._simulated(self.scene)

    time = property(attrgetter("motion.time"), doc="Times of the cadences, days (BKJD).")
    targetpixelfile = property(
        attrgetter("observation.flux"), doc="Flux without background, e-/s, (n_cadences, ny, nx)."
    )
    error = property(attrgetter("observation.flux_err"), doc="Its standard deviation, e-/s.")

    @property
    def lightcurve(self):
        """Sum of the flux in `aperture` in e-/s, shape ``(n_cadences,)``."""
        return self.targetpixelfile[:, self.aperture].sum(axis=1, dtype=float)

    @property
    def aperture(self):
        """Mask ``(ny, nx)`` that `create_aperture` made, the paper's by default."""
        given = self._aperture
        return sm.photometry.threshold_aperture(self._noise_free) if given is None else given

    @property
    def contamination(self):
        """Share of the neighbors in the aperture's starlight, which dilutes the star's signals."""
        own, *others = self.observation.star_images
        return 1 - sm.photometry.crowding(own, sum(others, 0 * own), self.aperture)

    @property
    def _noise_free(self):
        # It has warned.
        with warnings.catch_warnings(action="ignore", category=sm.exceptions.LostLightWarning):
            return self._simulated(self.scene.replace(stars=self.star, noise=False)).flux

    def add_transit(self, depth=0.01, per=15.0, dur=0.5, t0=5.0, *, b=0.0, u1=0.4, u2=0.26):
        """Let a planet on a circular orbit transit the star.

        Parameters
        ----------
        depth : float, optional
            Relative drop at mid-transit, between 0 and 1.
        per, dur, t0 : float, optional
            In days: orbital period, time from first to fourth contact, and time of a mid-transit
            after the first cadence.
        b, u1, u2 : float, optional
            Impact parameter in stellar radii, and coefficients of quadratic limb darkening.

        {same}
        """
        days = ("per", per), ("dur", dur)
        per, dur = (_checks.checked_number(*item, "day", positive=True) for item in days)
        t0 = self.time[0] + _checks.checked_number("t0", t0, "day", any_sign=True)
        options = {"b": b, "u1": u1, "u2": u2, "exposure_time": self.detector.cadence_days}
        planet = sm.TransitModel.from_depth_duration(depth, dur, per, t0, **options)
        self.add_signal(planet).transits.append(planet)
        return self

    def add_variability(self, var_amp=0.005, freq=0.25):
        """Let the star vary sinusoidally, by ``1 + var_amp * sin(freq * t)``.

        Parameters
        ----------
        var_amp : float, optional
            Relative semi-amplitude, between 0 and 1.
        freq : float, optional
            Angular frequency in radians per day; t is the time after the first cadence.

        {same}
        """
        var_amp = _checks.checked_number("var_amp", var_amp, positive=True)
        period = 2 * np.pi / _checks.checked_number("freq", freq, "rad / day", positive=True)
        return self.add_signal(sm.models.sinusoidal_signal(var_amp, period, -self.time[0] / period))

    def add_signal(self, signal):
        """Multiply the star's flux with a signal.

        Parameters
        ----------
        signal : `~astropy.modeling.Model` or callable or array_like
            Relative flux: a model or function of the times `time`, or an array ``(n_cadences,)``.

        {same}
        """
        more = sm.Star(self.star.mag, signal=signal).relative_flux(self.time)
        self.star = self.star.replace(signal=self.star.relative_flux(self.time) * more)
        return self

    def add_neighbor(
        self, magdiff=1.0, dist=1.7, *, angle=None, position=None, psf=None, signal=None
    ):
        """Put another star onto the stamp.

        Parameters
        ----------
        magdiff, dist, angle : float, optional
            Its magnitude minus the star's; distance from it in pixels; and direction in degrees
            from growing columns to growing rows, by default random and on the stamp.
        position : tuple of float, optional
            Its column and row, in place of `dist` and `angle`.
        psf, signal : optional
            Its PSF, by default the detector's, and relative flux, as in `add_signal`: an eclipsing
            background binary is a deep `~scope_models.TransitModel`.

        {same}
        """
        mag = self.star.mag + _checks.checked_number("magdiff", magdiff, "mag", any_sign=True)
        scale = {"pixel_scale": self.detector.pixel_scale}  # converts angles
        angles = stream(self.seed, f"neighbor {len(self.neighbors)}").uniform(0, 360, 1000)
        if angle is not None:
            angles = [_checks.checked_number("angle", angle, "deg", any_sign=True)]
        distance = _checks.checked_number("dist", dist, "pix", **scale)
        along = distance * np.exp(1j * np.radians(angles))
        places = [(self.star.x_0 + d.real, self.star.y_0 + d.imag) for d in along]
        if position is not None:
            places = [_checks.checked_pair("position", position, "pix", **scale)]
        # Of random angles the first one on the stamp.
        place = next((p for p in places if _checks.on_stamp(p, self.detector.shape)), None)
        if place is None:
            text = "the neighbor at column {:.2f}, row {:.2f} is off the stamp of {} x {} pixels"
            raise ValueError(text.format(*places[0], *self.detector.shape))
        neighbor = sm.Star(mag, *place, psf, signal)
        neighbor.relative_flux(self.time)  # a signal that does not fit is an error here
        self.neighbors.append(neighbor)
        return self

    def create_aperture(self, method="threshold", **options):
        """Choose the aperture.

        Parameters
        ----------
        method : {"threshold", "signal-to-noise", "contamination", "circular"}, optional
            Pixels that the noise-free star brightens at any cadence (the paper's); the highest
            signal-to-noise ratio; pixels that neighbors do not dominate; a circle about the star.
        **options
            Options of the function of `scope_models.photometry`, as ``threshold`` or ``radius``.

        Returns
        -------
        `~numpy.ndarray`
            Boolean mask ``(ny, nx)``, also kept as `aperture`.
        """
        own, pixels, star = self._noise_free, self.detector, self.star
        others = self.observation.star_images[1:].sum(axis=0)
        methods = {"threshold": (own,), "signal-to-noise": (own, pixels.exposure_time)}
        methods |= {"contamination": (own, others), "circular": (pixels.shape, star.x_0, star.y_0)}
        if _checks.checked_choice("method", method, methods) == "signal-to-noise":
            options |= {"background": pixels.background, "read_noise": pixels.read_noise}
            options |= {"neighbors": others, "n_frames": pixels.n_reads}
        make = getattr(sm.photometry, f"{method.replace('-', '_')}_aperture")
        self._aperture, self._corrected = make(*methods[method], **options), {}
        return self._aperture

    def estimate_cdpp(self, flux=None, duration=6.5, method="lightkurve"):
        """Estimate the noise on the time scale of a transit.

        Parameters
        ----------
        flux : array_like or `~lightkurve.LightCurve`, optional
            The light curve; by default `lightcurve`.
        duration : float, optional
            Time scale in hours.
        method : {"lightkurve", "everest"}, optional
            See `scope_models.photometry.cdpp`.

        Returns
        -------
        float
            CDPP in ppm.
        """
        flux = self.lightcurve if flux is None else flux
        cadence = None if hasattr(flux, "time") else self.detector.cadence_days
        return sm.photometry.cdpp(flux, duration, method, cadence=cadence)

    def detrend(self, **options):
        """De-trend the light curve of `aperture` by pixel-level decorrelation.

        The fit leaves out the transits; `plot` draws the result.

        Parameters
        ----------
        **options
            Options of `scope_models.correctors.PLDCorrector.correct`, such as order.

        Returns
        -------
        `~lightkurve.LightCurve`
            Without the cadences that lightkurve's default quality mask drops.
        """
        tpf = self.to_tpf()
        for planet in self.transits:
            inside = planet(tpf.time.value) < 1
            options["transit_mask"] = inside | options.get("transit_mask", False)
        corrected = sm.PLDCorrector(tpf, aperture_mask=self.aperture).correct(**options)
        self._corrected = {self.scene: corrected}
        return corrected

    to_tpf = _forwarded(sm.Observation.to_tpf)
    to_lightcurve = _forwarded(sm.Observation.to_lightcurve)
    write = _forwarded(sm.Observation.write)
    plot = _forwarded(sm.Observation.plot)
    animate = _forwarded(sm.Observation.animate)

    def display_detector(self, oversample=20, *, axes=None):
        """Draw sensitivity, PSF and pixels of the first cadence (the paper's figure 3).

        Parameters
        ----------
        oversample : int, optional
            Samples per pixel along each axis of the first two.
        {draw_three}
        """
        detector, truth = self.detector, self.observation.truth
        y, x = (np.indices(oversample * np.array(detector.shape)) + 0.5) / oversample - 0.5
        sensitivity = 1.0 if detector.sensitivity is None else detector.sensitivity(x, y)
        sensitivity = sensitivity * np.kron(truth.interpixel, np.ones((oversample, oversample)))
        light = np.zeros_like(x)
        for i, star in enumerate(self.scene.stars):
            prf = sm.PRF(psf := detector.psf if star.psf is None else star.psf)
            place = x - truth.x[i, 0] + prf.x_0.value, y - truth.y[i, 0] + prf.y_0.value
            light += truth.flux[i] * truth.relative_flux[i, 0] * psf(*place) / prf.flux.value
        maps = sensitivity, light, self.targetpixelfile[0], oversample
        return sm.plotting.plot_detector(*maps, aperture=self.aperture, axes=axes)

    def display_aperture(self, *, ax=None):
        """Draw the pixels of the first cadence with the outline of the aperture.

        Parameters
        ----------
        {draw}
        """
        image = self.targetpixelfile[0]
        return sm.plotting.plot_pixels(image, self.aperture, title="First cadence", ax=ax)

    def plot_transit(self, number=0, *, window=None, ax=None):
        """Draw the light curve folded on a transit that was added.

        After `Target.detrend` it is de-trended. The star's other signals are divided out.

        Parameters
        ----------
        number : int, optional
            Which of `transits`.
        window : float, optional
            Hours to draw on either side of mid-transit, by default twice the duration.
        {draw}
        """
        if not 0 <= number < (n := len(self.transits)):
            raise ValueError(f"`number` must be below {n}, the number of transits, got {number}")
        planet, own, flux = self.transits[number], 1 - self.contamination, self.lightcurve
        if (detrended := self._corrected.get(self.scene)) is not None:
            flux = np.full(len(self.motion), np.nan)
            flux[np.isin(self.motion.cadenceno, detrended.cadenceno)] = detrended.flux.value
        model, window = planet(self.time), 48 * planet.duration if window is None else window
        flux = flux / (1 + own * (self.star.relative_flux(self.time) / model - 1))
        return sm.plotting.plot_fold(
            self.time, flux / np.nanmedian(flux), planet.period.value, planet.t0.value,
            model=1 + own * (model - 1), window=window, title="Transit", ax=ax,
        )  # fmt: skip


def _find_motion(motion, tpf_path, ID, ncadences):
    if [motion, tpf_path, ID].count(None) < 2:
        raise ValueError("only one of `motion`, `tpf_path` and `ID` may be given")
    n = 1000 if ncadences is None else _checks.checked_integer("ncadences", ncadences, 1)
    if ID is not None:
        try:
            (tpf_path,) = sm.batch.find_files(f"EPIC {_checks.checked_integer('ID', ID, 1)}")
        except ConnectionError as error:
            raise ConnectionError(f"{error}; `tpf_path` takes a file") from error
    if tpf_path is not None:
        motion = sm.Motion.from_file(tpf_path)
    elif motion is None:
        motion = sm.Motion.k2_roll(n)
    elif not isinstance(motion, sm.Motion):
        raise TypeError(f"`motion` must be a Motion, got {motion!r}; `tpf_path` takes a file")
    if ncadences is not None and n > (most := len(motion)):
        raise ValueError(f"`ncadences` must be at most {most}, the length of the motion, got {n}")
    return motion[:n]
