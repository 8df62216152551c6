"""The result of a simulation: pixels, the truth behind them, and the target pixel file of both."""

from dataclasses import dataclass
from operator import attrgetter
from types import SimpleNamespace

import numpy as np

from scope_models._arrays import plain_array
from scope_models._checks import checked_choice, checked_integer, checked_mask
from scope_models._docstrings import documented
from scope_models._values import Value, frozen, html_table
from scope_models.effects import Effect
from scope_models.io import TPFMetadata, Truth, write_tpf
from scope_models.io.tpf import make_tpf_hdulist
from scope_models.missions import MISSIONS, TIME_ZEROS
from scope_models.photometry import noise_of
from scope_models.scene.scene import Scene, scene_facts
from scope_models.simulation import _light

__all__ = ["Observation"]

_MASKS = ("pipeline", "threshold", "default", "background", "all")  # those of lightkurve
# Attributes that files have as they are.
_WRITTEN = ("cadenceno", "raw_cnts", "flux", "flux_err", "flux_bkg", "flux_bkg_err", "quality")


@documented()
@dataclass(frozen=True, eq=False, repr=False)
class Observation(Value):
    """The pixels of a simulation by `simulate`, with the truth.

    Parameters
    ----------
    flux : ndarray of shape (n_cadences, ny, nx)
        Flux after subtraction of the background, e-/s.
    flux_err : ndarray of shape (n_cadences, ny, nx)
        True standard deviation of ``flux`` by the noise terms that are switched on, e-/s; at least
        that of rounding to single precision.
    flux_bkg : ndarray of shape (n_cadences, ny, nx)
        True background, which was subtracted, e-/s.
    raw_cnts : ndarray of int, shape (n_cadences, ny, nx)
        Digital numbers of the whole cadence, with background and fixed offset; -1 without data.
    quality : ndarray of int, shape (n_cadences,)
        Quality flags of the motion and of the effects.
    scene : Scene
        The scene, with its seed: ``simulate(scene)`` gives the same pixels again.
    truth : ~scope_models.io.Truth
        The truth.
    aperture : ndarray of bool, shape (ny, nx)
        Pixels of the highest signal-to-noise ratio of the target; all if it has no light.
    star_images : ndarray of shape (n_stars, ny, nx)
        Mean flux of each star with the response of the pixels, before saturation, e-/s.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> observation = simulate(Star(12.0), Detector.k2(), Motion.still(50), seed=1)
    >>> observation
    <Observation K2: 50 cadences of 11 x 11 pixels, 1 star, seed 1>
    >>> tpf = observation.to_tpf()
    >>> tpf.flux.shape
    (50, 11, 11)
    """

    flux: np.ndarray
    flux_err: np.ndarray
    flux_bkg: np.ndarray
    raw_cnts: np.ndarray
    quality: np.ndarray
    scene: Scene
    truth: Truth
    aperture: np.ndarray
    star_images: np.ndarray

    def __post_init__(self):
        for name, value in list(vars(self).items()):
            if isinstance(value, np.ndarray):
                if value.base is None:
                    value.flags.writeable = False
                object.__setattr__(self, name, frozen(value))

    def __repr__(self):
        (n, ny, nx), n_stars = self.flux.shape, len(self.stars)
        return (
            f"<Observation {self.detector.mission}: {n} cadences of {ny} x {nx} pixels, "
            f"{n_stars} star{'s' if n_stars > 1 else ''}, seed {self.truth.seed}>"
        )

    def _repr_html_(self):
        aperture = self.flux[:, self.aperture].sum(axis=1, dtype=float)
        rows = {
            "median flux in the aperture": f"{np.nanmedian(aperture):.6g} e-/s",
            "pixels of the aperture": int(self.aperture.sum()),
            "target's share of the light in it": f"{np.nanmean(self.truth.target_share):.4f}",
            "background per pixel": f"{np.nanmedian(self.flux_bkg):.4g} e-/s",
            "flagged cadences": int(np.count_nonzero(self.quality)),
            "noise": ", ".join(sorted(self.scene.noise)) or "none",
        }
        return html_table(repr(self), rows)

    stars = property(attrgetter("scene.stars"), doc="The stars; the first is the target.")
    detector = property(attrgetter("scene.detector"), doc="The detector.")
    motion = property(attrgetter("scene.motion"), doc="The motion, with times and cadence numbers.")
    time = property(attrgetter("motion.time"), doc="Middle of each cadence, days, as in `motion`.")
    cadenceno = property(attrgetter("motion.cadenceno"), doc="Cadence numbers.")

    @property
    def flux_bkg_err(self):
        """Error of the background, e-/s: 0, for its level is known."""
        return np.broadcast_to(np.float32(0), self.flux.shape)

    def model(self):
        """Return the expected flux, without noise and background.

        Returns
        -------
        ndarray of shape (n_cadences, ny, nx)
            Flux in e-/s, with the response of the pixels and saturation.

        Examples
        --------
        >>> from scope_models import Detector, Motion, Star, simulate
        >>> observation = simulate(Star(12.0), Detector.k2(), Motion.still(50), seed=1)
        >>> observation.model().shape
        (50, 11, 11)
        """
        if self.truth.model is not None:
            return self.truth.model
        prepared = _light.prepare(self.scene)
        model = np.empty(self.flux.shape)
        for part in _light.pieces(self.scene):
            electrons = _light.gather(prepared, part)
            _light.fill_wells(self.scene, electrons, _light.pedestal(prepared, part, electrons)[0])
            np.divide(electrons, self.detector.exposure_time, out=model[part])
        return model

    def target_share(self, aperture_mask=None):
        """Return the target's share in the starlight of an aperture, cadence by cadence.

        It dilutes a signal of the target; one minus it is the contamination.

        Parameters
        ----------
        aperture_mask : array_like of bool, shape (ny, nx), optional
            The pixels. The default is `aperture`.

        Returns
        -------
        ndarray of shape (n_cadences,)
            Between 0 and 1; NaN where no star lights the aperture.

        Examples
        --------
        >>> from scope_models import Detector, Motion, Star, simulate
        >>> stars = [Star(12.0), Star(14.0)]
        >>> observation = simulate(stars, Detector.k2(), Motion.still(50), seed=1)
        >>> print(observation.target_share().max().round(2))
        0.86
        """
        aperture = self._checked_aperture(aperture_mask)
        if np.array_equal(aperture, self.aperture):
            return self.truth.target_share
        weights = self.truth.interpixel * aperture
        sums = np.zeros((len(self.stars), len(self.motion)))
        for number, light in enumerate(_light.prepare(self.scene).lights):
            for part in _light.pieces(self.scene):
                sums[number, part] = np.tensordot(light.images(part), weights[light.window], axes=2)
        return _light.share_of_target(sums)

    def _checked_aperture(self, aperture_mask):
        if aperture_mask is None:
            return self.aperture
        return checked_mask("aperture_mask", aperture_mask, self.detector.shape)

    def to_tpf(self, *, aperture_mask=None, metadata=None, quality_bitmask="default"):
        """Return the observation as lightkurve's target pixel file.

        Parameters
        ----------
        aperture_mask : array_like of bool, shape (ny, nx), optional
            The pixels of the file's optimal aperture. The default is `aperture`.
        metadata : mapping, optional
            Fields of `scope_models.io.TPFMetadata`, as target_id, object_name, ra or dec.
        quality_bitmask : str or int, optional
            Which flagged cadences lightkurve leaves out.

        Returns
        -------
        lightkurve.KeplerTargetPixelFile or lightkurve.TessTargetPixelFile
            The target pixel file.

        Raises
        ------
        ValueError
            If the detector is of a mission without target pixel files, the aperture has no pixels,
            or the times are before the mission's zero or closer than the detector's cadence.

        Examples
        --------
        >>> from scope_models import Detector, Motion, Star, simulate
        >>> observation = simulate(Star(12.0), Detector.k2(), Motion.still(50), seed=1)
        >>> observation.to_tpf(metadata={"target_id": 205998445}).targetid
        205998445
        """
        import lightkurve

        hdulist = make_tpf_hdulist(**self._tpf_arguments(metadata, aperture_mask))
        kind = getattr(lightkurve, MISSIONS[self.detector.mission].tpf_class)
        return kind(hdulist, quality_bitmask=quality_bitmask)

    def to_lightcurve(self, aperture_mask=None, *, metadata=None, quality_bitmask="default"):
        """Return the sum of the pixels of an aperture as lightkurve's light curve.

        Parameters
        ----------
        aperture_mask : array_like of bool, shape (ny, nx), or str, optional
            The pixels, or lightkurve's "pipeline", "threshold", "default", "background" or "all".
            The default is `aperture`.
        metadata : mapping, optional
            See `to_tpf`.
        quality_bitmask : str or int, optional
            See `to_tpf`.

        Returns
        -------
        lightkurve.KeplerLightCurve or lightkurve.TessLightCurve
            The light curve.

        Raises
        ------
        ValueError
            If the aperture has no pixels.

        Examples
        --------
        >>> from scope_models import Detector, Motion, Star, simulate
        >>> observation = simulate(Star(12.0), Detector.k2(), Motion.still(50), seed=1)
        >>> len(observation.to_lightcurve())
        50
        """
        tpf = self.to_tpf(metadata=metadata, quality_bitmask=quality_bitmask)
        if isinstance(aperture_mask, str):
            checked_choice("aperture_mask", aperture_mask, _MASKS)
        else:
            aperture_mask = self._checked_aperture(aperture_mask)
        return tpf.to_lightcurve(aperture_mask=aperture_mask)

    def write(self, path, overwrite=False, *, aperture_mask=None, metadata=None):
        """Write a target pixel file with the truth, .fits or .fits.gz.

        Parameters
        ----------
        {path}
        aperture_mask : array_like of bool, shape (ny, nx), optional
            The pixels of the file's optimal aperture. The default is `aperture`.
        metadata : mapping, optional
            Fields of `scope_models.io.TPFMetadata`, as target_id, object_name, ra or dec.

        {written}
        ValueError
            If the detector is of a mission without target pixel files, the aperture has no pixels,
            or the times are before the mission's zero or closer than the detector's cadence.

        Examples
        --------
        >>> from scope_models import Detector, Motion, Star, simulate
        >>> observation = simulate(Star(12.0), Detector.k2(), Motion.still(50), seed=1)
        >>> observation.write("star.fits").name
        'star.fits'
        """
        return write_tpf(path, overwrite=overwrite, **self._tpf_arguments(metadata, aperture_mask))

    def plot(self, corrected=None, aperture_mask=None, *, title=None):
        """Draw pixels, motion and light curves in one figure, with lightkurve's CDPP.

        Parameters
        ----------
        corrected : lightkurve.LightCurve or array_like, optional
            The corrected light curve, with a column ``cadenceno``, or one value per cadence.
        aperture_mask : array_like of bool, shape (ny, nx), optional
            The pixels of the raw light curve. The default is `aperture`.
        title : str, optional
            Title of the figure; the object's name by default.

        Returns
        -------
        dict
            The Axes, see `scope_models.plotting.plot_summary`.

        Raises
        ------
        ValueError
            If the light curve has other cadences than the observation, or the aperture no pixels.

        Examples
        --------
        >>> from scope_models import Detector, Motion, Star, simulate
        >>> observation = simulate(Star(12.0), Detector.k2(), Motion.still(50), seed=1)
        >>> axes = observation.plot()
        >>> axes["light curve"].get_xlabel()
        'Time (BKJD)'
        """
        from scope_models.plotting import plot_summary

        aperture = self._checked_aperture(aperture_mask)
        raw = self.flux[:, aperture].sum(axis=1, dtype=float)
        signal = 1 + self.target_share(aperture) * (self.truth.relative_flux[0] - 1)
        corrected = None if corrected is None else self._at_all_cadences(corrected)
        return plot_summary(
            self.time, self.flux[0], raw, self.truth.x[0], self.truth.y[0], corrected=corrected,
            aperture=aperture, cdpp=self._cdpp(raw / signal),
            corrected_cdpp=None if corrected is None else self._cdpp(corrected / signal),
            model=signal / np.nanmedian(signal) if np.ptp(signal) > 0 else None,
            noise=np.sqrt((self.flux_err[:, aperture].astype(float) ** 2).sum(axis=1)) / raw,
            time_label=self._time_label, title=self.scene.object_name if title is None else title,
        )  # fmt: skip

    def animate(self, aperture_mask=None, *, step=1, interval=50, ax=None):
        """Animate the pixels, with the outline of an aperture.

        Parameters
        ----------
        aperture_mask : array_like of bool, shape (ny, nx), optional
            The aperture. The default is `aperture`.
        step : int, optional
            Draw every step-th cadence.
        interval : float, optional
            Milliseconds per frame.
        {ax}

        Returns
        -------
        matplotlib.animation.FuncAnimation
            The animation; keep it, and show it or ``.save()`` it.

        Raises
        ------
        ValueError
            If `step` is below 1.

        Examples
        --------
        >>> from scope_models import Detector, Motion, Star, simulate
        >>> observation = simulate(Star(12.0), Detector.k2(), Motion.still(50), seed=1)
        >>> html = observation.animate(step=25).to_jshtml()
        """
        from scope_models.plotting import animate_pixels

        step = checked_integer("step", step, 1)
        return animate_pixels(
            self.flux[::step], self.time[::step], self._checked_aperture(aperture_mask),
            interval=interval, time_label=self._time_label, ax=ax,
        )  # fmt: skip

    @property
    def _time_label(self):
        return f"Time ({self.motion.time_format.upper()})"

    def _cdpp(self, flux):
        """Return lightkurve's CDPP, None without enough cadences."""
        noise = noise_of(SimpleNamespace(time=self.time, flux=flux))
        return None if np.isnan(noise) else noise

    def _at_all_cadences(self, corrected):
        """Return a corrected light curve at all cadences, NaN where it has none."""
        n, flux = len(self.time), getattr(corrected, "flux", corrected)
        flux = plain_array(flux, None, "corrected")
        numbers = getattr(corrected, "cadenceno", None)
        if numbers is None:
            if flux.shape != (n,):
                wanted = f"one value for each of the {n} cadences or a column cadenceno"
                raise ValueError(f"`corrected` must have {wanted}, got shape {flux.shape}")
            return flux
        places = np.searchsorted(self.cadenceno, np.asarray(numbers)).clip(0, n - 1)
        if not np.array_equal(self.cadenceno[places], numbers):
            raise ValueError("`corrected` has cadences that the observation does not have")
        full = np.full(n, np.nan)
        full[places] = flux / np.nanmedian(flux)
        return full

    def _tpf_arguments(self, metadata, aperture_mask):
        aperture = self._checked_aperture(aperture_mask)
        if self.detector.mission not in MISSIONS:
            wanted = "Kepler, K2 or TESS (or Ground) to make a target pixel file"
            raise ValueError(f"`mission` must be {wanted}, got {self.detector.mission!r}")
        facts = scene_facts(self.scene) | dict(metadata or {})
        facts["extra_cards"] = self._aperture_cards(aperture) | dict(facts.get("extra_cards") or {})
        truth = {name: v for name, v in self.truth.columns.items() if name != "CADENCENO"}
        truth["TARGET_SHARE"] = self.target_share(aperture)
        metadata = TPFMetadata.of(self.detector, **facts)
        return {
            "metadata": metadata, "time": self._time_of(MISSIONS[metadata.mission]),
            **{name: getattr(self, name) for name in _WRITTEN}, "pos_corr1": self.motion.x,
            "pos_corr2": self.motion.y, "aperture": aperture, "truth_columns": truth,
            "truth_maps": self.truth.maps, "truth_tables": self.truth.tables or None,
            "scene": self.truth.scene,
        }  # fmt: skip

    def _time_of(self, mission):
        """Return the times with a mission's zero, if its detector can have them."""
        time = self.time + (TIME_ZEROS[self.motion.time_format] - mission.time_zero)
        days = self.detector.cadence_days
        step = np.median(np.diff(time)) if len(time) > 1 else days
        if time[0] < 0 or step < days / 2:
            raise ValueError(
                f"`motion` begins at {time[0]:.4g} d ({mission.time_format.upper()}) with a "
                f"cadence every {1440 * step:.4g} min; files of {mission.name} begin after 0, and "
                f"this detector has one every {1440 * days:.4g} min. Give times such as those of "
                f"Motion.still(n, start={mission.start}, cadence={days:.6g}, "
                f"time_format={mission.time_format!r})"
            )
        return time

    def _aperture_cards(self, aperture):
        light = self.star_images[:, aperture].sum(axis=1)
        if not light[0] > 0:
            return {}
        relative = self.truth.relative_flux[0]
        effects = (*self.detector.effects, *self.scene.effects)
        if any(type(effect).starlight is not Effect.starlight for effect in effects):
            relative = relative * _light.prepare(self.scene).lights[0].passed
        total = self.truth.flux[0] * relative.mean()
        return {"CROWDSAP": float(light[0] / light.sum()), "FLFRCSAP": float(light[0] / total)}
