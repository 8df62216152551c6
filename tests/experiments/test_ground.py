"""Study of pixel-level de-correlation from the ground."""

import numpy as np
import pytest
from astropy.table import Table
from matplotlib import pyplot as plt

from scope_models.experiments import make_study
from scope_models.experiments.ground import _METHODS, _SURVIVALS, GroundPLD


def made_up(study, **columns):
    """Return results with the noise of a telescope that PLD helps."""
    rows = []
    for task in study.tasks():
        values = {"floor": 500.0, "raw": 2e4, "raw_pld": 2e4, "differential": 600.0}
        values |= {"differential_pld": 550.0 if task["flat"] < 0.01 else 300.0}
        values |= {"differential_predicted": 1e4} | dict.fromkeys(_SURVIVALS, 0.99)
        rows.append(task | values | columns)
    return Table(rows)


def test_claims():
    study = GroundPLD(stars=2)
    table = made_up(study)
    summary = study.summarize(table)
    assert summary["stars"].tolist() == [2] * 4
    np.testing.assert_allclose(summary["ratio"], [550 / 600, 550 / 600, 0.5, 0.5])
    assert list(summary.meta["claims"].values()) == ["holds"] * 4
    verdicts = study.summarize(made_up(study, differential_pld=700.0)).meta["claims"]
    assert list(verdicts.values()) == ["holds", "does not hold", "does not hold", "holds"]
    lossy = study.summarize(made_up(study, differential_pld_survival=0.5)).meta["claims"]
    assert list(lossy.values())[3] == "does not hold"
    titles = [ax.get_title() for ax in study.draw(table, summary).axes[: len(_METHODS)]]
    assert titles == list(_METHODS.values())
    plt.close("all")


def test_error_of_the_ratio():
    study = GroundPLD(stars=40, flats=(0.01,), drifts=(0.03,))
    table = made_up(study)
    table["differential_pld"] *= np.random.default_rng(1).normal(1, 0.1, 40)
    summary = study.summarize(table)
    # The standard error of a median of normal numbers is sqrt(pi / 2 n) of their scatter.
    assert summary["ratio_error"][0] == pytest.approx(0.05 * np.sqrt(np.pi / 80), rel=0.3)
    assert np.isnan(GroundPLD(stars=1).summarize(made_up(GroundPLD(stars=1)))["ratio_error"]).all()


@pytest.mark.slow
def test_a_field():
    study = make_study("ground", {"cadences": 120, "stars": 1, "flats": [0.01], "drifts": [0.03]})
    (task,) = study.tasks()
    observation = study.observation(task)
    flux = observation.truth.relative_flux[0]
    assert np.all(flux == 1)
    row = study.measure(task, observation)
    # Photons of the target, and scintillation of target and reference, are the larger part.
    electrons = observation.detector.flux_from_mag(study.mag) * 60
    photons = 1e6 / np.sqrt(electrons * 10)
    assert photons < row["floor"] < 2.5 * photons
    assert row["floor"] < row["differential"] < row["raw"]
    assert row["differential_survival"] == pytest.approx(1, abs=0.05)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"flats": ()}, "`flats` must be one or more different numbers"),
        ({"drifts": (0.1, 0.1)}, "`drifts` must be one or more different numbers"),
        ({"flats": (-0.1,)}, "`flats` must not be negative"),
        ({"aperture": 0.0}, "`aperture` must be positive"),
        ({"cadences": 10}, "`cadences` must be at least 120"),
        ({"stars": 0}, "`stars` must be at least 1"),
    ],
)
def test_bad_configurations(fields, message):
    with pytest.raises(ValueError, match=message):
        GroundPLD(**fields)
