"""Reads the output of a run over many files."""

from pathlib import Path

import numpy as np
from astropy.io import fits
from astropy.table import QTable

from scope_models.batch._many import UNITS
from scope_models.batch._parquet import DATA_SET, data_set_rows, light_curve_of
from scope_models.batch._store import FILE, read_records

__all__ = ["read_results"]

#: Units of the columns of light curves.
_FLUXES = "flux", "flux_err", "raw_flux", "raw_flux_err", "bkg_flux"
_UNITS = {"time": "d"} | dict.fromkeys(_FLUXES, "electron / s")


def read_results(folder, *, light_curves=False):
    """Read the results of a run over many files, also of one that was interrupted.

    Parameters
    ----------
    folder : str or path-like
        The ``output_dir`` of the run; or a folder with only its Parquet data set.
    light_curves : bool, optional
        Whether the table has a column ``light_curve`` too, a table of each star, from the FITS or
        Parquet files that `detrend_files` wrote.

    Returns
    -------
    astropy.table.QTable
        A row per star that did not fail, with units.

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
    >>> stars = {"name": ["a", "b"], "mag": [11.0, 12.0]}
    >>> result = simulate_table(stars, "many", cadences=50, sweep={"progress": False})
    >>> table = read_results("many")
    >>> table["key"].tolist(), table["mag"].unit
    (['a', 'b'], Unit("mag"))
    """
    folder = Path(folder)
    if (folder / DATA_SET).is_dir() and not (folder / FILE).exists():
        rows = data_set_rows(folder)
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
        arrays = light_curve_of(path)
    else:
        with fits.open(path) as hdus:
            arrays = {name.lower(): np.array(hdus[1].data[name]) for name in hdus[1].data.names}
    return QTable(arrays, units={k: unit for k, unit in _UNITS.items() if k in arrays})
