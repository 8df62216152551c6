"""All files that the package writes follow the FITS standard."""

import shutil
import subprocess
import warnings

import pytest
from astropy.io import fits

from scope_models import Detector, Motion, Scene, Star, fit_tpf, simulate
from scope_models.correctors import detrend_file
from scope_models.exceptions import LostLightWarning
from scope_models.fitting import FitOptions
from scope_models.io._opening import open_fits

LAYOUTS = ("k2", "kepler", "tess", "many stars", "scene", "light curve", "fit")


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Return a file of each layout."""
    folder = tmp_path_factory.mktemp("files")
    paths = {name: folder / f"{name.replace(' ', '_')}.fits" for name in LAYOUTS}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LostLightWarning)
        for preset in ("k2", "kepler", "tess"):
            motion = Motion.k2_roll(60, seed=1)
            time_format = "btjd" if preset == "tess" else "bkjd"
            motion = Motion(motion.time, motion.x, motion.y, time_format=time_format)
            detector = Detector.preset(preset, shape=(7, 7))
            simulate(Star(12.0), detector, motion, seed=1).write(paths[preset])
        stars = [Star(15.0, 3 + i % 3, 3) for i in range(340)]
        scene = Scene(stars, Detector.k2(shape=(7, 7)), Motion.still(4), seed=1)
        simulate(scene).write(paths["many stars"])
        scene.write(paths["scene"])
    detrend_file(paths["k2"], paths["light curve"], order=1)
    fit_tpf(paths["k2"], psf=1, options=FitOptions(max_steps=20)).write(paths["fit"])
    return paths


@pytest.mark.parametrize("layout", LAYOUTS)
def test_structure(files, layout):
    """What can be checked without other programs."""
    path = files[layout]
    assert path.stat().st_size % 2880 == 0
    with fits.open(path, checksum=True) as hdus:  # a wrong checksum is a warning, thus an error
        hdus.verify("exception")
        assert hdus[0].header["NEXTEND"] == len(hdus) - 1
        for hdu in hdus:
            for card in hdu.header.cards:
                assert card.image.isascii()
                assert card.keyword == card.keyword.upper()
            if isinstance(hdu, fits.BinTableHDU):
                names = hdu.columns.names
                assert len({name.upper() for name in names}) == len(names) <= 999
                assert hdu.header["NAXIS1"] == hdu.data.dtype.itemsize
    content = path.read_bytes()
    with open_fits(path) as hdus:  # our own sums, of which a wrong one is a warning
        assert len(hdus) > 1
    for keyword in (b"CHECKSUM", b"DATASUM "):
        assert content.count(keyword + b"= '") == len(hdus)


@pytest.mark.skipif(shutil.which("fitsverify") is None, reason="fitsverify is not installed")
@pytest.mark.parametrize("layout", LAYOUTS)
def test_fitsverify(files, layout):
    command = ["fitsverify", str(files[layout])]
    text = subprocess.run(command, capture_output=True, text=True, check=False).stdout
    assert "and 0 error(s)" in text
    warned = [line for line in text.splitlines() if "Warning:" in line]
    assert all("has a null value" in line for line in warned)
