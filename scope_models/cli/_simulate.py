"""``scope-models simulate``: a target pixel file of one star, and its neighbors."""

import scope_models as sm
from scope_models.cli import _batch

__all__ = ["add_parser", "run"]

_CADENCES = 1000


def add_parser(commands):
    """Add the command to the parser of the command line."""
    parser = commands.add_parser(
        "simulate",
        help="write a target pixel file of a star",
        description="Simulate the pixels of a star along a spacecraft's motion, and write them "
        "with the truth to a target pixel file that lightkurve opens.",
    )
    parser.add_argument("--output", metavar="FILE", help="the file to write")
    parser.add_argument(
        "--table",
        metavar="TABLE",
        help="simulate each row of a table that astropy reads (columns mag and, if wanted, name, "
        "x_0, y_0, period, t0, depth, duration) into --output-dir, with --detector, --motion, "
        "--cadences and --seed for all",
    )
    _batch.add_options(parser)
    parser.add_argument("--overwrite", action="store_true", help="replace the file if it exists")
    parser.add_argument("--seed", type=int, help="makes the result reproducible")
    parser.add_argument("--target-id", type=int, default=1, metavar="N", help="KEPLERID or TICID")
    parser.add_argument("--name", help="name of the target in the file")
    _add_motion(parser.add_argument_group("motion"))
    _add_star(parser.add_argument_group("star"))
    _add_detector(parser.add_argument_group("detector"))
    parser.set_defaults(run=run, error=parser.error)


def _add_motion(group):
    """Add the options of the motion."""
    group.add_argument(
        "--motion",
        metavar="FILE",
        help="target pixel or light-curve file of Kepler, K2 or TESS whose POS_CORR columns the "
        "star follows (default: a generated K2 roll for --detector k2; for the others the star "
        "rests)",
    )
    group.add_argument("--scale", type=float, default=1.0, help="factor on the motion (default: 1)")
    group.add_argument("--cadences", type=int, metavar="N", help="only the first N cadences")
    group.add_argument(
        "--n-sub",
        type=int,
        default=1,
        metavar="N",
        help="exposures within a cadence to average the motion over (default: 1)",
    )


def _add_star(group):
    """Add the options of the star."""
    group.add_argument("--mag", type=float, help="magnitude, Kp or T; needed without --table")
    group.add_argument(
        "--position",
        type=float,
        nargs=2,
        metavar=("X", "Y"),
        help="column and row, pixels from 0 (default: the middle)",
    )
    group.add_argument(
        "--psf",
        type=float,
        nargs=3,
        metavar=("SIGMA_X", "SIGMA_Y", "RHO"),
        help="widths, in pixels, and correlation of a Gaussian PSF (default: the detector's)",
    )
    group.add_argument(
        "--transit",
        type=float,
        nargs=4,
        metavar=("PERIOD", "T0", "DEPTH", "DURATION"),
        help="a planet: period and first mid-transit after the first cadence, relative drop, and "
        "duration; times in days",
    )
    group.add_argument(
        "--neighbor",
        type=float,
        nargs=3,
        action="append",
        default=[],
        metavar=("MAG", "X", "Y"),
        help="another star on the stamp; may be repeated",
    )


def _add_detector(group):
    """Add the options of the detector."""
    group.add_argument(
        "--detector",
        default="k2",
        metavar="NAME",
        help="the preset, kepler, k2, k2_calibrated or tess, or a TOML file of your own detector "
        "(default: k2)",
    )
    group.add_argument(
        "--shape", type=int, nargs=2, metavar=("NY", "NX"), help="rows and columns of the stamp"
    )
    group.add_argument(
        "--no-sensitivity",
        action="store_true",
        help="pixels that all respond alike, and evenly within: the control",
    )
    noise = group.add_mutually_exclusive_group()
    noise.add_argument(
        "--noise",
        nargs="+",
        metavar="TERM",
        help="only these noise terms, of photon, background, read and quantization "
        "(default: the first three)",
    )
    noise.add_argument("--no-noise", action="store_true", help="expected counts without noise")


def run(arguments):
    """Simulate the star and write the file; return the exit status."""
    from scope_models.io._atomic import check_output

    if arguments.table is not None:
        return _run_table(arguments)
    if arguments.output is None or arguments.mag is None:
        arguments.error("--output and --mag are needed, or --table and --output-dir")
    inputs = [arguments.motion, arguments.detector]
    check_output(
        arguments.output,
        overwrite=arguments.overwrite,
        inputs=[path for path in inputs if path is not None],
    )
    detector = _make_detector(arguments)
    motion = _make_motion(arguments, detector)
    stars = _make_stars(arguments, detector, motion.time[0])
    noise = arguments.noise or not arguments.no_noise
    observation = sm.simulate(
        stars, detector, motion, seed=arguments.seed, noise=noise, n_sub=arguments.n_sub
    )
    metadata = {"target_id": arguments.target_id, "object_name": arguments.name}
    observation.write(arguments.output, overwrite=arguments.overwrite, metadata=metadata)
    rows, columns = detector.shape
    print(f"{arguments.output}: {len(motion)} cadences of {rows} x {columns} pixels")
    return 0


def _run_table(arguments):
    """Simulate the stars of a table."""
    from astropy.table import Table

    if arguments.output_dir is None:
        raise ValueError("--table needs an --output-dir")
    table = Table.read(arguments.table)
    options = {"detector": arguments.detector, "motion": arguments.motion or ""}
    options |= {"cadences": arguments.cadences or _CADENCES, "seed": arguments.seed or 1}
    return _batch.run("simulate_table", arguments, table, **options)


def _make_motion(arguments, detector):
    """Return the motion that the options ask for."""
    number = arguments.cadences
    if number is not None and number < 1:
        raise ValueError(f"--cadences must be at least 1, got {number}")
    if arguments.motion is None:
        return _default_motion(arguments, detector, number or _CADENCES)
    motion = sm.Motion.from_file(arguments.motion)
    if number is not None and number > len(motion):
        raise ValueError(f"--cadences must be at most {len(motion)}, the motion's, got {number}")
    return arguments.scale * motion[:number]


def _default_motion(arguments, detector, number):
    """Return the motion without a file: K2 rolls, the others point steadily."""
    from scope_models.missions import MISSIONS

    if detector.mission == "K2":
        return arguments.scale * sm.Motion.k2_roll(number)
    if arguments.scale != 1:
        raise ValueError(f"--scale needs --motion FILE with --detector {arguments.detector}")
    mission = MISSIONS.get(detector.mission, MISSIONS["Kepler"])
    return sm.Motion.still(
        number,
        start=mission.start,
        cadence=detector.cadence_days,
        time_format=mission.time_format,
    )


def _make_detector(arguments):
    """Return the detector that the options ask for."""
    from scope_models.scene.presets import PRESETS

    changes = {} if arguments.shape is None else {"shape": tuple(arguments.shape)}
    if arguments.detector in PRESETS:
        detector = sm.Detector.preset(arguments.detector, **changes)
    elif arguments.detector.endswith(".toml"):
        detector = sm.read_detector(arguments.detector).replace(**changes)
    else:
        raise ValueError(
            f"--detector must be one of {', '.join(PRESETS)} or a .toml file, "
            f"got {arguments.detector!r}"
        )
    return detector.without_sensitivity() if arguments.no_sensitivity else detector


def _make_stars(arguments, detector, start):
    """Return the star and its neighbors that the options ask for."""
    x_0, y_0 = arguments.position or (None, None)
    psf = signal = None
    if arguments.psf is not None:
        sigma_x, sigma_y, rho = arguments.psf
        psf = sm.BivariateGaussianPSF(sigma_x=sigma_x, sigma_y=sigma_y, rho=rho)
    if arguments.transit is not None:
        period, t0, depth, duration = arguments.transit
        signal = sm.TransitModel.from_depth_duration(
            depth, duration, period, start + t0, exposure_time=detector.cadence_days
        )
    star = sm.Star(arguments.mag, x_0, y_0, psf, signal)
    return [star, *(sm.Star(mag, x, y, psf) for mag, x, y in arguments.neighbor)]
