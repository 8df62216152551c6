"""A study: a grid of stars, the measurement of each, and their summary."""

import dataclasses
import hashlib
import types
import typing
import warnings
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
from astropy.utils.exceptions import AstropyDeprecationWarning

from scope_models._arrays import plain_tree
from scope_models._checks import checked_integer, checked_number

__all__ = ["Study"]

_RENAMED = "`summarise` of a study has become `summarize`"


@dataclass(frozen=True, kw_only=True)
class Study(ABC):
    """Base of all studies. A study is its own configuration.

    A subclass is a frozen dataclass whose fields are the configuration: numbers, strings, true or
    false, and tuples of these, each with a default, so that a TOML file can fill them. It says
    which stars there are (`tasks`), what is measured of one star (`run_star`), what that means
    (`summarize`) and how it looks (`draw`).

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

    Raises
    ------
    TypeError
        If a field is of another type than its annotation.
    ValueError
        If a field is outside its domain.

    Notes
    -----
    A subclass whose stars have pixels should define ``observation(task)``, which returns an
    `~scope_models.Observation`, and ``measure(task, observation)``, which returns the numbers:
    `run_star` calls them, and the pixels can then be written as target pixel files. A subclass
    without pixels defines `run_star`.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> from typing import ClassVar
    >>> from scope_models.experiments.study import Study
    >>> @dataclass(frozen=True, kw_only=True)
    ... class Squares(Study):
    ...     name: ClassVar[str] = "squares"
    ...     stars: int = 3
    ...     def tasks(self):
    ...         return [{"key": f"star{i}", "index": i} for i in range(self.stars)]
    ...     def run_star(self, task):
    ...         return {"square": task["index"] ** 2}
    ...     def summarize(self, table):
    ...         return table[:0]
    ...     def draw(self, table, summary):
    ...         raise NotImplementedError
    >>> study = Squares(stars=2)
    >>> study.config()
    {'study': 'squares', 'seed': 1, 'stars': 2}
    >>> [study.run_star(task) for task in study.tasks()]
    [{'square': 0}, {'square': 1}]
    """

    name: ClassVar[str] = ""
    units: ClassVar[Mapping] = types.MappingProxyType({})

    seed: int = 1

    def __init_subclass__(cls, **kwargs):
        super().__init_subclass__(**kwargs)
        old = vars(cls).get("summarise")
        if old is not None and "summarize" not in vars(cls):
            warnings.warn(_RENAMED, AstropyDeprecationWarning, stacklevel=2)
            cls.summarize = old
            del cls.summarise

    def __post_init__(self):
        """Check the type of every field; subclasses go on with the domains."""
        for name, hint in field_types(type(self)).items():
            object.__setattr__(self, name, _checked_value(name, getattr(self, name), hint))
        checked_integer("seed", self.seed, 0)

    @abstractmethod
    def tasks(self):
        """Return the stars.

        Returns
        -------
        list of dict
            One small dictionary of numbers and strings per star. "key" is a unique name out of
            letters, digits and ``._+=-``.
        """

    def run_star(self, task):
        """Return what is measured of one star.

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

    def summarise(self, table):
        """Return `summarize`, by its old name, with a deprecation warning.

        Parameters
        ----------
        table : astropy.table.Table
            As for `summarize`.

        Returns
        -------
        astropy.table.Table
            The summary.
        """
        warnings.warn(_RENAMED, AstropyDeprecationWarning, stacklevel=2)
        return self.summarize(table)

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
            Paths: by default all strings of the configuration that are those of files. A results
            directory that was begun with other contents of them is refused.
        """
        values = [getattr(self, item.name) for item in dataclasses.fields(self)]
        texts = [text for value in values for text in _strings(value)]
        return [text for text in dict.fromkeys(texts) if Path(text).is_file()]

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


def field_types(study_class):
    """Return the types of a study's fields by name.

    Parameters
    ----------
    study_class : type
        A subclass of `Study`.

    Returns
    -------
    dict
        Types, as `int`, ``tuple[float, ...]`` or ``str | None``.
    """
    hints = typing.get_type_hints(study_class)
    return {item.name: hints[item.name] for item in dataclasses.fields(study_class)}


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


def _strings(value):
    """Yield the strings of a field's value."""
    if isinstance(value, str) and value:
        yield value
    elif isinstance(value, tuple):
        for item in value:
            yield from _strings(item)
