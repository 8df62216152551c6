"""Pixels, noise and headers are those of the first version; corrections and fits find the truth."""

import json
import runpy
from pathlib import Path

import numpy as np
import pytest

from scope_models import (
    BivariateGaussianPSF,
    Detector,
    Motion,
    SensitivityPolynomial,
    Star,
    fit_tpf,
    simulate,
)
from scope_models.correctors import PLDCorrector

RECORDED = runpy.run_path(str(Path(__file__).with_name("values") / "record.py"))
CASES = RECORDED["CASES"]
RECORD = json.loads(RECORDED["RECORD"].read_text(encoding="utf-8"))


@pytest.mark.filterwarnings("ignore::scope_models.exceptions.ScopeModelsWarning")
@pytest.mark.parametrize("name", CASES)
def test_values_are_those_on_record(name):
    values = CASES[name]()
    assert sorted(values) == sorted(RECORD[name])
    for key, expected in RECORD[name].items():
        value = values[key]
        if isinstance(expected, dict):
            scale = expected["scale"]
            assert value["scale"] == pytest.approx(scale, rel=1e-12), key
            np.testing.assert_allclose(
                value["sums"], expected["sums"], rtol=0, atol=1e-12 * scale, err_msg=key
            )
        elif isinstance(expected, float):
            assert value == pytest.approx(expected, rel=1e-12), key
        else:
            assert value == expected, key


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("seed", [1, 2])
def test_corrected_noise_is_that_of_the_pixels(seed, order):
    observation = simulate(
        Star(12.0), Detector.k2(shape=(7, 7)), 2 * Motion.k2_roll(240), seed=seed
    )
    aperture = observation.aperture
    light = observation.flux[:, aperture].sum(axis=1)
    noise = np.sqrt(np.square(observation.flux_err[:, aperture]).sum(axis=1))
    corrector = PLDCorrector(observation.to_tpf(), aperture_mask=aperture)
    curve = corrector.correct(order=order)
    level = np.nanmedian(curve.flux.value)
    scatter = np.nanstd(curve.flux.value) / level  # the star is constant
    assert scatter < 1.12 * np.median(noise / light)
    assert 0.9 < scatter / np.nanmedian(curve.flux_err.value / level) < 1.1
    assert np.nanstd(corrector.original_lc.flux.value) / level > 50 * scatter


@pytest.mark.parametrize("seed", [1, 2])
def test_fit_finds_positions_shape_and_constant_flux(seed):
    star = Star(12.0, 3.2, 2.9, psf=BivariateGaussianPSF(1, 0, 0, 0.55, 0.5, 0.1))
    detector = Detector.k2(shape=(7, 7), interpixel_distribution="normal")
    observation = simulate(star, detector, 5 * Motion.k2_roll(60), seed=seed)
    tpf = observation.to_tpf()
    fixed = SensitivityPolynomial(fixed={"ax1": True, "ay1": True})
    fit = fit_tpf(tpf, psf=1, sensitivity=fixed)
    assert fit.reduced_chi2 == pytest.approx(1, abs=0.02)  # 0.006
    for name, true in (("sigma_x", 0.55), ("sigma_y", 0.5), ("rho", 0.1)):
        assert abs(fit.values[name] - true) < 5 * fit.errors[name]
    for name in ("x", "y"):
        true = getattr(observation.truth, name)[0][tpf.quality_mask]
        error = getattr(fit, f"{name}_err")
        assert np.all(np.abs(getattr(fit, name) - true) < 5 * error)
    assert np.std(fit.flux) / np.mean(fit.flux) < 1e-3
