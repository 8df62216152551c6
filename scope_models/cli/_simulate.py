"""``scope-models simulate``: a target pixel file of one star, and its neighbors."""

import scope_models as sm
from scope_models.cli import _batch

__all__ = ["add_parser", "run"]

_CADENCES = 1000
# The options that go together with --table.
_OF_TABLES = (
    "table", "output_dir", "overwrite", "workers", "scheduler", "detector", "motion", "cadences",
    "seed",
)  # fmt: skip
_RUNS = ("campaign", "quarter", "sector", "channel", "camera", "ccd")


def add_parser(commands):
    """Add the command to the parser of the command line."""
    parser = _batch.add_command(
        commands,
        "simulate",
        help="write a target pixel file of a star",
        description="Simulate the pixels of a star along a spacecraft's motion, and write them "
        "with the truth to a target pixel file that lightkurve opens.",
        example="simulate --mag 12 --period 4.2 --depth 0.001 --output star.fits",
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
    parser.add_argument("--seed", type=int, help="makes the result reproducible")
    parser.add_argument("--target-id", type=int, default=1, metavar="N", help="KEPLERID or TICID")
    parser.add_argument("--name", help="name of the target in the file")
    _add_motion(parser.add_argument_group("motion"))
    _add_star(parser.add_argument_group("star"))
    _add_sky(parser.add_argument_group("sky"))
    _add_detector(parser.add_argument_group("detector"))
    parser.set_defaults(run=run, default_of=parser.get_default)


def _add(group, kind, *options):
    """Add options of a type: the name, the metavar or those of several values, and the help."""
    for name, metavar, text in options:
        several = {"nargs": len(metavar)} if isinstance(metavar, tuple) else {}
        group.add_argument(f"--{name}", type=kind, metavar=metavar, help=text, **several)


def _add_motion(group):
    group.add_argument(
        "--motion",
        metavar="FILE",
        help="target pixel or light-curve file of Kepler, K2 or TESS whose POS_CORR columns the "
        "star follows (default: a generated K2 roll for --detector k2, the tracking of a telescope "
        "for ground; for the others the star rests)",
    )
    group.add_argument("--scale", type=float, default=1.0, help="factor on the motion (default: 1)")
    _add(group, int, ("cadences", "N", "only the first N cadences"))
    text = "exposures within a cadence to average the motion over (default: 1)"
    group.add_argument("--n-sub", type=int, default=1, metavar="N", help=text)


def _add_star(group):
    _add(
        group,
        float,
        ("mag", None, "magnitude, Kp or T; needed without --table and --catalog"),
        ("position", ("X", "Y"), "column and row, pixels from 0 (default: the middle)"),
        (
            "psf",
            ("SIGMA_X", "SIGMA_Y", "RHO"),
            "widths, in pixels, and correlation of a Gaussian PSF (default: the detector's)",
        ),
    )
    _batch.add_planet(group)
    several = {"nargs": 3, "action": "append", "default": [], "metavar": ("MAG", "X", "Y")}
    text = "another star on the stamp; may be repeated"
    group.add_argument("--neighbor", type=float, help=text, **several)


def _add_sky(group):
    _add(
        group,
        float,
        ("ra", "DEG", "right ascension of the target"),
        ("dec", "DEG", "declination of the target"),
        ("orientation", "DEG", "position angle of growing rows from north to east (default: 0)"),
    )
    group.add_argument(
        "--catalog",
        metavar="FILE",
        help="a table that astropy reads, as of Gaia, with the columns ra, dec and a magnitude, "
        "and if wanted pmra, pmdec and ref_epoch: its stars are target and neighbors; needs --ra "
        "and --dec",
    )
    _add(
        group,
        float,
        ("magnitude-limit", "MAG", "leave out fainter stars of it"),
        (
            "background-stars",
            "MAG",
            "draw stars down to this magnitude by the mean counts in this direction",
        ),
    )
    _add(group, int, *((name, "N", f"{name}, for the file's headers") for name in _RUNS[:3]))
    _add(group, int, *((name, "N", f"{name}, for the same") for name in _RUNS[3:]))


def _add_detector(group):
    group.add_argument(
        "--detector",
        default="k2",
        metavar="NAME",
        help="the preset, kepler, k2, k2_calibrated, tess or ground, or a TOML file of your own "
        "detector (default: k2)",
    )
    _add(group, int, ("shape", ("NY", "NX"), "rows and columns of the stamp"))
    text = "pixels that all respond alike, and evenly within: the control"
    group.add_argument("--no-sensitivity", action="store_true", help=text)
    text = "with the effects of the detector's mission: cosmic rays, smear and others"
    group.add_argument("--mission-effects", action="store_true", help=text)
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

    _batch.check_number(arguments, "cadences")
    if arguments.table is not None:
        return _run_table(arguments)
    if arguments.output is None or (arguments.mag is None and arguments.catalog is None):
        arguments.error("--output and --mag or --catalog are needed, or --table and --output-dir")
    if arguments.output_dir is not None:
        raise ValueError("--output-dir needs --table")
    _batch.refuse_options_of_runs(arguments)
    inputs = [*filter(None, (arguments.motion, arguments.detector, arguments.catalog))]
    check_output(arguments.output, overwrite=arguments.overwrite, inputs=inputs)
    detector = _make_detector(arguments)
    motion = _make_motion(arguments, detector)
    noise = arguments.noise or not arguments.no_noise
    fields = {"seed": arguments.seed, "noise": noise, "n_sub": arguments.n_sub}
    fields |= {"effects": "mission"} if arguments.mission_effects else {}
    scene = _make_scene(arguments, detector, motion, fields)
    observation = sm.simulate(scene)
    observation.write(arguments.output, overwrite=arguments.overwrite)
    rows, columns = detector.shape
    stars = f", {len(scene.stars)} stars" if arguments.catalog else ""
    print(f"{arguments.output}: {len(motion)} cadences of {rows} x {columns} pixels{stars}")
    return 0


def _run_table(arguments):
    from astropy.table import Table

    if arguments.output_dir is None:
        raise ValueError("--table needs an --output-dir")
    for name, value in vars(arguments).items():
        if name not in _OF_TABLES and value != arguments.default_of(name):
            raise ValueError(f"--{name.replace('_', '-')} cannot be combined with --table")
    table = Table.read(arguments.table)
    options = {"detector": arguments.detector, "motion": arguments.motion or ""}
    options["cadences"] = arguments.cadences or _CADENCES
    options["seed"] = 1 if arguments.seed is None else arguments.seed
    return _batch.run("simulate_table", arguments, table, **options)


def _make_motion(arguments, detector):
    number = arguments.cadences
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
    if detector.mission == "Ground":
        seconds, scale = detector.cadence_days * 86400, detector.pixel_scale
        return arguments.scale * sm.Motion.ground(number, cadence=seconds, pixel_scale=scale)
    if arguments.scale != 1:
        raise ValueError(f"--scale needs --motion FILE with --detector {arguments.detector}")
    mission = MISSIONS.get(detector.mission, MISSIONS["Kepler"])
    options = {"start": mission.start, "time_format": mission.time_format}
    return sm.Motion.still(number, cadence=detector.cadence_days, **options)


def _make_detector(arguments):
    from scope_models.scene.presets import PRESETS

    changes = {} if arguments.shape is None else {"shape": tuple(arguments.shape)}
    if arguments.detector in PRESETS:
        detector = sm.Detector.preset(arguments.detector, **changes)
    elif arguments.detector.endswith(".toml"):
        detector = sm.read_detector(arguments.detector).replace(**changes)
    else:
        wanted = f"one of {', '.join(PRESETS)} or a .toml file"
        raise ValueError(f"--detector must be {wanted}, got {arguments.detector!r}")
    return detector.without_sensitivity() if arguments.no_sensitivity else detector


def _make_scene(arguments, detector, motion, fields):
    fields |= {"target_id": arguments.target_id, "object_name": arguments.name}
    fields["metadata"] = _batch.given(arguments, *_RUNS)
    if (arguments.ra is None) != (arguments.dec is None):
        raise ValueError("--ra and --dec go together")
    stars = _make_stars(arguments, detector, motion.time)
    drawn = {"background_stars": arguments.background_stars}
    if arguments.catalog is None and arguments.background_stars is None:
        fields |= _batch.given(arguments, "ra", "dec", "orientation")
        return sm.Scene(stars, detector, motion, **fields)
    if arguments.ra is None or arguments.neighbor:
        raise ValueError("--catalog and --background-stars need --ra and --dec, and no --neighbor")
    return _make_field(arguments, stars[0], detector, motion, fields | drawn)


def _make_field(arguments, target, detector, motion, options):
    from astropy.coordinates import SkyCoord
    from astropy.table import Table

    table = None if arguments.catalog is None else Table.read(arguments.catalog)
    options |= {"orientation": arguments.orientation or 0.0}
    options |= {"magnitude_limit": arguments.magnitude_limit}
    coord = SkyCoord(arguments.ra, arguments.dec, unit="deg")
    if arguments.mag is None:
        found = sm.Scene.from_catalog(table, coord, detector, motion, **options)
        coord = SkyCoord(found.ra, found.dec, unit="deg")
        target = target.replace(mag=found.stars[0].mag)
    return sm.Scene.from_catalog(table, coord, detector, motion, target=target, **options)


def _make_stars(arguments, detector, time):
    from scope_models.batch.files import planet_model

    x_0, y_0 = arguments.position or (None, None)
    psf = signal = None
    if arguments.psf is not None:
        sigma_x, sigma_y, rho = arguments.psf
        psf = sm.BivariateGaussianPSF(sigma_x=sigma_x, sigma_y=sigma_y, rho=rho)
    if planet := _batch.planet_of(arguments):
        signal = planet_model(planet, time, detector.cadence_days)
    # The magnitude of a catalog's star is set later.
    star = sm.Star(arguments.mag or 0.0, x_0, y_0, psf, signal)
    return [star, *(sm.Star(mag, x, y, psf) for mag, x, y in arguments.neighbor)]
