"""The style that all figures share."""

from functools import wraps

import matplotlib.pyplot as plt

__all__ = ["DARK", "GRAY", "LIGHT", "STYLE", "styled"]

STYLE = "scope_models.plotting.scope_models"
# Far apart in lightness too, so that figures can be read in black and white.
DARK, LIGHT, GRAY = "#08306b", "#f08a24", "0.65"


def styled(function):
    """Return a plotting function that draws in the style of the package."""

    @wraps(function)
    def draw(*args, **kwargs):
        with plt.style.context(STYLE):
            return function(*args, **kwargs)

    return draw
