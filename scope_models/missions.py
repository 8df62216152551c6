"""The missions: every number and name that a mission fixes, once.

The docstrings of `Detector.kepler <scope_models.Detector.kepler>` and `Detector.tess
<scope_models.Detector.tess>` have the sources of numbers without one.
"""

import math
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from scope_models._arrays import TIME_ZEROS, plain_number
from scope_models._values import Value

__all__ = ["MISSIONS", "TIME_ZEROS", "Cadence", "Mission", "QualityBits"]


@dataclass(frozen=True)
class Cadence(Value):
    """A kind of cadence that a mission records.

    Parameters
    ----------
    name : str
        Its name, as "long" or "120 s".
    n_frames : int
        Frames per cadence.
    fixed_offset : int, optional
        Number added to each pixel of the raw counts, DN.
    live_fraction : float, optional
        Part of the frames that is summed.

    Examples
    --------
    >>> from scope_models.missions import MISSIONS
    >>> MISSIONS["Kepler"].cadence("short").n_frames
    9
    """

    name: str
    n_frames: int
    fixed_offset: int = 0
    live_fraction: float = 1.0


@dataclass(frozen=True, kw_only=True)
class QualityBits(Value):
    """Bits of the QUALITY column, by meaning; 0 where a mission has no such bit.

    Parameters
    ----------
    attitude_tweak, safe_mode, coarse_point, earth_point, no_fine_point : int
        State of the spacecraft.
    desaturation : int
        Momentum dump.
    thruster_firing, possible_thruster_firing : int
        Firings of K2's thrusters.
    argabrightening : int
        Diffuse flash of light.
    scattered_light : int
        Light of Earth or Moon.
    cosmic_ray, collateral_cosmic_ray : int
        Cosmic rays in the optimal aperture, and in the collateral data.
    sensitivity_dropout : int
        Loss of a pixel's sensitivity.
    rolling_band, detector_anomaly, impulsive_outlier : int
        Artifacts of the electronics, and outliers.
    manual_exclude : int
        Left out by hand, or here without a position or time.
    no_data : int
        No data, and no time.
    rejected : int
        The bits that lightkurve rejects by default.

    Examples
    --------
    >>> from scope_models.missions import MISSIONS
    >>> MISSIONS["K2"].quality.thruster_firing
    1048576
    """

    attitude_tweak: int = 1
    safe_mode: int = 2
    coarse_point: int = 4
    earth_point: int = 8
    no_fine_point: int = 0
    desaturation: int = 32
    thruster_firing: int = 0
    possible_thruster_firing: int = 0
    argabrightening: int
    scattered_light: int = 0
    cosmic_ray: int
    collateral_cosmic_ray: int
    sensitivity_dropout: int = 0
    rolling_band: int = 0
    detector_anomaly: int = 0
    impulsive_outlier: int
    manual_exclude: int
    no_data: int = 0
    rejected: int


@dataclass(frozen=True, kw_only=True, repr=False)
class Mission(Value):
    """Facts that are the same for all stars of a mission.

    Parameters
    ----------
    name : str
        Name, as in `~scope_models.missions.MISSIONS`, the card MISSION and detectors.
    telescope, instrument : str
        The cards TELESCOP and INSTRUME.
    template : str
        The mission whose headers its files have, in lower case.
    band : str
        Name of the band in which magnitudes are given.
    time_format : {"bkjd", "btjd"}
        Format of times in lightkurve.
    time_unit : str
        Unit of the column TIME in archive files.
    start : float
        Time of the first cadence of a generated motion, days since `time_zero`.
    pixel_scale : float
        Size of a pixel on the sky, arcsec.
    zero_points : tuple of (str, float)
        Names and values of the flux of a star of ``zero_point_mag``, e-/s; the usual one first.
    zero_point_mag : float
        Their magnitude.
    int_time, read_time : float
        Exposure of a frame, and the time per frame in which none is recorded, s.
    cadences : tuple of Cadence
        The cadences, the usual one first.
    well_depth : float
        Electrons that a pixel holds in a frame, the median over the detectors.
    quality : QualityBits
        Bits of the quality flags.
    quality_column : str
        Name of the quality flags in light-curve files.
    id_keyword, magnitude_keyword, gain_keyword, read_noise_keyword, black_keyword : str
        Cards of the target's number and magnitude, and of the detector's gain, read noise and
        black level.
    offset_keywords : tuple of str
        Cards of the offset of the raw counts.
    run : {"quarter", "campaign", "sector"}
        What an observing run is called.
    places : tuple of str
        What determines the place on the focal plane.
    absent_columns : tuple of str
        Columns that its target pixel files lack.
    displays : tuple of str
        Display formats of 64-bit floats, 32-bit floats and flags.
    field_center : tuple of float
        Right ascension and declination of the middle of a field, deg.
    tpf_class : str
        The class of its target pixel files in lightkurve.

    Examples
    --------
    >>> from scope_models.missions import MISSIONS
    >>> MISSIONS["K2"]
    <Mission K2: BJD - 2454833, cadences long, short>
    """

    name: str
    telescope: str
    instrument: str
    template: str
    band: str
    time_format: str
    time_unit: str
    start: float
    pixel_scale: float
    zero_points: tuple[tuple[str, float], ...]
    zero_point_mag: float
    int_time: float
    read_time: float
    cadences: tuple[Cadence, ...]
    well_depth: float
    quality: QualityBits
    quality_column: str
    id_keyword: str
    magnitude_keyword: str
    gain_keyword: str
    read_noise_keyword: str
    black_keyword: str
    offset_keywords: tuple[str, ...]
    run: str
    places: tuple[str, ...]
    absent_columns: tuple[str, ...]
    displays: tuple[str, str, str]
    field_center: tuple[float, float]
    tpf_class: str

    def __repr__(self):
        names = ", ".join(item.name for item in self.cadences)
        return f"<Mission {self.name}: BJD - {self.time_zero:.0f}, cadences {names}>"

    @classmethod
    def from_header(cls, cards):
        """Return the mission of an archive file.

        Parameters
        ----------
        cards : mapping
            Cards of the headers: MISSION, else TELESCOP with CAMPAIGN for K2, decide.

        Returns
        -------
        Mission or None
            The mission, None if the cards name none.
        """
        known = {name.lower(): mission for name, mission in MISSIONS.items()}
        names = (str(cards.get(keyword)).strip().lower() for keyword in ("MISSION", "TELESCOP"))
        mission, telescope = map(known.get, names)
        campaign = cards.get("CAMPAIGN")
        is_campaign = isinstance(campaign, int | np.integer) and not isinstance(campaign, bool)
        if mission is None and telescope is MISSIONS["Kepler"] and is_campaign:
            return MISSIONS["K2"]
        return mission or telescope

    @property
    def time_zero(self):
        """Barycentric Julian date (TDB) from which its days are counted."""
        return TIME_ZEROS[self.time_format]

    @property
    def frame_time(self):
        """Length of a frame, s."""
        return self.int_time + self.read_time

    @property
    def full_flux(self):
        """Flux from which a pixel may be full, e-/s, its background included."""
        return full_flux(self.well_depth, self.int_time)

    def cadence(self, choice=None):
        """Return one of the mission's cadences.

        Parameters
        ----------
        choice : str, float or Quantity, optional
            The cadence's name or its length within 3 %, in seconds or with a unit; None is the
            mission's usual cadence.

        Returns
        -------
        Cadence
            The cadence.

        Raises
        ------
        ValueError
            If the mission has no such cadence.

        Examples
        --------
        >>> from scope_models.missions import MISSIONS
        >>> MISSIONS["Kepler"].cadence(1800.0).name
        'long'
        """
        return choose_cadence(self.cadences, self.frame_time, choice)

    def cadence_days(self, choice=None):
        """Return the length of a cadence.

        Parameters
        ----------
        choice : str, float or Quantity, optional
            As for `cadence`.

        Returns
        -------
        float
            The length in days.

        Raises
        ------
        ValueError
            If the mission has no such cadence.
        """
        return self.cadence(choice).n_frames * self.frame_time / 86400


def full_flux(well_depth, int_time, background=0.0):
    """Return the flux, e-/s, from which a pixel of an archive file may be full.

    The shallowest of Kepler's 84 channels are full at 0.877 of the median (0.947e6 of 1.08e6
    electrons, KSCI-19033, table 13). For other missions that is an assumption.
    """
    return 0.877 * well_depth / int_time - background


def choose_cadence(cadences, frame_time, choice=None):
    """Return the cadence of a name or of a length, s, within 3 %; None is the first one."""
    if choice is None and cadences:
        return cadences[0]
    is_name = isinstance(choice, str)
    wanted = choice if is_name else plain_number(choice, "s", "cadence")
    frame_time = plain_number(frame_time, "s", "frame_time")
    for item in cadences:
        length = item.n_frames * frame_time
        # A Kepler long cadence is called 30 minutes.
        is_close = not is_name and math.isclose(wanted, length, rel_tol=0.03)
        if is_close or wanted == item.name:
            return item
    known = ", ".join(f"{item.name!r} ({item.n_frames * frame_time:.6g} s)" for item in cadences)
    raise ValueError(f"`cadence` must be one of {known or 'none'}, got {choice!r}")


# Kepler Archive Manual (KDMC-10008), table of the QUALITY flags; K2 Handbook for the thrusters.
_KEPLER_BITS = QualityBits(
    argabrightening=64, cosmic_ray=128, manual_exclude=256, sensitivity_dropout=1024,
    impulsive_outlier=2048, collateral_cosmic_ray=8192, detector_anomaly=16384, no_fine_point=32768,
    no_data=65536, rolling_band=131072, possible_thruster_firing=524288, thruster_firing=1048576,
    rejected=1130799,
)  # fmt: skip
# TESS Science Data Products Description Document (EXP-TESS-ARC-ICD-0014), table of the flags.
_TESS_BITS = QualityBits(
    argabrightening=16, cosmic_ray=64, manual_exclude=128, impulsive_outlier=512,
    collateral_cosmic_ray=1024, scattered_light=4096, rejected=17087,
)  # fmt: skip
_KEPLER = Mission(
    name="Kepler", telescope="Kepler", instrument="Kepler Photometer", template="kepler", band="Kp",
    time_format="bkjd", time_unit="BJD - 2454833",
    start=131.5,  # about the beginning of quarter 1
    pixel_scale=3.98, zero_points=(("optimal aperture", 1.74e5), ("focal plane", 2.141e5)),
    zero_point_mag=12.0, int_time=6.019802903270, read_time=0.518948526144,
    cadences=(Cadence("long", 270, 419400), Cadence("short", 9, 219400)), well_depth=1.08e6,
    quality=_KEPLER_BITS, quality_column="SAP_QUALITY", id_keyword="KEPLERID",
    magnitude_keyword="KEPMAG", gain_keyword="GAIN", read_noise_keyword="READNOIS",
    black_keyword="MEANBLCK", offset_keywords=("LCFXDOFF", "SCFXDOFF"), run="quarter",
    places=("channel", "module", "output"), absent_columns=("RB_LEVEL",),
    # The archive's B16.16 of the flags is too narrow for bit 65536, which stands for no data.
    displays=("D12.7", "E13.6", "B24.24"), field_center=(290.6667, 44.5),
    tpf_class="KeplerTargetPixelFile",
)  # fmt: skip
_K2 = replace(
    _KEPLER, name="K2", template="k2", run="campaign", absent_columns=(),
    start=2144.1028,  # first time of campaign 3 (ktwo206103150-c03_llc.fits)
    displays=("D14.7", "E14.7", "B24.24"), field_center=(336.6667, -11.0967),
)  # fmt: skip
_TESS = Mission(
    name="TESS", telescope="TESS", instrument="TESS Photometer", template="tess", band="T",
    time_format="btjd", time_unit="BJD - 2457000, days",
    start=1325.3,  # about the beginning of sector 1
    pixel_scale=21.0, zero_points=(("handbook", 1.0),), zero_point_mag=20.44,  # +- 0.05 mag
    int_time=1.98, read_time=0.02,
    cadences=(
        Cadence("120 s", 60, 209700, 0.8), Cadence("20 s", 10, 209700),
        Cadence("200 s", 100, 209700, 0.8), Cadence("600 s", 300, 209700, 0.8),
        Cadence("1800 s", 900, 209700, 0.8),
    ),
    well_depth=2e5, quality=_TESS_BITS, quality_column="QUALITY", id_keyword="TICID",
    magnitude_keyword="TESSMAG", gain_keyword="GAINA", read_noise_keyword="READNOIA",
    black_keyword="MEANBLCA", offset_keywords=("FXDOFF",), run="sector", places=("camera", "ccd"),
    absent_columns=("COSMIC_RAYS", "RB_LEVEL"), displays=("D14.7", "E14.7", "B16.16"),
    field_center=(270.0, 66.5607),  # the north ecliptic pole
    tpf_class="TessTargetPixelFile",
)  # fmt: skip
# Telescopes on the ground: lightkurve opens no files but those that say Kepler or TESS. The zero
# point is that of `Detector.ground` with its defaults.
_GROUND = replace(
    _TESS, name="Ground", instrument="ground-based telescope", band="R", pixel_scale=0.4,
    zero_points=(("1 m", 3.36e9),), zero_point_mag=0.0, int_time=60.0, read_time=10.0,
    cadences=(Cadence("60 s", 1),), well_depth=1e5,
)  # fmt: skip
#: The missions by name; read-only.
MISSIONS = MappingProxyType({item.name: item for item in (_KEPLER, _K2, _TESS, _GROUND)})
