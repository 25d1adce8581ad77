"""The FMU export: an identified arm as a functional mock-up unit that runs without Python."""

from stopset.fmu.build import PLATFORMS
from stopset.fmu.export import archive, export
from stopset.fmu.reference import reference_paths, write_reference

__all__ = ["PLATFORMS", "archive", "export", "reference_paths", "write_reference"]
