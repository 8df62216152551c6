"""Draw tracks and light curves of a star at multiples of K2's motion, as the paper discusses them.

The build of the documentation draws the figure. In the folder of this file, so does
``python -c "import paper_motion; paper_motion.make_figure().savefig('paper_motion.png')"``.
"""

import matplotlib.pyplot as plt

import scope_models as scope
from scope_models.plotting import plot_light_curve, plot_motion

# Multiples of the motion, and stamps that hold the star.
STAMPS = {1: 9, 2: 11, 5: 15, 10: 23}
# Rows and columns of the pixels that are drawn below the tracks.
DRAWN = 15


def make_figure():
    """Return the figure: one row per multiple of the motion."""
    figure = plt.figure(figsize=(9.5, 11), layout="constrained")
    grid = figure.subplots(len(STAMPS), 2, width_ratios=(1, 1.9))
    for (track, curve), (scale, size) in zip(grid, STAMPS.items(), strict=True):
        star = scope.generate_target(mag=12, roll=scale, apsize=size, seed=1)
        corrected = star.detrend()
        x, y = star.observation.truth.x[0], star.observation.truth.y[0]
        shift = (DRAWN - size) / 2
        place = x + shift, y + shift, (DRAWN, DRAWN)
        plot_motion(star.time, *place, time_label="Time (BKJD)", title=f"{scale}x", ax=track)
        track.get_legend().remove()
        tpf = star.to_tpf()
        raw = tpf.to_lightcurve(aperture_mask=star.aperture)
        plot_light_curve(
            raw.time.value,
            raw.flux.value,
            corrected.flux.value,
            cdpp=star.estimate_cdpp(raw, method="everest"),
            corrected_cdpp=star.estimate_cdpp(corrected, method="everest"),
            convention="EVEREST",
            time_label="Time (BKJD)",
            title=None,
            ax=curve,
        )
        options = {"bbox_to_anchor": (1, 1), "fontsize": "small", "markerscale": 2}
        curve.legend(loc="lower right", ncols=2, borderaxespad=0.2, **options)
        curve.locator_params(axis="x", nbins=5)
    return figure


if __name__ == "__main__":
    make_figure()
