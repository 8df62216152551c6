"""Each constant of PLDCorrector has its kind, and the script finds it."""

import ast

import pytest
from constants import FOLDERS, KINDS, constants


def test_each_constant_has_a_kind():
    rows = constants()
    assert [row["name"] for row in rows if row["kind"] not in KINDS or not row["reason"]] == []
    assert {row["kind"] for row in rows} == set(KINDS)


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("#: Prior: width.\n_A, _B = 1.5, 2\n", [("_A", "1.5", "prior"), ("_B", "2", "prior")]),
        ("#: Branch: limits, in\n#: units.\n_A = {'a': 1}\n_B = (3, 4)\n",
         [("_A", "{'a': 1}", "branch"), ("_B", "(3, 4)", "branch")]),
        ("_A = 3\nNAME = 'text'\n", [("_A", "3", "")]),
        ("#: Prior: width.\n_A = 1\n\n_B = 2\n", [("_A", "1", "prior"), ("_B", "2", "")]),
    ],
)  # fmt: skip
def test_constants_and_their_comments(tmp_path, text, found):
    (tmp_path / "module.py").write_text(text, encoding="utf-8")
    rows = [(row["name"], row["value"], row["kind"]) for row in constants(tmp_path)]
    assert rows == found


def unnamed(path):
    """Return line and value of each fraction in functions of a module that is no arithmetic.

    Quarters and the ratio of standard deviation and median deviation are, and what is only not
    zero or infinite, below 1e-5 and above 1e5.
    """
    found = set()
    for function in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        inside = isinstance(function, ast.FunctionDef | ast.Lambda)
        for node in ast.walk(function) if inside else ():
            value = getattr(node, "value", None)
            if type(value) is float and value % 0.25 and value != 1.4826 and 1e-5 < value < 1e5:
                found.add((node.lineno, value))
    return sorted(found)


def test_functions_hold_no_unnamed_fractions(tmp_path):
    path = tmp_path / "module.py"
    path.write_text("A = 0.3\ndef f(x):\n    return 0.3 * (lambda y: 0.98 * y)(x) / 1e-9 + 0.5\n")
    assert unnamed(path) == [(3, 0.3), (3, 0.98)]
    paths = [path for folder in FOLDERS for path in folder.glob("*.py")]
    assert {path.name: unnamed(path) for path in paths if unnamed(path)} == {}
