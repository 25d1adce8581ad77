"""What the monitor says of a good arm, driven to its bounds, whose stamps jitter: ``python benchmarks/monitor_jitter.py [--seeds 8]``.

250 Hz; stamps scatter normally about their cycles, either because the arm was read late or because it was stamped late; some messages
are lost on the way.  A row counts verdicts of all seeds, 2,000 cycles each.  Any violation is a good arm accused.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from stopset.monitor.verdict import Conformance
from test_monitor_jitter import truly_late, verdicts

SAMPLES, FIRST = 2000, 100
SCATTER = (0.2e-3, 0.5e-3, 1e-3, 1.5e-3)  # [s]
LOSSES = (0, 5)  # messages of a seed


def said(scatter: float, losses: int, seeds: int, *, read_late: bool) -> Counter[Conformance]:
    """Verdicts of all seeds together."""
    out = Counter[Conformance]()
    for seed in range(FIRST, FIRST + seeds):
        rng = np.random.default_rng(seed)
        off, lost = rng.normal(0.0, scatter, SAMPLES), rng.integers(50, SAMPLES, losses).tolist()
        out += verdicts(truly_late(seed, SAMPLES, off if read_late else np.zeros(SAMPLES)), off, lost)
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=8)
    seeds = parser.parse_args().seeds
    for scatter in SCATTER:
        for losses in LOSSES:
            for read_late in (True, False):
                x = said(scatter, losses, seeds, read_late=read_late)
                print(
                    f"{scatter * 1e3:.1f} ms, {losses * seeds:2} lost of {SAMPLES * seeds}, {'read' if read_late else 'stamped'} late: "
                    + ", ".join(
                        f"{x[c]} {c.name.lower()}" for c in (Conformance.CONFORMANT, Conformance.UNKNOWN, Conformance.VIOLATION)
                    ),
                    flush=True,
                )


if __name__ == "__main__":
    main()
