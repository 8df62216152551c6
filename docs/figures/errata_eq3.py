"""Draw Eq. 3 of the paper as printed and corrected."""

import matplotlib.pyplot as plt
import numpy as np

from scope_models import BivariateGaussianPSF

LEVELS = (0.1, 0.3, 0.5, 0.8)


def printed(x, y, sigma, rho):
    """Return Eq. 3 with the extra factor 1/2, for a flux of 1."""
    squares = (x**2 + y**2) / (2 * sigma**2) - 2 * rho * x * y / sigma**2
    norm = 2 * np.pi * sigma**2 * np.sqrt(1 - rho**2)
    return np.exp(-squares / (2 * (1 - rho**2))) / norm


def make_figure():
    """Return the figure."""
    figure, axes = plt.subplots(2, 2, figsize=(7, 6.4), layout="constrained")
    axes = axes.ravel()
    side = np.linspace(-1.6, 1.6, 161)
    x, y = np.meshgrid(side, side)
    for ax, rho in zip(axes, (0.0, 0.3, 0.6), strict=False):
        for values, color, style in (
            (BivariateGaussianPSF(rho=rho)(x, y), "tab:blue", "solid"),
            (printed(x, y, 0.5, rho), "tab:orange", "dashed"),
        ):
            ax.contour(x, y, values / values[80, 80], LEVELS, colors=color, linestyles=style)
        ax.set(title=f"rho = {rho:g}", xlabel="x (pixel)", ylabel="y (pixel)", aspect="equal")
    rho = np.linspace(-0.49, 0.49, 401)
    axes[3].plot([-0.6, 0.6], [1, 1], color="tab:blue", label="corrected")
    integral = np.sqrt((1 - rho**2) / (0.25 - rho**2))
    axes[3].plot(rho, integral, "--", color="tab:orange", label="as printed")
    axes[3].set(title="Integral", xlabel="rho", ylabel="Integral / A", ylim=(0, 8))
    axes[3].legend()
    return figure


if __name__ == "__main__":
    make_figure()
