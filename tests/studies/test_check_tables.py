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


@pytest.mark.parametrize("name", check_tables.ROWS)
def test_first_rows_of_a_study_are_compared(name, monkeypatch, capsys):
    """What a study writes for its first stars is compared with the rows that are stored."""
    stored = Table.read(check_tables.DATA / f"{name}.ecsv")[:2]
    column = stored.colnames[-1]

    def main(arguments):
        assert arguments[2:] == ["--stars", "2"]
        stored.write(arguments[1])

    monkeypatch.setattr(check_tables.importlib.import_module(name), "main", main)
    assert check_tables.main([name]) == 0
    stored[column][0] *= 2
    assert check_tables.main([name]) == 1
    assert f": {column} " in capsys.readouterr().out


def test_unknown_tables_are_refused():
    with pytest.raises(SystemExit):
        check_tables.main(["nothing"])
