"""Fixtures of the tests of experiments."""

import sys
from pathlib import Path

# Worker processes import the studies of the tests by this name.
sys.path.insert(0, str(Path(__file__).parent))
