"""Random target pixel files with known pixels, made without the package's simulator.

``random_file(seed)`` draws a mission, a stamp, stars on it and beside it, and what real files hold:
pixels and cadences without data, wild POS_CORR, backgrounds that were subtracted twice, errors of
zero. The same seed gives the same file. ``checked(call, file)`` makes a call and compares what it
does with the rules that hold for every file.
"""

import re
import warnings
from dataclasses import dataclass

import numpy as np
from astropy.io import fits
from astropy.utils.exceptions import AstropyWarning
from lightkurve.utils import LightkurveWarning
from scipy.special import ndtr

from scope_models.io import TPFMetadata
from scope_models.io.tpf import make_tpf_hdulist

#: Exposure (s), days between cadences, zero point (e-/s of magnitude 0), first time, full pixel
#: (e-/s), background (e-/s per pixel), read noise (e-/s per pixel).
_MISSIONS = {
    "Kepler": (1625.3, 0.0204336, 1.1e10, 352.4, 1e4 * 20, 150.0, 0.9),
    "K2": (1625.3, 0.0204336, 1.1e10, 2144.1, 1e4 * 20, 166.0, 0.9),
    "TESS": (95.0, 0.00138889, 1.4e9, 1683.4, 1e5, 120.0, 5.0),
}
_SIGNALS = ("constant", "transits", "eclipses", "doubling", "pulsation")


@dataclass(frozen=True)
class RandomFile:
    """A random file, the facts that it was made of, and the star's relative flux."""

    seed: int
    hdus: fits.HDUList
    facts: dict
    signal: np.ndarray

    def tpf(self):
        """Return lightkurve's object."""
        import lightkurve

        kind = "Tess" if self.facts["mission"] == "TESS" else "Kepler"
        hdus = fits.HDUList([hdu.copy() for hdu in self.hdus])
        return getattr(lightkurve, f"{kind}TargetPixelFile")(hdus, quality_bitmask="none")

    def __repr__(self):
        return f"<RandomFile {self.seed}: {self.facts}>"


def random_file(seed, *, small=False):
    """
    Make a random file.

    Parameters
    ----------
    seed : int
        Seed of everything in it.
    small : bool, optional
        Whether the file has at most 300 cadences of at most 9 x 9 pixels.

    Returns
    -------
    RandomFile
        The file.
    """
    rng = np.random.default_rng([22, seed])
    mission = str(rng.choice(list(_MISSIONS)))
    _, step, _, first, *_ = _MISSIONS[mission]
    shape = _shape(rng, small)
    n = int(np.exp(rng.uniform(np.log(25), np.log(300 if small else 4000))))
    time = first + step * np.arange(n)
    if gap := rng.random() < 0.2:
        time[n // 2 :] += rng.choice([1.0, 30.0, 300.0])
    facts = {"mission": mission, "shape": (n, *shape), "gap": gap}
    positions, expected, signal = _light(rng, facts, time - time[0])
    flux, error = _pixels(rng, facts, expected)
    errors = str(rng.choice(["right", "zero", "nan", "some"], p=[0.7, 0.1, 0.1, 0.1]))
    invalid = {"right": 0, "some": 0.1}.get(errors, 1) > rng.random(n)
    if "times" in facts["missing"]:
        time[rng.random(n) < 0.03] = np.nan
    order = str(rng.choice(["increasing", "unsorted"], p=[0.95, 0.05]))
    offsets = str(rng.choice(["right", "nan", "zero"], p=[0.8, 0.1, 0.1]))
    columns = {"right": positions, "nan": np.full((n, 2), np.nan), "zero": np.zeros((n, 2))}
    aperture = np.median(np.nan_to_num(expected), axis=0)
    aperture = aperture > 0.3 * aperture.max() if rng.random() < 0.8 else None
    magnitude = round(facts["magnitude"], 2)
    hdus = make_tpf_hdulist(
        metadata=TPFMetadata(mission=mission, target_id=seed + 1, magnitude=magnitude),
        time=time, flux=flux, flux_err=error, flux_bkg=_MISSIONS[mission][5], flux_bkg_err=0.1,
        pos_corr1=columns[offsets][:, 0], pos_corr2=columns[offsets][:, 1], aperture=aperture,
    )  # fmt: skip
    table = hdus[1].data  # what no writer writes
    table["FLUX_ERR"][invalid] = np.nan if errors == "nan" else 0.0
    table["FLUX_ERR"][np.isnan(flux)] = np.nan
    if order == "unsorted":
        table["TIME"] = rng.permutation(time)
    facts |= {"errors": errors, "pos_corr": offsets, "times": order}
    return RandomFile(seed, hdus, facts, signal)


def _light(rng, facts, time):
    """Return POS_CORR, expected pixels, and the star's relative flux; add to the facts."""
    _, _, zero, _, full, *_ = _MISSIONS[facts["mission"]]
    n, ny, nx = facts["shape"]
    x, y = _motion(rng, n)
    place = str(rng.choice(["inside", "edge", "off"], p=[0.7, 0.15, 0.15]))
    x_0, y_0 = _place(rng, nx, place), _place(rng, ny, "inside" if place == "off" else place)
    magnitude, signal = rng.uniform(8, 18), str(rng.choice(_SIGNALS))
    relative = _signal(rng, signal, time)
    light = zero * 10 ** (-0.4 * magnitude) * relative
    wild = str(rng.choice(["none", "number", "star"], p=[0.7, 0.15, 0.15]))
    away = rng.random(n) < rng.choice([1 / n, 0.01])
    jump = np.where(away[:, None] & (wild != "none"), rng.uniform(100, 1000, (n, 2)), 0.0)
    at_x, at_y = x + jump[:, 0] * (wild == "star"), y + jump[:, 1] * (wild == "star")
    sigma = rng.uniform(0.4, 1.0)
    expected = light[:, None, None] * _images(x_0 + at_x, y_0 + at_y, sigma, ny, nx)
    n_neighbors = int(rng.integers(0, 11)) if rng.random() < 0.5 else 0
    for _ in range(n_neighbors):
        other = zero * 10 ** (-0.4 * (magnitude + rng.uniform(-1, 6)))
        u, v = rng.uniform(-2, nx + 1), rng.uniform(-2, ny + 1)
        expected += other * _images(u + at_x, v + at_y, sigma, ny, nx)
    expected *= 1 + 0.01 * rng.standard_normal((ny, nx))
    facts |= {"magnitude": magnitude, "signal": signal, "star": place, "wild": wild}
    facts["neighbors"] = n_neighbors
    return np.column_stack([x, y]) + jump, _bled(expected, full), relative


def _pixels(rng, facts, expected):
    """Return flux and errors of pixels, some of them without data; add to the facts."""
    exposure, *_, sky, read = _MISSIONS[facts["mission"]]
    variance = (np.maximum(expected, 0) + sky) / exposure + read**2
    flux = expected + np.sqrt(variance) * rng.standard_normal(expected.shape)
    taken = str(rng.choice(["right", "twice", "star"], p=[0.75, 0.15, 0.1]))
    flux -= {"right": 0.0, "twice": sky, "star": 0.2 * np.median(expected)}[taken]
    flaws = [str(name) for name in ("pixels", "cadences", "times") if rng.random() < 0.25]
    _damage(rng, flux, flaws)
    facts |= {"background": taken, "missing": flaws}
    return flux, np.sqrt(variance)


def _damage(rng, flux, flaws):
    """Take data from pixels and cadences, in place."""
    if "pixels" in flaws:
        flux[:, rng.random(flux.shape[1:]) < 0.1] = np.nan
        flux[rng.random(flux.shape) < 1e-3] = np.nan
    if "cadences" in flaws:
        flux[rng.random(len(flux)) < rng.uniform(0, 0.2)] = np.nan


def _shape(rng, small):
    """Return rows and columns of the stamp: square, strips, and single rows and columns."""
    most = (9, 9) if small else (25, 20)
    kind = rng.choice(["any", "strip", "little"], p=[0.7, 0.15, 0.15])
    if kind == "strip":
        shape = (1, int(rng.integers(5, most[1] + 1)))
        return shape[:: rng.choice([1, -1])]
    if kind == "little":
        return tuple(int(k) for k in rng.integers(2, 5, 2))
    return tuple(int(rng.integers(4, k + 1)) for k in most)


def _place(rng, n, kind):
    """Return a coordinate of the star: in the middle, at the edge or beyond it."""
    if kind == "inside":
        return (n - 1) / 2 + rng.uniform(-0.25, 0.25) * min(n, 8)
    return -0.4 if kind == "edge" else -rng.uniform(0.6, 2.5)


def _motion(rng, n):
    """Return offsets in pixels: a roll of 12 cadences, a drift, jitter, or next to nothing."""
    t = np.arange(n)
    size = rng.choice([0.0, 0.3, 1.5])
    x = size * ((t % 12) / 12 - 0.5) + 0.2 * size * np.sin(2 * np.pi * t / n)
    return x + rng.normal(0, 0.005, n), 0.5 * x + rng.normal(0, 0.005, n)


def _signal(rng, name, t):
    """Return the relative flux at times in days."""
    period = rng.uniform(0.05, 0.5) * max(t[-1], 0.1)
    phase = (t / period + rng.random()) % 1
    if name in ("transits", "eclipses"):
        return 1 - (0.01 if name == "transits" else 0.9) * (phase < 0.08)
    return {
        "constant": np.ones(len(t)),
        "doubling": 1 + t / max(t[-1], 0.1),
        "pulsation": 1 + 0.5 * np.sin(2 * np.pi * phase) + 0.15 * np.sin(4 * np.pi * phase),
    }[name]


def _images(x, y, sigma, ny, nx):
    """Return integrals of a normal density over the pixels, ``(n, ny, nx)``."""

    def along(center, size):
        edges = (np.arange(size + 1) - 0.5 - center[:, None]) / sigma
        return np.diff(ndtr(edges), axis=1)

    return along(y, ny)[:, :, None] * along(x, nx)[:, None, :]


def _bled(flux, full):
    """Return flux whose full pixels have given their charge to their neighbors in the column."""
    flux = flux.copy()
    for _ in range(3 * flux.shape[1]):
        more = np.maximum(flux - full, 0)
        if not more.any():
            break
        flux -= more
        flux[:, 1:] += 0.5 * more[:, :-1]
        flux[:, :-1] += 0.5 * more[:, 1:]
    return np.minimum(flux, full)


def checked(call, file):
    """
    Make a call, and return its result, or None if it refuses the file as it should.

    Warnings of astropy's and lightkurve's kinds may be given, and those of this package are of
    astropy's; NumPy's may not. What is raised is a TypeError or ValueError that names an argument
    or a file; ``LinAlgError``, which is a ValueError, is none.

    Parameters
    ----------
    call : callable
        What to do, without arguments.
    file : RandomFile
        The file, for messages.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for category in (AstropyWarning, LightkurveWarning):
            warnings.simplefilter("ignore", category)
        try:
            return call()
        except (TypeError, ValueError) as error:
            named = re.search(r"`\w+`|\.fits", str(error))
            if isinstance(error, np.linalg.LinAlgError) or not named:
                raise AssertionError(f"{file}: {error!r}") from error
            return None
