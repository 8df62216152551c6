"""Scenes and a fit whose files were written at commit 19e5c3d, before files held class names alone.

Run there as ``python record.py FOLDER``. The files are never written again: later versions open
them.
"""

import sys
from pathlib import Path

import numpy as np
from astropy import units as u
from astropy.coordinates import SkyCoord
from astropy.time import Time

from scope_models import (
    BivariateGaussianPSF,
    Detector,
    Motion,
    Scene,
    SensitivityPolynomial,
    Star,
    TabulatedPSF,
    TransitModel,
    effects,
    fit_tpf,
    simulate,
)
from scope_models.models import (
    DiffusionSensitivity,
    GaussHermitePSF,
    moffat_psf,
    sinusoidal_signal,
    tabulated_signal,
)

RESPONSE = SensitivityPolynomial((1, 0, -0.1), (1, 0.01, -0.2))
PLANET = {"depth": 0.01, "duration": 0.1, "period": 0.3, "t0": 2144.2, "exposure_time": 0.02}


def k2_scene():
    """Return a scene of several PSFs, signals and effects."""
    motion = Motion.k2_roll(12, seed=3)
    core = BivariateGaussianPSF(0.7, sigma_x=0.6, sigma_y=0.5, rho=0.1)
    wing = BivariateGaussianPSF(0.3, sigma_x=1.6, sigma_y=1.5)
    place = SkyCoord(
        *(150.0 * u.deg, 10.0 * u.deg),
        pm_ra_cosdec=50.0 * u.mas / u.yr,
        pm_dec=-20.0 * u.mas / u.yr,
        obstime=Time(2016.0, format="jyear"),
    )
    stars = [
        Star(11.5, coord=place, signal=TransitModel.from_depth_duration(**PLANET)),
        Star(14.0, 1.0, 3.0, GaussHermitePSF(sigma_x=0.7, c_2_0=0.1), sinusoidal_signal(0.1, 2.0)),
        Star(15.0, 4.0, 4.0, moffat_psf(1.5, n_components=4), 1 + 0.1 * np.sin(motion.time)),
        Star(15.5, 0.0, 0.0, signal=tabulated_signal(motion.time[[0, -1]], [1.0, 0.9])),
    ]
    some = [
        effects.Focus(0.01, period=0.5),
        effects.Jitter(0.05, 10.0),
        effects.Background(10.0, drift=0.1),
        effects.CosmicRays(rate=50.0),
        effects.Throughput(series=1 + 0.01 * motion.x),
        effects.Smear(),
        effects.Gaps([(motion.time[4], motion.time[5])]),
    ]
    detector = Detector.k2(
        shape=(6, 5), psf=core + wing, sensitivity=RESPONSE, interpixel_scatter=0.01
    )
    return Scene(
        stars, detector, motion, seed=3, effects=some, n_sub=3, object_name="a star",
        target_id=7, orientation=20.0, column=10, row=20, metadata={"campaign": 5},
    )  # fmt: skip


def tess_scene():
    """Return a scene with a given interpixel map and sensitivity of another kind, not simulated."""
    time = 1325.0 + np.arange(8) * 120 / 86400
    motion = Motion(time, 0.01 * np.arange(8), -0.02 * np.arange(8), time_format="btjd")
    y, x = np.indices((17, 17)) - 8.0
    detector = Detector.tess(
        shape=(4, 5),
        psf=TabulatedPSF(np.exp(-(x**2 + y**2) / 6), 2),
        sensitivity=DiffusionSensitivity(),
        interpixel=np.linspace(0.98, 1.02, 20).reshape(4, 5),
        effects=[effects.DarkCurrent(2.0)],
    )
    return Scene(Star(10.0, 2.2, 1.7), detector, motion, seed=5, noise=("photon", "read"))


def fitted_observation():
    """Return the observation that is fitted."""
    detector = Detector.k2(shape=(5, 5), interpixel_scatter=0.0)
    stars = [Star(13.0), Star(15.0, 1.0, 3.5)]
    return simulate(stars, detector, Motion.k2_roll(8, seed=2), seed=2)


def main():
    folder = Path(sys.argv[1])
    simulate(k2_scene()).write(folder / "observation.fits.gz")
    tess_scene().write(folder / "scene.fits.gz")
    k2_scene().motion.write(folder / "motion.ecsv")
    k2_scene().detector.write(folder / "detector.toml")
    fit = fit_tpf(fitted_observation().to_tpf(), psf=1, neighbors=[(1.0, 3.5)])
    fit.write(folder / "fit.fits.gz")


if __name__ == "__main__":
    main()
