"""The command line, ``scope-models``."""

from scope_models.cli._main import main

__all__ = ["main"]
