"""Figures of pixels: maps, stamps, tracks and animations."""

import astropy.units as u
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.animation import FuncAnimation
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm
from matplotlib.patheffects import Normal, Stroke

from scope_models._arrays import plain_number
from scope_models.plotting import _style
from scope_models.plotting._style import FLUX, LIGHT, styled

__all__ = [
    "animate_pixels", "plot_detector", "plot_motion", "plot_pixels", "plot_psf", "plot_scene",
    "plot_sensitivity",
]  # fmt: skip


@styled(image=None)
def plot_pixels(image, aperture=None, *, log=False, title="Pixel image", ax=None):
    """Draw a pixel image, with the outline of an aperture.

    Parameters
    ----------
    image : array_like
        Flux per pixel ``(ny, nx)`` in e-/s.
    {mask}
    log : bool, optional
        Scale the colors logarithmically, over at most four decades.
    {title}
    {draw}

    Examples
    --------
    >>> from scope_models.plotting import plot_pixels
    >>> plot_pixels([[1, 2], [3, 4]], [[False, True], [True, True]]).get_xlabel()
    'Column (pixel)'
    """
    norm = None
    if log:
        top = np.nanmax(image)
        norm = LogNorm(vmin=max(np.nanmin(image), 1e-4 * top), vmax=top, clip=True)
    ax = _draw_image(image, 1, FLUX, title, ax, norm=norm)
    draw_outline(ax, aperture)
    return ax


@styled(sensitivity=None)
def plot_sensitivity(sensitivity, oversample=1, *, title="Sensitivity", ax=None):
    """Draw the sensitivity of the detector at sub-pixel resolution.

    Parameters
    ----------
    sensitivity : array_like
        Relative response ``(ny * oversample, nx * oversample)``.
    oversample : int, optional
        Samples per pixel along each axis.
    {title}
    {draw}

    Examples
    --------
    >>> import numpy as np
    >>> from scope_models.plotting import plot_sensitivity
    >>> plot_sensitivity(np.ones((20, 30)), oversample=10).get_xlim()
    (np.float64(-0.5), np.float64(2.5))
    """
    return _draw_image(sensitivity, oversample, "Relative sensitivity", title, ax, cmap="gray")


@styled(psf=None)
def plot_psf(psf, oversample=1, *, title="PSF on the detector", ax=None):
    """Draw the light that falls on the detector at sub-pixel resolution.

    Parameters
    ----------
    psf : array_like
        Density ``(ny * oversample, nx * oversample)`` in e-/s per square pixel.
    oversample : int, optional
        Samples per pixel along each axis.
    {title}
    {draw}

    Examples
    --------
    >>> import numpy as np
    >>> from scope_models.plotting import plot_psf
    >>> plot_psf(np.ones((20, 30)), oversample=10).get_title()
    'PSF on the detector'
    """
    label = "Flux density (e$^-$ s$^{-1}$ pixel$^{-2}$)"
    return _draw_image(psf, oversample, label, title, ax)


@styled
def plot_detector(sensitivity, psf, image, oversample=1, *, aperture=None, axes=None):
    """Draw sensitivity, PSF and pixel image side by side, as the paper's figure 3.

    Parameters
    ----------
    sensitivity, psf, image : array_like
        Relative response and flux density in e-/s per square pixel, ``(ny * oversample,
        nx * oversample)``, and the pixels ``(ny, nx)`` in e-/s.
    oversample : int, optional
        Samples per pixel of the first two along each axis.
    {mask}
    {draw_three}

    Examples
    --------
    >>> import numpy as np
    >>> from scope_models.plotting import plot_detector
    >>> fine = np.ones((20, 30))
    >>> len(plot_detector(fine, fine, np.eye(2, 3), oversample=10))
    3
    """
    if axes is None:
        _, axes = plt.subplots(1, 3, figsize=(13, 3.8), layout="constrained")
    plot_sensitivity(sensitivity, oversample, title="(a) Sensitivity", ax=axes[0])
    plot_psf(psf, oversample, title="(b) PSF on the detector", ax=axes[1])
    plot_pixels(image, aperture, title="(c) Pixel image", ax=axes[2])
    return np.asarray(axes)


@styled(time=u.day, x=u.pix, y=u.pix)
def plot_motion(time, x, y, shape=None, *, time_label="Time (d)", title="Motion", ax=None):
    """Draw the track of a star over the pixel grid, colored by time.

    Parameters
    ----------
    time, x, y : array_like
        Times in days and positions in pixels ``(n_cadences,)``.
    shape : tuple of int, optional
        Shape ``(ny, nx)`` of the stamp, to draw all of it, instead of the pixels at the track.
    time_label, title : str, optional
        Label of the color bar and title of the Axes.
    {draw}

    Examples
    --------
    >>> from scope_models.plotting import plot_motion
    >>> plot_motion([0, 1, 2], [2, 2.3, 2.1], [3, 3.1, 3], shape=(6, 5)).get_ylim()
    (np.float64(-0.5), np.float64(5.5))
    """
    ax = _style.given_or_new(ax, 5, 4.2)
    _draw_track(ax, time, x, y, time_label)
    ax.plot(x[0], y[0], "kx", ms=7, mew=1.5, zorder=4, label="first cadence")
    _style.legend_above(ax)
    if shape is None:
        _draw_surroundings(ax, x, y)
    else:
        _pixel_axes(ax, shape)
    ax.set_title(title, loc="left")
    return ax


@styled(time=u.day, x=u.pix, y=u.pix, places=u.pix, magnitudes=None)
def plot_scene(time, x, y, shape, places, magnitudes, *, time_label="Time (d)", ax=None):
    """Draw the stars of a stamp, larger if they are brighter, with the track of the target.

    Parameters
    ----------
    time, x, y : array_like
        Times in days and positions of the target in pixels ``(n_cadences,)``.
    shape : tuple of int
        Shape ``(ny, nx)`` of the stamp.
    places : array_like
        Columns and rows ``(n_stars, 2)`` of the stars in pixels, the target first.
    magnitudes : array_like
        Magnitudes ``(n_stars,)``, written beside the stars; of crowded ones beside the brightest.
    {time_label}
    {draw}

    Examples
    --------
    >>> from scope_models.plotting import plot_scene
    >>> plot_scene([0, 1], [2, 2.5], [3, 3], (6, 6), [(2, 3)], [12.0]).get_xlim()
    (np.float64(-0.5), np.float64(5.5))
    """
    ax = _style.given_or_new(ax, 5.4, 4.2)
    _pixel_axes(ax, shape)
    size = 100 * np.clip(10 ** (-0.2 * (magnitudes - magnitudes[0])), 0.15, 2.5)  # square points
    if len(places) > 1:
        disk = {"color": "k", "alpha": 0.7, "lw": 0, "zorder": 3}
        ax.scatter(*places[1:].T, size[1:], label="other stars", **disk)
    if np.ptp(x) or np.ptp(y):
        _draw_track(ax, time, x, y, time_label)
    ring = {"facecolor": "none", "edgecolor": LIGHT, "lw": 2, "zorder": 5}
    ax.scatter(*places[0], size[0], label="target", **ring)
    _style.legend_above(ax, ncols=2)
    ax.set_title("Scene", loc="left")
    order = [0, *(1 + np.argsort(magnitudes[1:]))]
    texts = [f"{magnitudes[i]:.4g}" for i in order]
    ax.figure.draw_without_rendering()  # where the Axes is
    _style.label_places(ax, places[order], texts, np.sqrt(size[order]) / 2)
    return ax


def _draw_track(ax, time, x, y, time_label):
    points = np.column_stack([x, y])
    lines = np.stack([points[:-1], points[1:]], axis=1)
    track = LineCollection(lines, cmap="viridis", lw=0.6, alpha=0.5)
    track.set_array(time[:-1])
    ax.add_collection(track)
    dots = ax.scatter(x, y, c=time, s=8, cmap="viridis", zorder=3)
    if np.ptp(x) or np.ptp(y):  # a star at rest is one dot
        ax.figure.colorbar(dots, ax=ax, label=time_label, shrink=0.85)


def _draw_surroundings(ax, x, y):
    """Limit the axes to the track, and draw the edges of the pixels that it crosses."""
    half = max(0.6 * max(np.ptp(x), np.ptp(y)), 0.15)
    middles = [(values.min() + values.max()) / 2 for values in (x, y)]
    limits = [(middle - half, middle + half) for middle in middles]
    for draw, along, across in ((ax.vlines, *limits), (ax.hlines, *limits[::-1])):
        edges = np.arange(np.ceil(along[0] + 0.5), along[1] + 0.5) - 0.5
        draw(edges, *across, color="0.5", lw=0.9, zorder=0)
    ax.set(xlim=limits[0], ylim=limits[1], xlabel="Column (pixel)", ylabel="Row (pixel)")
    ax.set_aspect("equal")


@styled(cube=None, time=u.day)
def animate_pixels(cube, time=None, aperture=None, *, interval=50, time_label="Time (d)", ax=None):
    """Animate a stamp, cadence by cadence.

    Parameters
    ----------
    cube : array_like
        Flux per pixel ``(n_cadences, ny, nx)`` in e-/s.
    time : array_like, optional
        Times ``(n_cadences,)`` in days, written into the title.
    {mask}
    interval : float, optional
        Milliseconds per frame.
    {time_label}
    {ax}

    Returns
    -------
    `~matplotlib.animation.FuncAnimation`
        The animation; keep it, and show it or ``.save()`` it.

    Examples
    --------
    >>> import numpy as np
    >>> from scope_models.plotting import animate_pixels
    >>> html = animate_pixels(np.ones((3, 4, 5))).to_jshtml()
    """
    if cube.ndim != 3:
        raise ValueError(f"`cube` must have shape (n_cadences, ny, nx), got {cube.shape}")
    ax = plot_pixels(cube[0], aperture, title="", ax=ax)
    picture = ax.images[0]
    picture.set_clim(np.nanmin(cube), np.nanmax(cube))

    def draw(frame):
        picture.set_data(cube[frame])
        name = f"cadence {frame + 1}" if time is None else f"{time_label}: {time[frame]:.4f}"
        return picture, ax.set_title(name)

    interval = plain_number(interval, u.ms, "interval")
    return FuncAnimation(ax.figure, draw, frames=len(cube), interval=interval)


def _draw_image(image, oversample, label, title, ax, **kwargs):
    if image.ndim != 2:
        raise ValueError(f"an image must have two dimensions, got shape {image.shape}")
    ax = _style.given_or_new(ax, 5, 4.2)
    ny, nx = (size / oversample for size in image.shape)
    extent = (-0.5, nx - 0.5, -0.5, ny - 0.5)
    _style.show_image(ax, image, title, label, extent=extent, interpolation="nearest", **kwargs)
    _pixel_axes(ax, (ny, nx))
    return ax


def _pixel_axes(ax, shape):
    """Label the axes in whole pixels and draw the pixels' edges."""
    y_limits, x_limits = ((-0.5, n - 0.5) for n in shape)
    ax.set(xlim=x_limits, ylim=y_limits, xlabel="Column (pixel)", ylabel="Row (pixel)")
    ax.set_aspect("equal")
    for axis, n in zip((ax.yaxis, ax.xaxis), shape, strict=True):
        centers = np.arange(np.floor(n + 0.5))
        axis.set_ticks(centers[:: 1 + len(centers) // 12])
        axis.set_ticks(np.arange(-0.5, n), minor=True)
        axis.set_tick_params(which="minor", length=0)
    ax.grid(which="minor", color="0.6", lw=0.5)


def draw_outline(ax, aperture):
    """Draw the edges between pixels inside and outside, white on black; nothing of None."""
    if aperture is None:
        return
    padded = np.pad(np.asarray(aperture, dtype=bool), 1)
    below, left = padded[1:] != padded[:-1], padded[:, 1:] != padded[:, :-1]
    lines = [[(x - 1.5, y - 0.5), (x - 0.5, y - 0.5)] for y, x in np.argwhere(below)]
    lines += [[(x - 0.5, y - 1.5), (x - 0.5, y - 0.5)] for y, x in np.argwhere(left)]
    edges = LineCollection(lines, colors="w", lw=2, zorder=3, capstyle="round", clip_on=False)
    edges.set_path_effects([Stroke(linewidth=4.5, foreground="k"), Normal()])
    edges.set_label("aperture")
    ax.add_collection(edges, autolim=False)
