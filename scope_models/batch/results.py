"""Light curves of many stars as a data set of Parquet files, and the output of a run as a table.

The data set has a row per star, the light curve a struct of lists. Each star is a file of its own
in its partition, so that many workers write at once and whatever is finished can be read. pandas,
nested-pandas and pyarrow read the folder as one table.
"""

from pathlib import Path

import numpy as np
from astropy.io import fits
from astropy.table import QTable

from scope_models._arrays import native
from scope_models.batch._many import UNITS
from scope_models.batch._store import FILE, read_records
from scope_models.io._opening import atomic_path

__all__ = ["read_results"]

#: Name of the data set in a results directory.
DATA_SET = "light_curves"
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
    return QTable(arrays, units={k: unit for k, unit in _UNITS.items() if k in arrays})


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
