"""Commands on many files, and the parts that commands share."""

import argparse
import sys
import tomllib
import warnings
from pathlib import Path

import scope_models as sm

__all__ = [
    "add_command", "add_options", "add_parser", "add_planet", "add_workers", "adder",
    "check_number", "client_of", "given", "planet_of", "refuse_options_of_runs", "run",
    "with_config",
]  # fmt: skip

_NEIGHBORS = (
    "other stars in the pixels: find, or a table that astropy reads with the columns ra and dec "
    "(degrees), or x and y (pixels); stars outside of the pixels are left out"
)


def add_parser(commands):
    _add_detrend(commands)
    _add_fit(commands)
    _add_inject(commands)
    text = "write a page about a run over many files"
    _, add = add_command(commands, _report, "report corrected", text)
    add("folder", "the --output-dir of the run", metavar="FOLDER")
    add("--output", "the page (default: report.html in the folder)", metavar="FILE")
    example = "benchmark --stars 5 --output-dir skies"
    text = "write target pixel files whose truth is known"
    parser, add = add_command(commands, _benchmark, example, text)
    add_options(parser)
    add("--stars", "only the first N", type=int, default=200, metavar="N")
    example = "score corrected/sky0001-lc.fits --output scores.ecsv"
    text = "compare corrected light curves of the benchmark with the truth"
    _, add = add_command(commands, _score, example, text)
    add("input", "light-curve files", nargs="+", metavar="LC")
    add("--output", "write the scores of each file, as ECSV", metavar="TABLE")
    add("--overwrite", "replace the table if it exists", action="store_true")


def _add_file_command(commands, one, output, example, text):
    """Return the parser of a command, a function that adds an option, and one for other options.

    The options are those of ``one``, for a file, and ``NAME_files`` of `scope_models.batch`.
    """
    parser, add_any = add_command(commands, one, example, text)
    text = "target pixel files, or EPIC, KIC or TIC numbers such as 'EPIC 211956421', whose files "
    add_any("input", f"{text}are downloaded", nargs="+", metavar="IN")
    add_any("--output", f"{output} of a single input", metavar="OUT")
    add_options(parser)
    names = []
    parser.set_defaults(run=_run_files, command=example.split()[0], one=one, names=names)

    def add(*option, **settings):
        names.append(add_any(*option, **settings).dest)

    return parser, add, add_any


def _run_files(arguments):
    check_number(arguments, "cadences")
    options = given(arguments, *arguments.names)
    if arguments.command == "inject":
        options["planets"] = _planets_of(arguments, planet_of(arguments))
        if options["planets"] is None:
            raise ValueError("--period and --depth are needed, or --planets")
    if arguments.command == "detrend":
        options |= _detrend_options(arguments)
    if arguments.output_dir is not None:
        compute = getattr(sm.batch, f"{arguments.command}_files")
        return run(compute, arguments, arguments.input, **options)
    if arguments.output is None or len(arguments.input) > 1:
        raise ValueError("give --output for one input, or --output-dir for any number")
    refuse_options_of_runs(arguments)
    (path,) = sm.batch.find_files(arguments.input)
    print(arguments.one(arguments, path, overwrite=arguments.overwrite, **options))
    return 0


def _planets_of(arguments, planet):
    """Return the table ``--planets``, or the planet as columns; None without both."""
    if arguments.planets is None:
        return {name: [value] for name, value in planet.items()} or None
    if planet:
        raise ValueError("--period and --depth cannot be combined with --planets")
    from scope_models.io._opening import read_table

    return read_table(arguments.planets)


def _add_detrend(commands):
    text = "correct the light curve of a target pixel file"
    example = "detrend star.fits --output lc.fits"
    parser, add, add_any = _add_file_command(
        commands, _detrend, "the light-curve file", example, text
    )
    add_any("--figure", "the figure (default: the output's name with .png)", metavar="FILE")
    add("--order", "pixel fractions that are multiplied (default: 2)", type=int)
    add("--trend", "model of the long-term variability (default: gp)", choices=("gp", "quadratic"))
    text = "remove the long-term variability too"
    add("--remove-trend", text, dest="restore_trend", action="store_false")
    text = "find the part of a transit that survives, by a second correction"
    add("--survival", text, action="store_true")
    text = "pixels that are summed (default: those whose sum is most precise)"
    add("--aperture", text, dest="aperture_mask", choices=("pipeline", "threshold", "all"))
    add("--neighbors", _NEIGHBORS, metavar="TABLE")
    text = (
        "target pixel files of stars on the same CCD, whose common motion gives the positions "
        "(default: POS_CORR, and with --output-dir the POS_CORR of other files of the run on the "
        "same CCD where it is missing or disagrees with these)"
    )
    add_any("--positions-from", text, nargs="+", metavar="FILE")
    add_any = adder(parser.add_argument_group("transits that are left out of the fit"))
    add_any("--period", "period of a planet, days", type=float, metavar="P")
    add_any("--t0", "a mid-transit, days as in the file", type=float, metavar="T")
    add_any("--duration", "of its transits, days", type=float, metavar="D")
    text = "a table that astropy reads with these columns: one row for each file"
    add_any("--planets", text, metavar="TABLE")
    add_any = adder(parser.add_argument_group("files for archives, with --output-dir"))
    text = "fits: a file per star; hlsp: files as in an archive's collection; parquet: one data set"
    text += " (default: fits)"
    add_any("--format", text, choices=("fits", "hlsp", "parquet"), default="fits")
    text = "identifier of the collection, for --format hlsp"
    add_any("--hlsp-id", text, dest="id", metavar="TEXT")
    add_any("--lead", "name of who leads it", metavar="TEXT")
    add_any("--version", "its version, as 1.0", metavar="TEXT")
    add_any("--title", "its title", metavar="TEXT")
    add_any("--doi", "its digital object identifier", metavar="TEXT")


def _detrend_options(arguments):
    """Return options, for many files or for one, that are not arguments of a correction."""
    planet = given(arguments, "period", "t0", "duration")
    if planet and (len(planet) < 3 or arguments.planets is not None):
        raise ValueError("a mask of transits needs --period, --t0 and --duration, or --planets")
    hlsp = given(arguments, "id", "lead", "version", "title", "doi")
    if arguments.format == "hlsp" and not {"id", "lead", "version"} <= hlsp.keys():
        raise ValueError("--format hlsp needs --hlsp-id, --lead and --version")
    if arguments.output_dir is not None:
        many = {"format": arguments.format, "hlsp": hlsp or None}
        many["planets"] = _planets_of(arguments, planet)
        return many | given(arguments, "positions_from")
    if arguments.format != "fits" or arguments.planets:
        raise ValueError("--format and --planets need an --output-dir")
    one = {"transits": planet or None}
    if arguments.positions_from is not None:
        one["positions"] = sm.Motion.from_tpfs(arguments.positions_from)
    return one


def _detrend(arguments, path, **options):
    """Remove pointing systematics from a target pixel file by pixel level decorrelation.

    The file is one of Kepler, K2 or TESS, or of a simulation. Writes a light-curve file that
    lightkurve opens, and a figure.
    """
    output = arguments.output
    figure = Path(arguments.figure or Path(output).with_suffix(".png"))
    corrector = sm.correctors.detrend_file(path, output, figure=figure, **options)
    lcs = corrector.original_lc, corrector.corrected_lc
    try:
        raw, corrected = map(sm.photometry.cdpp, lcs)
    except ValueError:
        return f"{output}: too few cadences for a CDPP"
    text = f"{output}: CDPP {raw:.1f} -> {corrected:.1f} ppm (6.5 h, as lightkurve's estimate_cdpp)"
    if options["survival"]:
        result = corrector.result
        survival = f"{result.transit_survival:.3f} +- {result.transit_survival_err:.3f}"
        text += f"; {survival} of a transit survives"
    return text


def _add_fit(commands):
    text = "fit PSF, sensitivity, positions and fluxes to a target pixel file"
    example = "fit star.fits --components 2 --robust --output fit.fits"
    _, add, _ = _add_file_command(commands, _fit, "the file to write", example, text)
    text = "Gaussian components of the PSF (default: what describes the pixels)"
    add("--components", text, dest="psf", type=int, choices=(1, 2, 3))
    text = "order of an empirical term in the PSF (default: none)"
    add("--empirical", text, type=int, metavar="N")
    add("--sensitivity", "fit a quadratic response within the pixels", action="store_true")
    text = "standard deviation of the response between pixels; 0: all alike (default: 0.01 if the "
    add("--interpixel", f"{text}PSF describes the pixels, else 0)", type=float, metavar="S")
    add("--neighbors", _NEIGHBORS, metavar="TABLE")
    text = "what POS_CORR is used for (default: start)"
    add("--positions", text, choices=("start", "free", "prior", "path"))
    text = "pixels: the share of each pixel is a smooth function of position and time; auto: where "
    text += "no PSF describes the pixels (default: auto)"
    add("--response", text, choices=("auto", "psf", "pixels"))
    text = "a loss that suits data with cosmic rays"
    add("--robust", text, dest="loss", action="store_const", const="soft_l1")
    add("--cadences", "only the first N cadences", type=int, metavar="N")


def _fit(arguments, path, **options):
    """Fit one model to all pixels and cadences of a target pixel file.

    Writes the parameters with their errors, the light curve and the model's pixels to a FITS file.
    """
    from scope_models.batch.files import fit_file

    fit = fit_file(path, arguments.output, **options)
    return f"{fit.summary()}\n{arguments.output}: {len(fit.time)} cadences"


def _add_inject(commands):
    text = "add transits to the pixels of a target pixel file"
    example = "inject star.fits --period 4.2 --depth 0.001 --output planet.fits"
    parser, add, add_any = _add_file_command(commands, _inject, "the file to write", example, text)
    add_planet(parser)
    text = "a table that astropy reads with the columns period and depth, and if wanted t0 and "
    text += "duration: one row for each file"
    add_any("--planets", text, metavar="TABLE")
    text = "the light that is dimmed: scene, that of a simulated file; fit, that of a fit of the "
    text += "PSF; or the share of the star in all pixels (default: the scene if there is one, else "
    add("--star", f"{text}the fit)", type=_light, metavar="LIGHT")
    add("--seed", "seed of the photon noise (default: 1)", type=int, default=1)


def _light(text):
    try:
        return float(text)
    except ValueError:
        return text


def _inject(arguments, path, planets, **options):
    """Multiply the light of the star in a target pixel file by the transits of a planet.

    The file is real or simulated, and the photon noise that belongs to it changes too. Neighbors
    and background stay.
    """
    from scope_models.batch.files import inject_file, planet_rows

    (planet,) = planet_rows(planets, [path])
    row = inject_file(path, planet, arguments.output, **options)
    return (
        f"{arguments.output}: mid-transit at {row['t0']:.4f} d, {row['in_transit']} cadences in "
        f"transit, {1e6 * row['injected_depth']:.0f} ppm of the light of all pixels"
    )


def _report(arguments):
    """Write one HTML page about a run.

    Noise against magnitude, outliers with their pixels, light curves and positions, warnings, and
    failures by cause. It holds all of its figures and needs no network.
    """
    print(sm.batch.write_report(arguments.folder, arguments.output))


def _benchmark(arguments):
    """Write 200 target pixel files of messy stars, the same on every machine.

    They have motion, focus, neighbors, background, variability and transits. Correct them with any
    pipeline, then let `scope-models score` compare the light curves with the truth.
    """
    if arguments.output_dir is None:
        arguments.parser.error("the following arguments are required: --output-dir")
    return run(sm.benchmark.make_benchmark, arguments, stars=arguments.stars)


def _score(arguments):
    """Print the medians of the scores by regime.

    full and high_passed: scatter in 6.5 h about the truth over that of the noise; amplitude and
    depth: part of variability and transits that is kept; pull: deviations over quoted errors; kept:
    part of the cadences. The truth with its noise has 1 everywhere. bias and step, in ppm and 0 for
    the truth: dependence on the place within the pixel, and steps from pixel to pixel.
    """
    from scope_models.io._opening import atomic_path, check_output

    if arguments.output is not None:
        check_output(arguments.output, overwrite=arguments.overwrite, inputs=arguments.input)
    table = sm.benchmark.score_light_curves(arguments.input)
    summary = sm.benchmark.summarize_scores(table)
    for name in summary.colnames[2:]:
        summary[name].info.format = ".3g"
    print("\n".join(summary.pformat(max_lines=-1, max_width=-1)))
    if arguments.output is not None:
        with atomic_path(arguments.output, overwrite=arguments.overwrite) as temporary:
            table.write(temporary, format="ascii.ecsv")


def add_command(commands, run, example, text):
    """Return the parser of a command, which `run` describes, and a function that adds an option."""
    epilog = f"example: scope-models {example}"
    name = example.split()[0]
    parser = commands.add_parser(name, help=text, description=run.__doc__, epilog=epilog)
    parser.set_defaults(run=run, parser=parser)
    return parser, adder(parser)


def adder(group):
    """Return a function that adds an option with its text to a parser or a group."""
    return lambda flag, text, **settings: group.add_argument(flag, help=text, **settings)


def add_planet(group):
    add = adder(group)
    add("--period", "period of a planet, days; needs --depth", type=float, metavar="P")
    add("--depth", "relative drop of its transits", type=float, metavar="D")
    text = "a mid-transit, days as in the file (default: half a period after the first one)"
    add("--t0", text, type=float, metavar="T")
    text = "of its transits, days (default: central ones of a star like the Sun)"
    add("--duration", text, type=float, metavar="D")


def given(arguments, *names):
    """Return the options that have a value, by name."""
    return {n: getattr(arguments, n) for n in names if getattr(arguments, n) is not None}


def planet_of(arguments):
    """Return the planet of the options, empty without one."""
    planet = given(arguments, "period", "depth", "t0", "duration")
    if planet and not {"period", "depth"} <= planet.keys():
        raise ValueError("a planet needs --period and --depth")
    return planet


def check_number(arguments, name):
    value = getattr(arguments, name, None)
    if value is not None and value < 1:
        raise ValueError(f"--{name} must be at least 1, got {value}")


def refuse_options_of_runs(arguments):
    if arguments.workers != 1 or arguments.scheduler:
        name = "--scheduler" if arguments.workers == 1 else "--workers"
        raise ValueError(f"{name} needs an --output-dir")


def add_options(parser):
    """Add the options of a run over many files."""
    add = adder(parser)
    text = "folder for the files of many inputs and for the tables of results; the same command "
    add("--output-dir", f"{text}goes on where a run has stopped", metavar="FOLDER")
    text = "a TOML file with options of the command, as `order = 1`; those given here go first"
    add("--config", text, metavar="FILE")
    add("--overwrite", "replace files that exist", action="store_true")
    add_workers(parser)


def add_workers(parser):
    add = adder(parser.add_mutually_exclusive_group())
    add("--workers", "processes on this machine (default: 1)", type=int, default=1, metavar="N")
    add("--scheduler", "address of a Dask scheduler, as tls://host:8786", metavar="ADDRESS")


def client_of(arguments):
    """Return the `client` of `run_sweep`."""
    check_number(arguments, "workers")
    return arguments.scheduler or (None if arguments.workers == 1 else arguments.workers)


def with_config(argv):
    """Return arguments with those of the TOML file of ``--config`` put before the others."""
    finder = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    finder.add_argument("--config", nargs="?")
    path = finder.parse_known_args(argv)[0].config
    if path is None:
        return argv
    try:
        values = tomllib.loads(Path(path).read_text(encoding="utf-8-sig"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path} is not valid TOML: {error}") from error
    inputs, added = [], []
    for name, value in values.items():
        listed = value if isinstance(value, list) else [value]
        if not all(isinstance(item, (int, float, str)) for item in listed):
            raise ValueError(f"{path}: `{name}` must be a number, text, true, false or a list")
        option = f"--{name.replace('_', '-')}"
        if name == "input":
            inputs += map(str, listed)
        elif isinstance(value, bool):
            added += [option] if value else []
        else:  # a negative number alone would be an option
            added += [option, *map(str, value)] if value is listed else [f"{option}={value}"]
    # The option between the file's and those given here ends a list of values.
    return [*argv[:1], *inputs, *added, f"--config={path}", *argv[1:]]


def run(compute, arguments, *inputs, **options):
    """Call a function for many files and print its results; return 1 if a file has failed."""
    for option in ("output", "figure"):
        if getattr(arguments, option, None) is not None:
            raise ValueError(f"--{option} cannot be combined with --output-dir")
    client = client_of(arguments)
    from scope_models._checks import one_line
    from scope_models.exceptions import FailedStarsWarning

    try:
        # The failures are listed below.
        with warnings.catch_warnings(action="ignore", category=FailedStarsWarning):
            result = compute(
                *inputs, output_dir=arguments.output_dir, client=client, **options,
                overwrite=arguments.overwrite, sweep={"progress": sys.stderr.isatty()},
            )  # fmt: skip
    except (ModuleNotFoundError, sm.batch.SweepError) as error:
        print(f"scope-models: error: {one_line(error)}", file=sys.stderr)
        return 1
    for key, error in result.failures.iterrows("key", "error"):
        print(f"scope-models: failed: {key}: {one_line(error)}", file=sys.stderr)
    print(f"{len(result.table) + len(result.failures)} stars, {len(result.failures)} failed")
    for file in result.files:
        print(file)
    return 1 if len(result.failures) else 0
