"""The benchmark is the same every time, and its scores are those of the truth."""

import numpy as np
import pytest
from astropy.io import fits
from astropy.table import Table

from scope_models.cli import main
from scope_models.experiments.benchmark import (
    benchmark_star,
    make_benchmark,
    score_light_curves,
    summarize_scores,
)
from scope_models.experiments.skies import REGIMES

QUIET = {"progress": False}


def write_curve(path, sky, flux, error):
    good = np.isfinite(sky.flux).all(axis=(1, 2))
    columns = {"CADENCENO": sky.cadenceno, "FLUX": flux, "FLUX_ERR": error}
    Table({name: values[good] for name, values in columns.items()}).write(path)
    return path


@pytest.fixture(scope="module")
def transits():
    """Return the number and the sky of the first star with transits."""
    number = next(i for i, regime in enumerate(REGIMES.values()) if regime.depth > 0)
    return number, benchmark_star(number)


def test_files_are_the_same_again(tmp_path):
    for name in ("a", "b"):
        make_benchmark(tmp_path / name, stars=2, sweep=QUIET)
    names = sorted(path.name for path in (tmp_path / "a").glob("*.fits"))
    assert names == [f"sky{i:03d}-{name}.fits" for i, name in enumerate(list(REGIMES)[:2])]
    for name in names:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    with fits.open(tmp_path / "a" / names[0]) as hdus:
        flux = hdus[1].data["FLUX"].astype(float)
        good = np.isfinite(flux)
        assert np.array_equal(64 * flux[good], np.round(64 * flux[good]))
        assert np.abs(flux - benchmark_star(0).flux)[good].max() <= 1 / 128
        assert hdus[0].header["KEPLERID"] == 5001
        assert [hdu.name for hdu in hdus] == ["PRIMARY", "TARGETTABLES", "APERTURE"]


def test_the_truth_with_its_noise_scores_1(tmp_path, transits):
    number, sky = transits
    noise = sky.floor()
    rng = np.random.default_rng(0)
    flux = 1000 * sky.true_flux * (1 + noise * rng.standard_normal(len(sky.time)))
    error = np.full(len(flux), 1000 * noise)
    path = write_curve(tmp_path / f"sky{number:03d}.fits", sky, flux, error)
    row = score_light_curves([path])[0]
    assert row["regime"] == sky.regime.name
    for name in ("full", "high_passed", "depth", "pull"):
        assert row[name] == pytest.approx(1, abs=0.25), name


def test_a_file_is_found_by_its_target_number(tmp_path, transits):
    number, sky = transits
    error = np.full(len(sky.time), 1e-4)
    path = write_curve(tmp_path / "other.fits", sky, sky.true_flux, error)
    with pytest.raises(ValueError, match="is not of a star of the benchmark: its name"):
        score_light_curves([path])
    fits.setval(path, "KEPLERID", value=5001 + number)
    assert score_light_curves([path])["regime"][0] == sky.regime.name


def test_other_files_are_refused(tmp_path):
    text = tmp_path / "sky000.txt"
    text.write_text("nothing")
    with pytest.raises(ValueError, match=r"sky000\.txt is no table that astropy reads"):
        score_light_curves([text])
    Table({"FLUX": [1.0]}).write(tmp_path / "sky000.fits")
    with pytest.raises(ValueError, match="is no light curve: it has no column CADENCENO"):
        score_light_curves([tmp_path / "sky000.fits"])
    Table({"CADENCENO": [5000], "FLUX": [1.0], "FLUX_ERR": [1.0]}).write(tmp_path / "sky001.fits")
    with pytest.raises(ValueError, match="has cadences that the star does not have"):
        score_light_curves([tmp_path / "sky001.fits"])
    with pytest.raises(FileNotFoundError):
        score_light_curves([tmp_path / "absent.fits"])


def test_summary():
    table = Table({"regime": ["a", "b", "a"], "full": [1.0, 2.0, 3.0], "depth": [np.nan] * 3})
    summary = summarize_scores(table)
    assert summary["regime"].tolist() == ["a", "b", "all"]
    assert summary["stars"].tolist() == [2, 1, 3]
    assert summary["full"].tolist() == [2.0, 2.0, 2.0]
    assert np.isnan(summary["depth"]).all()


def test_command_line(tmp_path, capsys):
    assert main(["benchmark", "--output-dir", str(tmp_path / "sky"), "--stars", "1"]) == 0
    (path,) = (tmp_path / "sky").glob("*.fits")
    out = tmp_path / "lc"
    options = ["--order", "1", "--output-dir", str(out)]
    assert main(["detrend", str(path), *options]) == 0
    capsys.readouterr()
    (curve,) = out.glob("*-lc.fits")
    table = tmp_path / "scores.ecsv"
    assert main(["score", str(curve), "--output", str(table)]) == 0
    assert "k2-1x-constant" in capsys.readouterr().out
    row = Table.read(table)[0]
    raw = Table.read(tmp_path / "sky" / "results.ecsv")[0]
    assert row["full"] < 0.5 * raw["full"]
    assert main(["score", str(curve), "--output", str(curve), "--overwrite"]) == 2
