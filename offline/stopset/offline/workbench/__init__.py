"""The loop compare → diagnose → add as a web page, for those who would rather click than type."""

from stopset.offline.workbench.loop import ACTIONS, Loop
from stopset.offline.workbench.server import Server

__all__ = ["ACTIONS", "Loop", "Server"]
