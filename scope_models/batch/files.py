"""One call for many files: fit, inject, and simulate the stars of a table."""

import os
import re
import sys
import time
import unicodedata
import warnings
from dataclasses import fields
from functools import partial
from pathlib import Path

import numpy as np
from astropy.table import Table

from scope_models._arrays import LARGEST_DAY, values_of, without_unit
from scope_models._checks import checked_number, one_line
from scope_models._docstrings import documented
from scope_models.batch.results import FILE, UNITS
from scope_models.batch.sweep import run_sweep, star_seed
from scope_models.fitting import FitOptions, fit_tpf
from scope_models.io._opening import check_output, identity, naming
from scope_models.io.pixels import read_neighbors, read_pixels, read_tpf
from scope_models.io.tpf import write_hdulist
from scope_models.missions import MISSIONS
from scope_models.models import SensitivityPolynomial, TransitModel
from scope_models.photometry import noise_of
from scope_models.scene import PRESETS, Detector, Motion, Star, read_detector
from scope_models.simulation import inject, simulate

__all__ = ["find_files", "fit_files", "inject_file", "inject_files", "simulate_table"]

_NAME = re.compile(r"(EPIC|KIC|TIC)[ -]?\d+", re.IGNORECASE)
_PLANET = ("period", "t0", "depth", "duration")
_COLUMNS = ("name", "mag", "x_0", "y_0", *_PLANET)
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
# How the names of FITS files end.
_FITS = re.compile(r"\.(fits|fit|fts)(\.gz)?$", re.IGNORECASE)
_LONGEST = 300  # characters of the warnings of a star


@documented(run=RUN, raises=RAISES)
def fit_files(paths, output_dir, client=None, *, overwrite=False, sweep=None, **options):
    """Fit PSF, response, positions and fluxes to many target pixel files.

    Parameters
    ----------
    paths : sequence of str or path-like
        Target pixel files, or names of targets.
    output_dir : str or path-like
        Folder for the results and the files, ``NAME-fit.fits``.
    {run}
    **options
        Arguments of `~scope_models.fit_tpf` and `~scope_models.fitting.FitOptions` that are
        numbers, text, or true or false; ``sensitivity=True`` fits a quadratic response,
        ``cadences=N`` uses the first N only, ``neighbors`` is "find" or the file of a catalog.

    Returns
    -------
    SweepResult
        A row per file: reduced chi-squared, cadences, median flux and the fitted parameters.

    {raises}

    Examples
    --------
    >>> from scope_models import generate_target
    >>> from scope_models.batch import fit_files
    >>> path = generate_target(11, ncadences=100, seed=1).write("star.fits")
    >>> result = fit_files([path], "fits", psf=1, sweep={"progress": False})
    >>> result.table["n_cadences"].tolist()
    [95]
    """
    return run_files(
        _fitted, find_files(paths), output_dir, client, name="fit", suffix="-fit.fits",
        inputs=absolute_neighbors(options), options=options, overwrite=overwrite, sweep=sweep,
    )  # fmt: skip


@documented(run=RUN, raises=RAISES)
def inject_files(
    paths, planets, output_dir, client=None, *, overwrite=False, sweep=None, star=None, seed=1
):
    """Inject transits into many target pixel files.

    Parameters
    ----------
    paths : sequence of str or path-like
        Target pixel files, or names of targets.
    planets : astropy.table.Table or mapping
        Columns period and depth, and if wanted t0 and duration (days; depth relative): one row
        for all files, or one for each. ``t0``, a mid-transit as in the file, is by default half a
        period after its first cadence, the duration that of a central transit of a star like the
        Sun.
    output_dir : str or path-like
        Folder for the results and the files, ``NAME-injected.fits``.
    {run}
    star : {"scene", "fit"} or float, optional
        The light that is dimmed: that of the scene of a simulated file; of a default
        `~scope_models.fit_tpf`; or the share of the star in all pixels. The default is the scene
        if the file has one, else the fit.
    seed : int, optional
        Seed of the photon noise, together with the name of the file.

    Returns
    -------
    SweepResult
        A row per file with the planet and the expected depth in all pixels.

    {raises}

    Examples
    --------
    >>> from scope_models import generate_target
    >>> from scope_models.batch import inject_files
    >>> path = generate_target(11, ncadences=100, seed=1).write("one.fits")
    >>> planet = {"period": [1.0], "t0": [2145.0], "depth": [0.01], "duration": [0.2]}
    >>> result = inject_files([path], planet, "injected", sweep={"progress": False})
    >>> result.table["injected_depth"].round(4).tolist()
    [0.01]
    """
    files = find_files(paths)
    return run_files(
        _injected, files, output_dir, client, name="inject", suffix="-injected.fits", seed=seed,
        rows=planet_rows(planets, files), options={"star": star}, overwrite=overwrite, sweep=sweep,
    )  # fmt: skip


def inject_file(path, planet, output, *, star=None, seed=1, overwrite=False):
    """Inject transits into a target pixel file.

    Parameters
    ----------
    path : str or path-like
        The file.
    planet : mapping
        The period and depth, and if wanted t0 and duration, as in `inject_files`.
    output : str or path-like
        The file to write.
    star : {"scene", "fit"} or float, optional
        As in `inject_files`.
    seed : int, optional
        Seed of the photon noise.
    overwrite : bool, optional
        Whether a file that exists is replaced. The input never is.

    Returns
    -------
    dict
        Name, mission, magnitude; "t0" and "duration"; "injected_depth", the expected depth in all
        pixels; and "in_transit", the number of cadences.

    Raises
    ------
    OSError, ValueError
        As `~scope_models.simulation.inject`, or if the output exists or is the input, or no
        cadence is in transit.

    Examples
    --------
    >>> from scope_models import generate_target
    >>> from scope_models.batch import inject_file
    >>> path = generate_target(11, ncadences=100, seed=1).write("two.fits")
    >>> planet = {"period": 1.0, "t0": 2145.0, "depth": 0.01, "duration": 0.2}
    >>> round(inject_file(path, planet, "planet.fits")["injected_depth"], 3)
    0.01
    """
    check_output(output, overwrite=overwrite, inputs=[path])
    tpf = read_tpf(path)
    series = read_pixels(tpf)
    total = np.median(np.nansum(series.flux, axis=(1, 2)))
    if not total > 0:
        raise ValueError(f"{path} has no light in its pixels")
    if star is None:
        star = "scene" if "SCENE" in tpf.hdu else "fit"
    if isinstance(star, str) and star not in {"scene", "fit"}:
        raise ValueError(f'`star` must be "scene", "fit" or a share, got {star!r}')
    with naming(path):
        time = series.time[np.isfinite(series.time)]
        model = planet_model(planet, time, Detector.from_tpf(series).cadence_days)
        light = None if star == "scene" else fit_tpf(tpf) if star == "fit" else star
        injected = inject(tpf, model, light, seed=seed)
    write_hdulist(injected.hdu, output, overwrite=overwrite)
    table = injected.hdu[-1].data
    depth = float(-np.min(table["FLUX_ADDED"].sum(axis=(1, 2))) / total) + 0.0
    row = {"t0": float(model.t0.value), "duration": float(model.duration), "injected_depth": depth}
    return header_row(series) | row | {"in_transit": int(np.sum(table["SIGNAL"] < 1))}


def absolute_neighbors(options):
    """Return the file of neighbors, if there is one; workers find it by its absolute path."""
    if options.get("neighbors") in {None, "find"}:
        return ()
    options["neighbors"] = str(Path(options["neighbors"]).absolute())
    return (options["neighbors"],)


def planet_rows(planets, files, needed=("period", "depth"), further=("t0", "duration")):
    """Return the given parameters of the planet of each file."""
    planets = Table(planets)
    for name in needed:
        if name not in planets.colnames:
            raise ValueError(f"`planets` lacks the column {name}")
    if len(planets) not in {1, len(files)}:
        wanted = f"one row, or one for each of the {len(files)} files"
        raise ValueError(f"`planets` must have {wanted}, got {len(planets)}")
    given = [_values_of(row, (*needed, *further)) for row in planets]
    rows = [{name: float(value) for name, value in row.items()} for row in given]
    return rows if len(rows) > 1 else rows * len(files)


def _values_of(row, names):
    """Return the values that a row of a table has, without units."""
    given = {name: row[name] for name in names if name in row.colnames}
    return {
        name: np.asarray(without_unit(value)).item()
        for name, value in given.items()
        if not np.ma.is_masked(value)
    }


def planet_model(planet, time, exposure_time):
    """Return the transits of a planet; at least one must be among the times in days."""
    period = checked_number("period", float(planet["period"]), positive=True)
    # 13 h (P / yr)^(1/3) (R / R_sun) (rho / rho_sun)^(-1/3): arXiv:1001.2010, eq. 19.
    duration = float(planet.get("duration", 13 / 24 * (period / 365.25) ** (1 / 3)))
    t0 = float(planet.get("t0", time.min() + period / 2))
    span = f"{time.min():.2f} and {time.max():.2f} d, the times of the file"
    if t0 > LARGEST_DAY:
        raise ValueError(f"`t0` must have the zero of the times between {span}, got {t0:.1f}")
    shape = float(planet["depth"]), duration, period, t0
    model = TransitModel.from_depth_duration(*shape, exposure_time=exposure_time)
    if np.all(model(time) == 1):
        given = f"`t0` = {t0:g} d with `period` = {period:g} d"
        raise ValueError(f"{given}: no cadence is in transit between {span}")
    return model


@documented(run=RUN, raises=RAISES)
def simulate_table(
    table, output_dir, client=None, *, overwrite=False, sweep=None,
    detector="k2", motion="", cadences=1000, seed=1,
):  # fmt: skip
    """Simulate the stars of a table, a target pixel file each.

    Parameters
    ----------
    table : astropy.table.Table or mapping
        A row per star: ``mag``, and if wanted ``name``, ``x_0`` and ``y_0`` (pixels), and the
        columns of a planet, as in `inject_files`.
    output_dir : str or path-like
        Folder for the results and the files, ``NAME.fits`` or ``star0001.fits`` and so on.
    {run}
    detector : str, optional
        Name of a preset, or a TOML file of `~scope_models.read_detector`.
    motion : str, optional
        A file whose POS_CORR columns the stars follow. The default is a generated roll for K2, the
        tracking of a telescope for the ground, and rest for others.
    cadences : int, optional
        Cadences of each star; those of the file, if it has fewer.
    seed : int, optional
        Seed of all noise, together with the name of the star.

    Returns
    -------
    SweepResult
        A row per star: what the table has, and the noise of the aperture.

    {raises}

    Examples
    --------
    >>> from scope_models.batch import simulate_table
    >>> stars = {"name": ["faint", "bright"], "mag": [14.0, 11.0]}
    >>> result = simulate_table(stars, "stars", cadences=100, sweep={"progress": False})
    >>> sorted(path.name for path in result.files[0].parent.glob("*.fits"))
    ['bright.fits', 'faint.fits']
    """
    named_detector(str(detector))
    table = Table(table)
    if "mag" not in table.colnames or not len(table):
        raise ValueError("`table` must have a column `mag` and at least one row")
    for name in table.colnames:
        if name not in _COLUMNS:
            known = ", ".join(_COLUMNS)
            raise ValueError(f"`table` has an unknown column {name}; known are {known}")
    planet = set(_PLANET) & set(table.colnames)
    if planet and not {"period", "depth"} <= planet:
        raise ValueError(f"`table` must have period and depth of a planet, got {sorted(planet)}")
    rows = [_values_of(row, table.colnames) for row in table]
    width = max(4, len(str(len(rows))))
    names = [str(row.get("name", f"star{n:0{width}d}")) for n, row in enumerate(rows, start=1)]
    files = {"detector": str(detector), "motion": str(motion)}
    return run_files(
        _simulated, names, output_dir, client, name="simulate", suffix=".fits", rows=rows,
        inputs=[path for path in files.values() if path not in {"", *PRESETS}], are_files=False,
        options=files | {"cadences": cadences}, seed=seed, overwrite=overwrite, sweep=sweep,
    )  # fmt: skip


def find_files(paths):
    """Return files for paths and names of targets.

    Of a name, such as "EPIC 211956421" (or KIC or TIC), lightkurve searches and downloads the first
    target pixel file; of several cadences of one pipeline it is the longest.

    Parameters
    ----------
    paths : sequence of str or path-like
        Files and names.

    Returns
    -------
    tuple of str
        Absolute paths.

    Raises
    ------
    OSError
        If the search or the download fails, or there is no such file.
    ValueError
        If a file is given twice, or nothing is found for a name.

    Examples
    --------
    >>> from scope_models.batch import find_files
    >>> find_files(["absent.fits", "absent.fits"])
    Traceback (most recent call last):
    ...
    ValueError: `paths` holds absent.fits twice
    """
    if isinstance(paths, (str, os.PathLike)):
        paths = [paths]
    found = {}
    for path in paths:
        text = os.fspath(path)
        if not Path(text).exists() and not _FITS.search(text):
            text = _downloaded(text)
        key = os.path.realpath(text)
        if key in found:
            raise ValueError(f"`paths` holds {path} twice")
        found[key] = str(Path(text).absolute())
    return tuple(found.values())


def _downloaded(name):
    """Return the path of the file of a name, as `find_files` describes it."""
    if not _NAME.fullmatch(name):
        raise FileNotFoundError(f"{name}: no such file, and not an EPIC, KIC or TIC number")
    import lightkurve

    try:
        search, tpf = lightkurve.search_targetpixelfile(name), None
        if len(search):
            seconds = search.exptime.value * (search.author == search.author[0])
            tpf = search[int(np.argmax(seconds))].download()
    except Exception as error:  # of the network, from many libraries
        message = f"{name} is not a file, and the search for it failed: {one_line(error)}"
        raise ConnectionError(message) from error
    if tpf is None:
        raise ValueError(f"{name} is not a file, and no target pixel file was found for this name")
    tpf.hdu.close()
    return tpf.path


def named_detector(name, argument="`detector`"):
    if name.endswith(".toml"):
        return read_detector(name)
    if name in PRESETS:
        return Detector.preset(name)
    raise ValueError(f"{argument} must be a TOML file or one of {', '.join(PRESETS)}, got {name!r}")


def default_motion(detector, n):
    """Return the motion that `simulate_table` has by default."""
    cadence = detector.cadence_days
    if detector.mission == "K2":
        return Motion.k2_roll(n)
    if detector.mission == "Ground":
        return Motion.ground(n, cadence=86400 * cadence, pixel_scale=detector.pixel_scale)
    mission = MISSIONS.get(detector.mission, MISSIONS["Kepler"])
    return Motion.still(n, cadence=cadence, start=mission.start, time_format=mission.time_format)


def fit_file(path, output, *, sensitivity=False, cadences=None, overwrite=False, **options):
    """Fit a file, write the fit and return it; the options are those of `fit_files`."""
    check_output(output, overwrite=overwrite, inputs=[path])
    if sensitivity:
        options["sensitivity"] = SensitivityPolynomial(fixed={"ax1": True, "ay1": True})
    with naming(path):
        names = {item.name for item in fields(FitOptions)}
        few = {name: options.pop(name) for name in names & options.keys()}
        pixels = read_pixels(path)[: cadences or None]
        if options.get("neighbors") not in {None, "find"}:
            options["neighbors"] = read_neighbors(options["neighbors"], pixels)
        fit = fit_tpf(pixels, options=FitOptions(**few), **options)
    fit.write(output, overwrite=overwrite)
    return fit


def _fitted(task, output, seed, **options):  # noqa: ARG001 - nothing is drawn
    fit = fit_file(task["file"], output, overwrite=True, **options)
    row = header_row(read_pixels(task["file"])) | {"n_cadences": len(fit.time)}
    row |= {"reduced_chi2": float(fit.reduced_chi2), "flux": float(np.nanmedian(fit.flux))}
    return row | dict(fit.parameters.iterrows("name", "value"))


def _injected(task, output, seed, *, star):
    row = inject_file(task["file"], task, output, star=star, seed=seed, overwrite=True)
    return {name: value for name, value in row.items() if name not in task}


def _simulated(task, output, seed, *, detector, motion, cadences):
    detector, signal = named_detector(detector), None
    motion = Motion.from_file(motion) if motion else default_motion(detector, cadences)
    motion = motion[:cadences]
    if "depth" in task:
        signal = planet_model(task, motion.time, detector.cadence_days)
    star = Star(task["mag"], task.get("x_0"), task.get("y_0"), signal=signal)
    observation = simulate(star, detector, motion, seed=seed)
    name = unicodedata.normalize("NFKD", task["key"]).encode("ascii", "ignore").decode()
    observation.write(output, overwrite=True, metadata={"object_name": name or None})
    flux = observation.flux[:, observation.aperture].sum(axis=1, dtype=float)
    n_pixels = int(observation.aperture.sum())
    return {"n_cadences": len(motion), "n_pixels": n_pixels, "cdpp": noise_of(flux)}


def run_files(
    work, names, folder, client, *, name, suffix, options, rows=None, inputs=(), are_files=True,
    seed=1, draw=None, overwrite=False, sweep=None, name_output=None,
):  # fmt: skip
    """Run a function that writes a file over many files or names, after checks of the outputs.

    ``work(task, output, seed, **options)`` returns a row. The tasks hold ``rows`` and, if
    ``are_files``, the names. Outputs are the keys with the suffix, or those of
    ``name_output(file, key)``.
    """
    for option, value in options.items():
        if not isinstance(value, (int, float, str, type(None))):
            raise TypeError(f"`{option}` must be a number, text, or true or false, got {value!r}")
    folder, tasks, written = Path(folder).absolute(), [], {}
    for file, row in zip(names, rows or [{}] * len(names), strict=True):
        stem = unicodedata.normalize("NFC", _FITS.sub("", Path(file).name))
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
    """Return the peak memory of this process, MiB; NaN on Windows."""
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


def header_row(series):
    header, mission = series.header, series.mission
    return {
        "object": str(header.get("OBJECT") or ""), "n_cadences": len(series),
        "mission": mission.name if mission else "",
        "mag": number_of(header.get(mission.magnitude_keyword) if mission else None),
    }  # fmt: skip


def number_of(value):
    return float(value) if isinstance(value, (int, float)) else np.nan
