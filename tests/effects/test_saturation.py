"""Bleeding: charge is conserved, wells are not exceeded, up and down are alike."""

import numpy as np
import pytest

from scope_models.effects._noise import bleed


def test_nothing_happens_below_the_well_depth():
    charge = np.random.default_rng(1).uniform(0, 10, (3, 5, 4))
    before = charge.copy()
    assert bleed(charge, 10.0) is charge
    assert np.array_equal(charge, before)


def test_charge_is_conserved_and_wells_are_kept():
    generator = np.random.default_rng(2)
    charge = generator.uniform(0, 8, (50, 41, 6))
    charge[:, 18:23, 2:4] += generator.uniform(0, 20, (50, 5, 2))
    before = charge.copy()
    bleed(charge, 10.0)
    assert charge.max() <= 10 * (1 + 1e-14)
    np.testing.assert_allclose(charge.sum(axis=1), before.sum(axis=1), rtol=1e-13)
    # Columns without a full pixel are untouched, and no pixel that was not full loses charge.
    untouched = before.max(axis=1) <= 10
    assert np.array_equal(charge.sum(axis=1)[untouched], before.sum(axis=1)[untouched])
    assert np.all(charge >= np.minimum(before, 10) - 1e-12)


def test_half_goes_up_and_half_down():
    column = np.zeros((11, 1))
    column[5] = 52.0
    bleed(column, 10.0)
    np.testing.assert_allclose(column[:, 0], [0, 0, 1, 10, 10, 10, 10, 10, 1, 0, 0], atol=1e-12)


@pytest.mark.parametrize("shape", [(12, 1), (4, 12, 3)])
def test_mirror_images_bleed_alike(shape):
    charge = np.random.default_rng(3).uniform(0, 25, shape)
    mirrored = charge[..., ::-1, :].copy()
    np.testing.assert_allclose(
        bleed(mirrored, 10.0), bleed(charge.copy(), 10.0)[..., ::-1, :], rtol=0, atol=1e-12
    )


def test_charge_beyond_the_edge_is_lost():
    column = np.array([[30.0], [2.0], [2.0], [2.0]])
    bleed(column, 10.0)
    # Half of 20 leaves the lower edge; half fills the next pixels.
    np.testing.assert_allclose(column[:, 0], [10, 10, 4, 2])
