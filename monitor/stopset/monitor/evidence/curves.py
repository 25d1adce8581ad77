"""Joint states and tubes once more as ROS 2 messages: what shows no JSON, Rerun among them, draws these."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from stopset.monitor.jointstate import JointState, to_cdr

NAME = "sensor_msgs/msg/JointState"
_LINE = "=" * 80
SCHEMA = "\n".join(
    [
        "std_msgs/Header header", "string[] name", "float64[] position", "float64[] velocity", "float64[] effort",
        _LINE, "MSG: std_msgs/Header", "builtin_interfaces/Time stamp", "string frame_id",
        _LINE, "MSG: builtin_interfaces/Time", "int32 sec", "uint32 nanosec", "",
    ]
)  # fmt: skip
TOPICS = {
    "joint_states": {"ros/joint_states": ("position", "velocity", "effort")},
    "tube": {"ros/tube_lo": ("q_lo", "dq_lo", ""), "ros/tube_hi": ("q_hi", "dq_hi", "")},
}
STAMP, HEAD, DOUBLE = 4, 4, 8  # bytes: where the stamp begins, what numbers are aligned behind, and a number


@dataclass(slots=True)
class Curves:
    """Messages of an arm with these ``joints``; a row that is not there, or not whole, is empty."""

    joints: tuple[str, ...]
    _begin: bytes = field(init=False)  # of every message: stamp and names

    def __post_init__(self) -> None:
        none = struct.calcsize("<3I")  # three empty rows
        self._begin = to_cdr(JointState(0, self.joints, (), (), ()))[:-none]

    def of(self, topic: str, t_ns: int, message: Mapping[str, Any]) -> Iterator[tuple[str, bytes]]:
        """Topic and CDR bytes of what a JSON ``message`` holds."""
        for name, rows in TOPICS.get(topic, {}).items():
            yield name, self._cdr(t_ns, [message.get(row) or () for row in rows])

    def _cdr(self, t_ns: int, rows: list[Sequence[float | None]]) -> bytes:
        out = bytearray(self._begin)
        struct.pack_into("<iI", out, STAMP, *divmod(t_ns, 1_000_000_000))
        for row in rows:
            numbers = [x for x in row if x is not None]
            whole = numbers if len(numbers) == len(self.joints) else []
            out += struct.pack("<I", len(whole))
            if whole:
                out += bytes(-(len(out) - HEAD) % DOUBLE) + struct.pack(f"<{len(whole)}d", *whole)
        return bytes(out)
