"""Each constant of PLDCorrector has its kind, and the script finds it."""

import pytest
from constants import KINDS, constants


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
