"""The sensitivity polynomial."""

import numpy as np
import pytest

from scope_models import SensitivityPolynomial


def test_paper_values():
    """The corner of a pixel has 0.9875^2 = 0.9752 of its center: the paper's 2.48 %."""
    s = SensitivityPolynomial()
    assert s(4, 5) == 1
    assert s(4.5, 5.5) == pytest.approx(0.9875**2, rel=1e-14)
    assert 1 - s(3.5, 5.5) == pytest.approx(0.0248, abs=5e-5)


def test_same_in_every_pixel():
    s = SensitivityPolynomial((1, 0.3, -0.2), (0.9, 0.1, 0.1, -0.4))
    u, v = np.random.default_rng(2).uniform(-0.499, 0.499, (2, 20))
    expected = np.polyval([-0.2, 0.3, 1], u) * np.polyval([-0.4, 0.1, 0.1, 0.9], v)
    for i, j in [(0, 0), (7, 3), (-4, 12)]:
        np.testing.assert_allclose(s(i + u, j + v), expected, rtol=1e-12)


def test_edges_belong_to_the_next_pixel():
    s = SensitivityPolynomial((0, 1), (1,))
    assert s(2.5, 0) == -0.5
    assert s(np.nextafter(2.5, 0), 0) == pytest.approx(0.5)


def test_any_degree_per_axis():
    s = SensitivityPolynomial((1,), np.arange(1.0, 8.0))
    assert s.param_names == ("ax0", *(f"ay{n}" for n in range(7)))
    assert s.x_coefficients == (1.0,)
    assert s.y_coefficients == tuple(np.arange(1.0, 8.0))
    s.ay3 = 0.5
    assert s.y_coefficients[3] == 0.5
    assert SensitivityPolynomial().param_names == ("ax0", "ax1", "ax2", "ay0", "ay1", "ay2")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (((),), "`x_coefficients` must be a sequence of at least one number"),
        (((1,), 1.0), "`y_coefficients` must be a sequence of at least one number"),
        (([[1, 2]],), "`x_coefficients` must be a sequence"),
        (((1, np.nan),), "`ax1` must be finite, got nan"),
    ],
)
def test_bad_coefficients(arguments, message):
    with pytest.raises(ValueError, match=message):
        SensitivityPolynomial(*arguments)
