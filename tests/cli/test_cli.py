"""The command line: what it writes and prints, and how it fails."""

import os
import shlex
import subprocess
import sys
from contextlib import contextmanager

import lightkurve as lk
import numpy as np
import pytest
from astropy.io import fits
from astropy.table import Table
from astropy.wcs import WCS
from matplotlib.image import imread

from scope_models import Motion, __version__, read_scene
from scope_models.cli import main
from scope_models.cli._main import _make_parser
from scope_models.correctors import PLDCorrector
from scope_models.io import read_truth
from scope_models.photometry import cdpp

COMMANDS = ("demo", "simulate", "inject", "detrend", "fit", "report", "benchmark", "score")


@pytest.fixture
def command(tmp_path):
    """Return a function that runs `simulate` with few cadences and returns status and file."""
    path = tmp_path / "star.fits"

    def run(*options):
        status = main(
            ["simulate", "--mag", "12", "--cadences", "60", "--output", str(path), *options]
        )
        return status, path

    return run


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """Return the folder and the output of one run, in a terminal that cannot show its name."""
    folder = tmp_path_factory.mktemp("demo") / "new" / "\u661f"
    code = "import sys; from scope_models.cli import main; sys.exit(main())"
    command = [sys.executable, "-X", "utf8=0", "-c", code, "demo", "--output-dir", folder]
    result = subprocess.run(
        command, capture_output=True, text=True, check=False,
        env=os.environ | {"PYTHONIOENCODING": "ascii"},
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    return folder, result.stdout, result.stderr


@contextmanager
def read(path, **options):
    """Read a file with lightkurve, and close it, which lightkurve leaves to its users."""
    product = lk.read(path, **options)
    yield product
    if isinstance(product, lk.targetpixelfile.TargetPixelFile):
        product.hdu.close()


def noise_table(text):
    """Return the numbers of the demonstration's table by name and convention."""
    lines = text.splitlines()
    numbers = {line[:12].strip(): float(line[12:]) for line in lines[1:4]}
    everest = [float(value) for value in lines[4].rpartition("gives")[2].split(",")]
    return {name: pair for name, *pair in zip(numbers, numbers.values(), everest, strict=True)}


class TestDemo:
    def test_says_nothing_on_standard_error(self, demo):
        assert demo[2] == ""

    def test_names_that_the_terminal_cannot_show(self, demo):
        assert "/new/\\u661f/pixels.fits\n" in demo[1]
        assert demo[0].is_dir()

    def test_pixels_are_read_by_lightkurve(self, demo):
        with read(demo[0] / "pixels.fits") as tpf:
            assert isinstance(tpf, lk.KeplerTargetPixelFile)
            assert tpf.mission == "K2"
            assert tpf.get_header()["SEED"] == 1

    def test_light_curve_is_that_of_the_pixels(self, demo):
        aperture = PLDCorrector(demo[0] / "pixels.fits").aperture_mask
        with read(demo[0] / "pixels.fits") as tpf:
            expected = tpf.to_lightcurve(aperture_mask=aperture)
        lc = lk.read(demo[0] / "light-curve.fits")
        assert isinstance(lc, lk.KeplerLightCurve)
        np.testing.assert_allclose(lc["raw_flux"].value, expected.flux.value, rtol=1e-6)

    def test_table_is_the_noise_of_the_light_curves_about_the_truth(self, demo):
        printed = noise_table(demo[1])
        table = fits.getdata(demo[0] / "light-curve.fits")
        truth = read_truth(demo[0] / "pixels.fits").at_cadences(table["CADENCENO"])["SIGNAL1"]
        for name, column in {"raw": "RAW_FLUX", "corrected": "FLUX"}.items():
            lc = lk.LightCurve(time=table["TIME"], flux=table[column] / truth)
            expected = [cdpp(lc, method=way) for way in ("lightkurve", "everest")]
            assert printed[name] == pytest.approx(expected, abs=0.1)

    def test_the_correction_helps(self, demo):
        printed = noise_table(demo[1])
        # The light curve of the same star at rest has the noise alone; transits are not masked.
        for corrected, still in zip(printed["corrected"], printed["at rest"], strict=True):
            assert corrected < 1.5 * still
        assert printed["corrected"][0] < 0.2 * printed["raw"][0]

    def test_figure(self, demo):
        image = imread(demo[0] / "summary.png")
        assert image.shape[0] > 400
        assert image.shape[1] > 600
        assert image[..., :3].std() > 0.05

    def test_does_not_replace_files(self, demo, capsys):
        before = (demo[0] / "pixels.fits").read_bytes()
        assert main(["demo", "--output-dir", str(demo[0])]) == 2
        error = capsys.readouterr().err
        assert error.count("\n") == 1
        assert "--overwrite" in error
        assert (demo[0] / "pixels.fits").read_bytes() == before


class TestSimulate:
    def test_default(self, command, capsys):
        status, path = command("--seed", "3")
        assert status == 0
        assert capsys.readouterr().out == f"{path}: 60 cadences of 11 x 11 pixels\n"
        with read(path, quality_bitmask="none") as tpf:
            assert tpf.flux.shape == (60, 11, 11)
            assert tpf.get_header()["SEED"] == 3
            assert tpf.get_header()["KEPMAG"] == 12.0

    def test_seed_makes_it_reproducible(self, command):
        first = fits.getdata(command("--seed", "3")[1])["FLUX"].copy()
        again = fits.getdata(command("--seed", "3", "--overwrite")[1])["FLUX"].copy()
        other = fits.getdata(command("--seed", "4", "--overwrite")[1])["FLUX"].copy()
        np.testing.assert_array_equal(first, again)
        assert not np.array_equal(first, other)

    def test_motion_of_a_real_file(self, command, shared_data):
        source = shared_data / "poscorr" / "ktwo206103150-c03_llc.fits"
        status, path = command("--motion", str(source), "--scale", "5")
        assert status == 0
        written, real = fits.getdata(path), fits.getdata(source)[:60]
        used = np.abs(real["POS_CORR1"]) < 50
        assert used.sum() > 50
        for column in ("POS_CORR1", "POS_CORR2"):
            np.testing.assert_allclose(written[column][used], 5 * real[column][used], rtol=1e-6)

    def test_stars(self, command):
        options = ["--position", "4.5", "6.25", "--neighbor", "14", "2", "3", "--neighbor", "15"]
        status, path = command(*options, "8", "7", "--psf", "0.6", "0.5", "0.2", "--no-noise")
        assert status == 0
        truth = read_truth(path).table
        motion_x, motion_y = truth["MOTION_X"], truth["MOTION_Y"]
        for i, (x, y) in enumerate([(4.5, 6.25), (2, 3), (8, 7)], start=1):
            np.testing.assert_allclose(truth[f"X{i}"] - motion_x, x, atol=1e-12)
            np.testing.assert_allclose(truth[f"Y{i}"] - motion_y, y, atol=1e-12)

    def test_transit(self, command):
        start = Motion.k2_roll(1).time[0]
        planet = ["--period", "5", "--t0", str(start + 0.5), "--depth", "0.02", "--duration", "0.2"]
        status, path = command(*planet, "--no-noise", "--scale", "0")
        assert status == 0
        table = fits.getdata(path)
        flux = np.nansum(table["FLUX"], axis=(1, 2))
        assert flux.min() / flux.max() == pytest.approx(0.98, abs=2e-4)
        middle = table["TIME"][flux < 0.99 * flux.max()].mean()
        assert middle - table["TIME"][0] == pytest.approx(0.5, abs=0.0205)

    def test_star_of_a_catalog(self, tmp_path, capsys):
        catalog = tmp_path / "field.csv"
        rows = ["ra,dec,phot_g_mean_mag", "150,10,12.5", "150.003,10.002,15.5", "150.001,9.998,20"]
        catalog.write_text("\n".join(rows), encoding="utf-8")
        path = tmp_path / "star.fits"
        sky = ["--ra", "150", "--dec", "10", "--campaign", "14", "--channel", "31"]
        options = ["--catalog", str(catalog), "--period", "1.0", "--depth", "0.02", "--no-noise"]
        command_line = ["simulate", "--cadences", "60", "--output", str(path), *sky, *options]
        assert main([*command_line, "--magnitude-limit", "18"]) == 0
        assert capsys.readouterr().out.endswith("of 11 x 11 pixels, 2 stars\n")
        scene = read_scene(path)
        assert [star.mag for star in scene.stars] == [12.5, 15.5]
        header = fits.getheader(path)
        assert (header["CAMPAIGN"], header["CHANNEL"]) == (14, 31)
        assert (header["RA_OBJ"], header["DEC_OBJ"]) == (150.0, 10.0)
        x, y = WCS(fits.getheader(path, "APERTURE")).wcs_world2pix(150.003, 10.002, 0)
        np.testing.assert_allclose(scene.positions[1], [x, y], atol=0.01)
        signal, time = read_truth(path).relative_flux[0], read_truth(path).columns["TIME"]
        assert signal.min() == pytest.approx(0.98, abs=1e-3)
        low = time[signal < 0.9999] - time[0]
        assert low.mean() == pytest.approx(0.5, abs=0.0205)
        # A central transit in front of the Sun lasts 13 h in a year.
        assert np.ptp(low) == pytest.approx(13 / 24 / 365.25 ** (1 / 3), abs=0.03)
        assert main([*command_line, "--mag", "11", "--overwrite", "--background-stars", "19"]) == 0
        assert read_scene(path).stars[0].mag == 11.0

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            (["--ra", "10"], "--ra and --dec go together"),
            (["--background-stars", "18"], "need --ra and --dec"),
            (["--period", "2"], "a planet needs --period and --depth"),
            (["--t0", "2"], "a planet needs --period and --depth"),
            (
                ["--period", "2", "--depth", "0.1", "--t0", "0"],
                "`t0` = 0 d with `period` = 2 d: no cadence is in transit between 2144.10 and",
            ),
            (
                ["--period", "2", "--depth", "0.1", "--t0", "2456977"],
                "`t0` must have the zero of the times between 2144.10 and",
            ),
        ],
    )
    def test_options_that_need_others(self, command, capsys, options, message):
        assert command(*options)[0] == 2
        assert message in capsys.readouterr().err

    def test_telescope_on_the_ground(self, command):
        status, path = command("--detector", "ground", "--mag", "16", "--seed", "1")
        assert status == 0
        scene = read_scene(path)
        assert scene.detector.effects[1].aperture == 1.0
        assert scene.motion.x.std() > 0.1

    def test_detector(self, command):
        status, path = command("--detector", "tess", "--shape", "7", "9", "--no-sensitivity")
        assert status == 0
        with read(path, quality_bitmask="none") as tpf:
            assert isinstance(tpf, lk.TessTargetPixelFile)
            assert tpf.flux.shape[1:] == (7, 9)
            assert tpf.time.format == "btjd"
            assert tpf.time.value[0] == pytest.approx(1325.3, abs=0.1)
            assert np.diff(tpf.time.value) == pytest.approx(120 / 86400, rel=1e-3)
            assert np.all(tpf.pos_corr1 == 0)
        assert np.all(read_truth(path).maps["INTERPIXEL"] == 1)

    def test_effects_of_the_mission(self, command):
        _, path = command("--detector", "tess", "--cadences", "50", "--mission-effects")
        assert [e.name for e in read_scene(path).effects] == ["CosmicRays", "ScatteredLight"]

    def test_detector_of_a_file(self, command, tmp_path):
        path = tmp_path / "detector.toml"
        text = 'preset = "k2"\nmission = "Kepler"\nshape = [9, 9]\nread_noise = 0\nn_frames = 1\n'
        path.write_text(text, encoding="utf-8")
        status, output = command("--detector", str(path), "--shape", "7", "8", "--noise", "read")
        assert status == 0
        table = fits.getdata(output)
        assert table["FLUX"].shape == (60, 7, 8)
        assert np.diff(table["TIME"]) == pytest.approx(6.538751429414 / 86400, rel=1e-3)
        assert np.all(table["POS_CORR1"] == 0)

    def test_noise_terms(self, command):
        _, path = command("--noise", "read")
        errors = fits.getdata(path)["FLUX_ERR"]
        assert np.ptp(errors) == pytest.approx(0, abs=1e-3)
        assert errors.mean() > 0


ERRORS = {
    "sigma": (["--psf", "-1", "1", "0"], "`sigma_x` must be positive"),
    "cadences": (["--cadences", "0"], "--cadences must be at least 1, got 0"),
    "detector": (
        ["--detector", "plato"],
        "--detector must be a TOML file or one of kepler, k2, k2_calibrated, tess",
    ),
    "toml": (["--detector", "no-such-file.toml"], "no-such-file.toml"),
    "missing": (["--motion", "no-such-file.fits"], "no-such-file.fits"),
    "folder": (["--output", "no-such-folder/star.fits"], "no-such-folder"),
    "depth": (["--period", "1", "--depth", "2"], "`depth` must be between 0 and 1"),
    "seed": (["--seed", "-1"], "`seed` must be at least 0"),
    "scale": (["--detector", "tess", "--scale", "2"], "--scale needs --motion FILE"),
}


class TestErrors:
    @pytest.mark.parametrize("name", ERRORS)
    def test_is_one_line(self, command, capsys, name, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        options, message = ERRORS[name]
        assert command(*options)[0] == 2
        error = capsys.readouterr().err
        assert error.startswith("scope-models: error: ")
        assert message in error
        assert error.count("\n") == 1
        assert list(tmp_path.iterdir()) == []

    @pytest.mark.parametrize(
        "argv",
        [
            ["simulate", "--table", "stars.txt", "--output-dir", "out"],
            ["inject", "star.fits", "--planets", "stars.txt", "--output-dir", "out"],
            ["detrend", "star.fits", "--planets", "stars.txt", "--output-dir", "out"],
        ],
    )
    def test_table_that_is_none(self, capsys, tmp_path, monkeypatch, argv):
        monkeypatch.chdir(tmp_path)
        (tmp_path / "stars.txt").write_text("hello")
        assert main(argv) == 2
        error = capsys.readouterr().err
        assert error.startswith("scope-models: error: stars.txt is not a table that astropy can")
        assert error.count("\n") == 1

    def test_period_of_an_injection(self, command, capsys, tmp_path):
        _, path = command()
        capsys.readouterr()
        options = ["--period", "-3", "--depth", "0.01", "--output", str(tmp_path / "planet.fits")]
        assert main(["inject", str(path), *options]) == 2
        assert "`period` must be positive, got -3.0" in capsys.readouterr().err

    def test_file_without_positions(self, command, capsys, tmp_path):
        table = fits.BinTableHDU.from_columns([fits.Column("TIME", "D", array=[1.0, 2.0])])
        table.writeto(tmp_path / "other.fits")
        assert command("--motion", str(tmp_path / "other.fits"))[0] == 2
        error = capsys.readouterr().err
        assert "other.fits" in error
        assert "POS_CORR1" in error

    def test_more_cadences_than_the_motion_has(self, command, capsys, tmp_path):
        rows = {"TIME": [1.0, 2.0], "POS_CORR1": [0.0, 0.1], "POS_CORR2": [0.0, 0.1]}
        Table(rows).write(tmp_path / "short.fits")
        assert command("--motion", str(tmp_path / "short.fits"))[0] == 2
        assert "--cadences must be at most 2, the motion's, got 60" in capsys.readouterr().err
        assert command("--cadences", "1200", "--shape", "5", "5")[0] == 0
        assert ": 1200 cadences of 5 x 5 pixels" in capsys.readouterr().out

    def test_existing_output(self, command, capsys):
        _, path = command()
        before = path.read_bytes()
        assert command()[0] == 2
        assert "--overwrite" in capsys.readouterr().err
        assert path.read_bytes() == before

    @pytest.mark.filterwarnings("always::scope_models.exceptions.LostLightWarning")
    def test_warning_is_one_line(self, command, capsys):
        assert command("--position", "0", "0")[0] == 0
        error = capsys.readouterr().err
        assert error.startswith("scope-models: warning: ")
        assert "% of its light off the stamp" in error
        assert error.count("\n") == 1

    @pytest.mark.parametrize("argv", [[], ["no-such-command"], ["simulate"], ["demo", "--sead"]])
    def test_misuse(self, capsys, argv):
        with pytest.raises(SystemExit) as stop:
            main(argv)
        assert stop.value.code == 2
        error = capsys.readouterr().err
        assert error.count("\n") == 1
        assert "--help" in error

    @pytest.mark.parametrize("name", ["", *COMMANDS])
    def test_help_ends_with_an_example(self, capsys, name):
        with pytest.raises(SystemExit) as stop:
            main([*name.split(), "--help"])
        assert stop.value.code == 0
        text = capsys.readouterr().out
        assert "usage: scope-models" in text
        assert "DIR\n" not in text
        example = shlex.split(text.split("example: ")[-1])
        assert example[:2] == ["scope-models", name or "demo"]
        assert _make_parser().parse_args(example[1:]).run

    def test_version(self, capsys):
        with pytest.raises(SystemExit) as stop:
            main(["--version"])
        assert stop.value.code == 0
        assert capsys.readouterr().out == f"scope-models {__version__}\n"


HEAVY = ["numpy", "scipy", "astropy", "lightkurve", "matplotlib", "tqdm", "dask"]


@pytest.mark.parametrize(
    "argv",
    [["--version"], ["--help"]]
    + [[name, "--help"] for name in ("demo", "simulate", "detrend", "fit", "benchmark")],
    ids=" ".join,
)
def test_answers_without_heavy_imports(argv):
    """They are what makes a command line slow: a time would depend on the machine."""
    code = (
        "import sys; from scope_models.cli import main\n"
        "try: main(sys.argv[1:])\n"
        f"finally: sys.stderr.write(str([m for m in {HEAVY} if m in sys.modules]))"
    )
    command = [sys.executable, "-c", code, *argv]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 0
    assert result.stdout
    assert result.stderr == "[]"


def test_interrupt_during_the_first_import_is_one_line(monkeypatch, capsys):
    def interrupted(name):
        raise KeyboardInterrupt(name)

    monkeypatch.setattr("scope_models.cli._main.importlib.import_module", interrupted)
    assert main(["demo"]) == 130
    assert capsys.readouterr().err == "scope-models: error: interrupted\n"
