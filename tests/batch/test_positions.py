"""Positions of the stars of a run from other stars of their CCDs."""

import numpy as np
import pytest
from astropy.io import fits
from photutils.detection import DAOStarFinder
from photutils.psf import CircularGaussianPRF, PSFPhotometry, SourceGrouper

from scope_models import Detector, Motion, PLDCorrector, Scene, Star, read_pixels, simulate
from scope_models.batch import detrend_files
from scope_models.cli import main
from scope_models.exceptions import FitWarning
from scope_models.io import read_tpf
from scope_models.photometry import cdpp

pytestmark = pytest.mark.usefixtures("empty_figures")

MOTION = Motion.k2_roll(150, seed=3)


def make(path, number, channel=31):
    place = {"column": 100 * number, "row": 400, "object_name": f"star {number}"}
    metadata = {"campaign": 5, "channel": channel}
    scene = Scene(Star(11 + 0.2 * number), Detector.k2(shape=(9, 9)), MOTION, **place)
    return simulate(scene, seed=number).write(path / f"star{number}.fits", metadata=metadata)


def change(path, factor):
    """Multiply POS_CORR."""
    with fits.open(path, mode="update", checksum=True) as hdus:
        for axis in (1, 2):
            hdus[1].data[f"POS_CORR{axis}"] *= factor
    return path


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Five stars of a CCD, the second without POS_CORR, the fourth with a wrong one; another."""
    folder = tmp_path_factory.mktemp("positions")
    paths = [make(folder, number) for number in range(1, 6)]
    change(paths[1], np.nan)
    change(paths[3], -1)
    return [*paths, make(folder, 6, channel=32)]


def detrend(files, folder, **options):
    return detrend_files(files, folder, sweep={"progress": False}, order=1, **options)


def write(folder, name, stars, detector, motion, row):
    place = {"column": 100 + 10 * len(stars), "row": row, "object_name": name}
    scene = Scene(stars, detector, motion, **place)
    metadata = {"campaign": 5, "channel": 31}
    return simulate(scene, seed=len(name)).write(folder / f"{name}.fits", metadata=metadata)


def flux(folder, number):
    return fits.getdata(folder / f"star{number}-lc.fits")["FLUX"]


def test_positions_that_are_missing_or_disagree_are_those_of_others(files, tmp_path):
    table = detrend(files, tmp_path / "out").table
    found = dict(zip(table["key"], table["warnings"], strict=True))
    assert "POS_CORR is missing: positions come from 3 stars of c05 CCD 31" in found["star2"]
    message = "POS_CORR disagrees with that of other stars: positions come from 3 stars of c05"
    assert message in found["star4"]
    assert not any("positions" in found[f"star{number}"] for number in (1, 3, 5, 6))
    paths = dict(zip(table["key"], table["positions"], strict=True))
    assert paths["star1"].startswith("positions/c05-31-1765s-")
    assert paths["star6"] == ""
    motion = Motion.read(tmp_path / "out" / paths["star1"])
    assert motion.meta["stars"] == ["star1.fits", "star3.fits", "star5.fits"]
    assert list(motion.meta["left_out"]) == ["star4.fits"]
    expected = PLDCorrector(files[1]).correct(order=1, positions=motion).flux.value
    np.testing.assert_allclose(flux(tmp_path / "out", 2), expected, rtol=1e-6)


def test_positions_from_files(files, tmp_path):
    given = [files[number] for number in (0, 2, 4)]
    with pytest.warns(FitWarning, match="no file of the run is of the same CCD as"):
        table = detrend(files[1:2], tmp_path / "out", positions_from=[*given, files[5]]).table
    assert "positions come from 3 stars of c05 CCD 31" in table["warnings"][0]
    motion = Motion.from_tpfs(given)
    assert not (motion.x_err > 2e-4).any()
    expected = PLDCorrector(files[1]).correct(order=1, positions=motion).flux.value
    np.testing.assert_allclose(flux(tmp_path / "out", 2), expected, rtol=1e-6)
    table = detrend(files[1:2], tmp_path / "out", positions_from=given[:2]).table
    assert "positions come from 2 stars" in table["warnings"][0]


def test_stars_whose_positions_come_from_changed_files_are_corrected_again(files, tmp_path):
    given = [tmp_path / files[number].name for number in (0, 2)]
    for number, path in zip((0, 2), given, strict=True):
        path.write_bytes(files[number].read_bytes())
    first = detrend(files[1:2], tmp_path / "out", positions_from=given)
    assert detrend(files[1:2], tmp_path / "out", positions_from=given).n_computed == 0
    with fits.open(given[0], mode="update", checksum=True) as hdus:
        hdus[1].data["FLUX"] *= 1.5
    again = detrend(files[1:2], tmp_path / "out", positions_from=given)
    assert again.n_computed == 1
    assert again.table["positions"][0] != first.table["positions"][0]


def test_stars_whose_own_run_has_changed_files_are_corrected_again(files, tmp_path):
    paths = [tmp_path / files[number].name for number in (0, 1, 2)]
    for number, path in enumerate(paths):
        path.write_bytes(files[number].read_bytes())
    first = detrend(paths, tmp_path / "out")
    assert detrend(paths, tmp_path / "out").n_computed == 0
    assert detrend([*paths, files[4]], tmp_path / "out").n_computed == 1  # one is added
    change(paths[0], 1.01)
    paths[2].unlink()  # is not a change
    again = detrend(paths[:2], tmp_path / "out")
    assert again.n_computed == 2
    assert len({first.table["positions"][1], again.table["positions"][1]}) == 2


def test_stars_of_which_no_two_agree_keep_their_positions(files, tmp_path):
    rng = np.random.default_rng(1)
    paths = []
    for file in files[:4]:
        paths.append(tmp_path / file.name)
        paths[-1].write_bytes(file.read_bytes())
        with fits.open(paths[-1], mode="update", checksum=True) as hdus:
            for axis in (1, 2):
                hdus[1].data[f"POS_CORR{axis}"] = rng.normal(0, 0.1, len(hdus[1].data))
    table = detrend(paths, tmp_path / "out").table
    assert not any("positions" in text for text in table["warnings"])


@pytest.mark.slow
@pytest.mark.parametrize("given", [False, True])
def test_crowds_without_pos_corr_are_no_noisier_than_raw(tmp_path, given):
    """Stars among 25 others, some brighter: less than a tenth of the raw noise is left."""
    motion, crowds, bright = Motion.k2_roll(300, seed=3), [], []
    metadata = {"campaign": 5, "channel": 31}
    for number in (1, 2):
        rng = np.random.default_rng(number)
        others = zip(rng.uniform(12, 17, 25), *rng.uniform(-1, 12, (2, 25)), strict=True)
        stars = Star(12.0 + number, 5.0, 5.0), *(Star(*values) for values in others)
        place = {"column": 100 * number, "row": 700, "object_name": f"crowd {number}"}
        scene = Scene(stars, Detector.k2(shape=(12, 12)), motion, **place)
        path = simulate(scene, seed=number).write(tmp_path / f"{number}.fits", metadata=metadata)
        crowds.append(change(path, np.nan))
    for number in (1, 2, 3):
        place = {"column": 100 * number, "row": 400, "object_name": f"star {number}"}
        scene = Scene(Star(11 + 0.2 * number), Detector.k2(shape=(9, 9)), motion, **place)
        path = simulate(scene, seed=number).write(tmp_path / f"b{number}.fits", metadata=metadata)
        bright.append(path)
    files, more = (crowds, {"positions_from": bright}) if given else (crowds + bright, {})
    table = detrend_files(files, tmp_path / "out", sweep={"progress": False}, **more).table
    assert len(table) == len(files)  # no exception
    assert all("positions come from 3 stars" in text for text in table["warnings"][:2])
    for name in ("cdpp", "cdpp_everest"):
        assert (table[name] < 0.1 * table[f"raw_{name}"])[:2].all()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:One or more fit")
def test_crowds_of_a_real_field_are_as_quiet_as_with_true_positions(tmp_path, shared_data):
    """Stars, as measured in an image of Ruprecht 147, that move as a real star of K2.

    No positions are better than the true ones: those of other stars, and the stars' own in the
    pixels, add no more than 2 % to the noise; draws of noise and pixels scatter by 1 % per star.
    """
    image = fits.getdata(shared_data / "k2_superstamp" / "r147_c7.fits.gz")[120:240, 30:150]
    finder = DAOStarFinder(threshold=60, fwhm=1.4)
    photometry = PSFPhotometry(
        CircularGaussianPRF(fwhm=1.4), (3, 3), finder=finder, grouper=SourceGrouper(2.5),
        aperture_radius=1.5,
    )  # fmt: skip
    found = photometry(image.astype(float) - np.percentile(image, 20))
    moved = np.hypot(*(found[f"{axis}_fit"] - found[f"{axis}_init"] for axis in "xy"))
    found = found[(found["flux_fit"] > 0) & (moved < 1)]
    assert len(found) > 250
    x, y, flux = (np.array(found[f"{name}_fit"]) for name in ("x", "y", "flux"))
    detector = Detector.k2_calibrated(shape=(13, 13))
    mags = 12 - 2.5 * np.log10(flux / detector.flux_from_mag(12.0))
    near = (np.abs(x - x[:, None]) < 4) & (np.abs(y - y[:, None]) < 4)
    crowding = np.where(near, flux, 0).sum(axis=1) / flux
    whole = Motion.from_file(shared_data / "poscorr" / "ktwo211436265-c05_llc.fits", bad="drop")
    motion, files = whole[:500], []
    inside = (np.abs(x - 60) < 50) & (np.abs(y - 60) < 50) & (mags > 13) & (mags < 15.5)
    crowds = np.flatnonzero(inside)[np.argsort(crowding[inside])[-3:]]
    for number in crowds:
        dx, dy = x - np.rint(x[number]) + 6, y - np.rint(y[number]) + 6
        part = np.flatnonzero((np.abs(dx - 6) < 11) & (np.abs(dy - 6) < 11))
        part = [number, *part[part != number]]
        stars = [Star(mags[i], dx[i], dy[i]) for i in part]
        files.append(write(tmp_path, f"crowd{number}", stars, detector, motion, 700))
    bright = []
    for n, place in enumerate(np.random.default_rng(0).uniform(5.5, 6.5, (3, 2))):
        bright.append(
            write(tmp_path, f"star{n}", [Star(11.5 + 0.3 * n, *place)], detector, motion, 400)
        )
    known = detrend_files(files, tmp_path / "known", sweep={"progress": False}).table
    for path in files:
        change(path, np.nan)
    alone, helped = (
        detrend_files(files, tmp_path / name, sweep={"progress": False}, **options).table
        for name, options in (("alone", {}), ("helped", {"positions_from": bright}))
    )
    assert len(alone) == len(helped) == len(known) == 3
    assert all("positions come from 3 stars" in text for text in helped["warnings"])
    others = Motion.read(tmp_path / "helped" / helped["positions"][0])
    wrong = others.offsets(files[0])[0] - motion.offsets(files[0])[0]
    assert wrong.std(axis=0).max() < 2e-3
    for table in (alone, helped):
        assert (table["cdpp"] < 0.1 * table["raw_cdpp"]).all()
        ratio = table["cdpp"] / known["cdpp"]
        assert ratio.max() < 1.05
        assert np.log(ratio).mean() < 0.02
    assert (helped["cdpp"] / alone["cdpp"]).max() < 1.05


def test_a_file_of_other_times_keeps_its_own_positions(files, tmp_path):
    later = MOTION.replace(time=MOTION.time + 20, cadenceno=MOTION.cadenceno + 1000)
    scene = Scene(Star(12), Detector.k2(shape=(9, 9)), later, column=700, row=400)
    path = simulate(scene, seed=1).write(
        tmp_path / "later.fits", metadata={"campaign": 5, "channel": 31, "object_name": "later"}
    )
    table = detrend([*files[:5], change(path, np.nan)], tmp_path / "out").table
    assert len(table) == 6
    assert "positions" not in dict(zip(table["key"], table["warnings"], strict=True))["later"]


def test_command(files, tmp_path, capsys):
    given = ["--positions-from", *map(str, (files[0], files[2], files[4]))]
    one = ["detrend", str(files[1]), "--order", "1"]
    assert main([*one, "--output", str(tmp_path / "lc.fits"), *given]) == 0
    assert main([*one, "--output-dir", str(tmp_path / "out"), *given]) == 0
    alone = fits.getdata(tmp_path / "lc.fits")["FLUX"]
    np.testing.assert_array_equal(alone, flux(tmp_path / "out", 2))
    other = ["detrend", str(files[5]), "--output", str(tmp_path / "other.fits"), *given]
    capsys.readouterr()
    assert main(other) == 2
    assert "the motion belongs to c05 CCD 31, the file to c05 CCD 32" in capsys.readouterr().err


def test_light_curves_of_real_stars_without_pos_corr(shared_data):
    """They are as good as with their own, and better than the sums."""
    files = sorted((shared_data / "kepler_q12_ch4").glob("tpf_*.fits.gz"))
    motion, noise = Motion.from_tpfs(files[1:4]), []
    for path in (files[0], *files[4:]):
        own, others = PLDCorrector(read_tpf(path)), PLDCorrector(read_tpf(path))
        others._series = read_pixels(others.tpf).replace(pos_corr=None)
        curves = own.original_lc, own.correct(), others.correct(positions=motion)
        noise.append([cdpp(lc, method="everest") for lc in curves])
    raw, with_own, with_others = np.log(noise).T
    assert np.mean(with_others - with_own) < np.log(1.1)
    assert np.mean(with_others - raw) < 0
