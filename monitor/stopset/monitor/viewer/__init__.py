"""What a person sees of a running monitor, from zenoh alone: a terminal view, and a page with the same content."""

from stopset.monitor.viewer.page import ViewerPage
from stopset.monitor.viewer.terminal import terminal
from stopset.monitor.viewer.view import View

__all__ = ["View", "ViewerPage", "terminal"]
