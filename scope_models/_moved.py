"""Old module paths, which keep working with a deprecation warning."""

import importlib
import warnings

from astropy.utils.exceptions import AstropyDeprecationWarning

__all__ = ["moved"]


def moved(old, *new):
    """Return the module-level ``__getattr__`` of a module whose names have moved.

    Parameters
    ----------
    old : str
        The old module.
    *new : str
        The modules that hold its names now.

    Returns
    -------
    callable
        Returns an attribute of the first new module that has it, with an
        `~astropy.utils.exceptions.AstropyDeprecationWarning`.
    """

    def __getattr__(name):  # noqa: N807
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

    return __getattr__
