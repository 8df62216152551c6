"""Draw the logo: the track of a star over its pixels. ``python docs/figures/logo.py``."""

from pathlib import Path

import numpy as np

from scope_models import BivariateGaussianPSF, Motion, integrate_pixels

SIZE, SIDE = 4, 24  # pixels, and their size in the picture


def draw():
    """Return the picture as SVG."""
    motion = 6.5 * Motion.k2_roll(48, seed=3)
    offsets = np.stack([motion.x - motion.x.mean(), motion.y - motion.y.mean()])
    x, y = 1.5 + offsets
    psf = BivariateGaussianPSF(1.0, x, y, 0.55, 0.55)
    image = integrate_pixels(psf, shape=(SIZE, SIZE)).mean(axis=0)
    share = np.sqrt(image / image.max())
    low, high = np.array([28, 39, 76]), np.array([255, 196, 84])
    lines = [f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {SIZE * SIDE} {SIZE * SIDE}">']
    for row, column in np.ndindex(SIZE, SIZE):
        color = "#" + "".join(f"{int(v):02x}" for v in low + share[row, column] * (high - low))
        corner = f'x="{column * SIDE + 1}" y="{(SIZE - 1 - row) * SIDE + 1}"'
        lines.append(
            f'<rect {corner} width="{SIDE - 2}" height="{SIDE - 2}" rx="3" fill="{color}"/>'
        )
    points = zip((x + 0.5) * SIDE, (SIZE - 0.5 - y) * SIDE, strict=True)
    track = " ".join(f"{a:.1f},{b:.1f}" for a, b in points)
    lines.append(f'<polyline points="{track}" fill="none" stroke="#ffffff" stroke-width="3"')
    lines.append(' stroke-linejoin="round" stroke-linecap="round"/></svg>')
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    path = Path(__file__).parents[1] / "_static" / "logo.svg"
    path.write_text(draw(), encoding="utf-8")
