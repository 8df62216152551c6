"""``scope-models inject``: transits in the pixels of target pixel files."""

from scope_models.cli import _batch

__all__ = ["add_parser", "run"]

_PLANET = ("period", "t0", "depth", "duration")


def add_parser(commands):
    """Add the command to the parser of the command line."""
    parser = commands.add_parser(
        "inject",
        help="add transits to the pixels of a target pixel file",
        description="Multiply the light of the star in a target pixel file, real or simulated, by "
        "the transits of a planet, with the photon noise that belongs to it. Neighbors and "
        "background stay.",
    )
    _batch.add_inputs(parser, "the file to write")
    parser.add_argument("--overwrite", action="store_true", help="replace files that exist")
    for name, text in (
        ("period", "days"),
        ("t0", "time of a mid-transit, days as in the file"),
        ("depth", "relative"),
        ("duration", "days"),
    ):
        parser.add_argument(f"--{name}", type=float, help=text)
    parser.add_argument(
        "--planets",
        metavar="TABLE",
        help="a table that astropy reads with the columns period, t0, depth and duration: one row "
        "for each file",
    )
    parser.add_argument(
        "--star",
        metavar="LIGHT",
        help="the light that is dimmed: scene, that of a simulated file; fit, that of a fit of the "
        "PSF; or the share of the star in all pixels (default: the scene if there is one, else "
        "the fit)",
    )
    parser.add_argument("--seed", type=int, default=1, help="seed of the photon noise (default: 1)")
    parser.set_defaults(run=run)


def run(arguments):
    """Inject into one file or many; return the exit status."""
    from scope_models.batch import inject_file

    planets = _planets(arguments)
    options = {"star": _star(arguments.star), "seed": arguments.seed}
    if arguments.output_dir is not None:
        return _batch.run("inject_files", arguments, arguments.input, planets, **options)
    path = _batch.single(arguments)
    if len(planets) != 1:
        raise ValueError(f"--planets must have one row for one file, got {len(planets)}")
    row = inject_file(path, planets[0], arguments.output, overwrite=arguments.overwrite, **options)
    print(
        f"{arguments.output}: {row['in_transit']} cadences in transit, "
        f"{1e6 * row['injected_depth']:.0f} ppm of the light of all pixels"
    )
    return 0


def _planets(arguments):
    """Return the table of planets."""
    from astropy.table import Table

    values = {name: getattr(arguments, name) for name in _PLANET}
    given = [name for name, value in values.items() if value is not None]
    if arguments.planets is not None:
        if given:
            raise ValueError(f"--{given[0]} cannot be combined with --planets")
        return Table.read(arguments.planets)
    if len(given) < len(_PLANET):
        raise ValueError("--period, --t0, --depth and --duration are needed, or --planets")
    return Table(rows=[values])


def _star(text):
    """Return the light as `inject_files` takes it."""
    try:
        return float(text)
    except (TypeError, ValueError):
        return text
