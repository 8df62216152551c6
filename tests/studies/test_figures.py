"""Figures of the experiments: they show what they were given."""

import matplotlib as mpl
import numpy as np
import pytest
from _figures import plot_cdpp, plot_cdpp_panels, plot_map
from astropy.table import Table
from matplotlib import pyplot as plt
from numpy.testing import assert_allclose

MAG = np.array([12.0, 13.0, 14.0])
KEPLER = {
    "mag": MAG,
    "median": [25.6, 34.3, 52.5],
    "low": [17.2, 26.8, 43.1],
    "high": [60.0, 70.0, 90.0],
    "label": "Kepler, median",
    "band_label": "Kepler, 10 % to 90 %",
}
SERIES = {
    "1x": (MAG, [17, 28, 46], [15, 27, 44], [19, 30, 50]),
    "10x": (MAG, [40, 50, 70]),
}


@pytest.fixture(autouse=True)
def _default_style():
    with mpl.style.context("default"):
        yield
    plt.close("all")


def panels_of(*arguments, **options):
    """Return the Axes by their titles."""
    return {ax.get_title(): ax for ax in plot_cdpp_panels(*arguments, **options).axes}


def legend(ax):
    return [text.get_text() for text in ax.get_legend().get_texts()]


def test_cdpp_shows_series_reference_and_limits():
    ax = plot_cdpp(SERIES, KEPLER, limits=[(13.0, 200.0, "2x: 200 ppm")], title="PLD")
    assert sorted(legend(ax)) == ["10x", "1x", "Kepler, 10 % to 90 %", "Kepler, median"]
    assert ax.get_yscale() == "log"
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("Magnitude (Kp)", "6.5-h CDPP (ppm)")
    one, ten = (container.lines[0] for container in ax.containers)
    assert_allclose(one.get_ydata(), SERIES["1x"][1])
    assert_allclose(ten.get_xdata(), MAG)
    # Bars from 15 to 19 ppm at the first star; none where none were given.
    (bars,) = ax.containers[0].lines[2]
    assert_allclose(bars.get_segments()[0], [[12, 15], [12, 19]])
    assert ax.containers[1].lines[2] == ()
    limit = [line for line in ax.lines if line.get_linestyle() == ":"]
    assert_allclose(limit[0].get_xydata(), [[12, 200], [13, 200]])
    assert [note.get_text() for note in ax.texts] == ["2x: 200 ppm"]


def test_series_differ_in_lightness_and_marker():
    many = {f"{k}x": (MAG, k * MAG) for k in range(1, 6)}
    lines = [container.lines[0] for container in plot_cdpp(many).containers]
    lightness = [mpl.colors.to_rgb(line.get_color()) @ np.array([0.3, 0.6, 0.1]) for line in lines]
    assert np.all(np.diff(lightness) < -0.05)
    assert len({line.get_marker() for line in lines}) == 5


def test_a_star_outside_of_its_own_bars_has_none_on_that_side():
    ax = plot_cdpp({"1x": ([12.0], [20.0], [21.0], [25.0])})
    (bars,) = ax.containers[0].lines[2]
    assert_allclose(bars.get_segments()[0], [[12, 20], [12, 25]])


def test_panels_share_their_scale():
    axes = panels_of({"PLD": SERIES, "SFF": {"1x": (MAG, [500, 600, 700])}}, KEPLER)
    assert list(axes) == ["PLD", "SFF"]
    assert axes["PLD"].get_ylim() == axes["SFF"].get_ylim()
    assert axes["PLD"].get_ylim()[1] > 700
    below = [text.get_text() for text in axes["PLD"].figure.legends[0].get_texts()]
    assert sorted(below) == ["10x", "1x", "Kepler, 10 % to 90 %", "Kepler, median"]
    assert axes["PLD"].get_legend() is axes["SFF"].get_legend() is None


def test_residuals_are_the_last_panel():
    panels = dict.fromkeys(("PLD", "SFF", "other"), SERIES)
    axes = panels_of(panels, KEPLER, residuals={"1x": (MAG, [1.0, 0.9, 0.8])})
    ax = axes["Residual over noise"]
    assert list(axes) == [*panels, "Residual over noise"]
    assert len(ax.figure.axes) == 4
    assert_allclose(ax.containers[0].lines[0].get_ydata(), [1.0, 0.9, 0.8])
    assert (ax.get_yscale(), ax.get_ylim()[0]) == ("linear", 0)
    # Each label is explained once.
    below = [text.get_text() for text in ax.figure.legends[0].get_texts()]
    assert sorted(below) == ["10x", "1x", "Kepler, 10 % to 90 %", "Kepler, median"]
    assert ax.get_legend() is None


def test_the_lowest_panels_have_the_labels_of_the_magnitudes():
    axes = panels_of(dict.fromkeys(("PLD", "SFF", "other"), SERIES))
    # Three panels in two columns: the second column ends above an empty place.
    assert len(axes["PLD"].figure.axes) == 3
    shown = {title: ax.xaxis.label.get_visible() for title, ax in axes.items()}
    assert shown == {"PLD": False, "SFF": True, "other": True}
    for title, ax in axes.items():
        ticks = ax.xaxis.get_tick_params()["labelbottom"]
        assert ticks is shown[title]


def test_map_shows_numbers_and_leaves_empty_cells():
    rows = [(100, 13, 1.0), (50, 12, 0.0), (50, 13, 0.25), (200, 12, np.nan)]
    ax = plot_map(
        Table(rows=rows, names=("depth", "mag", "found")), "found", ("depth", "Depth (ppm)"),
        ("mag", "Kp"), label="Completeness", norm=plt.Normalize(0, 1),
    )  # fmt: skip
    assert [text.get_text() for text in ax.texts] == ["0.00", "0.25", "1.00"]
    assert [text.get_position() for text in ax.texts] == [(0, 0), (1, 0), (1, 1)]
    assert [tick.get_text() for tick in ax.get_yticklabels()] == ["50", "100", "200"]
    # Text is white on dark cells and black on light ones.
    assert [text.get_color() for text in ax.texts] == ["w", "w", "k"]
