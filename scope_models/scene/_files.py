"""Scenes, detectors and motions as FITS files of arrays and JSON; detectors as TOML by hand."""

import tomllib
from contextlib import contextmanager, suppress
from dataclasses import fields
from functools import reduce
from operator import add, mul
from pathlib import Path

import numpy as np
from astropy.modeling import Model
from astropy.table import QTable

from scope_models._arrays import plain_tree
from scope_models._checks import checked_choice
from scope_models._values import value_key
from scope_models.effects import Effect
from scope_models.io import read_truth
from scope_models.io._opening import making, open_fits
from scope_models.io._truth import maps_of, scene_blocks, scene_of, truth_blocks
from scope_models.io.tpf import write_hdulist
from scope_models.models._description import (
    class_named,
    describe_coord,
    describe_model,
    make_coord,
    make_model,
    packed,
    unpacked,
)
from scope_models.scene.common import CommonMotion
from scope_models.scene.detector import Detector
from scope_models.scene.motion import Motion
from scope_models.scene.presets import PRESETS
from scope_models.scene.scene import Scene, Star

__all__ = [
    "describe_detector", "describe_scene", "make_detector", "read_detector", "read_object",
    "read_scene", "scene_columns", "write_object",
]  # fmt: skip

_VERSION = 3
# Fields that files of version 2 lack, and whose effect was another then.
_OLD_FIELDS = {"Undershoot": {"residual": 1.0}}


def read_scene(path):
    """Read a scene from a file of `Scene.write` or of `~scope_models.Observation.write`.

    Parameters
    ----------
    path : str or path-like
        The file.

    Returns
    -------
    Scene
        The scene, equal to the written one. Signals that were functions are arrays.

    Raises
    ------
    ValueError
        If the file holds no scene, or one whose models cannot be made here.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, read_scene, simulate
    >>> observation = simulate(Star(12.0), Detector.k2(), Motion.still(10), seed=1)
    >>> read_scene(observation.write("star.fits")) == observation.scene
    True
    """
    truth = read_truth(path)
    described = truth.scene
    with _making(path, described, "scene"):
        detector = make_detector(described["detector"], truth.maps)
        stars = [_star(star, i, truth.columns) for i, star in enumerate(described["stars"], 1)]
        effects = [_make_effect(effect) for effect in described["effects"]]
        return Scene(stars, detector, _motion(truth), effects=effects, **described["options"])


def read_detector(path):
    r"""Read a detector from a FITS file of `Detector.write <scope_models.Detector.write>` or TOML.

    In TOML, each key is a field of `~scope_models.Detector`, but:

    - ``preset`` and ``cadence`` are arguments of `Detector.preset <scope_models.Detector.preset>`,
      which gives all other fields;
    - ``psf`` is a table, or several (``[[psf]]``) that are added: ``model`` is the name of a PSF of
      `scope_models.models`, photutils or `astropy.modeling.models`; other keys are its parameters;
    - ``sensitivity`` is alike, but multiplied; without ``model`` it is a
      `~scope_models.SensitivityPolynomial`, and ``false`` is none;
    - ``effects`` are tables (``[[effects]]``) with the name of an ``effect`` of
      `scope_models.effects` and its fields.

    Parameters
    ----------
    path : str or path-like
        The file.

    Returns
    -------
    Detector
        The detector.

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If it is neither, or a field is unknown, is missing or outside its domain.

    Examples
    --------
    >>> from pathlib import Path
    >>> from scope_models import read_detector
    >>> text = 'preset = "k2"\n[psf]\nmodel = "BivariateGaussianPSF"\nsigma_x = 0.6\n'
    >>> _ = Path("detector.toml").write_text(text, encoding="utf-8")
    >>> float(read_detector("detector.toml").psf.sigma_x.value)
    0.6
    """
    if _is_fits(path):
        with open_fits(path) as hdus:
            described, maps = scene_of(hdus), maps_of(hdus)
        with _making(path, described, "detector"):
            return make_detector(described["detector"], maps)
    try:
        return _detector_of_toml(tomllib.loads(Path(path).read_text(encoding="utf-8-sig")))
    except (TypeError, ValueError, RecursionError) as error:
        raise ValueError(f"{path}: {error}") from error


def _read_motion(path):
    if _is_fits(path):
        truth = read_truth(path)
        with _making(path, truth.scene, "motion"):
            return _motion(truth)
    try:
        text = Path(path).read_text(encoding="utf-8")
        table = QTable.read(text.splitlines(), format="ascii.ecsv")
        columns = [table[name] for name in ("time", "x", "y")]
        flags = [np.asarray(table[name]) for name in ("quality", "cadenceno")]
        return Motion(*columns, *flags, table.meta["time_format"], table.meta.get("motion") or {})
    except (LookupError, TypeError, ValueError) as error:
        raise ValueError(f"{path} is not a table of a motion: {error}") from error


def _is_fits(path):
    with Path(path).open("rb") as stream:
        return stream.read(6).startswith((b"SIMPLE", b"\x1f\x8b"))


def read_object(kind, path):
    """Return the scene, the detector or the motion, a class, of a file."""
    if issubclass(kind, Scene):
        return read_scene(path)
    return read_detector(path) if issubclass(kind, Detector) else _read_motion(path)


def write_object(value, path, *, overwrite):
    """Write a scene, a detector or a motion; return the path."""
    from astropy.io import fits

    if isinstance(value, Detector):
        described = {"version": _VERSION, "detector": describe_detector(value)}
        blocks = scene_blocks(_maps(value), described)
    elif isinstance(value, Motion):
        described = {"version": _VERSION, "motion": _describe_motion(value)}
        blocks = truth_blocks(value.cadenceno, _motion_columns(value), {}, described, None)
    else:
        motion, maps = value.motion, _maps(value.detector)
        columns = scene_columns(value, [star.relative_flux(motion.time) for star in value.stars])
        blocks = truth_blocks(motion.cadenceno, columns, maps, describe_scene(value), None)
    hdus = [fits.PrimaryHDU(), *(block.hdu() for block in blocks)]
    return write_hdulist(fits.HDUList(hdus), path, overwrite=overwrite)


def _maps(detector):
    return {} if detector.interpixel is None else {"INTERPIXEL": detector.interpixel}


@contextmanager
def _making(path, described, what):
    """Raise errors of the object that a file describes as ValueErrors that name the file."""
    if not described:
        raise ValueError(f"{path} holds no {what}")
    version = described.get("version")
    if not isinstance(version, int):
        raise ValueError(f"{path} holds a {what} without a version")  # noqa: TRY004
    if version > _VERSION:
        raise ValueError(f"{path} holds a {what} of a later version of this package")
    with making(path, what):
        yield


def _motion(truth):
    table, described = truth.columns, truth.scene["motion"]
    kind = CommonMotion if "place" in described else Motion
    further = {n: table[n.upper()] for n in (*kind.offsets_of[2:], *kind.errors_of)}
    return kind(
        table["TIME"], table["MOTION_X"], table["MOTION_Y"], table["QUALITY"].astype(np.int32),
        table["CADENCENO"], **described, **further,
    )  # fmt: skip


def describe_scene(scene):
    """Return a scene without its arrays as values that JSON can hold."""
    options = {name: value for name, value in scene.options.items() if name != "effects"}
    return {
        "version": _VERSION,
        "stars": [_describe_star(star) for star in scene.stars],
        "detector": describe_detector(scene.detector),
        "motion": _describe_motion(scene.motion),
        "options": plain_tree(options, str),
        "effects": [_describe_effect(effect) for effect in scene.effects],
    }


def _describe_star(star):
    """Return the fields of a star; the signal is a model, or whether there is one: an array."""
    described = {name: getattr(star, name) for name in ("mag", "x_0", "y_0")}
    described |= {"psf": describe_model(star.psf), "signal": star.signal is not None}
    if isinstance(star.signal, Model):
        signal = describe_model(star.signal)
        # unless it is of a kind that files cannot hold
        with suppress(KeyError, TypeError, ValueError):
            if value_key(make_model(signal)) == value_key(star.signal):
                described["signal"] = signal
    return described | ({} if star.coord is None else {"coord": describe_coord(star.coord)})


def scene_columns(scene, relative_flux):
    """Return the arrays of a scene, cadence by cadence, as columns of a table."""
    signals = {f"SIGNAL{i}": signal for i, signal in enumerate(relative_flux, start=1)}
    return _motion_columns(scene.motion) | signals


def _motion_columns(motion):
    columns = {"TIME": motion.time, "QUALITY": motion.quality}
    columns |= {"MOTION_X": motion.x, "MOTION_Y": motion.y}
    names = (*motion.offsets_of[2:], *motion.errors_of)
    return columns | {name.upper(): getattr(motion, name) for name in names}


def _describe_motion(motion):
    place = {"place": motion.place} if isinstance(motion, CommonMotion) else {}
    return {"time_format": motion.time_format, "meta": plain_tree(motion.meta, str)} | place


def _describe_effect(effect):
    values = {item.name: packed(getattr(effect, item.name)) for item in fields(effect)}
    return {"class": type(effect).__name__, "parameters": plain_tree(values, str)}


def _make_effect(described):
    values = {name: unpacked(value) for name, value in described["parameters"].items()}
    kind = _named_effect(described["class"])
    return kind(**(_OLD_FIELDS.get(kind.__name__, {}) | values))


def _named_effect(name):
    return class_named(name, Effect, ("scope_models.effects",), "an effect")


def describe_detector(detector):
    """Return the fields of a detector; the interpixel map is stored elsewhere."""
    described = {item.name: getattr(detector, item.name) for item in fields(detector)}
    described |= {name: describe_model(described[name]) for name in ("sensitivity", "psf")}
    described |= {"shape": list(detector.shape), "interpixel": detector.interpixel is not None}
    return described | {"effects": [_describe_effect(effect) for effect in detector.effects]}


def make_detector(described, maps):
    models = {name: make_model(described[name]) for name in ("sensitivity", "psf")}
    effects = [_make_effect(effect) for effect in described["effects"]]
    interpixel = maps["INTERPIXEL"] if described["interpixel"] else None
    return Detector(**(described | models | {"interpixel": interpixel, "effects": effects}))


def _star(described, number, table):
    is_array = described["signal"] is True
    signal = table[f"SIGNAL{number}"] if is_array else make_model(described["signal"] or None)
    psf, coord = make_model(described["psf"]), make_coord(described.get("coord"))
    return Star(described["mag"], described["x_0"], described["y_0"], psf, signal, coord)


def _detector_of_toml(values):
    preset = values.pop("preset", None)
    if preset is not None:
        checked_choice("preset", preset, PRESETS)
    known = {item.name for item in fields(Detector)} | ({"cadence"} if preset else set())
    for name in values:
        if name not in known:
            raise ValueError(f"`{name}` is not a field of a detector")
    if "effects" in values:
        given = _named(values["effects"], "effects", "effect")
        values["effects"] = [_named_effect(name)(**parameters) for name, parameters in given]
    if "psf" in values:
        values["psf"] = _combined(values, "psf", add)
    if values.get("sensitivity") is False:
        values["sensitivity"] = None
    elif "sensitivity" in values:
        values["sensitivity"] = _combined(values, "sensitivity", mul, "SensitivityPolynomial")
    return Detector.preset(preset, **values) if preset else Detector(**values)


def _combined(values, name, combine, default=None):
    """Return the sum or the product of the models that tables describe."""
    given = _named(values[name], name, "model", default)
    return reduce(combine, (make_model({"class": k, "parameters": p}) for k, p in given))


def _named(tables, name, key, default=None):
    """Yield the name under a key, and the other values, of one table or several."""
    for table in tables if isinstance(tables, list) else [tables]:
        if not isinstance(table, dict) or not isinstance(table.get(key, default), str):
            wanted = f"a table with the name of its `{key}`"
            raise ValueError(f"`{name}` must be {wanted}, got {table!r}")  # noqa: TRY004
        yield table.get(key, default), {k: v for k, v in table.items() if k != key}
