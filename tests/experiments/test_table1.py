"""Table 1 of the paper."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
from scope_models.experiments.table1 import PAPER_PIXELS, Table1

from scope_models import Motion
from scope_models.experiments import run_experiment, run_sweep


def summary_of(study):
    return study.summarize(run_sweep(study, progress=False).table)


def test_generator_agrees_with_the_paper():
    summary = summary_of(Table1())
    assert summary["scale"].tolist() == [1.0, 2.0, 5.0, 10.0]
    for name in PAPER_PIXELS:
        np.testing.assert_allclose(summary[f"ratio_{name}"], 1, atol=0.05)
    assert summary["paper_maximum"].tolist() == pytest.approx([0.59, 1.18, 2.95, 5.9])


def test_the_papers_star(shared_data):
    # of the 1000 cadences that the paper has, the file has 500: FACTS say 0.177, 0.124, 0.579, 0.81
    path = str(shared_data / "poscorr" / "epic205998445_c03_poscorr.fits")
    study = Table1(motions=(path,), scales=(1.0, 10.0))
    assert study.input_files() == [path]
    row = summary_of(study)[0]
    found = [row[name] for name in ("mean", "std", "maximum", "extent")]
    assert found == pytest.approx([0.177, 0.124, 0.579, 0.81], abs=0.005)
    for name in PAPER_PIXELS:
        assert row[f"ratio_{name}"] == pytest.approx(1, abs=0.05)


def test_any_motion(tmp_path):
    from astropy.table import Table

    time = np.linspace(0, 1, 50)
    x, y = np.cos(time), np.full(50, 0.1)
    Table({"TIME": time, "POS_CORR1": x, "POS_CORR2": y}).write(tmp_path / "motion.fits")
    table = run_sweep(
        Table1(motions=(str(tmp_path / "motion.fits"), "still")), progress=False
    ).table
    expected = (5 * Motion.from_arrays(time, x, y)).statistics()
    assert table["mean"][2] == pytest.approx(expected.mean.value)
    assert table["maximum_angle"][2] == pytest.approx(3.98 * expected.maximum.value)
    assert table["mean_angle"].unit == "arcsec"
    assert table["maximum"][4:].tolist() == [0.0] * 4
    assert table["cadences"].tolist() == [50] * 4 + [1000] * 4


def test_figures_are_closed(tmp_path):
    before = plt.get_fignums()
    run_experiment(Table1(scales=(1.0,)), tmp_path, progress=False)
    assert plt.get_fignums() == before


def test_figure_names_the_motions():
    study = Table1(scales=(1.0, 5.0))
    figure = study.draw(None, summary_of(study))
    labels = figure.axes[0].get_legend_handles_labels()[1]
    assert labels == ["paper", "k2_roll"]
    points = figure.axes[2].lines[1]
    assert points.get_ydata() == pytest.approx([0.59, 2.95], rel=0.05)


@pytest.mark.parametrize(
    "fields, message",
    [
        ({"cadences": 1}, "`cadences` must be at least 2, got 1"),
        ({"pixel_scale": 0}, "`pixel_scale` must be positive, got 0.0"),
        ({"scales": (1, -1)}, "`scales` must be positive, got -1.0"),
    ],
)
def test_bad_fields(fields, message):
    with pytest.raises(ValueError, match=message):
        Table1(**fields)
