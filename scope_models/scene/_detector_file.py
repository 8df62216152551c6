"""Detectors as TOML files."""

import json
import tomllib
from dataclasses import fields
from functools import reduce
from operator import add, mul
from pathlib import Path

import numpy as np
from astropy.modeling import CompoundModel

import scope_models.effects
import scope_models.models
from scope_models._checks import checked_choice
from scope_models.io._atomic import atomic_path
from scope_models.models._description import describe_model, make_model
from scope_models.scene.detector import Detector
from scope_models.scene.presets import PRESETS

__all__ = ["read_detector", "write_detector"]

# Fields that are models, and the operator of several.
_MODELS = {"psf": "+", "sensitivity": "*"}


def read_detector(path):
    r"""Read a detector from a TOML file.

    Each key is a field of `~scope_models.Detector`. Four are written in a way of their own:

    - ``preset``, a name for `Detector.preset <scope_models.Detector.preset>` as "k2", takes all
      fields that are not given from that preset, with the preset's ``cadence``;
    - ``psf`` is a table, or several (``[[psf]]``) whose models are added: ``model`` is the name
      of a PSF of `scope_models.models`, or the full name of another package's, as
      "photutils.psf.MoffatPSF"; the other keys are its parameters;
    - ``sensitivity`` is a table, or several that are multiplied, with the arguments of
      `~scope_models.SensitivityPolynomial`, or of another ``model``; ``false`` is none;
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


def write_detector(detector, path, overwrite=False):
    """Write a detector as the TOML file of `read_detector`; return its path."""
    lines, tables = [], []
    for item in fields(detector):
        value = getattr(detector, item.name)
        if value is None:  # TOML has no null: it is the default of all fields that may be None
            continue
        if item.name == "effects":
            tables += [text for effect in value for text in ("[[effects]]", *_effect(effect), "")]
        elif item.name in _MODELS:
            parts = _parts(value, item.name)
            tables += [text for part in parts for text in (f"[[{item.name}]]", *_table(part), "")]
        else:
            lines.append(f"{item.name} = {_toml(value)}")
    with atomic_path(path, overwrite=overwrite) as temporary:
        Path(temporary).write_text("\n".join([*lines, "", *tables]), encoding="utf-8", newline="\n")
    return Path(path)


def _parts(model, name):
    """Return the models of a sum or a product."""
    if not isinstance(model, CompoundModel):
        return [model]
    if model.op != _MODELS[name]:
        raise ValueError(f"`{name}` with the operator {model.op} cannot be written as TOML")
    return _parts(model.left, name) + _parts(model.right, name)


def _table(model):
    """Return the lines of a table."""
    described = describe_model(model)
    kind = described["class"]
    if getattr(scope_models.models, kind, None) is not type(model):
        kind = f"{described['module']}.{kind}"
    return _lines({"model": kind} | described["parameters"])


def _effect(effect):
    """Return the lines of an effect."""
    if type(effect).__module__.partition(".")[0] != "scope_models":
        raise ValueError(f"`effects` with {effect.name} cannot be written as TOML")
    values = {item.name: getattr(effect, item.name) for item in fields(effect)}
    return _lines({"effect": type(effect).__name__} | values)


def _lines(values):
    """Return the lines of a table; TOML has no null, the default of all that may be None."""
    return [f"{name} = {_toml(value)}" for name, value in values.items() if value is not None]


def _made_effect(table):
    """Return the effect of a table."""
    values = dict(table) if isinstance(table, dict) else {}
    name = values.pop("effect", None)
    if not isinstance(name, str) or name not in scope_models.effects.__all__:
        raise ValueError(f"`effects` must be tables with the name of an `effect`, got {name!r}")
    return getattr(scope_models.effects, name)(**values)


def _toml(value):
    """Return a value as TOML."""
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if isinstance(value, dict):
        return f"{{ {', '.join(f'{name} = {_toml(item)}' for name, item in value.items())} }}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_toml, value))}]"
    if isinstance(value, str | bool):
        return json.dumps(value, ensure_ascii=False)
    return repr(value)  # of a number, with inf and nan as TOML has them


def _detector_of_toml(values):
    """Return the detector of a parsed file."""
    preset = values.pop("preset", None)
    if preset is not None:
        checked_choice("preset", preset, PRESETS)
    known = {item.name for item in fields(Detector)} | ({"cadence"} if preset else set())
    for name in values:
        if name not in known:
            raise ValueError(f"`{name}` is not a field of a detector")
    if "effects" in values:
        given = values["effects"]
        given = given if isinstance(given, list) else [given]
        values["effects"] = [_made_effect(table) for table in given]
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
