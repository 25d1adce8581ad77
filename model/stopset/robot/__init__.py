"""The robot: rigid body, drives, and the arms that come with the package."""

from stopset.robot.arm import Drive, Robot, load_robot
from stopset.robot.rigid import Chain

__all__ = ["Chain", "Drive", "Robot", "load_robot"]
