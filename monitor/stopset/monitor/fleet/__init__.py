"""Many arms at a glance: one line or tile each, from zenoh alone."""

from stopset.monitor.fleet.fleet import Fleet
from stopset.monitor.fleet.page import FleetPage
from stopset.monitor.fleet.terminal import terminal

__all__ = ["Fleet", "FleetPage", "terminal"]
