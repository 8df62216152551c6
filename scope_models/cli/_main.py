"""The command line's entry: its commands, errors and warnings."""

import argparse
import importlib
import io
import signal
import sys
import warnings

from scope_models._threads import one_thread
from scope_models._version import __version__
from scope_models.cli import _batch, _simulate

__all__ = ["main"]

# A command is a module with `add_parser(commands)`, which sets `run(arguments)` as a default.
_COMMANDS = (_simulate, _batch)
_TERMINATED = "by SIGTERM"


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
        0, 1 if some of many files failed, or 2 after an error, whose line goes to the
        standard error.

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
    for command in _COMMANDS:
        command.add_parser(commands)
    return parser


def _write(kind, message):
    """Write a message as one line to the standard error."""
    from scope_models._checks import one_line  # with astropy, which a --help does not need

    if isinstance(message, OSError) and message.strerror and message.filename is not None:
        message = f"{message.filename}: {message.strerror}"
    text = one_line(message) or type(message).__name__
    text = text.replace("pass overwrite=True to replace it", "--overwrite replaces it")
    print(f"scope-models: {kind}: {text}", file=sys.stderr)
