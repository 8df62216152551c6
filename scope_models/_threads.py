"""One thread for linear algebra while the library works."""

import importlib
import threading
from contextlib import ContextDecorator
from functools import cache

from threadpoolctl import ThreadpoolController

__all__ = ["one_thread"]


@cache
def _libraries():
    """Return NumPy's and SciPy's libraries of linear algebra; to find them takes milliseconds."""
    importlib.import_module("scipy.linalg")  # SciPy's own is found only once it is loaded
    return ThreadpoolController().select(user_api="blas").lib_controllers


def _set_threads(library, number):
    """Set the number of threads from any thread; since threadpoolctl 3.8 it has one owner."""
    _release(library)
    library.set_num_threads(number)
    _release(library)


def _release(library):
    if hasattr(library, "clear_controlling_thread"):
        library.clear_controlling_thread(force=True)


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
                numbers = ((library, library.num_threads) for library in _libraries())
                self._limited = [(library, n) for library, n in numbers if n != 1]
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
