"""``scope-models experiment``: a study of the paper, from its configuration to its figure."""

import argparse
import inspect
import sys
import tomllib

import scope_models as sm
from scope_models.cli import _batch

__all__ = ["add_parser", "run"]


def add_parser(commands):
    """Add the command to the parser of the command line."""
    parser = commands.add_parser(
        "experiment",
        help="run a study of the paper",
        description="Run a study: simulate and measure its stars, and write tables and a figure. "
        "A run that was interrupted goes on where it stopped when it is started again.",
    )
    parser.add_argument(
        "name",
        nargs="?",
        metavar="NAME",
        help="one of those that --list prints (default: what the configuration names)",
    )
    parser.add_argument("--list", action=_List, help="list the studies with their fields, and exit")
    parser.add_argument("--config", metavar="FILE", help="a TOML file with fields of the study")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="FIELD=VALUE",
        dest="fields",
        help="a field of the study, as in TOML; goes before that of the file; may be repeated",
    )
    parser.add_argument(
        "--directory", metavar="DIR", help="folder for the results (default: the study's name)"
    )
    _batch.add_workers(parser)
    parser.add_argument(
        "--write-tpfs", action="store_true", help="write a target pixel file of each star too"
    )
    parser.add_argument(
        "--keep-failures",
        action="store_true",
        help="do not try stars again that failed in an earlier run",
    )
    parser.set_defaults(run=run)


class _List(argparse.Action):
    """Prints the studies, as ``--help`` prints the options."""

    def __init__(self, option_strings, dest, **options):
        super().__init__(option_strings, dest, nargs=0, default=argparse.SUPPRESS, **options)

    def __call__(self, parser, *_):
        """Print and exit."""
        for name, study in sm.experiments.STUDIES.items():
            print(f"{name}: {inspect.getdoc(study).splitlines()[0]}")
            for field, value in study().config().items():
                if field != "study":
                    print(f"    {field} = {_toml(value)}")
        parser.exit()


def run(arguments):
    """Run the study and print where its results are."""
    client = _batch.client_of(arguments)
    study = _make_study(arguments)
    try:
        result = sm.experiments.run_experiment(
            study,
            arguments.directory or study.name,
            client,
            write_tpfs=arguments.write_tpfs,
            retry_failed=not arguments.keep_failures,
            progress=sys.stderr.isatty(),
        )
    except (ModuleNotFoundError, sm.experiments.SweepError) as error:
        raise ValueError(str(error)) from error
    print(f"{study.name}: {len(result.table)} stars, {len(result.failures)} failed")
    for claim, verdict in result.summary.meta.get("claims", {}).items():
        print(f"{verdict}: {claim}")
    for file in result.files:
        print(file)


def _make_study(arguments):
    """Return the study of the arguments."""
    fields = dict(_field(text) for text in arguments.fields)
    if arguments.config is not None:
        return sm.experiments.read_config(arguments.config, arguments.name, fields)
    if arguments.name is None:
        raise ValueError(
            f"name a study ({', '.join(sm.experiments.STUDIES)}), or give one with --config"
        )
    return sm.experiments.make_study(arguments.name, fields)


def _field(text):
    """Return name and value of ``FIELD=VALUE``; what is no TOML value is a string."""
    name, equals, value = text.partition("=")
    name = name.strip()
    if not equals or not name:
        raise ValueError(f"--set needs FIELD=VALUE, got {text!r}")
    try:
        return name, tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        return name, value.strip()


def _toml(value):
    """Return a value as TOML writes it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        return f"[{', '.join(_toml(item) for item in value)}]"
    return f'"{value}"' if isinstance(value, str) else repr(value)
