"""``scope-models report``, ``benchmark`` and ``score``: pages and scores of corrections."""

import scope_models as sm
from scope_models.cli import _batch

__all__ = ["add_parser"]


def add_parser(commands):
    text = "write a page about a run over many files"
    _, add = _batch.add_command(commands, _report, "report corrected", text)
    add("folder", "the --output-dir of the run", metavar="FOLDER")
    add("--output", "the page (default: report.html in the folder)", metavar="FILE")
    example = "benchmark --stars 5 --output-dir skies"
    text = "write target pixel files whose truth is known"
    parser, add = _batch.add_command(commands, _write, example, text)
    _batch.add_options(parser)
    add("--stars", "only the first N", type=int, default=200, metavar="N")
    example = "score corrected/sky0001-lc.fits --output scores.ecsv"
    text = "compare corrected light curves of the benchmark with the truth"
    _, add = _batch.add_command(commands, _score, example, text)
    add("input", "light-curve files", nargs="+", metavar="LC")
    add("--output", "write the scores of each file, as ECSV", metavar="TABLE")
    add("--overwrite", "replace the table if it exists", action="store_true")


def _report(arguments):
    """Write one HTML page about a run.

    Noise against magnitude, outliers with their pixels, light curves and positions, warnings, and
    failures by cause. It holds all of its figures and needs no network.
    """
    print(sm.batch.write_report(arguments.folder, arguments.output))


def _write(arguments):
    """Write 200 target pixel files of messy stars, the same on every machine.

    They have motion, focus, neighbors, background, variability and transits. Correct them with any
    pipeline, then let `scope-models score` compare the light curves with the truth.
    """
    if arguments.output_dir is None:
        arguments.parser.error("the following arguments are required: --output-dir")
    return _batch.run(sm.benchmark.make_benchmark, arguments, stars=arguments.stars)


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
