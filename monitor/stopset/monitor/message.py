"""The state message's fields: what a turn of the loop, a sample, its verdict and the latch come to."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from stopset.monitor.certificates import Numbers
from stopset.monitor.config import Fallback
from stopset.monitor.latch import Latch
from stopset.monitor.layout import CATEGORIES, PREFIX
from stopset.monitor.packer import Changing
from stopset.monitor.publisher import U64
from stopset.monitor.report import Turn
from stopset.monitor.sample import Sample
from stopset.monitor.status import stop_fields
from stopset.monitor.verdict import Conformance, Verdict

U32 = 2**32 - 1
INFINITE = math.inf
CODES = {Conformance.UNKNOWN: 0, Conformance.CONFORMANT: 1, Conformance.VIOLATION: 2, Conformance.FAULT: 3}


class StateMessage:
    """Of an arm with these ``joints``; ``fallback``: the numbers that stand for withdrawn ones."""

    def __init__(self, fallback: Fallback, joints: tuple[str, ...]) -> None:
        self.fallback, self.n = fallback, len(joints)
        self._number = {joint: i for i, joint in enumerate(joints, 1)}
        self._block: tuple[dict[str, Numbers], Mapping[str, int], dict[str, Any]] = ({}, {}, {})
        self._withdrawn: dict[str, Numbers] = {}

    def withdrawn(self, numbers: dict[str, Numbers]) -> dict[str, Numbers]:
        """The configured ones in place of ``numbers``, the same object every time: it need not be made a message of anew."""
        if self._withdrawn.keys() != numbers.keys():
            f = self.fallback
            self._withdrawn = {c: Numbers.fallback(self.n, f.time_s, f.angle_rad, f.tcp_m) for c in numbers}
        return self._withdrawn

    def changing(self, turn: Turn, s: Sample | None, v: Verdict | None, latch: Latch, dropped: int) -> Changing:
        """The fields that change with every message: of the last sample and its verdict, the latch, and how many inputs were ``dropped``."""
        stamp = round(s.t * 1e9) if s and math.isfinite(s.t) else 0
        first = latch.first
        # by their places: by name they take three times as long
        return Changing(
            stamp if 0 <= stamp <= U64 else min(max(0, stamp), U64),
            turn.state,
            CODES[v.conformance] if v else 0,
            self._number.get(first.first.joint, 0) if first else 0,
            latch.kind.code,
            turn.flags,
            min(latch.count, U32),
            v.oldest if v else 0.0,
            min(v.room.tolist()) if v and v.room is not None else -INFINITE,  # the array's own asks the system for memory
            s.bad_nodes if s else 0,
            dropped & U32,
        )

    def block(self, numbers: dict[str, Numbers], identity: Mapping[str, int]) -> dict[str, Any]:
        """The fields that stay, with ``identity``, while the stop numbers do: they are rounded once."""
        known, of, block = self._block
        if known is not numbers or of is not identity:
            block = {**identity, "holding_margin_min": min([x.margin for x in numbers.values()], default=-INFINITE)}
            for category in CATEGORIES:
                block |= stop_fields(PREFIX[category], numbers.get(category) or Numbers.none(self.n, "not asked for"))
            self._block = numbers, identity, block
        return block
