"""The three files that studies/synthetic_lightkurve.py makes serve lightkurve's tests.

What is checked is what lightkurve checks with the files that these succeed: its self-flat-fielding
(SFF) and its PLD find the signals, residuals are normal, and centroids follow POS_CORR.
"""

import importlib.util
import warnings

import numpy as np
import pytest
from astropy.io import fits
from lightkurve import KeplerTargetPixelFile
from lightkurve.correctors import SFFCorrector
from scipy.stats import anderson

NAMES = ("flat", "sinusoid", "planet")
DURATIONS = np.arange(0.1, 0.6, 0.1)


def path_of(repository, name):
    return repository / "tests" / "data" / "synthetic" / f"synthetic-k2-{name}.targ.fits.gz"


@pytest.fixture
def tpfs(repository):
    return {name: KeplerTargetPixelFile(str(path_of(repository, name))) for name in NAMES}


@pytest.mark.parametrize("name", NAMES)
def test_the_script_makes_them(name, repository, tmp_path):
    script = repository / "studies" / "synthetic_lightkurve.py"
    spec = importlib.util.spec_from_file_location("synthetic_lightkurve", script)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    stored = path_of(repository, name)
    assert stored.stat().st_size < 200_000
    made = module.write(name, *module.stars()[name], tmp_path)
    assert made.name == stored.name
    with fits.open(made) as new, fits.open(stored, checksum=True) as old:
        assert [hdu.name for hdu in new] == [hdu.name for hdu in old]
        assert old[3].name == "SIMULATED_SIGNAL"
        assert old[3].columns.names == ["TIME", "NOISELESS_INPUT"]
        np.testing.assert_allclose(new[3].data["NOISELESS_INPUT"], old[3].data["NOISELESS_INPUT"])
        # rounding differs where a machine's last bit does
        step = 0.1 * old[1].data["FLUX_ERR"]
        assert np.all(np.abs(new[1].data["FLUX"] - old[1].data["FLUX"]) <= step)


def test_signals(tpfs):
    header = tpfs["sinusoid"].hdu[3].header
    assert (header["PERIOD"], header["SINE_AMP"]) == (5.0, 0.001)
    signal = tpfs["sinusoid"].hdu[3].data["NOISELESS_INPUT"]
    assert np.ptp(signal) / 2 == pytest.approx(0.001, rel=1e-3)
    header = tpfs["planet"].hdu[3].header
    assert (header["PERIOD"], header["RPRS"]) == (5.0, 0.044)
    assert 1 - tpfs["planet"].hdu[3].data["NOISELESS_INPUT"].min() > 0.044**2
    assert np.all(tpfs["flat"].hdu[3].data["NOISELESS_INPUT"] == 1)


def test_centroids_follow_the_positions(tpfs):
    for tpf in tpfs.values():
        columns, rows = (c.value - np.median(c.value) for c in tpf.estimate_centroids())
        x, y = (p - np.median(p) for p in (tpf.pos_corr1, tpf.pos_corr2))
        assert np.hypot(columns - x, rows - y).max() < 0.01
        assert np.hypot(columns - y, rows - x).max() < 0.01  # as lightkurve compares them


def correct(tpf, method, **options):
    """Return the light curve of one of lightkurve's correctors."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if method == "pld":
            return tpf.to_corrector("pld").correct(**options)
        places = tpf.pos_corr2, tpf.pos_corr1
        settings = {"niters": 4, "windows": 1, "bins": 7, "timescale": 0.5}
        return SFFCorrector(tpf.to_lightcurve()).correct(*places, **(settings | options))


@pytest.mark.slow
@pytest.mark.parametrize("method", ["sff", "pld"])
def test_residuals_are_normal(method, tpfs):
    options = {"sff": {"niters": 10, "windows": 5, "timescale": 1.5}, "pld": {}}[method]
    lc = correct(tpfs["flat"], method, restore_trend=method == "sff", **options)
    raw = tpfs["flat"].to_lightcurve()
    assert raw.estimate_cdpp() > 10 * lc.estimate_cdpp()
    pull = np.array((lc.flux.value - lc.flux.value.mean()) / lc.flux_err.value)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert anderson(pull).statistic ** 2 < 1.57
    assert pull.std() < 2


@pytest.mark.slow
@pytest.mark.parametrize("method", ["sff", "pld"])
def test_sinusoid_is_found(method, tpfs):
    lc = correct(tpfs["sinusoid"], method, restore_trend=True)
    options = {"minimum_period": 1, "maximum_period": 10, "oversample_factor": 10}
    period = lc.to_periodogram(method="lombscargle", **options).period_at_max_power.value
    assert period == pytest.approx(5.0, rel=0.2)
    phase = 2 * np.pi * lc.time.value / period
    matrix = np.stack([np.ones_like(phase), np.sin(phase), np.cos(phase)], axis=1)
    mean, *wave = np.linalg.lstsq(matrix, np.asarray(lc.flux.value, dtype=float), rcond=None)[0]
    assert 0.001 / 1.1 < np.hypot(*wave) / mean < 0.0011


@pytest.mark.slow
@pytest.mark.parametrize("method", ["sff", "pld"])
def test_planet_is_found(method, tpfs):
    options = {"minimum_period": 1, "maximum_period": 9, "frequency_factor": 0.05}

    def search(lc):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return lc.to_periodogram(method="bls", duration=DURATIONS, **options)

    lc = correct(tpfs["planet"], method, restore_trend=method == "pld").normalize()
    found = search(lc)
    if method == "pld":
        mask = ~found.get_transit_mask()
        found = search(correct(tpfs["planet"], "pld", cadence_mask=mask).normalize())
    assert found.period_at_max_power.value == pytest.approx(5.0, rel=0.05)
    deepest = 1 - tpfs["planet"].hdu[3].data["NOISELESS_INPUT"].min()
    assert 0.044**2 <= float(found.depth_at_max_power) < deepest
