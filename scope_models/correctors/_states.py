"""What a model of the pixels finds in each cadence."""

from dataclasses import dataclass

import numpy as np

__all__ = ["CleanPixels"]


@dataclass(frozen=True)
class CleanPixels:
    """The light of a star without background, and predicted pixel fractions.

    The ``light`` is that of the aperture, by least squares, cosmic rays replaced; constant light is
    taken off where it is known, and what the focus moves over the border of the aperture is put
    back. The ``background`` is relative to its median where the dark pixels may hold the star's
    wings.
    """

    light: np.ndarray  # e-/s, (n,)
    light_error: np.ndarray  # standard deviation of its noise, e-/s, (n,)
    shares: np.ndarray  # fractions of this light (n, n_pixels), 0 outside of the aperture
    still: np.ndarray  # those of the light at the slow focus; they add up to 1
    outside: np.ndarray  # the star's light in its other pixels over that inside, (n,)
    background: np.ndarray  # e-/s, (n, n_pixels)
    position: np.ndarray  # relative to the median, px, (n, 2)
    focus: np.ndarray  # relative change of the PSF's width without short dips, (n,)
    constant: float  # median of the constant light that was taken off, e-/s
    repaired: np.ndarray  # pixels whose light was replaced by the model's, (n, n_pixels)

    def leaks(self):
        """Return the states by name, and the light that positions and width move in each pixel."""
        background = np.mean(self.background, axis=1)
        states = {
            "Column (pixel)": self.position[:, 0],
            "Row (pixel)": self.position[:, 1],
            "Relative width": np.round(self.focus - np.median(self.focus), 12),
            "Background (e-/s)": background - np.median(background),
        }
        moving = list(states)[:3]
        columns = np.column_stack([np.ones_like(self.focus), *(states[name] for name in moving)])
        slopes = np.linalg.lstsq(columns, self.shares, rcond=None)[0][1:]
        sizes = np.std(columns[:, 1:], axis=0)
        return states, dict(zip(moving, sizes[:, np.newaxis] * slopes, strict=True))
