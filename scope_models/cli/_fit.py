"""``scope-models fit``: one model for all pixels and cadences of a target pixel file."""

import scope_models as sm
from scope_models.cli import _batch

__all__ = ["add_parser", "run"]


def add_parser(commands):
    """Add the command to the parser of the command line."""
    parser = commands.add_parser(
        "fit",
        help="fit PSF, sensitivity, positions and fluxes to a target pixel file",
        description="Fit one model to all pixels and cadences of a target pixel file, and write "
        "the parameters with their errors, the light curve and the model's pixels to a FITS file.",
    )
    _batch.add_inputs(parser, "the file to write")
    parser.add_argument("--overwrite", action="store_true", help="replace the file if it exists")
    parser.add_argument(
        "--components",
        type=int,
        choices=(1, 2, 3),
        default=None,
        help="Gaussian components of the PSF (default: what describes the pixels)",
    )
    parser.add_argument(
        "--empirical",
        type=int,
        default=0,
        metavar="N",
        help="order of an empirical term in the PSF (default: none)",
    )
    parser.add_argument(
        "--sensitivity", action="store_true", help="fit a quadratic response within the pixels"
    )
    parser.add_argument(
        "--interpixel",
        type=float,
        default=None,
        metavar="S",
        help="standard deviation of the response between pixels; 0: all alike (default: 0.01 if "
        "the PSF describes the pixels, else 0)",
    )
    parser.add_argument(
        "--positions",
        choices=("start", "free", "prior", "path"),
        default="start",
        help="what POS_CORR is used for (default: start)",
    )
    parser.add_argument(
        "--response",
        choices=("auto", "psf", "pixels"),
        default="auto",
        help="pixels: the share of each pixel is a smooth function of position and time; auto: "
        "where no PSF describes the pixels (default: auto)",
    )
    parser.add_argument(
        "--robust", action="store_true", help="a loss that suits data with cosmic rays"
    )
    parser.add_argument("--cadences", type=int, metavar="N", help="only the first N cadences")
    parser.set_defaults(run=run)


def run(arguments):
    """Fit one file or many; return the exit status."""
    from scope_models.io._atomic import check_output
    from scope_models.io._opening import naming

    if arguments.cadences is not None and arguments.cadences < 1:
        raise ValueError(f"--cadences must be at least 1, got {arguments.cadences}")
    options = {
        "psf": arguments.components,
        "empirical": arguments.empirical,
        "interpixel": arguments.interpixel,
        "positions": arguments.positions,
        "response": arguments.response,
        "loss": "soft_l1" if arguments.robust else "linear",
    }
    if arguments.output_dir is not None:
        options |= {"sensitivity": arguments.sensitivity, "cadences": arguments.cadences or 0}
        return _batch.run("fit_files", arguments, arguments.input, **options)
    path = _batch.single(arguments)
    check_output(arguments.output, overwrite=arguments.overwrite, inputs=[path])
    if arguments.sensitivity:
        options["sensitivity"] = sm.SensitivityPolynomial(fixed={"ax1": True, "ay1": True})
    with naming(path):
        fit = sm.fit_tpf(sm.io.read_pixels(path)[: arguments.cadences], **options)
    path = fit.write(arguments.output, overwrite=arguments.overwrite)
    table = fit.table()
    for row in table[~table["fixed"]]:
        print(f"{row['name']:18s} {row['value']:12.6g} +- {row['error']:<10.2g} {row['unit']}")
    print(f"chi-squared per degree of freedom {fit.reduced_chi2:.4g}")
    print(f"{path}: {len(fit.time)} cadences")
    return 0
