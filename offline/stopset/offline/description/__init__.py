"""The robot's description: a URDF and a drive data sheet, read by pinocchio and reduced to one arm."""

from stopset.offline.description.read import load_robot, robot_from_text, shipped_robots

__all__ = ["load_robot", "robot_from_text", "shipped_robots"]
