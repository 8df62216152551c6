"""Tests of the comparison of correctors."""

import numpy as np
import pytest
from astropy import units as u

from scope_models.correctors import PLDCorrector, compare_correctors
from scope_models.exceptions import DetrendingWarning
from scope_models.photometry import cdpp


@pytest.fixture(scope="module")
def compared(star):
    """Return a comparison of a constant star of 12th magnitude."""
    return compare_correctors(star.tpf, ("raw", "pld", "lightkurve"))


def test_numbers_are_those_of_the_light_curves(compared):
    raw, pld = (compared.light_curves[name] for name in ("raw", "pld"))
    for method in ("lightkurve", "everest"):
        column = compared.table[f"cdpp_{method}"].to_value(u.one)
        assert column[0] == pytest.approx(1e-6 * cdpp(raw, method=method))
        assert column[1] == pytest.approx(1e-6 * cdpp(pld, method=method))
        assert column[1] < column[0]
    corrector = compared.correctors["pld"]
    cadences = np.isfinite(raw.flux.value) & np.isfinite(pld.flux.value)
    residual, error, _ = corrector.held_out(13, cadences)
    pull = np.sqrt(np.mean((residual / error) ** 2))
    assert compared.table["held_out_pull"][1] == pytest.approx(pull)
    assert compared.table["transit_survival"][1] == corrector.result.transit_survival
    assert np.isnan(compared.table["transit_survival"][2])


def test_apertures_and_cadences_are_the_same(compared):
    assert len(set(compared.table["aperture"])) == 1
    assert len({len(lc) for lc in compared.light_curves.values()}) == 1


def test_text_has_all_columns(compared):
    assert repr(compared) == "<ComparisonResult of raw, pld, lightkurve>"
    text = str(compared)
    assert all(name in text for name in compared.table.colnames)


def test_picture(compared):
    axes = compared.plot()
    assert len(axes) == 3
    assert axes[0].get_ylim() == axes[2].get_ylim()


@pytest.mark.parametrize(
    ("correctors", "match"),
    [(("pld", "sff"), "must be of raw, pld, measured, lightkurve"), ((), "each corrector once"),
     (("pld", "pld"), "each corrector once")],
)  # fmt: skip
def test_bad_names(star, correctors, match):
    with pytest.raises(ValueError, match=match):
        compare_correctors(star.tpf, correctors)


@pytest.mark.filterwarnings("ignore::scope_models.exceptions.DetrendingWarning")
def test_windows_are_the_same_for_all(fake_star, monkeypatch):
    """Dropping cadences as outliers does not win: they are predicted, too."""
    tpf = fake_star(200, 12, 5).tpf
    flux = tpf.hdu[1].data["FLUX"].copy()
    flux[50:56] *= 1.05
    tpf.hdu[1].data["FLUX"][:] = flux
    asked, original = [], PLDCorrector.held_out

    def held_out(self, *arguments):
        asked.append(original(self, *arguments))
        return asked[-1]

    monkeypatch.setattr(PLDCorrector, "held_out", held_out)
    compared = compare_correctors(tpf, ("pld", "measured"))
    assert any(found.outlier_mask[50:56].any() for found in compared.correctors.values())
    np.testing.assert_array_equal(asked[0][2], asked[1][2])
    assert np.isin(np.arange(50, 56), asked[0][2]).all()
    for residual, error, _ in asked:  # the window of 52 to 64
        assert residual[4] == pytest.approx(np.log(1.05) * 4 / 13, rel=0.01)  # 0.1 % apart
        assert error[4] < 5e-5  # 2e-5


def test_failing_corrector_is_left_out(star, monkeypatch):
    def fail(*_, **__):
        raise ValueError("no light")

    monkeypatch.setattr(PLDCorrector, "correct", fail)
    with pytest.warns(DetrendingWarning, match="pld: fails: no light"):
        found = compare_correctors(star.tpf, ("raw", "pld"))
    assert list(found.table["corrector"]) == ["raw"]
