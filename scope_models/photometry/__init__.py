"""Aperture masks, the fractions of light they hold, and the noise of light curves (CDPP)."""

from scope_models.photometry.apertures import (
    aperture_flux,
    circular_aperture,
    contamination_aperture,
    crowding,
    flux_fraction,
    moving_aperture,
    signal_to_noise_aperture,
    threshold_aperture,
)
from scope_models.photometry.precision import cdpp

__all__ = [
    "aperture_flux", "cdpp", "circular_aperture", "contamination_aperture", "crowding",
    "flux_fraction", "moving_aperture", "signal_to_noise_aperture", "threshold_aperture",
]  # fmt: skip
