"""Options of the commands that compute many stars."""

__all__ = ["add_options", "client_of"]


def add_options(parser):
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
