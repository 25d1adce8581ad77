"""The compiled core: one C library that computes what monitor, offline part, stop bounds and FMU all compute."""
