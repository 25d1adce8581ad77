"""Recordings of a robot: the one format in, checked at the door."""

from stopset.recording.reader import read_meta, read_recordings, sources_of, stream_recordings
from stopset.recording.types import EFFORTS, PHASES, Meta, Recording, Recordings, SuiteKey, counted, suite_label
from stopset.recording.writer import write_recordings

__all__ = [
    "EFFORTS",
    "PHASES",
    "Meta",
    "Recording",
    "Recordings",
    "SuiteKey",
    "counted",
    "read_meta",
    "read_recordings",
    "sources_of",
    "stream_recordings",
    "suite_label",
    "write_recordings",
]
