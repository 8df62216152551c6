"""PLDCorrector and lightkurve's PLDCorrector on real target pixel files.

CDPP in both conventions of two K2 stars; what is left of a known sinusoid on one of them, which
varies with a period of 1.7 days by itself; depths of the transits of Kepler-62. lightkurve's best
is that of orders 1 to 3 in five apertures. Run it as

    OMP_NUM_THREADS=1 python studies/pld_real.py --data FOLDER
"""

import argparse
from pathlib import Path

import numpy as np
from _files import FILES
from celerite2 import GaussianProcess, terms
from paper._correctors import CONVENTIONS, quiet

from scope_models.correctors import PLDCorrector
from scope_models.photometry import cdpp

STARS = ("EPIC 211956421", "EPIC 211983544")
#: Period (d), mid-transit (BKJD), duration (h); see tests/correctors/test_pld.py.
PLANETS = {"b": (5.714932, 170.9189, 2.31), "d": (18.16406, 180.8117, 2.97)}
METHODS = CONVENTIONS[::-1]
VARIABLE, PERIODS, AMPLITUDE = "EPIC 211983544", (0.8, 1.2, 1.69, 2.5, 4.0), 0.02


def read(path, signal=None):
    """Read a file, with all pixels multiplied with a function of time."""
    from lightkurve import KeplerTargetPixelFile

    tpf = KeplerTargetPixelFile(str(path))
    if signal is None:
        return tpf
    hdus = tpf.hdu.__class__([hdu.copy() for hdu in tpf.hdu])
    factor = signal(np.nan_to_num(hdus[1].data["TIME"]))
    hdus[1].data["FLUX"][:] = hdus[1].data["FLUX"] * factor[:, None, None]
    return KeplerTargetPixelFile(hdus)


def correct_with_lightkurve(tpf, order, aperture):
    from lightkurve.correctors import PLDCorrector as LightkurveCorrector

    return LightkurveCorrector(tpf, aperture_mask=aperture).correct(pld_order=order)


def ways_of_lightkurve(tpf, aperture):
    """Return its light curves of orders 1 to 3, in five apertures."""
    threshold, everything = tpf.create_threshold_mask(3), np.ones_like(aperture)
    apertures = (None, tpf.pipeline_mask, aperture, threshold, everything)
    ways = [(order, mask) for mask in apertures for order in (1, 2, 3)]
    return [(way, correct_with_lightkurve(tpf, *way)) for way in ways]


def without_variability(lc, sigma, period):
    """Return flux without a Gaussian process of given parameters, and without 5-sigma outliers."""
    time, flux = lc.time.value, lc.flux.value / np.nanmedian(lc.flux.value)
    error = np.nanmedian(lc.flux_err.value) / np.nanmedian(lc.flux.value)
    good = np.isfinite(flux)
    for _ in range(5):
        process = GaussianProcess(terms.SHOTerm(sigma=sigma, rho=period, Q=0.5**0.5), mean=1.0)
        process.compute(time[good], yerr=error)
        ratio = flux / process.predict(flux[good], t=time)
        kept = np.abs(ratio - 1) < 5 * 1.4826 * np.nanmedian(np.abs(ratio - 1))
        if (kept == good).all():
            break
        good = kept
    return ratio[good]


def wave(lc, period):
    """Return sine and cosine amplitude of a period beside a slow polynomial."""
    good = np.isfinite(lc.flux.value)
    time, flux = lc.time.value[good], lc.flux.value[good]
    phase, slow = 2 * np.pi * time / period, (time - time.mean()) / np.ptp(time)
    columns = [np.sin(phase), np.cos(phase), *(slow**k for k in range(6))]
    return np.linalg.lstsq(np.stack(columns, axis=1), flux / np.median(flux), rcond=None)[0][:2]


def report_cdpp(folder):
    for star in STARS:
        tpf = read(folder / FILES[star])
        print(f"\n{star}: CDPP in ppm, lightkurve's and EVEREST's convention")
        for order in (2, 3):
            corrector = PLDCorrector(tpf)
            lc = corrector.correct(order)
            print(
                f"  ours, order {order}      "
                + "".join(f"{cdpp(lc, method=m):8.0f}" for m in METHODS)
            )
        found = [
            [cdpp(other, method=m) for m in METHODS]
            for _, other in ways_of_lightkurve(tpf, corrector.aperture_mask)
        ]
        print("  lightkurve's best  " + "".join(f"{v:8.0f}" for v in np.min(found, axis=0)))


def report_variability(folder):
    """Print what each corrector leaves of the star's own wave and of sinusoids put in."""
    path = folder / FILES[VARIABLE]
    corrector = PLDCorrector(read(path))
    lc, result = corrector.correct(), corrector.result
    aperture = corrector.aperture_mask
    others = ways_of_lightkurve(read(path), aperture)
    way, best = min(others, key=lambda pair: cdpp(pair[1]))
    print(f"\n{VARIABLE}: process of {100 * result.trend_sigma:.1f} %, {result.trend_period:.2f} d")
    for name, curve in (("raw", corrector.original_lc), ("ours", lc), ("lightkurve's best", best)):
        print(f"  {name:18s} amplitude at 1.69 d {1e2 * np.hypot(*wave(curve, 1.69)):.2f} %")
    parameters = result.trend_sigma, result.trend_period
    ours = without_variability(lc, *parameters)
    flat = [without_variability(curve, *parameters) for _, curve in others]
    print("  CDPP without the process, fitted to each light curve alike, both conventions:")
    print("    ours             " + "".join(f"{cdpp(ours, method=m):8.0f}" for m in METHODS))
    print("    lightkurve's best" + "".join(
        f"{min(cdpp(f, method=m) for f in flat):8.0f}" for m in METHODS))  # fmt: skip
    print(f"  kept of a sinusoid of {100 * AMPLITUDE:.0f} %: ours, lightkurve's best")
    for period in PERIODS:

        def signal(time, period=period):
            return 1 + AMPLITUDE * np.sin(2 * np.pi * time / period)

        tpf = read(path, signal)
        pairs = (
            (PLDCorrector(tpf, aperture).correct(), lc),
            (correct_with_lightkurve(tpf, *way), best),
        )
        kept = [np.hypot(*(wave(a, period) - wave(b, period))) / AMPLITUDE for a, b in pairs]
        print(f"    {period:4.2f} d " + "".join(f"{value:8.3f}" for value in kept))


def report_transits(folder):
    tpf = read(folder / FILES["Kepler-62"])
    time = tpf.time.value
    signals = {}
    for planet, (period, t0, duration) in PLANETS.items():
        distance = 24 * np.abs((time - t0 + period / 2) % period - period / 2)
        # a box, as cadences of 0.49 h see it
        signals[planet] = 1 - 1e-3 * np.clip((duration / 2 - distance) / 0.49 + 0.5, 0, 1)
    corrector = PLDCorrector(tpf)
    print("\nKepler-62, quarter 5: depth of a box in ppm, masked and not masked")
    found = {}
    masked = np.min(list(signals.values()), axis=0) < 1
    for mask in (masked, None):
        corrector.correct(transit_mask=mask)
        for planet, signal in signals.items():
            lc = corrector.corrected_lc
            depths = _local_depth(time, lc.flux.value, *PLANETS[planet])
            found.setdefault(planet, []).append(depths)
            if mask is not None:
                scale, error = corrector.fit_transit(signal)
                print(f"  planet {planet}: fitted jointly {1e3 * scale:.0f} +- {1e3 * error:.0f}")
    for planet, (with_mask, without) in found.items():
        print(f"  planet {planet}: {with_mask:.0f} masked, {without:.0f} not masked")


def _local_depth(time, flux, period, t0, duration):
    """Return the mean over transits of the drop against the hours around."""
    number = np.round((time - t0) / period)
    distance = 24 * np.abs(time - t0 - number * period)
    depths = []
    for k in np.unique(number):
        near = (number == k) & np.isfinite(flux)
        inside = near & (distance < duration / 2)
        around = near & (distance > duration / 2) & (distance < 1.5 * duration)
        if min(inside.sum(), around.sum()) > 2:
            depths.append(1 - flux[inside].mean() / flux[around].mean())
    return 1e6 * np.mean(depths)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    folder = Path("../shared/data")
    parser.add_argument("--data", type=Path, default=folder, metavar="FOLDER")
    folder = parser.parse_args().data
    with quiet():
        report_cdpp(folder)
        report_variability(folder)
        report_transits(folder)


if __name__ == "__main__":
    main()
