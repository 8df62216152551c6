"""Fixed and moving apertures on messy stars: white noise, raw and corrected scores.

    python studies/moving_apertures.py --stars k2-5x-kp15:2,k2-10x-constant:2

The moving aperture is `scope_models.photometry.moving_aperture` at POS_CORR about the star's median
place. The fixed one is the file's, which has the least scatter without correction; PLDCorrector
takes its own. Scores are in units of the noise of the file's aperture.
"""

import argparse
import warnings

import numpy as np

from scope_models.benchmark import make_sky, score
from scope_models.correctors import PLDCorrector
from scope_models.photometry import moving_aperture

LONGEST = 20.0  # px: POS_CORR beyond is absurd


def window(tpf, sky, radius):
    """Return the weights of an aperture that follows POS_CORR."""
    offsets = (tpf.pos_corr1, tpf.pos_corr2)
    x, y = (
        np.median(place) + np.where(np.abs(o) < LONGEST, o, np.nan)
        for place, o in zip((sky.x, sky.y), offsets, strict=True)
    )
    return moving_aperture(tpf.shape[1:], x, y, radius)


def row(name, seed, radii):
    """Print one star."""
    sky = make_sky(name, seed)
    tpf = sky.to_tpf()
    print(f"\n{name}, seed {seed}: white noise of the raw sum; raw; PLD (full / high-passed, pull)")
    for radius in (None, *radii):
        weights = None if radius is None else window(tpf, sky, radius)
        corrector = PLDCorrector(tpf, weights)
        corrected = score(corrector.correct(), sky)
        raw = corrector.original_lc
        label = f"moving, {radius} px"
        if weights is None:
            label, raw = "fixed", tpf.to_lightcurve(aperture_mask="pipeline")
        noise = np.nanmedian(raw.flux_err.value / raw.flux.value) / sky.floor()
        before = score(raw, sky)
        print(
            f"  {label:16}{noise:6.2f}{before.full:9.1f} / {before.high_passed:5.1f}"
            f"{corrected.full:9.2f} / {corrected.high_passed:4.2f}{corrected.pull:7.2f}"
        )


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--stars", default="k2-5x-kp15:2", help="regime:seed, comma-separated")
    parser.add_argument("--radii", default="2,3", help="of the moving aperture, px")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    for star in options.stars.split(","):
        name, seed = star.split(":")
        row(name, int(seed), [float(r) for r in options.radii.split(",")])


if __name__ == "__main__":
    main()
