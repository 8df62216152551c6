"""``scope-models report``: a page about a run over many files."""

from scope_models.cli import _batch

__all__ = ["add_parser"]


def add_parser(commands):
    """Add the command to the parser of the command line."""
    parser = _batch.add_command(
        commands,
        "report",
        example="report corrected",
        help="write a page about a run over many files",
        description="Write one HTML page about a run: noise against magnitude, outliers with their "
        "pixels, light curves and positions, warnings, and failures by cause. It holds all of its "
        "figures and needs no network.",
    )
    parser.add_argument("folder", metavar="FOLDER", help="the --output-dir of the run")
    parser.add_argument(
        "--output", metavar="FILE", help="the page (default: report.html in the folder)"
    )
    parser.set_defaults(run=_run)


def _run(arguments):
    """Write the page and print its path."""
    from scope_models.batch import write_report

    print(write_report(arguments.folder, arguments.output))
