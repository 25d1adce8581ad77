"""The files an identification reads."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from stopset.errors import RecordingError
from stopset.recording import Meta, read_meta


def common_meta(paths: Sequence[str | Path]) -> Meta:
    metas = [read_meta(p) for p in paths]
    kinds = {m.effort for m in metas}
    if len(kinds) != 1:
        raise RecordingError(f"the recordings hold {' and '.join(sorted(kinds))}; one identification takes one kind of torque")
    return replace(
        metas[0], sources=tuple(s for m in metas for s in m.sources), warnings=tuple(w for m in metas for w in m.warnings)
    )
