"""The simulator: a scene gives pixels, and the truth behind them."""

from scope_models.simulation.observation import Observation, Truth
from scope_models.simulation.simulate import simulate

__all__ = ["Observation", "Truth", "simulate"]
