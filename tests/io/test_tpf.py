"""Target pixel files: layout, checks, truth, and what lightkurve makes of them."""

import gc
import gzip
import json
import time
import warnings
import weakref

import numpy as np
import pytest
from astropy import units as u
from astropy.coordinates import SkyCoord
from astropy.io import fits
from astropy.table import Table
from astropy.time import Time
from astropy.units import UnitsWarning
from astropy.wcs import WCS

from scope_models.io import TPFMetadata, read_pixels, read_truth, write_tpf
from scope_models.io._truth import truth_blocks
from scope_models.io.tpf import make_tpf_hdulist, write_hdulist

MISSIONS = ["Kepler", "K2", "TESS"]
KEPLER_FRAMES = {
    "pixel_scale": 3.98,
    "int_time": 6.019802903270,
    "read_time": 0.518948526144,
    "n_frames": 270,
    "gain": 110.0,
    "read_noise": 90.0,
    "fixed_offset": 419400,
    "mean_black": 720,
}
TESS_FRAMES = {
    "pixel_scale": 21.0,
    "int_time": 1.98,
    "read_time": 0.02,
    "n_frames": 60,
    "n_readouts": 48,
    "gain": 5.25,
    "read_noise": 10.0,
    "fixed_offset": 209700,
    "mean_black": 6812,
}
FIELDS = {
    "Kepler": {**KEPLER_FRAMES, "quarter": 5, "channel": 20},
    "K2": {**KEPLER_FRAMES, "campaign": 18, "channel": 48},
    "TESS": {**TESS_FRAMES, "sector": 15, "camera": 2, "ccd": 3},
}
REAL_FILES = {
    "K2 C18": "k2_tpf/ktwo211983544-c18_lpd-targ.fits.gz",
    "K2 C5": "k2_tpf/ktwo211956421-c05_lpd-targ.fits.gz",
    "Kepler": "kepler_tpf/kplr009002278-2010174085026_lpd-targ.fits.gz",
    "TESS": "tess_tpf/tesssip_tpf1.fits",
}
# Keywords that our files have and an archive file may not.
OURS = {
    "SIMDATA",  # only TESS has it; ours are all simulated
    "SEED",  # how to make the file again
    "DATASUM",  # archive files before 2020 have only CHECKSUM
    "MISSION",  # Kepler files of format 3.0 lack it; lightkurve reads it
    "TTABLEID",  # the same
    *(f"RBTDUR{n}" for n in range(1, 6)),  # campaign 5 has no rolling bands, 18 has
}
# Keywords of an archive file that ours do not have.
THEIRS = {"PDCSAPFL"}  # a flag of the light-curve pipeline, there twice, in format 3.0 only


def metadata_of(mission, **changes):
    return TPFMetadata(mission=mission, target_id=42, **(FIELDS[mission] | changes))


def contents_of(mission, n=60, shape=(11, 11), seed=1, **changes):
    """Return a Gaussian star on a moving path, with white noise and a transit."""
    rng = np.random.default_rng(seed)
    metadata = metadata_of(mission, column=740, row=796, magnitude=12.0)
    ny, nx = shape
    number = np.arange(n)
    drift = 0.4 * ((number % 12) / 12 - 0.5)
    x = (nx - 1) / 2 + drift
    y = (ny - 1) / 2 - 0.5 * drift + 0.1 * np.sin(number / 40)
    relative = np.where(number % 100 < 6, 0.995, 1.0)
    rows, columns = np.mgrid[:ny, :nx]
    distance2 = (columns - x[:, None, None]) ** 2 + (rows - y[:, None, None]) ** 2
    expected = 1.74e5 * relative[:, None, None] * np.exp(-distance2 / 1.28) / (1.28 * np.pi)
    error = np.sqrt((expected + 250) / 1600 + 0.8)
    flux = rng.normal(expected, error)
    timecorr = np.full(n, 0.004)
    return {
        "metadata": metadata,
        "time": 2000.0 + number * metadata.cadence_days,
        "timecorr": timecorr,
        "cadenceno": 100 + number,
        "raw_cnts": np.rint(419400 + (flux + 250) * 14).astype(int),
        "flux": flux,
        "flux_err": error,
        "flux_bkg": np.full(flux.shape, 250.0),
        "flux_bkg_err": np.full(flux.shape, 0.1),
        "quality": np.zeros(n, dtype=int),
        "pos_corr1": x - x.mean(),
        "pos_corr2": y - y.mean(),
        "aperture": np.hypot(columns - (nx - 1) / 2, rows - (ny - 1) / 2) < 2.5,
        "truth_columns": {"X": x, "Y": y, "FLUX": relative},
        "truth_maps": {"INTERPIX": rng.uniform(0.99, 1.01, shape)},
        "scene": {"stars": [{"mag": 12.0, "psf": None}], "note": 'quotes " and \u00e9', "seed": 3},
        **changes,
    }


@pytest.fixture(scope="module", params=MISSIONS)
def mission(request):
    return request.param


@pytest.fixture(scope="module")
def path(mission, tmp_path_factory):
    return write_tpf(
        tmp_path_factory.mktemp("tpf") / f"{mission}.fits", **contents_of(mission, n=400)
    )


class TestLayout:
    @pytest.mark.parametrize("name", REAL_FILES)
    def test_keywords_are_those_of_the_archive(self, name, shared_data):
        hdus = make_tpf_hdulist(**contents_of(name.split()[0]))
        with fits.open(shared_data / REAL_FILES[name]) as real:
            for index, hdu in enumerate(real):
                theirs, ours = set(hdu.header), set(hdus[index].header)
                checksums = {"CHECKSUM", "DATASUM"}  # only when written
                assert hdu.name == hdus[index].name
                assert theirs - ours - checksums <= THEIRS
                assert ours - theirs <= OURS
                same = [key for key in hdu.header if key in ours]
                kinds = [
                    key
                    for key in same
                    if isinstance(hdu.header[key], str) != isinstance(hdus[index].header[key], str)
                    and hdus[index].header[key] is not None
                    and hdu.header[key] is not None
                ]
                assert kinds == []

    @pytest.mark.parametrize("name", REAL_FILES)
    def test_columns_are_those_of_the_archive(self, name, shared_data):
        with fits.open(shared_data / REAL_FILES[name]) as real:
            shape = real["APERTURE"].data.shape
            hdus = make_tpf_hdulist(**contents_of(name.split()[0], shape=shape))
            attributes = ["name", "format", "unit", "disp", "dim", "null"]
            theirs = [[getattr(c, a) for a in attributes] for c in real[1].columns]
            ours = [[getattr(c, a) for a in attributes] for c in hdus[1].columns]
        if name == "Kepler":  # its B16.16 has no room for bit 65536
            theirs[9][3] = "B24.24"
        if name == "K2 C5":  # no rolling bands: a column of no width, which astropy cannot write
            theirs[12][1], theirs[12][4] = f"{5 * shape[0]}E", f"(5,{shape[0]})"
        assert ours == theirs

    def test_fixed_values_are_those_of_the_archive(self, shared_data):
        fixed = "TELESCOP INSTRUME RADESYS EQUINOX TIMEREF TASSIGN TIMESYS BJDREFI BJDREFF TIMEUNIT"
        fixed += " INT_TIME READTIME FRAMETIM NUM_FRM NREADOUT TIMEPIXR BACKAPP DEADAPP OBSMODE"
        fixed += " MISSION CHANNEL MODULE OUTPUT CAMPAIGN SEASON QUARTER FILEVER CAMERA CCD SECTOR"
        fixed += " WCSAXES CTYPE1 CUNIT2 CTYPE1P CDELT1P CRPIX2P WCSN5P 1CTY6P WCAX7 1CTYP8"
        for name in ("K2 C18", "Kepler", "TESS"):
            hdus = make_tpf_hdulist(**contents_of(name.split()[0]))
            with fits.open(shared_data / REAL_FILES[name]) as real:
                for ours, theirs in zip(hdus[:3], real[:3], strict=True):
                    same = [key for key in fixed.split() if key in theirs.header]
                    for key in same:
                        expected = theirs.header[key]
                        if isinstance(expected, float):
                            expected = pytest.approx(expected, rel=1e-12)
                        assert ours.header[key] == expected, key
                table = real[1].header
                assert hdus[1].header["TIMEDEL"] == pytest.approx(table["TIMEDEL"], rel=1e-8)
                assert hdus[1].header["DEADC"] == pytest.approx(table["DEADC"], rel=1e-7)

    def test_every_card_has_a_comment_and_fits(self, mission):
        for hdu in make_tpf_hdulist(**contents_of(mission))[:3]:
            assert [card.keyword for card in hdu.header.cards[6:] if not card.comment] == []
            assert {len(str(card)) for card in hdu.header.cards} == {80}

    def test_checksums_and_verification(self, path):
        with fits.open(path, checksum=True) as hdus:
            hdus.verify("exception")
            for hdu in hdus:
                assert hdu.verify_checksum() == hdu.verify_datasum() == 1

    def test_time_cards(self, mission):
        contents = contents_of(mission, n=100)
        contents["time"][[0, 40]] = np.nan
        contents["flux"][50] = np.nan
        contents["flux_err"][50] = np.nan
        header = make_tpf_hdulist(**contents)[1].header
        delta = header["TIMEDEL"]
        first, last = contents["time"][[1, -1]]
        assert header["TSTART"] == pytest.approx(first - delta / 2, abs=1e-9)
        assert header["TELAPSE"] == pytest.approx(99 * delta, abs=1e-9)
        assert header["LIVETIME"] == pytest.approx(99 * delta * header["DEADC"], abs=1e-9)
        assert header["EXPOSURE"] == pytest.approx(97 * delta * header["DEADC"], abs=1e-9)
        stop = Time(header["DATE-END"], scale="utc").tdb.jd - header["BJDREFI"]
        assert stop == pytest.approx(header["TSTOP"], abs=1e-7)
        if mission != "TESS":
            assert header["LC_START"] == pytest.approx(first - 0.004 + 54832.5, abs=1e-6)
            assert header["LC_END"] == pytest.approx(last - 0.004 + 54832.5, abs=1e-6)

    def test_short_cadence(self):
        contents = contents_of("Kepler", metadata=metadata_of("Kepler", n_frames=9))
        contents["time"] = 2000 + 0.000681 * np.arange(60)
        hdus = make_tpf_hdulist(**contents)
        assert hdus[0].header["OBSMODE"] == "short cadence"
        assert hdus[1].header["SCFXDOFF"] == 419400
        assert hdus[1].header["LCFXDOFF"] is None
        assert "SC_START" in hdus[1].header

    def test_aperture(self, mission):
        contents = contents_of(mission)
        image = make_tpf_hdulist(**contents)["APERTURE"]
        assert image.data.dtype.kind == "i"
        assert np.array_equal(image.data, np.where(contents["aperture"], 3, 1))
        assert image.header["NPIXSAP"] == contents["aperture"].sum()
        bits = np.full((11, 11), 5)
        bits[3, 4] = 2
        image = make_tpf_hdulist(**(contents | {"aperture": bits}))["APERTURE"]
        assert np.array_equal(image.data, bits)
        assert (image.header["NPIXSAP"], image.header["NPIXMISS"]) == (1, 1)
        assert np.all(make_tpf_hdulist(**(contents | {"aperture": None}))["APERTURE"].data == 1)

    def test_extra_cards(self):
        extra = {"TEFF": 5000, "CROWDSAP": (0.9, "measured"), "OBSERVER": "nobody", "history": "a"}
        hdus = make_tpf_hdulist(**contents_of("K2", metadata=metadata_of("K2", extra_cards=extra)))
        assert hdus[0].header["TEFF"] == 5000
        assert hdus[0].header.comments["TEFF"] == "[K] effective temperature"
        assert hdus[1].header["CROWDSAP"] == 0.9
        assert hdus[1].header.comments["CROWDSAP"] == "measured"
        assert hdus[0].header["OBSERVER"] == "nobody"
        assert hdus[0].header["HISTORY"][0] == "a"

    def test_large_seed_is_text(self):
        contents = contents_of("K2", metadata=metadata_of("K2", seed=2**120))
        assert int(make_tpf_hdulist(**contents)[0].header["SEED"]) == 2**120


class TestData:
    def test_values_are_what_went_in(self, mission):
        contents = contents_of(mission)
        rows = make_tpf_hdulist(**contents)[1].data
        assert np.array_equal(rows["TIME"], contents["time"])
        for name in ("FLUX", "FLUX_ERR", "FLUX_BKG", "FLUX_BKG_ERR", "POS_CORR1", "POS_CORR2"):
            assert np.array_equal(rows[name], contents[name.lower()].astype(np.float32)), name
        for name in ("RAW_CNTS", "CADENCENO", "QUALITY"):
            assert np.array_equal(rows[name], contents[name.lower()]), name
            assert rows[name].dtype.itemsize == 4

    def test_layout_of_memory_does_not_matter(self):
        contents = contents_of("K2")
        expected = make_tpf_hdulist(**contents)[1].data["FLUX"]
        for flux in (
            np.asfortranarray(contents["flux"]),
            contents["flux"][:, ::-1, ::-1][:, ::-1, ::-1],
            contents["flux"].astype(">f4"),
            contents["flux"].astype(np.float32),
        ):
            hdus = make_tpf_hdulist(**(contents | {"flux": flux}))
            assert np.array_equal(hdus[1].data["FLUX"], expected)

    def test_memory_is_given_back(self, mission):
        hdulist = make_tpf_hdulist(**contents_of(mission))
        assert hdulist[1].columns["FLUX"].array.shape == hdulist[1].data["FLUX"].shape
        tables = [weakref.ref(hdu.data) for hdu in hdulist[1:]]
        del hdulist
        gc.collect()
        assert all(table() is None for table in tables)

    def test_what_is_absent(self):
        contents = contents_of("K2", raw_cnts=None, timecorr=None, flux_bkg=3.0, flux_bkg_err=0)
        hdus = make_tpf_hdulist(**contents)
        rows = hdus[1].data
        assert np.all(rows["RAW_CNTS"] == -1)
        for name in ("TIMECORR", "COSMIC_RAYS", "RB_LEVEL"):
            assert np.all(np.isnan(rows[name])), name
        assert np.all(rows["FLUX_BKG"] == 3.0)
        assert hdus[1].header["LC_START"] is None

    def test_arguments_are_not_shared(self):
        contents = contents_of("K2")
        hdus = make_tpf_hdulist(**contents)
        before = contents["flux"].copy()
        hdus[1].data["FLUX"][:] = 0
        hdus["APERTURE"].data[:] = 0
        hdus["INTERPIX"].data[:] = 0
        assert np.array_equal(contents["flux"], before)
        assert contents["aperture"].any()
        assert contents["truth_maps"]["INTERPIX"].all()

    def test_cadences_without_time_are_flagged(self, mission):
        contents = contents_of(mission)
        contents["time"][7] = np.nan
        contents["quality"][7:9] = 8
        quality = make_tpf_hdulist(**contents)[1].data["QUALITY"]
        # TESS has no such bit; lightkurve drops cadences without a time by itself there.
        assert quality[7:10].tolist() == [8 if mission == "TESS" else 65544, 8, 0]

    def test_cosmic_rays(self, mission):
        rays = np.full((60, 11, 11), np.nan)
        rays[3, 2, 4] = 50.0
        hdus = make_tpf_hdulist(**contents_of(mission, cosmic_rays=rays))
        if mission == "TESS":
            assert hdus["TARGET COSMIC RAY"].data.tolist() == [[103, 744, 798, 50.0]]
        else:
            assert np.array_equal(hdus[1].data["COSMIC_RAYS"], rays, equal_nan=True)


class TestSky:
    @pytest.mark.parametrize("orientation", [0.0, 90.0, -37.0])
    def test_projection(self, orientation):
        metadata = metadata_of(
            "TESS", ra=359.999, dec=-60.0, x_0=3.0, y_0=4.5, orientation=orientation
        )
        hdus = make_tpf_hdulist(**contents_of("TESS", metadata=metadata))
        wcs = WCS(hdus["APERTURE"].header)
        center = wcs.pixel_to_world(3.0, 4.5)
        target = SkyCoord(359.999, -60.0, unit="deg")
        assert center.separation(target).arcsec < 1e-6
        up = wcs.pixel_to_world(3.0, 14.5)
        left = wcs.pixel_to_world(-7.0, 4.5)
        assert target.separation(up).arcsec == pytest.approx(210.0, rel=1e-6)
        assert target.position_angle(up).deg == pytest.approx(orientation % 360, abs=1e-6)
        assert target.position_angle(left).deg == pytest.approx((orientation + 90) % 360, abs=1e-6)

    def test_each_column_agrees_with_the_aperture(self, mission):
        hdus = make_tpf_hdulist(
            **contents_of(mission, metadata=metadata_of(mission, orientation=20))
        )
        table, image = hdus[1].header, hdus["APERTURE"].header
        pixels = [i for i, c in enumerate(hdus[1].columns, 1) if c.dim and c.name != "RB_LEVEL"]
        assert pixels == list(range(4, 9 if mission == "TESS" else 10))
        for n in pixels:
            for axis in "12":
                pairs = {
                    "CTYP": "CTYPE",
                    "CRPX": "CRPIX",
                    "CRVL": "CRVAL",
                    "CUNI": "CUNIT",
                    "CDLT": "CDELT",
                }
                for short, long in pairs.items():
                    assert table[f"{axis}{short}{n}"] == image[f"{long}{axis}"]
                for other in "12":
                    assert table[f"{axis}{other}PC{n}"] == image[f"PC{axis}_{other}"]
                assert table[f"{axis}CRV{n}P"] == image[f"CRVAL{axis}P"]


class TestTruth:
    def test_exactly_what_went_in(self, mission, tmp_path):
        contents = contents_of(mission)
        contents["truth_columns"]["stars"] = np.arange(120.0).reshape(60, 2) / 3
        contents["truth_columns"]["X"][3] = np.nan
        flags = contents["truth_columns"]["QUALITY"] = np.arange(60, dtype=np.int32)
        hdus = make_tpf_hdulist(**contents)
        path = write_hdulist(hdus, tmp_path / "star.fits")
        compressed = write_tpf(tmp_path / "star.fits.gz", **contents)
        for source in (path, str(path), compressed, hdus):
            truth = read_truth(source)
            assert truth.table.colnames == ["CADENCENO", "X", "Y", "FLUX", "stars", "QUALITY"]
            assert np.array_equal(truth.table["CADENCENO"], contents["cadenceno"])
            for name, values in contents["truth_columns"].items():
                assert truth.table[name].dtype == (np.int32 if values is flags else np.float64)
                assert np.array_equal(truth.table[name], values, equal_nan=True)
            assert list(truth.maps) == ["INTERPIX"]
            assert np.array_equal(truth.maps["INTERPIX"], contents["truth_maps"]["INTERPIX"])
            assert truth.scene == contents["scene"]

    def test_cadences_can_be_chosen(self):
        truth = read_truth(make_tpf_hdulist(**contents_of("K2")))
        chosen = truth.at_cadences([110, 103])
        assert np.array_equal(chosen["X"], truth.table["X"][[10, 3]])
        with pytest.raises(ValueError, match="must be cadences of the truth, got 99"):
            truth.at_cadences([100, 99])

    @pytest.mark.parametrize("part", ["truth_columns", "truth_maps", "scene"])
    def test_one_part_is_enough(self, part):
        contents = contents_of("K2")
        nothing = {"truth_columns": None, "truth_maps": None, "scene": None}
        hdus = make_tpf_hdulist(**(contents | nothing | {part: contents[part]}))
        truth = read_truth(hdus)
        assert len(truth.table) == 60
        assert bool(truth.maps) == (part == "truth_maps")
        assert bool(truth.scene) == (part == "scene")

    def test_empty_scene(self):
        assert read_truth(make_tpf_hdulist(**contents_of("K2", scene={}))).scene == {}

    def test_file_without_truth(self, shared_data, tmp_path):
        contents = contents_of("TESS", truth_columns=None, truth_maps=None, scene=None)
        path = write_tpf(tmp_path / "bare.fits", **contents)
        for source in (path, shared_data / REAL_FILES["K2 C5"]):
            with pytest.raises(ValueError, match=f"{source.name} holds no truth"):
                read_truth(source)
        with pytest.raises(ValueError, match="holds no truth"):
            read_truth(make_tpf_hdulist(**contents))

    def test_broken_files(self, tmp_path):
        path = write_tpf(tmp_path / "star.fits", **contents_of("K2"))
        whole = path.read_bytes()
        broken = tmp_path / "broken.fits"
        for part in (b"", b"no FITS file", whole[: len(whole) // 3], whole[:-6000]):
            broken.write_bytes(part)
            with pytest.raises(ValueError, match=r"broken\.fits"):
                read_truth(broken)
        (tmp_path / "broken.fits.gz").write_bytes(gzip.compress(whole)[:-5000])
        with pytest.raises(ValueError, match=r"broken\.fits\.gz"):
            read_truth(tmp_path / "broken.fits.gz")
        with pytest.raises(FileNotFoundError, match=r"absent\.fits"):
            read_truth(tmp_path / "absent.fits")

    @pytest.mark.parametrize(
        "change, error, message",
        [
            (
                {"truth_columns": {"X": np.zeros(59)}},
                ValueError,
                "`truth_columns` X must have a row",
            ),
            ({"truth_columns": {"cadenceno": np.zeros(60)}}, ValueError, "which is taken"),
            ({"truth_columns": {"X": np.zeros(60), "x": np.zeros(60)}}, ValueError, "taken"),
            ({"truth_columns": {"": np.zeros(60)}}, ValueError, "must have names"),
            ({"truth_maps": {"FLAT": np.zeros(5)}}, ValueError, "FLAT must be an image"),
            ({"truth_maps": {"aperture": np.zeros((2, 2))}}, ValueError, "which is taken"),
            ({"scene": [1]}, TypeError, "`scene` must be a dict"),
            ({"scene": {"a": {1, 2}}}, TypeError, "`scene` must hold what JSON can"),
            ({"scene": {"a ": 1}}, TypeError, "`scene` must be a dict"),
        ],
    )
    def test_bad_truth(self, change, error, message):
        with pytest.raises(error, match=message):
            make_tpf_hdulist(**contents_of("K2", **change))


def changed(values, index, value):
    """Return a copy of an array with another value at one place."""
    copy = np.array(values)
    copy[index] = value
    return copy


class TestChecks:
    @pytest.mark.parametrize(
        "name, index, value, message",
        [
            ("time", 5, 2000.0, "`time` must increase"),
            ("time", 5, np.inf, "`time` must not be infinite"),
            ("time", slice(None), np.nan, "`time` must have a finite value"),
            ("time", -1, 2456789.0, "`time` must be BJD - 2454833 in days"),
            ("cadenceno", 5, 100, "`cadenceno` must increase"),
            ("cadenceno", 0, 0, "`cadenceno` must increase from at least 1, got 0"),
            ("cadenceno", -1, 2**31, "`cadenceno` must fit into 32 bits"),
            ("raw_cnts", (0, 0, 0), 2**31, "`raw_cnts` must fit into 32 bits"),
            ("raw_cnts", (0, 0, 0), -2, "`raw_cnts` must not be negative"),
            ("flux", (3, 0, 0), np.inf, "`flux` must not be infinite"),
            ("flux", (3, 0, 0), -1e39, "`flux` must .* fit into single precision"),
            ("flux_err", (3, 0, 0), 0.0, "`flux_err` must be positive, got 0.0"),
            ("flux_err", (3, 0, 0), -1.0, "`flux_err` must be positive, got -1.0"),
            ("flux_err", (3, 0, 0), np.nan, "`flux_err` must not be NaN where `flux` is not"),
            ("flux_bkg_err", (3, 0, 0), -1.0, "`flux_bkg_err` must not be negative"),
            ("quality", 5, -1, "`quality` must not be negative"),
            ("pos_corr1", 5, -np.inf, "`pos_corr1` must not be infinite"),
        ],
    )
    def test_values(self, name, index, value, message):
        contents = contents_of("K2")
        with pytest.raises(ValueError, match=message):
            make_tpf_hdulist(**(contents | {name: changed(contents[name], index, value)}))

    @pytest.mark.parametrize(
        "name",
        [
            "time",
            "timecorr",
            "cadenceno",
            "raw_cnts",
            "flux_err",
            "flux_bkg",
            "quality",
            "pos_corr1",
            "aperture",
        ],
    )
    def test_shapes(self, name):
        contents = contents_of("K2")
        with pytest.raises(ValueError, match=rf"`{name}` must (have|fit) the shape \("):
            make_tpf_hdulist(**(contents | {name: contents[name][:-1]}))

    def test_flux_is_a_cube_with_cadences(self):
        for flux in (np.zeros((60, 121)), np.zeros((0, 11, 11))):
            with pytest.raises(ValueError, match="`flux` must have the shape"):
                make_tpf_hdulist(**contents_of("K2", flux=flux))

    @pytest.mark.parametrize(
        "name, value",
        [
            ("raw_cnts", np.zeros((60, 11, 11))),
            ("quality", np.zeros(60)),
            ("aperture", np.ones((11, 11))),
        ],
    )
    def test_integers(self, name, value):
        with pytest.raises(TypeError, match=f"`{name}` must (be of booleans or|hold) integers"):
            make_tpf_hdulist(**contents_of("K2", **{name: value}))

    def test_numbers(self):
        with pytest.raises(TypeError, match="`flux_bkg` must be an array of numbers"):
            make_tpf_hdulist(**contents_of("K2", flux_bkg="dark"))
        with pytest.raises(TypeError, match="`metadata` must be a TPFMetadata"):
            make_tpf_hdulist(**contents_of("K2", metadata={}))
        with pytest.raises(ValueError, match="`aperture` must not be negative"):
            make_tpf_hdulist(**contents_of("K2", aperture=np.full((11, 11), -1)))

    @pytest.mark.parametrize(
        "mission, change, error, message",
        [
            (
                "K2",
                {"mission": "k3"},
                ValueError,
                "`mission` must be one of 'Kepler', 'K2'",
            ),
            ("K2", {"target_id": 0}, ValueError, "`target_id` must be at least 1"),
            ("K2", {"target_id": "7"}, TypeError, "`target_id` must be an integer"),
            ("K2", {"pixel_scale": 0}, ValueError, "`pixel_scale` must be positive"),
            ("K2", {"pixel_scale": "4"}, TypeError, "`pixel_scale` must be a number"),
            ("K2", {"ra": np.nan}, ValueError, "`ra` must be finite"),
            ("K2", {"dec": 91.0}, ValueError, "`dec` must not be above 90, got 91"),
            ("K2", {"sector": 3}, ValueError, "`sector` must not be given for K2"),
            ("TESS", {"channel": 3}, ValueError, "`channel` must not be given for TESS"),
            ("K2", {"channel": 85}, ValueError, "`channel` must be at most 84"),
            ("K2", {"channel": 48, "module": 13}, ValueError, "`module` must be 14 for channel 48"),
            ("K2", {"channel": None, "module": 5}, ValueError, "`module` must be one of"),
            ("TESS", {"camera": 5}, ValueError, "`camera` must be at most 4"),
            ("TESS", {"n_readouts": 61}, ValueError, "`n_readouts` must not exceed"),
            ("K2", {"object_name": "\u00e9toile"}, TypeError, "`object_name` must be ASCII"),
            ("K2", {"date": "today"}, TypeError, "`date` must be a datetime.date"),
            ("K2", {"extra_cards": [1]}, TypeError, "`extra_cards` must be a mapping"),
        ],
    )
    def test_metadata(self, mission, change, error, message):
        with pytest.raises(error, match=message):
            TPFMetadata(**({"mission": mission, "target_id": 42} | FIELDS[mission] | change))

    @pytest.mark.parametrize(
        "card, message",
        [
            ({"RA_OBJ": 3.0}, "must not replace RA_OBJ"),
            ({"CHECKSUM": "0"}, "must not replace CHECKSUM"),
            ({"TOO_LONG_A_NAME": 1}, "must have keywords of 1 to 8 characters"),
            ({"A B": 1}, "cannot hold A B"),
            ({"TEXT": "\u00e9"}, "cannot hold TEXT"),
            ({"NUMBER": np.nan}, "cannot hold NUMBER"),
            ({"LIST": [1, 2]}, "cannot hold LIST"),
            ({"COMMENT": "like EVEREST"}, "readers misread it"),
        ],
    )
    def test_extra_cards(self, card, message):
        with pytest.raises(ValueError, match=message):
            make_tpf_hdulist(**contents_of("K2", metadata=metadata_of("K2", extra_cards=card)))

    def test_channel_module_and_output(self):
        for channel, place in {1: (2, 1), 20: (7, 4), 46: (14, 2), 84: (24, 4)}.items():
            assert metadata_of("K2", channel=channel).module_and_output == place
            module, output = place
            metadata = metadata_of("K2", channel=None, module=module, output=output)
            assert metadata.full_channel == channel


class TestWriting:
    def test_same_contents_give_the_same_file(self, tmp_path):
        for suffix in (".fits", ".fits.gz"):
            paths = [tmp_path / f"{name}{suffix}" for name in "ab"]
            for path in paths:
                assert write_tpf(path, **contents_of("TESS")) == path
            assert paths[0].read_bytes() == paths[1].read_bytes()

    def test_compressed(self, tmp_path):
        contents = contents_of("K2")
        path = write_tpf(str(tmp_path / "star.fits.gz"), **contents)
        assert path.read_bytes()[:2] == b"\x1f\x8b"
        plain = write_tpf(tmp_path / "star.fits", **contents)
        assert gzip.decompress(path.read_bytes()) == plain.read_bytes()

    def test_other_readers(self, path):
        with warnings.catch_warnings():
            # The archive's unit of TIME is not one of astropy's.
            warnings.simplefilter("ignore", UnitsWarning)
            table = Table.read(path, hdu=1)
        assert table["FLUX"].shape == (400, 11, 11)
        scene = Table.read(path, hdu="SCENE")
        values = [value.decode() if isinstance(value, bytes) else value for value in scene["VALUE"]]
        assert json.loads(values[0]) == [{"mag": 12.0, "psf": None}]

    def test_misspelt_argument(self, tmp_path):
        with pytest.raises(TypeError, match="flux_error"):
            write_tpf(tmp_path / "star.fits", flux_error=1.0, **contents_of("K2"))
        assert list(tmp_path.iterdir()) == []


class TestOwnArrays:
    """Files from a user's own arrays, with nothing more than time, flux and its error."""

    @pytest.mark.parametrize("mission", MISSIONS)
    def test_shortest_call(self, tmp_path, mission):
        import lightkurve

        rng = np.random.default_rng(1)
        time = 2230 + 0.02 * np.arange(50)
        flux = rng.normal(1000, 1, size=(50, 7, 5)).astype(np.float32)
        path = write_tpf(tmp_path / "mine.fits", metadata=mission, time=time, flux=flux, flux_err=1)
        tpf = lightkurve.read(path)
        assert tpf.mission == mission
        np.testing.assert_array_equal(tpf.flux.value, flux)
        np.testing.assert_allclose(tpf.time.value, time, rtol=0, atol=1e-9)
        np.testing.assert_array_equal(tpf.cadenceno, np.arange(1, 51))
        assert np.isnan(tpf.pos_corr1).all()
        assert tpf.to_lightcurve(aperture_mask="all").flux.value == pytest.approx(
            flux.sum(axis=(1, 2), dtype=float), rel=1e-6
        )
        tpf.hdu.close()

    def test_units_and_times(self):
        days = 2230 + 0.02 * np.arange(5)
        times = Time(days + 2454833, format="jd", scale="tdb")
        flux = np.full((5, 3, 3), 2.0) * u.electron / u.ms
        hdus = make_tpf_hdulist(
            metadata="K2", time=times, flux=flux, flux_err=60 * u.electron / u.min,
            pos_corr1=np.ma.masked_equal([0.0, 9.0, 0.1, 0.2, 0.3], 9.0),
        )  # fmt: skip
        data = hdus[1].data
        np.testing.assert_allclose(data["TIME"], days, rtol=0, atol=1e-7)
        assert np.all(data["FLUX"] == 2000)
        assert np.all(data["FLUX_ERR"] == 1)
        assert np.isnan(data["POS_CORR1"]).tolist() == [False, True, False, False, False]

    @pytest.mark.parametrize(
        "name, value, message",
        [
            ("flux", np.ones((5, 3, 3)) * u.m, "`flux` must be in electron / s"),
            ("time", np.arange(5) * u.m, "`time` must be in d"),
            ("pos_corr2", np.zeros(5) * u.arcsec, "`pos_corr2` must be in pix"),
            ("flux_err", np.ones(4), "`flux_err` must fit the shape"),
        ],
    )
    def test_what_does_not_convert(self, name, value, message):
        contents = {"time": np.arange(5.0), "flux": np.ones((5, 3, 3)), "flux_err": 1.0}
        with pytest.raises(ValueError, match=message):
            make_tpf_hdulist(metadata="TESS", **(contents | {name: value}))

    def test_pixels_that_are_not_simulated(self):
        contents = {"time": np.arange(5.0), "flux": np.ones((5, 3, 3)), "flux_err": 1.0}
        for simulated in (True, False):
            hdus = make_tpf_hdulist(metadata="TESS", simulated=simulated, **contents)
            assert [hdu.header["SIMDATA"] for hdu in hdus] == [simulated] * len(hdus)


@pytest.mark.parametrize("name", ["Kepler", "K2", "TESS"])
def test_names_of_missions_in_any_case(name):
    time = 2500.0 + 0.02 * np.arange(3)
    for text in (name.lower(), name.upper()):
        hdus = make_tpf_hdulist(metadata=text, time=time, flux=np.ones((3, 5, 5)), flux_err=0.1)
        assert read_pixels(hdus).mission.name == name
    with pytest.raises(ValueError, match=r"`mission` must be one of .* got 'k3'"):
        make_tpf_hdulist(metadata="k3", time=time, flux=np.ones((3, 5, 5)), flux_err=0.1)


def test_truth_of_many_stars_takes_linear_time():
    """A scene of 10,000 stars has 30,000 columns, which are joined to three of vectors."""
    names = [f"{name}{k}" for name in ("X", "Y", "SIGNAL") for k in range(1, 10_001)]
    columns = {name: np.ones(2) for name in names}
    begin = time.process_time()
    (block,) = truth_blocks(np.arange(2), columns, None, None, None)
    assert time.process_time() - begin < 20  # with a quadratic search minutes
    assert block is not None
