"""What sky, telescope and detector do to light and charge, besides noise and saturation."""

from scope_models.effects._effect import Conditions, Drawn, Effect, Exposures
from scope_models.effects.background import Argabrightening, Background, ScatteredLight
from scope_models.effects.focus import Focus

__all__ = [
    "Argabrightening",
    "Background",
    "Conditions",
    "Drawn",
    "Effect",
    "Exposures",
    "Focus",
    "ScatteredLight",
]
