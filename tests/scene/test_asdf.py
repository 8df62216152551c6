"""Models and scenes go to ASDF and back."""

import numpy as np
import pytest
from astropy.coordinates import SkyCoord

from scope_models import (
    PRF,
    BivariateGaussianPSF,
    Detector,
    Motion,
    Scene,
    SensitivityPolynomial,
    Star,
    TabulatedPSF,
    TransitModel,
)
from scope_models.effects import CosmicRays, Focus
from scope_models.models import GaussHermitePSF, sinusoidal_signal, tabulated_signal

asdf = pytest.importorskip("asdf")
pytest.importorskip("asdf_astropy")

CORE = BivariateGaussianPSF(flux=0.7, sigma_x=0.6, sigma_y=0.5, rho=0.1, name="core")
WING = BivariateGaussianPSF(flux=0.3, sigma_x=1.6, sigma_y=1.5, fixed={"rho": True})
RESPONSE = SensitivityPolynomial((1, 0, -0.1), (1, 0.01, -0.2))


def back(value, path):
    """Return what a file of ASDF holds of a value."""
    from scope_models.scene._asdf import extensions

    with asdf.config_context() as config:
        for extension in extensions():
            config.add_extension(extension)
        asdf.AsdfFile({"value": value}).write_to(path)
        with asdf.open(path) as file:
            return file["value"]


@pytest.mark.parametrize(
    "model",
    [
        CORE,
        WING,
        CORE + WING,
        RESPONSE,
        (CORE + WING) * RESPONSE,
        GaussHermitePSF(sigma_x=0.7, c_2_0=0.1),
        TabulatedPSF(np.exp(-np.hypot(*np.indices((21, 21)) - 10.0)), 4),
        PRF((CORE + WING) * RESPONSE, flux=3.0, x_0=1.2, y_0=0.9),
    ],
    ids=lambda model: type(model).__name__,
)
def test_models(model, tmp_path):
    found = back(model, tmp_path / "model.asdf")
    y, x = np.mgrid[:4, :5].astype(float)
    assert type(found) is type(model)
    assert (found.name, found.param_names) == (model.name, model.param_names)
    assert np.array_equal(found.parameters, model.parameters)
    assert found.fixed == model.fixed
    assert np.allclose(found(x, y), model(x, y), rtol=1e-14)


def test_transit(tmp_path):
    planet = TransitModel.from_depth_duration(0.01, 0.2, 3.0, 1.0, exposure_time=0.02)
    found = back(planet, tmp_path / "planet.asdf")
    time = np.linspace(0, 4, 300)
    assert np.array_equal(found(time), planet(time))


@pytest.mark.parametrize(
    "signal", [sinusoidal_signal(0.1, 2.0), tabulated_signal([0, 1, 2], [1.0, 0.9, 1.0])]
)
def test_signals(signal, tmp_path):
    found = back(Star(12.0, signal=signal), tmp_path / "star.asdf")
    assert found == Star(12.0, signal=signal)


def test_scene(tmp_path):
    motion = Motion.k2_roll(20)
    stars = [
        Star(12.0, psf=CORE + WING),
        Star(14.0, 3.0, 4.0, signal=1 + 0.1 * np.sin(motion.time)),
    ]
    effects = [Focus(0.01, series=1 + 0.01 * motion.x), CosmicRays()]
    detector = Detector.k2(shape=(9, 9), sensitivity=RESPONSE, interpixel=np.full((9, 9), 0.99))
    scene = Scene(
        stars, detector, motion, seed=3, effects=effects, object_name="a star", ra=12.0, dec=-3.0,
        metadata={"campaign": 5},
    )  # fmt: skip
    assert back(scene, tmp_path / "scene.asdf") == scene
    for detector in (Detector.tess(), Detector.ground()):
        assert back(detector, tmp_path / "detector.asdf") == detector


def test_star_on_the_sky(tmp_path):
    star = Star(12.0, coord=SkyCoord(12.0, -3.0, unit="deg"))
    found = back(star, tmp_path / "star.asdf")
    assert found.coord.separation(star.coord).arcsec < 1e-9
    assert found.replace(coord=star.coord) == star


def test_functions_are_refused(tmp_path):
    with pytest.raises(TypeError, match="`signal` of a star must be a model or an array"):
        back(Star(12.0, signal=np.cos), tmp_path / "star.asdf")
