"""Figures of a target; matplotlib is imported when the first one is drawn."""

import numpy as np

from scope_models.models import PRF

__all__ = ["TargetFigures"]


class TargetFigures:
    """The figures of a `Target`, which provides the arrays."""

    def display_detector(self, oversample=20, *, axes=None):
        """
        Draw sensitivity, PSF and pixels of the first cadence (the paper's figure 3).

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
            flux = truth.flux[i] * truth.relative_flux[i, 0]
            light += flux * _density(psf, x - truth.x[i, 0], y - truth.y[i, 0])
        return plot_detector(
            sensitivity,
            light,
            self.targetpixelfile[0],
            oversample,
            aperture=self.aperture,
            axes=axes,
        )

    def display_aperture(self, *, ax=None):
        """
        Draw the pixels of the first cadence with the outline of the aperture.

        Parameters
        ----------
        ax : `~matplotlib.axes.Axes`, optional
            Where to draw; a new figure by default.

        Returns
        -------
        `~matplotlib.axes.Axes`
            The Axes.

        Examples
        --------
        >>> import scope_models as scope
        >>> scope.generate_target(ncadences=10, seed=1).display_aperture().get_title()
        'First cadence'
        """
        from scope_models.plotting import plot_pixels

        return plot_pixels(self.targetpixelfile[0], self.aperture, title="First cadence", ax=ax)

    def display_motion(self, *, ax=None):
        """
        Draw the track of the star over the pixels, coloured by time.

        Parameters
        ----------
        ax : `~matplotlib.axes.Axes`, optional
            Where to draw; a new figure by default.

        Returns
        -------
        `~matplotlib.axes.Axes`
            The Axes.

        Examples
        --------
        >>> import scope_models as scope
        >>> scope.generate_target(ncadences=10, seed=1).display_motion().get_title()
        'Motion'
        """
        from scope_models.plotting import plot_motion

        truth, shape = self.observation.truth, self.detector.shape
        return plot_motion(
            self.time, truth.x[0], truth.y[0], shape, time_label=self._time_label, ax=ax
        )

    def plot(self):
        """
        Draw pixels, motion and light curves in one figure.

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

    def plot_transit(self, number=0, *, window=None, ax=None):
        """
        Draw the light curve folded on a transit that was added.

        The star's other signals are divided out by their truth.

        Parameters
        ----------
        number : int, optional
            Which of `transits`.
        window : float, optional
            Hours to draw on either side of mid-transit; by default twice
            the transit's duration.
        ax : `~matplotlib.axes.Axes`, optional
            Where to draw; a new figure by default.

        Returns
        -------
        `~matplotlib.axes.Axes`
            The Axes; the light curve is the de-trended one after
            `Target.detrend` was called.

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

    def animate(self, *, step=1, interval=50, ax=None):
        """
        Animate the pixels.

        Parameters
        ----------
        step : int, optional
            Draw every step-th cadence.
        interval : float, optional
            Milliseconds per frame.
        ax : `~matplotlib.axes.Axes`, optional
            Where to draw; a new figure by default.

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
        from scope_models.plotting import animate_pixels

        return animate_pixels(
            self.targetpixelfile[::step],
            self.time[::step],
            self.aperture,
            interval=interval,
            time_label=self._time_label,
            ax=ax,
        )

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


def _density(psf, x, y):
    """Return the values of a PSF of total 1 about its position, in the sense of `PRF`."""
    prf = PRF(psf)
    return psf(x + prf.x_0.value, y + prf.y_0.value) / prf.flux.value
