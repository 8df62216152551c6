"""A study: a grid of stars, the measurement of each, and their summary."""

import dataclasses
import hashlib
import inspect
import itertools
import re
import string
import textwrap
import types
import typing
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from scope_models._arrays import plain_tree
from scope_models._checks import checked_integer, checked_number

__all__ = ["Study", "parameter"]

# Between the sections of a docstring.
_SECTION = re.compile(r"\n\n(?=\w[^\n]*\n---)")
_RAISES = """Raises
------
TypeError, ValueError
    If a field is of the wrong type or outside its domain."""


def parameter(default, text, *, least=None, positive=None, different="", among=()):
    """Return a field of a study with its meaning and its domain.

    The docstring of the study lists these fields, and its constructor checks them.

    Parameters
    ----------
    default : int, float, str, bool, tuple or None
        The default.
    text : str
        The meaning, in a sentence.
    least : int, optional
        Smallest value of an integer, or of each in a list.
    positive : bool, optional
        Whether a number, or each in a list, must be positive (true), or at least 0 (false).
    different : {"", "numbers", "values"}, optional
        What a list holds that must not be empty, nor have one of them twice.
    among : iterable of str, optional
        The texts that are allowed.

    Returns
    -------
    dataclasses.Field
        The field.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> from scope_models.experiments.study import Study, parameter
    >>> @dataclass(frozen=True, kw_only=True)
    ... class Grid(Study):
    ...     '''A grid of stars.'''
    ...     stars: int = parameter(5, "Stars per magnitude.", least=1)
    >>> "Stars per magnitude." in Grid.__doc__
    True
    """
    domain = {"least": least, "positive": positive, "different": different, "among": tuple(among)}
    return dataclasses.field(default=default, metadata={"text": text, "domain": domain})


@dataclass(frozen=True, kw_only=True)
class Study(ABC):
    """Base of all studies. A study is its own configuration.

    A subclass is a frozen dataclass whose fields are the configuration: numbers, strings, true or
    false, and tuples of these, each with a default, so that a TOML file can fill them. It defines
    the stars (`grid` and `key`, or `tasks`), what is measured of one star (`observation` and
    `measure`, or `run_star` if it has no pixels), a summary (`summarize`) and a figure (`draw`).

    Parameters
    ----------
    seed : int, optional
        Seed of all random numbers of the study.

    Attributes
    ----------
    name : str
        The name of the study on the command line and in files.
    units : mapping of str to str
        Units of columns of the results; columns that are not named have none.
    grid : mapping of str to str
        The field that has the values of each column of the tasks, from the outermost loop to the
        innermost; an integer field stands for as many numbers from 0.
    key : str
        The key of a star, a format string of the columns, in the order of the table.

    Raises
    ------
    TypeError
        If a field is of another type than its annotation.
    ValueError
        If a field is outside its domain.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> from typing import ClassVar
    >>> from scope_models.experiments.study import Study, parameter
    >>> @dataclass(frozen=True, kw_only=True)
    ... class Squares(Study):
    ...     name: ClassVar[str] = "squares"
    ...     grid: ClassVar[dict] = {"index": "stars"}
    ...     key: ClassVar[str] = "star{index}"
    ...     stars: int = parameter(3, "Number of stars.", least=1)
    ...     def run_star(self, task):
    ...         return {"square": task["index"] ** 2}
    ...     def summarize(self, table):
    ...         return table[:0]
    ...     def draw(self, table, summary):
    ...         raise NotImplementedError
    >>> study = Squares(stars=2)
    >>> study.config()
    {'study': 'squares', 'seed': 1, 'stars': 2}
    >>> study.tasks()
    [{'key': 'star0', 'index': 0}, {'key': 'star1', 'index': 1}]
    >>> [study.run_star(task) for task in study.tasks()]
    [{'square': 0}, {'square': 1}]
    """

    name: ClassVar[str] = ""
    units: ClassVar[Mapping] = types.MappingProxyType({})
    grid: ClassVar[Mapping] = types.MappingProxyType({})
    key: ClassVar[str] = ""

    seed: int = parameter(1, "Seed of all random numbers.", least=0)

    def __init_subclass__(cls, **kwargs):
        super().__init_subclass__(**kwargs)
        own = {key: item for key, item in vars(cls).items() if isinstance(item, dataclasses.Field)}
        if own and cls.__doc__ and "Parameters\n" not in cls.__doc__:
            summary, *rest = _SECTION.split(inspect.cleandoc(cls.__doc__))
            fields = {item.name: item for item in dataclasses.fields(cls)} | own
            cls.__doc__ = "\n\n".join([summary, _described(cls, fields), _RAISES, *rest]) + "\n"

    def __post_init__(self):
        """Check type and domain of every field."""
        hints = typing.get_type_hints(type(self))
        items = dataclasses.fields(self)
        for item in items:
            value = _checked_value(item.name, getattr(self, item.name), hints[item.name])
            object.__setattr__(self, item.name, value)
        for item in items:
            if item.metadata:
                _check_domain(item.name, getattr(self, item.name), **item.metadata["domain"])

    def tasks(self):
        """Return the stars: by default one for each cell of `grid`.

        Returns
        -------
        list of dict
            One small dictionary of numbers and strings per star. "key" is a unique name out of
            letters, digits and ``._+=-``.
        """
        if not self.grid:
            raise NotImplementedError(f"the study `{self.name}` has neither a grid nor tasks")
        values = [getattr(self, name) for name in self.grid.values()]
        values = [range(value) if isinstance(value, int) else value for value in values]
        columns = [name for _, name, *_ in string.Formatter().parse(self.key) if name]
        cells = (dict(zip(self.grid, cell, strict=True)) for cell in itertools.product(*values))
        return [
            {"key": self.key.format(**cell)} | {name: cell[name] for name in columns}
            for cell in cells
        ]

    def observation(self, task):
        """Return the pixels of a star, which can then be written as target pixel files.

        Parameters
        ----------
        task : dict
            One of `tasks`.

        Returns
        -------
        Observation
            The observation.
        """
        raise NotImplementedError(f"the study `{self.name}` has no pixels")

    def measure(self, task, observation):
        """Return what is measured of a star with pixels.

        Parameters
        ----------
        task : dict
            One of `tasks`.
        observation : Observation
            Its pixels.

        Returns
        -------
        dict
            As `run_star`.
        """
        raise NotImplementedError(f"the study `{self.name}` measures no pixels")

    def run_star(self, task):
        """Return what is measured of one star: by default `measure` of its `observation`.

        The result depends on the configuration and the task alone: random numbers come from
        `star_seed`.

        Parameters
        ----------
        task : dict
            One of `tasks`.

        Returns
        -------
        dict
            Numbers, strings, and true or false, by the name of their column.
        """
        return self.measure(task, self.observation(task))

    @abstractmethod
    def summarize(self, table):
        """Return a summary of the results beside the reference.

        Parameters
        ----------
        table : astropy.table.Table
            The results: one row per star that did not fail.

        Returns
        -------
        astropy.table.Table
            The summary.
        """

    @abstractmethod
    def draw(self, table, summary):
        """Draw the results.

        Parameters
        ----------
        table : astropy.table.Table
            The results.
        summary : astropy.table.Table
            The summary of them.

        Returns
        -------
        matplotlib.figure.Figure or None
            The figure; None if there is nothing to draw.
        """

    def input_files(self):
        """Return the files that the results depend on.

        Returns
        -------
        list of str
            Paths: by default all strings of the configuration that are those of files, but for
            fields with a list of allowed texts. A results directory that was begun with other
            contents of them is refused.
        """
        values = [
            getattr(self, item.name)
            for item in dataclasses.fields(self)
            if not item.metadata.get("domain", {}).get("among")
        ]
        listed = (value if isinstance(value, tuple) else (value,) for value in values)
        texts = dict.fromkeys(text for values in listed for text in values)
        return [text for text in texts if isinstance(text, str) and text and Path(text).is_file()]

    def has_output(self, task):
        """Return whether the files that `run_star` writes are there; by default it writes none.

        Parameters
        ----------
        task : dict
            One of `tasks`.

        Returns
        -------
        bool
            Whether nothing is to be computed again for the sake of files.
        """
        return True

    def config(self):
        """Return the configuration as values that TOML and JSON can hold.

        Returns
        -------
        dict
            The name of the study and all fields.
        """
        values = {item.name: getattr(self, item.name) for item in dataclasses.fields(self)}
        return {"study": self.name, **plain_tree(values)}

    def star_seed(self, key, purpose=""):
        """Return the seed of a star, which depends on its key and the study's seed only.

        Parameters
        ----------
        key : str
            The star's key.
        purpose : str, optional
            Another purpose gives another, independent seed.

        Returns
        -------
        int
            A seed below 2**53, so that JSON and FITS cards hold it exactly.
        """
        text = f"{self.seed}\n{key}\n{purpose}"
        return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8]) >> 11

    def star_rng(self, key, purpose="star"):
        """Return a random generator for what is drawn of a star.

        Parameters
        ----------
        key : str
            The star's key.
        purpose : str, optional
            Another purpose gives another, independent generator.

        Returns
        -------
        numpy.random.Generator
            The generator, at the beginning of its stream.
        """
        return np.random.default_rng(self.star_seed(key, purpose))


def _described(cls, fields):
    """Return the section of a docstring that lists fields with their types and meanings."""
    hints = typing.get_type_hints(cls)
    lines = ["Parameters", "----------"]
    for name, item in fields.items():
        if not item.metadata:
            continue
        kind = getattr(hints[name], "__name__", str(hints[name]))
        if typing.get_origin(hints[name]) is tuple:
            kind = f"tuple of {typing.get_args(hints[name])[0].__name__}"
        elif item.metadata["domain"]["among"]:
            kind = f"{{{', '.join(map(repr, item.metadata['domain']['among']))}}}".replace("'", '"')
        lines.append(f"{name} : {kind}, optional")
        lines.append(textwrap.indent(textwrap.fill(item.metadata["text"], 92), "    "))
    return "\n".join(lines)


def _check_domain(name, value, *, least, positive, different, among):
    """Raise an error if the value of a field is outside its domain, see `parameter`."""
    many = isinstance(value, tuple)
    if different and (not value or len(set(value)) < len(value)):
        raise ValueError(f"`{name}` must be one or more different {different}, got {value}")
    for one in value if many else (value,):
        if among and one not in among:
            allowed = f"among {', '.join(among)}" if many else " or ".join(among)
            raise ValueError(f"`{name}` must be {allowed}, got {one!r}")
        if least is not None:
            checked_integer(name, one, least)
        if positive is not None:
            checked_number(name, one, positive=positive)


def _checked_value(name, value, hint):
    """Return a field's value in the type of its annotation."""
    arguments = typing.get_args(hint)
    if isinstance(hint, types.UnionType):
        if value is None and type(None) in arguments:
            return None
        hint = next(kind for kind in arguments if kind is not type(None))
        return _checked_value(name, value, hint)
    if typing.get_origin(hint) is tuple:
        if not isinstance(value, (list, tuple, np.ndarray)):
            raise TypeError(f"`{name}` must be a list, got {value!r}")
        return tuple(_checked_value(name, item, arguments[0]) for item in value)
    if isinstance(value, np.generic):
        value = value.item()
    if hint is float:
        return checked_number(name, value, any_sign=True)
    wrong_bool = isinstance(value, bool) and hint is not bool
    if wrong_bool or not isinstance(value, hint):
        kind = {int: "an integer", str: "a string", bool: "true or false"}[hint]
        raise TypeError(f"`{name}` must be {kind}, got {value!r}")
    return value
