"""From the full dynamics to a polynomial simple enough for reachability, by Taylor polynomial arithmetic."""

from stopset.offline.abstraction.choose import Candidate, prediction_error, ranked
from stopset.offline.abstraction.identified import IdentifiedArm, abstract, friction_polynomial
from stopset.offline.abstraction.models import ORDERS, Degrees, build, degrees, predicted_bytes

__all__ = [
    "ORDERS",
    "Candidate",
    "Degrees",
    "IdentifiedArm",
    "abstract",
    "build",
    "degrees",
    "friction_polynomial",
    "predicted_bytes",
    "prediction_error",
    "ranked",
]
