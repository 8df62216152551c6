"""Date, version and command of a stored table, which the pages show above it."""

import subprocess
import time
from pathlib import Path

from scope_models import __version__


def version():
    """Return the version of the package and the commit of this checkout."""
    git = ["git", "-C", str(Path(__file__).parent), "rev-parse", "--short", "HEAD"]
    done = subprocess.run(git, capture_output=True, text=True, check=False)  # noqa: S603
    return f"{__version__} ({done.stdout.strip()})"


def stamp(table, command, made_with=None):
    """Add the origin of a table to its ``meta``; its rows may be of other versions than this."""
    origin = {"version": made_with or version(), "command": command}
    table.meta |= {"date": time.strftime("%Y-%m-%d")} | origin
