"""Stops for the safety file: tables, pictures, separation distance, and the sampler that tries to break the bounds."""
