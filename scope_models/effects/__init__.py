"""Effects of sky, telescope and detector on light and charge, besides noise and saturation."""

from scope_models.effects.atmosphere import (
    Extinction,
    Scintillation,
    Seeing,
    airmass,
    moon_geometry,
)
from scope_models.effects.background import Argabrightening, Background, NightSky, ScatteredLight
from scope_models.effects.base import Effect
from scope_models.effects.blurring import Focus, Jitter
from scope_models.effects.charge import (
    BrighterFatter,
    ChargeTransferInefficiency,
    DarkCurrent,
    RollingBands,
    Smear,
    Undershoot,
)
from scope_models.effects.cosmic_rays import CosmicRays
from scope_models.effects.presets import mission_effects
from scope_models.effects.response import Gaps, SensitivityDropouts, Throughput
from scope_models.effects.shares import PixelShares

__all__ = [
    "Argabrightening", "Background", "BrighterFatter", "ChargeTransferInefficiency", "CosmicRays",
    "DarkCurrent", "Effect", "Extinction", "Focus", "Gaps", "Jitter", "NightSky", "PixelShares",
    "RollingBands", "ScatteredLight", "Scintillation", "Seeing", "SensitivityDropouts", "Smear",
    "Throughput", "Undershoot", "airmass", "mission_effects", "moon_geometry",
]  # fmt: skip
