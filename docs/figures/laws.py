"""Figures of the page on laws: what files hold, and the ratio to the law."""

import tomllib
from functools import partial
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from astropy.table import Table

_TEXTS = tomllib.loads(Path("../../studies/laws.toml").read_text(encoding="utf-8"))


def draw(name):
    """Return the figure of a law."""
    table, texts = Table.read("../data/laws.csv"), _TEXTS[name]
    x, measured, error, predicted = (
        np.array(table[n][table["law"] == name]) for n in ("x", "measured", "error", "predicted")
    )
    figure, (top, bottom) = plt.subplots(
        2, sharex=True, height_ratios=(3, 1), layout="constrained", figsize=(6, 4.5)
    )
    top.plot(x, predicted, color="C1", label="law")
    top.errorbar(x, measured, error, fmt=".", label="measured")
    # Where a law passes zero, a ratio has no meaning.
    passes = predicted.min() * predicted.max() <= 0
    large = np.abs(predicted) > (0.01 if passes else 0) * np.abs(predicted).max()
    ratio, noise = measured[large] / predicted[large], error[large] / np.abs(predicted[large])
    bottom.errorbar(x[large], ratio, noise, fmt=".")
    bottom.axhline(1, color="C1")
    half = max(1.2 * np.max(np.abs(ratio - 1) + noise), 1e-4)
    bottom.set_ylim(1 - half, 1 + half)
    if x.min() > 0 and x.max() > 9 * x.min():
        top.set_xscale("log")
        if predicted.min() > 0 and predicted.max() > 9 * predicted.min():
            top.set_yscale("log")
    figure.suptitle(texts["title"], fontsize="medium")
    top.set_ylabel(texts["y"])
    top.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=2, frameon=False)
    bottom.set_xlabel(texts["x"])
    bottom.set_ylabel("Ratio")
    return figure


_LAWS = [name for name, texts in _TEXTS.items() if isinstance(texts, dict)]
globals().update({f"make_{name}_figure": partial(draw, name) for name in _LAWS})
