"""Presets: the numbers of known detectors, by name."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from scope_models._checks import checked_choice, checked_number
from scope_models._values import Value
from scope_models.effects import DarkCurrent, Extinction, Scintillation, Seeing
from scope_models.missions import MISSIONS, Cadence
from scope_models.models import BivariateGaussianPSF, SensitivityPolynomial, moffat_psf

__all__ = ["BANDS", "PRESETS", "Preset", "register_preset"]


@dataclass(frozen=True, eq=False)
class Preset(Value):
    """The fields of a detector.

    Parameters
    ----------
    fields : mapping
        Fields of `~scope_models.Detector` and their values.
    cadences : tuple of Cadence, optional
        The cadences to choose from, the usual one first; empty if there is only that of the fields.

    Examples
    --------
    >>> from scope_models.scene.presets import PRESETS
    >>> PRESETS["tess"].fields["read_noise"]
    10.0
    """

    fields: Mapping
    cadences: tuple[Cadence, ...] = ()


_OF_MISSION = ("pixel_scale", "zero_point_mag", "int_time", "read_time", "well_depth")
_REGISTERED, _OWN = {}, []
#: The presets by name; read-only, `register_preset` adds to it.
PRESETS = MappingProxyType(_REGISTERED)


def register_preset(name, *, cadences=(), **fields):
    """Add a preset, or replace one that was added.

    `Detector.preset <scope_models.Detector.preset>`, TOML files and the command line find it by
    its name.

    Parameters
    ----------
    name : str
        Its name, in lower case.
    cadences : iterable of Cadence, optional
        The cadences to choose from; by default those of the mission, or that of the fields.
    **fields
        Fields of `~scope_models.Detector`. Of a ``mission`` of `~scope_models.missions.MISSIONS`,
        pixel scale, exposure of a frame, well depth and zero point are the defaults.

    Returns
    -------
    Preset
        The preset.

    Raises
    ------
    ValueError
        If the name is the package's own, or not in lower case.

    Examples
    --------
    >>> from scope_models.scene import Detector, register_preset
    >>> _ = register_preset("survey", mission="K2", shape=(9, 9), read_noise=80.0)
    >>> Detector.preset("survey").read_noise
    80.0
    """
    if not isinstance(name, str) or not name or name != name.lower():
        raise ValueError(f"`name` must be text in lower case, got {name!r}")
    mission = MISSIONS.get(fields.get("mission"))
    if mission is not None:
        cadences = tuple(cadences) or mission.cadences
        own = {name: getattr(mission, name) for name in _OF_MISSION}
        fields = own | {"zero_point": mission.zero_points[0][1]} | fields
    if name in _OWN:
        raise ValueError(f"`name` must not be one of {', '.join(_OWN)}, got {name!r}")
    preset = _REGISTERED[name] = Preset(MappingProxyType(fields), tuple(cadences))
    return preset


_A_2 = -0.5  # of the response fitted to the noise of K2
_MEAN = 1 + _A_2 / 12
_FITTED = (1 / _MEAN, 0.0, _A_2 / _MEAN)
# The sources of all numbers are in the docstrings of Detector.kepler, k2, k2_calibrated and tess.
_KEPLER = {
    "mission": "Kepler", "shape": (11, 11), "gain": 110.0, "read_noise": 90.0, "background": 166.0,
    "mean_black": 720, "sensitivity": SensitivityPolynomial(), "interpixel_scatter": 0.01,
    "psf": BivariateGaussianPSF(),
}  # fmt: skip
_K2 = _KEPLER | {"mission": "K2", "background": 284.0}
register_preset("kepler", **_KEPLER)
register_preset("k2", **_K2)
_CALIBRATED = _K2 | {
    "sensitivity": SensitivityPolynomial(_FITTED, _FITTED),
    "interpixel_scatter": 0.01, "interpixel_distribution": "normal",
    "psf": BivariateGaussianPSF(0.8, sigma_x=0.45, sigma_y=0.45)
    + BivariateGaussianPSF(0.2, sigma_x=1.261, sigma_y=1.261),
}  # fmt: skip
register_preset("k2_calibrated", **_CALIBRATED)
register_preset(
    "tess", mission="TESS", shape=(11, 11), gain=5.25, read_noise=10.0, background=134.0,
    mean_black=6812, sensitivity=SensitivityPolynomial(), interpixel_scatter=0.01,
    psf=BivariateGaussianPSF(0.45, sigma_x=0.55, sigma_y=0.55)
    + BivariateGaussianPSF(0.55, sigma_x=1.25, sigma_y=1.25),
)  # fmt: skip


@dataclass(frozen=True)
class Band(Value):
    """A photometric band, as seen from the ground."""

    flux: float  # of a star of magnitude 0 above the atmosphere, Jy
    width: float  # over wavelength
    sky: float  # brightness of the dark sky at the zenith, mag per square arcsecond
    extinction: float  # mag per airmass


#: Bands by name. Fluxes and widths: Bessell (1979); sky and extinction: Paranal (Patat 2003).
BANDS = MappingProxyType({
    "V": Band(3640.0, 0.16, 21.6, 0.11), "R": Band(3080.0, 0.23, 20.9, 0.07),
    "I": Band(2550.0, 0.19, 19.7, 0.05),
})  # fmt: skip
_PHOTONS = 1.51e7  # per s, m2 and relative width of the band, of 1 Jy


def ground_fields(aperture, altitude, band, seeing, pixel_scale, airmass, throughput):
    """Return the fields of a detector on a ground-based telescope; see `Detector.ground`."""
    found = BANDS[checked_choice("band", band, BANDS)]
    aperture = checked_number("aperture", aperture, "m", positive=True)
    seeing = checked_number("seeing", seeing, "arcsec", positive=True)
    pixel_scale = checked_number("pixel_scale", pixel_scale, "arcsec", positive=True)
    throughput = checked_number("throughput", throughput, positive=True)
    photons = _PHOTONS * found.flux * found.width * np.pi / 4 * aperture**2
    return {
        "mission": "Ground", "shape": (21, 21), "pixel_scale": pixel_scale,
        "zero_point": throughput * photons, "zero_point_mag": 0.0,
        "int_time": 60.0, "read_time": 10.0, "gain": 1.0, "read_noise": 7.0,
        "background": throughput * photons * 10 ** (-0.4 * found.sky) * pixel_scale**2,
        "well_depth": 1e5, "interpixel_scatter": 0.002, "interpixel_distribution": "normal",
        "psf": moffat_psf(seeing / pixel_scale),
        "effects": (
            Extinction(found.extinction, airmass), Scintillation(aperture, altitude, airmass),
            Seeing(airmass=airmass), DarkCurrent(0.1),
        ),
    }  # fmt: skip


register_preset("ground", **ground_fields(1.0, 2400.0, "R", 1.0, 0.4, 1.0, 0.4))
_OWN.extend(_REGISTERED)
