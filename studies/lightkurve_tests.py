"""Run lightkurve's own tests with its target pixel files replaced by files of this package.

    python studies/lightkurve_tests.py CHECKOUT [pytest options]

CHECKOUT is a clone of lightkurve 2.6 (its distributions hold no tests). Tests that need the network
are left out. The page on robustness lists the failures.
"""

import shutil
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path

import numpy as np
from synthetic_lightkurve import main as write_synthetic

from scope_models import Detector, Motion, Star, simulate
from scope_models.exceptions import LostLightWarning
from scope_models.io import TPFMetadata, write_tpf

MODULES = ("test_synthetic_data.py", "test_targetpixelfile.py")


def small_k2(path, center):
    """Write 1290 cadences of 3 x 3 pixels, of which one has light; flags as lightkurve counts."""
    n = 1290
    flux, error = np.zeros((n, 3, 3)), np.full((n, 3, 3), 1.0)
    flux[:, 1, 1] = center
    quality = np.zeros(n, dtype=np.int32)
    quality[10:22] = 4  # coarse point
    quality[30:75] = 2  # safe mode
    quality[100:232] = 128  # a cosmic ray in the aperture: left out by "hard" only
    time = 2925.0 + 0.0204336 * np.arange(n)
    time[10:22] = np.nan
    quality[10:22] |= 65536
    metadata = TPFMetadata(
        mission="K2", target_id=200000000, campaign=3, channel=45, ra=12.0, dec=-3.0, magnitude=12.0
    )
    write_tpf(
        path, overwrite=True, metadata=metadata, time=time, flux=flux, flux_err=error,
        cadenceno=125000 + np.arange(n), quality=quality, pos_corr1=np.zeros(n),
        pos_corr2=np.zeros(n), aperture=np.ones((3, 3), dtype=bool),
    )  # fmt: skip


def star(path, preset, n, **metadata):
    """Write a simulated star."""
    tess = preset == "tess"
    detector = Detector.preset(preset, shape=(11, 11) if tess else (7, 6))
    time_format, start = ("btjd", 1325.3) if tess else ("bkjd", 735.4)
    motion = Motion.still(n, start=start, cadence=detector.cadence_days, time_format=time_format)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LostLightWarning)
        observation = simulate(Star(9.0 if tess else 12.0), detector, motion, seed=1)
    observation.write(path, overwrite=True, metadata=metadata)


def replace(data):
    """Replace the files in a folder; return their names."""
    write_synthetic(data / "synthetic")
    small_k2(data / "test-tpf-all-zeros.fits", 0.0)
    small_k2(data / "test-tpf-non-zero-center.fits", 1.0)
    place = {"ra": 301.5643971, "dec": 44.4568869}
    star(data / "test-tpf-kplr-tabby-100-cadences.fits", "kepler", 100, target_id=8462852, **place)
    field = {"sector": 1, "camera": 4, "ccd": 1, "ra": 63.37, "dec": -69.23}
    name = "tess25155310-s01-first-cadences.fits.gz"
    star(data / name, "tess", 100, target_id=25155310, **field)


def main(checkout, *options):
    with tempfile.TemporaryDirectory() as folder:
        tests = Path(folder) / "tests"
        shutil.copytree(Path(checkout) / "tests", tests)
        replace(tests / "data")
        command = [sys.executable, "-m", "pytest", "-q", "-c", "/dev/null", "--rootdir", folder]
        command += ["-m", "not remote_data", *options, *(str(tests / name) for name in MODULES)]
        return subprocess.run(command, cwd=folder, check=False).returncode


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
