"""Values that the first version gave; ``tests/test_values.py`` compares today's with them.

Run as ``python tests/values/record.py [CASE ...]`` to record cases again, all by default. A record
is replaced only if the change is intended; the commit gives the reason.
"""

import json
import sys
import tempfile
import warnings
from pathlib import Path

import numpy as np

RECORD = Path(__file__).with_name("values.json")
NOISE = ("photon", "background", "read", "quantization")
# They name a day or a version, or follow from all other cards.
_VOLATILE = {"DATE", "CHECKSUM", "DATASUM", "CREATOR", "PROCVER", "COMMENT", "HISTORY", ""}


def digest(array):
    """Return six sums over an array and their scales, which any change alters."""
    values = np.nan_to_num(np.asarray(array, dtype=float), nan=-1.0).ravel()
    phases = np.arange(1, 7)[:, np.newaxis] * np.sqrt(2.0) * np.arange(values.size)
    return {"sums": (np.cos(phases) @ values).tolist(), "scale": float(np.abs(values).sum())}


def cubes(observation):
    """Return digests of the pixels of an observation."""
    names = ("flux", "flux_err", "flux_bkg", "raw_cnts")
    return {name: digest(getattr(observation, name)) for name in names}


def two_stars():
    """Return the arguments of a simulation of two variable stars with five times K2's motion."""
    from scope_models import Detector, Motion, Star

    motion = 5 * Motion.k2_roll(150, seed=4)
    signal = 1 + 0.1 * np.sin(np.arange(150) / 7)
    stars = [Star(11.5, 5.2, 4.9, signal=signal), Star(13.0, 7.4, 3.1)]
    return stars, Detector.k2(), motion


def integrals():
    """Integrate models over pixels, in closed form and by quadrature."""
    from photutils.psf import MoffatPSF

    from scope_models import BivariateGaussianPSF, SensitivityPolynomial, integrate_pixels
    from scope_models.models import GaussHermitePSF

    response = SensitivityPolynomial((1, 0.01, -0.3), (1, 0, -0.1))
    gaussian = BivariateGaussianPSF(2.0, 4.3, 3.9, 0.6, 0.4, -0.35)
    models = {
        "gaussian": gaussian * response,
        "sum": (gaussian + BivariateGaussianPSF(1.0, 4.0, 4.0, 1.2, 1.3)) * response,
        "moffat": MoffatPSF(flux=2.0, x_0=4.2, y_0=3.7, alpha=1.1, beta=3.0) * response,
        "hermite": GaussHermitePSF(2.0, 4.3, 3.9, 0.7, 0.6, c_2_0=0.1, c_1_1=-0.05) * response,
    }
    return {name: digest(integrate_pixels(model, (9, 10))) for name, model in models.items()}


def rendered():
    """Render noise-free pixels of a long series, which are interpolated, and of tilted PSFs."""
    from scope_models import PRF, BivariateGaussianPSF, Motion, SensitivityPolynomial

    motion = 3 * Motion.k2_roll(600, seed=8)
    values = {}
    for name, rho in (("round", 0.0), ("tilted", 0.4)):
        prf = PRF(BivariateGaussianPSF(rho=rho) * SensitivityPolynomial())
        cube = prf.render((9, 9), flux=1e5, x_0=4.1 + motion.x, y_0=3.8 + motion.y)
        values[name] = digest(cube)
    return values


def noise_free():
    """Simulate without noise."""
    from scope_models import simulate

    observation = simulate(*two_stars(), seed=5, noise=False)
    return cubes(observation) | {
        "model": digest(observation.model()),
        "aperture": digest(observation.aperture),
        "share": digest(observation.target_share()),
        "x": digest(observation.truth.x),
        "interpixel": digest(observation.truth.interpixel),
    }


def exposures():
    """Average three exposures within each cadence."""
    from scope_models import simulate

    return cubes(simulate(*two_stars(), seed=5, noise=False, n_sub=3))


def saturated():
    """Simulate a star that fills its wells."""
    from scope_models import Star, simulate

    stars, detector, motion = two_stars()
    return cubes(simulate([Star(9.5), *stars], detector, motion, seed=6))


def noise():
    """Simulate with each noise term, and with all."""
    from scope_models import simulate

    scene = two_stars()
    return {
        f"{term} {seed} {name}": value
        for seed in (1, 2)
        for term in (*NOISE, "all")
        for name, value in cubes(
            simulate(*scene, seed=seed, noise=NOISE if term == "all" else term)
        ).items()
    }


def detectors():
    """Simulate with every preset."""
    from scope_models import Detector, Motion, Star, simulate

    values = {}
    for name in ("kepler", "k2", "k2_calibrated", "tess"):
        observation = simulate(Star(11.0), getattr(Detector, name)(), Motion.k2_roll(40), seed=3)
        values |= {f"{name} {cube}": value for cube, value in cubes(observation).items()}
    return values


def headers():
    """Write files of each mission and read all cards."""
    from astropy.io import fits

    from scope_models import Detector, Motion, Star, simulate

    values = {}
    for name in ("kepler", "k2", "tess"):
        detector = getattr(Detector, name)()
        time_format = "btjd" if name == "tess" else "bkjd"
        motion = Motion.still(6, cadence=detector.cadence_days, time_format=time_format)
        observation = simulate([Star(11.0), Star(13.0, 8, 8)], detector, motion, seed=3)
        with tempfile.TemporaryDirectory() as folder:
            path = observation.write(Path(folder) / "star.fits", metadata={"target_id": 1234})
            with fits.open(path, memmap=False) as hdus:
                for hdu in hdus[:3]:
                    for card in hdu.header.cards:
                        if card.keyword not in _VOLATILE:
                            value = card.value
                            blank = isinstance(value, fits.card.Undefined)
                            key = f"{name} {hdu.name} {card.keyword}"
                            values[key] = None if blank else value
    return values


def motions():
    """Generate motions."""
    from scope_models import Motion

    values = {}
    for seed in (1, 10):
        motion = Motion.k2_roll(500, seed=seed)
        for name in ("time", "x", "y", "quality"):
            values[f"{seed} {name}"] = digest(getattr(motion, name))
    return values


CASES = {
    function.__name__: function
    for function in (
        integrals,
        rendered,
        noise_free,
        exposures,
        saturated,
        noise,
        detectors,
        headers,
        motions,
    )
}


def main(names):
    """Record the cases of some names."""
    record = json.loads(RECORD.read_text(encoding="utf-8")) if RECORD.exists() else {}
    for name in names or CASES:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            record[name] = CASES[name]()
    text = json.dumps({name: record[name] for name in CASES}, indent=0)
    RECORD.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
