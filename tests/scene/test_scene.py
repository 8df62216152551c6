"""Scenes: what a file holds gives the same pixels again, bit for bit."""

import pickle

import astropy.units as u
import numpy as np
import pytest
from astropy.io import fits
from astropy.modeling.models import Linear1D
from astropy.wcs import WCS
from matplotlib import pyplot as plt
from photutils.psf import MoffatPSF

from scope_models import Detector, Motion, Scene, Star, simulate
from scope_models.effects import Undershoot
from scope_models.io import read_truth
from scope_models.models import (
    BivariateGaussianPSF,
    SensitivityPolynomial,
    TabulatedPSF,
    TransitModel,
    sinusoidal_signal,
    tabulated_signal,
)
from scope_models.scene import read_detector, read_scene

CORE = BivariateGaussianPSF(0.7, sigma_x=0.45, sigma_y=0.55, rho=-0.3)
WINGS = BivariateGaussianPSF(0.3, 0.1, -0.05, sigma_x=1.2, sigma_y=1.1)
SCENES = {
    "defaults": ([Star(12.0)], Detector.k2(), Motion.k2_roll(40, seed=1), {}),
    "everything": (
        [
            Star(9.0, 4.9, 5.2, CORE + WINGS, signal=lambda time: 1 + 0.01 * np.sin(time)),
            Star(13.5, 6.0, 3.0, MoffatPSF(flux=2.0, alpha=0.9, beta=3.5), signal=np.ones(40)),
        ],
        Detector.kepler(
            interpixel=np.random.default_rng(1).uniform(0.98, 1.02, (11, 11)),
            sensitivity=SensitivityPolynomial((1, 0.01, -0.06), (1, 0, -0.04, 0, 0.1)),
            cadence="short",
        ),
        3 * Motion.k2_roll(40, seed=2),
        {"noise": ("photon", "read", "quantization"), "n_sub": 3},
    ),
    "tess": (
        [Star(10.0)],
        Detector.tess(shape=(9, 13), interpixel_distribution="normal", zero_point=1.1),
        Motion.still(40, cadence=1 / 720, time_format="btjd"),
        {"noise": False},
    ),
}


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("suffix", [".fits", ".fits.gz"])
def test_scene_in_a_file_gives_the_same_pixels(name, suffix, tmp_path):
    stars, detector, motion, options = SCENES[name]
    observation = simulate(stars, detector, motion, seed=12, **options)
    scene = read_scene(observation.write(tmp_path / f"star{suffix}"))
    again = simulate(*scene, **scene.options)
    for cube in ("flux", "flux_err", "flux_bkg", "raw_cnts"):
        assert np.array_equal(getattr(again, cube), getattr(observation, cube))
    assert np.array_equal(again.model(), observation.model())
    for quantity in ("time", "x", "y", "quality", "cadenceno"):
        assert np.array_equal(getattr(scene.motion, quantity), getattr(motion, quantity))
    assert scene.motion.time_format == motion.time_format
    assert repr(scene.detector) == repr(detector)
    # The scene of an observation is the one that it was made of.
    direct = simulate(*observation.scene, **observation.scene.options)
    assert np.array_equal(direct.flux, observation.flux)


def test_default_places_and_psfs_stay_defaults(tmp_path):
    observation = simulate(Star(12.0), Detector.k2(), Motion.still(3), seed=1)
    star = read_scene(observation.write(tmp_path / "star.fits")).stars[0]
    assert (star.mag, star.x_0, star.y_0, star.psf, star.signal) == (12.0, None, None, None, None)


def make_scene(**changes):
    stars = [Star(12.0, 4.0, 5.0, CORE + WINGS, np.ones(40)), Star(14.0)]
    fields = {"seed": 3, "noise": "read", "n_sub": 2, "target_id": 7, "object_name": "a star"}
    fields |= {"ra": 12.5, "dec": -3.25, "orientation": 10.0, "column": 33, "row": 0}
    fields |= {"metadata": {"campaign": 5}}
    return Scene(stars, Detector.k2(), 2 * Motion.k2_roll(40, seed=1), **(fields | changes))


@pytest.mark.parametrize("name", ["scene.fits", "scene.fits.gz"])
def test_a_scene_is_written_without_a_simulation(name, tmp_path, monkeypatch):
    monkeypatch.setattr("scope_models.models._series.ImageSeries.__call__", None)
    response = np.random.default_rng(1).uniform(0.98, 1.02, (11, 11))
    for scene in (
        make_scene(),
        make_scene(seed=None),
        make_scene(noise=False).replace(detector=Detector.tess(interpixel=response)),
    ):
        path = scene.write(tmp_path / name, overwrite=True)
        assert Scene.read(path) == scene
        assert read_scene(path) == scene
    with pytest.raises(OSError, match="exists"):
        scene.write(tmp_path / name)


def test_scenes_are_equal_by_value():
    assert make_scene() == make_scene()
    assert make_scene() != "a scene"
    assert len({make_scene(), make_scene()}) == 1
    changes = {
        "seed": 4,
        "noise": True,
        "stars": [Star(12.0, 4.0, 5.0, CORE + WINGS, np.full(40, 2.0)), Star(14.0)],
        "detector": Detector.k2(read_noise=1.0),
        "motion": 3 * Motion.k2_roll(40, seed=1),
        "row": 1,
        "metadata": {},
    }
    for name, value in changes.items():
        assert make_scene().replace(**{name: value}) != make_scene(), name
    assert pickle.loads(pickle.dumps(make_scene())) == make_scene()  # noqa: S301


def test_identity_of_a_scene_is_in_its_file(tmp_path):
    observation = simulate(make_scene())
    path = observation.write(tmp_path / "star.fits")
    with fits.open(path) as hdus:
        header = {**hdus[0].header, **hdus[1].header}
        facts = {
            key: header[key] for key in ("KEPLERID", "OBJECT", "RA_OBJ", "DEC_OBJ", "CAMPAIGN")
        }
        assert list(facts.values()) == [7, "a star", 12.5, -3.25, 5]
        assert (header["1CRV5P"], header["2CRV5P"]) == (33, 0)
    assert read_scene(path) == observation.scene == make_scene()
    changed = observation.write(tmp_path / "b.fits", metadata={"object_name": "another"})
    assert fits.getheader(changed)["OBJECT"] == "another"


def test_world_coordinates_are_those_of_the_file(tmp_path):
    scene = make_scene()
    sky = scene.wcs.pixel_to_world(4.0, 5.0)  # the target's place
    assert (sky.ra.deg, sky.dec.deg) == pytest.approx((12.5, -3.25))
    up = scene.wcs.pixel_to_world(4.0, 6.0)
    assert sky.position_angle(up).deg == pytest.approx(10.0, abs=1e-3)
    assert sky.separation(up).arcsec == pytest.approx(3.98)
    with fits.open(simulate(scene).write(tmp_path / "star.fits")) as hdus:
        wcs = WCS(hdus["APERTURE"].header)
    x, y = np.mgrid[:11, :11]
    ours, others = (w.pixel_to_world(x, y) for w in (scene.wcs, wcs))
    assert ours.separation(others).arcsec.max() < 1e-6


def test_units_of_a_scene():
    scene = make_scene(ra=0.5 * u.hourangle, dec=60 * u.arcmin, orientation=0.1 * u.rad)
    assert (scene.ra, scene.dec) == pytest.approx((7.5, 1.0))
    assert scene.orientation == pytest.approx(np.degrees(0.1))


@pytest.mark.parametrize(
    "changes, error, message",
    [
        ({"ra": 3 * u.m}, ValueError, "`ra` must be in deg, or convert to it, got m"),
        ({"target_id": 0}, ValueError, "`target_id` must be at least 1, got 0"),
        ({"column": 1.5}, TypeError, "`column` must be an integer, got 1.5"),
        ({"object_name": 7}, TypeError, "`object_name` must be text, got 7"),
        ({"metadata": 7}, TypeError, "`metadata` must be a mapping, got 7"),
        ({"sead": 7}, TypeError, "sead"),
    ],
)
def test_bad_scenes(changes, error, message):
    with pytest.raises(error, match=message):
        make_scene(**changes)


def test_scene_shows_what_it_is():
    text = "<Scene a star of 2 stars, K2, 40 cadences of 11 x 11 pixels, seed 3>"
    assert repr(make_scene()) == text
    html = make_scene()._repr_html_()
    assert "<th>star 2</th><td>magnitude 14 at column 5, row 5</td>" in html
    assert "&lt;Scene a star" in html


def test_a_scene_alone_has_no_flux(tmp_path):
    with pytest.raises(ValueError, match="the truth has no flux: nothing was simulated"):
        _ = read_truth(make_scene().write(tmp_path / "scene.fits")).flux


def test_files_without_a_scene(shared_data, tmp_path):
    with pytest.raises(ValueError, match="holds no truth"):
        read_scene(shared_data / "tess_tpf" / "tesssip_tpf1.fits")
    with pytest.raises(FileNotFoundError, match=r"absent\.fits"):
        read_scene(tmp_path / "absent.fits")


def test_scene_of_a_later_version(tmp_path, monkeypatch):
    monkeypatch.setattr("scope_models.scene._files._VERSION", 4)
    observation = simulate(Star(12.0), Detector.k2(), Motion.still(3), seed=1)
    path = observation.write(tmp_path / "star.fits")
    monkeypatch.setattr("scope_models.scene._files._VERSION", 3)
    with pytest.raises(ValueError, match="a scene of a later version"):
        read_scene(path)


@pytest.mark.parametrize(
    "name", ["unknown.PSF", "scope_models.io.read_truth", "numpy.ndarray", "NoModel", 5, None]
)
def test_only_models_are_made(name, tmp_path, monkeypatch):
    observation = simulate(Star(12.0, psf=CORE), Detector.k2(), Motion.still(3), seed=1)
    path = observation.write(tmp_path / "star.fits")
    truth = read_truth(path)
    truth.scene["stars"][0]["psf"] |= {"class": name}
    monkeypatch.setattr("scope_models.scene._files.read_truth", lambda _: truth)
    with pytest.raises(ValueError, match=rf"{name}'? is not the name of a model"):
        read_scene(path)


class OwnPSF(BivariateGaussianPSF):
    """A PSF of the user's own."""


class OwnEffect(Undershoot):
    """An effect of the user's own."""


def test_classes_of_a_user(tmp_path):
    stars, effects = [Star(12.0, psf=OwnPSF(sigma_x=0.7))], [OwnEffect()]
    scene = Scene(stars, Detector.k2(), Motion.still(3), seed=1, effects=effects)
    path = scene.write(tmp_path / "scene.fits")
    assert read_scene(path) == scene
    assert type(read_scene(path).stars[0].psf) is OwnPSF
    assert "module" not in read_truth(path).scene["stars"][0]["psf"]


@pytest.mark.parametrize(
    "signal",
    [
        TransitModel.from_depth_duration(0.01, 0.2, 3.0, 1.0, exposure_time=0.02),
        TransitModel(period=48 * u.hour) * sinusoidal_signal(0.1, 2.0),
        tabulated_signal([0, 1e4], [1.0, 0.9]),
        Linear1D(0.0, 1.0),
        np.linspace(0.9, 1.1, 10),
    ],
    ids=["transit", "product", "table", "astropy", "array"],
)
def test_signals_come_back(signal, tmp_path):
    scene = Scene(Star(12.0, signal=signal), Detector.k2(), Motion.still(10), seed=1)
    found = read_scene(scene.write(tmp_path / "scene.fits"))
    assert found == scene
    longer = Motion.still(30)
    if isinstance(signal, np.ndarray):
        with pytest.raises(ValueError, match="`signal` must give one number for each"):
            simulate(found.replace(motion=longer))
    else:
        flux = found.replace(motion=longer).stars[0].relative_flux(longer.time)
        assert np.array_equal(flux, signal(longer.time))


def test_functions_come_back_as_arrays(tmp_path):
    scene = Scene(
        Star(12.0, signal=lambda time: 1 + 1e-4 * time), Detector.k2(), Motion.still(10), seed=1
    )
    found = read_scene(scene.write(tmp_path / "scene.fits")).stars[0].signal
    assert np.array_equal(found, 1 + 1e-4 * scene.motion.time)


def test_old_undershoot_stays_in_the_flux(tmp_path, monkeypatch):
    scene = Scene(Star(12.0), Detector.k2(), Motion.still(3), seed=1, effects=Undershoot())
    path = scene.write(tmp_path / "scene.fits")
    truth = read_truth(path)
    del truth.scene["effects"][0]["parameters"]["residual"]
    monkeypatch.setattr("scope_models.scene._files.read_truth", lambda _: truth)
    assert read_scene(path).effects[0].residual == 1.0


DETECTOR = """
mission = "balloon"
shape = [7, 9]
pixel_scale = 2.5
zero_point = 1e5
zero_point_mag = 12
int_time = 10
n_frames = 6
read_noise = 5.0
well_depth = 1e6

[sensitivity]
x_coefficients = [1, 0, -0.1]
y_coefficients = [1, 0, -0.2]

[[psf]]
model = "BivariateGaussianPSF"
flux = 0.7
sigma_x = 0.6

[[psf]]
model = "photutils.psf.MoffatPSF"
flux = 0.3
alpha = 1.2
beta = 3.0
"""


def test_detector_from_toml(tmp_path):
    path = tmp_path / "detector.toml"
    path.write_text(DETECTOR, encoding="utf-8")
    detector = read_detector(path)
    expected = Detector(
        mission="balloon",
        shape=(7, 9),
        pixel_scale=2.5,
        zero_point=1e5,
        zero_point_mag=12.0,
        int_time=10.0,
        n_frames=6,
        read_noise=5.0,
        well_depth=1e6,
        sensitivity=SensitivityPolynomial((1, 0, -0.1), (1, 0, -0.2)),
        psf=BivariateGaussianPSF(0.7, sigma_x=0.6) + MoffatPSF(flux=0.3, alpha=1.2, beta=3.0),
    )
    assert repr(detector) == repr(expected)
    images = [
        simulate(Star(12.0), item, Motion.still(2), seed=1).flux for item in (detector, expected)
    ]
    assert np.array_equal(*images)


@pytest.mark.parametrize(
    "detector",
    [
        Detector.kepler(),
        Detector.k2_calibrated(shape=(5, 7)),
        Detector.tess(mission='a "name" of ä\n', well_depth=None, psf=None, sensitivity=None),
        Detector.k2(sensitivity=SensitivityPolynomial() + SensitivityPolynomial()),
        Detector.k2(
            shape=(2, 3),
            interpixel=[[1, 0.99, 1.01], [1, 1, 1]],
            sensitivity=SensitivityPolynomial() * SensitivityPolynomial((1, 0.01), (1,)),
            psf=MoffatPSF(flux=0.3, alpha=1.2, beta=3.0)
            + TabulatedPSF(np.exp(-np.hypot(*np.indices((21, 21)) - 10.0)), 4),
        ),
    ],
    ids=["Kepler", "K2", "custom", "sum", "models"],
)
def test_detector_to_a_file_and_back(detector, tmp_path):
    path = detector.write(tmp_path / "detector.fits.gz")
    assert Detector.read(path) == detector
    with pytest.raises(FileExistsError, match="overwrite"):
        detector.write(path)


def test_figure_of_a_scene():
    scene = make_scene()
    ax = scene.plot()
    ny, nx = scene.detector.shape
    assert (ax.get_xlim(), ax.get_ylim()) == ((-0.5, nx - 0.5), (-0.5, ny - 0.5))
    assert [text.xy for text in ax.texts] == [tuple(place) for place in scene.positions]
    plt.close("all")


def test_preset_in_toml(tmp_path):
    path = tmp_path / "detector.toml"
    path.write_text('preset = "kepler"\ncadence = "short"\nsensitivity = false\n', encoding="utf-8")
    assert repr(read_detector(path)) == repr(Detector.kepler(cadence="short", sensitivity=None))


@pytest.mark.parametrize(
    "text, message",
    [
        ("shape = [7", "detector.toml: "),
        (
            'preset = "plato"',
            "`preset` must be one of kepler, k2, k2_calibrated, tess, ground, got 'plato'",
        ),
        ('preset = "k2"\nreed_noise = 1', "`reed_noise` is not a field of a detector"),
        ('cadence = "long"', "`cadence` is not a field of a detector"),
        ("shape = [7, 7]", "missing .* 'zero_point'"),
        ('preset = "k2"\nread_noise = -1', "`read_noise` must not be negative, got -1"),
        ('preset = "k2"\npsf = 0.5', "`psf` must be a table with the name of its `model`"),
        ('preset = "k2"\n[psf]\nsigma_x = 0.5', "`psf` must be a table with the name"),
        ('preset = "k2"\n[psf]\nmodel = "NoPSF"', "'NoPSF' is not the name of a model"),
        ('preset = "k2"\n[psf]\nmodel = "unknown.PSF"', "'unknown.PSF' is not the name of a"),
        ('preset = "k2"\n[psf]\nmodel = "astropy.nothing.X"', "'astropy.nothing.X' is not the"),
        ("shape = " + "[" * 5000, "detector.toml: .*recursion"),
        ('preset = "k2"\n[psf]\nmodel = "BivariateGaussianPSF"\nsigma = 1', "sigma"),
        (
            'preset = "k2"\n[psf]\nmodel = "BivariateGaussianPSF"\nsigma_x = { value = 0.5 }',
            "a table must have `value` and `unit`, got value",
        ),
    ],
)
def test_wrong_detector_files(text, message, tmp_path):
    path = tmp_path / "detector.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=message):
        read_detector(path)
