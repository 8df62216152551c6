"""Linear algebra has one thread within the library, and the user's number after it."""

import sys
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier

import numpy as np
import pytest
import scipy.linalg  # noqa: F401 - SciPy's library is found only once it is loaded
from threadpoolctl import ThreadpoolController, threadpool_limits

from scope_models import Detector, Motion, Star, fit_tpf, inject, simulate
from scope_models._threads import one_thread
from scope_models.cli import main
from scope_models.correctors import PLDCorrector

BLAS = ThreadpoolController().select(user_api="blas")


def threads():
    """Return the numbers of threads of the libraries of linear algebra."""
    return {library["num_threads"] for library in BLAS.info()}


@pytest.fixture(autouse=True)
def _three_threads():
    """Set three threads, and check that they are restored."""
    with threadpool_limits(3, user_api="blas"):
        if threads() != {3}:
            pytest.skip("the number of threads of this linear algebra cannot be set")
        yield
        assert threads() == {3}


@pytest.fixture
def during(monkeypatch):
    """Return the numbers of threads during decompositions and the rendering of stars."""
    seen = set()

    def watched(function):
        def call(*args, **kwargs):
            seen.update(threads())
            return function(*args, **kwargs)

        return call

    for name in ("cholesky", "eigh", "inv", "lstsq", "pinv", "qr", "solve", "svd"):
        monkeypatch.setattr(np.linalg, name, watched(getattr(np.linalg, name)))
    module = sys.modules["scope_models.simulation._light"]
    monkeypatch.setattr(module, "gather", watched(module.gather))
    return seen


@pytest.fixture(scope="module")
def scene():
    return Star(12.0), Detector.k2(shape=(5, 5)), Motion.k2_roll(60)


@pytest.fixture(scope="module")
def tpf(scene):
    return simulate(*scene, seed=1).to_tpf()


@pytest.mark.filterwarnings("ignore::scope_models.exceptions.ScopeModelsWarning")
def test_the_corrector_uses_one_thread(tpf, during):
    made = PLDCorrector(tpf)
    transit = np.where(np.arange(len(tpf.time)) // 5 == 4, 0.99, 1.0)
    made.correct(transit_model=transit)
    made.fit_transit(transit)
    assert during == {1}


@pytest.mark.parametrize(
    "call",
    [
        lambda tpf, _: fit_tpf(tpf, psf=1),
        lambda _, scene: simulate(*scene, seed=1),
        lambda tpf, _: inject(tpf, star=Star(14.0, 2.0, 2.0)),
    ],
    ids=["fit_tpf", "simulate", "inject"],
)
@pytest.mark.filterwarnings("ignore::scope_models.exceptions.ScopeModelsWarning")
def test_fits_and_simulations_use_one_thread(call, tpf, scene, during):
    call(tpf, scene)
    assert during == {1}


def test_command_line_uses_one_thread(during, tmp_path):
    assert main(["simulate", "--mag", "12", "--output", str(tmp_path / "star.fits")]) == 0
    assert during == {1}


def test_limit_ends_after_an_error(tpf):
    with pytest.raises(ValueError, match="usable cadences"):
        PLDCorrector(tpf[:20]).correct()
    # the fixture checks the number of threads


def test_limit_ends_with_the_last_of_several_threads():
    met = Barrier(2)

    def first():
        with one_thread, one_thread:
            met.wait()  # both are inside
        met.wait()
        return threads()

    def second():
        with one_thread:
            met.wait()
            met.wait()  # the first has left
            return threads()

    with ThreadPoolExecutor(2) as executor:
        runs = [executor.submit(function) for function in (first, second)]
        assert runs[1].result() == {1}
    assert threads() == {3}
