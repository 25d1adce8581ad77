"""From the full dynamics to a polynomial simple enough for reachability, by Taylor polynomial arithmetic."""

from stopset.offline.abstraction.models import ORDERS, Degrees, build, degrees, predicted_bytes

__all__ = ["ORDERS", "Degrees", "build", "degrees", "predicted_bytes"]
