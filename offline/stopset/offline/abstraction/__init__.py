"""From the full dynamics to a polynomial simple enough for reachability, by Taylor polynomial arithmetic."""

from stopset.offline.abstraction.choose import ModelCandidate, best_first, prediction_error
from stopset.offline.abstraction.identified import IdentifiedArm, abstract, friction_polynomial
from stopset.offline.abstraction.models import ORDERS, build, predicted_bytes

__all__ = [
    "ORDERS",
    "IdentifiedArm",
    "ModelCandidate",
    "abstract",
    "best_first",
    "build",
    "friction_polynomial",
    "predicted_bytes",
    "prediction_error",
]
