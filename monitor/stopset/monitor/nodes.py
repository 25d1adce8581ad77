"""What the drives say of themselves on CANopen: heartbeat, NMT state, emergencies. OK needs all of them good.

Source: CANopen services of CiA 301: NMT 0x000, EMCY 0x080 + node, heartbeat 0x700 + node.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from stopset.core.library import lib
from stopset.types import Array

NMT, EMCY, HEARTBEAT = 0x000, 0x080, 0x700
BOOT, STOPPED, OPERATIONAL, PREOPERATIONAL = 0x00, 0x04, 0x05, 0x7F
NAMES = {BOOT: "starting", STOPPED: "stopped", OPERATIONAL: "operational", PREOPERATIONAL: "pre-operational"}
# what a master's command makes of a node; that it has obeyed a reset (0x81, 0x82), its own boot-up message says
COMMANDS = {0x01: OPERATIONAL, 0x02: STOPPED, 0x80: PREOPERATIONAL, 0x81: BOOT, 0x82: BOOT}
PATIENCE = 3.0  # heartbeats that may be missed
MAX_SAID = 64  # emergencies kept for telling
REGISTER = 2  # byte of an emergency that holds the error register, object 0x1001: zero where no error is left
UNREAD = 0xFFFF  # stands for an emergency that was not read, or not heard


@dataclass(slots=True)
class Node:
    """The state last heard, and the emergency in force, 0 none."""

    state: int | None = None
    emergency: int = 0

    @property
    def good(self) -> bool:
        return not self.emergency and self.state in (None, OPERATIONAL)


@dataclass(slots=True)
class Nodes:
    """Follows the drives of ``joints`` (node id by joint). ``heartbeat_s``: their period; 0 = they send none.

    Without heartbeats a node counts as operational until a command or an emergency says otherwise: its PDOs show that it lives.
    An emergency is in force until the drive says that no error is left, or that it has started anew: CiA 301 has it tell once more what
    is wrong after that. Who has missed that word waits for an operator's (`dismiss`).
    ``heard`` [s] and ``standing``, by node id, are the core's too: it takes in the heartbeats that change nothing.
    """

    joints: Mapping[str, int]
    heartbeat_s: float
    emergencies: list[tuple[int, bytes]] = field(default_factory=list)
    heard: Array = field(default_factory=lambda: np.full(lib.STOPSET_NODES, -np.inf))
    standing: NDArray[np.uint8] = field(default_factory=lambda: np.full(lib.STOPSET_NODES, lib.STOPSET_STRANGER, np.uint8))
    in_force: dict[str, int] = field(default_factory=dict)  # emergencies by joint
    _nodes: dict[int, Node] = field(init=False)

    def __post_init__(self) -> None:
        self._nodes = {node: Node() for node in self.joints.values()}
        self.standing[list(self._nodes)] = lib.STOPSET_GOOD

    @property
    def patience(self) -> float:
        """[s] of silence after which a node is not good any more; 0: it may be silent."""
        return PATIENCE * self.heartbeat_s

    def frame(self, cob_id: int, data: bytes | bytearray, t: float) -> None:
        """Take a frame received at ``t`` [s]; others than the three services are passed over."""
        if cob_id == NMT:
            if len(data) == 2 and data[0] in COMMANDS:
                for node_id in self._nodes if data[1] == 0 else (data[1],):
                    if node_id in self._nodes:
                        self._becomes(node_id, COMMANDS[data[0]])
        elif EMCY < cob_id < EMCY + 0x80:
            self._emergency(cob_id - EMCY, bytes(data))
        elif HEARTBEAT < cob_id < HEARTBEAT + 0x80 and len(data) == 1 and cob_id - HEARTBEAT in self._nodes:
            self.heard[cob_id - HEARTBEAT] = t
            if data[0] == BOOT:
                self._nodes[cob_id - HEARTBEAT].emergency = 0
            self._becomes(cob_id - HEARTBEAT, data[0] & 0x7F)

    def recall(self, emergencies: Mapping[str, int]) -> None:
        """What drives said before this was here, by joint, still holds."""
        for joint, code in emergencies.items():
            node = self._nodes.get(self.joints.get(joint, -1))
            if node is not None and not node.emergency:
                node.emergency = code
                self._stands(self.joints[joint], node)

    def dismiss(self) -> None:
        """A person has seen to it that no drive has an error."""
        for node_id, node in self._nodes.items():
            node.emergency = 0
            self._stands(node_id, node)

    def remember(self, before: Nodes) -> None:
        """What the same drives said on a bus that was lost still holds: an emergency is told once, its end too."""
        for node_id, node in before._nodes.items():
            if node_id in self._nodes:
                self._nodes[node_id] = node
                self._stands(node_id, node)

    def _becomes(self, node_id: int, state: int) -> None:
        node = self._nodes[node_id]
        node.state = state
        self._stands(node_id, node)

    def _emergency(self, node_id: int, data: bytes) -> None:
        if len(self.emergencies) < MAX_SAID:
            self.emergencies.append((node_id, data))
        node = self._nodes.get(node_id)
        if node is not None:
            node.emergency = _in_force(data, node.emergency)
            self._stands(node_id, node)

    def _stands(self, node_id: int, node: Node) -> None:
        self.standing[node_id] = lib.STOPSET_GOOD if node.good else lib.STOPSET_BAD
        self.in_force = {joint: self._nodes[i].emergency for joint, i in self.joints.items() if self._nodes[i].emergency}

    def bad(self, now: float) -> tuple[int, str]:
        """Bit i set = the drive of joint i is not good at ``now`` [s]; and a sentence on the first of them, empty if none."""
        bits, words = 0, ""
        for i, (joint, node_id) in enumerate(self.joints.items()):
            why = self._why(node_id, now)
            if why:
                bits |= 1 << i
                words = words or f"the drive of {joint} (node {node_id}) {why}"
        return bits, words

    def _why(self, node_id: int, now: float) -> str:
        node = self._nodes[node_id]
        if node.emergency:
            return (
                f"reports the emergency 0x{node.emergency:04X}, until it says that no error is left, starts anew, or an operator's "
                "reset says so for it"
            )
        if not node.good:
            assert node.state is not None
            return f"is {NAMES.get(node.state, f'in the unknown state 0x{node.state:02X}')}"
        if self.heartbeat_s and not abs(now - self.heard[node_id]) <= self.patience:
            return f"has sent no heartbeat for {self.patience:g} s"
        return ""


def _in_force(data: bytes, before: int) -> int:
    """The emergency in force after a message, where ``before`` was; 0: none.

    Code 0x00xx says that an error is gone, and the error register behind it whether it was the last: CiA 301 has a drive say so for each
    of several, too. A message without a register cannot be read, and is no all-clear.
    """
    code = int.from_bytes(data[:2], "little") if len(data) > REGISTER else UNREAD
    if code >> 8:
        return code
    return (before or UNREAD) if data[REGISTER] else 0
