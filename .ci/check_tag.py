"""Fail unless a tag is that of the package's version: ``python .ci/check_tag.py v0.2``."""

import runpy
import sys
from pathlib import Path

VERSION = Path(__file__).parents[1] / "scope_models" / "_version.py"


def main(tag):
    """Return an error message, or None."""
    version = runpy.run_path(str(VERSION))["__version__"]
    if ".dev" in version:
        return f"{version} is a development version, which is not released"
    return None if tag == f"v{version}" else f"the tag {tag} is not v{version}, the version"


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
