"""Light curves as one data set of Parquet files: a row per star, the light curve a struct of lists.

Each star is a file of its own in its partition, so that many workers write at once and whatever is
finished can be read. pandas, nested-pandas and pyarrow read the folder as one table.
"""

from pathlib import Path

import numpy as np

from scope_models._arrays import native
from scope_models.batch._many import UNITS
from scope_models.batch._store import FILE
from scope_models.io._atomic import atomic_path

__all__ = [
    "DATA_SET", "check_data_set", "data_set_rows", "light_curve_of", "partition", "write_star",
]  # fmt: skip

#: Name of the data set in a results directory.
DATA_SET = "light_curves"
_UNKNOWN = "__HIVE_DEFAULT_PARTITION__"  # these data sets' name of a missing value


def _pyarrow():
    """Import pyarrow, or raise an error that names the extra."""
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


def partition(campaign, channel, key):
    """Return the path of a star in the folder."""
    campaign, channel = campaign or _UNKNOWN, channel or _UNKNOWN
    return f"{DATA_SET}/campaign={campaign}/channel={channel}/{key}.parquet"


def write_star(path, row, light_curve):
    """Write the file of a star from its row and the table of its light curve."""
    pa = _pyarrow()
    columns, fields = [], []
    for name, value in row.items():
        unit = {"unit": UNITS[name]} if name in UNITS else None
        columns.append(pa.array([value]))
        fields.append(pa.field(name, columns[-1].type, metadata=unit))
    names = light_curve.dtype.names
    lists = [pa.array([native(light_curve[name])]) for name in names]
    names = [name.lower().replace("sap_quality", "quality") for name in names]
    columns.append(pa.StructArray.from_arrays(lists, names=names))
    fields.append(pa.field("light_curve", columns[-1].type))
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_path(path, overwrite=True) as temporary:
        pa.parquet.write_table(pa.table(columns, schema=pa.schema(fields)), temporary)


def data_set_rows(folder):
    """Return the rows of a data set without the light curves."""
    pa = _pyarrow()
    text = pa.schema([("campaign", pa.string()), ("channel", pa.string())])
    hive = pa.dataset.partitioning(text, flavor="hive")
    data = pa.dataset.dataset(Path(folder) / DATA_SET, format="parquet", partitioning=hive)
    names = [name for name in data.schema.names if name != "light_curve"]
    return data.to_table(columns=names).to_pylist()


def light_curve_of(path):
    lists = _pyarrow().parquet.ParquetFile(path).read(["light_curve"])["light_curve"][0]
    return {name: np.asarray(lists[name].values) for name in lists}
