"""Old module paths, which keep working with a deprecation warning."""

import importlib
import warnings

from astropy.utils.exceptions import AstropyDeprecationWarning

__all__ = ["moved", "renamed"]


def moved(old, *new):
    """Return the module-level ``__getattr__`` of a module whose names have moved to others."""

    def attribute(name):
        if not name.startswith("__"):
            for path in new:
                module = importlib.import_module(path)
                if hasattr(module, name):
                    warnings.warn(
                        f"{old}.{name} has moved to {path}.{name}",
                        AstropyDeprecationWarning,
                        stacklevel=2,
                    )
                    return getattr(module, name)
        raise AttributeError(f"module {old!r} has no attribute {name!r}")

    return attribute


def renamed(module, **names):
    """Return the module-level ``__getattr__`` of a module some of whose names are new."""

    def attribute(name):
        if name not in names:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        warnings.warn(
            f"{module}.{name} is now {module}.{names[name]}",
            AstropyDeprecationWarning,
            stacklevel=2,
        )
        return getattr(importlib.import_module(module), names[name])

    return attribute
