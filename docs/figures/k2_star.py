"""Draw the light curve of WASP-47 and of a simulated star that moves in the same way."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from astropy.table import Table

from scope_models import Detector, Motion, Star, simulate
from scope_models.photometry import circular_aperture

# From the folder of this file, in which the documentation's build runs it.
PATH = Path("../../../shared/data/poscorr/ktwo206103150-c03_llc.fits")
LAST = 500


def make_figure(path=PATH):
    """Return the figure; without the archive file the motion is generated."""
    real = path.exists()
    motion = (Motion.from_file(path) if real else Motion.k2_roll())[:LAST]
    observation = simulate(Star(mag=11.76), Detector.k2(), motion, seed=1)
    tpf = observation.to_tpf()
    large = circular_aperture(observation.detector.shape, x_0=5, y_0=5, radius=4.0)
    curves = {
        "simulated, aperture of 9 pixels": tpf.to_lightcurve(),
        "simulated, aperture of 45 pixels": tpf.to_lightcurve(aperture_mask=large),
    }
    curves = {name: (lc.time.value, lc.flux.value) for name, lc in curves.items()}
    if real:
        table = Table.read(path, hdu=1, unit_parse_strict="silent")[:LAST]
        keep = np.isin(table["TIME"], curves["simulated, aperture of 9 pixels"][0])
        names = "TIME", "SAP_FLUX"
        curves = {"WASP-47, archive": tuple(np.asarray(table[n][keep]) for n in names)} | curves
    figure, axes = plt.subplots(
        len(curves), 1, figsize=(8, 2.2 * len(curves)), sharex=True, layout="constrained"
    )
    for ax, (name, (time, flux)) in zip(axes, curves.items(), strict=True):
        ax.plot(time, flux / np.nanmedian(flux), ".", color="tab:blue", ms=3)
        ax.set_title(name, loc="left")
        ax.set_ylabel("Relative flux")
    axes[-1].set_xlabel("Time (BKJD)")
    return figure


if __name__ == "__main__":
    make_figure()
