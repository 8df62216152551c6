"""The benchmark, a fixed set of messy stars, and scores of corrections."""

import re
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from astropy.table import Table
from scipy.ndimage import median_filter

from scope_models._arrays import plain_array, values_of
from scope_models._checks import checked_integer
from scope_models._docstrings import documented
from scope_models.batch.files import RAISES, RUN, medians, run_files
from scope_models.benchmark.regimes import REGIMES
from scope_models.benchmark.sky import make_sky
from scope_models.io._opening import first_table, open_fits, read_table
from scope_models.io.tpf import write_hdulist
from scope_models.scene.motion import K2Roll

__all__ = [
    "SkyScore", "benchmark_star", "make_benchmark", "score", "score_light_curves",
    "summarize_scores",
]  # fmt: skip

_FIRST_SEED = 5000
_STEPS = 64  # per e-/s: far below the noise, far above the rounding errors of machines
# How files of bzip2, xz, zip, compress and zstandard begin.
_COMPRESSED = (b"BZh", b"\xfd7zXZ", b"PK\x03\x04", b"\x1f\x9d", b"\x28\xb5\x2f\xfd")
_SCORES = ("full", "high_passed", "amplitude", "depth", "pull", "kept", "bias", "step")
_BIN = 13 * K2Roll.cadence  # days, 6.5 h
_WINDOW = 3.0  # days
_MOST_CLIPPED = 0.02
_FEWEST = 100
_PHASES = 8  # bins of a pixel along an axis
_NEAR = 0.15  # px from the border of two pixels
_SIDE = 8  # cadences on either side of a border, at least


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
    return make_sky(_regime_of(number), _FIRST_SEED + number, n_cadences=1100)


def _regime_of(number):
    return tuple(REGIMES)[number % len(REGIMES)]


@documented(run=RUN, raises=RAISES)
def make_benchmark(output_dir, client=None, *, overwrite=False, sweep=None, stars=200):
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
    numbers = range(checked_integer("stars", stars, 1))
    return run_files(
        _written, [f"sky{n:03d}-{_regime_of(n)}" for n in numbers], output_dir, client,
        name="benchmark", suffix=".fits", rows=[{"number": n} for n in numbers], are_files=False,
        options={"version": 2}, overwrite=overwrite, sweep=sweep,
    )  # fmt: skip


def _written(task, output, seed, *, version):  # noqa: ARG001 - the same on every machine
    sky = benchmark_star(task["number"])
    tpf = sky.to_tpf(quality_bitmask="none")
    for hdu in tpf.hdu:
        if "DATE" in hdu.header:
            hdu.header["DATE"] = "2026-01-01"
    tpf.hdu[0].header["OBJECT"] = task["key"]
    flux = tpf.hdu[1].data["FLUX"]
    flux[...] = np.round(_STEPS * flux.astype(float)) / _STEPS
    write_hdulist(tpf.hdu, output, overwrite=True)
    lc = sky.to_tpf().to_lightcurve(aperture_mask="pipeline")
    return {"regime": sky.regime.name} | asdict(score(lc, sky))


@dataclass(frozen=True)
class SkyScore:
    """Score of a light curve against the star's true flux, but for a constant factor.

    Attributes
    ----------
    full : float
        Standard deviation of 6.5-h bins of corrected over true flux, in units of the floor.
    high_passed : float
        The same after a running mean of 3 d has been subtracted.
    amplitude : float
        Slope of the corrected flux on the true one, outside of transits; NaN for constant stars.
    depth : float
        Depth of the transits over the true one, below a line around each; NaN without transits.
    pull : float
        Root mean square of the cadences' deviations from the truth over the quoted errors.
    kept, floor : float
        Part of the cadences that have a corrected flux; and expected noise of a 6.5-h bin, ppm.

    Examples
    --------
    >>> from scope_models.benchmark import make_sky, score
    >>> sky = make_sky("k2-1x-delta-scuti", seed=2, n_cadences=300)
    >>> lc = sky.to_tpf().to_lightcurve(aperture_mask="pipeline")
    >>> bool(0.9 < score(lc, sky).amplitude < 1.1)
    True
    """

    full: float
    high_passed: float
    amplitude: float
    depth: float
    pull: float
    kept: float
    floor: float


def score(lc, sky):
    """Compare a light curve with the truth.

    Parameters
    ----------
    lc : lightkurve.LightCurve
        Corrected (or raw) light curve with cadence numbers, from `MessyStar.to_tpf`.
    sky : MessyStar
        The star.

    Returns
    -------
    SkyScore
        The scores.

    Raises
    ------
    ValueError
        If the light curve has no column ``cadenceno``.

    Examples
    --------
    >>> from scope_models.benchmark import make_sky, score
    >>> sky = make_sky("k2-1x-transits-1pct", seed=1, n_cadences=300)
    >>> lc = sky.to_tpf().to_lightcurve(aperture_mask="pipeline")
    >>> bool(0.7 < score(lc, sky).depth < 1.3)
    True
    """
    if "cadenceno" not in getattr(lc, "columns", ()):
        raise ValueError("`lc` must have the column cadenceno")
    rows = np.searchsorted(sky.cadenceno, np.asarray(lc["cadenceno"], dtype=int))
    flux, error = (plain_array(lc[name], None, name) for name in ("flux", "flux_err"))
    return score_light_curve(
        sky.regime.cadence * rows, flux, error, sky.true_flux[rows], sky.transit[rows],
        sky.floor(),
    )  # fmt: skip


def score_light_curves(paths):
    """Compare corrected light curves of the benchmark with the truth.

    Parameters
    ----------
    paths : sequence of str or path-like
        Light curves: the first table of a FITS file, or another table that astropy reads, with the
        columns CADENCENO, FLUX and FLUX_ERR in upper or lower case. A file's name identifies its
        star by ``skyNNN``, else its header by KEPLERID or TICID.

    Returns
    -------
    astropy.table.Table
        A row per file: "file", "regime" and the fields of `~scope_models.benchmark.SkyScore`, which
        are 1 for the truth with the noise of its pixels but for ``floor``. "bias" is the standard
        deviation of what depends on the place within the pixel, "step" the root mean square of the
        steps where the star crosses from pixel to pixel, both in ppm and less the expected noise.

    Raises
    ------
    OSError
        If a file cannot be read.
    ValueError
        If a file is not a light curve of a star of the benchmark.

    Examples
    --------
    >>> from scope_models.benchmark import benchmark_star, score_light_curves
    >>> lc = benchmark_star(0).to_tpf().to_lightcurve(aperture_mask="pipeline")
    >>> lc.to_table()["cadenceno", "flux", "flux_err"].write("sky000-raw.ecsv")
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
        time = sky.cadenceno * sky.regime.cadence
        bias, step = score_places(time, flux, sky.true_flux, sky.x, sky.y)
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


def score_light_curve(time, flux, error, truth, transit, noise):
    """Return the `SkyScore` of a light curve; all but `time`, in days, is relative."""
    good = np.isfinite(flux) & np.isfinite(error)
    floor = noise / np.sqrt(_per_bin(time))
    shared = {"kept": float(good.mean()), "floor": 1e6 * floor}
    time, flux, error, truth, transit = (a[good] for a in (time, flux, error, truth, transit))
    if good.sum() < _FEWEST or not np.median(flux) > 0:
        return SkyScore(np.inf, np.inf, np.nan, np.nan, np.nan, **shared)
    ratio = flux / truth
    level = np.median(ratio)
    deviation = ratio / level - 1
    fine = ~outliers(deviation)
    pull = np.sqrt(np.mean((deviation * truth * level / error)[fine] ** 2))
    smooth = deviation[fine] - _running_mean(time[fine], deviation[fine])
    outside = fine & (transit == 1)
    varies = outside.any() and truth[outside].std() >= 1e-5
    return SkyScore(
        full=_scatter(time[fine], deviation[fine]) / floor,
        high_passed=_scatter(time[fine], smooth) / floor,
        amplitude=slope(flux[outside], truth[outside]) if varies else np.nan,
        depth=_depth(time[fine], flux[fine], truth[fine], transit[fine]),
        pull=float(pull),
        **shared,
    )


def score_places(time, flux, truth, x, y):
    """Return the bias, of a sum of functions of the fractions of x and y, and the step, in ppm.

    `score_light_curves` defines both; they are NaN with too few cadences or crossings of pixels.
    """
    good = np.isfinite(flux * truth * x * y)
    time, flux, truth, x, y = (a[good] for a in (time, flux, truth, x, y))
    if good.sum() < _FEWEST or not np.median(flux) > 0:
        return np.nan, np.nan
    deviation = flux / truth / np.median(flux / truth) - 1
    deviation = deviation - _running_mean(time, deviation)
    fine = ~outliers(deviation)
    deviation, places = deviation[fine], (x[fine], y[fine])
    bins = [((a + 0.5) % 1 * _PHASES).astype(int) for a in places]
    columns = np.concatenate([np.eye(_PHASES)[number] for number in bins], axis=1)
    found, _, rank, _ = np.linalg.lstsq(columns, deviation, rcond=None)
    fitted = columns @ found
    noise = np.sum((deviation - fitted) ** 2) / (len(deviation) - rank)
    bias = np.sqrt(max(fitted.var() - noise * (rank - 1) / len(deviation), 0.0))
    steps = [step for place in places for step in _steps(deviation, place)]
    if not steps:
        return 1e6 * float(bias), np.nan
    sizes, errors, cadences = np.transpose(steps)
    mean = np.average(sizes**2 - errors**2, weights=cadences)
    return 1e6 * float(bias), 1e6 * float(np.sqrt(max(mean, 0.0)))


def _steps(values, place):
    """Yield the step at each border of pixels, beside a parabola, its error and the cadences."""
    border = np.floor(place)
    distance = place - border - 0.5
    near = np.abs(distance) < _NEAR
    for one in np.unique(border[near]):
        mine = near & (border == one)
        beyond = distance[mine] > 0
        if min(beyond.sum(), (~beyond).sum()) < _SIDE:
            continue
        columns = np.stack([beyond, *distance[mine] ** np.arange(3)[:, None]], axis=1)
        inverse = np.linalg.pinv(columns.T @ columns)
        found = inverse @ columns.T @ values[mine]
        rest = values[mine] - columns @ found
        yield found[0], np.sqrt(inverse[0, 0] * (rest @ rest) / (len(rest) - 4)), len(rest)


def outliers(values):
    """Return cadences far from their neighbors' median, 2 % at most: cosmic rays and the like."""
    size = np.abs(values - median_filter(values, 7, mode="nearest"))
    limit = max(6 * 1.4826 * np.median(size), np.quantile(size, 1 - _MOST_CLIPPED))
    return size > limit


def _scatter(time, values):
    """Return the standard deviation of the means of 13 cadences, infinite without any."""
    _, means, count = binned(time, values)
    if not len(count):
        return np.inf
    # Bins with fewer cadences are noisier: the floor is that of full ones.
    return float(np.sqrt(np.average((means - means.mean()) ** 2, weights=count)))


def _per_bin(time):
    return max(round(_BIN / np.diff(time).min()), 1) if len(time) > 1 else 1


def binned(time, values):
    """Return times, means ``(..., m)`` and numbers of cadences of 6.5-h bins, half full or more."""
    size = _per_bin(time)
    number = ((time - time[0]) / np.diff(time).min() + 0.5).astype(int) // size
    count = np.bincount(number)
    full = count > size / 2
    sums = [np.bincount(number, one) for one in (time, *np.atleast_2d(values))]
    time, *means = np.array(sums)[:, full] / count[full]
    return time, np.reshape(means, (*np.shape(values)[:-1], -1)), count[full]


def _running_mean(time, values):
    """Return the mean of all values within 1.5 d."""
    first = np.searchsorted(time, time - _WINDOW / 2)
    last = np.searchsorted(time, time + _WINDOW / 2)
    total = np.concatenate([[0], np.cumsum(values)])
    return (total[last] - total[first]) / (last - first)


def slope(flux, truth):
    """Return the relative change of the flux over that of the truth."""
    change, level = np.polyfit(truth, flux, 1)
    return float(change / (change * truth.mean() + level) * truth.mean())


def _depth(time, flux, truth, transit):
    """Return the depth in units of the true one, with a line around each transit."""
    inside = transit < 1
    if not inside.any():
        return np.nan
    flux = flux / (truth / transit)
    flux = flux / np.median(flux)
    edges = np.flatnonzero(np.diff(inside, prepend=False, append=False))
    products = np.zeros(2)
    for start, end in edges.reshape(-1, 2) - (0, 1):
        half = time[end] - time[start]
        near = (time > time[start] - half) & (time < time[end] + half)
        line = np.vander(time[near] - time[start], 2)
        if near.sum() < 6:
            continue
        both = np.column_stack([flux[near], transit[near] - 1])
        rest = both - line @ np.linalg.lstsq(line, both, rcond=None)[0]
        products += rest[:, 1] @ rest
    return float(products[0] / products[1]) if products[1] > 0 else np.nan
