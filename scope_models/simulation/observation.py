"""What a simulation gives: pixels and the truth behind them, and how they become a TPF."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from scope_models._checks import checked_mask
from scope_models.io import TPFMetadata, make_tpf_hdulist, write_tpf
from scope_models.missions import MISSIONS, TIME_ZEROS
from scope_models.photometry import signal_to_noise_aperture
from scope_models.scene.detector import Detector
from scope_models.scene.motion import Motion
from scope_models.scene.scene import Scene, describe_scene, scene_columns
from scope_models.scene.star import Star
from scope_models.simulation._light import Light

__all__ = ["Observation", "Truth"]

# Cadences that are enough to choose an aperture.
_APERTURE_CADENCES = 64


@dataclass(frozen=True, eq=False, repr=False)
class Truth:
    """What lies behind the pixels of an observation.

    Parameters
    ----------
    x, y : ndarray of shape (n_stars, n_cadences)
        Column and row of each star, the mean over the cadence, pixels.
    relative_flux : ndarray of shape (n_stars, n_cadences)
        Flux of each star, 1 at its magnitude.
    flux : ndarray of shape (n_stars,)
        Flux of each star at its magnitude, e-/s, before the response of the pixels.
    lost_fraction : ndarray of shape (n_stars,)
        Part of each star's light that falls off the stamp where the motion takes it farthest.
    interpixel : ndarray of shape (ny, nx)
        Response of each pixel against the others.
    detector : Detector
        The detector.
    seed : int
        The seed, given or taken from the operating system.
    noise : frozenset of str
        The noise terms.
    n_sub : int
        Exposures within a cadence over which the motion is averaged.
    model : ndarray of shape (n_cadences, ny, nx) or None
        Expected flux without noise and background, e-/s, if ``keep_model`` asked for it.
        `~scope_models.Observation.model` computes it at any time.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> observation = simulate(Star(12.0, x_0=4.5), Detector.k2(), Motion.still(50), seed=1)
    >>> observation.truth.seed, float(observation.truth.x[0, 0])
    (1, 4.5)
    """

    x: np.ndarray
    y: np.ndarray
    relative_flux: np.ndarray
    flux: np.ndarray
    lost_fraction: np.ndarray
    interpixel: np.ndarray
    detector: Detector
    seed: int
    noise: frozenset
    n_sub: int
    model: np.ndarray | None = None

    def __repr__(self):
        terms = ", ".join(sorted(self.noise)) or "none"
        return f"<Truth of {len(self.flux)} stars, seed {self.seed}, noise: {terms}>"


@dataclass(frozen=True, eq=False, repr=False)
class Observation:
    """The pixels of a simulation, with the truth.

    `simulate` makes it.

    Parameters
    ----------
    flux : ndarray of shape (n_cadences, ny, nx)
        Flux after subtraction of the background, e-/s.
    flux_err : ndarray of shape (n_cadences, ny, nx)
        True standard deviation of ``flux`` by the noise terms that are switched on, e-/s; at least
        that of rounding to single precision.
    flux_bkg : ndarray of shape (n_cadences, ny, nx)
        Background that was subtracted, e-/s. It is the true level.
    raw_cnts : ndarray of int, shape (n_cadences, ny, nx)
        Digital numbers of the whole cadence, with background and fixed offset.
    stars : tuple of Star
        The stars; the first is the target.
    detector : Detector
        The detector.
    motion : Motion
        The motion; time, quality and cadence numbers are its own.
    truth : Truth
        What lies behind the pixels.

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
    stars: tuple[Star, ...]
    detector: Detector
    motion: Motion
    truth: Truth

    def __post_init__(self):
        for cube in (self.flux, self.flux_err, self.raw_cnts):
            cube.flags.writeable = False

    def __repr__(self):
        n, ny, nx = self.flux.shape
        stars = f"{len(self.stars)} star{'s' if len(self.stars) > 1 else ''}"
        return (
            f"<Observation {self.detector.mission}: {n} cadences of {ny} x {nx} pixels, {stars}, "
            f"seed {self.truth.seed}>"
        )

    @property
    def time(self):
        """Middle of each cadence, days, in the format of the motion."""
        return self.motion.time

    @property
    def quality(self):
        """Quality flags."""
        return self.motion.quality

    @property
    def cadenceno(self):
        """Cadence numbers."""
        return self.motion.cadenceno

    @property
    def flux_bkg_err(self):
        """Error of the background, e-/s: 0, for its level is known."""
        return np.broadcast_to(np.float32(0), self.flux.shape)

    @property
    def scene(self):
        """The stars, detector, motion and options: ``simulate(*scene, **scene.options)``."""
        options = {
            "seed": self.truth.seed,
            "noise": sorted(self.truth.noise),
            "n_sub": self.truth.n_sub,
        }
        return Scene(self.stars, self.detector, self.motion, options)

    @cached_property
    def _light(self):
        """What renders the expected light again."""
        truth = self.truth
        return Light(self.stars, self.detector, self.motion, truth.seed, truth.n_sub)

    def model(self):
        """Return the expected flux, without noise and background.

        Returns
        -------
        ndarray of shape (n_cadences, ny, nx)
            Flux in e-/s, with the response of the pixels and saturation.

        Examples
        --------
        >>> import numpy as np
        >>> from scope_models import Detector, Motion, Star, simulate
        >>> observation = simulate(Star(12.0), Detector.k2(), Motion.still(9), noise=False)
        >>> np.allclose(observation.model(), observation.flux, rtol=1e-6, atol=1e-3)
        True
        """
        if self.truth.model is not None:
            return self.truth.model
        light = self._light
        model = np.empty(self.flux.shape)
        for cadences in light.pieces():
            model[cadences] = light.electrons(cadences)
        model /= self.detector.exposure_time
        return model

    @cached_property
    def aperture(self):
        """Pixels of the highest signal-to-noise ratio of the target, shape (ny, nx).

        All pixels if the target has no light on the stamp.
        """
        target, others = self._images
        if not target.any():
            return np.ones(self.detector.shape, dtype=bool)
        detector = self.detector
        return signal_to_noise_aperture(
            target,
            detector.exposure_time,
            neighbors=others,
            background=self.flux_bkg[0],
            read_noise=detector.read_noise,
            n_frames=detector.n_reads,
        )

    @cached_property
    def _images(self):
        """Noise-free images of the target and of all others, in some cadences."""
        light = self._light
        some = slice(None, None, -(-len(self.motion) // _APERTURE_CADENCES))
        target = light.star(0, some) * light.interpixel
        others = np.zeros_like(target)
        for number in range(1, len(self.stars)):
            others += light.star(number, some) * light.interpixel
        return target, others

    def target_share(self, aperture_mask=None):
        """Return the target's share in the starlight of an aperture, cadence by cadence.

        One minus it is the contamination: a signal of the target is diluted by the share.

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
        >>> stars = [Star(12.0, 5, 5), Star(14.0, 5.4, 5)]
        >>> observation = simulate(stars, Detector.k2(), Motion.still(3), seed=1)
        >>> observation.target_share().round(2)
        array([0.86, 0.86, 0.86])
        """
        return _share(self._light_in(self._checked_aperture(aperture_mask)))

    def _checked_aperture(self, aperture_mask):
        """Return the pixels of an aperture."""
        if aperture_mask is None:
            return self.aperture
        return checked_mask("aperture_mask", aperture_mask, self.detector.shape)

    def _light_in(self, aperture):
        """Return the flux of each star in an aperture, shape (n_stars, n_cadences)."""
        light = self._light
        sums = np.empty((len(self.stars), len(self.motion)))
        for cadences in light.pieces():
            for number in range(len(self.stars)):
                images = light.star(number, cadences)[:, aperture]
                sums[number, cadences] = images @ light.interpixel[aperture]
        return sums

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
            If the detector is of a mission without target pixel files, or the aperture has no
            pixels.

        Examples
        --------
        >>> from scope_models import Detector, Motion, Star, simulate
        >>> observation = simulate(Star(12.0), Detector.k2(), Motion.still(50), seed=1)
        >>> observation.to_tpf(metadata={"target_id": 205998445}).targetid
        205998445
        """
        from lightkurve import KeplerTargetPixelFile, TessTargetPixelFile

        hdulist = make_tpf_hdulist(**self._tpf_arguments(metadata, aperture_mask))
        kind = TessTargetPixelFile if self.detector.mission == "TESS" else KeplerTargetPixelFile
        return kind(hdulist, quality_bitmask=quality_bitmask)

    def to_lightcurve(self, aperture_mask=None, *, metadata=None, quality_bitmask="default"):
        """Return the sum of the pixels of an aperture as lightkurve's light curve.

        Parameters
        ----------
        aperture_mask : array_like of bool, shape (ny, nx), or str, optional
            The pixels, or what lightkurve understands. The default is `aperture`.
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
        mask = aperture_mask
        if not isinstance(mask, str):
            mask = self._checked_aperture(mask)
        return tpf.to_lightcurve(aperture_mask=mask)

    def write(self, path, overwrite=False, *, aperture_mask=None, metadata=None):
        """Write a target pixel file with the truth.

        Parameters
        ----------
        path : str or path-like
            The file, .fits or .fits.gz.
        overwrite : bool, optional
            Whether to replace a file.
        aperture_mask : array_like of bool, shape (ny, nx), optional
            The pixels of the file's optimal aperture. The default is `aperture`.
        metadata : mapping, optional
            Fields of `scope_models.io.TPFMetadata`, as target_id, object_name, ra or dec.

        Returns
        -------
        pathlib.Path
            The file.

        Raises
        ------
        OSError
            If the file exists and is not to be replaced, or cannot be written.
        ValueError
            If the detector is of a mission without target pixel files, or the aperture has no
            pixels.

        Examples
        --------
        >>> from scope_models import Detector, Motion, Star, simulate
        >>> observation = simulate(Star(12.0), Detector.k2(), Motion.still(50), seed=1)
        >>> observation.write("star.fits").name
        'star.fits'
        """
        arguments = self._tpf_arguments(metadata, aperture_mask)
        return write_tpf(path, overwrite=overwrite, **arguments)

    def _metadata(self, changes, light):
        """Return the facts for the headers, given the flux of each star in the aperture."""
        detector, target = self.detector, self.stars[0]
        if detector.mission not in MISSIONS:
            raise ValueError(
                f"`mission` must be Kepler, K2 or TESS to make a target pixel file, got "
                f"{detector.mission!r}"
            )
        x_0, y_0 = self._light.positions[0]
        facts = {
            "target_id": 1,
            "magnitude": target.mag,
            "x_0": x_0,
            "y_0": y_0,
            "seed": self.truth.seed,
        } | dict(changes or {})
        facts["extra_cards"] = self._aperture_cards(light) | dict(facts.get("extra_cards") or {})
        return TPFMetadata.of(detector, **facts)

    def _aperture_cards(self, light):
        """Return the cards on the target's light in the aperture."""
        own = light[0].sum()
        if not own > 0:
            return {}
        total = self.truth.flux[0] * self.truth.relative_flux[0].sum()
        return {"CROWDSAP": float(own / light.sum()), "FLFRCSAP": float(own / total)}

    def _tpf_arguments(self, metadata: Mapping | None, aperture_mask):
        """Return what the writer of target pixel files takes."""
        aperture = self._checked_aperture(aperture_mask)
        light = self._light_in(aperture)
        metadata = self._metadata(metadata, light)
        zero = MISSIONS[metadata.mission].time_zero
        return {
            "metadata": metadata,
            "time": self.time + (TIME_ZEROS[self.motion.time_format] - zero),
            "cadenceno": self.cadenceno,
            "raw_cnts": self.raw_cnts,
            "flux": self.flux,
            "flux_err": self.flux_err,
            "flux_bkg": self.flux_bkg,
            "flux_bkg_err": self.flux_bkg_err,
            "quality": self.quality,
            "pos_corr1": self.motion.x,
            "pos_corr2": self.motion.y,
            "aperture": aperture,
            "truth_columns": self._truth_columns(light),
            "truth_maps": {"INTERPIXEL": self.truth.interpixel},
            "scene": describe_scene(self.scene),
        }

    def _truth_columns(self, light):
        """Return the truth of each cadence as columns of a table."""
        columns = scene_columns(self.scene, self.truth.relative_flux)
        columns["TARGET_SHARE"] = _share(light)
        for i, (x, y) in enumerate(zip(self.truth.x, self.truth.y, strict=True), start=1):
            columns |= {f"X{i}": x, f"Y{i}": y}
        return columns


def _share(light):
    """Return the target's share in the flux of all stars, NaN where there is none."""
    total = light.sum(axis=0)
    return np.divide(light[0], total, out=np.full(len(total), np.nan), where=total > 0)
