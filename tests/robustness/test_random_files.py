"""Default calls on random files: results that hold, or errors that name the file or an argument."""

import contextlib
import io

import numpy as np
import pytest
from random_files import checked, random_file

from scope_models import PLDCorrector, Star, fit_tpf
from scope_models.cli import main
from scope_models.simulation import inject

#: These large files are quick: neighbors of negative light, corrections and steps of a search that
#: overflow, and a survival that is not precise.
QUICK = (91, 231, 241, 259)


def files(small, large):
    """Return seeds of small and large files; those that are not named are slow."""
    kinds = (("small-", small, 12), ("", large, 300))
    rows = [(kind, seed, seed in quick) for kind, quick, n in kinds for seed in range(n)]
    slow = pytest.mark.slow
    return pytest.mark.parametrize(
        ("seed", "small"),
        [
            pytest.param(seed, bool(kind), id=f"{kind}{seed}", marks=() if quick else slow)
            for kind, seed, quick in rows
        ],
    )


every_file = files(range(8), QUICK)


@pytest.fixture
def file(seed, small):
    return random_file(seed, small=small)


@every_file
def test_a_file_is_drawn_again(file, seed, small):
    again = random_file(seed, small=small)
    np.testing.assert_array_equal(again.hdus[1].data["FLUX"], file.hdus[1].data["FLUX"])


@every_file
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
    least = np.maximum(5 * raw.flux_err.value, 0.05 * np.nanmedian(raw.flux.value))
    seen = usable & (raw.flux.value > least)
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
        if np.isfinite(survival):
            assert -0.05 < survival < 1.15, file
            assert result.transit_survival_err < 1, file


@every_file
@pytest.mark.parametrize("star", [0.7, Star(13.0, 0.4, 0.2)], ids=["share", "star"])
def test_inject(file, star):
    tpf = file.tpf()
    before = tpf.flux.value.astype(float)
    dip = np.where(np.arange(len(before)) % 10 < 3, 0.5, 1.2)
    changed = checked(lambda: inject(tpf, dip, star, seed=1), file)
    if changed is None:
        return
    after = changed.flux.value.astype(float)
    np.testing.assert_array_equal(np.isfinite(after), np.isfinite(before))
    known = tpf.flux_err.value > 0
    np.testing.assert_array_equal(changed.flux_err.value > 0, known)
    table = changed.hdu["INJECTED"].data
    timed = np.isin(changed.cadenceno, table["CADENCENO"])
    before, after, known = before[timed], after[timed], known[timed]
    added = table["FLUX_ADDED"][np.isin(table["CADENCENO"], changed.cadenceno)]
    quiet = np.isfinite(before) & ~known & (added <= 0)
    np.testing.assert_allclose((after - before)[quiet], added[quiet], rtol=1e-3, atol=0.1)
    if known.any() and np.isfinite(before[known]).any():
        assert np.ptp(np.nansum(added, axis=(1, 2))) > 0, file


# 132: variances of the PSF from 1e-12 to 1e10; 183: a correction that overflows
@files((1, 2, 3, 5, 6), (132, 183))
def test_fit(file):
    fit = checked(lambda: fit_tpf(file.tpf()), file)
    if fit is None:
        return
    for star in (fit, *fit.neighbors):
        for name in ("x", "y", "flux", "x_err", "y_err", "flux_err"):
            assert np.isfinite(getattr(star, name)).all(), (name, file)
    assert np.isfinite(list(fit.values.values())).all(), file
    assert fit.error_scale >= 1
    assert fit.reduced_chi2 > 0


@files(range(6), ())
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


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::scope_models.exceptions.DetrendingWarning")
def test_deep_eclipses_beside_constant_light():
    """The depth is 0.9, of which 5 faint neighbors and the motion by 1.5 px take nothing."""
    file = random_file(45)
    corrector = PLDCorrector(file.tpf())
    lc, light = corrector.correct(), file.signal
    flux, error = (x / np.nanmedian(lc.flux.value) for x in (lc.flux.value, lc.flux_err.value))
    known, eclipsed = np.isfinite(flux), light < 0.5
    assert np.quantile(np.abs(flux - light)[known & eclipsed], 0.95) < 0.01
    assert np.mean((np.abs(flux - light) < 3 * error)[known & eclipsed]) > 0.9
    assert corrector.result.dips[known & eclipsed].mean() > 0.9
