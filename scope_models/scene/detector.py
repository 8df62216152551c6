"""The detector: geometry, response and noise of the pixels."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import astropy.units as u
import numpy as np

from scope_models._arrays import DIGITAL, PER_PIXEL, plain_array
from scope_models._checks import (
    check_fields,
    checked_choice,
    checked_model,
    checked_shape,
    integer,
    number,
)
from scope_models._docstrings import documented
from scope_models._values import Value, frozen, html_table
from scope_models.effects._noise import stream
from scope_models.effects.base import Effect, checked_several
from scope_models.io.pixels import read_pixels
from scope_models.missions import MISSIONS, choose_cadence, full_flux
from scope_models.models import PRF, BivariateGaussianPSF
from scope_models.models._description import model_in_pixels
from scope_models.scene import _storage, presets

if TYPE_CHECKING:
    from astropy.modeling import Model

__all__ = ["ZERO_POINTS", "Detector"]

#: Zero points of the missions, by name.
ZERO_POINTS = {name: dict(mission.zero_points) for name, mission in MISSIONS.items()}
_DRAWN = ("uniform", "normal")
_RATE = u.electron / u.s

# Parts of the docstrings of the presets.
_CHANGES = """**changes
    Any field of `Detector`, to replace these values.

Returns
-------
Detector
    The detector.

Raises
------
TypeError, ValueError
    If a field is misspelled, of the wrong kind or outside its domain."""
_CADENCE = f"""Parameters
----------
cadence : {{"long", "short"}}, float or Quantity, optional
    270 frames in 29.4 min, or 9 in 58.8 s; or the length, in seconds or with a unit.
{_CHANGES}"""


@dataclass(frozen=True, eq=False, kw_only=True)
class Detector(Value):
    r"""The pixels of a stamp: geometry, exposure, noise and response.

    `kepler`, `k2`, `k2_calibrated`, `tess` and `ground` have the numbers of instruments with their
    sources; `preset` finds these, and your own, by name; `from_tpf` takes those of a file. Numbers
    with a unit may be quantities.

    Parameters
    ----------
    shape : tuple of int
        Rows and columns ``(ny, nx)`` of the stamp.
    zero_point : float or str
        Electrons per second of a star of magnitude ``zero_point_mag``, or the name of one in
        `~scope_models.scene.detector.ZERO_POINTS`.
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
        Part of the frames that is summed.
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
        Black level of one read, DN, taken off before the counts are stored.
    sensitivity : astropy.modeling.Model or None, optional
        Response within a pixel: a `SensitivityPolynomial` or a product of several; None is 1.
    interpixel : array_like of shape (ny, nx) or None, optional
        Response of each pixel against the others, the b of the paper's Eq. 2. None draws it from
        the observation's seed.
    interpixel_scatter : float, optional
        Half width ("uniform") or standard deviation ("normal") of the drawn responses about 1.
    interpixel_distribution : {"uniform", "normal"}, optional
        Their distribution.
    psf : astropy.modeling.Model or None, optional
        The PSF of stars that have none of their own. Widths that are angles become pixels.
    effects : Effect or sequence of Effect, optional
        Effects of the instrument and its site in every scene: see `scope_models.effects`.

    Raises
    ------
    TypeError, ValueError
        If a field is misspelled, of the wrong kind or outside its domain.

    Notes
    -----
    A pixel's response is :math:`s = b \sum_n a_{xn} u^n \sum_m a_{ym} v^m` (Eq. 2 of the paper)
    with :math:`u, v` from the center of the pixel.

    Examples
    --------
    >>> from scope_models import Detector
    >>> detector = Detector.k2(shape=(9, 9), read_noise=100.0)
    >>> detector.shape, detector.n_frames, round(detector.exposure_time, 2)
    ((9, 9), 270, 1625.35)
    """

    shape: tuple[int, int]
    zero_point: float = number(unit=_RATE, positive=True)
    zero_point_mag: float = number(unit=u.mag, any_sign=True)
    int_time: float = number(unit=u.s, positive=True)
    mission: str = "custom"
    pixel_scale: float = number(1.0, u.arcsec, positive=True, equivalencies=PER_PIXEL)
    read_time: float = number(0.0, u.s)
    n_frames: int = integer(1, 1)
    live_fraction: float = number(1.0, positive=True, at_most=1)
    gain: float = number(1.0, u.electron / u.adu, positive=True, equivalencies=DIGITAL)
    read_noise: float = number(0.0, u.electron)
    background: float = number(0.0, _RATE, equivalencies=PER_PIXEL)
    well_depth: float | None = number(None, u.electron, positive=True)
    fixed_offset: int = integer(0, 0)
    mean_black: int = integer(0, 0)
    sensitivity: "Model | None" = None
    interpixel: np.ndarray | None = None
    interpixel_scatter: float = number(0.0, at_most=1)
    interpixel_distribution: str = "uniform"
    psf: "Model | None" = None
    effects: tuple[Effect, ...] = ()

    def __post_init__(self):
        put = object.__setattr__
        put(self, "shape", checked_shape(self.shape))
        if not isinstance(self.mission, str):
            raise TypeError(f"`mission` must be a string, got {self.mission!r}")
        if isinstance(self.zero_point, str):
            known = ZERO_POINTS.get(self.mission, {})
            if self.zero_point not in known:
                wanted = f"a number or one of {list(known)} for {self.mission}"
                raise ValueError(f"`zero_point` must be {wanted}, got {self.zero_point!r}")
            put(self, "zero_point", known[self.zero_point])
        check_fields(self)
        checked_choice("interpixel_distribution", self.interpixel_distribution, _DRAWN)
        for name in ("sensitivity", "psf"):
            model = checked_model(name, getattr(self, name))
            put(self, name, model_in_pixels(model, self.pixel_scale))
        # Whatever cannot be integrated over pixels fails here rather than in a simulation.
        if self.psf is not None:
            PRF(self.psf)
        if self.sensitivity is not None:
            PRF(BivariateGaussianPSF() * self.sensitivity)
        light = self.background * self.int_time
        if self.well_depth is not None and light >= self.well_depth:
            wanted = f"exceed the background of a frame, {light:g} e-"
            raise ValueError(f"`well_depth` must {wanted}, got {self.well_depth:g}")
        put(self, "effects", checked_several("effects", self.effects, Effect))
        if self.interpixel is not None:
            response = plain_array(self.interpixel, u.one, "interpixel")
            if response.shape != self.shape or not np.all((response >= 0) & (response < np.inf)):
                wanted = f"finite and not negative, of the shape {self.shape}"
                raise ValueError(f"`interpixel` must be {wanted}, got {response.shape}")
            put(self, "interpixel", frozen(response))

    def __repr__(self):
        rows = self._rows()
        texts = [rows.pop(name) for name in ("stamp", "frames", "zero point")]
        texts += [f"{name} {text}" for name, text in rows.items()]
        return f"<Detector {self.mission}: {', '.join(texts)}>"

    def _repr_html_(self):
        psf = "none" if self.psf is None else f"{PRF(self.psf).n_components} components"
        return html_table(f"Detector {self.mission}", self._rows() | {"PSF": psf})

    def _rows(self):
        spread = f"{self.interpixel_distribution} {self.interpixel_scatter:g}"
        return {
            "stamp": f"{self.shape[0]} x {self.shape[1]} px of {self.pixel_scale:g} arcsec",
            "frames": f"{self.n_frames} frames of {self.int_time:g} s",
            "zero point": f"{self.zero_point:g} e-/s at magnitude {self.zero_point_mag:g}",
            "gain": f"{self.gain:g} e-/DN",
            "read noise": f"{self.read_noise:g} e-",
            "background": f"{self.background:g} e-/s",
            "well depth": "none" if self.well_depth is None else f"{self.well_depth:g} e-",
            "sensitivity": "1" if self.sensitivity is None else type(self.sensitivity).__name__,
            "interpixel": spread if self.interpixel is None else "given",
        }

    @classmethod
    @documented(changes=_CHANGES)
    def preset(cls, name, cadence=None, **changes):
        """Return a known detector.

        Parameters
        ----------
        name : str
            A name of `~scope_models.scene.presets.PRESETS`, in any case.
        cadence : str, float or Quantity, optional
            A cadence, by its name or length, in seconds or with a unit; by default the usual one.
        {changes}

        Examples
        --------
        >>> from scope_models import Detector
        >>> Detector.preset("tess", "20 s").n_frames
        10
        """
        found = presets.PRESETS.get(name.lower()) if isinstance(name, str) else None
        if found is None:
            raise ValueError(f"`name` must be one of {', '.join(presets.PRESETS)}, got {name!r}")
        fields = dict(found.fields)
        if cadence is not None or found.cadences:
            frame_time = fields["int_time"] + fields.get("read_time", 0.0)
            item = choose_cadence(found.cadences, frame_time, cadence)
            of_cadence = ("n_frames", "live_fraction", "fixed_offset")
            fields |= {name: getattr(item, name) for name in of_cadence}
        return cls(**(fields | changes))

    @classmethod
    @documented(rest=_CADENCE)
    def kepler(cls, cadence="long", **changes):
        """Return the Kepler photometer.

        {rest}

        Notes
        -----
        The page on noise has the values and more of their sources; TPFs are target pixel files:

        =================================== ========================================================
        pixel_scale                         KSCI-19033 (Kepler Instrument Handbook)
        zero_point                          "optimal aperture": Kepler GO calibration page; "focal
                                            plane": KSCI-19033-002, section 7.5
        int_time, read_time, n_frames       TPFs
        gain, read_noise, mean_black        TPFs
        fixed_offset                        TPFs: LCFXDOFF and SCFXDOFF
        background                          Kepler telescope page
        well_depth                          median of KSCI-19033, table 13
        sensitivity, psf                    Saunders et al., Eq. 2
        interpixel_scatter                  Saunders et al.: "up to 1 %"
        =================================== ========================================================

        Examples
        --------
        >>> from scope_models import Detector
        >>> Detector.kepler(cadence="short").n_frames
        9
        """
        return cls.preset("kepler", cadence, **changes)

    @classmethod
    @documented(rest=_CADENCE)
    def k2(cls, cadence="long", **changes):
        """Return the Kepler photometer in the K2 mission.

        {rest}

        Notes
        -----
        Every value is that of `kepler`, but the background: 284 e-/s per pixel is the median
        FLUX_BKG of EPIC 211983544, campaign 18 (EPIC 211956421, campaign 5: 360).

        Examples
        --------
        >>> from scope_models import Detector
        >>> Detector.k2().mission
        'K2'
        """
        return cls.preset("k2", cadence, **changes)

    @classmethod
    @documented(rest=_CADENCE)
    def k2_calibrated(cls, cadence="long", **changes):
        r"""Return the K2 photometer with a response that gives K2's noise.

        The response and the wings of the PSF are fitted to the noise of K2 campaign 3 before
        de-trending; with the paper's response moving stars are too quiet.

        {rest}

        Notes
        -----
        Every value is that of `k2` but these, of ``python studies/paper/calibrate_k2_motion.py``
        (see the page on calibration). The sensitivity along both axes, :math:`(1 + a_2 u^2) / (1 +
        a_2 / 12)`, has the mean 1 over a pixel; :math:`a_2 = -0.5` (-0.8 to -0.45) is fitted, as
        is the normal interpixel scatter of 0.01 (0 to 0.011). These 95 % ranges hold for the
        PSF's wings of 20 %, which are chosen, with widths from Kepler's PRF: 45 % of the light in
        the brightest pixel and 95 % within a diameter of 4.2 px (Kepler telescope page, medians).

        Examples
        --------
        >>> from scope_models import Detector
        >>> Detector.k2_calibrated().interpixel_scatter
        0.01
        """
        return cls.preset("k2_calibrated", cadence, **changes)

    @classmethod
    @documented(rest=_CHANGES)
    def tess(cls, cadence="120 s", **changes):
        """Return a TESS camera.

        Parameters
        ----------
        cadence : {"20 s", "120 s", "200 s", "600 s", "1800 s"}, float or Quantity, optional
            The cadence, by its name or length, in seconds or with a unit.
        {rest}

        Notes
        -----
        The page on noise has the values and more of their sources; TPFs are target pixel files:

        =================================== ========================================================
        pixel_scale, read_noise, well_depth TESS Instrument Handbook
        zero_point                          TESS Instrument Handbook (+- 0.05 mag)
        live_fraction                       TESS Instrument Handbook: the cosmic-ray mitigation
                                            drops two of ten reads, but at 20 s
        int_time, read_time, n_frames       TPFs
        gain                                GAINA to GAIND of TIC 273589987
        background                          FLUX_BKG of TIC 273589987, sector 15
        fixed_offset, mean_black            FXDOFF and MEANBLCA of TIC 273589987
        sensitivity, interpixel_scatter     assumed: the paper's, for Kepler
        psf                                 assumed
        =================================== ========================================================

        Examples
        --------
        >>> from scope_models import Detector
        >>> Detector.tess().n_reads
        48
        """
        return cls.preset("tess", cadence, **changes)

    @classmethod
    def ground(
        cls, aperture=1.0, altitude=2400.0, band="R", *, seeing=1.0, pixel_scale=0.4, airmass=1.0,
        throughput=0.4, **changes,
    ):  # fmt: skip
        r"""Return a CCD on a ground-based telescope, with its atmosphere.

        Parameters
        ----------
        aperture : float or Quantity, optional
            Diameter of the telescope, m.
        altitude : float or Quantity, optional
            Altitude of the observatory, m, for the scintillation.
        band : {"V", "R", "I"}, optional
            The band of the stars' magnitudes.
        seeing : float or Quantity, optional
            Full width at half maximum of the PSF at the zenith, arcsec.
        pixel_scale : float or Quantity, optional
            Size of a pixel, arcsec.
        airmass : float or array_like, optional
            Airmass, one number or one for each cadence: `~scope_models.effects.airmass`.
        throughput : float, optional
            Part of the photons that the detector would count without extinction.
        **changes
            Any field of `Detector`, to replace these values.

        Returns
        -------
        Detector
            The detector.

        Raises
        ------
        TypeError, ValueError
            If a field is misspelled, of the wrong kind or outside its domain.

        Notes
        -----
        The page on noise has the values:

        =================================== ========================================================
        zero_point                          `~scope_models.scene.presets.BANDS` above the atmosphere
                                            (Bessell 1979); the throughput is assumed
        background                          BANDS: Paranal, dark sky (Patat 2003, A&A 400, 1183)
        gain, read_noise, well_depth        assumed: typical of cooled CCDs
        interpixel_scatter                  assumed: what flat fields leave
        psf                                 `~scope_models.models.moffat_psf` of the seeing
        effects                             Extinction of BANDS, Scintillation, Seeing, DarkCurrent
                                            of 0.1 e-/s (assumed): see `scope_models.effects`
        =================================== ========================================================

        `Motion.ground <scope_models.Motion.ground>` is the motion, and moonlight the effect
        `~scope_models.effects.NightSky` of a scene.

        Examples
        --------
        >>> from scope_models import Detector
        >>> Detector.ground(2.0, altitude=2635, band="V").mission
        'Ground'
        """
        given = aperture, altitude, band, seeing, pixel_scale, airmass, throughput
        return cls(**(presets.ground_fields(*given) | changes))

    @classmethod
    def from_tpf(cls, tpf, **changes):
        """Return the detector that recorded a target pixel file.

        It is the preset of the mission with the file's shape, exposure, gain, read noise, black
        level, offset of the raw counts, and median of FLUX_BKG.

        Parameters
        ----------
        tpf : lightkurve.TargetPixelFile, str or path-like
            The file, as for `~scope_models.io.read_pixels`.
        **changes
            Any field of `Detector`, to replace these values. ``mission`` names the preset where
            the file does not.

        Returns
        -------
        Detector
            The detector.

        Raises
        ------
        OSError
            If the file cannot be opened.
        TypeError, ValueError
            If it is no target pixel file, names none of the missions, or a field is misspelled.

        Examples
        --------
        >>> from scope_models import Detector, Motion, Star, simulate
        >>> observation = simulate(Star(12.0), Detector.k2(gain=109.0), Motion.still(9), seed=1)
        >>> Detector.from_tpf(observation.to_tpf()).gain
        109.0
        """
        series = read_pixels(tpf)
        mission = MISSIONS.get(changes.get("mission")) or series.mission
        if mission is None:
            raise ValueError("`tpf` must have MISSION or TELESCOP in its header, or pass `mission`")
        found = _of_cards(series.header, mission) | {"shape": series.flux.shape[1:]}
        if series.flux_bkg is not None and np.isfinite(series.flux_bkg).any():
            found["background"] = float(max(np.nanmedian(series.flux_bkg), 0.0))
        return cls.preset(mission.name, **(found | changes))

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
        return self.n_frames * self.frame_time / 86400

    @property
    def duty_cycle(self):
        """Part of a cadence in which light is gathered (DEADC in headers)."""
        return self.exposure_time / (self.n_frames * self.frame_time)

    @property
    def full_flux(self):
        """Flux from which a pixel may be full, e-/s: see `~scope_models.Mission.full_flux`."""
        if self.well_depth is None:
            return np.inf
        return full_flux(self.well_depth, self.int_time, self.background)

    @property
    def n_reads(self):
        """Number of reads that are summed in a cadence."""
        return max(1, round(self.n_frames * self.live_fraction))

    @property
    def cadence_read_noise(self):
        """Standard deviation of all reads of a cadence together, electrons."""
        return self.read_noise * self.n_reads**0.5

    def flux_from_mag(self, mag):
        """Return the flux of a star before the response of the pixels.

        Parameters
        ----------
        mag : float, array_like or Quantity
            Magnitude in the mission's band (Kp or T).

        Returns
        -------
        float or ndarray
            Flux in e-/s.

        Raises
        ------
        ValueError
            If a magnitude is not finite or too small.

        Examples
        --------
        >>> from scope_models import Detector
        >>> round(Detector.tess().flux_from_mag(10.0))
        14997
        """
        mag = plain_array(mag, u.mag, "mag")
        if not np.all(np.isfinite(mag)):
            raise ValueError(f"`mag` must be finite, got {mag}")
        with np.errstate(over="ignore"):
            flux = self.zero_point * 10.0 ** (-0.4 * (mag - self.zero_point_mag))
        if not np.all(flux < np.finfo(np.float32).max):
            raise ValueError(f"`mag` is too small: {np.max(flux):.3g} e-/s at {np.min(mag)}")
        return float(flux) if flux.ndim == 0 else flux

    def interpixel_map(self, seed):
        """Return the response of each pixel against the others, b of Eq. 2.

        Parameters
        ----------
        seed : int
            The seed of the observation, which draws the map where the detector has none.

        Returns
        -------
        ndarray of shape (ny, nx)
            Not negative, about 1.

        Examples
        --------
        >>> from scope_models import Detector
        >>> Detector.k2().interpixel_map(seed=1).shape
        (11, 11)
        """
        if self.interpixel is not None:
            return self.interpixel.copy()
        generator = stream(seed, "interpixel")
        if self.interpixel_distribution == "uniform":
            deviates = generator.uniform(-1.0, 1.0, self.shape)
        else:
            deviates = generator.standard_normal(self.shape)
        return np.maximum(1.0 + self.interpixel_scatter * deviates, 0.0)

    read, write = classmethod(_storage.read), _storage.write

    def without_sensitivity(self):
        """Return the same detector with pixels that all respond alike, and evenly within.

        Returns
        -------
        Detector
            The control.
        """
        return self.replace(sensitivity=None, interpixel=None, interpixel_scatter=0.0)


def _of_cards(cards, mission):
    """Return the fields of a detector that the cards of a target pixel file have."""
    kinds = {
        "int_time": (float, "INT_TIME"), "read_time": (float, "READTIME"),
        "n_frames": (int, "NUM_FRM"), "reads": (int, "NREADOUT"),
        "gain": (float, mission.gain_keyword), "read_noise": (float, mission.read_noise_keyword),
        "mean_black": (int, mission.black_keyword), "fixed_offset": (int, *mission.offset_keywords),
    }  # fmt: skip
    found = {}
    for name, (kind, *keywords) in kinds.items():
        value = next(filter(None, map(cards.get, keywords)), None)
        if isinstance(value, int | float) and not isinstance(value, bool) and value > 0:
            found[name] = kind(value)
    reads = found.pop("reads", None)
    if reads and "n_frames" in found:
        found["live_fraction"] = min(reads / found["n_frames"], 1.0)
    return found
