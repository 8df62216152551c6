"""Parts of the commands that compute many stars or files."""

import argparse
import sys
import tomllib
import warnings
from pathlib import Path

__all__ = [
    "add_inputs",
    "add_options",
    "add_workers",
    "client_of",
    "refuse_options_of_runs",
    "run",
    "single",
    "with_config",
]


def add_inputs(parser, output):
    """Add the inputs and the output of a command for one file or many."""
    parser.add_argument(
        "input",
        nargs="+",
        metavar="IN",
        help="target pixel files, or names of targets such as 'EPIC 211956421', which are "
        "downloaded",
    )
    parser.add_argument("--output", metavar="OUT", help=f"{output} of a single input")
    add_options(parser)


def single(arguments):
    """Return the file of a command that has no --output-dir."""
    from scope_models.batch import find_files

    if arguments.output is None or len(arguments.input) > 1:
        raise ValueError("give --output for one input, or --output-dir for any number")
    refuse_options_of_runs(arguments)
    return find_files(arguments.input)[0]


def refuse_options_of_runs(arguments):
    """Refuse options of many files where there is one."""
    given = {"--workers": arguments.workers != 1, "--scheduler": arguments.scheduler}
    for name in filter(given.get, given):
        raise ValueError(f"{name} needs an --output-dir")


def add_options(parser):
    """Add the options of a run over many files."""
    parser.add_argument(
        "--output-dir",
        metavar="DIR",
        help="folder for the files of many inputs and for the tables of results; the same command "
        "goes on where a run has stopped",
    )
    parser.add_argument(
        "--config",
        metavar="FILE",
        help="a TOML file with options of the command, as `order = 1`; those given here go first",
    )
    add_workers(parser)


def with_config(argv):
    """Return arguments with those of the TOML file of ``--config`` put before the others."""
    finder = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    finder.add_argument("--config", nargs="?")
    path = finder.parse_known_args(argv)[0].config
    if path is None:
        return argv
    try:
        values = tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path} is not valid TOML: {error}") from error
    added = []
    for name, value in values.items():
        listed = value if isinstance(value, list) else [value]
        if not all(isinstance(item, (bool, int, float, str)) for item in listed):
            raise ValueError(f"{path}: `{name}` must be a number, text, true, false or a list")
        option = [] if name == "input" else [f"--{name.replace('_', '-')}"]
        if isinstance(value, bool):
            added += option if value else []
        elif isinstance(value, list):
            added += [*option, *map(str, value)]
        else:
            added.append(f"{option[0]}={value}" if option else str(value))
    return [*argv[:1], *added, *argv[1:]]


def add_workers(parser):
    """Add ``--workers`` and ``--scheduler``, of which one may be given."""
    group = parser.add_mutually_exclusive_group()
    group.add_argument(
        "--workers", type=int, default=1, metavar="N", help="processes on this machine (default: 1)"
    )
    group.add_argument(
        "--scheduler", metavar="ADDRESS", help="address of a Dask scheduler, as tls://host:8786"
    )


def client_of(arguments):
    """Return what computes the stars, as `run_sweep` takes it."""
    if arguments.workers < 1:
        raise ValueError(f"--workers must be at least 1, got {arguments.workers}")
    return arguments.scheduler or (None if arguments.workers == 1 else arguments.workers)


def run(name, arguments, *inputs, **options):
    """Call a function for many files, print what it has found, return the status.

    It is 1 if a file has failed; ``inputs`` and ``options`` are for the function.
    """
    for option in ("output", "figure"):
        if getattr(arguments, option, None) is not None:
            raise ValueError(f"--{option} cannot be combined with --output-dir")
    from scope_models import batch, benchmark
    from scope_models.exceptions import FailedStarsWarning

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FailedStarsWarning)  # the failures are listed below
            result = getattr(batch, name, getattr(benchmark, name, None))(
                *inputs,
                arguments.output_dir,
                client_of(arguments),
                overwrite=arguments.overwrite,
                sweep={"progress": sys.stderr.isatty()},
                **options,
            )
    except (ModuleNotFoundError, batch.SweepError) as error:
        print(f"scope-models: error: {error}", file=sys.stderr)
        return 1
    for key, error in result.failures.iterrows("key", "error"):
        print(f"scope-models: failed: {key}: {' '.join(error.split())}", file=sys.stderr)
    total = len(result.table) + len(result.failures)
    print(f"{total} stars, {len(result.failures)} failed")
    for file in result.files:
        print(file)
    return 1 if len(result.failures) else 0
