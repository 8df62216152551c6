"""Fixtures of the tests of experiments."""

import sys
from pathlib import Path

# Worker processes import the studies of the tests by this name.
sys.path.insert(0, str(Path(__file__).parent))
# What only studies use is tested from their folder.
sys.path.append(str(Path(__file__).parents[2] / "studies"))
