"""Many files: everything is written, failures are listed, runs go on, inputs are never replaced."""

import errno
import os
import shutil
import sqlite3
import sys
from contextlib import closing
from functools import partial

import numpy as np
import pytest
from astropy import units as u
from astropy.io import fits
from astropy.table import Table
from matplotlib.image import imread

from scope_models import Detector, Motion, Star, read_scene, simulate
from scope_models.batch import (
    SweepError,
    detrend_files,
    find_files,
    fit_files,
    inject_file,
    inject_files,
    simulate_table,
)
from scope_models.cli import main
from scope_models.exceptions import FailedStarsWarning
from scope_models.io._opening import atomic_path
from scope_models.io.tpf import write_hdulist

QUIET = {"progress": False}
PLANET = {"period": [1.5], "t0": [2145.0], "depth": [0.01], "duration": [0.2]}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Return a folder of three small target pixel files."""
    folder = tmp_path_factory.mktemp("made")
    for mag in (11, 12, 13):
        observation = simulate(
            Star(mag), Detector.k2(shape=(9, 9)), Motion.k2_roll(150, seed=mag), seed=mag
        )
        observation.write(folder / f"kp{mag}.fits")
    return folder


@pytest.fixture
def files(made, tmp_path):
    """Return copies of the files."""
    shutil.copytree(made, tmp_path / "in")
    return sorted((tmp_path / "in").glob("*.fits"))


def detrend(paths, folder, *arguments, **options):
    return detrend_files(paths, folder, *arguments, sweep=QUIET, order=1, **options)


def test_tables_files_and_figure(files, tmp_path):
    import lightkurve

    result = detrend(files, tmp_path / "out")
    assert result.table["key"].tolist() == ["kp11", "kp12", "kp13"]
    assert result.table["mag"].tolist() == [11, 12, 13]
    assert (result.table["cdpp"] < result.table["raw_cdpp"]).all()
    assert result.table["cdpp"].unit == "ppm"
    assert "survival" not in result.table.colnames
    assert result.summary["stars"].tolist() == [1, 1, 1]
    assert imread(tmp_path / "out" / "figure.png").std() > 0
    lc = lightkurve.read(tmp_path / "out" / "kp12-lc.fits")
    assert lc.meta["CDPP"] == pytest.approx(result.table["cdpp"][1], rel=1e-5)
    assert lc.estimate_cdpp().value == pytest.approx(lc.meta["CDPP"], rel=1e-4)


@pytest.mark.usefixtures("empty_figures")
class TestDetrend:
    def test_pixels_that_were_not_collected_are_no_warnings(self, files, tmp_path):
        with fits.open(files[0]) as hdus:
            for name in ("FLUX", "FLUX_ERR"):
                hdus[1].data[name][:, :2] = hdus[1].data[name][:, :, 8] = np.nan
            hdus["APERTURE"].data[:2] = hdus["APERTURE"].data[:, 8] = 0
            hdus.writeto(files[0], overwrite=True, checksum=True)
        result = detrend(files[:1], tmp_path / "out", survival=True)
        assert result.table["warnings"].tolist() == [""]
        assert result.table["survival"][0] == pytest.approx(1, abs=0.2)

    def test_is_that_of_one_file(self, files, tmp_path):
        from astropy.io import fits

        from scope_models.correctors import detrend_file

        detrend(files[:1], tmp_path / "out")
        detrend_file(files[0], tmp_path / "one.fits", order=1)
        with (
            fits.open(tmp_path / "out" / "kp11-lc.fits") as many,
            fits.open(tmp_path / "one.fits") as one,
        ):
            np.testing.assert_array_equal(many[1].data["FLUX"], one[1].data["FLUX"])

    def test_goes_on(self, files, tmp_path):
        out = tmp_path / "out"
        detrend(files[:2], out)
        times = {path: path.stat().st_mtime_ns for path in out.glob("*.fits")}
        (out / "kp12-lc.fits").unlink()
        result = detrend(files, out)
        assert len(result.table) == 3
        assert (out / "kp11-lc.fits").stat().st_mtime_ns == times[out / "kp11-lc.fits"]
        assert (out / "kp12-lc.fits").exists()

    def test_file_that_has_changed_is_computed_again(self, files, tmp_path):
        before = detrend(files, tmp_path / "out").table
        shutil.copy(files[2], files[0])
        after = detrend(files, tmp_path / "out").table
        assert after["cdpp"][0] == after["cdpp"][2] != before["cdpp"][0]
        assert after["cdpp"][1] == before["cdpp"][1]

    def test_other_options_are_refused(self, files, tmp_path):
        detrend(files[:1], tmp_path / "out")
        with pytest.raises(ValueError, match=r"differs in `order` \(1 there, 2 here\)"):
            detrend_files(files[:1], tmp_path / "out", order=2, sweep=QUIET)

    @pytest.mark.parametrize("work", [detrend, partial(fit_files, psf=1, cadences=60, sweep=QUIET)])
    def test_another_catalog_in_the_same_place_is_refused(self, files, tmp_path, work):
        catalog = tmp_path / "stars.csv"
        catalog.write_text("x,y\n80,3\n")
        work(files[:1], tmp_path / "out", neighbors=catalog)
        assert work(files[:1], tmp_path / "out", neighbors=catalog).n_computed == 0
        catalog.write_text("x,y\n80,2\n")
        with pytest.raises(ValueError, match=r"differs in `contents of .*stars\.csv`"):
            work(files[:1], tmp_path / "out", neighbors=catalog)

    @pytest.mark.parametrize("more", [{}, {"format": "parquet"}])
    def test_what_killed_workers_were_writing_is_removed(self, files, tmp_path, more):
        if more:
            pytest.importorskip("pyarrow")
        detrend(files[:1], tmp_path / "out", **more)
        output = next((tmp_path / "out").rglob("kp11*"))
        halves = [folder / ".scope-models-01.fits" for folder in (output.parent, tmp_path / "out")]
        for half in (*halves, tmp_path / halves[0].name):
            half.write_bytes(b"SIMPLE  =")
        with closing(sqlite3.connect(tmp_path / "out" / "results.sqlite")) as other:
            other.execute("BEGIN EXCLUSIVE")
            with pytest.raises(OSError, match="another run is writing to"):
                detrend(files[:1], tmp_path / "out", **more)
            assert all(half.exists() for half in halves)  # they may be of the other run
        assert detrend(files[:1], tmp_path / "out", **more).n_computed == 0
        assert not any(half.exists() for half in halves)
        assert (tmp_path / halves[0].name).exists()

    @pytest.mark.slow
    def test_workers_give_the_same_bytes(self, files, tmp_path):
        for workers, name in ((None, "a"), (2, "b")):
            detrend(files, tmp_path / name, workers)
        for name in ("summary.ecsv", "kp11-lc.fits", "kp13-lc.fits"):
            assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
        a, b = (Table.read(tmp_path / name / "results.ecsv") for name in "ab")
        a.remove_columns(cost := ["seconds", "peak_memory"])
        b.remove_columns(cost)
        assert (a == b).all()


class TestOthers:
    def test_fit(self, files, tmp_path):
        result = fit_files(files[:1], tmp_path / "out", psf=1, cadences=60, sweep=QUIET)
        assert result.table["reduced_chi2"][0] == pytest.approx(1, abs=0.3)
        assert result.table["n_cadences"][0] == 60
        assert (tmp_path / "out" / "kp11-fit.fits").exists()

    def test_inject(self, files, tmp_path):
        planets = {name: values * 3 for name, values in PLANET.items()} | {
            "depth": [0.01, 0.02, 0.03]
        }
        result = inject_files(files, planets, tmp_path / "out", sweep=QUIET)
        np.testing.assert_allclose(result.table["injected_depth"], planets["depth"], rtol=0.02)
        assert (result.table["in_transit"] > 5).all()
        row = inject_file(files[1], {k: v[1] for k, v in planets.items()}, tmp_path / "one.fits")
        assert row["injected_depth"] == result.table["injected_depth"][1]

    @pytest.mark.parametrize("star, expected", [("fit", 0.01), (0.5, 0.005)])
    def test_light_of_the_star(self, files, tmp_path, star, expected):
        result = inject_files(files[:1], PLANET, tmp_path / "out", star=star, sweep=QUIET)
        assert result.table["injected_depth"][0] == pytest.approx(expected, rel=0.05)

    def test_simulate_a_table(self, tmp_path):
        rng = np.random.default_rng(1)
        table = Table({"mag": rng.uniform(11, 15, 9), "x_0": rng.uniform(4.5, 5.5, 9)})
        result = simulate_table(table, tmp_path, cadences=20, sweep=QUIET)
        assert len(list(tmp_path.glob("star*.fits"))) == 9
        assert result.table["key"][8] == "star0009"
        scene = read_scene(tmp_path / "star0007.fits")
        assert scene.stars[0].mag == table["mag"][6]
        assert scene.stars[0].x_0 == table["x_0"][6]

    def test_names_keep_letters_of_all_alphabets(self, files, tmp_path):
        names = ["\u661f.fits", "e\u0301toile a.fits.gz"]  # the second as macOS writes it
        given = [file.rename(tmp_path / name) for file, name in zip(files, names, strict=False)]
        result = fit_files(given, tmp_path / "out", psf=1, cadences=20, sweep=QUIET)
        assert result.table["key"].tolist() == ["\u661f", "\xe9toile_a"]
        assert (tmp_path / "out" / "\xe9toile_a-fit.fits").exists()
        table = {"name": ["\xe9toile", "\u661f"], "mag": [12, 13]}
        simulate_table(table, tmp_path / "stars", cadences=20, sweep=QUIET)
        written = [fits.getheader(tmp_path / "stars" / f"{name}.fits") for name in table["name"]]
        assert [header["OBJECT"] for header in written] == ["etoile", "SIM 1"]

    def test_a_name_without_letters(self, files, tmp_path):
        with pytest.raises(ValueError, match=r"the name of .*_\.fits has no letter or digit"):
            fit_files([files[0].rename(tmp_path / "_.fits")], tmp_path / "out", sweep=QUIET)

    def test_another_motion_in_the_same_place_is_refused(self, files, tmp_path):
        options = {"motion": tmp_path / "motion.fits", "cadences": 20, "sweep": QUIET}
        for file in files[:2]:
            shutil.copy(file, tmp_path / "motion.fits")
            if file is files[0]:
                simulate_table({"mag": [12.0]}, tmp_path / "out", **options)
        with pytest.raises(ValueError, match=r"differs in `contents of .*motion\.fits`"):
            simulate_table({"mag": [12.0]}, tmp_path / "out", **options)

    def test_simulate_planets_and_names(self, tmp_path):
        table = {"name": ["a", "b"], "mag": [11, 11]} | {k: v * 2 for k, v in PLANET.items()}
        table["t0"] = Motion.still(1).time[0] + np.array([0.5, 0.7])
        simulate_table(table, tmp_path, cadences=60, detector="kepler", sweep=QUIET)
        scene = read_scene(tmp_path / "b.fits")
        signal = scene.stars[0].relative_flux(scene.motion.time)
        assert signal.min() == pytest.approx(0.99, abs=0.002)


class TestBadInput:
    def test_the_same_file_twice(self, files, tmp_path):
        (tmp_path / "link.fits").symlink_to(files[0])
        for again in (files[0], tmp_path / "link.fits"):
            with pytest.raises(ValueError, match=f"`paths` holds .*{again.name} twice"):
                find_files([files[0], again])

    def test_two_files_of_one_name(self, files, tmp_path):
        shutil.copytree(files[0].parent, tmp_path / "other")
        with pytest.raises(ValueError, match=r"would both become kp11-lc\.fits"):
            detrend([files[0], tmp_path / "other" / "kp11.fits"], tmp_path / "out")

    def test_files_that_are_none_among_many(self, files, tmp_path):
        text, cut = tmp_path / "text.fits", tmp_path / "cut.fits"
        text.write_text("no FITS file")
        cut.write_bytes(files[0].read_bytes()[:20_000])
        absent = tmp_path / "absent.fits"
        with pytest.warns(FailedStarsWarning, match="3 stars failed, the first one, text, with"):
            result = detrend([files[0], text, cut, absent, files[1]], tmp_path / "out")
        assert result.table["key"].tolist() == ["kp11", "kp12"]
        assert result.failures["key"].tolist() == ["text", "cut", "absent"]
        assert "absent.fits" in result.failures["error"][2]
        assert not list((tmp_path / "out").glob("text*"))

    def test_full_disk(self, files, tmp_path, monkeypatch):
        """The file that does not fit is a failure without a rest; the next run writes it."""

        def full(hdus, path, **options):
            if path.name == "kp12-lc.fits":
                with atomic_path(path) as temporary:
                    temporary.write_bytes(b"half")
                    raise OSError(errno.ENOSPC, "No space left on device", str(temporary))
            return write_hdulist(hdus, path, **options)

        with monkeypatch.context() as patch:
            patch.setattr("scope_models.batch.detrend.write_hdulist", full)
            with pytest.warns(FailedStarsWarning, match="1 stars failed"):
                result = detrend(files, tmp_path / "out")
        assert "kp12-lc.fits: No space left on device" in result.failures["error"][0]
        names = {"kp11-lc.fits", "kp13-lc.fits"}
        assert {path.name for path in (tmp_path / "out").glob("*fits*")} == names
        assert not list((tmp_path / "out").glob(".scope-models*"))
        again = detrend(files, tmp_path / "out")
        assert (again.n_computed, len(again.table)) == (1, 3)

    def test_second_run_in_one_folder(self, files, tmp_path, capsys):
        command = ["detrend", str(files[0]), "--order", "1", "--output-dir", str(tmp_path / "out")]
        assert main(command) == 0
        with closing(sqlite3.connect(tmp_path / "out" / "results.sqlite")) as other:
            other.execute("BEGIN EXCLUSIVE")
            assert main(command) == 2
        assert "another run is writing to" in capsys.readouterr().err
        assert main(command) == 0

    def test_all_fail(self, tmp_path):
        (tmp_path / "text.fits").write_text("no FITS file")
        with (
            pytest.warns(FailedStarsWarning),
            pytest.raises(SweepError, match="all 1 stars failed"),
        ):
            detrend([tmp_path / "text.fits"], tmp_path / "out")

    def test_outputs_never_replace_inputs(self, files):
        other = files[0].with_name("kp11-lc.fits")
        shutil.copy(files[0], other)
        before = other.read_bytes()
        with pytest.raises(ValueError, match=r"kp11-lc\.fits would be replaced by an output"):
            detrend([files[0], other], other.parent, overwrite=True)
        with pytest.raises(ValueError, match=r"kp11-lc\.fits"):
            inject_file(other, {k: v[0] for k, v in PLANET.items()}, other, overwrite=True)
        assert other.read_bytes() == before

    @pytest.mark.parametrize("link", [os.symlink, os.link])
    def test_nor_links_to_inputs(self, files, tmp_path, link):
        (tmp_path / "out").mkdir()
        link(files[1], tmp_path / "out" / "kp11-lc.fits")
        with pytest.raises(ValueError, match=r"kp12\.fits would be replaced by an output"):
            detrend(files[:2], tmp_path / "out", overwrite=True)

    @pytest.mark.parametrize("value", [np.nan, np.inf, 0.0, -3.0])
    def test_inject_into_no_light(self, files, tmp_path, value):
        path, planet = files[0], {k: v[0] for k, v in PLANET.items()}
        with fits.open(path) as hdus:
            hdus[1].data["FLUX"][...] = value
            hdus.writeto(path, overwrite=True, checksum=True)
        with pytest.raises(ValueError, match=r"kp11\.fits has no light in its pixels"):
            inject_file(path, planet, tmp_path / "out.fits", star=1.0)
        assert not (tmp_path / "out.fits").exists()

    def test_files_of_others_are_kept(self, files, tmp_path):
        mine = tmp_path / "out" / "kp11-lc.fits"
        mine.parent.mkdir()
        mine.write_text("mine")
        with pytest.raises(FileExistsError, match=r"kp11-lc\.fits exists already"):
            detrend(files, mine.parent)
        assert mine.read_text() == "mine"
        assert len(detrend(files[:1], mine.parent, overwrite=True).table) == 1

    @pytest.mark.parametrize(
        "planets, message",
        [
            ({"period": [1.0]}, "`planets` lacks the column depth"),
            ({k: v * 2 for k, v in PLANET.items()}, "one row, or one for each of the 3 files"),
        ],
    )
    def test_planets(self, files, tmp_path, planets, message):
        with pytest.raises(ValueError, match=message):
            inject_files(files, planets, tmp_path / "out")

    @pytest.mark.parametrize(
        "table, message",
        [
            ({"name": ["a"]}, "`table` must have a column `mag`"),
            ({"mag": []}, "`table` must have a column `mag` and at least one row"),
            ({"mag": [12], "magnitude": [12]}, "`table` has an unknown column magnitude"),
            (
                {"mag": [12], "depth": [0.1]},
                r"`table` must have period and depth of a planet, got \['depth'\]",
            ),
        ],
    )
    def test_tables(self, tmp_path, table, message):
        with pytest.raises(ValueError, match=message):
            simulate_table(table, tmp_path)

    def test_options(self, files, tmp_path):
        with pytest.raises(TypeError, match=r"`transit_mask` must be a number, text, or true"):
            detrend(files, tmp_path / "out", transit_mask=np.zeros(150, bool))
        with pytest.raises(ValueError, match="`detector` must be a TOML file or one of kepler, k2"):
            simulate_table({"mag": [12]}, tmp_path, detector="hubble")


class TestNames:
    def test_are_searched(self, files, monkeypatch):
        import lightkurve

        class Found(list):
            def download(self):
                return lightkurve.read(files[0])

        class Search(list):
            author, exptime = np.array(["K2"]), [1800] * u.s

            def __getitem__(self, item):
                return Found()

        asked = []

        def search(name):
            asked.append(name)
            return Search([1] if "EPIC" in name else [])

        monkeypatch.setattr(lightkurve, "search_targetpixelfile", search)
        assert find_files(["EPIC 211956421", files[1]]) == (str(files[0]), str(files[1]))
        with pytest.raises(ValueError, match="no target pixel file was found"):
            find_files(["TIC 1"])
        assert asked == ["EPIC 211956421", "TIC 1"]

    @pytest.mark.parametrize(
        ("authors", "seconds", "chosen"),
        [
            (["Kepler", "Kepler", "Kepler"], [60, 1800, 1800], 1),
            (["SPOC", "SPOC", "TESS-SPOC"], [20, 120, 1800], 1),
            (["K2"], [60], 0),
        ],
    )
    def test_long_cadence_is_preferred(self, files, monkeypatch, authors, seconds, chosen):
        """Results are in lightkurve's order: by pipeline and year, fast cadences first."""
        import lightkurve

        n = len(authors)
        table = Table(
            {"author": authors, "exptime": np.array(seconds, dtype=float), "distance": np.zeros(n),
             "t_min": 55000.0 + np.arange(n), "mission": ["of the search"] * n,
             "productFilename": [f"kplr1-200916600000{k}_lpd-targ.fits.gz" for k in range(n)]}
        )  # fmt: skip
        name, got = table["productFilename"][chosen], []

        def download(found):
            got.extend(found.table["productFilename"])
            return lightkurve.read(files[0])

        found = lightkurve.SearchResult(table)
        monkeypatch.setattr(lightkurve, "search_targetpixelfile", lambda _: found)
        monkeypatch.setattr(lightkurve.SearchResult, "download", download)
        find_files(["KIC 1"])
        assert got == [name]

    def test_no_network_is_one_error(self, monkeypatch):
        import lightkurve

        def search(_):
            raise RuntimeError("no route\nto host")

        monkeypatch.setattr(lightkurve, "search_targetpixelfile", search)
        with pytest.raises(
            OSError, match="EPIC 1 is not a file, and the search for it failed: no rou"
        ):
            find_files(["EPIC 1"])

    @pytest.mark.remote_data
    def test_are_downloaded(self):
        (path,) = find_files(["EPIC 211956421"])
        assert "211956421" in path
        assert find_files(["EPIC 211956421"]) == (path,)  # from the cache

    @pytest.mark.parametrize("name", ["star", "star.fit s", "kplr009002278", "EPIC211956421.fts.g"])
    def test_mistyped_files_are_not_searched(self, monkeypatch, name):
        monkeypatch.setitem(sys.modules, "lightkurve", None)
        with pytest.raises(
            FileNotFoundError, match=f"{name}: no such file, and not an EPIC, KIC or"
        ):
            find_files([name])

    def test_files_that_are_absent_are_not_searched(self, tmp_path, monkeypatch):
        monkeypatch.setitem(sys.modules, "lightkurve", None)
        monkeypatch.chdir(tmp_path)
        names = ["a.fits", "b.fits.gz", "c/d.fit"]
        assert find_files(names) == tuple(str(tmp_path / name) for name in names)


class TestCommandLine:
    def run(self, capsys, *arguments):
        status = main([str(argument) for argument in arguments])
        return status, *capsys.readouterr()

    def test_detrend(self, files, tmp_path, capsys):
        text = tmp_path / "text.fits"
        text.write_text("no FITS file")
        out = tmp_path / "out"
        arguments = ["detrend", *files, "--order", "1", "--output-dir", out]
        status, stdout, stderr = self.run(capsys, *arguments)
        assert (status, stderr) == (0, "")
        assert stdout.splitlines()[0] == "3 stars, 0 failed"
        arguments.insert(1, text)
        status, stdout, stderr = self.run(capsys, *arguments)
        assert status == 1
        assert stdout.splitlines()[0] == "4 stars, 1 failed"
        assert stderr.startswith("scope-models: failed: text: ")
        assert stderr.count("\n") == 1

    def test_inject_one_and_many(self, files, tmp_path, capsys):
        planet = ["--period", 1.5, "--t0", 2145, "--depth", 0.01, "--duration", 0.2]
        status, stdout, stderr = self.run(
            capsys, "inject", files[0], *planet, "--output", tmp_path / "one.fits"
        )
        assert (status, stderr) == (0, "")
        assert "cadences in transit" in stdout
        usual = tmp_path / "usual.fits"
        status, stdout, _ = self.run(
            capsys, "inject", files[0], "--period", 1.5, "--depth", 0.01, "--output", usual
        )
        with fits.open(usual) as hdus:
            time, signal = (hdus["INJECTED"].data[name] for name in ("TIME", "SIGNAL"))
        assert f"mid-transit at {time[0] + 0.75:.4f} d" in stdout
        low = time[(signal < 1) & (time < time[0] + 1.5)]
        assert low.mean() == pytest.approx(time[0] + 0.75, abs=0.0105)
        # A central transit in front of the Sun lasts 13 h in a year.
        assert np.ptp(low) == pytest.approx(13 / 24 * (1.5 / 365.25) ** (1 / 3), abs=0.03)
        planet[3] = 2148
        status, _, stderr = self.run(
            capsys, "inject", files[0], *planet, "--period", 99, "--output", tmp_path / "no.fits"
        )
        assert status == 2
        assert f"no cadence is in transit between {time[0]:.2f} and {time[-1]:.2f} d" in stderr
        table = tmp_path / "planets.csv"
        Table(PLANET).write(table)
        many = ["inject", *files, "--planets", table, "--output-dir", tmp_path / "out"]
        assert self.run(capsys, *many)[0] == 0
        assert len(list((tmp_path / "out").glob("*-injected.fits"))) == 3

    def test_simulate_table(self, tmp_path, capsys):
        table = tmp_path / "stars.ecsv"
        Table({"mag": [12.0, 13.0]}).write(table)
        arguments = ["simulate", "--table", table, "--cadences", 20, "--output-dir", tmp_path / "o"]
        status, stdout, _ = self.run(capsys, *arguments)
        assert (status, stdout.splitlines()[0]) == (0, "2 stars, 0 failed")

    def test_seed_of_a_table(self, tmp_path, capsys):
        Table({"mag": [12.0]}).write(tmp_path / "stars.ecsv")
        fluxes = []
        for seed in ("0", "1"):
            arguments = ["--cadences", 5, "--seed", seed, "--output-dir", tmp_path / seed]
            self.run(capsys, "simulate", "--table", tmp_path / "stars.ecsv", *arguments)
            fluxes.append(fits.getdata(tmp_path / seed / "star0001.fits")["FLUX"])
        assert not np.array_equal(*fluxes)

    def test_fit(self, files, tmp_path, capsys):
        arguments = ["fit", files[0], "--components", 1, "--cadences", 40, "--output-dir"]
        assert self.run(capsys, *arguments, tmp_path / "out")[0] == 0

    @pytest.mark.parametrize(
        "arguments, message",
        [
            (["detrend", "a.fits"], "give --output for one input, or --output-dir"),
            (["fit", "a.fits", "b.fits", "--output", "c.fits"], "give --output for one input"),
            (["inject", "a.fits", "--output", "c.fits"], "--period and --depth are needed, or"),
            (["inject", "a", "--depth", "1"], "a planet needs --period and --depth"),
            (
                ["inject", "a", "--planets", "b", "--depth", "1", "--period", "1"],
                "--period and --depth cannot be combined with --planets",
            ),
            (["simulate", "--table", "a.csv"], "--table needs an --output-dir"),
            (
                ["detrend", "a", "--workers", "2", "--output", "b"],
                "--workers needs an --output-dir",
            ),
            (["fit", "a", "--scheduler", "c:1", "--output", "b"], "--scheduler needs an --output"),
            (["detrend", "a", "--output", "b", "--output-dir", "c"], "--output cannot be combined"),
            (["detrend", "a", "--figure", "b", "--output-dir", "c"], "--figure cannot be combined"),
            (["simulate", "--mag", "9", "--output", "b", "--output-dir", "c"], "needs --table"),
            (["simulate", "--mag", "9", "--output", "b", "--workers", "2"], "--workers needs an"),
            (
                ["simulate", "--table", "a.csv", "--output-dir", "b", "--scale", "2"],
                "--scale cannot be combined with --table",
            ),
            (
                ["simulate", "--table", "a.csv", "--output-dir", "b", "--no-noise"],
                "--no-noise cannot be combined with --table",
            ),
            (
                ["simulate", "--table", "a.csv", "--output-dir", "b", "--cadences", "0"],
                "--cadences must be at least 1, got 0",
            ),
        ],
    )
    def test_misuse(self, capsys, arguments, message):
        status, stdout, stderr = self.run(capsys, *arguments)
        assert (status, stdout) == (2, "")
        assert message in stderr
        assert stderr.count("\n") == 1

    def test_options_of_a_file(self, files, tmp_path, capsys):
        config = tmp_path / "options.toml"
        config.write_text(
            f"input = {[str(path) for path in files[:2]]}\norder = 1\nremove-trend = true\n"
            "overwrite = false\n"
        )
        arguments = ["detrend", "--config", config, "--output-dir", tmp_path / "out"]
        status, stdout, stderr = self.run(capsys, *arguments)
        assert (status, stderr) == (0, "")
        assert stdout.splitlines()[0] == "2 stars, 0 failed"
        meta = Table.read(tmp_path / "out" / "results.ecsv").meta
        assert (meta["order"], meta["restore_trend"]) == (1, False)
        arguments = [*arguments[:-1], tmp_path / "other", "--order", "2", "--workers", "1"]
        assert self.run(capsys, *arguments)[0] == 0
        assert Table.read(tmp_path / "other" / "results.ecsv").meta["order"] == 2

    @pytest.mark.parametrize("text", ["", "input = 'a.fits'\r\n", "\ufeff"])
    def test_lists_in_a_file_of_options_end(self, tmp_path, capsys, text):
        """They take none of the inputs; some editors begin files with a byte-order mark."""
        config = tmp_path / "options.toml"
        given = f"{text}positions_from = ['c.fits', 'd.fits']\r\n"
        config.write_bytes(given.encode())
        inputs = [] if "input" in text else ["a.fits"]
        arguments = ["detrend", "--config", config, *inputs, "--output", tmp_path / "b.fits"]
        status, _, stderr = self.run(capsys, *arguments)
        assert (status, stderr.count("no such file")) == (2, 2)
        assert "a.fits" not in stderr

    @pytest.mark.parametrize(
        "text, message",
        [
            ("order = 1\nordre = 2", "unrecognized arguments: --ordre=2"),
            ("order = 'many'", "argument --order: invalid int value: 'many'"),
            ("order = two", "is not valid TOML"),
            ("[order]\na = 1", "`order` must be a number, text, true, false or a list"),
        ],
    )
    def test_bad_files_of_options(self, tmp_path, capsys, text, message):
        config = tmp_path / "options.toml"
        config.write_text(text)
        try:
            status = main(["detrend", "a.fits", "--config", str(config), "--output", "b.fits"])
        except SystemExit as end:
            status = end.code
        err = capsys.readouterr().err
        assert status == 2
        assert message in err
        assert err.count("\n") == 1
