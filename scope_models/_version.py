"""The version of the package, written in this one place."""

__all__ = ["__version__"]

__version__ = "0.2.dev0"
