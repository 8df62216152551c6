"""Effects of sky, telescope and detector on light and charge, besides noise and saturation."""

from scope_models.effects.base import Effect
from scope_models.effects.charge import (
    BrighterFatter,
    ChargeTransferInefficiency,
    CosmicRays,
    DarkCurrent,
    RollingBands,
    Smear,
    Undershoot,
    mission_effects,
)
from scope_models.effects.light import (
    Focus,
    Gaps,
    Jitter,
    PixelShares,
    SensitivityDropouts,
    Throughput,
)
from scope_models.effects.sky import (
    Argabrightening,
    Background,
    Extinction,
    NightSky,
    ScatteredLight,
    Scintillation,
    Seeing,
    airmass,
    moon_geometry,
)

__all__ = [
    "Argabrightening", "Background", "BrighterFatter", "ChargeTransferInefficiency", "CosmicRays",
    "DarkCurrent", "Effect", "Extinction", "Focus", "Gaps", "Jitter", "NightSky", "PixelShares",
    "RollingBands", "ScatteredLight", "Scintillation", "Seeing", "SensitivityDropouts", "Smear",
    "Throughput", "Undershoot", "airmass", "mission_effects", "moon_geometry",
]  # fmt: skip
