"""The check of stored tables before a release."""

import check_tables
import pytest
from astropy.table import Table


def test_differences_name_each_number():
    stored = Table({"mag": [10, 11], "cdpp": [20.0, 30.0], "converged": ["yes", "yes"]})
    new = Table({"mag": [11, 12], "cdpp": [34.0, 50.0], "converged": ["no", "yes"]})
    number, lines = check_tables.differences(stored, new, ("mag",), 0.1)
    assert number == 2
    assert lines == [
        "mag 11: cdpp 30 is 34 now", "mag 11: converged yes is no now",
        "mag 12: no such row is stored",
    ]  # fmt: skip
    assert check_tables.differences(stored, new[:1], ("mag",), 0.2)[1] == lines[1:2]


@pytest.mark.slow
def test_stored_laws_are_what_a_new_run_gives(capsys):
    assert check_tables.main(["laws", "--limit", "1e-4"]) == 0
    assert ", 0 differ" in capsys.readouterr().out


def test_unknown_tables_are_refused():
    with pytest.raises(SystemExit):
        check_tables.main(["nothing"])
