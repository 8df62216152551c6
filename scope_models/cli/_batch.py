"""Parts of the commands that compute many stars or files."""

import argparse
import sys
import tomllib
import warnings
from pathlib import Path

import scope_models as sm

__all__ = [
    "add_command", "add_options", "add_planet", "add_workers", "adder", "check_number", "client_of",
    "given", "planet_of", "refuse_options_of_runs", "run", "with_config",
]  # fmt: skip


def add_command(commands, run, example, text):
    """Return the parser of a command, which `run` describes, and a function that adds an option."""
    name, description = example.split()[0], " ".join((run.__doc__ or "").split())
    texts = {"help": text, "description": description, "epilog": f"example: scope-models {example}"}
    parser = commands.add_parser(name, **texts)
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
    """Return the planet of the options, as far as it is given; empty without one."""
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
        if not all(isinstance(item, (bool, int, float, str)) for item in listed):
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
