"""Validate the docstrings of all public names with numpydoc, by its settings in pyproject.toml.

`numpydoc lint` reads source code only, and so takes properties for functions, and the fields of
dataclasses for undocumented parameters. This script validates the objects themselves.
"""

import importlib
import inspect
import pkgutil
import sys
from pathlib import Path

from numpydoc.hooks.validate_docstrings import parse_config
from numpydoc.validate import validate

import scope_models


def public_names():
    """Yield the public names of all modules, and the methods and properties of classes."""
    modules = [
        module.name for module in pkgutil.walk_packages(scope_models.__path__, "scope_models.")
    ]
    for module_name in ["scope_models", *modules]:
        if "._" in module_name:
            continue
        module = importlib.import_module(module_name)
        for name in module.__all__:
            value = getattr(module, name)
            if inspect.isclass(value) or inspect.isfunction(value):
                yield f"{module_name}.{name}"
            if inspect.isclass(value):
                yield from (f"{module_name}.{name}.{member}" for member in own_members(value))


def own_members(class_):
    """Return the public methods and properties that the class itself defines."""
    kinds = (property, classmethod, staticmethod)
    return [
        name
        for name, value in vars(class_).items()
        if not name.startswith("_") and (inspect.isfunction(value) or isinstance(value, kinds))
    ]


def is_excused(code, docstring):
    """Return whether a complaint about parameters has a good reason."""
    # What the package returns, and users do not make, describes its attributes instead.
    if code == "PR01" and "Attributes\n---" in docstring:
        return True
    # astropy makes the parameters of a model arguments, which the signature need not show.
    return code in {"PR01", "PR02"} and "~astropy.modeling.Model`" in docstring


def main():
    """Print what is wrong; return 1 if anything is."""
    settings = parse_config(Path(__file__).parents[1])
    problems = {}
    for name in public_names():
        if settings["exclude"] and settings["exclude"].search(name):
            continue
        result = validate(name)
        for code, message in result["errors"]:
            if code in settings["checks"] and not is_excused(code, result["docstring"]):
                problems[f"{result['file']}:{result['file_line']}: {code} {message}"] = name
    for problem, name in problems.items():
        print(f"{problem} ({name})")
    return bool(problems)


if __name__ == "__main__":
    sys.exit(main())
