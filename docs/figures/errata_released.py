"""Draw what defects of the paper's released code do to an image."""

import matplotlib.pyplot as plt
import numpy as np
from scipy.special import erf

from scope_models import BivariateGaussianPSF, SensitivityPolynomial, integrate_pixels

N, SIGMA = 7, 0.5
X, Y, MOTION = 3.2, 3.0, 0.6


def star(x=X + MOTION, y=Y, sigma=SIGMA):
    """Return the image of a star on pixels with the paper's sensitivity."""
    psf = BivariateGaussianPSF(1.0, x, y, sigma, sigma)
    return integrate_pixels(psf * SensitivityPolynomial(), shape=(N, N))


def not_integrated_along_y(y, sigma=SIGMA, n=N):
    """Return an even pixel's share of the light, with the PSF taken at the lower edge along y."""
    columns, rows = np.arange(n), np.arange(n) - 0.5 - np.atleast_1d(y)[:, None]
    edges = (columns[:, None] + [-0.5, 0.5] - X - MOTION) / (np.sqrt(2) * sigma)
    along_x = 0.5 * np.diff(erf(edges), axis=1)[:, 0]
    along_y = np.exp(-(rows**2) / (2 * sigma**2)) / np.sqrt(2 * np.pi) / sigma
    return along_y[:, :, None] * along_x


def polynomial_from_the_edge():
    """Return the image with u and v from 0 to 1, where 1 - 0.05 u^2 is 1 - 0.05 (u + 1/2)^2."""
    coefficients = (1 - 0.05 / 4, -0.05, -0.05)
    psf = BivariateGaussianPSF(1.0, X + MOTION, Y, SIGMA, SIGMA)
    return integrate_pixels(psf * SensitivityPolynomial(coefficients, coefficients), shape=(N, N))


def make_figure():
    """Return the figure."""
    image = star()
    even = integrate_pixels(BivariateGaussianPSF(1.0, X + MOTION, Y, SIGMA, SIGMA), shape=(N, N))
    flat = 0.975 ** (N - np.arange(N))[:, None]
    changes = {
        "1. Wider": star(sigma=np.sqrt(2) * SIGMA) - image,
        "2. y not integrated": not_integrated_along_y(Y)[0] - even,
        "3. From the edge": polynomial_from_the_edge() - image,
        "4. Flat repeated": image * (flat - 0.975),
        "5. Axes swapped": star(X, Y + MOTION) - image,
    }
    panels = {"Image": image} | changes
    names = list(panels)
    mosaic = [names[:3], names[3:], ["Even pixels"] * 3]
    figure, axes = plt.subplot_mosaic(mosaic, figsize=(8, 7.6), layout="constrained")
    for title, values in panels.items():
        ax = axes[title]
        largest = 100 * np.abs(values).max()
        low, colors = (0, "viridis") if title == "Image" else (-largest, "RdBu")
        drawn = ax.imshow(100 * values, origin="lower", vmin=low, vmax=largest, cmap=colors)
        ax.set_title(title, fontsize="medium")
        ax.set(xlabel="Column (pixel)", ylabel="Row (pixel)")
        ax.set(xticks=range(N), yticks=range(N))
        figure.colorbar(drawn, ax=ax, label="% of the flux", shrink=0.85)
    _draw_flux(axes["Even pixels"])
    return figure


def _draw_flux(ax):
    """Draw the flux of a star that moves along y over even pixels, with defects 1 and 2."""
    y = np.linspace(6, 7, 101)
    flux = not_integrated_along_y(y, np.sqrt(2) * SIGMA, n=13).sum(axis=(1, 2))
    ax.plot(y - 6, np.zeros_like(y), label="integrated")
    ax.plot(y - 6, 1e6 * (flux / flux.mean() - 1), "--", label="defects 1 and 2")
    ax.set(
        title="Flux of a star on uniform pixels",
        xlabel="Position along y (pixel)",
        ylabel="Change (ppm)",
    )
    ax.legend()


if __name__ == "__main__":
    make_figure()
