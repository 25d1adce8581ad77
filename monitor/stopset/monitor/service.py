"""A configuration made into a running daemon: model, bus, zenoh session, journal, keys, signals, memory."""

from __future__ import annotations

import gc
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from stopset.artifact import Model
from stopset.artifact.signature import Accepted, load_trusted
from stopset.errors import BusError, NotCovered
from stopset.monitor.authentication import load_keys
from stopset.monitor.config import Config
from stopset.monitor.daemon import Beside, Daemon
from stopset.monitor.evidence.overheard import Overheard
from stopset.monitor.evidence.recorder import Recorder
from stopset.monitor.evidence.trace import Trace
from stopset.monitor.jointstate import MAX_BYTES
from stopset.monitor.journal import Journal
from stopset.monitor.journal_file import FileStore
from stopset.monitor.latch import Latch, Record
from stopset.monitor.links.bus import listen
from stopset.monitor.links.zenoh_link import ZenohLink
from stopset.monitor.opening import Opening
from stopset.monitor.profile import Profile, load_profile
from stopset.monitor.realtime import claim
from stopset.monitor.report import about, health
from stopset.monitor.rtde_source import RtdeSource
from stopset.monitor.source import BACKLOG, CanSource, JointStateSource, NoSource, SampleSource
from stopset.monitor.spawned import Spawned
from stopset.monitor.watch import check_cycle


def start(config: Config, begun: Spawned, seconds: float = 0.0) -> tuple[int, dict[str, Any]]:
    """Open everything the configuration names, run until SIGTERM or SIGINT (or ``seconds``), close. Exit code, last health.

    ``begun``: the process that will bound stops. SIGHUP reads the model anew.
    """
    granted = claim(lock=config.realtime, priority=config.priority, cores=config.cores, begun=(begun.process.pid,))
    profile = load_profile(config.bus.profile) if config.bus else None
    read = trusted(config)

    def load() -> Model:
        """On every reload too: what does not go with the arm's link is refused."""
        model = read()
        _cycle(config, model, profile)
        return model

    model = load()
    cycle_s = _cycle(config, model, profile)
    key = load_keys(config.keys).first if config.keys else None
    latch = Latch(Journal(FileStore(Path(config.journal), Record(), Path(config.begun), lost=config.must_remember)))
    z = config.zenoh
    link = ZenohLink(config.prefix, mode=z.mode, connect=z.connect, listen=z.listen, file=z.file or None, longest=MAX_BYTES)
    valid_for = config.publish.valid_for_ms * 1e-3  # older samples need not wait

    def open_source() -> SampleSource:
        if config.bus and profile:
            return CanSource(listen(config.bus.link), profile, cycle_s / config.bus.time_scale, valid_for)
        if config.rtde:
            return RtdeSource(config.rtde, valid_for)
        assert config.joint_states is not None
        source = JointStateSource(model.joints, cycle_s, max(BACKLOG, round(valid_for / cycle_s)))
        link.subscribe("/" + config.joint_states.key, source.take)
        return source

    def first_source() -> SampleSource:
        try:
            return open_source()
        except BusError:
            if profile is None or config.bus is None:
                raise
            return NoSource(profile, time.monotonic() + config.bus.wait_s)

    recorder = Recorder(Trace(model.n), config.record, Path(config.record.folder), cycle_s)
    try:
        daemon = Daemon(
            config, model, first_source(), Overheard(link, recorder), cycle_s,
            Beside(latch=latch, key=key, load=load, recorder=recorder, granted=granted, begun=begun),
        )  # fmt: skip
    except BaseException:
        link.close()
        raise
    recorder.about = lambda: about(daemon)
    recorder.heard = lambda first, last: daemon.source.heard(first, last)
    recorder.start()
    _signals(daemon, seconds)
    gc.collect()
    gc.freeze()
    gc.disable()  # the loop makes no circles: `benchmarks/monitor_long.py`
    try:
        code = daemon.run(Opening(open_source).turn)
        return code, health(daemon)
    finally:
        gc.enable()
        daemon.close()
        link.close()


def trusted(config: Config) -> Callable[[], Model]:
    """What reads the configuration's model, now and on every reload: only what an accepted key has signed, where keys are named."""
    accepted = Accepted.of(config.signed.keys, config.signed.least_revision)
    return lambda: load_trusted(config.model, accepted)


def _cycle(config: Config, model: Model, profile: Profile | None) -> float:
    """The period of the samples [s]; raises `NotCovered` if bus and model do not belong together."""
    if profile is not None and profile.joints != model.joints:
        raise NotCovered(
            f"the bus profile names {', '.join(profile.joints)}, the model {', '.join(model.joints)}; give the matching profile"
        )
    if config.rtde and (model.n != 6 or model.effort != "motor_torque"):
        raise NotCovered(
            f"the model has {model.n} joints and takes {model.effort}, a Universal Robots controller tells motor_torque of 6; give a model of "
            "its recordings"
        )
    cycle_s = config.joint_states.cycle_s if config.joint_states else config.rtde.cycle_s if config.rtde else 0.0
    if config.bus and profile:
        cycle_s = config.bus.cycle_s or profile.cycle_s
    check_cycle(model, cycle_s)
    return cycle_s


def _signals(daemon: Daemon, seconds: float) -> None:
    def stop(*_: object) -> None:
        daemon.stopping = True

    def reload(*_: object) -> None:
        daemon.reloading.asked = True

    for s in (signal.SIGTERM, signal.SIGINT):
        signal.signal(s, stop)
    signal.signal(signal.SIGHUP, reload)
    if seconds:
        signal.signal(signal.SIGALRM, stop)
        signal.setitimer(signal.ITIMER_REAL, seconds)
