"""Figures: what they draw and say, and, with one version of matplotlib, every pixel."""

from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib import colors
from matplotlib import pyplot as plt
from matplotlib.testing.compare import compare_images
from numpy.testing import assert_allclose, assert_array_equal

from scope_models.plotting import (
    animate_pixels,
    plot_detector,
    plot_fit,
    plot_fold,
    plot_light_curve,
    plot_motion,
    plot_pixels,
    plot_psf,
    plot_scene,
    plot_sensitivity,
    plot_summary,
)

BASELINE = Path(__file__).parent / "baseline"
BASELINE_VERSION = "3.11.2"


@pytest.fixture(autouse=True)
def _default_style():
    """Draw in matplotlib's default style and leave no figure open."""
    with mpl.style.context("default"):
        yield
    plt.close("all")


class Scene:
    """Arrays that look like a simulation: a star on nine by eight pixels that rolls."""

    def __init__(self):
        rng = np.random.default_rng(1)
        self.oversample, (ny, nx) = 10, (9, 8)
        y, x = (np.mgrid[: ny * 10, : nx * 10] + 0.5) / 10 - 0.5
        u, v = x - np.round(x), y - np.round(y)
        gain = np.kron(1 + rng.uniform(-0.01, 0.01, (ny, nx)), np.ones((10, 10)))
        self.sensitivity = (1 - 0.05 * u**2) * (1 - 0.05 * v**2) * gain
        r2 = (x - 3.6) ** 2 + (y - 4.2) ** 2
        self.psf = 1.74e5 * np.exp(-r2 / 2 / 0.5**2) / (2 * np.pi * 0.5**2)
        self.image = (self.psf * self.sensitivity).reshape(ny, 10, nx, 10).mean(axis=(1, 3))
        self.aperture = self.image > 500
        n = 600
        self.time = 1980 + np.arange(n) * 0.0204336
        roll = ((np.arange(n) % 12) / 12 - 0.5) * 0.8
        self.x, self.y = 3.6 + roll + 0.1 * np.sin(self.time / 8), 4.2 + 0.4 * roll
        self.model = 1 - 0.003 * (np.abs((self.time - 1985 + 2) % 4 - 2) < 0.15)
        self.corrected = 1.7e5 * (self.model + rng.normal(0, 1e-4, n))
        self.flux = self.corrected * (1 + 0.01 * roll**2)


@pytest.fixture(scope="module")
def scene():
    return Scene()


def _summary(scene, **options):
    return plot_summary(
        scene.time,
        scene.image,
        scene.flux,
        scene.x,
        scene.y,
        aperture=scene.aperture,
        cdpp=201.26,
        time_label="Time (BKJD)",
        title="Star",
        **options,
    )


STARS = [(3.6, 4.2), (6.0, 1.5), (6.2, 1.7), (1.0, 7.0)]

FIGURES = {
    "pixels": lambda s: plot_pixels(s.image, s.aperture, log=True),
    "detector": lambda s: plot_detector(
        s.sensitivity, s.psf, s.image, s.oversample, aperture=s.aperture
    )[0],
    "motion": lambda s: plot_motion(s.time, s.x, s.y, s.image.shape),
    "scene": lambda s: plot_scene(
        s.time, s.x, s.y, s.image.shape, STARS, [12.0, 13.0, 15.0, 16.5], time_label="Time (BKJD)"
    ),
    "light_curve": lambda s: plot_light_curve(
        s.time, s.flux, s.corrected, cdpp=201.26, corrected_cdpp=20.3
    ),
    "fold": lambda s: plot_fold(s.time, s.corrected / 1.7e5, 4, 1985, model=s.model, window=10),
    "summary": lambda s: _summary(s, corrected=s.corrected, corrected_cdpp=20.3, model=s.model)[
        "image"
    ],
}


@pytest.mark.skipif(
    mpl.__version__ != BASELINE_VERSION,
    reason=f"the baseline images are those of matplotlib {BASELINE_VERSION}; "
    "other versions place text differently",
)
@pytest.mark.parametrize("name", FIGURES)
def test_images(name, scene, tmp_path):
    """Compare with tests/plotting/baseline; after an intended change copy the named image."""
    made = tmp_path / f"{name}.png"
    FIGURES[name](scene).figure.savefig(made, dpi=50, metadata={"Software": None})
    message = compare_images(str(BASELINE / f"{name}.png"), str(made), tol=2)
    assert message is None, message


@pytest.mark.parametrize("name", FIGURES)
def test_every_axes_is_labeled_with_units(name, scene):
    figure = FIGURES[name](scene).figure
    for ax in figure.axes:
        labels = [ax.get_ylabel()]
        if ax.get_label() != "<colorbar>":
            labels.append(ax.get_xlabel())
        assert all(labels)
        assert all("(" in text or "elative" in text for text in labels), labels


def _lightness(color):
    return np.dot(colors.to_rgb(color), [0.299, 0.587, 0.114])


@pytest.mark.parametrize("name", FIGURES)
def test_black_and_white(name, scene):
    """Color maps grow in lightness; series differ in lightness."""
    for ax in FIGURES[name](scene).figure.axes:
        for mapped in [*ax.images, *ax.collections]:
            if mapped.get_array() is not None:
                ramp = [_lightness(c) for c in mapped.cmap(np.linspace(0, 1, 50))]
                assert (np.diff(ramp) > 0).all()
        series = sorted(_lightness(line.get_color()) for line in ax.lines)
        assert np.all(np.diff(series) > 0.1)


def test_pixels_are_drawn_where_they_are(scene):
    ax = plot_pixels(scene.image)
    (picture,) = ax.images
    assert_array_equal(picture.get_array(), scene.image)
    assert picture.origin == "lower"
    assert_allclose(picture.get_extent(), [-0.5, 7.5, -0.5, 8.5])
    assert_allclose([*ax.get_xlim(), *ax.get_ylim()], [-0.5, 7.5, -0.5, 8.5])
    assert not ax.collections  # no outline without an aperture


def test_aperture_outline_is_the_border_of_the_mask():
    """Each edge between inside and outside, once: an L of three pixels has eight."""
    mask = np.array([[True, False, False], [True, True, False]])
    (outline,) = plot_pixels(np.ones((2, 3)), mask).collections
    edges = {tuple(map(tuple, segment)) for segment in outline.get_segments()}
    expected = {
        ((-0.5, -0.5), (0.5, -0.5)),
        ((0.5, 0.5), (1.5, 0.5)),
        ((-0.5, 1.5), (0.5, 1.5)),
        ((0.5, 1.5), (1.5, 1.5)),
        ((-0.5, -0.5), (-0.5, 0.5)),
        ((-0.5, 0.5), (-0.5, 1.5)),
        ((0.5, -0.5), (0.5, 0.5)),
        ((1.5, 0.5), (1.5, 1.5)),
    }
    assert edges == expected


@pytest.mark.parametrize("plot", [plot_sensitivity, plot_psf])
def test_maps_at_subpixel_resolution(plot, scene):
    ax = plot(scene.sensitivity, scene.oversample)
    assert_array_equal(ax.images[0].get_array(), scene.sensitivity)
    assert_allclose(ax.images[0].get_extent(), [-0.5, 7.5, -0.5, 8.5])


def test_detector_is_figure_3(scene):
    _, axes = plt.subplots(1, 3)
    result = plot_detector(scene.sensitivity, scene.psf, scene.image, scene.oversample, axes=axes)
    assert_array_equal(result, axes)
    for ax, data in zip(axes, (scene.sensitivity, scene.psf, scene.image), strict=True):
        assert_array_equal(ax.images[0].get_array(), data)


def test_motion_track(scene):
    ax = plot_motion(scene.time, scene.x, scene.y, time_label="Time (BKJD)")
    lines, dots, *edges = ax.collections
    assert_allclose(dots.get_offsets(), np.column_stack([scene.x, scene.y]))
    assert_array_equal(dots.get_array(), scene.time)
    assert len(lines.get_segments()) == len(scene.time) - 1
    # The axes hold the whole track, with the edges of its pixels and equal scales.
    half = 0.6 * max(np.ptp(scene.x), np.ptp(scene.y))
    middle = (scene.x.min() + scene.x.max()) / 2
    assert_allclose(ax.get_xlim(), [middle - half, middle + half])
    columns = {float(points[0, 0]) for points in edges[0].get_segments()}
    assert columns == {value for value in (2.5, 3.5, 4.5) if abs(value - middle) < half}
    assert ax.figure.axes[1].get_ylabel() == "Time (BKJD)"


def test_light_curve_is_relative_and_says_the_cdpp(scene):
    ax = plot_light_curve(scene.time, scene.flux, scene.corrected, cdpp=201.26, corrected_cdpp=20.3)
    raw, corrected = ax.lines
    assert_allclose(raw.get_ydata(), scene.flux / np.median(scene.flux))
    assert_allclose(np.median(corrected.get_ydata()), 1)
    texts = [text.get_text() for text in ax.get_legend().get_texts()]
    assert texts == ["raw, CDPP 201.3 ppm (lightkurve)", "corrected, CDPP 20.3 ppm (lightkurve)"]


def test_scene_shows_brightness_and_labels_apart(scene):
    ax = FIGURES["scene"](scene)
    ax.figure.draw_without_rendering()
    boxes = [text.get_window_extent() for text in ax.texts]
    assert [text.get_text() for text in ax.texts] == ["12", "13", "15", "16.5"]
    assert not any(a.overlaps(b) for i, a in enumerate(boxes) for b in boxes[:i])
    others = next(c for c in ax.collections if c.get_label() == "other stars")
    assert (np.diff(others.get_sizes()) < 0).all()
    assert len(ax.figure.axes) == 2
    still = plot_scene(scene.time, 0 * scene.x + 3.6, 0 * scene.y + 4.2, (9, 8), STARS[:1], [12.0])
    assert len(still.figure.axes) == 1  # nothing for a color bar


def test_values_beyond_the_scale_are_arrows(scene):
    flux = np.array(scene.flux)
    flux[[100, 300]] *= 1.5, 0.5
    axes = plot_fit(
        scene.image, scene.image, 0 * scene.image, scene.x, scene.y, chi2=1 + scene.image,
        time=scene.time, flux=flux, time_label="Time (BKJD)",
    )  # fmt: skip
    ax = axes["light curve"]
    arrows = {line.get_marker(): line.get_xydata() for line in ax.lines[1:]}
    assert_allclose(arrows["^"], [[scene.time[100], ax.get_ylim()[1]]])
    assert_allclose(arrows["v"], [[scene.time[300], ax.get_ylim()[0]]])
    assert ax.get_xlabel() == "Time (BKJD)"


def test_fold_means(scene):
    """The bins' means, against a loop over cadences."""
    flux = scene.corrected / 1.7e5
    ax = plot_fold(scene.time, flux, 4.0, 1985, window=6, n_bins=12)
    bins = {}
    for time, value in zip(scene.time, flux, strict=True):
        phase = (time - 1985) % 4
        hours = 24 * (phase - 4 if phase > 2 else phase)
        if abs(hours) <= 6:
            bins.setdefault(int(np.floor(hours)), []).append(value)
    binned = ax.lines[1]
    assert_allclose(binned.get_xdata(), np.array(sorted(bins)) + 0.5)
    assert_allclose(binned.get_ydata(), [np.mean(bins[key]) for key in sorted(bins)])


def test_animation(scene, tmp_path):
    rng = np.random.default_rng(0)
    cube = scene.image + rng.normal(0, 50, (2, *scene.image.shape))
    animation = animate_pixels(cube, scene.time[:2], scene.aperture)
    path = tmp_path / "stamp.gif"
    animation.save(path, writer="pillow", dpi=40)
    assert path.read_bytes().startswith(b"GIF8")
    ax = plt.gcf().axes[0]
    assert_array_equal(ax.images[0].get_array(), cube[-1])
    assert_allclose(ax.images[0].get_clim(), [cube.min(), cube.max()])
    assert ax.get_title() == f"Time (d): {scene.time[1]:.4f}"


def test_summary_without_and_with_correction(scene):
    assert set(_summary(scene)) == {"image", "motion", "light curve"}
    axes = _summary(scene, corrected=scene.corrected, model=scene.model)
    assert set(axes) == {"image", "motion", "light curve", "corrected"}
    assert_array_equal(axes["corrected"].lines[1].get_ydata(), scene.model)
    assert axes["image"].figure.get_suptitle() == "Star"


def test_everything_draws_into_given_axes(scene):
    _, ax = plt.subplots()
    assert plot_pixels(scene.image, ax=ax) is ax
    assert plot_motion(scene.time, scene.x, scene.y, ax=ax) is ax
    assert plot_light_curve(scene.time, scene.flux, ax=ax) is ax
    assert plot_fold(scene.time, scene.flux, 4, 1985, ax=ax) is ax
    assert len(plt.get_fignums()) == 1


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda s: plot_pixels(s.flux), "an image must have two dimensions"),
        (lambda s: plot_psf(s.flux), "an image must have two dimensions"),
        (lambda s: animate_pixels(s.image), r"`cube` must have shape \(n_cadences, ny, nx\)"),
        (lambda s: plot_fold(s.time, s.flux, 0, 1985), "`period` must be positive, got 0"),
        (lambda s: plot_fold(s.time, s.flux, 400, 1800, window=1), "holds no cadence"),
    ],
)
def test_bad_input(call, message, scene):
    with pytest.raises(ValueError, match=message):
        call(scene)
