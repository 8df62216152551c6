"""Light curves as archives and catalogs take them: collections, data sets, results."""

import csv
import hashlib
import multiprocessing
import shutil
import subprocess
import time

import numpy as np
import pytest
from astropy import units as u
from astropy.io import fits
from astropy.table import Table
from astropy.time import Time
from astropy.wcs import WCS
from sweep_studies import write_rows

from scope_models import Detector, Motion, Star, simulate
from scope_models.batch import detrend_files, fit_files, inject_file, read_results
from scope_models.cli import main
from scope_models.exceptions import FailedStarsWarning

pytestmark = pytest.mark.usefixtures("empty_figures")

QUIET = {"progress": False}
HLSP = {"id": "Test-LCs", "lead": "A. Nobody", "version": "1.0"}
#: Keywords that MAST requires or recommends for all products, and for light curves.
PRIMARY = """
DATE-BEG DATE-END DATE-AVG DOI HLSPID HLSPLEAD HLSPNAME HLSPTARG HLSPVER INSTRUME LICENSE LICENURL
MJD-BEG MJD-END MJD-MID OBSERVAT TELAPSE TELESCOP TIMESYS XPOSURE MISSION
"""
TABLE = ["DEC_TARG", "RA_TARG", "RADESYS", "FILTER", "TIMESYS", "DATE-BEG", "DATE-END"]


def make(path, number, mag=12, cadences=150, **metadata):
    """Write a target pixel file of a K2 star."""
    observation = simulate(
        Star(mag), Detector.k2(shape=(9, 9)), Motion.k2_roll(cadences, seed=number), seed=number
    )
    metadata = {"campaign": 5, "channel": 40 + number % 2} | metadata
    return observation.write(
        path, metadata={"object_name": f"EPIC {211000000 + number}", **metadata}
    )


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Return the target pixel files of three stars."""
    folder = tmp_path_factory.mktemp("made")
    return [make(folder / f"star{n}.fits", n, mag=11 + n) for n in range(3)]


@pytest.fixture(scope="module")
def collection(made, tmp_path_factory):
    """Return the folder and the result of a collection."""
    folder = tmp_path_factory.mktemp("hlsp")
    return folder, detrend(made, folder, format="hlsp", hlsp=HLSP)


@pytest.fixture(scope="module")
def folder(made, tmp_path_factory):
    """Return the folder of a data set."""
    pytest.importorskip("pyarrow")
    folder = tmp_path_factory.mktemp("parquet")
    detrend(made, folder, format="parquet")
    return folder


@pytest.fixture(scope="module")
def injected(tmp_path_factory):
    """Return a star with deep transits of a planet, and the planet."""
    folder = tmp_path_factory.mktemp("planet")
    path = make(folder / "star.fits", 1, cadences=400)
    planet = {"period": 1.7, "depth": 0.004, "t0": 2145.0, "duration": 0.3}
    inject_file(path, planet, folder / "planet.fits")
    return folder / "planet.fits", planet


def detrend(paths, folder, **options):
    return detrend_files(paths, folder, sweep=QUIET, order=1, **options)


class TestCollection:
    def test_names(self, collection):
        folder, result = collection
        names = sorted(path.name for path in folder.glob("hlsp*"))
        expected = "hlsp_test-lcs_k2_kepler_epic21100000{}-c05_kepler_v1.0_lc.fits"
        assert names == [expected.format(n) for n in range(3)] == sorted(result.table["output"])

    def test_files_are_fits_with_right_checksums(self, collection):
        folder, _ = collection
        for path in folder.glob("hlsp*"):
            with fits.open(path, checksum=True) as hdus:  # a wrong checksum warns
                hdus.verify("exception")
                for hdu in hdus:
                    assert "CHECKSUM" in hdu.header
                    assert all(len(str(card)) == 80 for card in hdu.header.cards)

    @pytest.mark.skipif(shutil.which("fitsverify") is None, reason="fitsverify is not installed")
    def test_fitsverify(self, collection):
        folder, result = collection
        for name in result.table["output"]:
            command = ["fitsverify", str(folder / name)]
            text = subprocess.run(command, capture_output=True, text=True, check=False).stdout
            assert "found 0 warning(s) and 0 error(s)" in text

    def test_keywords(self, collection, made):
        folder, result = collection
        with fits.open(folder / result.table["output"][1]) as hdus, fits.open(made[1]) as tpf:
            primary, table = (hdu.header for hdu in hdus[:2])
            assert not [key for key in PRIMARY.split() if key not in primary]
            assert not [key for key in TABLE if key not in table]
            assert "EQUINOX" not in primary
            assert primary["HLSPID"] == "TEST-LCS"
            assert primary["HLSPTARG"] == "EPIC 211000001"
            assert primary["SIMULATD"] is True
            assert primary["TPFSHA"] == hashlib.sha256(made[1].read_bytes()).hexdigest()
            assert primary["CDPP"] == pytest.approx(result.table["cdpp"][1])
            assert primary["RAWCDPP"] == pytest.approx(result.table["raw_cdpp"][1])
            assert "lightkurve" in primary["CDPPCONV"]
            assert 0.3 < primary["HELDPULL"] < 3
            assert 0 < primary["CROWDING"] <= 1
            time = hdus[1].data["TIME"]
            middle = Time(2454833, np.nanmean(time), format="jd", scale="tdb")
            assert abs(Time(primary["DATE-AVG"], scale="tdb") - middle) < 0.1 * u.day
            assert Time(primary["DATE-BEG"], scale="tdb").mjd == pytest.approx(primary["MJD-BEG"])
            exposure = tpf[1].header["EXPOSURE"] * 86400  # of all cadences of the simulation
            assert primary["XPOSURE"] == pytest.approx(exposure, rel=0.1)

    def test_columns(self, collection, made):
        folder, result = collection
        with fits.open(folder / result.table["output"][0]) as hdus, fits.open(made[0]) as tpf:
            names = hdus[1].columns.names
            for name in ("FLUX", "FLUX_ERR", "RAW_FLUX", "BKG_FLUX", "POS_FIT1", "WIDTH"):
                assert name in names
            kept = np.isin(tpf[1].data["CADENCENO"], hdus[1].data["CADENCENO"])
            assert kept.mean() > 0.9
            for name in ("TIME", "CADENCENO", "QUALITY"):
                np.testing.assert_array_equal(hdus[1].data[name], tpf[1].data[name][kept])
            assert hdus[1].columns["TIME"].unit == "d"
            assert {column.unit for column in hdus[1].columns} == {None, "d", "e-/s", "pixel"}
            chosen = hdus["APERTURE"].data & 2 > 0
            raw = tpf[1].data["FLUX"][kept][:, chosen].sum(axis=1)
            finite = np.isfinite(hdus[1].data["RAW_FLUX"])
            np.testing.assert_allclose(hdus[1].data["RAW_FLUX"][finite], raw[finite], rtol=1e-5)

    # lightkurve adds a number without a unit to a time.
    @pytest.mark.filterwarnings("ignore:Numerical value without unit")
    # lightkurve's `to_fits` inverts a bool
    @pytest.mark.filterwarnings("ignore:Bitwise inversion:DeprecationWarning")
    def test_lightkurve_reads_and_writes_it_again(self, collection, tmp_path):
        import lightkurve

        folder, result = collection
        path = folder / result.table["output"][2]
        lc = lightkurve.read(path)
        assert isinstance(lc, lightkurve.KeplerLightCurve)
        assert len(lightkurve.KeplerLightCurve.read(path, format="kepler")) == len(lc)
        assert lc.meta["HLSPID"] == "TEST-LCS"
        assert lc.time.format == "bkjd"
        lc.to_fits(tmp_path / "again.fits", flux_column_name="FLUX")
        again = lightkurve.read(tmp_path / "again.fits", quality_bitmask="none")
        np.testing.assert_array_equal(again.flux.value, lc.flux.value)
        np.testing.assert_allclose(again.time.value, lc.time.value)

    def test_manifest(self, collection):
        folder, result = collection
        assert result.files[-1] == folder / "manifest.csv"
        with (folder / "manifest.csv").open() as file:
            rows = list(csv.DictReader(file))
        assert [row["tpf"] for row in rows] == ["star0.fits", "star1.fits", "star2.fits"]
        for row in rows:
            content = (folder / row["file"]).read_bytes()
            assert row["sha256"] == hashlib.sha256(content).hexdigest()

    @pytest.mark.parametrize(
        "name, mission, expected",
        [
            ("kepler_q12_ch4/tpf_01.fits.gz", "KeplerLightCurve",
             "hlsp_test-lcs_kepler_kepler_kic12644774-q12_kepler_v1.0_lc.fits"),
            ("tess_tpf/tesssip_tpf1.fits", "TessLightCurve",
             "hlsp_test-lcs_tess_phot_tic273589987-s0015_tess_v1.0_lc.fits"),
        ],
    )  # fmt: skip
    def test_real_files(self, shared_data, tmp_path, name, mission, expected):
        import lightkurve

        detrend([shared_data / name], tmp_path, format="hlsp", hlsp=HLSP)
        lc = lightkurve.read(tmp_path / expected)
        assert type(lc).__name__ == mission
        assert "SIMULATD" not in lc.meta
        with fits.open(tmp_path / expected, checksum=True) as hdus:
            hdus.verify("exception")
            assert hdus[0].header["INSTRUME"] == f"{lc.meta['TELESCOP']} Photometer"
            assert hdus[1].header["FILTER"] == lc.meta["TELESCOP"].upper()

    @pytest.mark.parametrize(
        "changes, message",
        [
            ({"id": "my collection"}, "`hlsp_id` must be 2 to 20 letters"),
            ({"id": "x" * 21}, "`hlsp_id` must be 2 to 20 letters"),
            ({"lead": ""}, "`hlsp_lead` must name the leader"),
            ({"lead": "Müller"}, "`hlsp_lead` must be text of at most 68 ASCII characters"),
            ({"version": "one"}, "`hlsp_version` must be a version as 1.0, got 'one'"),
        ],
    )
    def test_bad_collections(self, made, tmp_path, changes, message):
        with pytest.raises(ValueError, match=message):
            detrend(made, tmp_path, format="hlsp", hlsp=HLSP | changes)

    def test_other_format(self, made, tmp_path):
        with pytest.raises(ValueError, match="`format` must be one of fits, hlsp, parquet"):
            detrend(made, tmp_path, format="csv")
        with pytest.raises(ValueError, match="`hlsp` is needed by, and only by"):
            detrend(made, tmp_path, format="hlsp")

    def test_one_star_twice(self, made, tmp_path):
        shutil.copy(made[0], tmp_path / "copy.fits")
        with pytest.raises(ValueError, match=r"star0.* and .*copy\.fits would both become hlsp"):
            detrend([made[0], tmp_path / "copy.fits"], tmp_path, format="hlsp", hlsp=HLSP)

    def test_files_without_a_name_fail_alone(self, made, tmp_path):
        (tmp_path / "text.fits").write_text("no FITS file")
        shutil.copy(made[1], tmp_path / "nameless.fits")
        with fits.open(tmp_path / "nameless.fits", mode="update") as hdus:
            for hdu in hdus[:2]:
                hdu.header["OBJECT"] = ""
                hdu.add_checksum()
        paths = [made[0], tmp_path / "text.fits", tmp_path / "nameless.fits"]
        with pytest.warns(FailedStarsWarning, match="2 stars failed"):
            result = detrend(paths, tmp_path / "out", format="hlsp", hlsp=HLSP)
        assert "must name the mission and the target" in result.failures["error"][1]
        assert len(list((tmp_path / "out").glob("*.fits"))) == 1

    def test_files_of_another_collection_are_kept(self, collection, made, tmp_path):
        folder, result = collection
        name = result.table["output"][0]
        shutil.copy(folder / name, tmp_path / name)
        with pytest.raises(FileExistsError, match="exists already"):
            detrend(made, tmp_path, format="hlsp", hlsp=HLSP)
        with pytest.raises(ValueError, match="differs in `hlsp_version`"):
            detrend(made, folder, format="hlsp", hlsp=HLSP | {"version": "2.0"})

    def test_command(self, made, tmp_path, capsys):
        command = ["detrend", str(made[0]), "--output-dir", str(tmp_path / "out"), "--order", "1"]
        assert main([*command, "--format", "hlsp"]) == 2
        assert "--hlsp-id, --lead and --version" in capsys.readouterr().err
        more = ["--hlsp-id", "test", "--lead", "A. Nobody", "--version", "2"]
        assert main([*command, "--format", "hlsp", *more]) == 0
        assert "manifest.csv" in capsys.readouterr().out
        assert main(["detrend", str(made[0]), "--output", "a.fits", "--format", "hlsp", *more]) == 2
        assert "need an --output-dir" in capsys.readouterr().err


class TestParquet:
    def test_one_data_set_by_campaign_and_channel(self, folder):
        found = sorted(str(p.relative_to(folder)) for p in folder.glob("light_curves/**/*.parquet"))
        assert found == [
            "light_curves/campaign=c05/channel=40/star0.parquet",
            "light_curves/campaign=c05/channel=40/star2.parquet",
            "light_curves/campaign=c05/channel=41/star1.parquet",
        ]

    def test_pandas_reads_it(self, folder, made, tmp_path):
        import pandas as pd

        frame = pd.read_parquet(folder / "light_curves").sort_values("key")
        assert frame["mag"].tolist() == [11, 12, 13]
        assert frame["campaign"].tolist() == ["c05"] * 3
        detrend(made[:1], tmp_path)
        with fits.open(tmp_path / "star0-lc.fits") as hdus:
            curve = frame["light_curve"].iloc[0]
            for name in ("TIME", "FLUX", "FLUX_ERR", "RAW_FLUX", "CADENCENO"):
                np.testing.assert_array_equal(curve[name.lower()], hdus[1].data[name])

    def test_the_column_is_a_struct_of_lists(self, folder):
        import pyarrow.dataset as ds
        from pyarrow import types

        column = ds.dataset(folder / "light_curves").schema.field("light_curve").type
        assert types.is_struct(column)
        assert all(types.is_list(field.type) for field in column)

    def test_partitions_are_chosen_without_reading_the_others(self, folder):
        import pandas as pd

        frame = pd.read_parquet(folder / "light_curves", filters=[("channel", "=", 41)])
        assert frame["key"].tolist() == ["star1"]

    def test_is_readable_after_a_crash(self, folder, tmp_path):
        """A file that a worker was writing has a hidden name, which readers leave out."""
        copy = tmp_path / "copy"
        shutil.copytree(folder, copy)
        part = copy / "light_curves" / "campaign=c05" / "channel=40"
        (part / ".scope-models-0123.parquet").write_bytes(b"PAR1 half of a file")
        for name in ("results.ecsv", "summary.ecsv", "results.sqlite"):
            (copy / name).unlink()
        assert read_results(copy)["key"].tolist() == ["star0", "star1", "star2"]

    @pytest.mark.slow
    def test_many_stars_by_many_workers_after_a_crash(self, tmp_path):
        """10,000 stars by four processes, which are killed, and begin again."""
        pytest.importorskip("pyarrow")
        import pandas as pd

        context, data = multiprocessing.get_context("spawn"), tmp_path / "light_curves"

        def written():
            return {int(path.stem[4:]) for path in data.glob("*/*/star*.parquet")}

        def begin():
            missing = sorted(set(range(10_000)) - written())
            shares = [missing[first::4] for first in range(4)]
            workers = [context.Process(target=write_rows, args=(tmp_path, n)) for n in shares]
            for worker in workers:
                worker.start()
            return workers

        def check(number):
            frame = pd.read_parquet(data)
            assert len(frame) == number == len(read_results(tmp_path))
            numbers = frame["key"].str[4:].astype(int)
            assert numbers.nunique() == number
            assert np.allclose(frame["mag"], numbers / 1e3, rtol=1e-12)
            for n, curve in zip(numbers, frame["light_curve"], strict=True):
                np.testing.assert_array_equal(curve["time"], np.arange(20.0) + n)
                np.testing.assert_array_equal(curve["flux"], 2 * np.arange(20.0) + 2 * n)

        workers, limit = begin(), time.monotonic() + 600
        while len(written()) < 2000:
            assert time.monotonic() < limit
            time.sleep(0.5)
        for worker in workers:
            worker.kill()
            worker.join()
        assert len(written()) < 10_000
        check(len(written()))
        for worker in begin():
            worker.join()
            assert worker.exitcode == 0
        check(10_000)

    def test_a_data_set_that_exists(self, folder, made, tmp_path):
        shutil.copytree(folder / "light_curves", tmp_path / "light_curves")
        with pytest.raises(FileExistsError, match="light_curves exists already"):
            detrend(made, tmp_path, format="parquet")
        assert len(detrend(made[:1], tmp_path, format="parquet", overwrite=True).table) == 1

    def test_no_campaign_and_no_channel(self, tmp_path):
        pytest.importorskip("pyarrow")
        path = make(tmp_path / "star.fits", 1)
        with fits.open(path, mode="update") as hdus:
            for hdu in hdus[:2]:
                for keyword in ("CAMPAIGN", "CHANNEL"):
                    hdu.header.remove(keyword, ignore_missing=True)
                hdu.add_checksum()
        detrend([path], tmp_path / "out", format="parquet")
        (tmp_path / "out" / "results.sqlite").unlink()
        assert read_results(tmp_path / "out")["key"].tolist() == ["star"]

    def test_without_pyarrow(self, made, tmp_path, monkeypatch):
        monkeypatch.setitem(__import__("sys").modules, "pyarrow", None)
        with pytest.raises(ModuleNotFoundError, match=r"scope_models\[parquet\]"):
            detrend(made, tmp_path, format="parquet")

    def test_both_formats_give_the_same_results(self, folder, collection):
        a, b = (read_results(path, light_curves=True) for path in (folder, collection[0]))
        for name in ("key", "cdpp", "raw_cdpp", "mag", "campaign", "channel"):
            np.testing.assert_array_equal(a[name], b[name])
        assert a["cdpp"].unit == b["cdpp"].unit == u.cds.ppm
        for one, other in zip(a["light_curve"], b["light_curve"], strict=True):
            assert one["flux"].unit == other["flux"].unit == u.electron / u.s
            np.testing.assert_array_equal(one["flux"], other["flux"])


class TestResults:
    def test_of_a_run_that_was_interrupted(self, made, tmp_path, monkeypatch):
        def stop(*_, **__):
            raise KeyboardInterrupt

        from scope_models.batch import sweep

        monkeypatch.setattr(sweep, "_table", stop)
        with pytest.raises(KeyboardInterrupt):
            detrend(made, tmp_path)
        table = read_results(tmp_path)
        assert table["key"].tolist() == ["star0", "star1", "star2"]
        assert table["cdpp"].unit == "ppm"

    def test_seconds_and_memory(self, collection):
        table = collection[1].table
        assert ((table["seconds"] > 0.01) & (table["seconds"] < 60)).all()
        assert ((table["peak_memory"] > 50) & (table["peak_memory"] < 4000)).all()
        assert table["peak_memory"].unit == u.Mibyte
        assert "seconds" not in collection[1].summary.colnames

    def test_no_results(self, tmp_path):
        with pytest.raises(FileNotFoundError, match="is not a results directory"):
            read_results(tmp_path)
        (tmp_path / "results.sqlite").write_bytes(b"damaged" * 1000)
        with pytest.raises(ValueError, match="is damaged"):
            read_results(tmp_path)


class TestTransits:
    def test_are_left_out_of_the_fit(self, injected, tmp_path):
        path, planet = injected
        mask = {name: [planet[name]] for name in ("period", "t0", "duration")}
        result = detrend([path], tmp_path, planets=mask)
        assert result.table["period"].tolist() == [1.7]
        with fits.open(tmp_path / "planet-lc.fits") as hdus:
            phase = (hdus[1].data["TIME"] - 2145.0 + 0.85) % 1.7 - 0.85
            inside = np.abs(phase) <= 0.15
            assert inside.sum() > 20
            assert not hdus[1].data["IN_FIT"][inside].any()
            assert hdus[1].data["IN_FIT"][~inside].mean() > 0.9

    def test_command_of_one_file_and_of_many(self, injected, tmp_path, capsys):
        path, _ = injected
        mask = ["--period", "1.7", "--t0", "2145", "--duration", "0.3", "--order", "1"]
        one = tmp_path / "one.fits"
        assert main(["detrend", str(path), "--output", str(one), *mask]) == 0
        assert main(["detrend", str(path), "--output-dir", str(tmp_path / "many"), *mask]) == 0
        with fits.open(one) as a, fits.open(tmp_path / "many" / "planet-lc.fits") as b:
            np.testing.assert_array_equal(a[1].data["FLUX"], b[1].data["FLUX"])
        assert main(["detrend", str(path), "--output", str(one), "--period", "1.7"]) == 2
        assert "needs --period, --t0 and --duration" in capsys.readouterr().err

    def test_no_duration(self, injected, tmp_path):
        from scope_models.correctors import detrend_file

        with pytest.raises(ValueError, match="`planets` lacks the column duration"):
            detrend([injected[0]], tmp_path, planets={"period": [1.7], "t0": [2145.0]})
        planet = {"period": -1.0, "t0": 2145.0, "duration": 0.1}
        with pytest.raises(ValueError, match=r"`transits` must have positive days, got -1.0"):
            detrend_file(injected[0], tmp_path / "lc.fits", transits=planet)


class TestCommand:
    def test_aperture(self, made, tmp_path):
        out = tmp_path / "lc.fits"
        command = ["detrend", str(made[0]), "--output", str(out), "--aperture", "pipeline"]
        assert main([*command, "--order", "1"]) == 0
        with fits.open(out) as lc, fits.open(made[0]) as tpf:
            assert ((lc["APERTURE"].data & 2 > 0) == (tpf["APERTURE"].data & 2 > 0)).all()

    @pytest.mark.filterwarnings("ignore::scope_models.exceptions.DetrendingWarning")
    @pytest.mark.parametrize("sky", [False, True])
    def test_light_of_the_neighbors_of_a_catalog(self, tmp_path, sky):
        """The corrected light curve is that of the target; without its neighbor in it, of both."""
        from scope_models import Scene

        catalog, path = tmp_path / "stars.csv", tmp_path / "two.fits"
        stars = Star(12, 4.0, 4.0), Star(13.5, 7.5, 4.5)
        place = {"ra": 150.0, "dec": 10.0} if sky else {}
        motion = Motion.k2_roll(300, seed=1)
        simulate(Scene(stars, Detector.k2(shape=(9, 12)), motion, **place), seed=1).write(path)
        catalog.write_text("x,y\n7.5,4.5\n80,3\n")
        if sky:  # a catalog has the target, too
            with fits.open(path) as hdus:
                wcs = WCS(hdus["APERTURE"].header)
            rows = wcs.pixel_to_world_values([4.0, 7.5, 80.0], [4.0, 4.5, 3.0])
            Table(rows, names=["ra", "dec"]).write(catalog, overwrite=True)
        command = ["detrend", str(path), "--aperture", "all"]
        share = {}
        Table.read(catalog)[-1:].write(tmp_path / "far.csv")
        runs = ("with", catalog), ("without", tmp_path / "far.csv")
        for name, file in runs[: 2 - sky]:
            more = ["--output-dir", str(tmp_path / name), "--neighbors", str(file)]
            assert main([*command, *more]) == 0
            with fits.open(tmp_path / name / "two-lc.fits") as hdus:
                data = hdus[1].data
                share[name] = np.nanmedian(data["FLUX"]) / np.nanmedian(data["RAW_FLUX"])
        # the level of the background is a part of the model
        assert share["with"] == pytest.approx(1 / (1 + 10 ** (-0.4 * 1.5)), abs=0.025)
        if sky:
            return
        assert share["without"] == pytest.approx(1, abs=0.01)
        one = tmp_path / "one.fits"
        assert main([*command, "--output", str(one), "--neighbors", str(catalog)]) == 0
        with fits.open(one) as a, fits.open(tmp_path / "with" / "two-lc.fits") as b:
            np.testing.assert_array_equal(a[1].data["FLUX"], b[1].data["FLUX"])

    def test_neighbors_of_a_catalog(self, tmp_path):
        """Stars outside of the pixels, and the target itself, are no neighbors."""
        from scope_models import Scene

        detector = Detector.k2(shape=(9, 11))
        stars = Star(12, 4.0, 4.0), Star(13.5, 7.5, 4.5)
        path = tmp_path / "two.fits"
        simulate(Scene(stars, detector, Motion.k2_roll(60, seed=1)), seed=1).write(path)
        catalog = tmp_path / "catalog.csv"
        catalog.write_text("x,y\n4.0,4.0\n7.5,4.5\n80,3\n")
        command = ["fit", str(path), "--output", str(tmp_path / "fit.fits"), "--components", "1"]
        assert main([*command, "--neighbors", str(catalog)]) == 0
        chi2 = {}
        for name, neighbors in (("with", str(catalog)), ("without", None)):
            options = {"psf": 1, "response": "psf", "neighbors": neighbors, "sweep": QUIET}
            result = fit_files([path], tmp_path / name, **options)
            chi2[name] = result.table["reduced_chi2"][0]
        assert chi2["with"] == pytest.approx(1, abs=0.2)
        assert chi2["without"] > 3
