"""From the full dynamics to a polynomial simple enough for reachability, by Taylor polynomial arithmetic."""

from stopset.offline.abstraction.build import ORDERS, build, degrees, predicted_bytes

__all__ = ["ORDERS", "build", "degrees", "predicted_bytes"]
