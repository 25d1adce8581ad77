"""State messages by themselves, as a monitor that packs one only."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from stopset.monitor.authentication import Key
from stopset.monitor.packer import Packer


def pack(values: Mapping[str, Any], key: Key | None = None) -> bytes:
    """One message, see `Packer`."""
    return Packer(key).pack(values)
