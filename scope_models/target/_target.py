"""The star of the paper's Appendix A."""

import numpy as np

from scope_models._checks import checked_mask
from scope_models.photometry import (
    cdpp,
    circular_aperture,
    contamination_aperture,
    signal_to_noise_aperture,
    threshold_aperture,
)
from scope_models.target._figures import TargetFigures
from scope_models.target._scene import TargetScene

__all__ = ["Target"]


class Target(TargetScene, TargetFigures):
    """
    A simulated star, its neighbours and its pixels.

    `generate_target` makes it. What is added changes the expected flux only:
    the noise of all else stays as it was, as every effect draws from its own
    stream of the seed.

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
        Its neighbours.
    transits : list of `~scope_models.TransitModel`
        The transits that were added.
    detector, motion, seed
        See the parameters.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star
    >>> from scope_models.target import Target
    >>> star = Target(Star(12.0, 5, 5), Detector.k2(), Motion.still(100), seed=1)
    >>> star.add_transit(depth=0.01, per=15, dur=0.5, t0=1)
    <Target of magnitude 12 with 1 transit and 0 neighbours: 100 cadences of 11 x 11 pixels, seed 1>
    """

    def create_aperture(self, method="threshold", **options):
        """
        Choose the aperture.

        Parameters
        ----------
        method : {"threshold", "signal-to-noise", "contamination", "circular"}, optional
            Pixels that the noise-free star brightens at any cadence (the
            paper's); the highest signal-to-noise ratio; the star's pixels
            that neighbours do not dominate; a circle about the star's
            reference position.
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
            If an option is misspelt.

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
        self._aperture, self._detrended = mask, None
        return mask

    def estimate_cdpp(self, flux=None, duration=6.5, method="lightkurve"):
        """
        Estimate the noise on the time scale of a transit.

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

    def to_tpf(self, *, metadata=None, quality_bitmask="default"):
        """
        Return lightkurve's target pixel file, with `aperture` as its own.

        Parameters
        ----------
        metadata : mapping, optional
            Fields of `scope_models.io.TPFMetadata`.
        quality_bitmask : str or int, optional
            Which flagged cadences lightkurve leaves out.

        Returns
        -------
        `~lightkurve.targetpixelfile.KeplerTargetPixelFile`
            The target pixel file.

        Examples
        --------
        >>> import scope_models as scope
        >>> scope.generate_target(ncadences=50, seed=1).to_tpf().shape[1:]
        (7, 7)
        """
        return self.observation.to_tpf(
            aperture_mask=self.aperture, metadata=metadata, quality_bitmask=quality_bitmask
        )

    def to_lightcurve(self, aperture_mask=None, **options):
        """
        Return lightkurve's light curve of an aperture.

        Parameters
        ----------
        aperture_mask : array_like of bool, or str, optional
            Mask ``(ny, nx)``, or what lightkurve understands; by default
            `aperture`.
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

    def write(self, path, overwrite=False, *, metadata=None):
        """
        Write a target pixel file with the truth and `aperture`.

        Parameters
        ----------
        path : str or path-like
            The file, .fits or .fits.gz.
        overwrite : bool, optional
            Whether to replace a file.
        metadata : mapping, optional
            Fields of `scope_models.io.TPFMetadata`.

        Returns
        -------
        pathlib.Path
            The file.

        Raises
        ------
        OSError
            If the file exists and is not to be replaced, or cannot be written.

        Examples
        --------
        >>> import scope_models as scope
        >>> scope.generate_target(ncadences=50, seed=1).write("star.fits").name
        'star.fits'
        """
        return self.observation.write(
            path, overwrite, aperture_mask=self.aperture, metadata=metadata
        )

    def detrend(self, *, mask_transits=True, **options):
        """
        De-trend the light curve of `aperture` by pixel-level decorrelation.

        Parameters
        ----------
        mask_transits : bool, optional
            Leave the cadences of the transits that were added out of the fit.
        **options
            Options of `scope_models.correctors.PLDCorrector.correct`, such
            as order or transit_mask.

        Returns
        -------
        `~lightkurve.LightCurve`
            The de-trended light curve, without the cadences that
            lightkurve's default quality mask drops. `plot` draws it too.

        Raises
        ------
        TypeError
            If an option is misspelt.

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
        self._detrended = PLDCorrector(tpf, aperture_mask=self.aperture).correct(**options)
        return self._detrended
