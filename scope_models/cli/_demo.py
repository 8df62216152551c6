"""``scope-models demo``: a star on K2's roll, its files, its figure and its noise."""

from pathlib import Path

import scope_models as sm
from scope_models.cli import _batch

__all__ = ["add_parser", "run"]

_PIXELS, _LIGHT_CURVE, _FIGURE = "pixels.fits", "light-curve.fits", "summary.png"
_CONVENTIONS = ("lightkurve", "everest")
_MAGNITUDE = 12.0


def add_parser(commands):
    """Add the command to the parser of the command line."""
    parser = _batch.add_command(
        commands,
        "demo",
        help="simulate and de-trend a star, without any input",
        description="Simulate a star of magnitude 12 on the roll of K2, write its target pixel "
        "file, its light curve and a figure, and print its noise. Needs no file and no network.",
        example="demo --output-dir demo",
    )
    parser.add_argument(
        "--output-dir",
        default="scope-models-demo",
        metavar="FOLDER",
        help="where the files go; it is made if need be (default: scope-models-demo)",
    )
    parser.add_argument("--overwrite", action="store_true", help="replace files that exist")
    parser.add_argument("--seed", type=int, default=1, help="seed of the noise (default: 1)")
    parser.set_defaults(run=run)


def run(arguments):
    """Simulate and de-trend the star, write the files and print the table."""
    from tqdm import tqdm

    from scope_models.correctors._files import make_lightcurve_hdulist
    from scope_models.io._atomic import atomic_path, check_output

    folder = Path(arguments.output_dir)
    paths = [folder / name for name in (_PIXELS, _LIGHT_CURVE, _FIGURE)]
    folder.mkdir(parents=True, exist_ok=True)
    for path in paths:
        check_output(path, overwrite=arguments.overwrite)
    with tqdm(total=4, leave=False, disable=None) as bar:
        bar.set_description("simulating")
        motion = sm.Motion.k2_roll()
        observation = _observe(motion, arguments.seed)
        still = _observe(sm.Motion.still(len(motion)), arguments.seed)
        aperture = sm.photometry.threshold_aperture(observation.model())
        bar.update()
        bar.set_description("de-trending")
        tpf = observation.to_tpf()
        raw = tpf.to_lightcurve(aperture_mask=aperture)
        corrector = sm.correctors.PLDCorrector(tpf, aperture_mask=aperture)
        corrected = corrector.correct()
        bar.update()
        bar.set_description("writing")
        observation.write(paths[0], overwrite=arguments.overwrite)
        hdus = make_lightcurve_hdulist(corrector)
        sm.io.tpf.write_hdulist(hdus, paths[1], overwrite=arguments.overwrite)
        bar.update()
        bar.set_description("drawing")
        curves = {"raw": raw, "de-trended": corrected}
        curves["without motion"] = still.to_lightcurve(aperture)
        noise = {
            name: [sm.photometry.cdpp(lc, method=way) for way in _CONVENTIONS]
            for name, lc in curves.items()
        }
        figure = _draw(observation, aperture, curves, noise)
        with atomic_path(paths[2], overwrite=arguments.overwrite) as temporary:
            figure.savefig(temporary, dpi=110)
        bar.update()
    print(_table(noise))
    print("\n".join(["", "Written:", *(f"  {path}" for path in paths)]))


def _observe(motion, seed):
    """Return the demonstration's star on a motion."""
    return sm.simulate(sm.Star(_MAGNITUDE), sm.Detector.k2(), motion, seed=seed)


def _draw(observation, aperture, curves, noise):
    """Return the figure: image, motion and light curves."""
    import numpy as np

    raw, corrected = curves["raw"], curves["de-trended"]
    used = np.isin(observation.cadenceno, raw.cadenceno)
    axes = sm.plotting.plot_summary(
        raw.time.value,
        observation.flux[used][0],
        raw.flux.value,
        observation.truth.x[0, used],
        observation.truth.y[0, used],
        corrected=corrected.flux.value,
        aperture=aperture,
        cdpp=noise["raw"][0],
        corrected_cdpp=noise["de-trended"][0],
        noise=float(np.nanmedian(raw.flux_err.value / raw.flux.value)),
        time_label="Time (BKJD)",
        title=f"A star of magnitude {_MAGNITUDE:g} on the roll of K2",
    )
    return axes["image"].figure


def _table(noise):
    """Return the noise of each light curve in both conventions as lines of text."""
    lines = [f"{'6.5-hour CDPP (ppm)':20s}" + "".join(f"{way:>12s}" for way in _CONVENTIONS)]
    lines += [f"{name:20s}" + "".join(f"{v:12.1f}" for v in row) for name, row in noise.items()]
    return "\n".join(lines)
