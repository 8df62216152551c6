"""``scope-models detrend``: the light curve of a target pixel file, without its systematics."""

from pathlib import Path

import scope_models as sm
from scope_models.cli import _batch

__all__ = ["add_parser", "run"]


def add_parser(commands):
    """Add the command to the parser of the command line."""
    parser = commands.add_parser(
        "detrend",
        help="correct the light curve of a target pixel file",
        description="Remove pointing systematics from a target pixel file of Kepler, K2 or TESS, "
        "or of a simulation, by pixel level decorrelation. Writes a light-curve file that "
        "lightkurve opens, and a figure.",
    )
    _batch.add_inputs(parser, "the light-curve file")
    parser.add_argument(
        "--figure", metavar="FILE", help="the figure (default: the output's name with .png)"
    )
    parser.add_argument("--overwrite", action="store_true", help="replace files that exist")
    parser.add_argument(
        "--order", type=int, default=2, help="pixel fractions that are multiplied (default: 2)"
    )
    parser.add_argument(
        "--trend",
        choices=("gp", "quadratic"),
        default="gp",
        help="model of the long-term variability (default: gp)",
    )
    parser.add_argument(
        "--remove-trend", action="store_true", help="remove the long-term variability too"
    )
    parser.set_defaults(run=run)


def run(arguments):
    """Run the command; return the exit status."""
    options = {
        "order": arguments.order,
        "trend": arguments.trend,
        "restore_trend": not arguments.remove_trend,
    }
    if arguments.output_dir is not None:
        return _batch.run("detrend_files", arguments, arguments.input, **options)
    path = _batch.single(arguments)
    figure = Path(arguments.figure or Path(arguments.output).with_suffix(".png"))
    corrector = sm.correctors.detrend_file(
        path, arguments.output, figure=figure, overwrite=arguments.overwrite, **options
    )
    print(f"{arguments.output}: {_summary(corrector)}")
    return 0


def _summary(corrector):
    """Return what became of the noise."""
    lcs = corrector.original_lc, corrector.corrected_lc
    try:
        raw, corrected = (sm.photometry.cdpp(lc, method="everest") for lc in lcs)
    except ValueError:
        return "too few cadences for a CDPP"
    return f"CDPP {raw:.1f} -> {corrected:.1f} ppm (6.5 h, EVEREST's convention)"
