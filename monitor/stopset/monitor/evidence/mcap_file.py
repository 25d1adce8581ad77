"""The one file format of what was seen: MCAP with JSON messages and a JSON schema per topic, as Foxglove and PlotJuggler show it,
and the curves once more as ROS 2 messages, as Rerun does.

The topics are a table; units stand in the schemas.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, BinaryIO

import msgspec
from mcap.writer import CompressionType, Writer

from stopset.monitor.evidence.curves import NAME, SCHEMA, Curves

WARNING, ERROR = 3, 4  # levels on ``log``
CHUNK = 65536  # bytes that a loss of power can cost
_STAMP = {"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}


def _row(means: str) -> dict[str, Any]:
    return {"type": "array", "items": {"type": ["number", "null"]}, "description": means}


def _word(means: str) -> dict[str, Any]:
    return {"type": "string", "description": means}


def _object(title: str, required: tuple[str, ...], **properties: dict[str, Any]) -> dict[str, Any]:
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema", "title": title, "type": "object",
        "properties": properties, "required": list(required),
    }  # fmt: skip


TOPICS: dict[str, dict[str, Any]] = {
    "joint_states": _object(
        "stopset.JointStates", ("timestamp", "k", "name", "position", "velocity", "effort"),
        timestamp=_STAMP, k={"type": "integer", "description": "cycle number; a lost cycle leaves one out"},
        name={"type": "array", "items": {"type": "string"}}, position=_row("rad"), velocity=_row("rad/s"),
        effort=_row("N m"), temperature=_row("degC"), input=_row("what the model is driven by, N m"),
    ),
    "tube": _object(
        "stopset.Tube", ("timestamp", "age_s", "q_lo", "q_hi", "dq_lo", "dq_hi"),
        timestamp=_STAMP, age_s={"type": "number", "description": "age of the prediction [s]"},
        q_lo=_row("rad"), q_hi=_row("rad"), dq_lo=_row("rad/s"), dq_hi=_row("rad/s"),
    ),
    "verdict": _object(
        "stopset.Verdict", ("timestamp", "conformance", "state"),
        timestamp=_STAMP, conformance=_word("of this sample"), state=_word("as published"),
        room_q=_row("distance to the nearest bound over the half width: 1 centre, 0 on the bound, negative outside"),
        room_dq=_row("as room_q"),
    ),
    "can": _object(
        "stopset.CanFrame", ("timestamp", "id", "data"),
        timestamp=_STAMP, id={"type": "integer", "description": "COB-ID"}, data=_word("bytes in hexadecimal"),
    ),
    "state": _object("stopset.State", ("state",), state=_word("the state message in words, with the stop bounds in force")),
    "event": _object("stopset.Event", ("kind",), kind=_word("what happened"), t_ns={"type": "integer"}),
    "health": _object("stopset.Health", ()),
    "cause": _object(
        "stopset.Cause", ("kind", "says"), kind=_word("class of the violation"), says=_word("in a sentence"),
        joint=_word("where it shows"), signal=_word("q, dq or tau"), size={"type": "number"}, unit=_word("of size"),
        t={"type": "number", "description": "onset [s]"}, torque_Nm=_row("push on every joint"), depends_on=_word("a signal"),
    ),
    "log": _object(  # a well-known schema of Foxglove's: shown in its log panel
        "foxglove.Log", ("timestamp", "level", "message", "name", "file", "line"), timestamp=_STAMP,
        level={"type": "integer", "enum": [0, 1, 2, 3, 4, 5]}, message=_word("what happened"), name=_word("who says it"),
        file=_word("of a program's text"), line={"type": "integer", "minimum": 0, "description": "in that file"},
    ),
}  # fmt: skip
_encode = msgspec.json.Encoder(enc_hook=float).encode


class McapFile:
    """Writes messages on the `TOPICS` of ``prefix`` into a file that the caller opens and closes; ``about``: what holds for all."""

    def __init__(self, stream: BinaryIO, prefix: str, about: Mapping[str, str]) -> None:
        self._writer = Writer(stream, chunk_size=CHUNK, compression=CompressionType.ZSTD)
        self._writer.start(profile="", library="stopset")
        self._writer.add_metadata("stopset", {k: str(v) for k, v in about.items()})
        self._prefix, self._channels = prefix, dict[str, int]()
        self._curves = Curves(tuple(about["joints"].split(","))) if about.get("joints") else None
        self._sequence = 0

    def add(self, topic: str, t_ns: int, message: Mapping[str, Any] | bytes, prefix: str = "") -> None:
        """One message at ``t_ns`` since the epoch; bytes are JSON already. ``prefix``: of another than the file's own."""
        name, t_ns = f"{prefix or self._prefix}/{topic}", max(0, t_ns)
        if name not in self._channels:
            schema = TOPICS[topic]
            number = self._writer.register_schema(schema["title"], "jsonschema", json.dumps(schema).encode())
            self._channels[name] = self._writer.register_channel(name, "json", number)
        self._put(name, t_ns, message if isinstance(message, bytes) else _encode(message))
        if self._curves is None or isinstance(message, bytes):
            return
        for curve, data in self._curves.of(topic, t_ns, message):
            name = f"{prefix or self._prefix}/{curve}"
            if name not in self._channels:
                number = self._writer.register_schema(NAME, "ros2msg", SCHEMA.encode())
                self._channels[name] = self._writer.register_channel(name, "cdr", number)
            self._put(name, t_ns, data)

    def _put(self, name: str, t_ns: int, data: bytes) -> None:
        channel, self._sequence = self._channels[name], self._sequence + 1
        self._writer.add_message(channel, log_time=t_ns, publish_time=t_ns, data=data, sequence=self._sequence & 0xFFFFFFFF)

    def finish(self) -> None:
        """The index, and the mark that the file is whole."""
        self._writer.finish()  # type: ignore[no-untyped-call]


def logged(t_ns: int, level: int, name: str, message: str) -> dict[str, Any]:
    """A message on ``log``, whole as the schema's owner asks for it: no program's text is behind it."""
    return {"timestamp": stamp(t_ns), "level": level, "name": name, "message": message, "file": "", "line": 0}


def stamp(t_ns: int) -> dict[str, int]:
    """As Foxglove reads times."""
    return {"sec": t_ns // 1_000_000_000, "nsec": t_ns % 1_000_000_000}
