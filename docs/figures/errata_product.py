"""Draw the flux of a star that crosses a pixel, with joint and with separate integrals."""

import matplotlib.pyplot as plt
import numpy as np

from scope_models import BivariateGaussianPSF, SensitivityPolynomial, integrate_pixels


def make_figure():
    """Return the figure."""
    x = np.linspace(7.0, 8.0, 101)
    star = BivariateGaussianPSF(1.0, x, 7.0)
    response = SensitivityPolynomial((1, 0, -0.05), (1,))
    joint = integrate_pixels(star * response, shape=(15, 15)).sum(axis=(1, 2))
    light = integrate_pixels(star, shape=(15, 15)).sum(axis=(1, 2))
    product = light * (1 - 0.05 / 12)  # the mean response of a pixel
    figure, ax = plt.subplots(figsize=(7, 3.2), layout="constrained")
    for flux, style, label in (
        (joint, "-", "integral of the product"),
        (product, "--", "product of the integrals"),
    ):
        ax.plot(x - 7, 1e6 * (flux / flux.mean() - 1), style, label=label)
    ax.set(xlabel="Position in the pixel (pixel)", ylabel="Change of the flux (ppm)")
    ax.legend()
    return figure


if __name__ == "__main__":
    make_figure()
