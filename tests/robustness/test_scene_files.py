"""Files of scenes: many stars, and names and values that somebody put there."""

import base64
import json
import zlib

import numpy as np
import pytest
from astropy.io import fits

from scope_models import Detector, Motion, Scene, Star, read_scene, read_truth
from scope_models.io.tpf import make_tpf_hdulist
from scope_models.models._description import make_model


def make_scene(n_stars=1, **changes):
    stars = [Star(15.0 + 0.001 * i, 2 + i % 7, 3 + i % 5) for i in range(n_stars)]
    motion = Motion.still(4)
    return Scene(stars, Detector.k2(shape=(11, 11)), motion, seed=1, **changes)


@pytest.mark.parametrize("n_stars", [1, 400, 1100])
def test_many_stars(n_stars, tmp_path):
    scene = make_scene(n_stars)
    path = scene.write(tmp_path / "field.fits")
    assert read_scene(path) == scene
    with fits.open(path) as hdus:
        assert len(hdus["TRUTH"].columns) <= 999
        # CFITSIO refuses texts of more than 2879 characters.
        assert int(hdus["SCENE"].columns["VALUE"].format.rstrip("A")) <= 2879


def test_vectors_give_the_columns_back(tmp_path):
    rng = np.random.default_rng(1)
    columns = {f"X{i}": rng.normal(size=5) for i in range(1, 1201)} | {"X_Y": rng.normal(size=5)}
    hdus = make_hdus(columns)
    hdus.writeto(tmp_path / "star.fits")
    with fits.open(tmp_path / "star.fits") as opened:
        assert opened["TRUTH"].columns.names == ["CADENCENO", "X_Y", "X"]
    table = read_truth(tmp_path / "star.fits").table
    assert set(table.colnames) == {"CADENCENO", *columns}
    for name, values in columns.items():
        assert np.array_equal(table[name], values)


def make_hdus(truth_columns, scene=None):
    from scope_models.io import TPFMetadata

    metadata = TPFMetadata(
        mission="K2", target_id=7, pixel_scale=3.98, int_time=6.02, read_time=0.52, n_frames=270
    )
    n = len(next(iter(truth_columns.values())))
    return make_tpf_hdulist(
        metadata=metadata,
        time=np.arange(n) * 0.02 + 2000.0,
        cadenceno=np.arange(1, n + 1),
        raw_cnts=None,
        flux=np.ones((n, 3, 3)),
        flux_err=0.1,
        flux_bkg=0.0,
        flux_bkg_err=0.0,
        quality=np.zeros(n, dtype=int),
        pos_corr1=np.zeros(n),
        pos_corr2=np.zeros(n),
        truth_columns=truth_columns,
        scene=scene,
    )


def test_long_texts_of_a_scene(tmp_path):
    scene = {"text": " a  b ü" * 2000, "blanks": " " * 5000, "list": list(range(3000))}
    make_hdus({"X": np.zeros(3)}, scene).writeto(tmp_path / "star.fits")
    assert read_truth(tmp_path / "star.fits").scene == scene


def rewritten(path, change):
    """Change the texts of the SCENE table."""
    with fits.open(path) as hdus:
        rows = hdus["SCENE"].data
        scene = {}
        for row in rows:
            scene[row["KEY"]] = scene.get(row["KEY"], "") + row["VALUE"]
        scene = {key: json.loads(text) for key, text in scene.items()}
        change(scene)
        texts = [text if isinstance(text, str) else json.dumps(text) for text in scene.values()]
        hdus["SCENE"] = fits.BinTableHDU.from_columns(
            [
                fits.Column("KEY", "40A", array=list(scene)),
                fits.Column("VALUE", "2800A", array=texts),
            ],
            name="SCENE",
        )
        hdus.writeto(path, overwrite=True)
    return path


def psf_of(**described):
    return lambda scene: scene["detector"].update(psf=described)


@pytest.mark.parametrize(
    "change",
    [
        lambda scene: scene.pop("version"),
        lambda scene: scene.pop("detector"),
        lambda scene: scene.pop("stars"),
        lambda scene: scene.update(stars=5),
        lambda scene: scene.update(stars=[]),
        lambda scene: scene.update(stars=[None]),
        lambda scene: scene.update(stars="[" * 2500),
        lambda scene: scene.update(stars="{"),
        lambda scene: scene.update(motion=None),
        lambda scene: scene.update(options={"seeds": 5}),
        lambda scene: scene["detector"].update(shape=[0, 5]),
        lambda scene: scene["detector"].update(gain="much"),
        lambda scene: scene["detector"].update(unknown=1),
        psf_of(module="os", **{"class": "system"}, parameters={"command": "touch here"}),
        psf_of(module="absent_module", **{"class": "PSF"}, parameters={}),
        psf_of(module="scope_models.absent", **{"class": "PSF"}, parameters={}),
        psf_of(module="astropy.modeling.models", **{"class": "Absent"}, parameters={}),
        psf_of(module="subprocess", **{"class": "Popen"}, parameters={"args": ["touch", "here"]}),
        psf_of(operator="/", left=None, right=None),
        psf_of(module=5, **{"class": "PSF"}, parameters={}),
    ],
)
def test_a_scene_that_cannot_be_made(tmp_path, monkeypatch, change):
    monkeypatch.chdir(tmp_path)
    path = rewritten(make_scene().write(tmp_path / "scene.fits"), change)
    with pytest.raises(ValueError, match=r"scene\.fits"):
        read_scene(path)
    assert [file.name for file in tmp_path.iterdir()] == ["scene.fits"]


def test_later_version(tmp_path):
    path = rewritten(
        make_scene().write(tmp_path / "scene.fits"), lambda scene: scene.update(version=99)
    )
    with pytest.raises(ValueError, match=r"scene\.fits holds a scene of a later version"):
        read_scene(path)


def test_packed_array_larger_than_its_shape():
    bomb = base64.b64encode(zlib.compress(bytes(10**7))).decode()
    for shape, match in (
        ([2, 2], "does not have the 32 bytes"),
        ([10**6, 10**6], "up to 67,108,864 bytes"),
    ):
        described = {
            "module": "scope_models.models",
            "class": "BivariateGaussianPSF",
            "parameters": {"sigma_x": {"array": bomb, "shape": shape}},
        }
        with pytest.raises(ValueError, match=match):
            make_model(described)
