"""The simulated arm: full nonlinear dynamics with dry friction and brakes as sets, and the campaigns measured on it.

`simulate_stop` is the compiled stop that bounds are tested on, `simulate_stops` several of them; `prepare` gives a measuring campaign with
effects hidden.
"""

from stopset.simulation.campaign import PLANS, Schedule
from stopset.simulation.hidden import kinds
from stopset.simulation.scenario import Scenario, prepare
from stopset.simulation.stop import StoppingArm, simulate_stop, simulate_stops

__all__ = ["PLANS", "Scenario", "Schedule", "StoppingArm", "kinds", "prepare", "simulate_stop", "simulate_stops"]
