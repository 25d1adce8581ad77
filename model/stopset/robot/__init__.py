"""The robot: rigid body, drives, and the arms that come with the package."""

from stopset.robot.arm import Robot
from stopset.robot.drives import Drive
from stopset.robot.rigid import Chain

__all__ = ["Chain", "Drive", "Robot"]
