"""The errors a user can do something about; every message says what was seen, what was expected, what to do."""

from __future__ import annotations


class StopsetError(Exception):
    """Root of all errors that stopset raises on purpose; the command line prints it as one sentence, exit code 2."""


class RobotError(StopsetError):
    """The robot description cannot be used: mend the URDF or the drive data sheet."""


class RecordingError(StopsetError):
    """A recording cannot be used: mend the data or name another file."""


class ModelFileError(StopsetError):
    """A model file is damaged, foreign, or from another version: identify it again."""


class EffectError(StopsetError):
    """An effect is unknown or does not apply to this robot or these data."""


class NotConformant(StopsetError):
    """The data contradict the model, or no conformant model exists under the given limits."""


class NotCovered(StopsetError):
    """The question lies outside the model's domain of validity; no number is given."""


class BusError(StopsetError):
    """A bus or a zenoh session cannot be opened or failed; check wiring, name and permissions."""


class OutputError(StopsetError):
    """The result cannot be written where it was asked for; nothing was changed there."""
