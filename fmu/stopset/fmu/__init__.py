"""The FMU export: an identified arm as a functional mock-up unit that runs without Python."""

from stopset.fmu.build import PLATFORMS
from stopset.fmu.check import FmuCheck, check_fmu
from stopset.fmu.export import Contents, archive, export

__all__ = ["PLATFORMS", "Contents", "FmuCheck", "archive", "check_fmu", "export"]
