"""The benchmark is the same every time, and its scores are those of the truth."""

import lzma

import numpy as np
import pytest
from astropy.io import fits
from astropy.table import Table

from scope_models.benchmark import (
    REGIMES,
    benchmark_star,
    make_benchmark,
    score_light_curves,
    summarize_scores,
)
from scope_models.benchmark.files import score_places
from scope_models.cli import main

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
    assert row["bias"] < 1e6 * noise / 5


@pytest.mark.parametrize("wrong", ["nothing", "bias", "step"])
def test_dependence_on_the_place_within_the_pixel(wrong):
    """A photometry with a known error: its size comes back, and the other score stays small."""
    rng = np.random.default_rng(3)
    time = np.arange(2000) * 0.02
    x, y = 5 + 1.3 * np.sin(2 * np.pi * time / 0.27), 5 + 0.4 * np.cos(2 * np.pi * time / 0.31)
    truth = 1 + 0.1 * np.sin(time)
    factor = 1 + 2e-5 * rng.standard_normal(2000)
    if wrong == "bias":
        factor += 0.001 * np.cos(2 * np.pi * x)
    elif wrong == "step":
        factor += 0.001 * (np.round(x) % 2)
    bias, step = score_places(time, 1000 * truth * factor, truth, x, y)
    if wrong == "nothing":
        assert bias < 4
        assert step < 30
    elif wrong == "bias":
        expected = 1e6 * np.std(0.001 * np.cos(2 * np.pi * x))
        assert bias == pytest.approx(expected, rel=0.1)
        assert step < 100  # the parabola about a border is no cosine
    else:
        assert step == pytest.approx(1000, rel=0.05)


def test_places_of_few_cadences():
    assert np.isnan(score_places(*np.ones((5, 50)))).all()
    x = np.full(300, 5.0)
    bias, step = score_places(np.arange(300) * 0.02, x, np.ones(300), x, x)
    assert (bias, np.isnan(step)) == (0, True)


def test_a_file_is_found_by_its_target_number(tmp_path, transits):
    number, sky = transits
    error = np.full(len(sky.time), 1e-4)
    path = write_curve(tmp_path / "other.fits", sky, sky.true_flux, error)
    with pytest.raises(ValueError, match="is not a star of the benchmark: its name"):
        score_light_curves([path])
    fits.setval(path, "KEPLERID", value=5001 + number)
    assert score_light_curves([path])["regime"][0] == sky.regime.name


def test_other_files_are_refused(tmp_path):
    text = tmp_path / "sky000.txt"
    text.write_text("nothing")
    with pytest.raises(ValueError, match=r"sky000\.txt is not a table that astropy can read"):
        score_light_curves([text])
    Table({"FLUX": [1.0]}).write(tmp_path / "sky000.fits")
    with pytest.raises(ValueError, match="is not a light curve: it has no column CADENCENO"):
        score_light_curves([tmp_path / "sky000.fits"])
    Table({"CADENCENO": [5000], "FLUX": [1.0], "FLUX_ERR": [1.0]}).write(tmp_path / "sky001.fits")
    with pytest.raises(ValueError, match="has cadences that the star does not have"):
        score_light_curves([tmp_path / "sky001.fits"])
    with pytest.raises(FileNotFoundError):
        score_light_curves([tmp_path / "absent.fits"])
    packed = tmp_path / "sky000.ecsv.xz"
    packed.write_bytes(lzma.compress(bytes(1000)))
    with pytest.raises(ValueError, match="has a compression that is not supported"):
        score_light_curves([packed])
    with pytest.raises(ValueError, match="is not a regular file"):
        score_light_curves([tmp_path])


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
    assert row["full"] < 0.2 * raw["full"]
    assert main(["score", str(curve), "--output", str(curve), "--overwrite"]) == 2


def test_a_star_off_its_stamp_has_scores(tmp_path):
    number = next(i for i, regime in enumerate(REGIMES.values()) if regime.lost)
    sky = benchmark_star(number)
    error = np.full(len(sky.time), sky.floor())
    path = write_curve(tmp_path / f"sky{number:03d}.fits", sky, sky.true_flux, error)
    row = score_light_curves([path])[0]
    assert row["full"] < 0.1
    assert row["bias"] == pytest.approx(0, abs=1e-6)
