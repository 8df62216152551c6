"""A function that writes a file, for many files: checks of the outputs, and resuming."""

import re
import sys
import time
import unicodedata
import warnings
from functools import partial
from pathlib import Path

import numpy as np
from astropy.table import Table

from scope_models._arrays import values_of
from scope_models.batch._store import FILE
from scope_models.batch.sweep import run_sweep, star_seed
from scope_models.io._opening import identity

__all__ = ["FITS", "RAISES", "RUN", "UNITS", "file_state", "medians", "run_files"]

#: Arguments of all functions that run over many files.
RUN = """
client : distributed.Client, str, int or concurrent.futures.Executor, optional
    What computes, as in `run_sweep`.
overwrite : bool, optional
    Whether a new run may replace files in the folder.
sweep : mapping, optional
    Options of `run_sweep`: retry_failed, progress, chunk_size and in_flight.
"""
#: Errors of all of them.
RAISES = """
Raises
------
OSError, ValueError, SweepError
    As `~scope_models.batch.detrend_files`, or if an argument is not as described."""
#: How the names of FITS files end.
FITS = re.compile(r"\.(fits|fit|fts)(\.gz)?$", re.IGNORECASE)
#: Units of all columns of results.
UNITS = {
    "mag": "mag", "ra": "deg", "dec": "deg", "flux": "electron / s",
    "seconds": "s", "peak_memory": "Mibyte",
    **dict.fromkeys(("period", "t0", "duration"), "d"),
    **dict.fromkeys(("raw_cdpp", "cdpp", "raw_cdpp_everest", "cdpp_everest", "held_out"), "ppm"),
}  # fmt: skip
_LONGEST = 300  # characters of the warnings of a star


def run_files(
    work, names, folder, client, *, name, suffix, options, rows=None, inputs=(), are_files=True,
    seed=1, draw=None, overwrite=False, sweep=None, name_output=None,
):  # fmt: skip
    """Run a function that writes a file over many files or names, after checks of the outputs.

    ``work(task, output, seed, **options)`` returns a row. The tasks hold ``rows`` and, where they
    are files, the names; ``inputs`` are files on which all results depend. By default outputs
    are the keys with the suffix, else what ``name_output(file, key)`` returns.
    """
    for option, value in options.items():
        if not isinstance(value, (bool, int, float, str, type(None))):
            raise TypeError(f"`{option}` must be a number, text, or true or false, got {value!r}")
    folder, tasks, written = Path(folder).absolute(), [], {}
    for file, row in zip(names, rows or [{}] * len(names), strict=True):
        stem = unicodedata.normalize("NFC", FITS.sub("", Path(file).name))
        key = re.sub(r"[^\w.+=-]", "_", stem).strip("._-")
        if not key:
            raise ValueError(f"the name of {file} has no letter or digit for that of its output")
        usual = f"{key}{suffix}"
        output = usual if name_output is None else name_output(file, key)
        for path in dict.fromkeys((usual, output)):
            if path in written:
                raise ValueError(f"{written[path]} and {file} would both become {path}")
            written[path] = file
        state = {"file": file} | file_state(file) if are_files else {}
        tasks.append({"key": key} | state | row | {"output": output})
    outputs = [folder / task["output"] for task in tasks]
    replaced = {identity(path) for path in outputs}
    for file in (*(names if are_files else ()), *inputs):
        if identity(file) in replaced:
            raise ValueError(f"{file} would be replaced by an output: choose another folder")
    for path in () if overwrite or (folder / FILE).exists() else outputs:
        if path.exists():
            raise FileExistsError(f"{path} exists already; pass overwrite=True to replace it")
    return run_sweep(
        partial(_worked, work, options, folder, seed), tasks, folder, client, name=name,
        config={"seed": seed, **options}, units=UNITS, summarize=_summary, draw=draw,
        inputs=inputs, output=lambda task: folder / task["output"], **(sweep or {}),
    )  # fmt: skip


def _worked(work, options, folder, seed, task):
    """Write the file of a star and return its row, with the warnings and the cost."""
    start = time.thread_time()
    with warnings.catch_warnings(record=True, action="always") as caught:
        row = work(task, folder / task["output"], star_seed(seed, task["key"]), **options)
    texts = dict.fromkeys(" ".join(str(item.message).split()) for item in caught)
    texts = [text for text in texts if "tpfmodel submodule" not in text]
    row |= {"n_warnings": len(texts), "warnings": "; ".join(texts)[:_LONGEST]}
    return row | {"seconds": round(time.thread_time() - start, 3), "peak_memory": _peak_memory()}


def _peak_memory():
    """Return the most memory that this process has used so far, MiB; NaN on Windows."""
    try:
        import resource
    except ImportError:
        return np.nan
    unit = 2**20 if sys.platform == "darwin" else 2**10  # bytes there, KiB elsewhere
    return round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit, 1)


def _summary(table):
    """Return the medians of all columns of numbers, by half magnitudes."""
    left_out = {"bytes", "changed", "mag", "seconds", "peak_memory"}
    names = [n for n in table.colnames if table[n].dtype.kind in "fi" and n not in left_out]
    bins = np.round(2 * values_of(table, "mag")) / 2
    rows = []
    for center in np.unique(bins):  # NaN, of unknown magnitudes, is the last
        chosen = np.isnan(bins) if np.isnan(center) else bins == center
        first = {"mag": center, "stars": int(chosen.sum())}
        rows.append(first | medians(table[chosen], names))
    return Table(rows)


def medians(table, names):
    """Return the median of the finite values of each column, NaN without any."""
    columns = {name: values_of(table, name) for name in names}
    finite = {name: values[np.isfinite(values)] for name, values in columns.items()}
    return {name: float(np.median(v)) if len(v) else np.nan for name, v in finite.items()}


def file_state(file):
    """Return size and age of a file, so that one that has changed is computed again."""
    try:
        state = Path(file).stat()
    except OSError:
        return {"bytes": -1, "changed": 0}
    return {"bytes": state.st_size, "changed": state.st_mtime_ns}
