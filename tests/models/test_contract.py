"""The contract of every public model, over one table of all of them."""

import copy
import inspect
import pickle

import numpy as np
import pytest
from astropy import units as u
from astropy.modeling import Model
from astropy.modeling.bounding_box import ModelBoundingBox
from astropy.modeling.fitting import TRFLSQFitter

import scope_models.models
from scope_models import PRF, BivariateGaussianPSF, SensitivityPolynomial, TransitModel
from scope_models.models import (
    CorrectedPRF,
    DiffusionSensitivity,
    GaussHermitePSF,
    TabulatedPRF,
    TabulatedPSF,
)

RATE = u.electron / u.s


def _two_components():
    core = BivariateGaussianPSF(0.8, 0.1, 0.2, 0.5, 0.45, 0.2)
    wings = BivariateGaussianPSF(0.2, 0.15, 0.1, 1.2, 1.1, -0.3)
    return (core + wings) * SensitivityPolynomial((1, 0.01, -0.05), (1, 0, -0.05))


def _table(kind, model):
    y, x = np.mgrid[-30:31, -30:31] / 5
    return kind(model(x, y), 5, 7.0, 0.1, -0.2)


def _corrected():
    table = _table(TabulatedPRF, PRF(BivariateGaussianPSF(sigma_x=0.6, sigma_y=0.7)))
    coefficients = {"c_1_0": 0.02, "c_2_0": 0.1, "c_1_1": -0.05}
    return CorrectedPRF(table.array, 5, 7.0, 0.1, -0.2, order=2, **coefficients)


# Each row: a model inside its domain; inputs inside its domain; the unit of its inputs and that of
# its output for parameters with units; whether it is bounded; parameters that a fit to its own
# values cannot tell from others.
MODELS = {
    "BivariateGaussianPSF": {
        "model": BivariateGaussianPSF(5.0, 0.1, -0.2, 0.6, 0.5, 0.3),
        "units": {"flux": RATE, "x_0": u.pix, "y_0": u.pix, "sigma_x": u.pix, "sigma_y": u.pix},
        "input_unit": u.pix,
        "output_unit": RATE / u.pix**2,
        "bounded": True,
        "free": None,
    },
    "CorrectedPRF": {
        "model": _corrected(),
        "units": {"flux": RATE, "x_0": u.pix, "y_0": u.pix},
        "input_unit": u.pix,
        "output_unit": RATE,
        "bounded": True,
        "free": {"flux", "x_0", "y_0", "c_2_0", "c_1_1"},
    },
    "DiffusionSensitivity": {
        "model": DiffusionSensitivity(0.2),
        "units": {},
        "input_unit": u.pix,
        "output_unit": u.dimensionless_unscaled,
        "bounded": False,
        "free": None,
    },
    "GaussHermitePSF": {
        "model": GaussHermitePSF(5.0, 0.1, -0.2, 0.6, 0.5, order=3, c_2_0=0.1, c_1_2=-0.05),
        "units": {"flux": RATE, "x_0": u.pix, "y_0": u.pix, "sigma_x": u.pix, "sigma_y": u.pix},
        "input_unit": u.pix,
        "output_unit": RATE / u.pix**2,
        "bounded": True,
        "free": {"flux", "c_2_0", "c_1_2", "c_3_0"},
    },
    "SensitivityPolynomial": {
        "model": SensitivityPolynomial((1, 0.02, -0.05), (1, 0, -0.04, 0.3)),
        "units": {},
        "input_unit": u.pix,
        "output_unit": u.dimensionless_unscaled,
        "bounded": False,
        "free": {"ax1", "ax2", "ay0", "ay1", "ay2", "ay3"},
    },
    "PRF": {
        "model": PRF(_two_components(), flux=20.0),
        "units": {
            "flux": RATE, "x_0": u.pix, "y_0": u.pix, "x_offset_1": u.pix, "y_offset_1": u.pix,
            "sigma_x_0": u.pix, "sigma_y_0": u.pix, "sigma_x_1": u.pix, "sigma_y_1": u.pix,
        },
        "input_unit": u.pix,
        "output_unit": RATE,
        "bounded": True,
        "free": {"flux", "x_0", "y_0", "sigma_x_0", "sigma_y_0", "rho_0"},
    },
    "TabulatedPSF": {
        "model": _table(TabulatedPSF, BivariateGaussianPSF(sigma_x=0.6, sigma_y=0.7)),
        "units": {"flux": RATE, "x_0": u.pix, "y_0": u.pix},
        "input_unit": u.pix,
        "output_unit": RATE / u.pix**2,
        "bounded": True,
        "free": None,
    },
    "TabulatedPRF": {
        "model": _table(TabulatedPRF, PRF(BivariateGaussianPSF(sigma_x=0.6, sigma_y=0.7))),
        "units": {"flux": RATE, "x_0": u.pix, "y_0": u.pix},
        "input_unit": u.pix,
        "output_unit": RATE,
        "bounded": True,
        "free": None,
    },
    "TransitModel": {
        "model": TransitModel(period=3.0, t0=0.02, rp=0.1, a=8.0, inc=88.0),
        "units": {"period": u.day, "t0": u.day, "inc": u.deg, "omega": u.deg},
        "input_unit": u.day,
        "output_unit": u.dimensionless_unscaled,
        "bounded": False,
        "free": {"t0", "rp"},
    },
}  # fmt: skip
NAMES = sorted(MODELS)


def inputs(model):
    if model.n_inputs == 1:
        return (np.linspace(-0.2, 0.25, 60),)
    if isinstance(model, PRF):
        y, x = np.mgrid[-3:4.0, -3:4.0]
        return x, y
    x, y = np.random.default_rng(8).uniform(-1.4, 1.4, (2, 7, 9))
    return x, y


def with_units(row):
    model = row["model"].copy()
    for name, unit in row["units"].items():
        parameter = getattr(model, name)
        parameter.quantity = parameter.value * unit
    return model


def test_every_public_model_has_a_row():
    public = {
        name
        for name in scope_models.models.__all__
        if inspect.isclass(getattr(scope_models.models, name))
        and issubclass(getattr(scope_models.models, name), Model)
    }
    assert public == set(MODELS)


@pytest.mark.parametrize("name", NAMES)
def test_parameters_are_described(name):
    model = MODELS[name]["model"]
    for parameter in model.param_names:
        assert len(getattr(model, parameter).__doc__ or "") > 5, parameter


@pytest.mark.parametrize("name", NAMES)
def test_evaluate_keeps_shapes_and_is_stateless(name):
    model = MODELS[name]["model"]
    arguments = inputs(model)
    values = model(*arguments)
    assert values.shape == arguments[0].shape
    assert np.all(np.isfinite(values))
    flat = model(*(a.ravel() for a in arguments))
    np.testing.assert_allclose(flat, values.ravel(), rtol=1e-12, atol=1e-15)
    other = model.parameters * 1.01 if name != "TransitModel" else model.parameters
    shifted = model.evaluate(*arguments, *other)
    assert np.all(np.isfinite(shifted))
    np.testing.assert_array_equal(model(*arguments), values)
    scalar = model(*(a.flat[5] for a in arguments))
    assert np.ndim(scalar) == 0
    assert scalar == pytest.approx(values.flat[5], rel=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_derivatives(name):
    """Analytic derivatives against central differences of fourth order."""
    model = MODELS[name]["model"]
    if model.fit_deriv is None:
        pytest.skip(f"{name} leaves its derivatives to the fitter")
    arguments = inputs(model)
    derivatives = model.fit_deriv(*arguments, *model.parameters)
    assert len(derivatives) == len(model.param_names)
    steps = [(2, -1 / 12), (1, 8 / 12), (-1, -8 / 12), (-2, 1 / 12)]
    for i, derivative in enumerate(derivatives):
        numerical = 0.0
        for factor, weight in steps:
            values = model.parameters.copy()
            values[i] += factor * 1e-4
            numerical = numerical + weight * model.evaluate(*arguments, *values)
        numerical /= 1e-4
        scale = max(np.max(np.abs(numerical)), 1e-3)
        assert np.max(np.abs(derivative - numerical)) < 1e-8 * scale, model.param_names[i]


@pytest.mark.parametrize("name", NAMES)
def test_copies_and_pickles(name):
    model = MODELS[name]["model"]
    arguments = inputs(model)
    for other in (model.copy(), copy.copy(model), pickle.loads(pickle.dumps(model))):  # noqa: S301
        assert type(other) is type(model)
        assert other.param_names == model.param_names
        np.testing.assert_array_equal(other(*arguments), model(*arguments))
        assert other.fixed == model.fixed
        assert other.bounds == model.bounds
    changed = model.copy()
    setattr(changed, model.param_names[0], getattr(model, model.param_names[0]).value * 1.5)
    assert not np.allclose(changed.parameters, model.parameters)


@pytest.mark.parametrize("name", NAMES)
def test_units(name):
    row = MODELS[name]
    model = with_units(row)
    arguments = inputs(model)
    result = model(*(a * row["input_unit"] for a in arguments))
    if not isinstance(result, u.Quantity):
        result = u.Quantity(result)
    assert result.unit.is_equivalent(row["output_unit"])
    plain = row["model"](*arguments)
    np.testing.assert_allclose(result.to_value(row["output_unit"]), plain, rtol=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_bounding_box(name):
    row = MODELS[name]
    model = row["model"]
    if not row["bounded"]:
        with pytest.raises(NotImplementedError):
            _ = model.bounding_box
        return
    box = model.bounding_box
    assert isinstance(box, ModelBoundingBox)
    (y_low, y_high), (x_low, x_high) = box.bounding_box()
    y, x = np.mgrid[-12:13.0, -12:13.0]
    values = model(x, y)
    outside = (x < x_low) | (x > x_high) | (y < y_low) | (y > y_high)
    assert np.any(outside)
    assert np.sum(values[outside]) < 1e-8 * np.sum(values)


@pytest.mark.parametrize("name", NAMES)
def test_fits_its_own_values(name):
    row = MODELS[name]
    truth = row["model"]
    arguments = inputs(truth)
    start = truth.copy()
    free = row["free"] or set(truth.param_names)
    for parameter in truth.param_names:
        getattr(start, parameter).fixed = parameter not in free
        if parameter in free:
            setattr(start, parameter, getattr(truth, parameter).value * 1.02 + 0.003)
    fitted = TRFLSQFitter()(start, *arguments, truth(*arguments), maxiter=200)
    np.testing.assert_allclose(fitted.parameters, truth.parameters, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("name", NAMES)
def test_nan_is_refused(name):
    model = MODELS[name]["model"]
    values = dict(zip(model.param_names, model.parameters, strict=True))
    values[model.param_names[0]] = np.nan
    make = {
        "SensitivityPolynomial": lambda: SensitivityPolynomial((np.nan, 1)),
        "PRF": lambda: PRF(_two_components(), flux=np.nan),
        "CorrectedPRF": lambda: CorrectedPRF(np.ones((7, 7)), flux=np.nan),
        "TabulatedPRF": lambda: TabulatedPRF(np.ones((7, 7)), flux=np.nan),
        "TabulatedPSF": lambda: TabulatedPSF(np.ones((7, 7)), flux=np.nan),
    }.get(name, lambda: type(model)(**values))
    with pytest.raises(ValueError, match=r"finite|must be"):
        make()
