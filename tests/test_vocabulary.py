"""Public arguments keep to the glossary of the development page, and to American spelling."""

import importlib
import inspect
import operator
import re

import pytest
from docutils.core import publish_doctree
from docutils.nodes import entry, row

import scope_models

BRITISH = re.compile(
    r"colour|cent(re|red|ring)(_|$)|neighbour|behaviour|catalogue|"
    r"[a-z]{3}(al|ar|im|it|rd)is(e|ed|ing)(_|$)"
)


@pytest.fixture(scope="module")
def glossary(repository):
    """Return word, unit, arguments and words that are not used, of each row."""
    text = (repository / "docs" / "development.rst").read_text(encoding="utf-8")
    table = re.search(
        r"^Glossary\n-+\n.*?(^\.\. csv-table::.*?)^\w", text, re.MULTILINE | re.DOTALL
    )
    document = publish_doctree(table[1])
    cells = [[e.astext() for e in r.findall(entry)] for r in document.findall(row)]
    return [
        {
            "word": word,
            "unit": unit,
            "arguments": re.findall(r"\w+", arguments),
            "not": re.findall(r"\w+", avoided),
        }
        for word, _, unit, arguments, avoided in cells[1:]
    ]


@pytest.fixture(scope="module")
def arguments(public_callables):
    """Return the names of all public arguments, and where they occur."""
    found = {}
    for name, value in public_callables:
        try:
            parameters = inspect.signature(value).parameters
        except ValueError:
            continue
        for key in parameters:
            found.setdefault(key, []).append(name)
    return found


def test_glossary_is_sorted_and_has_each_argument_once(glossary):
    assert len(glossary) >= 25
    words = [item["word"] for item in glossary]
    assert words == sorted(words, key=str.lower)
    names = [name for item in glossary for name in item["arguments"]]
    assert len(names) == len(set(names))


def test_words_of_the_glossary_are_in_use(glossary, arguments):
    unused = [name for item in glossary for name in item["arguments"] if name not in arguments]
    assert unused == []


def test_arguments_do_not_use_other_words(glossary, arguments):
    avoided = {word for item in glossary for word in item["not"]}
    found = {name: where for name, where in arguments.items() if name in avoided}
    assert found == {}


def test_spelling_is_american(arguments, public_callables):
    names = set(arguments)
    names |= {name.rpartition(".")[2] for name, _ in public_callables}
    assert sorted(name for name in names if BRITISH.search(name)) == []


@pytest.fixture(scope="module")
def moved(repository):
    """Return old place, names and present place, of each row of the tables of names."""
    path = repository / "tests" / "data" / "names_19e5c3d.rst"
    document = publish_doctree(path.read_text(encoding="utf-8"))
    cells = [[e.astext() for e in r.findall(entry)] for r in document.findall(row)]
    return [(place, names.split(), now) for place, names, now in cells if now != "Now"]


def public_names(place):
    """Return the public names of a module, or the arguments of a call; nothing if it is absent."""
    try:
        if place.startswith("scope_models"):
            module = importlib.import_module(place)
            return set(module.__all__)
        return set(inspect.signature(operator.attrgetter(place)(scope_models)).parameters)
    except (AttributeError, ModuleNotFoundError):
        return set()


def test_names_are_where_the_table_has_them(moved):
    assert len(moved) >= 30
    for place, names, now in moved:
        if now == "here":
            assert set(names) - public_names(place) == set(), place
            continue
        assert set(names) & public_names(place) == set(), place
        if not now.startswith("gone: ") and now not in public_names(place):  # an argument
            assert set(names) - public_names(now) == set(), now


def test_names_of_the_table_import(moved):
    for place, names, now in moved:
        if place.startswith("scope_models") and not now.startswith("gone: "):
            module = importlib.import_module(place if now == "here" else now)
            assert all(getattr(module, name) is not None for name in names)


def test_table_has_each_name_once(moved):
    names = [(place, name) for place, several, _ in moved for name in several]
    assert len(names) == len(set(names)) > 220
