"""Settings of the tests of robustness."""

import sys
from pathlib import Path

# The malformed files are a module of their own, which is a script too.
sys.path.insert(0, str(Path(__file__).parent))
