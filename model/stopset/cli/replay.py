"""``stopset replay``: a recording, or a log, as if the arm were moving now."""

from __future__ import annotations

import argparse
import math
import time
from pathlib import Path

HELP = "play a recording or log onto a CAN bus or zenoh, in real time or faster"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "recording", type=Path, metavar="REC|LOG", help="recording (Parquet, CSV), or a candump, ASC, BLF or TRC log"
    )
    parser.add_argument(
        "--to", required=True, metavar="BUS",
        help="INTERFACE:CHANNEL of python-can (socketcan:can0, udp_multicast:239.74.163.2, serial:/dev/pts/3, ...); hub:28700 "
        "serves a bus on loopback for several processes; zenoh:tcp/127.0.0.1:7447 sends joint_states",
    )  # fmt: skip
    parser.add_argument("--profile", default="lwa4p/monitor", help="bus profile (default: lwa4p/monitor)")
    parser.add_argument(
        "--yes-this-bus-is-not-a-robot",
        action="store_true",
        dest="no_robot",
        help="needed for buses that a real arm may be on: all but hub, virtual, serial, udp_multicast and zenoh",
    )
    parser.add_argument("--speed", type=float, default=1.0, metavar="X", help="X times real time; inf: as fast as possible")
    parser.add_argument("--trials", type=int, metavar="N", help="only the first N trials")
    parser.add_argument("--loop", action="store_true", help="begin again at the end, until interrupted")
    parser.add_argument("--wait", type=int, default=0, metavar="N", help="hub: wait for N listeners before the first frame")
    parser.add_argument("--key", default="site/cell/arm/joint_states", help="zenoh: key of joint_states")
    parser.add_argument("--encoding", choices=("json", "cdr"), default="json", help="zenoh: encoding of joint_states")


def run(args: argparse.Namespace) -> int:
    """Send all of it, or with ``--loop`` again and again until Ctrl-C or SIGTERM."""
    from stopset.cli.common import end_as_a_service_ends, say

    if not args.loop:
        return _send(args)
    end_as_a_service_ends()
    try:
        return _send(args)
    except KeyboardInterrupt:
        say("ended")
        return 0


def _send(args: argparse.Namespace) -> int:
    from itertools import chain, islice, repeat

    from stopset.cli.common import say
    from stopset.errors import BusError, RecordingError
    from stopset.monitor.links.bus import may_hold_a_robot, talk
    from stopset.monitor.links.hub import Hub
    from stopset.monitor.logs import LOG_SUFFIXES, log_suffix
    from stopset.monitor.profile import load_profile
    from stopset.monitor.replay import CanSink, JointStateSink, Sink, play, steps_of
    from stopset.recording import read_meta, stream_recordings

    if not args.speed > 0:
        raise BusError(f"--speed is {args.speed}; expected a positive number or inf")
    if not args.no_robot and may_hold_a_robot(args.to):
        raise BusError(
            f"--to {args.to} may be the bus of a real arm, whose master would take the replay for its drives; expected a bus "
            "without one: say --yes-this-bus-is-not-a-robot if it is"
        )
    if log_suffix(args.recording) in LOG_SUFFIXES:
        return _frames(args)
    first = next(stream_recordings(args.recording, garbled=True))
    steps_of(first, stamped=args.to.startswith("zenoh"))
    joints = read_meta(args.recording).joints
    link = None
    hub: Hub | None = None
    sink: Sink
    if args.to.startswith("zenoh"):
        from stopset.monitor.links.zenoh_link import ZenohLink

        where = args.to.partition(":")[2] or "tcp/127.0.0.1:7447"
        link = ZenohLink(mode="client", connect=[where])
        sink = JointStateSink(link.fast(args.key), joints, args.encoding == "cdr")
        time.sleep(0.5)  # subscriptions travel to this session before the first sample does
    else:
        profile = load_profile(args.profile)
        if profile.joints != joints:
            raise RecordingError(
                f"{args.recording} records {', '.join(joints)}, profile {profile.name} has {', '.join(profile.joints)}; "
                "give the matching profile"
            )
        talker = talk(args.to)
        hub = talker if isinstance(talker, Hub) else None
        sink = CanSink.of(talker, profile)
    times = repeat(None) if args.loop else [None]
    try:
        while hub is not None and hub.clients < args.wait:
            time.sleep(0.05)
        trials = chain.from_iterable(islice(stream_recordings(args.recording, garbled=True), args.trials) for _ in times)
        sent, late = play(trials, sink, args.speed)
    finally:
        sink.close()
        if link is not None:
            link.close()
    pace = (
        "as fast as possible"
        if math.isinf(args.speed)
        else f"at {args.speed:g} times real time, latest sample {late * 1e3:.1f} ms late"
    )
    heard = f"; the other nodes sent {hub.client_frames} frames" if hub is not None else ""
    say(f"{sent} samples to {args.to}, {pace}{heard}")
    return 0


def _frames(args: argparse.Namespace) -> int:
    """The frames of a bus's log as they were, less those that no drive sends."""
    from stopset.cli.common import say
    from stopset.monitor.links.bus import talk
    from stopset.monitor.logs import play_log
    from stopset.monitor.profile import load_profile

    profile = load_profile(args.profile)
    bus = talk(args.to)
    try:
        frames, withheld = play_log(args.recording, bus.send, args.speed, profile)
    finally:
        bus.close()
    say(f"{frames} frames of {args.recording.name} sent to {args.to}; {withheld} kept back that no drive of the profile sends")
    return 0
