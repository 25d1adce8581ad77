"""Recordings of a robot: the one format in, checked at the door."""

from stopset.recording.reader import read_meta, read_recordings, stream_recordings
from stopset.recording.types import EFFORTS, PHASES, Meta, Recording, Recordings
from stopset.recording.writer import write_recordings

__all__ = [
    "EFFORTS",
    "PHASES",
    "Meta",
    "Recording",
    "Recordings",
    "read_meta",
    "read_recordings",
    "stream_recordings",
    "write_recordings",
]
