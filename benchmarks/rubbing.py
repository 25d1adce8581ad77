"""Friction at each joint's usual speed with all of the rigid body fitted beside it: what tells a torque that lacks a part (`rubbing`).

python benchmarks/rubbing.py URDF RECORDING...
"""

from __future__ import annotations

import argparse

from stopset.effects.selection import usual_friction
from stopset.offline.description import load_robot
from stopset.offline.inspect.findings_torque import pushed
from stopset.offline.nominal.normal_equations import accumulate
from stopset.offline.nominal.scale import rubbing
from stopset.recording import stream_recordings


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("urdf")
    parser.add_argument("recordings", nargs="+")
    args = parser.parse_args()
    robot = load_robot(args.urdf)
    seen = rubbing(robot, accumulate(robot, stream_recordings(args.recordings, robot), usual_friction(), compensated=False))
    wrong = {f.joint for f in pushed(seen, robot.joints)}
    for j, name in enumerate(robot.joints):
        friction = f"{seen.dry[j]:.3g} + {seen.wet[j]:.3g} = {seen.dry[j] + seen.wet[j]:.3g} +- {seen.std[j]:.1g} N m"
        print(f"{name}: {friction}, {seen.slope[j]:.3g} N m s/rad{', no friction' if name in wrong else ''}")


if __name__ == "__main__":
    main()
