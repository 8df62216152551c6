"""Corrects one file of many, and writes the light curve in the format of the run."""

from pathlib import Path

import numpy as np
from astropy.table import Table

from scope_models.batch._parquet import partition, write_star
from scope_models.batch._positions import file_cards, star_positions
from scope_models.io import read_pixels, read_tpf
from scope_models.io._atomic import atomic_path
from scope_models.io._light_curves import Collection, ccd_label, sha256
from scope_models.io._opening import naming
from scope_models.io.tpf import write_hdulist
from scope_models.photometry.precision import noise_of

__all__ = ["FORMATS", "archive_name", "detrended", "header_row", "partition_of", "write_manifest"]

FORMATS = "fits", "hlsp", "parquet"


def detrended(task, output, seed, *, format="fits", **options):  # noqa: A002, ARG001
    from scope_models.correctors import _files  # imports lightkurve

    path, survival = task["file"], options.pop("survival", False)
    hlsp = {name[5:]: options.pop(name) for name in list(options) if name.startswith("hlsp_")}
    transits = task if "period" in task else None
    with naming(path):
        tpf = read_tpf(path)
        if task.get("positions"):
            folder = output.parents[len(Path(task["output"]).parts) - 1]
            options["positions"] = star_positions(tpf, folder / task["positions"])
        corrector = _files.correct_file(tpf, transits, **options)
        series = read_pixels(corrector.tpf)
        header, row = series.header, header_row(series)
        row["campaign"], row["channel"] = ccd_label(header)
        row |= {"ra": number_of(header.get("RA_OBJ")), "dec": number_of(header.get("DEC_OBJ"))}
        row["n_pixels"] = int(corrector.aperture_mask.sum())
        for prefix, lc in (("raw_", corrector.original_lc), ("", corrector.corrected_lc)):
            row[f"{prefix}cdpp"] = noise_of(lc)
            row[f"{prefix}cdpp_everest"] = noise_of(lc, "everest")
        row["crowding"] = number_of(header.get("CROWDSAP"))
        if survival:
            row["survival"] = number_of(getattr(corrector.result, "transit_survival", None))
        row["n_outliers"] = int(np.sum(corrector.outlier_mask))
        if format == "hlsp":
            collection = Collection(**hlsp)
            collection.name(series.header)  # raises an error if there is none
            hdus = _files.make_archive_hdulist(corrector, path, collection, survival=survival)
        else:
            hdus = _files.make_lightcurve_hdulist(corrector, survival=survival)
    if format == "parquet":
        facts = {"key": task["key"], "output": task["output"]} | row
        del facts["campaign"], facts["channel"]  # which the path has
        write_star(output, facts, hdus[1].data)
    else:
        write_hdulist(hdus, output, overwrite=True)
    if format == "hlsp":
        row["sha256"] = sha256(output)
    return row


def archive_name(collection, file, key):
    """Return the name of a file in a collection; that of its key where the headers name none."""
    try:
        return collection.name(file_cards(file))
    except ValueError:
        return f"{key}-lc.fits"


def partition_of(file, key):
    """Return the place of a star in the data set, by campaign and channel."""
    return partition(*ccd_label(file_cards(file)), key)


def write_manifest(table, folder):
    """Write the list of the files of a collection, with their checksums."""
    path = Path(folder).absolute() / "manifest.csv"
    listed = Table({"file": table["output"], "sha256": table["sha256"], "target": table["object"]})
    listed["tpf"] = [Path(file).name for file in table["file"]]
    with atomic_path(path, overwrite=True) as temporary:
        listed.write(temporary, format="ascii.csv")
    return path


def header_row(series):
    """Return name, mission and magnitude from the header."""
    header, mission = series.header, series.mission
    row = {"object": str(header.get("OBJECT") or ""), "n_cadences": len(series)}
    row["mission"] = mission.name if mission else ""
    row["mag"] = number_of(header.get(mission.magnitude_keyword) if mission else None)
    return row


def number_of(value):
    return float(value) if isinstance(value, (int, float)) else np.nan
