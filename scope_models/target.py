"""Moved to scope_models.appendix_a; this path still works, with a warning."""

from scope_models._moved import moved

__all__ = []

__getattr__ = moved(__name__, "scope_models.appendix_a")
