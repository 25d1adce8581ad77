"""The simulated arm: full nonlinear dynamics with dry friction and brakes as sets, and the campaigns measured on it."""

from stopset.simulation.stop import simulate_stop

__all__ = ["simulate_stop"]
