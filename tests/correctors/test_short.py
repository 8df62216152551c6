"""Transits and bumps that no single cadence shows."""

from types import SimpleNamespace

import numpy as np
import pytest

from scope_models._threads import one_thread
from scope_models.benchmark import REGIMES, make_sky
from scope_models.correctors import PLDCorrector
from scope_models.regression import _periodic, _variances
from scope_models.regression._variances import Data

pytestmark = pytest.mark.usefixtures("one_thread")


def corrected(regime, **options):
    """Return corrector, relative flux and the transit of a star of the sky."""
    sky = make_sky(regime, 5, n_cadences=1000, **options)
    corrector = PLDCorrector(sky.to_tpf())
    lc = corrector.correct()
    flux = np.full(len(sky.time), np.nan)
    flux[np.asarray(lc.cadenceno.value, int) - 1] = lc.flux.value
    return sky, corrector, flux


@pytest.fixture(scope="module")
def without():
    """Return the relative flux of a star without transits."""
    with one_thread:
        return corrected(REGIMES["k2-1x-constant"])[2]


@pytest.mark.parametrize("depth", [3e-4, 3e-3])
def test_unmasked_transits_are_seen_and_kept(depth, without):
    """The same noise with and without transits of 10 h."""
    deep = {"depth": depth, "duration": 10 / 24, "transit_period": 6.0}
    sky, corrector, flux = corrected(REGIMES["k2-1x-constant"].replace(**deep))
    inside, known = sky.transit < 1 - depth / 2, np.isfinite(flux / without)
    ratio = flux[known] / without[known]
    slope = np.polyfit(sky.transit[known], ratio / np.median(ratio), 1)[0]
    assert slope == pytest.approx(1, abs=0.008)  # 0.003
    whole = corrector.corrected_lc
    seen = inside[np.asarray(whole.cadenceno.value, int) - 1]
    assert np.mean(corrector.result.dips[seen]) > 0.95
    assert np.mean(corrector.outlier_mask[seen]) < 0.02


@pytest.mark.parametrize(
    ("name", "depth"), [("walk-constant", 1.9e-4), ("wheels-constant-kp13", 3.2e-4)]
)
def test_transits_under_slow_motion_are_kept(name, depth):
    """All of these transits of ten floors are found, and not a part of them (0.91 and 0.95)."""
    transits = {"duration": 0.25, "transit_period": 3.1}
    regimes = [REGIMES[name].replace(depth=deep, **transits) for deep in (depth, 0.0)]
    (sky, _, flux), (*_, without) = map(corrected, regimes)
    ratio, known = flux / without, np.isfinite(flux / without)
    slope = np.polyfit(sky.transit[known], ratio[known] / np.median(ratio[known]), 1)[0]
    assert slope == pytest.approx(1, abs=0.03)


def test_a_change_beside_a_gap_has_its_cadences(monkeypatch):
    """The middle of three cadences around a gap of days is in the gap."""
    time = 0.02 * np.append(np.arange(100), 500 + np.arange(100))
    data = Data(time, np.zeros(200), np.ones(200), np.zeros((200, 1)), np.zeros(1, int), 0)
    posterior = SimpleNamespace(mean=np.zeros(1))
    used = np.ones(200, dtype=bool)
    solution = SimpleNamespace(time=time, data=data, posterior=posterior, hyper=None, use=used)
    monkeypatch.setattr(_periodic, "_runs", lambda *_: np.array([[33, 34]]))
    columns = _periodic.short_changes(solution)
    assert np.flatnonzero(columns[:, 0]).tolist() == [99, 100, 101]


@pytest.mark.parametrize("precision", [1e-4, 1e-2])
@pytest.mark.parametrize(("seed", "depth"), [(6102, 0.05), (6103, 0.01), (6104, 0.01)])
def test_long_transits_do_not_depend_on_the_search(seed, depth, precision, monkeypatch):
    """In short files they may be outliers, or short changes, of which one is far likelier."""
    monkeypatch.setattr(_variances, "_PRECISION", precision)
    sky = make_sky(REGIMES["k2-1x-transits-neighbor"].replace(depth=depth), seed, n_cadences=400)
    lc = PLDCorrector(sky.to_tpf()).correct()
    flux, rows = lc.flux.value, np.searchsorted(sky.cadenceno, lc["cadenceno"])
    columns = np.column_stack([np.ones(len(rows)), sky.transit[rows]])
    (level, slope), *_ = np.linalg.lstsq(columns, flux, rcond=None)
    rest = flux / (level + slope * sky.transit[rows]) - 1
    means = rest[: len(rest) // 13 * 13].reshape(-1, 13).mean(axis=1)
    assert means.std() < 2 * sky.floor() / np.sqrt(13)
