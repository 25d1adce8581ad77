"""A configuration made into a running daemon: model, bus, zenoh session, signals, memory."""

from __future__ import annotations

import ctypes
import gc
import signal
import time
from typing import Any

from stopset.artifact import load_model
from stopset.errors import BusError, NotCovered
from stopset.monitor.config import Config
from stopset.monitor.daemon import Daemon
from stopset.monitor.links.bus import listen
from stopset.monitor.links.zenoh_link import ZenohLink
from stopset.monitor.profile import load_profile
from stopset.monitor.source import CanSource, JointStateSource, NoSource, Source
from stopset.monitor.watch import check_cycle


def start(config: Config, seconds: float = 0.0) -> tuple[int, dict[str, Any]]:
    """Open everything the configuration names, run until SIGTERM or SIGINT (or ``seconds``), close. Exit code, last twin."""
    model = load_model(config.model)
    z = config.zenoh
    profile = load_profile(config.bus.profile) if config.bus else None
    if profile is not None and profile.joints != model.joints:
        raise NotCovered(
            f"the bus profile names {', '.join(profile.joints)}, the model {', '.join(model.joints)}; give the matching profile"
        )
    cycle_s = config.joint_states.cycle_s if config.joint_states else 0.0
    if config.bus and profile:
        cycle_s = config.bus.cycle_s or profile.cycle_s
    check_cycle(model, cycle_s)
    link = ZenohLink(config.prefix, mode=z.mode, connect=z.connect, listen=z.listen, file=z.file or None)

    def open_source() -> Source:
        if config.bus and profile:
            return CanSource(listen(config.bus.link), profile, cycle_s / config.bus.time_scale)
        assert config.joint_states is not None
        source = JointStateSource(model.joints, cycle_s)
        link.subscribe("/" + config.joint_states.key, source.take)
        return source

    def first_source() -> Source:
        try:
            return open_source()
        except BusError:
            if profile is None or config.bus is None:
                raise
            return NoSource(profile, time.monotonic() + config.bus.wait_s)

    try:
        daemon = Daemon(config, model, first_source(), link, cycle_s)
    except BaseException:
        link.close()
        raise

    def stop(*_: object) -> None:
        daemon.stopping = True

    for s in (signal.SIGTERM, signal.SIGINT):
        signal.signal(s, stop)
    if seconds:
        signal.signal(signal.SIGALRM, stop)
        signal.setitimer(signal.ITIMER_REAL, seconds)
    if config.realtime:
        ctypes.CDLL(None, use_errno=True).mlockall(3)
    gc.collect()
    gc.freeze()
    try:
        code = daemon.run(open_source)
        return code, daemon.health()
    finally:
        daemon.close()
        link.close()
