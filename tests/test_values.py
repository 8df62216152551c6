"""Pixels, noise, headers, corrections and fits are those of the first version."""

import json
import runpy
from pathlib import Path

import numpy as np
import pytest

RECORDED = runpy.run_path(str(Path(__file__).with_name("values") / "record.py"))
CASES = RECORDED["CASES"]
RECORD = json.loads(RECORDED["RECORD"].read_text(encoding="utf-8"))
# What an iteration or an inversion gives depends on the order of sums in the linear algebra.
TOLERANCES = {"decorrelated": 1e-9, "fitted": 1e-8}


@pytest.mark.filterwarnings("ignore::scope_models.exceptions.ScopeModelsWarning")
@pytest.mark.parametrize("name", CASES)
def test_values_are_those_on_record(name):
    values, tolerance = CASES[name](), TOLERANCES.get(name, 1e-12)
    assert sorted(values) == sorted(RECORD[name])
    for key, expected in RECORD[name].items():
        value = values[key]
        if isinstance(expected, dict):
            scale = expected["scale"]
            assert value["scale"] == pytest.approx(scale, rel=tolerance), key
            np.testing.assert_allclose(
                value["sums"], expected["sums"], rtol=0, atol=tolerance * scale, err_msg=key
            )
        elif isinstance(expected, float):
            assert value == pytest.approx(expected, rel=1e-12), key
        else:
            assert value == expected, key
