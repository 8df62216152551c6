"""The command line, and its commands ``demo`` and ``simulate``."""

import argparse
import importlib
import io
import signal
import sys
import warnings
from functools import partial
from pathlib import Path

import scope_models as sm
from scope_models._threads import one_thread
from scope_models._version import __version__
from scope_models.cli import _batch

__all__ = ["main"]

_TERMINATED = "by SIGTERM"
# The options that go together with --table.
_OF_TABLES = (
    "table", "output_dir", "overwrite", "workers", "scheduler", "detector", "motion", "cadences",
    "seed",
)  # fmt: skip
_RUNS = ("campaign", "quarter", "sector", "channel", "camera", "ccd")


class _Parser(argparse.ArgumentParser):
    """An argument parser whose errors are one line."""

    def error(self, message):
        self.exit(2, f"{self.prog}: error: {message} (see {self.prog} --help)\n")


def main(argv=None):
    """Run the command line.

    Parameters
    ----------
    argv : sequence of str, optional
        The arguments; those of the process by default.

    Returns
    -------
    int
        0, 1 if some of many files failed, or 2 after an error.

    Examples
    --------
    >>> from scope_models.cli import main
    >>> main(["simulate", "--mag", "12", "--psf", "-1", "1", "0", "--output", "star.fits"])
    2
    """
    try:
        given = _batch.with_config(sys.argv[1:] if argv is None else list(argv))
        arguments = _make_parser().parse_args(given)
        if argv is None:  # as a program: incomplete files are removed before the end
            signal.signal(signal.SIGTERM, _terminate)
            if isinstance(sys.stdout, io.TextIOWrapper):  # names of files can be printed
                sys.stdout.reconfigure(errors="backslashreplace")
        # Its logger takes over warnings when it is imported: before ours, which print one line.
        importlib.import_module("astropy")
        with warnings.catch_warnings(), one_thread:
            warnings.showwarning = lambda message, *_: _write("warning", message)
            # lightkurve warns at import that an optional part of it is absent
            warnings.filterwarnings("ignore", ".*tpfmodel submodule is not available", UserWarning)
            return arguments.run(arguments) or 0
    except (ImportError, MemoryError, OSError, TypeError, ValueError) as error:
        _write("error", error)
        return 2
    except KeyboardInterrupt as error:
        terminated = error.args == (_TERMINATED,)
        _write("error", "terminated" if terminated else "interrupted")
        return 143 if terminated else 130


def _terminate(*_):
    raise KeyboardInterrupt(_TERMINATED)


def _make_parser():
    parser = _Parser(
        prog="scope-models",
        description="Simulate what a space telescope records of a moving star.",
        epilog="`scope-models COMMAND --help` describes a command. example: scope-models demo",
    )
    parser.add_argument("--version", action="version", version=f"%(prog)s {__version__}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    _add_demo(commands)
    _add_simulate(commands)
    _batch.add_parser(commands)
    return parser


def _write(kind, message):
    """Write a message as one line to the standard error."""
    from scope_models._checks import one_line  # with astropy, which a --help does not need

    if isinstance(message, OSError) and message.strerror and message.filename is not None:
        message = f"{message.filename}: {message.strerror}"
    text = one_line(message) or type(message).__name__
    text = text.replace("pass overwrite=True to replace it", "--overwrite replaces it")
    print(f"scope-models: {kind}: {text}", file=sys.stderr)


def _add_demo(commands):
    text = "simulate and correct a star, without any input"
    _, add = _batch.add_command(commands, _demo, "demo --output-dir demo", text)
    text = "where the files go; it is made if need be (default: scope-models-demo)"
    add("--output-dir", text, default="scope-models-demo", metavar="FOLDER")
    add("--overwrite", "replace files that exist", action="store_true")
    add("--seed", "seed of the noise (default: 1)", type=int, default=1)


def _add_simulate(commands):
    text = "write a target pixel file of a star"
    example = "simulate --mag 12 --period 4.2 --depth 0.001 --output star.fits"
    parser, add = _batch.add_command(commands, _simulate, example, text)
    add("--output", "the file to write", metavar="FILE")
    text = (
        "simulate each row of a table that astropy reads (columns mag and, if wanted, name, x_0, "
        "y_0, period, t0, depth, duration) into --output-dir, with --detector, --motion, "
        "--cadences and --seed for all"
    )
    add("--table", text, metavar="TABLE")
    _batch.add_options(parser)
    add("--seed", "makes the result reproducible", type=int)
    add("--target-id", "KEPLERID or TICID", type=int, default=1, metavar="N")
    add("--name", "name of the target in the file")
    _add_motion(parser.add_argument_group("motion"))
    _add_star(parser.add_argument_group("star"))
    _add_sky(parser.add_argument_group("sky"))
    _add_detector(parser.add_argument_group("detector"))


def _add_motion(group):
    add = _batch.adder(group)
    text = (
        "target pixel or light-curve file of Kepler, K2 or TESS whose POS_CORR columns the star "
        "follows (default: a generated K2 roll for --detector k2, the tracking of a telescope for "
        "ground; for the others the star rests)"
    )
    add("--motion", text, metavar="FILE")
    add("--scale", "factor on the motion (default: 1)", type=float, default=1.0)
    add("--cadences", "only the first N cadences", type=int, metavar="N")
    text = "exposures within a cadence to average the motion over (default: 1)"
    add("--n-sub", text, type=int, default=1, metavar="N")


def _add_star(group):
    add = _batch.adder(group)
    add("--mag", "magnitude, Kp or T; needed without --table and --catalog", type=float)
    text = "column and row, pixels from 0 (default: the middle)"
    add("--position", text, type=float, nargs=2, metavar=("X", "Y"))
    text = "widths, in pixels, and correlation of a Gaussian PSF (default: the detector's)"
    add("--psf", text, type=float, nargs=3, metavar=("SIGMA_X", "SIGMA_Y", "RHO"))
    _batch.add_planet(group)
    several = {"type": float, "nargs": 3, "action": "append", "default": []}
    text = "another star on the stamp; may be repeated"
    add("--neighbor", text, metavar=("MAG", "X", "Y"), **several)


def _add_sky(group):
    add, degrees = _batch.adder(group), {"type": float, "metavar": "DEG"}
    add("--ra", "right ascension of the target", **degrees)
    add("--dec", "declination of the target", **degrees)
    text = "position angle of growing rows from north to east (default: 0)"
    add("--orientation", text, **degrees)
    add("--magnitude-limit", "leave out fainter stars of --catalog", type=float, metavar="MAG")
    text = "draw stars down to this magnitude by the mean counts in this direction"
    add("--background-stars", text, type=float, metavar="MAG")
    text = (
        "a table that astropy reads, as of Gaia, with the columns ra, dec and a magnitude, and if "
        "wanted pmra, pmdec and ref_epoch: its stars are target and neighbors; needs --ra and --dec"
    )
    add("--catalog", text, metavar="FILE")
    for name in _RUNS:
        add(f"--{name}", f"{name}, for the file's headers", type=int, metavar="N")


def _add_detector(group):
    add, presets = _batch.adder(group), "kepler, k2, k2_calibrated, tess or ground"
    text = f"the preset, {presets}, or a TOML file of your own detector (default: k2)"
    add("--detector", text, default="k2", metavar="NAME")
    add("--shape", "rows and columns of the stamp", type=int, nargs=2, metavar=("NY", "NX"))
    text = "pixels that all respond alike, and evenly within: the control"
    add("--no-sensitivity", text, action="store_true")
    text = "with the effects of the detector's mission: cosmic rays, smear and others"
    add("--mission-effects", text, action="store_true")
    add = _batch.adder(group.add_mutually_exclusive_group())
    text = "only these noise terms, of photon, background, read and quantization (default: the "
    add("--noise", f"{text}first three)", nargs="+", metavar="TERM")
    add("--no-noise", "expected counts without noise", action="store_true")


def _simulate(arguments):
    """Simulate the pixels of a star along a spacecraft's motion.

    Writes them with the truth to a target pixel file that lightkurve opens.
    """
    from scope_models.batch.files import named_detector
    from scope_models.io._opening import check_output

    _batch.check_number(arguments, "cadences")
    if arguments.table is not None:
        return _run_table(arguments)
    if arguments.output is None or (arguments.mag is None and arguments.catalog is None):
        needed = "--output and --mag or --catalog are needed, or --table and --output-dir"
        arguments.parser.error(needed)
    if arguments.output_dir is not None:
        raise ValueError("--output-dir needs --table")
    _batch.refuse_options_of_runs(arguments)
    inputs = [*filter(None, (arguments.motion, arguments.detector, arguments.catalog))]
    check_output(arguments.output, overwrite=arguments.overwrite, inputs=inputs)
    detector = named_detector(arguments.detector, "--detector")
    if arguments.shape is not None:
        detector = detector.replace(shape=tuple(arguments.shape))
    if arguments.no_sensitivity:
        detector = detector.without_sensitivity()
    motion = _make_motion(arguments, detector)
    scene = _make_scene(arguments, detector, motion)
    sm.simulate(scene).write(arguments.output, overwrite=arguments.overwrite)
    rows, columns = detector.shape
    stars = f", {len(scene.stars)} stars" if arguments.catalog else ""
    print(f"{arguments.output}: {len(motion)} cadences of {rows} x {columns} pixels{stars}")
    return 0


def _run_table(arguments):
    from scope_models.io._opening import read_table

    if arguments.output_dir is None:
        raise ValueError("--table needs an --output-dir")
    for name, value in vars(arguments).items():
        if name not in _OF_TABLES and value != arguments.parser.get_default(name):
            raise ValueError(f"--{name.replace('_', '-')} cannot be combined with --table")
    table = read_table(arguments.table)
    options = _batch.given(arguments, "detector", "motion", "cadences", "seed")
    return _batch.run(sm.batch.simulate_table, arguments, table, **options)


def _make_motion(arguments, detector):
    from scope_models.batch.files import default_motion

    number = arguments.cadences
    if arguments.motion is None:
        if arguments.scale != 1 and detector.mission not in {"K2", "Ground"}:
            raise ValueError(f"--scale needs --motion FILE with --detector {arguments.detector}")
        return arguments.scale * default_motion(detector, number or 1000)
    motion = sm.Motion.from_file(arguments.motion)
    if number is not None and number > (n := len(motion)):
        raise ValueError(f"--cadences must be at most {n}, the motion's, got {number}")
    return arguments.scale * motion[:number]


def _make_scene(arguments, detector, motion):
    from scope_models.batch.files import planet_model

    given = partial(_batch.given, arguments)
    options = given("seed", "n_sub", "target_id", "orientation") | {"metadata": given(*_RUNS)}
    options |= {"noise": arguments.noise or not arguments.no_noise, "object_name": arguments.name}
    if arguments.mission_effects:
        options["effects"] = "mission"
    if (arguments.ra is None) != (arguments.dec is None):
        raise ValueError("--ra and --dec go together")
    psf = signal = None
    if arguments.psf is not None:
        psf = sm.BivariateGaussianPSF(1, 0, 0, *arguments.psf)
    if planet := _batch.planet_of(arguments):
        signal = planet_model(planet, motion.time, detector.cadence_days)
    # The magnitude of a catalog's star is set later.
    place = arguments.position or (None, None)
    star = sm.Star(arguments.mag or 0.0, *place, psf, signal)
    if arguments.catalog is None and arguments.background_stars is None:
        stars = [star, *(sm.Star(mag, x, y, psf) for mag, x, y in arguments.neighbor)]
        return sm.Scene(stars, detector, motion, **options, **given("ra", "dec"))
    if arguments.ra is None or arguments.neighbor:
        raise ValueError("--catalog and --background-stars need --ra and --dec, and no --neighbor")
    options |= given("magnitude_limit", "background_stars")
    return _make_field(arguments, star, detector, motion, options)


def _make_field(arguments, target, detector, motion, options):
    from astropy.coordinates import SkyCoord

    from scope_models.io._opening import read_table

    table = None if arguments.catalog is None else read_table(arguments.catalog)
    coord = SkyCoord(arguments.ra, arguments.dec, unit="deg")
    if arguments.mag is None:
        found = sm.Scene.from_catalog(table, coord, detector, motion, **options)
        coord = SkyCoord(found.ra, found.dec, unit="deg")
        target = target.replace(mag=found.stars[0].mag)
    return sm.Scene.from_catalog(table, coord, detector, motion, target=target, **options)


def _demo(arguments):
    """Simulate a spotted star of magnitude 12 with a planet at twice the motion of K2.

    Writes its target pixel file, its corrected light curve and a figure, and prints its noise about
    the true signal. Needs no file and no network.
    """
    import numpy as np
    from tqdm import tqdm

    from scope_models.io._opening import atomic_path, check_output

    folder = Path(arguments.output_dir)
    paths = [folder / name for name in ("pixels.fits", "light-curve.fits", "summary.png")]
    folder.mkdir(parents=True, exist_ok=True)
    for path in paths:
        check_output(path, overwrite=arguments.overwrite)
    with tqdm(desc="simulating", total=3, leave=False, disable=None) as bar:
        motion = 2 * sm.Motion.k2_roll()
        observation = _demo_star(motion, arguments.seed)
        still = _demo_star(motion * 0, arguments.seed)
        observation.write(paths[0], overwrite=arguments.overwrite)
        bar.update()
        bar.set_description("correcting")
        corrector = sm.correctors.detrend_file(*paths[:2], overwrite=arguments.overwrite)
        corrected, aperture = corrector.corrected_lc, corrector.aperture_mask
        bar.update()
        bar.set_description("drawing")
        title = "A star of magnitude 12 with spots and a planet, at twice K2's motion"
        axes = observation.plot(corrected, aperture, title=title)
        with atomic_path(paths[2], overwrite=arguments.overwrite) as temporary:
            axes["image"].figure.savefig(temporary, dpi=110)
        bar.update()
    print("6.5-hour CDPP of flux over truth (ppm, lightkurve's convention)")
    curves = {"raw": corrector.original_lc, "corrected": corrected}
    curves["at rest"] = still.to_lightcurve(aperture)
    others = []
    for name, lc in curves.items():
        seen = np.isin(observation.cadenceno, lc.cadenceno)
        noise = lc / observation.truth.relative_flux[0, seen]
        print(f"{name:12s}{sm.photometry.cdpp(noise):8.1f}")
        others.append(f"{sm.photometry.cdpp(noise, method='everest'):.1f}")
    print(f"EVEREST's convention gives {', '.join(others)}", "", "Written:", sep="\n")
    for path in paths:
        print(f"  {path}")


def _demo_star(motion, seed):
    detector = sm.Detector.k2()
    planet = sm.TransitModel.from_depth_duration(
        0.001, 0.25, 4.1, motion.time[0] + 2.0, exposure_time=detector.cadence_days
    )
    signal = planet * sm.models.sinusoidal_signal(0.002, period=9.0)
    return sm.simulate(sm.Star(12.0, signal=signal), detector, motion, seed=seed)
