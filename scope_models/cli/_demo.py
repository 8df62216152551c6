"""``scope-models demo``: a variable star with a planet at twice K2's motion."""

from pathlib import Path

import scope_models as sm
from scope_models.cli import _batch

__all__ = ["add_parser", "run"]

_NAMES = "pixels.fits", "light-curve.fits", "summary.png"
_MAGNITUDE = 12.0


def add_parser(commands):
    text = "simulate and correct a star, without any input"
    _, add = _batch.add_command(commands, run, "demo --output-dir demo", text)
    text = "where the files go; it is made if need be (default: scope-models-demo)"
    add("--output-dir", text, default="scope-models-demo", metavar="FOLDER")
    add("--overwrite", "replace files that exist", action="store_true")
    add("--seed", "seed of the noise (default: 1)", type=int, default=1)


def run(arguments):
    """Simulate a spotted star of magnitude 12 with a planet at twice the motion of K2.

    Writes its target pixel file, its corrected light curve and a figure, and prints its noise about
    the true signal. Needs no file and no network.
    """
    import numpy as np
    from tqdm import tqdm

    from scope_models.io._opening import atomic_path, check_output

    folder = Path(arguments.output_dir)
    paths = [folder / name for name in _NAMES]
    folder.mkdir(parents=True, exist_ok=True)
    for path in paths:
        check_output(path, overwrite=arguments.overwrite)
    with tqdm(total=3, leave=False, disable=None) as bar:
        bar.set_description("simulating")
        motion = 2 * sm.Motion.k2_roll()
        observation = _observe(motion, arguments.seed)
        still = _observe(motion * 0, arguments.seed)
        observation.write(paths[0], overwrite=arguments.overwrite)
        bar.update()
        bar.set_description("correcting")
        corrector = sm.correctors.detrend_file(*paths[:2], overwrite=arguments.overwrite)
        corrected, aperture = corrector.corrected_lc, corrector.aperture_mask
        bar.update()
        bar.set_description("drawing")
        title = f"A star of magnitude {_MAGNITUDE:g} with spots and a planet, at twice K2's motion"
        axes = observation.plot(corrected, aperture, title=title)
        with atomic_path(paths[2], overwrite=arguments.overwrite) as temporary:
            axes["image"].figure.savefig(temporary, dpi=110)
        bar.update()
    curves = {"raw": corrector.original_lc, "corrected": corrected}
    curves["at rest"] = still.to_lightcurve(aperture)
    for name, lc in curves.items():
        seen = np.isin(observation.cadenceno, lc.cadenceno)
        curves[name] = lc / observation.truth.relative_flux[0, seen]
    print("6.5-hour CDPP of flux over truth (ppm, lightkurve's convention)")
    for name, lc in curves.items():
        print(f"{name:12s}{sm.photometry.cdpp(lc):8.1f}")
    others = [f"{sm.photometry.cdpp(lc, method='everest'):.1f}" for lc in curves.values()]
    print(f"EVEREST's convention gives {', '.join(others)}", "", "Written:", sep="\n")
    for path in paths:
        print(f"  {path}")


def _observe(motion, seed):
    detector = sm.Detector.k2()
    planet = sm.TransitModel.from_depth_duration(
        0.001, 0.25, 4.1, motion.time[0] + 2.0, exposure_time=detector.cadence_days
    )
    signal = planet * sm.models.sinusoidal_signal(0.002, period=9.0)
    return sm.simulate(sm.Star(_MAGNITUDE, signal=signal), detector, motion, seed=seed)
