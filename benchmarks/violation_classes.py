"""How often a fault of the arm is given its right class: ``python benchmarks/violation_classes.py [--seeds N] [--json FILE]``.

Every life has one fault, in the world of tests/monitor_world.py: real CANopen frames with their rounding, the real loop. Rows
of the table are what happened, columns what was said; ``joint`` is how often the joint was right, ``onset`` the median error.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from monitor_arm import DT, known_model
from monitor_faults import KINDS, Fault, Spring
from monitor_world import EPOCH, World
from stopset.artifact import Model, save_model
from stopset.monitor.evidence.cause import Kind

SPRING = "spring"  # appears, weak, in a motion of half a period: beside the table, as it has no class of its own
SECONDS, FROM = 1.35, (80, 140)  # of a life; cycles among which the fault begins


def life(kind: Kind, seed: int, path: Path, model: Model, make: type[Fault] = Fault) -> tuple[Fault, dict[str, Any] | None]:
    """The fault that was there, and the cause that was told; None if nothing was noticed."""
    rng = np.random.default_rng([seed, KINDS.index(kind) if make is Fault else 77])
    fault = make(kind, rng, int(rng.integers(*FROM)))
    world = World(seed, path, model, SECONDS, fault).live()
    events = [json.loads(e) for e in world.slow.get("event", [])]
    return fault, next((e["cause"] for e in events if e["kind"] == "bundle"), None)


def table(seeds: range, path: Path, model: Model) -> dict[str, Any]:
    """By kind: how often what was told, how often the joint was right, and the median error of the onset [s]."""
    out: dict[str, Any] = {}
    for name, kind, make in [*((k.value, k, Fault) for k in KINDS), (SPRING, Kind.MISSING_EFFECT, Spring)]:
        said, right, errors = Counter[str](), 0, []
        for seed in seeds:
            fault, cause = life(kind, seed, path, model, make)
            said["unnoticed" if cause is None else cause["kind"]] += 1
            if cause is not None:
                right += cause["joint"] in ("", model.joints[fault.joint])
                errors.append(abs(cause["t"] - EPOCH * 1e-9 - fault.at * DT))
        onset = float(np.median(errors)) if errors else None
        out[name] = {"said": dict(said), "joint_right": right, "onset_error_s": onset}
    return out


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--first", type=int, default=1000)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    path = Path(tempfile.mkdtemp()) / "arm.model.json"
    model = save_model(known_model(horizon=0.1), path)
    found = table(range(args.first, args.first + args.seeds), path, model)
    columns = [k.value for k in KINDS] + [Kind.UNCLASSED.value, "unnoticed"]
    print(" " * 15 + " ".join(f"{c[:11]:>11}" for c in columns) + "   joint  onset")
    for kind, row in found.items():
        counts = " ".join(f"{row['said'].get(c, 0):>11}" for c in columns)
        onset = "" if row["onset_error_s"] is None else f"{1e3 * row['onset_error_s']:.0f} ms"
        print(f"{kind:15}{counts}   {row['joint_right']:>5}  {onset}")
    right = sum(row["said"].get(kind, 0) for kind, row in found.items())
    print(f"{right} of {args.seeds * len(KINDS)} right")
    if args.json:
        args.json.write_text(json.dumps(found))
    return 0


if __name__ == "__main__":
    sys.exit(main())
