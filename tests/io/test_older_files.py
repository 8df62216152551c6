"""Files written at commit 19e5c3d open and mean the same."""

import importlib.util

import numpy as np
import pytest

from scope_models import (
    BivariateGaussianPSF,
    Detector,
    Motion,
    read_pixels,
    read_scene,
    read_truth,
    simulate,
)
from scope_models.fitting import TPFFit


@pytest.fixture
def folder(repository):
    return repository / "tests" / "data" / "files_19e5c3d"


@pytest.fixture
def record(folder):
    """The script that made the files."""
    spec = importlib.util.spec_from_file_location("record_of_files", folder / "record.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_observation(folder, record):
    path = folder / "observation.fits.gz"
    observation = simulate(record.k2_scene())
    again = simulate(read_scene(path))
    pixels, truth = read_pixels(path, quality_bitmask="none"), read_truth(path)
    for made in (observation, again):
        np.testing.assert_allclose(made.flux, pixels.flux, rtol=1e-5)
        np.testing.assert_array_equal(made.quality, pixels.quality)
        for name, column in truth.columns.items():
            np.testing.assert_allclose(made.truth.columns[name], column, rtol=1e-9, atol=1e-12)
    assert sorted(truth.tables) == sorted(observation.truth.tables)
    assert again.scene.effects == observation.scene.effects
    assert again.scene.detector == observation.scene.detector


def test_signals_are_arrays(folder, record):
    found, scene = read_scene(folder / "observation.fits.gz"), record.k2_scene()
    for old, new in zip(found.stars, scene.stars, strict=True):
        np.testing.assert_allclose(
            old.relative_flux(found.motion.time), new.relative_flux(scene.motion.time), rtol=1e-12
        )


def test_scene(folder, record):
    found, made = read_scene(folder / "scene.fits.gz"), record.tess_scene()
    psf = found.detector.psf  # its exponentials depend on the machine, in the last digit
    np.testing.assert_allclose(psf.array, made.detector.psf.array, rtol=1e-14)
    detector = found.detector.replace(psf=made.detector.psf)
    assert found.replace(detector=detector) == made


def test_motion(folder, record):
    found, made = Motion.read(folder / "motion.ecsv"), record.k2_scene().motion
    generator = {"name": "K2Roll", **found.meta["generator"]}  # the file has no name
    assert found.replace(meta=found.meta | {"generator": generator}) == made


def test_detector(folder, record):
    assert Detector.read(folder / "detector.toml") == record.k2_scene().detector


def test_fit(folder, record, tmp_path):
    fit, truth = TPFFit.read(folder / "fit.fits.gz"), record.fitted_observation().truth
    assert np.abs(fit.x - truth.at_cadences(fit.cadenceno)["X1"]).max() < 0.02
    assert np.abs(fit.flux / truth.flux[0] - 1).max() < 0.02
    assert np.abs(fit.neighbors[0].flux / truth.flux[1] - 1).max() < 0.2
    assert isinstance(fit.model.psf, BivariateGaussianPSF)
    assert abs(fit.model.psf.sigma_x.value - 0.5) < 0.01
    again = TPFFit.read(fit.write(tmp_path / "fit.fits"))
    assert np.array_equal(again.parameters, fit.parameters)
