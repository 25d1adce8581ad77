"""State messages by themselves, as a monitor that packs one only."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from stopset.monitor.packer import Packer, Signer


def pack(values: Mapping[str, Any], signer: Signer | None = None) -> bytes:
    """One message, see `Packer`."""
    return Packer(signer).pack(values)
