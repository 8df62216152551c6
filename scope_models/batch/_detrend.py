"""Corrects one file of many, with positions of other stars of its CCD where its own are wrong."""

import hashlib
import warnings
from collections import defaultdict
from pathlib import Path

import numpy as np
from astropy.io import fits
from astropy.table import Table
from astropy.utils.data import get_readable_fileobj

from scope_models.batch._many import file_state
from scope_models.batch.results import DATA_SET, write_star
from scope_models.exceptions import DetrendingWarning, FitWarning
from scope_models.fitting._common import common_motions, explains, pos_corr_track
from scope_models.io import read_pixels, read_tpf
from scope_models.io._light_curves import Collection, ccd_label, sha256
from scope_models.io._opening import atomic_path, cards_of, naming
from scope_models.io.tpf import write_hdulist
from scope_models.photometry import noise_of
from scope_models.scene import Motion

__all__ = [
    "FORMATS", "archive_name", "detrended", "header_row", "partition_of", "write_manifest",
    "write_motions",
]  # fmt: skip

FORMATS = "fits", "hlsp", "parquet"
_MOST = 12  # files of a CCD whose POS_CORR give the motion of its other stars: a limit of time
_MAJORITY = 3  # stars at least that outvote another one
_FOLDER = "positions"  # of the motions
# All cards would take longer, for all files of a run before the first is corrected.
_KEYWORDS = (
    "MISSION", "TELESCOP", "OBJECT", "CAMPAIGN", "QUARTER", "SECTOR", "CHANNEL", "CAMERA", "CCD",
    "TIMEDEL",
)  # fmt: skip


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
            row[f"{prefix}cdpp"] = noise_of(_files.written(lc))
            row[f"{prefix}cdpp_everest"] = noise_of(_files.written(lc), "everest")
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
    # The format has this name for a missing value.
    run, ccd = (label or "__HIVE_DEFAULT_PARTITION__" for label in ccd_label(file_cards(file)))
    return f"{DATA_SET}/campaign={run}/channel={ccd}/{key}.parquet"


def write_manifest(table, folder):
    """Write the list of the files of a collection, with their checksums."""
    path = Path(folder).absolute() / "manifest.csv"
    listed = Table({"file": table["output"], "sha256": table["sha256"], "target": table["object"]})
    listed["tpf"] = [Path(file).name for file in table["file"]]
    with atomic_path(path, overwrite=True) as temporary:
        listed.write(temporary, format="ascii.csv")
    return path


def header_row(series):
    header, mission = series.header, series.mission
    row = {"object": str(header.get("OBJECT") or ""), "n_cadences": len(series)}
    row["mission"] = mission.name if mission else ""
    row["mag"] = number_of(header.get(mission.magnitude_keyword) if mission else None)
    return row


def number_of(value):
    return float(value) if isinstance(value, (int, float)) else np.nan


def write_motions(files, folder, positions_from=None):
    """Write the common motion of each CCD; return what the task of each file has of it.

    By default it is that of POS_CORR, for files whose own is missing or disagrees.
    """
    given, groups, written = positions_from is not None, defaultdict(list), {}
    places = [_place(file) for file in files]
    sources = positions_from if given else files
    for file, place in zip(sources, map(_place, sources) if given else places, strict=True):
        if given or all(place[:2]):
            groups[place].append(file)
    if others := set(groups) - set(places):
        text = f"no file of the run is of the same CCD as {groups[min(others)][0]}"
        warnings.warn(text, FitWarning, stacklevel=3)
    folder = Path(folder) / _FOLDER
    for place in set(groups) & set(places):
        name, sources = "-".join(filter(None, place)) or "motion", groups[place]
        if not given:
            sources = sources[:: -(-len(sources) // _MOST)]
        path = not given and _unchanged(folder, name)
        if path or (path := _write_motion(folder, name, sources, given=given)):
            written[place] = f"{_FOLDER}/{path.name}"
    return [{"positions": written.get(place, "")} if written else {} for place in places]


def _unchanged(folder, name):
    """Return the motion of files of a run that have not changed since, or None."""
    for path in folder.glob(f"{name}-????????.fits"):
        meta = Motion.read(path).meta
        states = [(file_state(file), state) for file, state in meta["sources"].items()]
        if not meta["given"] and all(now == then or now["bytes"] < 0 for now, then in states):
            return path
    return None


def _write_motion(folder, name, files, *, given):
    """Write the common motion of a CCD; return its file, named by the contents of all, or None."""
    contents = sorted((Path(file).name, sha256(file)) for file in files)
    path = folder / f"{name}-{hashlib.sha256(repr(contents).encode()).hexdigest()[:8]}.fits"
    if path.exists():
        return path
    if given:
        motion = Motion.from_tpfs(files)
    elif len(files) > 1 and (found := common_motions(files, pixels=False)[0]):
        motion = max(found.values(), key=lambda motion: motion.meta["n_files"])
    else:
        return None
    folder.mkdir(parents=True, exist_ok=True)
    sources = {str(Path(file).absolute()): file_state(file) for file in files}
    motion = motion.replace(meta={**motion.meta, "given": given, "sources": sources})
    return motion.write(path, overwrite=True)


def _place(file):
    """Return campaign, CCD and length of the cadences of a file, as its headers have them."""
    cards = file_cards(file)
    step = cards.get("TIMEDEL")
    return *ccd_label(cards), f"{86400 * step:.0f}s" if isinstance(step, float) else ""


def star_positions(tpf, path):
    """Return the motion of a CCD for a star; None if its own positions agree with it."""
    motion, series, reason = Motion.read(path), read_pixels(tpf), ""
    n_stars = len(motion.meta["stars"])
    if not motion.meta["given"]:
        if not n_stars:  # they disagree
            return None
        try:
            motion.offsets(series)
        except ValueError:  # it has none of the cadences
            return None
        track, reason = pos_corr_track("", series), "POS_CORR is missing: "
        if track is not None:
            if n_stars < _MAJORITY or explains(motion, track, series):
                return None
            reason = "POS_CORR disagrees with that of other stars: "
    place = motion.meta["ccd"] or "the same CCD"
    message = f"{reason}positions come from {n_stars} stars of {place}"
    warnings.warn(message, DetrendingWarning, stacklevel=2)
    return motion


def file_cards(file):
    """Return the cards that name a target pixel file; none of one that cannot be read."""
    try:
        opened = get_readable_fileobj(file, encoding="binary")
        with warnings.catch_warnings(action="ignore"), opened as stream:
            headers = [fits.Header.fromfile(stream) for _ in range(2)]
            return cards_of(*({key: h[key] for key in _KEYWORDS if key in h} for h in headers))
    except (OSError, ValueError, IndexError, EOFError, fits.VerifyError):
        return {}
