"""Warnings of the package."""

from astropy.utils.exceptions import AstropyUserWarning

__all__ = [
    "CatalogWarning", "DamagedFileWarning", "DamagedResultWarning", "DetrendingWarning",
    "FailedStarsWarning", "FitWarning", "IntegrationWarning", "LostLightWarning",
    "ScopeModelsWarning",
]  # fmt: skip


class ScopeModelsWarning(AstropyUserWarning):
    """Base of all warnings of this package."""


class CatalogWarning(ScopeModelsWarning):
    """Stars of a catalog are left out."""


class LostLightWarning(ScopeModelsWarning):
    """Light or charge of a star is lost off the stamp."""


class DetrendingWarning(ScopeModelsWarning):
    """Data are left out or replaced before a light curve is de-trended."""


class IntegrationWarning(ScopeModelsWarning):
    """An integral over a pixel has not converged."""


class FitWarning(ScopeModelsWarning):
    """A fit has left data out, has not converged, or does not determine a parameter."""


class DamagedFileWarning(ScopeModelsWarning):
    """A checksum in a file does not match its contents."""


class DamagedResultWarning(ScopeModelsWarning):
    """Part of the results of an earlier run cannot be read, and is computed again."""


class FailedStarsWarning(ScopeModelsWarning):
    """Some stars of a sweep have failed."""
