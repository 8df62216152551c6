"""Date, version and command of a stored table, which the pages show above it."""

import subprocess
import time
from pathlib import Path

from scope_models import __version__


def stamp(table, command):
    """Add the origin of a table to its ``meta``."""
    git = ["git", "-C", str(Path(__file__).parent), "rev-parse", "--short", "HEAD"]
    done = subprocess.run(git, capture_output=True, text=True, check=False)  # noqa: S603
    table.meta |= {
        "date": time.strftime("%Y-%m-%d"),
        "version": f"{__version__} ({done.stdout.strip()})",
        "command": command,
    }
