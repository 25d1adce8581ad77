"""Diagnosis: which physical effect is missing, at which joint, and how sure that is."""

from stopset.offline.diagnose.answer import Diagnosis, Parameter, Ranked
from stopset.offline.diagnose.diagnose import diagnose, diagnose_model
from stopset.offline.nominal.prior import Tolerance

__all__ = ["Diagnosis", "Parameter", "Ranked", "Tolerance", "diagnose", "diagnose_model"]
