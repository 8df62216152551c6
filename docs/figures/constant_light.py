"""Draw what correctors leave of a variable star that has a constant neighbor."""

import sys
import warnings

import matplotlib.pyplot as plt
import numpy as np
from lightkurve.correctors import PLDCorrector as LightkurvePLD

from scope_models.benchmark import make_sky
from scope_models.correctors import PLDCorrector

DAYS = 4


def make_figure():
    """Return the figure: a star of one regime of the messy sky, and four light curves of it."""
    sky = make_sky("k2-1x-rr-lyrae-neighbor", 100, n_cadences=900)
    tpf = sky.to_tpf()
    both = tpf.create_threshold_mask(3)  # an aperture that holds both stars
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the variability, which is the subject of the figure
        corrector = PLDCorrector(tpf, both)
        curves = {
            "before correction": tpf.to_lightcurve(aperture_mask=both),
            "lightkurve's PLDCorrector": LightkurvePLD(tpf, both).correct(),
            'PLDCorrector, fractions="measured"': corrector.correct(fractions="measured"),
            "PLDCorrector": corrector.correct(),
        }
    figure, axes = plt.subplots(
        len(curves), 1, figsize=(8, 7), sharex=True, sharey=True, layout="constrained"
    )
    for ax, (name, curve) in zip(axes, curves.items(), strict=True):
        time, flux = curve.time.value, curve.flux.value
        first = time < time[0] + DAYS
        ax.plot(time[first], (flux / np.nanmedian(flux))[first], ".", color="tab:blue", ms=4)
        ax.set_title(name, loc="left")
        ax.set_ylabel("Relative flux")
    axes[-1].set_xlabel("Time (BKJD)")
    return figure


if __name__ == "__main__":
    figure = make_figure()
    if sys.argv[1:]:  # not in the documentation's build
        figure.savefig(sys.argv[1])
