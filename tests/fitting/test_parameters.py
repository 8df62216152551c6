"""Kinds, bounds, steps and priors of a fit's parameters come from the models, never from names."""

import numpy as np
import pytest
from astropy import units as u
from astropy.modeling import Fittable2DModel, Parameter

from scope_models import PRF, BivariateGaussianPSF, SensitivityPolynomial
from scope_models.fitting._problem import fit_parameters
from scope_models.models import GaussHermitePSF


class UserPSF(Fittable2DModel):
    """A density with parameters whose names resemble others."""

    flux = Parameter(default=1.0)
    x_0 = Parameter(default=0.0)
    y_0 = Parameter(default=0.0)
    rho_s = Parameter(default=2.0, bounds=(0.5, None))
    c_scale = Parameter(default=-3.0)
    sigma = Parameter(default=0.01)

    @staticmethod
    def evaluate(x, y, flux, x_0, y_0, rho_s, c_scale, sigma):  # noqa: ARG004
        distance = (x - x_0) ** 2 + (y - y_0) ** 2
        return flux * np.exp(-distance / (2 * rho_s**2)) / (2 * np.pi * rho_s**2)


def test_names_of_the_user_get_nothing_special():
    rho_s, c_scale, sigma = fit_parameters(PRF(UserPSF()), (5, 5))
    assert (rho_s.lower, rho_s.upper, rho_s.prior) == (0.5, np.inf, np.inf)
    assert rho_s.relative
    for parameter in (c_scale, sigma):
        assert (parameter.kind, parameter.lower, parameter.upper) == ("other", -np.inf, np.inf)
        assert np.isinf(parameter.prior)
        assert np.isinf(parameter.largest_step)


def test_kinds_of_the_models():
    psf = BivariateGaussianPSF(0.9) + GaussHermitePSF(0.1, order=1)
    response = SensitivityPolynomial((1, 0, 0), (1,), fixed={"ax0": True})
    prf = PRF(psf * response)
    for name in prf.response_powers:
        getattr(prf, name).fixed = name == "ax0"
    parameters = {p.name: p for p in fit_parameters(prf, (5, 9))}
    assert parameters["sigma_x_0"].upper == 4.5
    assert parameters["sigma_x_0"].kind == "width"
    assert parameters["rho_0"].upper == 0.95
    assert parameters["c_1_0_1"].prior == 10
    assert parameters["ax2"].upper == 4
    assert parameters["flux_fraction_1"].upper == 1
    assert "ax0" not in parameters
    assert "x_offset_1" not in parameters


def test_quantities(fit):
    assert fit.quantity("sigma_x_0") == fit.values["sigma_x_0"] * u.pix
    assert fit.quantity("ax2").unit == u.dimensionless_unscaled
    with pytest.raises(KeyError, match="sigma_z"):
        fit.quantity("sigma_z")
