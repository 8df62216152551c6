"""The model of a star and its neighbors, on pixels of known truth."""

import numpy as np
import pytest

from scope_models.benchmark import make_sky
from scope_models.pixelmodel._neighbors import fit_neighbors
from scope_models.pixelmodel._start import KnownNeighbors


def center(image):
    rows, columns = np.indices(image.shape)
    return np.array([np.sum(image * columns), np.sum(image * rows)]) / image.sum()


@pytest.mark.parametrize("motion", ["rest", "jitter"])
def test_widths_and_positions_of_a_star_that_hardly_moves(motion):
    """It shows one value of the PRF in each pixel; slopes come from a smooth prior."""
    sky = make_sky(f"{motion}-eclipses-30pct-neighbor", 4, n_cadences=400)
    seen = np.isfinite(sky.time) & np.isfinite(sky.flux).all(axis=(1, 2))
    star, other = (light[seen].mean(axis=0) for light in (sky.star_light, sky.neighbor_light))
    positions = np.column_stack([sky.pos_corr1, sky.pos_corr2])[seen]
    data = sky.time[seen], sky.flux[seen], sky.flux_err[seen] ** 2, positions
    known = KnownNeighbors(center(other)[np.newaxis], None)
    every = np.ones(seen.sum(), dtype=bool)
    nowhere = np.zeros(star.shape, dtype=bool)
    _, track, light = fit_neighbors(*data, center(star), every, known, nowhere)
    width = sky.width[seen]
    assert np.corrcoef(track.width, width)[0, 1] > 0.98  # 0.995
    assert 0.7 < np.polyfit(width / np.median(width), track.width, 1)[0] < 1.1  # 0.8, 0.9
    moved = np.column_stack([track.x - sky.x[seen], track.y - sky.y[seen]])
    assert moved.std(axis=0).max() < 5e-4  # 1.9e-4 px
    assert light.sum() == pytest.approx(sky.neighbor_light[seen].sum(), rel=0.02)
