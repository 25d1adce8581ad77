"""How often the diagnosis is right, on campaigns of the simulated arm that were not used to set anything.

    python benchmarks/diagnosis.py --seed 100 --healthy 10 --out results.json
    python benchmarks/diagnosis.py --effects stribeck,delay --size hard

Per case: what was hidden, the verdict, the ranked effects, the largest leftover variance, the seconds
of processor time.  The summary counts effect and
joint right together, false claims on healthy campaigns and abstentions on causes outside the catalogue.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import time
from pathlib import Path
from typing import Any

from stopset.offline.description import load_robot
from stopset.offline.diagnose import diagnose
from stopset.recording import Recordings
from stopset.simulation import prepare

EFFECTS = (
    "thermal_viscous", "warm_up", "self_heating", "stribeck", "load_coulomb", "asymmetric_coulomb", "cubic_viscous", "payload", "rotor_inertia",
    "elasticity", "torque_ripple", "hysteresis", "torque_gain", "delay", "base_tilt", "spring", "coupling",
)  # fmt: skip
OUTSIDE = ("outside_bump", "outside_walk", "outside_resonance", "outside_weave")


def case(robot: str, hide: list[str], seed: int, size: str, cad: str) -> dict[str, Any]:
    """Simulate one campaign, diagnose it, and compare with what was hidden."""
    scenario = prepare(load_robot(robot), hide, seed, "compact", size, cad)
    meta = dataclasses.replace(scenario.meta, sources=())
    recordings = Recordings(meta, tuple(scenario.recordings()))
    start = time.process_time()
    found = diagnose(scenario.robot, recordings)
    spent = time.process_time() - start
    hidden = scenario.truth["effects"]
    wanted = scenario.truth["verdict"]
    right = found.verdict == wanted
    if wanted == "missing" and right:
        top = found.ranked[: len(hidden)]
        right = all(
            any(r.effect == h["effect"] and (not r.joints or set(r.joints) & set(h["joints"])) for r in top) for h in hidden
        )
    return {
        "hidden": [f"{h['effect']}:{h['joint']}" for h in hidden], "seed": seed, "size": size, "cad": cad, "wanted": wanted,
        "reached": [h["ratio_achieved"] for h in hidden], "verdict": found.verdict, "right": right,
        "ranked": [[r.label, round(r.score, 1)] for r in found.ranked], "depends_on": found.depends_on, "seconds": spent,
        "leftover": max(found.excess.values(), default=0.0),
    }  # fmt: skip


def main() -> None:
    """Run the cases asked for and print one line each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", default="lwa4p")
    parser.add_argument("--seed", type=int, default=100, help="first seed; every case takes the next one")
    parser.add_argument("--healthy", type=int, default=0, help="healthy campaigns")
    parser.add_argument("--effects", default="", help="comma-separated effects, or 'all', 'outside'; a+b hides two at once")
    parser.add_argument("--size", choices=("easy", "hard"), default="easy")
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    named = {"all": EFFECTS, "outside": OUTSIDE, "": ()}.get(args.effects, tuple(args.effects.split(",")))
    wanted = [["none"]] * args.healthy + [name.split("+") for name in named]
    rows = []
    for k, hide in enumerate(wanted):
        row = case(args.robot, hide, args.seed + k, args.size, "wrong" if k % 2 else "exact")
        rows.append(row)
        mark = "ok   " if row["right"] else "WRONG"
        print(mark, row["seed"], row["cad"], row["hidden"], row["reached"], "->", row["verdict"], row["ranked"],
              row["depends_on"], f"leftover {row['leftover']:.2f}, {row['seconds']:.1f} s", flush=True)  # fmt: skip
    for verdict in ("none", "missing", "unknown"):
        group = [r["right"] for r in rows if r["wanted"] == verdict]
        if group:
            print(f"wanted {verdict}: {sum(group)} of {len(group)} right")
    if args.out:
        args.out.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
