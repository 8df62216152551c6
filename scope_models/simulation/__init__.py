"""The simulator: a scene gives pixels, and the truth behind them."""

from scope_models.simulation.inject import inject
from scope_models.simulation.observation import Observation
from scope_models.simulation.simulate import simulate

__all__ = ["Observation", "inject", "simulate"]
