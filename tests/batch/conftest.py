"""Fixtures of the tests of sweeps."""

import sys
from pathlib import Path

# Worker processes import the stars of the tests by this name.
sys.path.insert(0, str(Path(__file__).parent))
