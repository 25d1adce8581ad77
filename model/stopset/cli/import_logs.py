"""``stopset import``: logs of buses, ROS bags and tables of controllers to recordings."""

from __future__ import annotations

import argparse
from pathlib import Path

from stopset.cli.common import add_output_options, add_robot_options, check_outputs, say, write_json
from stopset.cli.steps import steps

HELP = "turn CAN logs, ROS bags, MCAP files or tables of other tools into recordings"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "log",
        type=Path,
        nargs="+",
        metavar="LOG",
        help="candump (.log, also as shown on the screen), .asc, .blf, .trc, these also .gz; .mcap, .db3, also .zstd, or a bag's folder, "
        ".bag (ROS 1); tables: .csv, .tsv, .txt, .dat, .npz, .mat, .parquet, of RTDE clients too",
    )
    parser.add_argument("--out", type=Path, required=True, metavar="REC.parquet", help="the recording to write")
    parser.add_argument("--profile", default="lwa4p/monitor", help="CAN: bus profile, name or path (default: %(default)s)")
    parser.add_argument(
        "--cycle", type=float, metavar="S",
        help="SYNC or message period in seconds (default: the profile's); of a table without stamps, the time between two rows",
    )  # fmt: skip
    parser.add_argument(
        "--effort", default="motor_torque", choices=("motor_torque", "compensated_torque"),
        help="what the torque signal is, which a log does not tell (default: %(default)s)",
    )  # fmt: skip
    parser.add_argument("--topic", default="/joint_states", help="MCAP, bags: topic of JointState (default: %(default)s)")
    parser.add_argument(
        "--joints", metavar="A,B,..",
        help="MCAP, bags: joints to keep, in this order (default: all); tables: names of the joints from base to flange "
        "(default: the robot's; of RTDE the maker's)",
    )  # fmt: skip
    parser.add_argument("--robot", metavar="URDF", help="tables: the joints are this robot's")
    add_robot_options(parser)
    parser.add_argument(
        "--columns", metavar="T=NAME,Q=PATTERN,..",
        help="tables: which columns hold time, angles, speeds, torques or currents where their names do not tell, e.g. "
        "'t=stamp,q=pos*,dq=vel*,tau=torque*'; of a table without a header their order, e.g. t,q,dq,tau (- for a block of others)",
    )  # fmt: skip
    parser.add_argument("--beside", action="store_true", help="tables: columns of one recording, row by row (q.csv tau.csv)")
    parser.add_argument("--degrees", action="store_true", help="tables: angles and speeds are in degrees")
    parser.add_argument(
        "--torque-constant",
        metavar="K,K,..",
        help="tables: torque per current of each joint, link side [N m/A]; below 0 where it counts against the joint",
    )
    add_output_options(parser)


def run(args: argparse.Namespace) -> int:
    from stopset.errors import RecordingError
    from stopset.monitor.bags import is_bag, meta_of_bag, trials_of_bag
    from stopset.monitor.logs import log_meta, trials_of_log
    from stopset.monitor.profile import load_profile
    from stopset.monitor.rtde import is_rtde, read_rtde
    from stopset.progress import counted
    from stopset.recording import Meta, Recording, write_recordings
    from stopset.recording.table import Stated, is_table, read_table

    check_outputs(args.out, args.json, args.report)
    if args.cycle is not None and not 1e-4 <= args.cycle <= 1.0:
        raise RecordingError(f"--cycle is {args.cycle}; expected seconds, from 0.0001 to 1")
    joints = tuple(args.joints.split(",")) if args.joints else None
    if joints and (twice := sorted({j for j in joints if joints.count(j) > 1})):
        raise RecordingError(
            f"--joints {args.joints} names {', '.join(twice)} twice; expected each joint once, from base to flange"
        )
    if (args.tip or args.lock) and not args.robot:
        raise RecordingError("--tip and --lock are of a robot, and none is given; expected its URDF: add --robot")
    constants = _numbers(args.torque_constant) if args.torque_constant else None
    stated = Stated(args.columns, joints or _joints_of(args.robot, args.tip, args.lock), args.degrees, constants, args.cycle)
    trials: list[Recording] = []
    meta: Meta | None = None
    with steps("import", args.log, quiet=args.quiet) as progress:
        if args.beside and not all(is_table(p) for p in args.log):
            raise RecordingError(
                "--beside is for tables whose columns are of one recording; expected tables: import logs without it"
            )
        for suite, path in enumerate(args.log[:1] if args.beside else args.log):
            if is_bag(path):
                found = list(counted(trials_of_bag(path, args.topic, joints, args.cycle, suite), None, path.name, progress))
                this = meta_of_bag(found, args.effort)
                trials += [r for r, _ in found]
            elif is_rtde(path) and args.columns is None and not args.beside:
                this, found_here, said = read_rtde(path, joints, constants, suite)
                trials += found_here
                say(f"{path.name}: torque is {said}")
            elif is_table(path):
                this, found_here, said = read_table(args.log if args.beside else [path], stated, args.effort, suite)
                trials += found_here
                say(f"{path.name}: {said}")
            else:
                profile = load_profile(args.profile)
                cycle = args.cycle or profile.cycle_s
                trials += counted(trials_of_log(path, profile, cycle, suite), None, path.name, progress)
                this = log_meta(profile, cycle, args.effort)
            if meta is not None and this.joints != meta.joints:
                raise RecordingError(
                    f"{path} holds joints {', '.join(this.joints)}, the first log {', '.join(meta.joints)}; import them apart"
                )
            meta = meta or this
    assert meta is not None  # nargs="+"
    write_recordings(args.out, meta, trials)
    samples = sum(len(r.t) for r in trials)
    say(f"{len(trials)} trials, {samples} samples to {args.out}, torque taken as {args.effort}")
    if args.json:
        write_json(
            args.json,
            {"out": str(args.out), "trials": len(trials), "samples": samples, "joints": meta.joints, "effort": args.effort},
        )
    if args.report:
        from stopset.offline.inspect.page import save

        save(args.report, [args.out], None)
        say(f"report {args.report}")
    return 0


def _joints_of(urdf: str | None, tip: str | None, lock: tuple[str, ...]) -> tuple[str, ...] | None:
    from stopset.offline.description import load_robot

    return load_robot(urdf, tip=tip, lock=lock).joints if urdf else None


def _numbers(text: str) -> tuple[float, ...]:
    """Numbers between commas. Raises `RecordingError`."""
    from stopset.errors import RecordingError

    try:
        return tuple(float(x) for x in text.split(","))
    except ValueError as e:
        raise RecordingError(
            f"--torque-constant {text}: expected numbers between commas, N m/A on the link side, e.g. 11.3,11.3,9.2"
        ) from e
