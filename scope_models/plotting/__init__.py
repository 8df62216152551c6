"""Figures: arrays in, `~matplotlib.axes.Axes` out.

Images are in e-/s with axes in pixels (0-based, an integer is a pixel's center), times in days.
Figures share one style sheet, ``scope_models.plotting.scope_models``, which
``matplotlib.style.use`` takes, too. They can be read in black and white: color maps grow in
lightness, series differ in it.
"""

from scope_models.plotting.images import (
    animate_pixels,
    plot_detector,
    plot_motion,
    plot_pixels,
    plot_psf,
    plot_scene,
    plot_sensitivity,
)
from scope_models.plotting.stars import (
    plot_fit,
    plot_fold,
    plot_light_curve,
    plot_summary,
    plot_twin,
)

__all__ = [
    "animate_pixels", "plot_detector", "plot_fit", "plot_fold", "plot_light_curve", "plot_motion",
    "plot_pixels", "plot_psf", "plot_scene", "plot_sensitivity", "plot_summary", "plot_twin",
]  # fmt: skip
