"""One effect, one law: what files hold, beside formulas that share no code with the package.

    python studies/laws.py docs

writes ``docs/data/laws.csv`` and the page ``docs/evaluation_laws.rst``. Each law simulates, writes
a target pixel file, reads it with astropy.io.fits, and measures without filters or clipping.
"""

import argparse
import tempfile
import tomllib
from functools import partial
from math import erf
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from astropy.coordinates import AltAz, EarthLocation, SkyCoord
from astropy.io import fits
from astropy.table import Table
from astropy.time import Time

from scope_models import BivariateGaussianPSF, Detector, Motion, Star, effects, simulate

LAWS = {}  # functions of a folder that return tables
TEXTS = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
PAGE, BLOCK = TEXTS.pop("page"), TEXTS.pop("block")
COLUMNS = ("x", "measured", "error", "predicted")
SIGMA = 0.8
NOISE = ("photon", "background", "read", "quantization")


def law(function, name=None):
    """Register a function of a folder: x, measured, error and predicted, as columns or rows."""

    def make(folder):
        found = function(folder)
        columns = found if isinstance(found, tuple) else np.transpose([*found])
        return Table([*np.broadcast_arrays(*columns)], names=COLUMNS)

    LAWS[name or function.__name__] = make
    return function


def plain(make=Detector.kepler, sigma=SIGMA, **changes):
    """Return a detector with a Gaussian PSF, pixels that respond alike, and no background."""
    psf = BivariateGaussianPSF(sigma_x=sigma, sigma_y=sigma)
    changes = {"background": 0.0, "well_depth": None, "psf": psf, "effects": ()} | changes
    return make(**changes).without_sensitivity()


def written(folder, stars, detector, motion, **options):
    """Return what a file holds: flux, background (e-/s), seconds, time, quality, all tables."""
    path = Path(folder) / "star.fits"
    simulate(stars, detector, motion, **({"seed": 1, "noise": False} | options)).write(path, True)
    with fits.open(path, memmap=False) as hdus:
        data, header = hdus[1].data, hdus[1].header
        tables = {h.name: h.data for h in hdus if isinstance(h, fits.BinTableHDU)}
        return SimpleNamespace(
            flux=data["FLUX"].astype(float), background=data["FLUX_BKG"].astype(float),
            seconds=header["INT_TIME"] * header["NREADOUT"], header=header,
            time=data["TIME"].astype(float), quality=data["QUALITY"], tables=tables,
        )  # fmt: skip


def ground(n):
    """Return a motion of a file from the ground, at rest."""
    return Motion.still(n, start=1400.6, cadence=70 / 86400, time_format="btjd")


def moments(images):
    """Return centroid (x, y) and mean of the two second moments of images, less 1/12."""
    total = images.sum(axis=(-2, -1))
    rows, columns = (np.arange(n) for n in images.shape[-2:])
    along = images.sum(axis=-2) / total[..., None], images.sum(axis=-1) / total[..., None]
    first = [part @ n for part, n in zip(along, (columns, rows), strict=True)]
    second = [part @ n**2 for part, n in zip(along, (columns, rows), strict=True)]
    widths = [b - a**2 - 1 / 12 for a, b in zip(first, second, strict=True)]
    return first[0], first[1], sum(widths) / 2


@law
def photon_transfer(folder):
    for seed, level in enumerate(np.geomspace(1, 3e4, 10)):
        detector = plain(shape=(40, 40), background=level)
        scene = Star(40.0), detector, Motion.still(30)
        file = written(folder, *scene, seed=seed, noise=NOISE)
        electrons = (file.flux + file.background) * file.seconds
        variances, reads = electrons.var(axis=0, ddof=1), 270
        noise = file.header["READNOIS"] ** 2 + file.header["GAIN"] ** 2 / 12
        charge = level * file.seconds
        yield charge, variances.mean(), variances.std() / 40, charge + reads * noise


@law
def brighter_fatter(folder):
    k, well = 0.02, 1.08e6
    part = np.diff([erf((e - 7.5) / SIGMA / 2**0.5) / 2 for e in range(16)])  # of a pixel
    squares = (part**2).sum() ** 2
    for mag in np.linspace(9.5, 13, 8):
        detector = plain(shape=(15, 15), n_frames=1)
        files = [written(folder, Star(mag), detector, Motion.still(1), effects=e)
                 for e in ((), effects.BrighterFatter(k, well))]  # fmt: skip
        thin, fat = (moments(file.flux[0])[2] for file in files)
        charge = files[0].flux.sum() * files[0].seconds
        yield charge * part.max() ** 2, fat - thin, 0, k / well * charge * squares


@law
def charge_transfer(folder):
    detector = plain(shape=(31, 15))
    star, motion, n = Star(12.0, 7, 10), Motion.still(1), 512
    before = moments(written(folder, star, detector, motion).flux[0])[1]
    for epsilon in np.geomspace(1e-6, 1e-3, 7):
        effect = effects.ChargeTransferInefficiency(epsilon, 0.0, rows=n)
        after = moments(written(folder, star, detector, motion, effects=effect).flux[0])[1]
        yield epsilon, after - before, 0, (n + 10) * epsilon / (1 - epsilon)


@law
def smear(folder):
    for mag in range(8, 15):
        scene = Star(mag, 5, 5), plain(shape=(41, 11)), Motion.still(1)
        file = written(folder, *scene, effects=effects.Smear(residual=1))
        column = file.flux[0, :, 5]
        part = file.header["READTIME"] / (1070 * file.header["INT_TIME"])
        light = column[:15].sum() - 15 * column[20:].mean()
        yield light, column[20:].mean(), 0, part * light


def jittered(folder, part):
    """Yield correlation time, and a moment of the image over the variance of the jitter."""
    n, rms = 3000, 0.1
    detector = plain(Detector.tess, 1.2, shape=(17, 17))
    motion = Motion.still(n, cadence=120 / 86400, time_format="btjd")
    for seed, time in enumerate(np.geomspace(6, 2000, 8)):
        scene = Star(9.0), detector, motion
        file = written(folder, *scene, seed=seed, effects=effects.Jitter(rms, time))
        x, y, width = moments(file.flux)
        moved = ((x - 8) ** 2 + (y - 8) ** 2).mean() / 2
        r = time / 120
        variance = 2 * r * (1 - r * (1 - np.exp(-1 / r)))
        error = np.sqrt((1 + 2 * r) / n) * variance  # of two axes, with their correlation
        values = (moved / rms**2, variance), ((width.mean() - 1.2**2) / rms**2, 1 - variance)
        yield time, values[part][0], error if part == 0 else 0, values[part][1]


for number, title in enumerate(("jitter_motion", "jitter_width")):
    law(partial(jittered, part=number), title)


@law
def scintillation(folder):
    n = 2000
    for seed, size in enumerate(np.geomspace(0.2, 10, 8)):
        detector = plain(Detector.ground, int_time=30.0, n_frames=1, shape=(13, 13))
        effect = effects.Scintillation(size, 2400.0, 1.5)
        file = written(folder, Star(12.0), detector, ground(n), seed=seed, effects=effect)
        flux = file.flux.sum(axis=(1, 2))
        noise = (1e-5 * 1.56**2 * size ** (-4 / 3) / 30 * 1.5**3 * np.exp(-2 * 2400 / 8000)) ** 0.5
        yield size, flux.std() / flux.mean(), noise / (2 * n) ** 0.5, noise


@law
def extinction(folder):
    place = EarthLocation.from_geodetic(-70.40, -24.63, 2635)
    star, k = SkyCoord("01h00m00s -24d38m00s"), 0.2
    motion = Motion.ground(60, cadence=300.0, start=1400.60)
    column = effects.airmass(motion.time, star, place)
    scene = Star(12.0), plain(Detector.ground, shape=(13, 13)), motion
    dim, bright = (written(folder, *scene, effects=e).flux.sum(axis=(1, 2))
                   for e in (effects.Extinction(k, column), ()))  # fmt: skip
    when = Time(motion.time + 2457000, format="jd", scale="tdb")
    h = star.transform_to(AltAz(obstime=when, location=place)).alt.deg
    predicted = k / np.sin(np.radians(h + 244 / (165 + 47 * h**1.1)))
    return h, -2.5 * np.log10(dim / bright), 0 * h, predicted


@law
def seeing(folder):
    column = np.linspace(1, 2.5, 9)
    detector = plain(Detector.ground, shape=(25, 25), sigma=1.2)
    effect = effects.Seeing(0.0, airmass=column)
    file = written(folder, Star(12.0, 12, 12), detector, ground(9), effects=effect)
    return column, np.sqrt(moments(file.flux)[2]) / 1.2, 0 * column, column**0.6


@law
def night_sky(folder):
    phase, k, dark = np.linspace(0, 150, 11), 0.172, 21.6
    x, x_m = (1 / np.sqrt(1 - 0.96 * np.sin(np.radians(z)) ** 2) for z in (30, 40))
    effect = effects.NightSky(x, 50.0, 60.0, phase, k, dark)
    detector = plain(Detector.ground, shape=(5, 5), background=10.0)
    moon = written(folder, Star(30.0), detector, ground(11), effects=effect)
    none = effects.NightSky(x, extinction=k)
    none = written(folder, Star(30.0), detector, ground(11), effects=none)
    ratio = moon.background[:, 2, 2] / none.background[:, 2, 2]
    zenith = 34.08 * np.exp(20.7233 - 0.92104 * dark)
    base = zenith * 10 ** (-0.4 * k * (x - 1)) * x
    light = 10 ** (-0.4 * (3.84 + 0.026 * phase + 4e-9 * phase**4))
    spread = 10**5.36 * (1.06 + np.cos(np.pi / 3) ** 2) + 10 ** (6.15 - 60 / 40)
    glow = spread * light * 10 ** (-0.4 * k * x_m) * (1 - 10 ** (-0.4 * k * x))
    return phase, -2.5 * np.log10(ratio), 0 * phase, -2.5 * np.log10(1 + glow / base)


@law
def focus(folder):
    detector, motion = plain(shape=(15, 15)), Motion.still(150)
    file = written(folder, Star(12.0), detector, motion, effects=effects.Focus(0.03, period=2.0))
    width = np.sqrt(moments(file.flux)[2]) / SIGMA
    predicted = 1 + 0.03 * np.sin(np.pi * file.time)
    return file.time - file.time[0], width, 0 * width, predicted


@law
def cosmic_rays(folder):
    for seed, rate in enumerate((1.0, 2.0, 5.0, 10.0, 20.0)):
        scene = Star(40.0), plain(shape=(40, 40)), Motion.still(60)
        file = written(folder, *scene, seed=seed, effects=effects.CosmicRays(rate))
        charge = file.flux * file.seconds
        cadences = charge.mean(axis=(1, 2))
        hits = rate * (27e-4) ** 2 * file.seconds
        yield rate, cadences.mean(), cadences.std(ddof=1) / 60**0.5, 2500 * hits


@law
def rejection(folder):
    detector = plain(Detector.tess, shape=(300, 300), read_noise=100.0)
    motion = Motion.still(2, cadence=120 / 86400, time_format="btjd")
    ray = effects.CosmicRays(100.0, 100.0, 15.0, 1e-9, 0.1, rejection=True)
    file = written(folder, Star(40.0), detector, motion, effects=ray)
    rays = file.tables["COSMICRAYS"]
    place = rays["CADENCE"], np.rint(rays["Y"]).astype(int), np.rint(rays["X"]).astype(int)
    pixel = np.ravel_multi_index(place, file.flux.shape)
    _, first, counts = np.unique(pixel, return_index=True, return_counts=True)
    alone = first[counts == 1]
    sent = rays["ELECTRONS"][alone] / 100
    left = file.flux[tuple(p[alone] for p in place)] * file.seconds / 100
    order = np.argsort(sent)
    ranks = order[np.searchsorted(sent[order], np.geomspace(0.51, 0.9 * sent.max(), 12))]
    reads = np.random.default_rng(1).standard_normal((400_000, 10))
    kept = []
    for charge in (0.0, *sent[ranks]):
        reads[:, 0] += charge
        kept.append((reads.sum(axis=1) - reads.max(axis=1) - reads.min(axis=1)).mean())
        reads[:, 0] -= charge
    return sent[ranks], left[ranks], 0 * ranks, np.array(kept[1:]) - kept[0]


@law
def rolling_bands(folder):
    effect = effects.RollingBands(0.3, duration=0.7, spacing=13.0, speed=25.0)
    scene = Star(40.0), plain(shape=(60, 5)), Motion.still(240)
    file = written(folder, *scene, seed=4, effects=effect)
    rows, k = np.arange(60), 100
    bands = np.zeros(60)
    for start, amplitude, phase in file.tables["ROLLINGBANDS"]:
        since = file.time[k] - start
        wave = np.sin(2 * np.pi * ((rows - 25 * since) / 13 + phase))
        bands += amplitude * np.exp(-(since**2) / 2 / 0.7**2) * wave
    return rows, file.flux[k, :, 2], 0 * rows, bands


@law
def dropouts(folder):
    effect = effects.SensitivityDropouts(0.02, 0.1, 0.6, 0.5)
    scene = Star(40.0), plain(shape=(11, 11), background=200.0), Motion.still(300)
    file = written(folder, *scene, seed=3, effects=effect)
    events = file.tables["SENSITIVITYDROPOUTS"]
    start, row, column, depth = events[np.argmax(events["DEPTH"] * (events["CADENCE"] < 200))]
    light = (file.flux + file.background)[:, row, column]
    since = file.time - file.time[start]
    lost = depth * (1 - 0.6 + 0.6 * np.exp(-since / 0.5)) * (since >= 0)
    near = np.abs(since) < 2
    return since[near], light[near] / light[0], 0 * since[near], 1 - lost[near]


@law
def aberration(folder):
    pointing = {"drift": 0.0, "heater": 0.0, "jitter": 0.0, "phase": 0.0}
    motion = Motion.kepler(4400, field=(5.0, 0.0), latitude=65.0, **pointing)[::50]
    file = written(folder, Star(12.0), plain(shape=(13, 13)), motion)
    angle = 2 * np.pi * (motion.time - motion.time[0]) / 365.25
    drift = 5 * 3600 / 3.98 * 29.8 / 299792.458 * np.cos(np.radians(65)) * np.cos(angle)
    x = moments(file.flux)[0]
    return motion.time - motion.time[0], x - x[0], 0 * x, drift - drift[0]


def write_page(docs, laws):
    """Write numbers and page."""
    rows, parts = [], [PAGE]
    for name, table in laws.items():
        rows += [(name, *(f"{value:.8g}" for value in row)) for row in table]
        texts, largest = TEXTS[name], np.abs(table["predicted"]).max()
        worst = np.abs(table["measured"] - table["predicted"]).max() / largest
        large = np.abs(table["predicted"]) > (table["predicted"].min() <= 0) * largest / 100
        ratio = table["measured"][large] / table["predicted"][large]
        ratio = f"{np.median(ratio):.4f} ({ratio.min():.4f} to {ratio.max():.4f})"
        error = table["error"].max() / largest
        parts.append(BLOCK.format(
            **texts, name=name, line="-" * len(texts["title"]), worst=worst, n=len(table),
            ratio=ratio, noise=f" (errors {error:.1g})" if error else "",
        ))  # fmt: skip
    Table(rows=rows, names=("law", *COLUMNS)).write(docs / "data" / "laws.csv", overwrite=True)
    (docs / "evaluation_laws.rst").write_text("\n".join(parts), encoding="utf-8")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("docs", type=Path)
    docs = parser.parse_args().docs
    with tempfile.TemporaryDirectory() as folder:
        write_page(docs, {name: make(folder) for name, make in LAWS.items()})


if __name__ == "__main__":
    main()
