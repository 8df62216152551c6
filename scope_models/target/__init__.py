"""The paper's Appendix A: a simulated star whose parts are added one by one.

A thin layer over `~scope_models.simulate`, the corrector and the figures.
"""

from scope_models.target._generate import generate_target
from scope_models.target._target import Target

__all__ = ["Target", "generate_target"]
