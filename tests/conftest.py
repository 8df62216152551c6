"""Fixtures shared by all tests."""

import importlib
import inspect
import pkgutil
from pathlib import Path

import pytest

import scope_models
from scope_models import _threads

REPOSITORY = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def repository():
    """Return the folder of the checkout."""
    return REPOSITORY


@pytest.fixture(scope="session")
def shared_data():
    """Return the folder of real archive files beside the checkout, or skip."""
    folder = REPOSITORY.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("the folder ../shared/data with real archive files is absent")
    return folder


@pytest.fixture
def one_thread():
    """Limit linear algebra, for tests of private functions, below the limit of the library."""
    with _threads.one_thread:
        yield


def _public_callables():
    """Yield name and object of each public function, class, and method."""
    seen = set()
    modules = [m.name for m in pkgutil.walk_packages(scope_models.__path__, "scope_models.")]
    for path in ["scope_models", *(name for name in modules if "._" not in name)]:
        module = importlib.import_module(path)
        for name in module.__all__:
            value = getattr(module, name)
            if id(value) in seen or not getattr(value, "__module__", "").startswith("scope_models"):
                continue
            seen.add(id(value))
            if inspect.isclass(value):
                yield name, value
                for key, member in vars(value).items():
                    kinds = (classmethod, staticmethod)
                    if key[0] != "_" and (inspect.isfunction(member) or isinstance(member, kinds)):
                        yield f"{name}.{key}", getattr(value, key)
            elif inspect.isfunction(value):
                yield name, value


@pytest.fixture(scope="session")
def public_callables():
    """Return name and object of each public function, class, and method."""
    return list(_public_callables())
