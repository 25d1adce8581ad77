"""``stopset monitor``: the daemon."""

from __future__ import annotations

import argparse
from pathlib import Path

HELP = "watch a running arm: conformance and stop bounds, published on zenoh"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--config", type=Path, required=True, metavar="C.toml", help="what to listen to and where to publish")
    parser.add_argument("--seconds", type=float, default=0.0, metavar="S", help="end after this time (default: never)")


def run(args: argparse.Namespace) -> int:
    from stopset.cli.common import mention
    from stopset.monitor.config import load_config
    from stopset.monitor.spawned import Spawned

    config = load_config(args.config)
    import stopset.monitor.stopworker  # noqa: F401 - what both processes need, loaded while there is one

    begun = Spawned.bounding_stops(copied=True)
    from stopset.monitor.report import NOTICE
    from stopset.monitor.service import start

    heard = config.bus.link if config.bus else config.joint_states.key if config.joint_states else ""
    if config.rtde:
        heard = f"the controller at {config.rtde.host}:{config.rtde.port}"
    # a client listens nowhere, whatever stands in the configuration
    listened = () if config.zenoh.mode == "client" else config.zenoh.listen
    where = config.zenoh.file or ", ".join([*listened, *config.zenoh.connect])
    mention(f"listening to {heard}, publishing {config.prefix}/** on {where}; stop with Ctrl-C")
    mention(NOTICE)
    code, health = start(config, begun, args.seconds)
    mention(f"{health['samples']} samples, {health['gaps']} gaps, {health['faults']} faults")
    return code
