"""Corrects the light curves of many files."""

import hashlib
import warnings
from collections import defaultdict
from functools import partial
from pathlib import Path

import numpy as np
from astropy.io import fits
from astropy.table import Table
from astropy.utils.data import get_readable_fileobj

from scope_models._arrays import values_of
from scope_models._checks import checked_choice
from scope_models._docstrings import documented
from scope_models.batch.files import (
    RUN,
    absolute_neighbors,
    file_state,
    find_files,
    header_row,
    number_of,
    planet_rows,
    run_files,
)
from scope_models.batch.results import DATA_SET, check_data_set, write_star
from scope_models.exceptions import DetrendingWarning, FitWarning
from scope_models.fitting._common import common_motions, explains, pos_corr_track
from scope_models.io import read_pixels, read_tpf
from scope_models.io._light_curves import Collection, ccd_label, sha256
from scope_models.io._opening import atomic_path, cards_of, naming
from scope_models.io.tpf import write_hdulist
from scope_models.photometry import noise_of
from scope_models.scene import Motion

__all__ = ["detrend_files"]

_MOST = 12  # files of a CCD whose POS_CORR give its motion: a limit of time
_MAJORITY = 3  # stars at least that outvote another one
_FOLDER = "positions"
# All cards would take longer, before the first file of a run is corrected.
_KEYWORDS = (
    "MISSION", "TELESCOP", "OBJECT", "CAMPAIGN", "QUARTER", "SECTOR", "CHANNEL", "CAMERA", "CCD",
    "TIMEDEL",
)  # fmt: skip


@documented(run=RUN)
def detrend_files(
    paths, output_dir, client=None, *, overwrite=False, sweep=None, format="fits", hlsp=None,  # noqa: A002
    planets=None, positions_from=None, **options,
):  # fmt: skip
    """Correct the light curves of many target pixel files.

    Parameters
    ----------
    paths : sequence of str or path-like
        Target pixel files, or names of targets (`find_files`).
    output_dir : str or path-like
        Folder for the light curves and the results, as `run_sweep` writes them: the same call goes
        on where an earlier one stopped.
    {run}
    format : {"fits", "hlsp", "parquet"}, optional
        A FITS file per star, ``NAME-lc.fits``; FITS files as in an archive's collection of
        high-level science products, with a manifest; or one data set ``light_curves`` of Parquet
        files, a row per star.
    hlsp : mapping of str to str, optional
        The collection of ``format="hlsp"``: id, lead and version, and if wanted title and doi.
    planets : astropy.table.Table or mapping, optional
        Period, t0 (a mid-transit, as in the file) and duration in days, one row for all files or
        one for each: cadences in transit are left out of the fit.
    positions_from : sequence of str or path-like, optional
        Target pixel files whose common motion (`Motion.from_tpfs <scope_models.Motion.from_tpfs>`)
        is that of all stars of their CCDs. By default stars whose POS_CORR is missing, or disagrees
        with that of up to 12 files of the run on the same CCD, have the motion of these, and a
        warning.
    **options
        Arguments of `~scope_models.correctors.PLDCorrector.correct` and fields of
        `~scope_models.correctors.PLDOptions` that are numbers, text, or true or false;
        ``survival`` and ``neighbors`` as for `~scope_models.correctors.detrend_file`.

    Returns
    -------
    SweepResult
        A row per file with its noise in ppm (6.5-h CDPP, lightkurve's as ``cdpp`` and EVEREST's as
        ``cdpp_everest``, before the correction with ``raw_``), the header's crowding, transit
        survival if wanted, and warnings; and medians by magnitude.

    Raises
    ------
    ValueError
        If a file is given twice, two have the same name, or one would be replaced.
    OSError, SweepError
        As `run_sweep`.

    Warns
    -----
    FailedStarsWarning
        If files have failed; the others go on.

    Examples
    --------
    >>> from scope_models import generate_target
    >>> from scope_models.batch import detrend_files
    >>> paths = [
    ...     generate_target(mag, ncadences=300, seed=1).write(f"kp{mag}.fits") for mag in (11, 12)]
    >>> result = detrend_files(paths, "corrected", order=1, sweep={"progress": False})
    >>> bool((result.table["cdpp"] < result.table["raw_cdpp"]).all())
    True
    """
    checked_choice("format", format, ("fits", "hlsp", "parquet"))
    files, inputs = find_files(paths), absolute_neighbors(options)
    rows, name_output = [{}] * len(files), None
    if planets is not None:
        rows = planet_rows(planets, files, ("period", "t0", "duration"), ())
    if (format == "hlsp") != (hlsp is not None):
        raise ValueError('`hlsp` is needed by, and only by, `format="hlsp"`')
    if format != "fits":
        options |= {"format": format} | {f"hlsp_{name}": hlsp[name] for name in hlsp or {}}
    if format == "hlsp":
        name_output = partial(_archive_name, Collection(**hlsp))
    elif format == "parquet":
        name_output = _partition_of
        check_data_set(output_dir, overwrite=overwrite)
    others = None if positions_from is None else find_files(positions_from)
    moved = _write_motions(files, output_dir, others)
    result = run_files(
        _detrended, files, output_dir, client, name="detrend", suffix="-lc.fits",
        rows=[row | more for row, more in zip(rows, moved, strict=True)], options=options,
        draw=_noise_figure, overwrite=overwrite, sweep=sweep, inputs=inputs,
        name_output=name_output,
    )  # fmt: skip
    if format == "hlsp":
        manifest = _write_manifest(result.table, output_dir)
        return result.replace(files=(*result.files, manifest))
    return result


def _noise_figure(table, _):
    from scope_models.plotting.detrending import plot_precision  # imports matplotlib

    return plot_precision({name: values_of(table, name) for name in ("mag", "raw_cdpp", "cdpp")})


def _detrended(task, output, seed, *, format="fits", **options):  # noqa: A002, ARG001
    from scope_models.correctors import _files  # imports lightkurve

    path, survival = task["file"], options.pop("survival", False)
    hlsp = {name[5:]: options.pop(name) for name in list(options) if name.startswith("hlsp_")}
    with naming(path):
        tpf = read_tpf(path)
        if task.get("positions"):
            folder = output.parents[len(Path(task["output"]).parts) - 1]
            options["positions"] = _star_positions(tpf, folder / task["positions"])
        corrector = _files.correct_file(tpf, task if "period" in task else None, **options)
        series = read_pixels(corrector.tpf)
        header, row = series.header, header_row(series)
        row["campaign"], row["channel"] = ccd_label(header)
        row["ra"], row["dec"] = (number_of(header.get(name)) for name in ("RA_OBJ", "DEC_OBJ"))
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
            collection.name(header)  # raises an error if there is none
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


def _archive_name(collection, file, key):
    """Return the name of a file in a collection; that of its key where the headers name none."""
    try:
        return collection.name(_file_cards(file))
    except ValueError:
        return f"{key}-lc.fits"


def _partition_of(file, key):
    """Return the place of a star in the data set, by campaign and channel."""
    # The format has this name for a missing value.
    run, ccd = (label or "__HIVE_DEFAULT_PARTITION__" for label in ccd_label(_file_cards(file)))
    return f"{DATA_SET}/campaign={run}/channel={ccd}/{key}.parquet"


def _write_manifest(table, folder):
    """Write the list of the files of a collection, with their checksums."""
    path = Path(folder).absolute() / "manifest.csv"
    listed = Table({"file": table["output"], "sha256": table["sha256"], "target": table["object"]})
    listed["tpf"] = [Path(file).name for file in table["file"]]
    with atomic_path(path, overwrite=True) as temporary:
        listed.write(temporary, format="ascii.csv")
    return path


def _write_motions(files, folder, positions_from=None):
    """Write the common motion of each CCD; return what the task of each file has of it."""
    given, groups, written = positions_from is not None, defaultdict(list), {}
    sources = positions_from if given else files
    places = {file: _place(file) for file in dict.fromkeys((*files, *sources))}
    for file in sources:
        if given or all(places[file][:2]):
            groups[places[file]].append(file)
    of_files = {places[file] for file in files}
    if others := groups.keys() - of_files:
        text = f"no file of the run is of the same CCD as {groups[min(others)][0]}"
        warnings.warn(text, FitWarning, stacklevel=3)
    folder = Path(folder) / _FOLDER
    for place in groups.keys() & of_files:
        name, sources = "-".join(filter(None, place)) or "motion", groups[place]
        if not given:
            sources = sources[:: -(-len(sources) // _MOST)]
        if path := _write_motion(folder, name, sources, given=given):
            written[place] = f"{_FOLDER}/{path.name}"
    return [{"positions": written.get(places[file], "")} if written else {} for file in files]


def _write_motion(folder, name, files, *, given):
    """Write the common motion of a CCD; return its file, named by the contents of all, or None.

    Without given files it is that of an earlier call if the files of the run have not changed.
    """
    for path in () if given else folder.glob(f"{name}-????????.fits"):
        meta = Motion.read(path).meta
        states = [(file_state(file), state) for file, state in meta["sources"].items()]
        if not meta["given"] and all(now == then or now["bytes"] < 0 for now, then in states):
            return path
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
    sources = {file: file_state(file) for file in files}
    motion = motion.replace(meta={**motion.meta, "given": given, "sources": sources})
    return motion.write(path, overwrite=True)


def _place(file):
    """Return campaign, CCD and length of the cadences of a file, as its headers have them."""
    cards = _file_cards(file)
    step = cards.get("TIMEDEL")
    return *ccd_label(cards), f"{86400 * step:.0f}s" if isinstance(step, float) else ""


def _star_positions(tpf, path):
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


def _file_cards(file):
    """Return the cards that name a target pixel file; none of one that cannot be read."""
    try:
        opened = get_readable_fileobj(file, encoding="binary")
        with warnings.catch_warnings(action="ignore"), opened as stream:
            headers = [fits.Header.fromfile(stream) for _ in range(2)]
            return cards_of(*({key: h[key] for key in _KEYWORDS if key in h} for h in headers))
    except (OSError, ValueError, IndexError, EOFError, fits.VerifyError):
        return {}
