"""An animated picture of a simulated star, for the page on motions."""

from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.animation import PillowWriter

from scope_models import Detector, Motion, Star, simulate


def write_animation(path):
    """Write a day and a half of a star that moves five times as far as K2's."""
    detector, motion = Detector.k2(), 5 * Motion.k2_roll(72)
    animation = simulate(Star(12.0), detector, motion, seed=1).animate(step=2, interval=120)
    animation.save(path, writer=PillowWriter(fps=8), dpi=70)
    plt.close("all")


def _write(app):
    folder = Path(app.srcdir) / "_generated"
    folder.mkdir(exist_ok=True)
    write_animation(folder / "moving_star.gif")


def setup(app):
    """Connect the animation to the build."""
    app.connect("builder-inited", _write)
    return {"parallel_read_safe": True}
