"""The scores, and a small version of the grid of simulated stars."""

import importlib.util
import itertools
import sys

import numpy as np
import pytest
from paper._correctors import residual_cdpp, score

from scope_models.correctors import PLDCorrector
from scope_models.photometry import cdpp


@pytest.mark.parametrize("method", ["lightkurve", "everest"])
def test_residual_cdpp(method):
    rng = np.random.default_rng(1)
    noise = rng.normal(0, 1e-4, 8000)
    truth = 1 - 0.01 * (np.arange(8000) % 100 < 8)
    assert residual_cdpp(truth * (1 + noise), truth, noise, method) == pytest.approx(1)
    more = truth * (1 + noise + rng.normal(0, 1e-4, 8000))
    assert residual_cdpp(more, truth, noise, method) == pytest.approx(2**0.5, rel=0.1)


def test_score_of_a_star(star):
    corrector = PLDCorrector(star.tpf)
    corrector.correct()
    mask = corrector.aperture_mask
    noise = star.noise[:, mask].sum(axis=1) / np.median(star.expected[:, mask].sum(axis=1))
    scores = score(corrector, np.ones(400), noise)
    # 30 windows: the scatter is known to 13 percent, and what is left of the noise to 10
    assert 0.6 < scores.held_out_mad < 1.4
    assert 0.7 < scores.held_out_rms < 1.3
    assert 0.7 < scores.held_out_pull < 1.3
    expected = cdpp(corrector.corrected_lc) / cdpp(1 + noise)
    assert scores.residual_lightkurve == pytest.approx(expected, rel=0.01)
    assert scores.floor == pytest.approx(1e6 * np.std(noise) / 13**0.5, rel=0.01)


def test_held_out_needs_windows(star):
    corrector = PLDCorrector(star.tpf)
    with pytest.raises(ValueError, match="call `correct` first"):
        corrector.held_out()
    corrector.correct(order=1)
    with pytest.raises(ValueError, match="`width` must be at most 200, got 300"):
        corrector.held_out(300)


@pytest.fixture(scope="module")
def grid(repository):
    """Return the benchmark as a module."""
    path = repository / "studies" / "pld_grid.py"
    spec = importlib.util.spec_from_file_location("pld_grid", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules["pld_grid"] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules["pld_grid"]


def options(shared_data, path, *more):
    return ["--data", str(shared_data / "poscorr"), "--output", str(path), *more]


def medians(rows, name, scale):
    return np.median([row[name] for row in rows if row["scale"] == scale])


@pytest.mark.parametrize(
    "bounds", [{5: 1.20}, pytest.param({1: 1.05, 5: 1.20}, marks=pytest.mark.slow)], ids=str
)
def test_small_grid(grid, shared_data, tmp_path, capsys, bounds):
    """One magnitude, some motions and both detectors reach what the whole grid must reach."""
    path = tmp_path / "grid.jsonl"
    few = options(shared_data, path, "--mags", "12", "--scales", *map(str, bounds), "--stars", "1")
    few += ["--series", "WASP-47, C3", "--cadences", "700"]
    grid.main(few)
    rows = grid.read(path)
    assert len(rows) == 2 * len(bounds)
    for row in rows:
        # 53 windows a star
        assert row["held_out_mad"] < 1.5
        assert row["residual_lightkurve"] < 1.10
        assert row["residual_everest"] < 1.10
        for how in ("masked", "joint"):
            assert abs(row[f"{how}_1000"] - 1) < 3.5 * row[f"{how}_1000_err"]
        assert row["cdpp_lightkurve"] < row["best_lightkurve"]["lightkurve"]
    for scale, largest in bounds.items():
        assert medians(rows, "held_out_mad", scale) < largest + 0.15
    # a second run has nothing left to do, and a report draws
    grid.main([*few, "--figure", str(tmp_path / "grid.png")])
    grid.main([*few])
    assert len(grid.read(path)) == len(rows)
    assert "ours lower in 100.0 % of stars" in capsys.readouterr().out
    assert (tmp_path / "grid.png").exists()


@pytest.mark.slow
def test_whole_grid(grid, shared_data, tmp_path):
    """One star per cell of the grid: what the corrector is to reach, scale by scale."""
    path = tmp_path / "grid.jsonl"
    grid.main(options(shared_data, path, "--stars", "1"))
    rows = grid.read(path)
    for scale, largest in ((1, 1.05), (2, 1.10), (5, 1.20), (10, 1.30)):
        assert medians(rows, "held_out_mad", scale) <= largest
        for detector, mag in itertools.product(grid.DETECTORS, grid.MAGNITUDES):
            cell = [
                r for r in rows if (r["scale"], r["detector"], r["mag"]) == (scale, detector, mag)
            ]
            for method in ("lightkurve", "everest"):
                assert np.median([r[f"residual_{method}"] for r in cell]) <= 1.10
    better = [row["cdpp_lightkurve"] < row["best_lightkurve"]["lightkurve"] for row in rows]
    assert np.mean(better) >= 0.95
    bright = [row for row in rows if row["mag"] <= 13]
    weights = [row["masked_1000_err"] ** -2.0 for row in bright]
    assert np.average([row["masked_1000"] for row in bright], weights=weights) == pytest.approx(
        1, abs=0.01
    )
