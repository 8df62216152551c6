"""Results of sweeps: their store, a table, light curves as a data set, and a page.

The store is one SQLite file, which one run at a time writes. The data set has a Parquet file per
star, so that many workers write at once and whatever is finished can be read.
"""

import base64
import errno
import html
import io
import json
import re
import sqlite3
import time
import warnings
import zlib
from collections import defaultdict
from contextlib import closing, contextmanager
from pathlib import Path

import numpy as np
from astropy.io import fits
from astropy.table import QTable

from scope_models._arrays import native, values_of, without_unit
from scope_models._values import html_table
from scope_models._version import __version__
from scope_models.exceptions import DamagedResultWarning
from scope_models.io import read_pixels
from scope_models.io._light_curves import sha256
from scope_models.io._opening import atomic_path
from scope_models.missions import MISSIONS

__all__ = ["read_results", "write_report"]

#: Names of the store and of the data set in a results directory.
FILE, DATA_SET = "results.sqlite", "light_curves"
_OUTPUTS = ("results.ecsv", "summary.ecsv", "failures.ecsv", "figure.png")
_SYNC_INTERVAL = 5.0  # seconds of work that a power failure may cost
_LOCKED = {sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED}
# An exclusive lock needs no shared memory, so that network file systems serve too.
_BEGIN = """
    PRAGMA locking_mode = EXCLUSIVE; PRAGMA journal_mode = WAL; PRAGMA synchronous = NORMAL;
    BEGIN IMMEDIATE;
    CREATE TABLE IF NOT EXISTS config (value TEXT NOT NULL);
    CREATE TABLE IF NOT EXISTS stars (key TEXT PRIMARY KEY, record TEXT NOT NULL, crc INTEGER);
    COMMIT;
"""
#: Units of all columns of results and of light curves.
UNITS = {
    "mag": "mag", "ra": "deg", "dec": "deg", "seconds": "s", "peak_memory": "Mibyte",
    **dict.fromkeys(("time", "period", "t0", "duration"), "d"),
    **dict.fromkeys(("flux", "flux_err", "raw_flux", "raw_flux_err", "bkg_flux"), "electron / s"),
    **dict.fromkeys(("raw_cdpp", "cdpp", "raw_cdpp_everest", "cdpp_everest", "held_out"), "ppm"),
}  # fmt: skip
#: Medians by magnitude, ppm, of the stars in `_SOURCES`.
_PUBLISHED = {
    "mag": [11.5, 12.5, 13.5, 14.5, 15.5, 16.5, 17.5],
    "raw, published": [212, 217, 255, 347, 744, 1534, 2752],
    "EVEREST 2": [20.9, 27.7, 42.9, 73.0, 167, 348, 664],
    "K2SFF": [26.3, 36.9, 61.2, 106, 247, 519, 985],
    "K2SC": [30.4, 39.8, 63.1, 105, 246, 490, 957],
}
_SOURCES = (
    "Medians of the unsaturated stars of K2's campaigns 3 to 6 (79,699 stars that all pipelines "
    "have), computed in the same convention from the published light curves of EVEREST 2 "
    "(AJ 156, 99), K2SFF (PASP 126, 948) and K2SC (MNRAS 459, 2408)."
)
_CONVENTION = (
    "Noise is the 6.5-h CDPP in EVEREST's convention: median of the scatter in windows of 13 "
    "cadences over the root of 13, after a Savitzky-Golay trend of 49 cadences."
)
_OUTLIERS = 8  # as many as one looks at
_STYLE = """
:root { color-scheme: light dark; }
body { font: 15px/1.5 system-ui, sans-serif; max-width: 1100px; margin: 2em auto; padding: 0 1em; }
h1, h2 { font-weight: 600; } img { max-width: 100%; } table { border-collapse: collapse; }
th, td { padding: .2em .8em; text-align: right; border-bottom: 1px solid #8886; }
th { text-align: left; font-weight: 400; } pre { overflow-x: auto; background: #8882; }
figure { display: inline-block; vertical-align: top; width: 48%; min-width: min(440px, 100%); }
figure { margin: 1em 0; } figure:first-of-type { width: 100%; }
figcaption, .note { opacity: 0.8; font-size: 90%; }
div { margin: .6em 0; overflow-wrap: anywhere; }
"""


class Store:
    """The records of a sweep, in a results directory or in memory: "task" and "row" or "error".

    Stars that were tried are in ``failed``, true without a result. The exclusive lock on the file
    ends with the process, however it ends.
    """

    def __init__(self, directory, config, inputs, tasks):
        self.directory = directory
        self._path = Path(":memory:") if directory is None else _file_in(directory)
        self.failed, self._synced = {}, time.monotonic()
        with self._clear_errors():
            self._connection = sqlite3.connect(self._path, timeout=0, isolation_level=None)
            self._connection.text_factory = bytes  # damaged text may not be UTF-8
            try:
                self._begin(config, inputs)
                self._load({task["key"]: task for task in tasks})
            except BaseException:
                self.close()
                raise

    def _begin(self, config, inputs):
        """Lock the file, and check that it belongs to the same configuration and inputs."""
        made = config | {f"contents of {path}": sha256(path) for path in inputs}
        self._connection.executescript(_BEGIN)
        found = self._connection.execute("SELECT value FROM config").fetchone()
        if found is None:
            self._connection.execute("INSERT INTO config VALUES (?)", (json.dumps(made),))
            return
        try:
            there = dict(json.loads(found[0]))
        except (TypeError, ValueError) as error:
            raise ValueError(f"{self._path} is damaged: choose another directory") from error
        here = json.loads(json.dumps(made))
        absent = object()
        differ = [
            f"`{name}` ({_shown(name, there)} there, {_shown(name, here)} here)"
            for name in here | there
            if here.get(name, absent) != there.get(name, absent)
        ]
        if differ:
            raise ValueError(
                f"{self.directory} was made with another configuration, which differs in "
                f"{', '.join(differ)}; choose another directory"
            )

    def _load(self, tasks):
        """Read which stars earlier runs have finished."""
        damaged = []
        for key, record in _records(self._connection):
            if record is None:
                damaged.append(repr(key)[1:])
            elif record["task"] == tasks.get(name := record["task"]["key"]):
                self.failed[name] = "error" in record
        if damaged:
            results = f"{self._path}: damaged results ({listed(damaged)})"
            message = f"{results} are left out and computed again"
            warnings.warn(message, DamagedResultWarning, stacklevel=5)

    def __len__(self):
        """Return how many stars have results."""
        return sum(not failed for failed in self.failed.values())

    def read(self, key):
        rows = self._connection.execute("SELECT record FROM stars WHERE key = ?", (key,))
        return json.loads(rows.fetchone()[0])

    def add(self, record):
        """Keep a record in a transaction of its own; a failure does not replace a result."""
        key, failed = record["task"]["key"], "error" in record
        if failed and self.failed.get(key) is False:
            return
        text = json.dumps(record)
        row = key, text, zlib.crc32(text.encode(), zlib.crc32(key.encode()))
        with self._clear_errors():
            self._connection.execute("INSERT OR REPLACE INTO stars VALUES (?, ?, ?)", row)
            if time.monotonic() - self._synced > _SYNC_INTERVAL:
                self._connection.execute("PRAGMA wal_checkpoint")
                self._synced = time.monotonic()
        self.failed[key] = failed

    def close(self):
        self._connection.close()

    @contextmanager
    def _clear_errors(self):
        """Raise errors of SQLite as errors about the file."""
        try:
            yield
        except sqlite3.DatabaseError as error:
            code = _code_of(error)
            if code in _LOCKED:
                raise OSError(
                    f"another run is writing to {self.directory}: wait until it has ended, or "
                    "choose another directory"
                ) from None
            if code in {sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB}:
                raise ValueError(f"{self._path} is damaged: choose another directory") from error
            failure = OSError(  # its text would begin with a number given here
                f"cannot write to {self._path}; the {len(self)} stars that are finished are kept, "
                f"and the same call resumes there: the reason is: {error}"
            )
            failure.errno = errno.ENOSPC if code == sqlite3.SQLITE_FULL else errno.EIO
            raise failure from error


def read_records(directory):
    """Return all records of a results directory, also of a run that was interrupted."""
    path = Path(directory) / FILE
    if not path.is_file():
        raise FileNotFoundError(f"{directory} is not a results directory: it has no {FILE}")
    try:
        with closing(sqlite3.connect(path, timeout=0)) as connection:
            connection.text_factory = bytes
            return [record for _, record in _records(connection) if record is not None]
    except sqlite3.DatabaseError as error:
        if _code_of(error) in _LOCKED:
            raise OSError(f"a run is writing to {directory}: wait until it has ended") from None
        raise ValueError(f"{path} is damaged") from error


def _records(connection):
    """Yield the key and the record of each star, None if it is damaged."""
    for key, text, crc in connection.execute("SELECT key, record, crc FROM stars"):
        yield key, json.loads(text) if crc == zlib.crc32(text, zlib.crc32(key)) else None


def _file_in(directory):
    """Return the file of a results directory, which is made if it is not there."""
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise NotADirectoryError(f"cannot write to {directory}: it is a file") from None
    except OSError as error:
        message = f"cannot make the folder {directory}: {error.strerror or error}"
        raise type(error)(message) from error
    path = directory / FILE
    for name in () if path.exists() else _OUTPUTS:
        if (directory / name).exists():
            raise ValueError(
                f"{directory} is not empty, and not a results directory either: it has "
                f"{name}, but no {FILE}; choose another directory"
            )
    return path


def _code_of(error):
    return getattr(error, "sqlite_errorcode", 0) & 0xFF


def _shown(name, values):
    text = json.dumps(values[name]) if name in values else "absent"
    return text if len(text) <= 60 else f"{text[:57]}..."


def listed(names):
    """Return the first names as a text."""
    return ", ".join(names[:5]) + (", ..." if len(names) > 5 else "")


def read_results(folder, *, light_curves=False):
    """Read the results of a run over many files, also of one that was interrupted.

    Parameters
    ----------
    folder : str or path-like
        The ``output_dir`` of the run; or a folder with only its Parquet data set.
    light_curves : bool, optional
        Whether the table has a column ``light_curve`` too, a table of each star that
        `detrend_files` wrote.

    Returns
    -------
    astropy.table.QTable
        A row per star that did not fail.

    Raises
    ------
    FileNotFoundError
        If the folder holds no results, or a light curve is missing.
    OSError, ValueError
        If a run is writing to the folder, or the results are damaged.
    ModuleNotFoundError
        If there are Parquet files and pyarrow is not installed.

    Examples
    --------
    >>> from scope_models.batch import read_results, simulate_table
    >>> result = simulate_table({"mag": [11.0]}, "many", cadences=50, sweep={"progress": False})
    >>> read_results("many")["mag"]
    <Quantity [11.] mag>
    """
    folder = Path(folder)
    if (folder / DATA_SET).is_dir() and not (folder / FILE).exists():
        pa = _pyarrow()
        text = pa.schema([("campaign", pa.string()), ("channel", pa.string())])
        hive = pa.dataset.partitioning(text, flavor="hive")
        data = pa.dataset.dataset(folder / DATA_SET, format="parquet", partitioning=hive)
        names = [name for name in data.schema.names if name != "light_curve"]
        rows = data.to_table(columns=names).to_pylist()
    else:
        records = read_records(folder)
        rows = [record["task"] | record["row"] for record in records if "row" in record]
    rows.sort(key=lambda row: row["key"])
    names = list(dict.fromkeys(name for row in rows for name in row))
    table = QTable({name: [row.get(name, np.nan) for row in rows] for name in names})
    for name in UNITS.keys() & set(names):
        table[name].unit = UNITS[name]
    if light_curves:
        curves = np.empty(len(table), dtype=object)
        curves[:] = [read_light_curve(folder / name) for name in table["output"]]
        table["light_curve"] = curves
    return table


def read_light_curve(path):
    if Path(path).suffix == ".parquet":
        lists = _pyarrow().parquet.ParquetFile(path).read(["light_curve"])["light_curve"][0]
        arrays = {name: np.asarray(lists[name].values) for name in lists}
    else:
        with fits.open(path) as hdus:
            arrays = {name.lower(): np.array(hdus[1].data[name]) for name in hdus[1].data.names}
    return QTable(arrays, units={name: UNITS[name] for name in UNITS.keys() & arrays.keys()})


def _pyarrow():
    try:
        import pyarrow as pa
        import pyarrow.dataset
        import pyarrow.parquet
    except ImportError as error:
        command = 'python -m pip install "scope_models[parquet]"'
        raise ModuleNotFoundError(f"Parquet files need pyarrow: {command}") from error
    return pa


def check_data_set(folder, *, overwrite):
    """Refuse a folder whose data set another run has written."""
    _pyarrow()
    path = Path(folder) / DATA_SET
    if path.exists() and not overwrite and not (Path(folder) / FILE).exists():
        raise FileExistsError(f"{path} exists already; pass overwrite=True to replace its stars")


def write_star(path, row, light_curve):
    pa = _pyarrow()
    names = light_curve.dtype.names
    lists = [pa.array([native(light_curve[name])]) for name in names]
    names = [name.lower().replace("sap_quality", "quality") for name in names]
    columns = {name: pa.array([value]) for name, value in row.items()}
    columns["light_curve"] = pa.StructArray.from_arrays(lists, names=names)
    units = {name: {"unit": unit} for name, unit in UNITS.items()}
    fields = [pa.field(name, c.type, metadata=units.get(name)) for name, c in columns.items()]
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_path(path, overwrite=True) as temporary:
        pa.parquet.write_table(pa.table(columns, schema=pa.schema(fields)), temporary)


def write_report(folder, output=None):
    """Write a page about a run over many files, also of one that was interrupted.

    Parameters
    ----------
    folder : str or path-like
        The ``output_dir`` of the run.
    output : str or path-like, optional
        The page, by default ``report.html`` in the folder; one that exists is replaced.

    Returns
    -------
    pathlib.Path
        The page: HTML that holds its figures, for runs of `detrend_files` the noise against the
        magnitude, beside published medians for K2, and the noisiest stars for their magnitude.

    Raises
    ------
    FileNotFoundError
        If the folder holds no results.
    OSError, ValueError
        If a run is writing to the folder, the results are damaged, or the page cannot be written.

    Examples
    --------
    >>> from scope_models.batch import simulate_table, write_report
    >>> result = simulate_table({"mag": [11.0]}, "few", cadences=50, sweep={"progress": False})
    >>> write_report("few").name
    'report.html'
    """
    folder = Path(folder)
    failures = [record for record in read_records(folder) if "error" in record]
    table = read_results(folder)
    parts = [_summary(table, failures)]
    if np.isfinite(values_of(table, "cdpp_everest")).any():
        parts += [_noise(table), _outliers(folder, table)]
    rows = table if "warnings" in table.colnames else ()
    warned = [(row["key"], row["warnings"], "") for row in rows if row["warnings"]]
    failed = [(row["task"]["key"], row["error"], row["traceback"]) for row in failures]
    parts += [_causes("Failures", failed), _causes("Warnings", warned)]
    title = f"Run of {html.escape(folder.absolute().name)}"
    page = (
        '<!DOCTYPE html><html lang="en"><head><meta charset="utf-8">'
        f'<meta name="viewport" content="width=device-width"><title>{title}</title>'
        f"<style>{_STYLE}</style></head><body><h1>{title}</h1>{''.join(parts)}</body></html>"
    )
    output = Path(output or folder / "report.html")
    with atomic_path(output, overwrite=True) as temporary:
        temporary.write_text(page, encoding="utf-8")
    return output


def _summary(table, failures):
    rows = {"stars": len(table), "failed": len(failures)}
    raw, now = (values_of(table, name) for name in ("raw_cdpp_everest", "cdpp_everest"))
    if np.isfinite(now / raw).any():
        rows["median noise over raw"] = f"{np.nanmedian(now / raw):.2f}"
        rows["noisier than raw"] = int(np.sum(now > raw))
    if "seconds" in table.colnames:
        seconds = without_unit(table["seconds"])
        rows["processor time per file"] = f"{np.median(seconds):.2f} s"
        rows["processor time of all"] = f"{np.sum(seconds) / 3600:.2f} h"
        memory = values_of(table, "peak_memory")
        if np.isfinite(memory).any():
            rows["peak memory"] = f"{np.nanmax(memory):.0f} MiB"
    return html_table(f"scope_models {__version__}", rows)


def _noise(table):
    from scope_models.plotting.detrending import plot_precision  # imports matplotlib

    columns = {"mag": "mag", "raw_cdpp": "raw_cdpp_everest", "cdpp": "cdpp_everest"}
    stars = {name: without_unit(table[column]) for name, column in columns.items()}
    is_k2 = bool(np.any(table["mission"] == "K2"))
    figure = plot_precision(stars, _PUBLISHED if is_k2 else None, convention="EVEREST")
    note = f"{_CONVENTION} {_SOURCES}" if is_k2 else _CONVENTION
    image = _image(figure, "Noise against magnitude")
    return f'<h2>Noise</h2>{image}<p class="note">{note}</p>'


def _outliers(folder, table):
    """Return the stars with the most noise for their magnitude, each with a figure."""
    mag, noise = (without_unit(table[name]) for name in ("mag", "cdpp_everest"))
    half, excess = np.round(2 * mag), np.full(len(table), -np.inf)
    for center in np.unique(half[np.isfinite(half)]):
        near = np.isfinite(noise) & (np.abs(half - center) <= 1)
        here = near & (half == center)
        excess[here] = noise[here] / np.median(noise[near])
    parts = ["<h2>Noisiest stars for their magnitude</h2>"]
    for n in np.argsort(-excess)[:_OUTLIERS]:
        if not excess[n] > 0:
            break
        row = table[n]
        text = (
            f"{row['object'] or row['key']} ({row['key']}): magnitude {mag[n]:.1f}, noise "
            f"{noise[n]:.0f} ppm, {excess[n]:.1f} times the median of stars like it. "
            f"{row['warnings']}"
        )
        parts.append(_image(_star(folder, row), text))
    return "".join(parts)


def _star(folder, row):
    from scope_models.plotting import plot_light_curve, plot_summary  # imports matplotlib

    curve = read_light_curve(folder / row["output"])
    time, raw, flux = (np.asarray(curve[name]) for name in ("time", "raw_flux", "flux"))
    label = {"time_label": f"Time ({MISSIONS[row['mission']].time_format.upper()})"}
    try:
        image = read_pixels(row["file"]).flux[0]
    except (OSError, ValueError):
        return plot_light_curve(time, raw, flux, **label).figure
    aperture = None
    if Path(row["output"]).suffix == ".fits":
        with fits.open(folder / row["output"]) as hdus:
            aperture = hdus["APERTURE"].data & 2 > 0
    name = "pos_fit" if np.isfinite(curve["pos_fit1"]).any() else "mom_centr"
    x, y = (np.asarray(curve[f"{name}{axis}"]) for axis in (1, 2))
    axes = plot_summary(time, image, raw, x, y, corrected=flux, aperture=aperture, **label)
    return axes["image"].figure


def _causes(title, found):
    """Return a list of messages, alike but for numbers and files, with the stars that have them."""
    groups = defaultdict(list)
    for key, message, trace in found:
        cause = re.sub(r"(/[^\s:'\"]+)+", "FILE", message)
        groups[re.sub(r"\d[\d.,e+-]*", "N", cause)].append((key, message, trace))
    parts = [f"<h2>{title}</h2>"] if groups else []
    for members in sorted(groups.values(), key=len, reverse=True):
        keys, (_, message, trace) = listed([key for key, *_ in members]), members[0]
        text = f"<b>{len(members)}</b> ({html.escape(keys)}): {html.escape(message)}"
        if trace:
            trace = f"<pre>{html.escape(trace)}</pre>"
            text += f"<details><summary>Traceback of the first</summary>{trace}</details>"
        parts.append(f"<div>{text}</div>")
    return "".join(parts)


def _image(figure, caption):
    from scope_models.plotting._style import save_figure

    content = io.BytesIO()
    save_figure(figure, content)
    data = base64.b64encode(content.getvalue()).decode()
    text = html.escape(caption)
    return (
        f'<figure><img src="data:image/png;base64,{data}" alt="{text}">'
        f"<figcaption>{text}</figcaption></figure>"
    )
