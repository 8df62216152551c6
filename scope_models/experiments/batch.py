"""One call for many files: correct, fit, inject, and simulate the stars of a table.

Each is a study whose stars are files, so that workers, results in one SQLite file, resuming and
failures are those of `~scope_models.experiments.run_sweep`.
"""

import json
import os
import re
import warnings
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import ClassVar

import numpy as np
from astropy.table import Table

from scope_models._arrays import without_unit
from scope_models._docstrings import documented
from scope_models.experiments._correctors import CONVENTIONS
from scope_models.experiments._statistics import percentiles, values_of
from scope_models.experiments._store import FILE
from scope_models.experiments.experiment import run_experiment
from scope_models.experiments.reference import read_reference
from scope_models.experiments.study import Study
from scope_models.io import read_pixels, read_tpf, write_hdulist
from scope_models.io._atomic import check_output
from scope_models.io._opening import naming
from scope_models.missions import MISSIONS
from scope_models.models import TransitModel
from scope_models.photometry import cdpp
from scope_models.scene import PRESETS, Detector, Motion, Star, read_detector
from scope_models.simulation import inject, simulate

__all__ = [
    "detrend_files",
    "find_files",
    "fit_files",
    "inject_file",
    "inject_files",
    "simulate_table",
]

#: Arguments of all functions that run over many files.
RUN = """
client : distributed.Client, str, int or concurrent.futures.Executor, optional
    What computes, as in `run_sweep`.
overwrite : bool, optional
    Whether a new run may replace files in the folder.
sweep : mapping, optional
    Options of `run_sweep`: retry_failed, progress, chunk_size and in_flight.
"""
_PLANET = ("period", "t0", "depth", "duration")
_FITS = re.compile(r"\.(fits|fit|fts)(\.gz)?$", re.IGNORECASE)
_LONGEST = 300  # characters of the warnings of a star


@documented(run=RUN)
def detrend_files(paths, output_dir, client=None, *, overwrite=False, sweep=None, **options):
    """Correct the light curves of many target pixel files.

    Parameters
    ----------
    paths : sequence of str or path-like
        Target pixel files; names of targets are searched and downloaded (`find_files`).
    output_dir : str or path-like
        Folder for the light curves, ``NAME-lc.fits``, and the results, as `run_experiment` writes
        them: the same call goes on where an earlier one stopped.
    {run}
    **options
        Arguments of `~scope_models.correctors.PLDCorrector.correct` that are numbers, text, or
        true or false; ``survival=False`` leaves out the survival of transits, which takes half
        of the time.

    Returns
    -------
    ExperimentResult
        A row per file with its noise before and after in ppm (6.5-h CDPP in both conventions),
        crowding as the header has it, transit survival and warnings; medians by magnitude;
        failures; and the files.

    Raises
    ------
    ValueError
        If a file is given twice, two have the same name, or one would be replaced.
    OSError, SweepError
        As `run_experiment`; SweepError if all files fail.

    Warns
    -----
    FailedStarsWarning
        If files have failed; the others go on.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> from scope_models.experiments.batch import detrend_files
    >>> motion = Motion.k2_roll(300)
    >>> paths = [
    ...     simulate(Star(mag), Detector.k2(shape=(9, 9)), motion, seed=1).write(f"kp{mag}.fits")
    ...     for mag in (11, 12)]
    >>> result = detrend_files(paths, "corrected", order=1, sweep={"progress": False})
    >>> [path.name for path in sorted(result.files[0].parent.glob("*.fits"))]
    ['kp11-lc.fits', 'kp12-lc.fits']
    >>> bool((result.table["cdpp"] < result.table["raw_cdpp"]).all())
    True
    """
    return _Detrend.run(find_files(paths), output_dir, client, overwrite, sweep, options)


@documented(run=RUN)
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
        Arguments of `~scope_models.fit_tpf` that are numbers, text, or true or false;
        ``sensitivity=True`` fits a quadratic response, ``cadences=N`` uses the first N only.

    Returns
    -------
    ExperimentResult
        A row per file: chi-squared per degree of freedom, cadences, median flux, and the fitted
        parameters.

    Raises
    ------
    OSError, ValueError, SweepError
        As `detrend_files`.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> from scope_models.experiments.batch import fit_files
    >>> detector = Detector.k2(shape=(7, 7))
    >>> path = simulate(Star(11), detector, Motion.k2_roll(100), seed=1).write("star.fits")
    >>> result = fit_files([path], "fits", psf=1, sweep={"progress": False})
    >>> result.table["n_cadences"].tolist()
    [95]
    """
    return _Fit.run(find_files(paths), output_dir, client, overwrite, sweep, options)


@documented(run=RUN)
def inject_files(
    paths, planets, output_dir, client=None, *, overwrite=False, sweep=None, star=None, seed=1
):
    """Inject transits into many target pixel files.

    Parameters
    ----------
    paths : sequence of str or path-like
        Target pixel files, or names of targets.
    planets : astropy.table.Table or mapping
        Columns period, t0, depth and duration (days; depth relative): one row for all files, or
        one for each in their order. ``t0`` is the time of a mid-transit as in the file.
    output_dir : str or path-like
        Folder for the results and the files, ``NAME-injected.fits``.
    {run}
    star : {"scene", "fit"} or float, optional
        The light that is dimmed: that of the scene of a simulated file; of a fit with the defaults
        of `~scope_models.fit_tpf`; or the share of the star in all pixels. The default is the
        scene if the file has one, else the fit.
    seed : int, optional
        Seed of the photon noise, together with the name of the file.

    Returns
    -------
    ExperimentResult
        A row per file with the planet and the expected depth in all pixels.

    Raises
    ------
    ValueError
        If the table lacks a column or has another number of rows, and as `detrend_files`.
    OSError, SweepError
        As `detrend_files`.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> from scope_models.experiments.batch import inject_files
    >>> detector = Detector.k2(shape=(9, 9))
    >>> path = simulate(Star(11), detector, Motion.k2_roll(100), seed=1).write("one.fits")
    >>> planet = {"period": [1.0], "t0": [2145.0], "depth": [0.01], "duration": [0.2]}
    >>> result = inject_files([path], planet, "injected", sweep={"progress": False})
    >>> result.table["injected_depth"].round(4).tolist()
    [0.01]
    """
    files = find_files(paths)
    planets = Table(planets)
    missing = [name for name in _PLANET if name not in planets.colnames]
    if missing:
        raise ValueError(f"`planets` lacks the column {missing[0]}")
    if len(planets) not in {1, len(files)}:
        raise ValueError(
            f"`planets` must have one row, or one for each of the {len(files)} files, "
            f"got {len(planets)}"
        )
    rows = [{name: float(row[name]) for name in _PLANET} for row in planets]
    rows = rows if len(rows) > 1 else rows * len(files)
    return _Inject.run(files, output_dir, client, overwrite, sweep, {"star": star}, rows, seed)


def inject_file(path, planet, output, *, star=None, seed=1, overwrite=False):
    """Inject transits into a target pixel file.

    Parameters
    ----------
    path : str or path-like
        The file.
    planet : mapping
        The period, t0, depth and duration, as in `inject_files`.
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
        Name, mission, magnitude; "injected_depth", the expected depth in all pixels; and
        "in_transit", the number of cadences.

    Raises
    ------
    OSError, ValueError
        As `~scope_models.simulation.inject`, or if the output exists or is the input.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> from scope_models.experiments.batch import inject_file
    >>> detector = Detector.k2(shape=(9, 9))
    >>> path = simulate(Star(11), detector, Motion.k2_roll(100), seed=1).write("two.fits")
    >>> planet = {"period": 1.0, "t0": 2145.0, "depth": 0.01, "duration": 0.2}
    >>> round(inject_file(path, planet, "planet.fits")["injected_depth"], 3)
    0.01
    """
    from scope_models import fit_tpf

    check_output(output, overwrite=overwrite, inputs=[path])
    tpf = read_tpf(path)
    series = read_pixels(tpf)
    model = TransitModel.from_depth_duration(
        *(float(planet[name]) for name in ("depth", "duration", "period", "t0")),
        exposure_time=Detector.from_tpf(series).cadence_days,
    )
    total = np.median(np.where(np.isfinite(series.flux), series.flux, 0).sum(axis=(1, 2)))
    if not total > 0:
        raise ValueError(f"{path} has no light in its pixels")
    if star is None:
        star = "scene" if "SCENE" in tpf.hdu else "fit"
    if isinstance(star, str) and star not in {"scene", "fit"}:
        raise ValueError(f'`star` must be "scene", "fit" or a share, got {star!r}')
    with naming(path):
        light = None if star == "scene" else fit_tpf(tpf) if star == "fit" else star
        injected = inject(tpf, model, light, seed=seed)
    write_hdulist(injected.hdu, output, overwrite=overwrite)
    table = injected.hdu[-1].data
    return _header_row(series) | {
        "injected_depth": float(-np.min(table["FLUX_ADDED"]) / total),
        "in_transit": int(np.sum(table["SIGNAL"] < 1)),
    }


@documented(run=RUN)
def simulate_table(
    table, output_dir, client=None, *, overwrite=False, sweep=None,
    detector="k2", motion="", cadences=1000, seed=1,
):  # fmt: skip
    """Simulate the stars of a table, a target pixel file each.

    Parameters
    ----------
    table : astropy.table.Table or mapping
        A row per star: ``mag``, and if wanted ``name``, ``x_0`` and ``y_0`` (pixels), ``period``,
        ``t0``, ``depth`` and ``duration`` of a planet (days; ``t0`` after the first cadence).
    output_dir : str or path-like
        Folder for the results and the files, ``NAME.fits``, by default ``star0001.fits`` and so on.
    {run}
    detector : str, optional
        Name of a preset, or a TOML file of `~scope_models.read_detector`.
    motion : str, optional
        A file whose POS_CORR columns the stars follow. By default a generated K2 roll for K2, and
        rest for others.
    cadences : int, optional
        Cadences of each star; those of the file, if it has fewer.
    seed : int, optional
        Seed of all noise, together with the name of the star.

    Returns
    -------
    ExperimentResult
        A row per star: what the table has, and the noise of the aperture.

    Raises
    ------
    ValueError
        If the table has no column ``mag``, and as `detrend_files`.
    OSError, SweepError
        As `detrend_files`.

    Examples
    --------
    >>> from scope_models.experiments.batch import simulate_table
    >>> stars = {"name": ["faint", "bright"], "mag": [14.0, 11.0]}
    >>> result = simulate_table(stars, "stars", cadences=100, sweep={"progress": False})
    >>> sorted(path.name for path in result.files[0].parent.glob("*.fits"))
    ['bright.fits', 'faint.fits']
    """
    _detector(str(detector))
    table = Table(table)
    if "mag" not in table.colnames or not len(table):
        raise ValueError("`table` must have a column `mag` and a row at least")
    known = ("name", "mag", "x_0", "y_0", *_PLANET)
    if unknown := [name for name in table.colnames if name not in known]:
        raise ValueError(
            f"`table` has an unknown column {unknown[0]}; known are {', '.join(known)}"
        )
    planet = [name for name in _PLANET if name in table.colnames]
    if planet and len(planet) < len(_PLANET):
        raise ValueError(f"`table` must have all or none of {', '.join(_PLANET)}, got {planet}")
    rows = [
        {
            name: np.asarray(without_unit(row[name])).item()
            for name in table.colnames
            if not np.ma.is_masked(row[name])
        }
        for row in table
    ]
    width = max(4, len(str(len(rows))))
    names = [str(row.get("name", f"star{n:0{width}d}")) for n, row in enumerate(rows, start=1)]
    options = {"detector": str(detector), "motion": str(motion), "cadences": cadences}
    return _Simulate.run(names, output_dir, client, overwrite, sweep, options, rows, seed)


def find_files(paths):
    """Return files for paths and names of targets.

    What is no file, and does not end as FITS files do, is a name such as "EPIC 211956421" or
    "TIC 273589987": lightkurve searches and downloads its first target pixel file, or takes it from
    its cache.

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
        If the search or the download fails.
    ValueError
        If a file is given twice, or nothing is found for a name.

    Examples
    --------
    >>> from scope_models.experiments.batch import find_files
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
        if not Path(text).exists() and not _FITS.search(text) and not Path(text).parent.name:
            text = _downloaded(text)
        key = os.path.realpath(text)
        if key in found:
            raise ValueError(f"`paths` holds {path} twice")
        found[key] = str(Path(text).absolute())
    return tuple(found.values())


def _downloaded(name):
    """Return the path of the first target pixel file that lightkurve finds."""
    import lightkurve

    try:
        search = lightkurve.search_targetpixelfile(name)
        tpf = search[0].download() if len(search) else None
    except Exception as error:  # of the network, from many libraries
        reason = " ".join(str(error).split())
        raise OSError(f"{name} is no file, and the search for it failed: {reason}") from error
    if tpf is None:
        raise ValueError(f"{name} is no file, and no target pixel file is found for this name")
    tpf.hdu.close()
    return tpf.path


def _identity(path):
    """Return what is the same for all links to a file: device and inode, or the path if absent."""
    try:
        state = Path(path).stat()
    except OSError:
        return os.path.realpath(path)
    return state.st_dev, state.st_ino


def _detector(name):
    """Return the detector of a name or a file."""
    if name.endswith(".toml"):
        return read_detector(name)
    if name not in PRESETS:
        known = ", ".join(PRESETS)
        raise ValueError(f"`detector` must be a TOML file or one of {known}, got {name!r}")
    return Detector.preset(name)


@dataclass(frozen=True, kw_only=True)
class FileStudy(Study):
    """Base of studies whose stars are files. Only the options are its configuration."""

    suffix: ClassVar[str] = ""

    files: tuple[str, ...] = ()
    rows: tuple[str, ...] = ()
    folder: str = ""
    options: str = "{}"

    @classmethod
    def run(cls, files, folder, client, overwrite, sweep, options, rows=(), seed=1):
        """Run the study after a check of its options and of what it would write."""
        for name, value in options.items():
            if not isinstance(value, (bool, int, float, str, type(None))):
                raise TypeError(f"`{name}` must be a number, text, or true or false, got {value!r}")
        folder = Path(folder).absolute()
        study = cls(
            files=files, rows=tuple(map(json.dumps, rows)), folder=str(folder), seed=seed,
            options=json.dumps(options, sort_keys=True),
        )  # fmt: skip
        outputs = [study.output_of(task["key"]) for task in study.tasks()]
        replaced = {_identity(path) for path in outputs}
        for name in study.input_paths():
            if _identity(name) in replaced:
                raise ValueError(f"{name} would be replaced by an output: choose another folder")
        for path in () if overwrite or (folder / FILE).exists() else outputs:
            if path.exists():
                raise FileExistsError(f"{path} exists already; pass overwrite=True to replace it")
        return run_experiment(study, folder, client, **(sweep or {}))

    def __reduce__(self):
        """Leave out the lists, which tasks have star by star, for workers."""
        names = [item.name for item in fields(self) if item.name not in {"files", "rows"}]
        return partial(type(self), **{name: getattr(self, name) for name in names}), ()

    def config(self):
        """Return the name of the study and its options."""
        return {"study": self.name, "seed": self.seed, **json.loads(self.options)}

    def input_files(self):
        """Return no files: each task has the size and the age of its own."""
        return []

    def input_paths(self):
        """Return the files that must not be replaced."""
        return self.files

    def tasks(self):
        """Return one task per file."""
        tasks, keys = [], {}
        for file in self.files:
            key = re.sub(r"[^A-Za-z0-9._+=-]", "_", _FITS.sub("", Path(file).name)).strip("._-")
            if key in keys:
                raise ValueError(f"{keys[key]} and {file} would both become {key}{self.suffix}")
            keys[key] = file
            tasks.append({"key": key, "file": file} | _state(file))
        for task, row in zip(tasks, self.rows, strict=False):
            task.update(json.loads(row))
        return tasks

    def output_of(self, key):
        """Return the file that is written for a star."""
        return Path(self.folder) / f"{key}{self.suffix}"

    def has_output(self, task):
        """Return whether the file of a star is there."""
        return self.output_of(task["key"]).is_file()

    def run_star(self, task):
        """Write the file of a star and return what is measured."""
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            row = self.work(task, json.loads(self.options), self.output_of(task["key"]))
        texts = dict.fromkeys(" ".join(str(item.message).split()) for item in caught)
        texts = [text for text in texts if "tpfmodel submodule" not in text]
        return row | {"n_warnings": len(texts), "warnings": "; ".join(texts)[:_LONGEST]}

    def summarize(self, table):
        """Return the medians of all columns of numbers, by half magnitudes."""
        names = [
            name
            for name in table.colnames
            if table[name].dtype.kind in "fi" and name not in {"bytes", "changed", "mag"}
        ]
        mag = values_of(table, "mag")
        bins = np.round(2 * mag) / 2
        rows = []
        for center in (*np.unique(bins[np.isfinite(bins)]), np.nan):
            chosen = np.isnan(bins) if np.isnan(center) else bins == center
            if chosen.any():
                row = {"mag": center, "stars": int(chosen.sum())}
                for name in names:
                    row[name] = percentiles(values_of(table[chosen], name))[1]
                rows.append(row)
        return Table(rows)

    def draw(self, table, summary):
        """Draw nothing."""
        return


def _state(file):
    """Return size and age of a file, so that one that has changed is computed again."""
    try:
        state = Path(file).stat()
    except OSError:
        return {"bytes": -1, "changed": 0}
    return {"bytes": state.st_size, "changed": state.st_mtime_ns}


def _header_row(series):
    """Return what the header has: name, mission and magnitude."""
    header, mission = series.header, series.mission
    row = {"object": str(header.get("OBJECT") or ""), "n_cadences": len(series)}
    row["mission"] = mission.name if mission else ""
    row["mag"] = _number(header.get(mission.magnitude_keyword) if mission else None)
    return row


def _number(value):
    """Return a number, NaN for anything else."""
    return float(value) if isinstance(value, (int, float)) else np.nan


@dataclass(frozen=True, kw_only=True)
class _Detrend(FileStudy):
    """Light curves of files."""

    name: ClassVar[str] = "detrend"
    suffix: ClassVar[str] = "-lc.fits"
    units: ClassVar[dict] = {
        "mag": "mag", "raw_cdpp": "ppm", "cdpp": "ppm", "raw_cdpp_lightkurve": "ppm",
        "cdpp_lightkurve": "ppm",
    }  # fmt: skip

    def work(self, task, options, output):
        """Correct a file."""
        from scope_models.correctors import detrend_file  # imports lightkurve

        corrector = detrend_file(task["file"], output, overwrite=True, **options)
        row = _header_row(read_pixels(corrector.tpf))
        row["n_pixels"] = int(corrector.aperture_mask.sum())
        for prefix, lc in (("raw_", corrector.original_lc), ("", corrector.corrected_lc)):
            for method in CONVENTIONS:
                end = "" if method == "everest" else f"_{method}"
                row[f"{prefix}cdpp{end}"] = _cdpp(lc, method)
        row["crowding"] = _number(corrector.tpf.hdu[1].header.get("CROWDSAP"))
        found = corrector.result if options.get("survival", True) else None
        row["survival"] = _number(getattr(found, "transit_survival", None))
        row["n_outliers"] = int(np.sum(corrector.outlier_mask))
        return row

    def draw(self, table, summary):
        """Draw the noise over the magnitude, beside Kepler's and K2's."""
        from scope_models.plotting.statistics import plot_precision  # imports matplotlib

        reference = {
            "Kepler": read_reference("kepler"),
            "K2 C3, EVEREST": read_reference("k2_c03_everest"),
        }
        columns = ("mag", "raw_cdpp", "cdpp")
        return plot_precision({name: values_of(table, name) for name in columns}, reference)


def _cdpp(lc, method):
    """Return the noise of a light curve, NaN if it is too short."""
    try:
        return float(cdpp(lc, method=method))
    except ValueError:
        return np.nan


@dataclass(frozen=True, kw_only=True)
class _Fit(FileStudy):
    """Fits of files."""

    name: ClassVar[str] = "fit"
    suffix: ClassVar[str] = "-fit.fits"
    units: ClassVar[dict] = {"mag": "mag", "flux": "electron / s"}

    def work(self, task, options, output):
        """Fit a file."""
        from scope_models import fit_tpf

        if options.pop("sensitivity", False):
            from scope_models.models import SensitivityPolynomial

            options["sensitivity"] = SensitivityPolynomial(fixed={"ax1": True, "ay1": True})
        tpf = read_tpf(task["file"])
        tpf = tpf[: options.pop("cadences", 0) or None]
        fit = fit_tpf(tpf, **options)
        fit.write(output, overwrite=True)
        row = _header_row(read_pixels(tpf)) | {
            "n_cadences": len(fit.time),
            "reduced_chi2": float(fit.reduced_chi2),
            "flux": float(np.nanmedian(np.asarray(getattr(fit.flux, "value", fit.flux)))),
        }
        for parameter in fit.table():
            value = parameter["value"]
            row[f"{parameter['name']}"] = float(getattr(value, "value", value))
        return row


@dataclass(frozen=True, kw_only=True)
class _Inject(FileStudy):
    """Files with transits."""

    name: ClassVar[str] = "inject"
    suffix: ClassVar[str] = "-injected.fits"
    units: ClassVar[dict] = dict.fromkeys(("period", "t0", "duration"), "d") | {"mag": "mag"}

    def work(self, task, options, output):
        """Inject into a file."""
        seed = self.star_seed(task["key"])
        return inject_file(
            task["file"], task, output, star=options["star"], seed=seed, overwrite=True
        )


@dataclass(frozen=True, kw_only=True)
class _Simulate(FileStudy):
    """Stars of a table."""

    name: ClassVar[str] = "simulate"
    suffix: ClassVar[str] = ".fits"
    units: ClassVar[dict] = dict.fromkeys(("period", "t0", "duration"), "d") | {
        "mag": "mag", "cdpp": "ppm",
    }  # fmt: skip

    def input_paths(self):
        """Return the files of detector and motion."""
        options = json.loads(self.options)
        return [options[name] for name in ("detector", "motion") if options[name]]

    def tasks(self):
        """Return one task per row of the table."""
        tasks = super().tasks()
        for task in tasks:
            for name in ("file", "bytes", "changed"):
                del task[name]
        return tasks

    def work(self, task, options, output):
        """Simulate a star."""
        detector, cadences = _detector(options["detector"]), options["cadences"]
        if options["motion"]:
            motion = Motion.from_file(options["motion"])[:cadences]
        elif detector.mission == "K2":
            motion = Motion.k2_roll(cadences)
        else:
            zero = MISSIONS.get(detector.mission, MISSIONS["Kepler"]).time_format
            motion = Motion.still(cadences, cadence=detector.cadence_days, time_format=zero)
        signal = None
        if "depth" in task:
            signal = TransitModel.from_depth_duration(
                task["depth"], task["duration"], task["period"], motion.time[0] + task["t0"],
                exposure_time=detector.cadence_days,
            )  # fmt: skip
        star = Star(task["mag"], task.get("x_0"), task.get("y_0"), signal=signal)
        observation = simulate(star, detector, motion, seed=self.star_seed(task["key"]))
        observation.write(output, overwrite=True, metadata={"object_name": task["key"]})
        flux = observation.flux[:, observation.aperture].sum(axis=1, dtype=float)
        return {
            "n_cadences": len(motion),
            "n_pixels": int(observation.aperture.sum()),
            "cdpp": _cdpp(flux, "everest"),
        }
