"""Presets: the numbers of known detectors, by name."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from scope_models._checks import checked_choice, checked_number
from scope_models._docstrings import documented
from scope_models._values import Value
from scope_models.effects import DarkCurrent, Extinction, Scintillation, Seeing
from scope_models.missions import MISSIONS, Cadence, choose_cadence
from scope_models.models import BivariateGaussianPSF, SensitivityPolynomial, moffat_psf

__all__ = ["BANDS", "PRESETS", "Preset", "ground_fields", "register_preset"]


@dataclass(frozen=True, eq=False)
class Preset(Value):
    """The fields of a detector.

    Parameters
    ----------
    fields : mapping
        Fields of `~scope_models.Detector` and their values.
    cadences : tuple of Cadence, optional
        The cadences to choose from; the first is the usual one. Empty if there is only that of
        the fields.

    Examples
    --------
    >>> from scope_models.scene.presets import PRESETS
    >>> PRESETS["tess"].fields["read_noise"]
    10.0
    """

    fields: Mapping
    cadences: tuple[Cadence, ...] = ()

    def with_cadence(self, choice=None):
        """Return the fields for one of the cadences.

        Parameters
        ----------
        choice : str, float or Quantity, optional
            The cadence's name or its length, in seconds or with a unit; by default the usual one.

        Returns
        -------
        dict
            The fields.

        Raises
        ------
        ValueError
            If there is no such cadence.

        Examples
        --------
        >>> from scope_models.scene.presets import PRESETS
        >>> PRESETS["k2"].with_cadence("short")["n_frames"]
        9
        """
        if choice is None and not self.cadences:
            return dict(self.fields)
        frame_time = self.fields["int_time"] + self.fields.get("read_time", 0.0)
        cadence = choose_cadence(self.cadences, frame_time, choice)
        return dict(self.fields) | {
            "n_frames": cadence.n_frames,
            "live_fraction": cadence.live_fraction,
            "fixed_offset": cadence.fixed_offset,
        }


_REGISTERED, _OWN = {}, []
#: The presets by name; read-only, `register_preset` adds to it.
PRESETS = MappingProxyType(_REGISTERED)


def register_preset(name, *, cadences=(), **fields):
    """Add a preset, or replace one that was added.

    `Detector.preset <scope_models.Detector.preset>`, `~scope_models.read_detector` and
    ``scope-models simulate --detector`` find it by its name.

    Parameters
    ----------
    name : str
        Its name, in lower case.
    cadences : iterable of Cadence, optional
        The cadences to choose from; by default those of the mission, or that of the fields.
    **fields
        Fields of `~scope_models.Detector`. A ``mission`` of `~scope_models.missions.MISSIONS` has
        its own pixel scale, exposure of a frame, well depth and zero point, where none are given.

    Returns
    -------
    Preset
        The preset.

    Raises
    ------
    ValueError
        If the name is one of the package's own, or not in lower case.

    Examples
    --------
    >>> from scope_models import Detector
    >>> from scope_models.scene import register_preset
    >>> _ = register_preset(
    ...     "survey", mission="survey", shape=(11, 11), zero_point=2e4, zero_point_mag=10.0,
    ...     int_time=4.0, n_frames=15, pixel_scale=20.0, read_noise=8.0)
    >>> Detector.preset("survey", read_noise=6.0).exposure_time
    60.0
    """
    if not isinstance(name, str) or not name or name != name.lower():
        raise ValueError(f"`name` must be text in lower case, got {name!r}")
    mission = MISSIONS.get(fields.get("mission"))
    if mission is not None:
        cadences = tuple(cadences) or mission.cadences
        fields = mission.detector_fields() | fields
    if name in _OWN:
        raise ValueError(f"`name` must not be one of {', '.join(_OWN)}, got {name!r}")
    preset = _REGISTERED[name] = Preset(MappingProxyType(fields), tuple(cadences))
    return preset


_A_2 = -0.75  # of the response fitted to the noise of K2
_MEAN = 1 + _A_2 / 12
_FITTED = (1 / _MEAN, 0.0, _A_2 / _MEAN)
# The sources of all numbers are in the docstrings of Detector.kepler, k2, k2_calibrated and tess.
_KEPLER = {
    "mission": "Kepler",
    "shape": (11, 11),
    "gain": 110.0,
    "read_noise": 90.0,
    "background": 166.0,
    "mean_black": 720,
    "sensitivity": SensitivityPolynomial(),
    "interpixel_scatter": 0.01,
    "psf": BivariateGaussianPSF(),
}
_K2 = _KEPLER | {"mission": "K2", "background": 284.0}
register_preset("kepler", **_KEPLER)
register_preset("k2", **_K2)
register_preset(
    "k2_calibrated",
    **_K2
    | {
        "sensitivity": SensitivityPolynomial(_FITTED, _FITTED),
        "interpixel_scatter": 0.011,
        "interpixel_distribution": "normal",
        "psf": BivariateGaussianPSF(0.8, sigma_x=0.45, sigma_y=0.45)
        + BivariateGaussianPSF(0.2, sigma_x=1.261, sigma_y=1.261),
    },
)
register_preset(
    "tess",
    mission="TESS",
    shape=(11, 11),
    gain=5.25,
    read_noise=10.0,
    background=134.0,
    mean_black=6812,
    sensitivity=SensitivityPolynomial(),
    interpixel_scatter=0.01,
    psf=BivariateGaussianPSF(0.45, sigma_x=0.55, sigma_y=0.55)
    + BivariateGaussianPSF(0.55, sigma_x=1.25, sigma_y=1.25),
)


@dataclass(frozen=True)
class Band(Value):
    """A photometric band, as seen from the ground.

    Parameters
    ----------
    flux : float
        Flux of a star of magnitude 0 above the atmosphere, Jy.
    width : float
        Width over wavelength.
    sky : float
        Brightness of the dark sky at the zenith, mag per square arcsecond.
    extinction : float
        Extinction, mag per airmass.

    Examples
    --------
    >>> from scope_models.scene.presets import BANDS
    >>> BANDS["R"].extinction
    0.07
    """

    flux: float
    width: float
    sky: float
    extinction: float


#: Bands by name. Fluxes and widths: Bessell (1979); sky and extinction: Paranal (Patat 2003).
BANDS = MappingProxyType(
    {
        "V": Band(3640.0, 0.16, 21.6, 0.11),
        "R": Band(3080.0, 0.23, 20.9, 0.07),
        "I": Band(2550.0, 0.19, 19.7, 0.05),
    }
)
_PHOTONS = 1.51e7  # per s, m2 and relative width of the band, of 1 Jy


def ground_fields(
    aperture=1.0, altitude=2400.0, band="R", *, seeing=1.0, pixel_scale=0.4, airmass=1.0,
    throughput=0.4,
):  # fmt: skip
    """Return the fields of a detector on a ground-based telescope.

    Parameters
    ----------
    aperture, altitude, band, seeing, pixel_scale, airmass, throughput : optional
        As for `Detector.ground <scope_models.Detector.ground>`.

    Returns
    -------
    dict
        The fields.

    Raises
    ------
    ValueError
        If the band is unknown or a number outside its domain.

    Examples
    --------
    >>> from scope_models.scene.presets import ground_fields
    >>> print(f"{ground_fields(1.0)['zero_point']:.3g}")
    3.36e+09
    """
    found = BANDS[checked_choice("band", band, BANDS)]
    aperture = checked_number("aperture", aperture, "m", positive=True)
    seeing = checked_number("seeing", seeing, "arcsec", positive=True)
    pixel_scale = checked_number("pixel_scale", pixel_scale, "arcsec", positive=True)
    throughput = checked_number("throughput", throughput, positive=True)
    photons = _PHOTONS * found.flux * found.width * np.pi / 4 * aperture**2
    return {
        "mission": "Ground",
        "shape": (21, 21),
        "pixel_scale": pixel_scale,
        "zero_point": throughput * photons,
        "zero_point_mag": 0.0,
        "int_time": 60.0,
        "read_time": 10.0,
        "gain": 1.0,
        "read_noise": 7.0,
        "background": throughput * photons * 10 ** (-0.4 * found.sky) * pixel_scale**2,
        "well_depth": 1e5,
        "interpixel_scatter": 0.002,
        "interpixel_distribution": "normal",
        "psf": moffat_psf(seeing / pixel_scale),
        "effects": (
            Extinction(found.extinction, airmass),
            Scintillation(aperture, altitude, airmass),
            Seeing(airmass=airmass),
            DarkCurrent(0.1),
        ),
    }


register_preset("ground", **ground_fields())
_OWN.extend(_REGISTERED)
# Parts of the docstrings of the presets.
_CHANGES = """**changes
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
    If a field is misspelled."""
_KEPLER = f"""cadence : {{"long", "short"}}, float or Quantity, optional
    270 frames in 29.4 min, or 9 frames in 58.8 s; or the length, in seconds or with a unit.
{_CHANGES}"""


@documented(rest=_KEPLER)
def kepler(cls, cadence="long", **changes):
    """Return the Kepler photometer.

    Parameters
    ----------
    {rest}

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
    return cls.preset("kepler", cadence, **changes)


@documented(rest=_KEPLER)
def k2(cls, cadence="long", **changes):
    """Return the Kepler photometer in the K2 mission.

    Parameters
    ----------
    {rest}

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
    return cls.preset("k2", cadence, **changes)


@documented(rest=_KEPLER)
def k2_calibrated(cls, cadence="long", **changes):
    r"""Return the K2 photometer with a response that gives K2's noise.

    With the paper's response stars that move as in K2 are too quiet. Here the response within
    pixels, that between them and the wings of the PSF are fitted to the noise of K2
    campaign 3 before de-trending.

    Parameters
    ----------
    {rest}

    Notes
    -----
    Every value is that of `k2` but these. The study is on the page on calibration; the fit is
    ``python studies/calibrate_k2_motion.py``. Of the values that fit alike, these also give
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
    >>> edge, center = detector.sensitivity(0.5, 0.0), detector.sensitivity(0.0, 0.0)
    >>> print(f"{edge / center:.4f}")
    0.8125
    """
    return cls.preset("k2_calibrated", cadence, **changes)


@documented(rest=_CHANGES)
def tess(cls, cadence="120 s", **changes):
    """Return a TESS camera.

    Parameters
    ----------
    cadence : {"20 s", "120 s", "200 s", "600 s", "1800 s"}, float or Quantity, optional
        The cadence's name; or its length, in seconds or with a unit.
    {rest}

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
    return cls.preset("tess", cadence, **changes)


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
        Altitude of the observatory, m, which matters to the scintillation.
    band : {"V", "R", "I"}, optional
        The band, in which the stars' magnitudes are.
    seeing : float or Quantity, optional
        Full width at half maximum of the PSF at the zenith, arcsec.
    pixel_scale : float or Quantity, optional
        Size of a pixel, arcsec.
    airmass : float or array_like, optional
        Airmass, one number or one for each cadence: `~scope_models.effects.airmass`.
    throughput : float, optional
        Part of the photons above the atmosphere that the detector would count without
        extinction.
    **changes
        Any field of `Detector`, to replace these values.

    Returns
    -------
    Detector
        The detector. `Motion.ground <scope_models.Motion.ground>` is its motion, and its
        files have the layout of TESS, which lightkurve opens.

    Raises
    ------
    ValueError
        If the band is unknown or a number outside its domain.
    TypeError
        If a field is misspelled.

    Notes
    -----
    ======================= ==================== ==========================================
    field                   value                source
    ======================= ==================== ==========================================
    shape                   (21, 21) px          our choice
    zero_point              above the atmosphere 3640, 3080, 2550 Jy of width 0.16, 0.23,
                                                 0.19 in V, R, I (Bessell 1979); 1.51e7
                                                 photons / (s m2 Jy); the throughput, 0.4,
                                                 is assumed
    background              21.6, 20.9, 19.7 mag V, R, I, dark sky at the zenith of Paranal
                            per arcsec2          (Patat 2003, A&A 400, 1183)
    int_time, read_time     60 s, 10 s           our choice
    gain, read_noise,       1 e-/DN, 7 e-,       assumed: typical of cooled CCDs
    well_depth              1e5 e-
    interpixel_scatter      0.002, normal        assumed: what flat fields leave
    psf                     Moffat of the seeing :math:`\beta = 4.765` (Trujillo et al. 2001):
                                                 `~scope_models.models.moffat_psf`
    effects                 Extinction           0.11, 0.07, 0.05 mag per airmass in V, R, I
                                                 (Patat 2003)
    \                       Scintillation        Osborn et al. (2015)
    \                       Seeing               width with the airmass to the power of 0.6;
                                                 changes of 15 percent are assumed
    \                       DarkCurrent          0.1 e-/s, assumed
    ======================= ==================== ==========================================

    Moonlight is the effect `~scope_models.effects.NightSky` of a scene.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> detector = Detector.ground(2.0, altitude=2635, band="V", seeing=0.8)
    >>> observation = simulate(Star(16.0), detector, Motion.ground(20), seed=1)
    >>> type(observation.to_tpf()).__name__
    'TessTargetPixelFile'
    """
    own = ground_fields(
        aperture, altitude, band, seeing=seeing, pixel_scale=pixel_scale, airmass=airmass,
        throughput=throughput,
    )  # fmt: skip
    return cls(**(own | changes))
