"""One thread for linear algebra while the library works."""

import importlib
import threading
from contextlib import ContextDecorator
from functools import cache

from threadpoolctl import ThreadpoolController

__all__ = ["one_thread"]


@cache
def _libraries():
    """Return NumPy's and SciPy's libraries of linear algebra, once: this takes milliseconds."""
    importlib.import_module("scipy.linalg")  # SciPy's own is found only once it is loaded
    return ThreadpoolController().select(user_api="blas").lib_controllers


def _set_threads(library, number):
    """Set the number of threads from any thread; since threadpoolctl 3.8 it has one owner."""
    release = getattr(library, "clear_controlling_thread", lambda **_: None)
    release(force=True)
    library.set_num_threads(number)
    release(force=True)


class _OneThread(ContextDecorator):
    """One thread for BLAS, from the first entry to the last exit of any thread of the process.

    The matrices are small: further threads wait, and their number changes the rounding of results.
    """

    def __init__(self):
        self._lock = threading.Lock()
        self._depth = 0
        self._limited = []

    def __enter__(self):
        with self._lock:
            if self._depth == 0:
                self._limited = [(one, n) for one in _libraries() if (n := one.num_threads) != 1]
                for library, _ in self._limited:
                    _set_threads(library, 1)
            self._depth += 1

    def __exit__(self, *_):
        with self._lock:
            self._depth -= 1
            if self._depth == 0:
                for library, number in self._limited:
                    _set_threads(library, number)


one_thread = _OneThread()
