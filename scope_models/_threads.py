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
    return ThreadpoolController().select(user_api="blas")


def _release():
    """Let any thread set the number of threads; since threadpoolctl 3.8 it has one owner."""
    for library in _libraries().lib_controllers:
        if hasattr(library, "clear_controlling_thread"):
            library.clear_controlling_thread(force=True)


class _OneThread(ContextDecorator):
    """One thread for BLAS, from the first entry to the last exit of any thread.

    The matrices are small: further threads wait actively for most of their time, and their number
    changes the rounding of the results. The limit holds for the process; the number of threads
    before the first entry is restored at the last exit.
    """

    def __init__(self):
        self._lock = threading.Lock()
        self._depth = 0
        self._limits = None

    def __enter__(self):
        with self._lock:
            if self._depth == 0:
                _release()
                self._limits = _libraries().limit(limits=1)
            self._depth += 1

    def __exit__(self, *_):
        with self._lock:
            self._depth -= 1
            if self._depth == 0:
                _release()  # the thread that leaves last need not be the one that came first
                self._limits.restore_original_limits()
                _release()


one_thread = _OneThread()
