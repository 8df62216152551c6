"""A fixed set of messy stars whose truth is known, and scores of anybody's corrections of them."""

import re
from dataclasses import asdict
from pathlib import Path

import numpy as np
from astropy.table import Table

from scope_models._arrays import values_of
from scope_models._checks import checked_integer
from scope_models._docstrings import documented
from scope_models.batch._many import RAISES, RUN, medians, run_files
from scope_models.benchmark._scores import score_places
from scope_models.benchmark.regimes import REGIMES
from scope_models.benchmark.sky import make_sky, score
from scope_models.io._opening import first_table, open_fits, read_table
from scope_models.io.tpf import write_hdulist

__all__ = ["benchmark_star", "make_benchmark", "score_light_curves", "summarize_scores"]

_FIRST_SEED = 5000
_STARS, _CADENCES = 200, 1100
# Fluxes are multiples of 1/64 e-/s, far below the noise: the rounding errors of machines vanish.
_STEPS = 64
_DATE = "2026-01-01"
# How files of bzip2, xz, zip, compress and zstandard begin.
_COMPRESSED = (b"BZh", b"\xfd7zXZ", b"PK\x03\x04", b"\x1f\x9d", b"\x28\xb5\x2f\xfd")
_SCORES = ("full", "high_passed", "amplitude", "depth", "pull", "kept", "bias", "step")


def benchmark_star(number):
    """Make a star of the benchmark with its truth.

    Parameters
    ----------
    number : int
        Number of the star, from 0; stars take the `~scope_models.benchmark.REGIMES` in turn.

    Returns
    -------
    MessyStar
        The star; KEPLERID or TICID of its file is 5001 and the number.

    Raises
    ------
    TypeError, ValueError
        If the number is not an integer, or is negative.

    Examples
    --------
    >>> from scope_models.benchmark import benchmark_star
    >>> star = benchmark_star(0)
    >>> star.regime.name, star.to_tpf().targetid
    ('k2-1x-constant', 5001)
    """
    number = checked_integer("number", number, 0)
    names = tuple(REGIMES)
    return make_sky(names[number % len(names)], _FIRST_SEED + number, n_cadences=_CADENCES)


@documented(run=RUN, raises=RAISES)
def make_benchmark(output_dir, client=None, *, overwrite=False, sweep=None, stars=_STARS):
    """Write the target pixel files of the benchmark, without their truth.

    The files are the same on every machine: fluxes are rounded to 1/64 e-/s.

    Parameters
    ----------
    output_dir : str or path-like
        Folder for the files, ``sky000-REGIME.fits`` and so on.
    {run}
    stars : int, optional
        The first so many stars.

    Returns
    -------
    SweepResult
        A row per star: its regime, and the scores of the uncorrected light curve.

    {raises}

    Examples
    --------
    >>> from scope_models.benchmark import make_benchmark
    >>> result = make_benchmark("skies", stars=1, sweep={"progress": False})
    >>> result.table["regime"].tolist()
    ['k2-1x-constant']
    """
    names = tuple(REGIMES)
    rows = [{"number": number} for number in range(checked_integer("stars", stars, 1))]
    files = [f"sky{n:03d}-{names[n % len(names)]}" for n in range(stars)]
    return run_files(
        _written, files, output_dir, client, name="benchmark", suffix=".fits", rows=rows,
        are_files=False, options={"version": 2}, overwrite=overwrite, sweep=sweep,
    )  # fmt: skip


def _written(task, output, seed, *, version):  # noqa: ARG001 - the same on every machine
    sky = benchmark_star(task["number"])
    tpf = sky.to_tpf(quality_bitmask="none")
    for hdu in tpf.hdu:
        if "DATE" in hdu.header:
            hdu.header["DATE"] = _DATE
    tpf.hdu[0].header["OBJECT"] = task["key"]
    flux = tpf.hdu[1].data["FLUX"]
    flux[...] = np.round(_STEPS * flux.astype(float)) / _STEPS
    write_hdulist(tpf.hdu, output, overwrite=True)
    lc = sky.to_tpf().to_lightcurve(aperture_mask="pipeline")
    return {"regime": sky.regime.name} | asdict(score(lc, sky))


def score_light_curves(paths):
    """Compare corrected light curves of the benchmark with the truth.

    Parameters
    ----------
    paths : sequence of str or path-like
        Light curves: the first table of a FITS file, or another table that astropy reads, with the
        columns CADENCENO, FLUX and FLUX_ERR in upper or lower case. ``skyNNN`` in the name of the
        file identifies the star, or KEPLERID or TICID in its header.

    Returns
    -------
    astropy.table.Table
        A row per file: "file", "regime" and the fields of `~scope_models.benchmark.SkyScore`. The
        truth with the noise of its pixels has 1 in ``full``, ``high_passed``, ``amplitude``,
        ``depth`` and ``pull``. For codes of photometry, "bias" is the standard deviation of what
        depends on the place within the pixel, "step" the root mean square of the steps where the
        star crosses from pixel to pixel, both in ppm and less the expected noise: 0 for the truth.

    Raises
    ------
    OSError
        If a file cannot be read.
    ValueError
        If a file is not a light curve of a star of the benchmark.

    Examples
    --------
    >>> from astropy.table import Table
    >>> from scope_models.benchmark import benchmark_star, score_light_curves
    >>> lc = benchmark_star(0).to_tpf().to_lightcurve(aperture_mask="pipeline")
    >>> names = ("cadenceno", "flux", "flux_err")
    >>> Table([lc[name] for name in names], names=names).write("sky000-raw.ecsv")
    >>> score_light_curves(["sky000-raw.ecsv"])["regime"].tolist()
    ['k2-1x-constant']
    """
    rows = []
    for path in paths:
        lc, cards = _read(path)
        sky = benchmark_star(_number_of(path, cards))
        numbers = np.asarray(lc["cadenceno"], dtype=int)
        if not len(lc) or numbers.min() < 1 or numbers.max() > len(sky.time):
            raise ValueError(f"{path} has cadences that the star does not have")
        row = {"file": str(path), "regime": sky.regime.name} | asdict(score(lc, sky))
        flux = np.full(len(sky.time), np.nan)
        flux[numbers - 1] = values_of(lc, "flux")
        cadences = sky.cadenceno * sky.regime.cadence
        bias, step = score_places(cadences, flux, sky.true_flux, sky.x, sky.y)
        rows.append(row | {"bias": bias, "step": step})
    return Table(rows=rows)


def _read(path):
    """Return a light curve with lower-case columns, and the cards of its file."""
    if Path(path).exists() and not Path(path).is_file():
        raise ValueError(f"{path} is not a regular file")
    with Path(path).open("rb") as file:
        start = file.read(6)
    if start.startswith(_COMPRESSED):
        raise ValueError(f"{path} has a compression that is not supported: unpack it")
    if start.startswith((b"SIMPLE", b"\x1f\x8b")):
        with open_fits(path) as hdus:
            table, cards = first_table(hdus, path), dict(hdus[0].header)
            lc = Table(table.data)
    else:
        lc, cards = read_table(path), {}
    lc.rename_columns(lc.colnames, [name.lower() for name in lc.colnames])
    for name in ("cadenceno", "flux", "flux_err"):
        if name not in lc.colnames:
            raise ValueError(f"{path} is not a light curve: it has no column {name.upper()}")
    return lc, cards


def _number_of(path, cards):
    """Return the number of a star from the name of its file, or from its header."""
    if found := re.match(r"sky(\d{3,})", Path(path).name):
        return int(found[1])
    for name in ("KEPLERID", "TICID"):
        value = cards.get(name)
        if isinstance(value, int) and value > _FIRST_SEED:
            return value - _FIRST_SEED - 1
    raise ValueError(
        f"{path} is not a star of the benchmark: its name does not begin with skyNNN, and it "
        f"has no KEPLERID or TICID above {_FIRST_SEED}"
    )


def summarize_scores(table):
    """Return the medians of scores by regime, and of all stars.

    Parameters
    ----------
    table : astropy.table.Table
        Of `score_light_curves`.

    Returns
    -------
    astropy.table.Table
        Columns regime, stars and the scores; the last row is "all".

    Examples
    --------
    >>> from astropy.table import Table
    >>> from scope_models.benchmark import summarize_scores
    >>> table = Table({"regime": ["a", "a", "b"], "full": [1.0, 3.0, 5.0]})
    >>> summarize_scores(table)["full"].tolist()
    [2.0, 5.0, 3.0]
    """
    regimes = np.asarray(table["regime"])
    rows = []
    for regime in (*dict.fromkeys(regimes), "all"):
        chosen = table if regime == "all" else table[regimes == regime]
        rows.append({"regime": str(regime), "stars": len(chosen)} | medians(chosen, _SCORES))
    return Table(rows=rows)
