"""Each public name of tests/data/names_19e5c3d.rst does what it is for, in a few lines."""

import importlib
import warnings
from types import SimpleNamespace

import numpy as np
import pytest
from astropy.coordinates import EarthLocation, SkyCoord
from astropy.time import Time
from matplotlib import pyplot as plt

import scope_models as scope
from scope_models import (
    batch,
    correctors,
    effects,
    exceptions,
    fitting,
    io,
    missions,
    models,
    photometry,
    plotting,
    scene,
    simulation,
)

N = 150
RNG = np.random.default_rng(1)
IMAGE = np.add.outer(np.hanning(9), np.hanning(9)) ** 4 + 1.0


@pytest.fixture(scope="module")
def made():
    """Return a star and what the large calls make of it."""
    detector = scene.Detector.k2(shape=(7, 7))
    observation = simulation.simulate(
        scene.Star(12.0, 3.1, 2.9), detector, scene.Motion.k2_roll(N), seed=1
    )
    tpf = observation.to_tpf(quality_bitmask="none")
    corrector = correctors.PLDCorrector(tpf)
    corrector.correct(order=1)
    return SimpleNamespace(
        detector=detector, observation=observation, tpf=tpf, corrector=corrector,
        fit=fitting.fit_tpf(tpf, 1), flux=corrector.corrected_lc.flux.value,
        time=observation.time, scene=observation.scene, motion=observation.motion,
    )  # fmt: skip


@pytest.fixture(autouse=True)
def _close():
    yield
    plt.close("all")


def near(value, expected, rel=1e-3):
    return np.asarray(value, dtype=float) == pytest.approx(np.asarray(expected), rel=rel)


def total(model, **options):
    """Return the sum over pixels of a model in the middle of a stamp."""
    model.x_0 = model.y_0 = 7.0
    return models.integrate_pixels(model, (15, 15), **options).sum()


def pixels_with(effect, n=40, **options):
    """Return how much the pixels of a still star change if an effect is in its scene."""
    star, motion = scene.Star(11.0, 3.0, 3.0), scene.Motion.still(n)
    detector = scene.Detector.k2(shape=(7, 7), **options)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", exceptions.LostLightWarning)
        one, other = (
            simulation.simulate(star, detector, motion, seed=2, effects=each)
            for each in ((effect,), ())
        )
    same = np.array_equal(one.flux, other.flux, equal_nan=True)
    return not (same and np.array_equal(one.flux_bkg, other.flux_bkg))


PSF = models.BivariateGaussianPSF
KECK = EarthLocation.from_geodetic(-155.47, 19.83, 4145)
SKY = Time(2459000.4 + np.arange(3) / 24, format="jd"), SkyCoord(200, 85, unit="deg"), KECK
EFFECTS = {
    "Argabrightening": (effects.Argabrightening(rate=20.0), {}),
    "Background": (effects.Background(200.0), {}),
    "BrighterFatter": (effects.BrighterFatter(), {}),
    "ChargeTransferInefficiency": (effects.ChargeTransferInefficiency(1e-3, 1e-3), {}),
    "CosmicRays": (effects.CosmicRays(rate=100.0), {}),
    "DarkCurrent": (effects.DarkCurrent(50.0), {}),
    "Extinction": (effects.Extinction(0.1), {}),
    "Focus": (effects.Focus(0.1), {}),
    "Gaps": (effects.Gaps([[0.2, 0.4]] + scene.Motion.still(1).time[0]), {}),
    "Jitter": (effects.Jitter(0.2), {}),
    "NightSky": (effects.NightSky(moon_altitude=50.0), {}),
    "PixelShares": (effects.PixelShares(np.full((1, 7, 7), 1 / 49)), {}),
    "RollingBands": (effects.RollingBands(rate=20.0, amplitude=50.0), {}),
    "ScatteredLight": (effects.ScatteredLight(perigee=0.3, residual=0.1), {}),
    "Scintillation": (effects.Scintillation(), {}),
    "Seeing": (effects.Seeing(), {}),
    "SensitivityDropouts": (effects.SensitivityDropouts(rate=0.5, depth=0.3), {}),
    "Smear": (effects.Smear(residual=0.5), {}),
    "Throughput": (effects.Throughput(0.05), {}),
    "Undershoot": (effects.Undershoot(0.05, residual=1.0), {}),
}

#: What each name does: a function of what `made` returns that is true.
BEHAVIOR = {
    "scope_models.models": {
        "PRF": lambda _: near(total(models.PRF(PSF(), flux=3.0)), 3.0),
        "BivariateGaussianPSF": lambda _: near(total(PSF(flux=2.0, rho=0.3)), 2.0),
        "CorrectedPRF": lambda _: models.CorrectedPRF(IMAGE).x_0 == 0,
        "DiffusionSensitivity": lambda _: models.DiffusionSensitivity(0.2)(0.5, 0) < 1,
        "GaussHermitePSF": lambda _: near(total(models.GaussHermitePSF()), 1.0),
        "PRFGrid": lambda _: near(
            models.PRFGrid(
                [(1, 1), (1, 9), (9, 1), (9, 9)], 4 * (models.TabulatedPRF(IMAGE),)
            ).at(3, 3)(0.3, 0.2),
            models.TabulatedPRF(IMAGE)(0.3, 0.2),
        ),
        "SensitivityPolynomial": lambda _: near(models.SensitivityPolynomial()(0.5, 0), 0.9875),
        "TabulatedPRF": lambda _: near(
            models.TabulatedPRF(IMAGE)([0.0, 1.0], [0.0, 0.0]), IMAGE[4, 4:6]
        ),
        "TabulatedPSF": lambda _: near(models.TabulatedPSF(IMAGE, flux=2.0).flux, 2.0),
        "TransitModel": lambda _: near(
            models.TransitModel.from_depth_duration(0.01, 0.2, 3.0, 1.0)(1.0), 0.99
        ),
        "integrate_pixels": lambda _: near(
            models.integrate_pixels(PSF(), (1, 1))[0, 0], 0.6826895**2
        ),
        "moffat_psf": lambda _: near(
            models.moffat_psf(2.0)(1.0, 0.0), 0.5 * models.moffat_psf(2.0)(0.0, 0.0), 0.02
        ),
        "sinusoidal_signal": lambda _: near(models.sinusoidal_signal(0.1, 4.0)(1.0), 1.1),
        "stochastic_signal": lambda m: np.std(models.stochastic_signal(m.time, 50)(m.time)) > 0,
        "tabulated_signal": lambda _: near(
            models.tabulated_signal([0.0, 1.0], [1.0, 2.0])(0.5), 1.5
        ),
    },
    "scope_models.scene": {
        "PRESETS": lambda _: {"k2", "kepler", "tess"} <= set(scene.PRESETS),
        "ZERO_POINTS": lambda _: near(
            scene.ZERO_POINTS["Kepler"]["optimal aperture"], scene.Detector.k2().flux_from_mag(12)
        ),
        "Detector": lambda _: near(
            scene.Detector.k2().flux_from_mag(10) / scene.Detector.k2().flux_from_mag(15), 100
        ),
        "K2Roll": lambda _: near(scene.K2Roll(solar_rate=2.0).solar_rate, 2.0),
        "Motion": lambda m: near((2 * m.motion).x, 2 * m.motion.x),
        "MotionStatistics": lambda m: m.motion.statistics().maximum.value > 0,
        "Scene": lambda m: m.scene.replace(seed=5).seed == 5,
        "Star": lambda _: near(
            scene.Star(12.0, signal=np.full(3, 0.5)).relative_flux(np.arange(3.0)), 3 * [0.5]
        ),
    },
    "scope_models.effects": {
        name: lambda _, effect=effect, options=options: pixels_with(effect, **options)
        for name, (effect, options) in EFFECTS.items()
    }
    | {
        "Effect": lambda _: not pixels_with(effects.Effect()),
        "airmass": lambda _: (effects.airmass(*SKY) >= 1).all(),
        "mission_effects": lambda m: all(
            isinstance(each, effects.Effect) for each in effects.mission_effects(m.detector)
        ),
        "moon_geometry": lambda _: len(effects.moon_geometry(*SKY)) > 0,
    },
    "scope_models.simulation": {
        "Observation": lambda m: m.observation.model().shape == (N, 7, 7),
        "inject": lambda m: simulation.inject(m.tpf, np.full(N, 0.5), 0.9, seed=1).flux.value.sum()
        < 0.7 * m.tpf.flux.value.sum(),
        "simulate": lambda m: np.array_equal(simulation.simulate(m.scene).flux, m.observation.flux),
    },
    "scope_models.io": {
        "PixelSeries": lambda m: io.read_pixels(m.tpf).flux.shape == (N, 7, 7),
        "TPFMetadata": lambda m: io.TPFMetadata.of(m.detector, target_id=3).target_id == 3,
        "Truth": lambda m: near(m.observation.truth.flux[0], m.detector.flux_from_mag(12.0)),
        "conf": lambda _: io.conf.max_bytes == 2**30,
        "read_pixels": lambda m: near(io.read_pixels(m.tpf).time, m.time, 1e-9),
        "usable_positions": lambda _: io.usable_positions([[0.0, 0.1], [900.0, 0.0]]).tolist()
        == [True, False],
    },
    "scope_models.photometry": {
        "aperture_flux": lambda _: near(
            photometry.aperture_flux(np.ones((2, 9, 9)), IMAGE > 0), [81, 81]
        ),
        "cdpp": lambda _: near(photometry.cdpp(1 + 1e-4 * RNG.normal(size=5000)), 100 * 0.23, 0.1),
        "circular_aperture": lambda _: photometry.circular_aperture((7, 7), 3, 3, 1.1).sum() == 5,
        "contamination_aperture": lambda _: photometry.contamination_aperture(
            IMAGE, 0.1 * IMAGE
        ).all(),
        "crowding": lambda _: near(photometry.crowding(IMAGE, IMAGE, IMAGE > 0), 0.5),
        "flux_fraction": lambda _: near(
            photometry.flux_fraction(IMAGE, IMAGE > 0, 2 * IMAGE.sum()), 0.5
        ),
        "moving_aperture": lambda _: near(
            photometry.moving_aperture((9, 9), [4.0, 4.5], [4.0, 4.0], 2.0).sum(axis=(1, 2)),
            [13.8, 13.8], 0.01,
        ),
        "signal_to_noise_aperture": lambda _: photometry.signal_to_noise_aperture(IMAGE, 9.0)[4, 4],
        "threshold_aperture": lambda _: photometry.threshold_aperture(IMAGE, 2.0).sum()
        == (IMAGE > 2).sum(),
    },
    "scope_models.correctors": {
        "PLDCorrector": lambda m: photometry.cdpp(m.flux)
        < 0.5 * photometry.cdpp(m.corrector.original_lc),
        "PLDFit": lambda m: 0.5 < m.corrector.result.noise_scale < 2,
        "PLDOptions": lambda m: near(
            m.corrector.correct(1, options=correctors.PLDOptions(sigma=6.0)).flux.value.mean(),
            m.flux.mean(), 0.01,
        ),
    },
    "scope_models.fitting": {
        "FittedStar": lambda _: fitting.FittedStar(*np.ones((6, 3))).x_err.tolist() == [1, 1, 1],
        "FitOptions": lambda _: fitting.FitOptions(loss="soft_l1").loss == "soft_l1",
        "TPFFit": lambda m: 0.5 < m.fit.reduced_chi2 < 2,
        "fit_tpf": lambda m: near(np.median(m.fit.x), 3.1 + np.median(m.motion.x), 0.02),
    },
    "scope_models.plotting": {
        "animate_pixels": lambda m: plotting.animate_pixels(m.observation.flux[:2]).to_jshtml(),
        "plot_detector": lambda _: len(plotting.plot_detector(IMAGE, IMAGE, IMAGE)) == 3,
        "plot_fit": lambda m: len(
            plotting.plot_fit(IMAGE, IMAGE, 0 * IMAGE, m.fit.x, m.fit.y)
        ) > 2,
        "plot_fold": lambda m: plotting.plot_fold(m.time, 1.0 + 0 * m.time, 1.0, m.time[0]).lines,
        "plot_light_curve": lambda m: plotting.plot_light_curve(m.time, m.time).has_data(),
        "plot_motion": lambda m: plotting.plot_motion(m.time, m.motion.x, m.motion.y).collections,
        "plot_pixels": lambda _: near(plotting.plot_pixels(IMAGE).images[0].get_array(), IMAGE),
        "plot_psf": lambda _: near(plotting.plot_psf(IMAGE).images[0].get_array(), IMAGE),
        "plot_sensitivity": lambda _: plotting.plot_sensitivity(IMAGE).images,
        "plot_summary": lambda m: set(
            plotting.plot_summary(m.time, IMAGE, m.time, m.motion.x, m.motion.y)
        ) >= {"image", "motion", "light curve"},
        "plot_twin": lambda m: "raw" in plotting.plot_twin(
            m.time, *2 * [[m.time, m.time]], [IMAGE, IMAGE]
        ),
    },
    "scope_models.exceptions": {
        name: lambda _, name=name: issubclass(
            getattr(exceptions, name), exceptions.ScopeModelsWarning
        )
        for name in exceptions.__all__
        if name.endswith("Warning")
    },
    "scope_models.missions": {
        "MISSIONS": lambda _: missions.MISSIONS["TESS"].time_format == "btjd",
        "TIME_ZEROS": lambda _: missions.TIME_ZEROS["bkjd"] == 2454833,
        "Cadence": lambda _: missions.Cadence("long", 270).n_frames == 270,
        "Mission": lambda _: near(missions.MISSIONS["K2"].cadence_days("long"), 0.0204336, 1e-4),
        "QualityBits": lambda _: missions.MISSIONS["K2"].quality.safe_mode == 2,
    },
    "scope_models.batch": {
        "run_sweep": lambda _: batch.run_sweep(
            lambda task: {"twice": 2 * task["n"]}, [{"key": "a", "n": 4}], progress=False
        ).table["twice"][0] == 8,
    },
}  # fmt: skip
NAMES = [(place, name) for place, names in BEHAVIOR.items() for name in names]


@pytest.mark.parametrize(("place", "name"), NAMES, ids=[name for _, name in NAMES])
def test_behavior(place, name, made):
    assert getattr(importlib.import_module(place), name) is not None
    assert BEHAVIOR[place][name](made)


#: Names with a test of their own: files, and calls that take seconds.
ELSEWHERE = {
    "read_detector", "read_scene", "register_preset", "read_tpf", "read_truth", "write_tpf",
    "ComparisonResult", "compare_correctors", "detrend_file", "plot_scene", "CommonMotion",
}  # fmt: skip


@pytest.mark.parametrize("place", BEHAVIOR)
def test_every_public_name_has_a_test_of_its_behavior(place, repository):
    if place == "scope_models.batch":  # tests/batch
        return
    names = set(importlib.import_module(place).__all__) - set(BEHAVIOR[place])
    assert names <= ELSEWHERE
    text = "\n".join(p.read_text(encoding="utf-8") for p in repository.glob("tests/*/test_*.py"))
    assert [name for name in names if name not in text] == []


CALLS = {
    "correct": (
        lambda m, **bad: m.corrector.correct(**bad),
        {
            "order": -1, "cadence_mask": [True], "transit_mask": [True], "transit_model": [0.9],
            "fractions": "guessed", "regressors": [1.0], "options": 3,
        },
    ),
    "fit_tpf": (
        lambda m, **bad: scope.fit_tpf(m.tpf, **bad),
        {
            "psf": 0, "sensitivity": "flat", "stars": "all", "neighbors": 3, "empirical": -1,
            "interpixel": -1.0, "positions": "guessed", "response": "none",
            "options": 3,
        },
    ),
    "simulate": (
        lambda m, **bad: scope.simulate(m.scene.stars, m.detector, m.motion, **bad),
        {"seed": -1, "noise": "all", "chunk_size": 0, "effects": [3], "column": 0.5},
    ),
}  # fmt: skip


@pytest.mark.parametrize(
    ("call", "argument"), [(call, name) for call in CALLS for name in CALLS[call][1]]
)
def test_a_bad_argument_is_named(call, argument, made):
    function, bad = CALLS[call]
    with pytest.raises((TypeError, ValueError), match=f"`{argument}`"):
        function(made, **{argument: bad[argument]})
