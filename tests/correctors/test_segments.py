"""Reversals of the roll."""

import numpy as np
import pytest

from scope_models.correctors._features import roll_reversals


def sawtooth(n, rng):
    return 0.3 * ((np.arange(n) % 12) / 12 - 0.5) + rng.normal(0, 0.005, n)


@pytest.mark.parametrize("sign", [1, -1])
def test_reversal_is_found(sign):
    rng = np.random.default_rng(0)
    time = 0.0204 * np.arange(3500)
    track = sawtooth(3500, rng)
    track = sign * np.where(time < 40, track, -track)
    (found,) = roll_reversals(time, track)
    assert found == pytest.approx(40, abs=2)


def test_no_reversal():
    rng = np.random.default_rng(1)
    time = 0.0204 * np.arange(3500)
    assert roll_reversals(time, sawtooth(3500, rng)) == ()
    assert roll_reversals(time, rng.normal(size=3500)) == ()
    assert roll_reversals(time[:100], sawtooth(100, rng)) == ()


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("ktwo206103150-c03_llc.fits", [2154, 2189]),
        ("ktwo211436265-c05_llc.fits", [2343]),
        ("ktwo211495446-c05_llc.fits", [2343]),
    ],
)
def test_campaigns(shared_data, name, expected):
    """Stars of one campaign reverse together; the times were read off plots of POS_CORR."""
    from astropy.io import fits

    table = fits.getdata(shared_data / "poscorr" / name, 1)
    time, x = table["TIME"], table["POS_CORR1"]
    good = np.isfinite(time) & np.isfinite(x) & (np.abs(x) < 3) & (table["SAP_QUALITY"] == 0)
    found = roll_reversals(time[good].astype(float), x[good].astype(float))
    np.testing.assert_allclose(found, expected, atol=3)
