"""Studies made of names and values, as a TOML file or a command line gives them."""

import dataclasses
import tomllib
from pathlib import Path

from scope_models.experiments import STUDIES

__all__ = ["make_study", "read_config"]


def make_study(name, fields=None):
    """Return a study with some of its fields changed.

    Parameters
    ----------
    name : str
        One of `STUDIES`.
    fields : mapping, optional
        Values by the name of the field; all others keep their defaults.

    Returns
    -------
    Study
        The study.

    Raises
    ------
    ValueError
        If the study or a field is unknown, or a value is outside its domain.
    TypeError
        If a value is of another type than the field.

    Examples
    --------
    >>> from scope_models.experiments import make_study
    >>> make_study("table1", {"scales": [1, 10]}).scales
    (1.0, 10.0)
    >>> make_study("table1", {"scale": 1})
    Traceback (most recent call last):
    ...
    ValueError: the study `table1` has no field `scale`; its fields are ...
    """
    if name not in STUDIES:
        raise ValueError(f"there is no study {name!r}; the studies are {', '.join(STUDIES)}")
    study = STUDIES[name]
    fields = dict(fields or {})
    known = [item.name for item in dataclasses.fields(study)]
    for field in fields:
        if field not in known:
            raise ValueError(
                f"the study `{name}` has no field `{field}`; its fields are {', '.join(known)}"
            )
    return study(**fields)


def read_config(path, name=None, fields=None):
    r"""Read a study from a TOML file.

    Parameters
    ----------
    path : str or path-like
        The file: ``study = "NAME"``, and a line for every field that differs from its default.
    name : str, optional
        The study, which the file then need not name.
    fields : mapping, optional
        Values that go before those of the file.

    Returns
    -------
    Study
        The study.

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If it is not valid TOML, names no study or another one than ``name``, or if the study or
        a field is unknown, or a value is outside its domain.
    TypeError
        If a value is of another type than the field.

    Examples
    --------
    >>> from pathlib import Path
    >>> from scope_models.experiments import read_config
    >>> _ = Path("table1.toml").write_text('study = "table1"\ncadences = 500\n')
    >>> read_config("table1.toml").cadences
    500
    """
    try:
        values = tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path} is not valid TOML: {error}") from error
    stated = values.pop("study", name)
    if stated is None:
        raise ValueError(f'{path} must name a study: study = "NAME"')
    if name is not None and stated != name:
        raise ValueError(f"{path} is a configuration of the study {stated!r}, not {name!r}")
    try:
        return make_study(stated, values | dict(fields or {}))
    except (TypeError, ValueError) as error:
        raise type(error)(f"{path}: {error}") from error
