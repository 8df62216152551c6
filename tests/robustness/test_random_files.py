"""Default calls on random files: results that hold, or errors that name the file or an argument."""

import contextlib
import io

import numpy as np
import pytest
from random_files import checked, random_file

from scope_models import PLDCorrector
from scope_models.cli import main

SMALL = [pytest.param(seed, True, id=f"small-{seed}") for seed in range(12)]
LARGE = [pytest.param(seed, False, id=f"{seed}", marks=pytest.mark.slow) for seed in range(300)]


@pytest.fixture
def file(seed, small):
    return random_file(seed, small=small)


pytestmark = pytest.mark.parametrize(("seed", "small"), SMALL + LARGE)


def test_a_file_is_drawn_again(file, seed, small):
    again = random_file(seed, small=small)
    np.testing.assert_array_equal(again.hdus[1].data["FLUX"], file.hdus[1].data["FLUX"])


def test_pld(file):
    tpf = file.tpf()

    def call():
        corrector = PLDCorrector(tpf)
        corrector.correct()
        return corrector, corrector.result and corrector.result.transit_survival

    found = checked(call, file)
    if found is None:
        return
    corrector, survival = found
    raw, lc = corrector.original_lc, corrector.corrected_lc
    usable = np.isfinite(raw.flux.value)
    seen = usable & (raw.flux.value > 5 * raw.flux_err.value)
    assert np.isfinite(lc.flux.value)[seen].all(), file
    assert (lc.flux_err.value[np.isfinite(lc.flux.value)] > 0).all(), file
    assert not np.isinf(lc.flux.value).any()
    assert not np.isinf(lc.flux_err.value).any()
    result = corrector.result
    if result is not None:
        for name in ("contamination", "crowding", "contrast_error"):
            assert 0 <= getattr(result, name) <= 1, (name, file)
        assert 0 < result.noise_scale < np.inf
        assert result.n_used + result.n_outliers <= usable.sum()
        # a background that is taken off twice makes depths larger than the star's
        if np.isfinite(survival) and file.facts["background"] == "right":
            assert -0.05 < survival < 1.15, file


def test_detrend(file, tmp_path):
    path, output = tmp_path / "star.fits", tmp_path / "lc.fits"
    file.hdus.writeto(path)
    said = io.StringIO()
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
        status = checked(lambda: main(["detrend", str(path), "--output", str(output)]), file)
    text = said.getvalue()
    assert "Traceback" not in text, text
    assert status == (0 if output.exists() else 2), text
    if status:
        assert "star.fits" in text.splitlines()[-1], text
