"""Models of light, of the response of pixels, of their integrals, and of stars' variability."""

from scope_models.models.integration import integrate_pixels
from scope_models.models.prf import PRF
from scope_models.models.psf import (
    BivariateGaussianPSF,
    DiffusionSensitivity,
    GaussHermitePSF,
    SensitivityPolynomial,
    moffat_psf,
)
from scope_models.models.signals import (
    TransitModel,
    sinusoidal_signal,
    stochastic_signal,
    tabulated_signal,
)
from scope_models.models.tables import CorrectedPRF, PRFGrid, TabulatedPRF, TabulatedPSF

__all__ = [
    "PRF", "BivariateGaussianPSF", "CorrectedPRF", "DiffusionSensitivity", "GaussHermitePSF",
    "PRFGrid", "SensitivityPolynomial", "TabulatedPRF", "TabulatedPSF", "TransitModel",
    "integrate_pixels", "moffat_psf", "sinusoidal_signal", "stochastic_signal", "tabulated_signal",
]  # fmt: skip
