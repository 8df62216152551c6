"""The detector: what the pixels do with the light of stars."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from scope_models._checks import checked_integer, checked_model, checked_number, checked_shape
from scope_models.effects.noise import stream
from scope_models.models import PRF, BivariateGaussianPSF, SensitivityPolynomial

if TYPE_CHECKING:
    from astropy.modeling import Model

__all__ = ["ZERO_POINTS", "Detector"]

ZERO_POINTS = {
    "Kepler": {"optimal aperture": 1.74e5, "focal plane": 2.141e5},
    "K2": {"optimal aperture": 1.74e5, "focal plane": 2.141e5},
    "TESS": {"handbook": 1.0},
}
_TESS_FRAMES = {20: 10, 120: 60, 200: 100, 600: 300, 1800: 900}
_SECONDS_PER_DAY = 86400.0
_DISTRIBUTIONS = ("uniform", "normal")
# Response within a pixel that K2's noise asks for: see `Detector.k2_calibrated`.
_CALIBRATED_A_2 = -0.75


@dataclass(frozen=True, eq=False, kw_only=True)
class Detector:
    r"""The pixels of a stamp: geometry, exposure, noise and response.

    The presets `kepler`, `k2`, `k2_calibrated` and `tess` hold the numbers of the missions with
    their sources. A detector does not change; `replace` and `without_sensitivity` give new ones.

    Parameters
    ----------
    shape : tuple of int
        Rows and columns ``(ny, nx)`` of the stamp.
    zero_point : float or str
        Electrons per second of a star of magnitude ``zero_point_mag``, or the name of one of the
        mission's zero points in `~scope_models.scene.detector.ZERO_POINTS`.
    zero_point_mag : float
        The magnitude that belongs to ``zero_point``.
    int_time : float
        Exposure of one frame, s.
    mission : str, optional
        "Kepler", "K2", "TESS" or any other name.
    pixel_scale : float, optional
        Size of a pixel on the sky, arcsec.
    read_time : float, optional
        Time per frame in which no light is recorded, s.
    n_frames : int, optional
        Frames per cadence.
    live_fraction : float, optional
        Part of the frames that is summed up; TESS's cosmic-ray mitigation drops two of ten.
    gain : float, optional
        Electrons per digital number (DN).
    read_noise : float, optional
        Standard deviation of one read, electrons.
    background : float, optional
        Background light, e-/s per pixel.
    well_depth : float or None, optional
        Electrons that a pixel holds in one frame before it bleeds; None for no limit.
    fixed_offset : int, optional
        Number added to each pixel of the raw counts, DN.
    mean_black : int, optional
        Black level of one read, DN. It is taken off before the counts are stored.
    sensitivity : astropy.modeling.Model or None, optional
        Response within a pixel: a `SensitivityPolynomial` or a product of several; None is 1.
    interpixel : array_like of shape (ny, nx) or None, optional
        Response of each pixel against the others, the b of the paper's Eq. 2. None draws it from
        the observation's seed with ``interpixel_scatter``.
    interpixel_scatter : float, optional
        Half width ("uniform") or standard deviation ("normal") of the drawn responses.
    interpixel_distribution : {"uniform", "normal"}, optional
        The distribution of the drawn responses about 1.
    psf : astropy.modeling.Model or None, optional
        The PSF of stars that have none of their own.

    Raises
    ------
    TypeError
        If a field is misspelt or of the wrong kind.
    ValueError
        If a number is not finite or outside its domain.

    Notes
    -----
    A pixel's response is :math:`s = b \sum_n a_{xn} u^n \sum_m a_{ym} v^m` (Eq. 2 of the paper)
    with :math:`u, v` measured from the centre of the pixel.

    Examples
    --------
    >>> from scope_models import Detector
    >>> detector = Detector.k2(shape=(9, 9), read_noise=100.0)
    >>> detector.shape, detector.n_frames, round(detector.exposure_time, 2)
    ((9, 9), 270, 1625.35)
    >>> round(detector.flux_from_mag(12.0))
    174000
    >>> detector.without_sensitivity()
    <Detector K2: 9 x 9 px of 3.98 arcsec, 270 frames of 6.0198 s, 174000 e-/s at magnitude 12,
    gain 110 e-/DN, read noise 100 e-, background 284 e-/s, well depth 1.08e+06 e-,
    sensitivity 1, interpixel uniform 0>
    """

    shape: tuple[int, int]
    zero_point: float
    zero_point_mag: float
    int_time: float
    mission: str = "custom"
    pixel_scale: float = 1.0
    read_time: float = 0.0
    n_frames: int = 1
    live_fraction: float = 1.0
    gain: float = 1.0
    read_noise: float = 0.0
    background: float = 0.0
    well_depth: float | None = None
    fixed_offset: int = 0
    mean_black: int = 0
    sensitivity: "Model | None" = None
    interpixel: np.ndarray | None = None
    interpixel_scatter: float = 0.0
    interpixel_distribution: str = "uniform"
    psf: "Model | None" = None

    def __post_init__(self):
        """Check every field and bring it to its type."""
        put = object.__setattr__
        put(self, "shape", checked_shape(self.shape))
        if not isinstance(self.mission, str):
            raise TypeError(f"`mission` must be a string, got {self.mission!r}")
        put(self, "zero_point", _zero_point_value(self.mission, self.zero_point))
        for name in ("zero_point", "int_time", "pixel_scale", "gain", "live_fraction"):
            put(self, name, checked_number(name, getattr(self, name), positive=True))
        for name in ("read_time", "read_noise", "background", "interpixel_scatter"):
            put(self, name, checked_number(name, getattr(self, name)))
        mag = checked_number("zero_point_mag", self.zero_point_mag, any_sign=True)
        put(self, "zero_point_mag", mag)
        for name in ("live_fraction", "interpixel_scatter"):
            if getattr(self, name) > 1:
                raise ValueError(f"`{name}` must not be above 1, got {getattr(self, name)}")
        for name, smallest in (("n_frames", 1), ("fixed_offset", 0), ("mean_black", 0)):
            put(self, name, checked_integer(name, getattr(self, name), smallest))
        if self.interpixel_distribution not in _DISTRIBUTIONS:
            raise ValueError(
                f"`interpixel_distribution` must be one of {', '.join(_DISTRIBUTIONS)}, "
                f"got {self.interpixel_distribution!r}"
            )
        for name in ("sensitivity", "psf"):
            put(self, name, checked_model(name, getattr(self, name)))
        # Whatever cannot be integrated over pixels fails here rather than in a simulation.
        if self.psf is not None:
            PRF(self.psf)
        if self.sensitivity is not None:
            PRF(BivariateGaussianPSF() * self.sensitivity)
        self._check_well_depth()
        if self.interpixel is not None:
            put(self, "interpixel", _checked_map(self.interpixel, self.shape))

    def _check_well_depth(self):
        """Check that a pixel holds the background of a frame."""
        if self.well_depth is None:
            return
        depth = checked_number("well_depth", self.well_depth, positive=True)
        object.__setattr__(self, "well_depth", depth)
        if self.background * self.int_time >= depth:
            raise ValueError(
                f"`well_depth` must exceed the background of a frame, "
                f"{self.background * self.int_time:g} e-, got {depth:g}"
            )

    def __repr__(self):
        depth = "none" if self.well_depth is None else f"{self.well_depth:g} e-"
        spread = f"{self.interpixel_distribution} {self.interpixel_scatter:g}"
        return (
            f"<Detector {self.mission}: {self.shape[0]} x {self.shape[1]} px of "
            f"{self.pixel_scale:g} arcsec, {self.n_frames} frames of {self.int_time:g} s, "
            f"{self.zero_point:g} e-/s at magnitude {self.zero_point_mag:g}, "
            f"gain {self.gain:g} e-/DN, read noise {self.read_noise:g} e-, "
            f"background {self.background:g} e-/s, well depth {depth}, "
            f"sensitivity {'1' if self.sensitivity is None else type(self.sensitivity).__name__}, "
            f"interpixel {spread if self.interpixel is None else 'given'}>"
        )

    @classmethod
    def kepler(cls, *, cadence="long", **changes):
        """Return the Kepler photometer.

        Parameters
        ----------
        cadence : {"long", "short"}, optional
            270 frames in 29.4 min, or 9 frames in 58.8 s.
        **changes
            Any field of `Detector`, to replace the preset's value.

        Returns
        -------
        Detector
            The detector.

        Raises
        ------
        ValueError
            If ``cadence`` is unknown.
        TypeError
            If a field is misspelt.

        Notes
        -----
        ======================= ==================== ==========================================
        field                   value                source
        ======================= ==================== ==========================================
        shape                   (11, 11) px          our choice
        pixel_scale             3.98 arcsec          KSCI-19033 (Kepler Instrument Handbook)
        zero_point              1.74e5 e-/s, Kp = 12 optimal aperture: Kepler GO calibration page
        "focal plane"           2.141e5 e-/s         KSCI-19033-002, section 7.5
        int_time, read_time     6.019802903270 s,    headers of target pixel files
                                0.518948526144 s
        n_frames                270 (long), 9        headers of target pixel files
        gain                    110 e-/DN            target pixel files: 105 to 114
        read_noise              90 e-                target pixel files: 85 to 112
        background              166 e-/s/px          Kepler telescope page
        well_depth              1.08e6 e-            median of KSCI-19033, table 13
        fixed_offset            419400 (long),       LCFXDOFF and SCFXDOFF in the headers of
                                219400 DN            target pixel files
        mean_black              720 DN               MEANBLCK, target pixel files: 712 to 744
        sensitivity             {1, 0, -0.05}        Saunders et al., Eq. 2
        interpixel_scatter      0.01, uniform        Saunders et al.: "up to 1 %"
        psf                     Gaussian, 0.5 px     Saunders et al.
        ======================= ==================== ==========================================

        Examples
        --------
        >>> from scope_models import Detector
        >>> Detector.kepler(cadence="short").n_frames
        9
        >>> round(Detector.kepler(zero_point="focal plane").flux_from_mag(12.0))
        214100
        """
        return cls._photometer("Kepler", cadence, 166.0, changes)

    @classmethod
    def k2(cls, *, cadence="long", **changes):
        """Return the Kepler photometer in the K2 mission.

        Parameters
        ----------
        cadence : {"long", "short"}, optional
            270 frames in 29.4 min, or 9 frames in 58.8 s.
        **changes
            Any field of `Detector`, to replace the preset's value.

        Returns
        -------
        Detector
            The detector.

        Raises
        ------
        ValueError
            If ``cadence`` is unknown.
        TypeError
            If a field is misspelt.

        Notes
        -----
        Every value is that of `kepler`, but the background: 284 e-/s per pixel is the median
        FLUX_BKG in the target pixel file of EPIC 211983544, campaign 18; that of EPIC 211956421,
        campaign 5, has 360. Fields near the ecliptic see more zodiacal light.

        Examples
        --------
        >>> from scope_models import Detector
        >>> Detector.k2().mission
        'K2'
        """
        return cls._photometer("K2", cadence, 284.0, changes)

    @classmethod
    def k2_calibrated(cls, *, cadence="long", **changes):
        r"""Return the K2 photometer with a response that gives K2's noise.

        With the paper's response stars that move as in K2 are too quiet. Here the response within
        pixels, that between them and the wings of the PSF are fitted to the noise of K2
        campaign 3 before de-trending.

        Parameters
        ----------
        cadence : {"long", "short"}, optional
            270 frames in 29.4 min, or 9 frames in 58.8 s.
        **changes
            Any field of `Detector`, to replace the preset's value.

        Returns
        -------
        Detector
            The detector.

        Raises
        ------
        ValueError
            If ``cadence`` is unknown.
        TypeError
            If a field is misspelt.

        Notes
        -----
        Every value is that of `k2` but these. The study is on the page on calibration; the fit is
        ``python benchmarks/calibrate_k2_motion.py``. Of the values that fit alike, these also give
        EPIC 205998445 its noise.

        ======================= ==================== ==========================================
        field                   value                source
        ======================= ==================== ==========================================
        sensitivity             :math:`a_2 = -0.75`  fit; along both axes
                                (-0.85 to -0.45)     :math:`(1 + a_2 u^2) / (1 + a_2 / 12)`, so
                                                     that the mean over a pixel is 1
        interpixel_scatter      0.011, normal        fit
                                (0.0045 to 0.0135)
        psf                     Gaussians: 80 % with wings of 20 %: chosen; the widths follow
                                sigma 0.450 px, 20 % from Kepler's PRF, 45 % of the light in the
                                with 1.261 px        brightest pixel and 95 % within a diameter
                                                     of 4.2 px (Kepler telescope page, medians)
        ======================= ==================== ==========================================

        The ranges hold for these wings. The three go together: with 10 % in the wings
        :math:`a_2` is -1.35 to -1.1, and what one response explains the other need not.

        Examples
        --------
        >>> from scope_models import Detector
        >>> detector = Detector.k2_calibrated()
        >>> edge, centre = detector.sensitivity(0.5, 0.0), detector.sensitivity(0.0, 0.0)
        >>> print(f"{edge / centre:.4f}")
        0.8125
        """
        mean = 1 + _CALIBRATED_A_2 / 12
        response = (1 / mean, 0.0, _CALIBRATED_A_2 / mean)
        calibrated = {
            "sensitivity": SensitivityPolynomial(response, response),
            "interpixel_scatter": 0.011,
            "interpixel_distribution": "normal",
            "psf": BivariateGaussianPSF(0.8, sigma_x=0.45, sigma_y=0.45)
            + BivariateGaussianPSF(0.2, sigma_x=1.261, sigma_y=1.261),
        }
        return cls._photometer("K2", cadence, 284.0, calibrated | changes)

    @classmethod
    def _photometer(cls, mission, cadence, background, changes):
        """Return a preset of the Kepler photometer."""
        frames = {"long": (270, 419400), "short": (9, 219400)}
        if cadence not in frames:
            raise ValueError(f"`cadence` must be 'long' or 'short', got {cadence!r}")
        n_frames, fixed_offset = frames[cadence]
        preset = {
            "mission": mission,
            "shape": (11, 11),
            "pixel_scale": 3.98,
            "zero_point": ZERO_POINTS[mission]["optimal aperture"],
            "zero_point_mag": 12.0,
            "int_time": 6.019802903270,
            "read_time": 0.518948526144,
            "n_frames": n_frames,
            "gain": 110.0,
            "read_noise": 90.0,
            "background": background,
            "well_depth": 1.08e6,
            "fixed_offset": fixed_offset,
            "mean_black": 720,
            "sensitivity": SensitivityPolynomial(),
            "interpixel_scatter": 0.01,
            "psf": BivariateGaussianPSF(),
        }
        return cls(**(preset | changes))

    @classmethod
    def tess(cls, *, cadence=120, **changes):
        """Return a TESS camera.

        Parameters
        ----------
        cadence : {20, 120, 200, 600, 1800}, optional
            Length of a cadence, s.
        **changes
            Any field of `Detector`, to replace the preset's value.

        Returns
        -------
        Detector
            The detector.

        Raises
        ------
        ValueError
            If ``cadence`` is unknown.
        TypeError
            If a field is misspelt.

        Notes
        -----
        ======================= ==================== ==========================================
        field                   value                source
        ======================= ==================== ==========================================
        shape                   (11, 11) px          target pixel files
        pixel_scale             21 arcsec            TESS Instrument Handbook
        zero_point              1 e-/s, T = 20.44    TESS Instrument Handbook (+- 0.05 mag)
        int_time, read_time     1.98 s, 0.02 s       headers of target pixel files
        n_frames                cadence / 2 s        headers of target pixel files
        live_fraction           0.8; 1 at 20 s       the cosmic-ray mitigation on board drops the
                                                     highest and lowest of ten reads
                                                     (handbook); 20-s data go without it
        gain                    5.25 e-/DN           GAINA to GAIND, TIC 273589987: 5.21 to 5.28
        read_noise              10 e-                TESS Instrument Handbook
        background              134 e-/s/px          FLUX_BKG of TIC 273589987, sector 15
        well_depth              2e5 e-               TESS Instrument Handbook
        fixed_offset            209700 DN            FXDOFF of TIC 273589987
        mean_black              6812 DN              MEANBLCA of TIC 273589987
        sensitivity             {1, 0, -0.05}        assumed: the paper's, for Kepler
        interpixel_scatter      0.01, uniform        assumed: the paper's, for Kepler
        psf                     Gaussians: 45 % with assumed; 83 % of its light is in the optimal
                                sigma 0.55 px, 55 %  aperture of TIC 273589987, sector 15, where
                                with 1.25 px         FLFRCSAP is 84 %
        ======================= ==================== ==========================================

        Examples
        --------
        >>> from scope_models import Detector
        >>> detector = Detector.tess()
        >>> round(detector.exposure_time, 2), detector.n_reads
        (95.04, 48)
        """
        if cadence not in _TESS_FRAMES:
            known = ", ".join(map(str, _TESS_FRAMES))
            raise ValueError(f"`cadence` must be one of {known} s, got {cadence!r}")
        preset = {
            "mission": "TESS",
            "shape": (11, 11),
            "pixel_scale": 21.0,
            "zero_point": ZERO_POINTS["TESS"]["handbook"],
            "zero_point_mag": 20.44,
            "int_time": 1.98,
            "read_time": 0.02,
            "n_frames": _TESS_FRAMES[cadence],
            "live_fraction": 1.0 if cadence == 20 else 0.8,
            "gain": 5.25,
            "read_noise": 10.0,
            "background": 134.0,
            "well_depth": 2e5,
            "fixed_offset": 209700,
            "mean_black": 6812,
            "sensitivity": SensitivityPolynomial(),
            "interpixel_scatter": 0.01,
            "psf": BivariateGaussianPSF(0.45, sigma_x=0.55, sigma_y=0.55)
            + BivariateGaussianPSF(0.55, sigma_x=1.25, sigma_y=1.25),
        }
        return cls(**(preset | changes))

    @property
    def exposure_time(self):
        """Time in which a cadence gathers light, s."""
        return self.int_time * self.n_frames * self.live_fraction

    @property
    def frame_time(self):
        """Length of a frame, s."""
        return self.int_time + self.read_time

    @property
    def cadence_days(self):
        """Length of a cadence, days."""
        return self.n_frames * self.frame_time / _SECONDS_PER_DAY

    @property
    def n_reads(self):
        """Number of reads that are summed up in a cadence."""
        return max(1, round(self.n_frames * self.live_fraction))

    @property
    def cadence_read_noise(self):
        """Standard deviation of all reads of a cadence together, electrons."""
        return self.read_noise * self.n_reads**0.5

    def flux_from_mag(self, mag):
        """Return the flux of a star before the response of the pixels.

        Parameters
        ----------
        mag : float or array_like
            Magnitude in the mission's band (Kp or T).

        Returns
        -------
        float or ndarray
            Flux in e-/s.

        Raises
        ------
        ValueError
            If a magnitude is not finite.

        Examples
        --------
        >>> from scope_models import Detector
        >>> round(Detector.tess().flux_from_mag(10.0))
        14997
        """
        mag = np.asarray(mag, dtype=float)
        if not np.all(np.isfinite(mag)):
            raise ValueError(f"`mag` must be finite, got {mag}")
        flux = self.zero_point * 10.0 ** (-0.4 * (mag - self.zero_point_mag))
        return float(flux) if flux.ndim == 0 else flux

    def interpixel_map(self, seed):
        """Return the response of each pixel against the others, b of Eq. 2.

        Parameters
        ----------
        seed : int
            The seed of the observation; its stream "interpixel" draws the map where the detector
            has none.

        Returns
        -------
        ndarray of shape (ny, nx)
            Not negative, about 1.

        Examples
        --------
        >>> from scope_models import Detector
        >>> response = Detector.k2().interpixel_map(seed=1)
        >>> response.shape, bool(abs(response - 1).max() <= 0.01)
        ((11, 11), True)
        """
        if self.interpixel is not None:
            return self.interpixel.copy()
        generator = stream(seed, "interpixel")
        if self.interpixel_distribution == "uniform":
            deviates = generator.uniform(-1.0, 1.0, self.shape)
        else:
            deviates = generator.standard_normal(self.shape)
        return np.maximum(1.0 + self.interpixel_scatter * deviates, 0.0)

    def replace(self, **changes):
        """Return a detector with some fields changed.

        Parameters
        ----------
        **changes
            Fields of `Detector` and their new values.

        Returns
        -------
        Detector
            The new detector.

        Raises
        ------
        TypeError
            If a field is misspelt.

        Examples
        --------
        >>> from scope_models import Detector
        >>> Detector.k2().replace(background=0.0).background
        0.0
        """
        return replace(self, **changes)

    def without_sensitivity(self):
        """Return the same detector with pixels that all respond alike, and evenly within.

        Returns
        -------
        Detector
            The control: no variation within a pixel, none between pixels.

        Examples
        --------
        >>> from scope_models import Detector
        >>> Detector.k2().without_sensitivity().sensitivity is None
        True
        """
        return replace(self, sensitivity=None, interpixel=None, interpixel_scatter=0.0)


def _checked_map(response, shape):
    """Return a read-only copy of an interpixel map."""
    response = np.array(response, dtype=float)
    if response.shape != shape:
        raise ValueError(f"`interpixel` must have the shape {shape}, got {response.shape}")
    if not np.all(np.isfinite(response)) or response.min() < 0:
        raise ValueError("`interpixel` must be finite and not negative")
    response.flags.writeable = False
    return response


def _zero_point_value(mission, zero_point):
    """Return a zero point given by its name or as a number."""
    if not isinstance(zero_point, str):
        return zero_point
    known = ZERO_POINTS.get(mission, {})
    if zero_point not in known:
        raise ValueError(
            f"`zero_point` must be a number or one of {list(known)} for {mission}, "
            f"got {zero_point!r}"
        )
    return known[zero_point]
