"""Conformance: the smallest sets that make every measured behaviour reachable."""
