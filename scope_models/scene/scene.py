"""Scenes: all that a simulation starts from, as Python objects and as what a file holds."""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import reduce
from operator import add, mul
from pathlib import Path

import numpy as np

from scope_models.io import read_truth
from scope_models.models._description import describe_model, make_model
from scope_models.scene.detector import Detector
from scope_models.scene.motion import Motion
from scope_models.scene.presets import PRESETS
from scope_models.scene.star import Star

__all__ = ["Scene", "read_detector", "read_scene"]

_VERSION = 1


@dataclass(frozen=True, eq=False)
class Scene:
    """The arguments of a simulation.

    Iterating gives the stars, the detector and the motion, so that
    ``simulate(*scene, **scene.options)`` gives the same pixels again.

    Parameters
    ----------
    stars : tuple of Star
        The stars; the first is the target.
    detector : Detector
        The detector.
    motion : Motion
        The motion that the stars share.
    options : mapping, optional
        Keyword arguments of `simulate`: seed, noise and n_sub.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star
    >>> from scope_models.scene import Scene
    >>> scene = Scene((Star(12.0),), Detector.k2(), Motion.still(10), {"seed": 1})
    >>> stars, detector, motion = scene
    >>> len(motion)
    10
    """

    stars: tuple[Star, ...]
    detector: Detector
    motion: Motion
    options: Mapping = None

    def __iter__(self):
        return iter((self.stars, self.detector, self.motion))


def read_scene(path):
    """Read the scene from a target pixel file that this package wrote.

    Parameters
    ----------
    path : str or path-like
        The file.

    Returns
    -------
    Scene
        The stars, detector, motion and options. Signals are given as arrays, cadence by cadence.

    Raises
    ------
    ValueError
        If the file holds no scene, or one whose models cannot be made here.

    Examples
    --------
    >>> import numpy as np
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> from scope_models.scene import read_scene
    >>> observation = simulate(Star(12.0), Detector.k2(), Motion.still(10), seed=1)
    >>> path = observation.write("star.fits")
    >>> scene = read_scene(path)
    >>> again = simulate(*scene, **scene.options)
    >>> np.array_equal(again.flux, observation.flux)
    True
    """
    truth = read_truth(path)
    if not truth.scene:
        raise ValueError(f"{path} holds no scene to simulate again")
    if truth.scene["version"] > _VERSION:
        raise ValueError(f"{path} holds a scene of a later version of this package")
    detector = _detector(truth.scene["detector"], truth.maps["INTERPIXEL"])
    stars = [_star(star, i, truth.table) for i, star in enumerate(truth.scene["stars"], start=1)]
    table, described = truth.table, truth.scene["motion"]
    motion = Motion(
        time=table["TIME"],
        x=table["MOTION_X"],
        y=table["MOTION_Y"],
        quality=np.asarray(table["QUALITY"], dtype=np.int32),
        cadenceno=table["CADENCENO"],
        time_format=described["time_format"],
        meta=described["meta"],
    )
    return Scene(tuple(stars), detector, motion, truth.scene["options"])


def read_detector(path):
    r"""Read a detector from a TOML file.

    Each key is a field of `~scope_models.Detector`. Three are written in a way of their own:

    - ``preset``, a name for `Detector.preset <scope_models.Detector.preset>` as "k2", takes all
      fields that are not given from that preset, with the preset's ``cadence``;
    - ``psf`` is a table, or several (``[[psf]]``) whose models are added: ``model`` is the name
      of a PSF of `scope_models.models`, or the full name of another package's, as
      "photutils.psf.MoffatPSF"; the other keys are its parameters;
    - ``sensitivity`` is a table, or several that are multiplied, with the arguments of
      `~scope_models.SensitivityPolynomial`, or of another ``model``; ``false`` is none.

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
        If it is not TOML, or a field is unknown, is missing or outside its domain. The message
        begins with the name of the file.

    Examples
    --------
    >>> from pathlib import Path
    >>> from scope_models import read_detector
    >>> text = 'preset = "k2"\nshape = [9, 9]\n'
    >>> psf = '[psf]\nmodel = "BivariateGaussianPSF"\nsigma_x = 0.6\n'
    >>> _ = Path("detector.toml").write_text(text + psf, encoding="utf-8")
    >>> detector = read_detector("detector.toml")
    >>> detector.shape, float(detector.psf.sigma_x.value)
    ((9, 9), 0.6)
    """
    try:
        return _detector_of_toml(tomllib.loads(Path(path).read_text(encoding="utf-8")))
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path}: {error}") from error


def describe_scene(scene):
    """Return a scene without its arrays as values that JSON can hold."""
    return {
        "version": _VERSION,
        "stars": [
            {
                "mag": star.mag,
                "x_0": star.x_0,
                "y_0": star.y_0,
                "psf": describe_model(star.psf),
                "signal": star.signal is not None,
            }
            for star in scene.stars
        ],
        "detector": _describe_detector(scene.detector),
        "motion": {
            "time_format": scene.motion.time_format,
            "meta": {key: _plain(value) for key, value in scene.motion.meta.items()},
        },
        "options": dict(scene.options or {}),
    }


def scene_columns(scene, relative_flux):
    """Return the arrays of a scene, cadence by cadence, as columns of a table."""
    columns = {
        "TIME": scene.motion.time,
        "QUALITY": scene.motion.quality,
        "MOTION_X": scene.motion.x,
        "MOTION_Y": scene.motion.y,
    }
    for i, signal in enumerate(relative_flux, start=1):
        columns[f"SIGNAL{i}"] = signal
    return columns


def _describe_detector(detector):
    """Return the fields of a detector; the interpixel map is stored elsewhere."""
    described = {item.name: getattr(detector, item.name) for item in fields(detector)}
    for name in ("sensitivity", "psf"):
        described[name] = describe_model(described[name])
    described["shape"] = list(detector.shape)
    described["interpixel"] = detector.interpixel is not None
    return described


def _detector(described, interpixel):
    """Return the detector of a description."""
    values = dict(described)
    for name in ("sensitivity", "psf"):
        values[name] = make_model(values[name])
    values["shape"] = tuple(values["shape"])
    values["interpixel"] = interpixel if values["interpixel"] else None
    return Detector(**values)


def _detector_of_toml(values):
    """Return the detector of a parsed file."""
    preset = values.pop("preset", None)
    if preset is not None and preset not in PRESETS:
        raise ValueError(f"`preset` must be one of {', '.join(PRESETS)}, got {preset!r}")
    known = {item.name for item in fields(Detector)} | ({"cadence"} if preset else set())
    for name in values:
        if name not in known:
            raise ValueError(f"`{name}` is not a field of a detector")
    if "psf" in values:
        values["psf"] = _combined(values["psf"], "psf", None, add)
    given = values.get("sensitivity")
    if given is False:
        values["sensitivity"] = None
    elif given is not None:
        values["sensitivity"] = _combined(given, "sensitivity", "SensitivityPolynomial", mul)
    return Detector.preset(preset, **values) if preset else Detector(**values)


def _combined(tables, name, default, combine):
    """Return the sum or the product of the models that tables describe."""
    models = []
    for table in tables if isinstance(tables, list) else [tables]:
        if not isinstance(table, dict) or not isinstance(table.get("model", default), str):
            raise ValueError(f"`{name}` must be a table with the name of its `model`")  # noqa: TRY004
        module, _, kind = table.get("model", default).rpartition(".")
        parameters = {key: value for key, value in table.items() if key != "model"}
        described = {"module": module or "scope_models.models", "class": kind}
        models.append(make_model({**described, "parameters": parameters}))
    return reduce(combine, models)


def _star(described, number, table):
    """Return the star of a description."""
    signal = np.asarray(table[f"SIGNAL{number}"]) if described["signal"] else None
    psf = make_model(described["psf"])
    return Star(described["mag"], described["x_0"], described["y_0"], psf, signal)


def _plain(value):
    """Return a value that JSON can hold."""
    if isinstance(value, np.generic):
        return value.item()
    return value if isinstance(value, (str, int, float, bool, type(None))) else str(value)
