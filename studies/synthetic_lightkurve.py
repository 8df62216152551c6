"""Three synthetic K2 files for lightkurve's tests: a flat, a sinusoidal and a transiting star.

    python studies/synthetic_lightkurve.py DIRECTORY

They have the signals and the extension SIMULATED_SIGNAL of earlier files of the same names. The
star moves along the diagonal of the pixels, along which their response grows: those files had
POS_CORR1 along rows and POS_CORR2 along columns, and lightkurve's tests expect that; here both are
right. Fluxes are rounded to a tenth of the photon noise, so that the files are small. The other
choices are of about twenty variants with which the tests of recovered signals pass.
"""

import sys
from pathlib import Path

import numpy as np
from astropy.io import fits

from scope_models import Detector, Motion, Star, TransitModel, simulate
from scope_models.io import TPFMetadata
from scope_models.io.tpf import make_tpf_hdulist, write_hdulist
from scope_models.models import BivariateGaussianPSF, sinusoidal_signal

CADENCES, MAGNITUDE, SEED = 1000, 11.0, 1
DATE = "2026-01-01"
LEFT = 10.0  # background that was not taken off, e-/s: lightkurve's PLD divides by such pixels
DETECTOR = Detector.k2(
    shape=(7, 7), psf=BivariateGaussianPSF(sigma_x=0.5, sigma_y=0.5),
    interpixel=1 + 0.002 * (np.indices((7, 7)).sum(axis=0) - 6), well_depth=None, background=20.0,
)  # fmt: skip
PERIOD, SINE_AMPLITUDE = 5.0, 0.001
PLANET = {"rp": 0.044, "a": 12.3108, "inc": 90.0, "u1": 0.40, "u2": 0.26}


def motion():
    """Return the roll of a K2 star, of which both components are the same."""
    roll = Motion.k2_roll(CADENCES)
    along = max((roll.x, roll.y), key=np.ptp) / np.sqrt(2)
    return Motion(roll.time, along, along, quality=roll.quality, time_format=roll.time_format)


def stars():
    """Return signal and cards of each file by its name."""
    start = motion().time[0]
    planet = TransitModel(
        period=PERIOD, t0=start + 2.0, **PLANET, exposure_time=DETECTOR.cadence_days
    )
    cards = {
        "PERIOD": (PERIOD, "[d] orbital period"),
        "T0": (start + 2.0, "[BKJD] middle of a transit"),
        "RPRS": (PLANET["rp"], "radius of the planet over that of the star"),
        "A_RS": (PLANET["a"], "semi-major axis over the radius of the star"),
        "LIMB_U1": (PLANET["u1"], "linear limb darkening"),
        "LIMB_U2": (PLANET["u2"], "quadratic limb darkening"),
    }
    waves = {
        "PERIOD": (PERIOD, "[d] period of the sinusoid"),
        "SINE_AMP": (SINE_AMPLITUDE, "relative amplitude, half of peak to peak"),
    }
    return {
        "flat": (None, {"SIGNAL": ("flat", "kind of the signal")}),
        "sinusoid": (sinusoidal_signal(SINE_AMPLITUDE, PERIOD), waves),
        "planet": (planet, cards),
    }


def write(name, signal, cards, folder):
    """Write a file; return its path."""
    observation = simulate(Star(MAGNITUDE, signal=signal), DETECTOR, motion(), seed=SEED)
    error = np.sqrt(np.mean(np.square(observation.flux_err, dtype=float), axis=0))
    flux, time, track = observation.flux + LEFT, observation.time, observation.motion
    step = 2.0 ** np.floor(np.log2(0.1 * error))
    metadata = TPFMetadata.of(
        DETECTOR, target_id=1, object_name=f"synthetic {name}", magnitude=MAGNITUDE, campaign=3
    )
    hdus = make_tpf_hdulist(
        metadata=metadata, time=time, flux=step * np.round(flux / step),
        flux_err=np.broadcast_to(error, flux.shape), quality=observation.quality,
        pos_corr1=track.x, pos_corr2=track.y, aperture=np.ones(DETECTOR.shape, dtype=bool),
    )  # fmt: skip
    light = observation.truth.relative_flux[0]
    columns = [
        fits.Column("TIME", "D", "d", array=time), fits.Column("NOISELESS_INPUT", "D", array=light)
    ]  # fmt: skip
    truth = fits.BinTableHDU.from_columns(columns, name="SIMULATED_SIGNAL")
    truth.header.update(cards)
    del hdus[3:]
    hdus.append(truth)
    hdus[0].header["NEXTEND"] = len(hdus) - 1
    for hdu in hdus:
        if "DATE" in hdu.header:
            hdu.header["DATE"] = DATE
    return write_hdulist(hdus, Path(folder) / f"synthetic-k2-{name}.targ.fits.gz", overwrite=True)


def main(folder):
    """Write the three files."""
    Path(folder).mkdir(parents=True, exist_ok=True)
    for name, (signal, cards) in stars().items():
        print(write(name, signal, cards, folder))


if __name__ == "__main__":
    main(sys.argv[1])
