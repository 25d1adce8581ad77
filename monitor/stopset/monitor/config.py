"""The daemon's configuration: one TOML file, read into frozen dataclasses; an unknown key is refused, never ignored."""

from __future__ import annotations

import dataclasses
import hashlib
import math
import os
import tomllib
import typing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, get_args, get_origin

from stopset.errors import StopsetError

Masses = tuple[
    float, float
]  # [kg] least and most; in the file a number alone stands for both, but 0 for nothing declared, as ever
LEAST_RECOVER = 0.05  # [s] without any, a good cycle between two bad ones is OK
LEAST_EVIDENCE = 0.02  # [s] without any, an arm is OK that has been held against nothing but the cycle before
EXPANDED = {"0": ("0",), "1": ("1", "1 guaranteed"), "2": ("2",)}  # what is bounded for a category that is asked for


TORQUES = (
    "actual_current_as_torque",
    "actual_current",
    "target_moment",
)  # of a controller, the nearer to a measurement, the earlier


class ConfigError(StopsetError):
    """The configuration cannot be used: mend the TOML file."""


@dataclass(frozen=True, slots=True)
class Bus:
    """Where the arm is heard on CAN. ``time_scale``: > 1 while a replay runs faster than life; 1 on a real arm."""

    link: str  # e.g. socketcan:can0, hub:28700, udp_multicast:239.74.163.2, serial:/dev/pts/3
    profile: str = "lwa4p/monitor"
    cycle_s: float = 0.0  # SYNC period; 0 = the profile's
    wait_s: float = 30.0  # for the bus to appear at start
    time_scale: float = 1.0


@dataclass(frozen=True, slots=True)
class JointStates:
    """Where the arm is heard on zenoh: JSON or CDR ``sensor_msgs/JointState``, one message per cycle of ``cycle_s``."""

    key: str
    cycle_s: float


@dataclass(frozen=True, slots=True)
class Rtde:
    """Where a Universal Robots controller is heard. ``torque``: the output that is nearest to a measurement of it; for
    ``actual_current`` with the ``torque_constant`` of each joint, link side [N m/A]."""

    host: str
    cycle_s: float = 0.002
    port: int = 30004
    torque: str = "actual_current_as_torque"
    torque_constant: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class Zenoh:
    """The session: a zenoh configuration ``file`` (TLS, access control), or these few settings. Nothing is scouted."""

    mode: str = "peer"
    listen: tuple[str, ...] = ("tcp/127.0.0.1:7447",)
    connect: tuple[str, ...] = ()
    file: str = ""


@dataclass(frozen=True, slots=True)
class Publish:
    """How often and how long-lived.

    ``valid_for_ms``: oldest data that OK is said for; ``stale_ms``: silence of the arm that makes the state FAULT;
    ``evidence_s``: how much is published with a violation; ``evidence_min_s``: OK needs a prediction at least this old;
    ``recover_s``: OK comes back only after cycles without a fault for this long.
    """

    json_hz: float = 5.0
    valid_for_ms: int = 30
    stale_ms: int = 200
    evidence_s: float = 1.0
    evidence_min_s: float = 0.1
    recover_s: float = 0.25


@dataclass(frozen=True, slots=True)
class Stops:
    """Which stops are bounded live; ``core_share``: part of a core that this may take in the long run, apart from the start.
    Reaction times before the drives act are the consumer's to add.

    The ramp of STOP 1 and 2: what the model holds from stop1 recordings, or stated here: every speed to rest in
    ``ramp_time_s``, or with ``ramp_deceleration`` [rad/s^2], begun within ``ramp_control_s``; power taken after
    ``ramp_off_after_s`` whatever happens (SS1-t, 0 = never), or when a ``ramp_monitored`` ramp is left (SS1-r).
    """

    categories: tuple[str, ...] = ("0", "1")
    ramp_time_s: float = 0.0
    ramp_deceleration: float = 0.0
    ramp_control_s: float = 0.024
    ramp_off_after_s: float = 0.0
    ramp_monitored: bool = False
    rate_hz: float = 40.0
    core_share: float = 0.1


@dataclass(frozen=True, slots=True)
class Plane:
    """The arm stays on the side where ``normal . p >= offset`` [m], in base coordinates; ``normal`` has any length but zero."""

    name: str
    normal: tuple[float, ...]
    offset: float


@dataclass(frozen=True, slots=True)
class StopLimits:
    """What a stop may take at most; margins to it are published in ``state/json``, for ``category`` ("": the first bounded).

    ``planes``: not to be passed by any link's axis, thickened by ``radius_m``; ``override``: also say by how much of the
    present speed the arm may go so that a stop keeps ``time_s``, ``angle_rad`` and ``tcp_m``: a process of its own.
    """

    category: str = ""
    time_s: float = float("inf")
    angle_rad: float = float("inf")
    tcp_m: float = float("inf")
    radius_m: float = 0.0
    planes: tuple[Plane, ...] = ()
    override: bool = False
    override_every_s: float = 2.0


@dataclass(frozen=True, slots=True)
class Records:
    """What is written down. ``folder``: "" = beside the journal; ``violations``: one file each, with ``before_s`` of readings
    before it; ``continuous``: everything too, in files of ``file_s``. Of each kind at most ``keep_mb`` are kept."""

    folder: str = ""
    violations: bool = True
    before_s: float = 2.0
    continuous: bool = False
    file_s: float = 600.0
    keep_mb: float = 1000.0


@dataclass(frozen=True, slots=True)
class Fallback:
    """Numbers to publish when the model is refuted or silent; infinite unless a worst-case table gives better ones."""

    time_s: float = float("inf")
    angle_rad: float = float("inf")
    tcp_m: float = float("inf")


@dataclass(frozen=True, slots=True)
class Signed:
    """Whose models are taken: files of public keys (none: unsigned ones too), and the least revision, so that none comes back."""

    keys: tuple[str, ...] = ()
    least_revision: int = 0


@dataclass(frozen=True, slots=True)
class Operator:
    """Who may clear a latched violation: the name for the log, and the file of the public key that proves it."""

    name: str
    key: str


@dataclass(frozen=True, slots=True)
class Config:
    """Everything the daemon is told. ``sha256``: of the file's text, published so that a change is seen.

    ``data_id``: this arm's, told to its consumers; ``keys``: key file of the authentication code, "" = no code; ``journal``:
    where a violation is remembered, "" = beside the configuration, or in systemd's state directory; ``must_remember``: a start without
    one is no first start but a loss, and latched, as is one after a life that the machine's power took; ``begun``: a file beside the
    configuration that tells one from the other, where it can be written. ``payload_kg``: surely on the flange, beyond the model's own;
    (0, 0) = surely nothing, None = not declared.
    """

    model: str
    data_id: int = field(kw_only=True)
    bus: Bus | None = None
    joint_states: JointStates | None = None
    rtde: Rtde | None = None
    site: str = "site"
    cell: str = "cell"
    arm: str = "arm"
    keys: str = ""
    journal: str = ""
    must_remember: bool = False
    payload_kg: Masses | None = None
    warm: tuple[float, ...] = (0.0, 1.0)  # place in the session, if known better: only for models with a warm-up
    realtime: bool = False  # lock memory; needs the limits of deploy/systemd, as the next two do
    priority: int = 0  # of the loop's thread, FIFO; 0 = as it is started
    cores: tuple[int, ...] = ()  # that it may run on; none = all
    zenoh: Zenoh = field(default_factory=Zenoh)
    publish: Publish = field(default_factory=Publish)
    stops: Stops = field(default_factory=Stops)
    fallback: Fallback = field(default_factory=Fallback)
    signed: Signed = field(default_factory=Signed)
    operators: tuple[Operator, ...] = ()  # none: whoever reaches the key ``reset``, under the name they give
    record: Records = field(default_factory=Records)
    limits: StopLimits = field(default_factory=StopLimits)
    sha256: str = ""
    begun: str = ""

    @property
    def prefix(self) -> str:
        return f"{self.site}/{self.cell}/{self.arm}/stopset"


def _build(kind: Any, x: Any, where: str) -> Any:
    origin = get_origin(kind)
    if type(None) in get_args(kind):
        return _build(next(a for a in get_args(kind) if a is not type(None)), x, where)
    if dataclasses.is_dataclass(kind):
        if not isinstance(x, dict):
            raise ConfigError(f"{where} is {x!r}; expected a table")
        hints = typing.get_type_hints(kind)
        known = {f.name for f in dataclasses.fields(kind)} - {"sha256", "begun"}
        if unknown := set(x) - known:
            raise ConfigError(
                f"{where or 'the configuration'} has the unknown key {', '.join(sorted(unknown))}; expected some of "
                f"{', '.join(sorted(known))}: check the spelling"
            )
        needed = {f.name for f in dataclasses.fields(kind) if f.default is f.default_factory is dataclasses.MISSING}
        if missing := needed - set(x):
            raise ConfigError(f"{where or 'the configuration'} lacks {', '.join(sorted(missing))}; add it")
        return kind(**{k: _build(hints[k], v, f"{where}.{k}".lstrip(".")) for k, v in x.items()})  # type: ignore[operator]
    if origin is tuple:
        if kind == Masses:
            if x == 0 and not isinstance(x, bool):
                return None  # cells have said so who meant that they do not know
            x = [x, x] if isinstance(x, int | float) else x
            if not (isinstance(x, list) and len(x) == 2):
                raise ConfigError(f"{where} is {x!r}; expected a number, or a list [least, most]")
        if not isinstance(x, list):
            tables = f" of tables, each headed [[{where}]]" if dataclasses.is_dataclass(get_args(kind)[0]) else ""
            raise ConfigError(f"{where} is {x!r}; expected a list{tables}")
        return tuple(_build(get_args(kind)[0], v, where) for v in x)
    if kind is float and isinstance(x, int) and not isinstance(x, bool):
        return float(x)
    if not isinstance(x, kind) or (kind is int and isinstance(x, bool)):
        raise ConfigError(f"{where} is {x!r}; expected {kind.__name__}")
    if (
        isinstance(x, str) and not x.isprintable()
    ):  # no file, key or address has them, and some calls end in an error of Python's own
        raise ConfigError(f"{where} is {x!r}; expected text without control characters")
    return x


def _ranges(config: Config) -> tuple[tuple[str, float, float, float], ...]:
    """Every number with its name, least and largest value."""
    return (
        ("bus.time_scale", config.bus.time_scale if config.bus else 1.0, 1e-3, 1e3),
        ("joint_states.cycle_s", config.joint_states.cycle_s if config.joint_states else 1.0, 1e-4, 1.0),
        ("rtde.cycle_s", config.rtde.cycle_s if config.rtde else 1.0, 1e-3, 1.0),
        ("rtde.port", config.rtde.port if config.rtde else 1, 1, 65535),
        ("publish.json_hz", config.publish.json_hz, 0.1, 50.0),
        ("publish.valid_for_ms", config.publish.valid_for_ms, 1, 1000),
        ("publish.stale_ms", config.publish.stale_ms, 1, 60000),
        ("publish.evidence_s", config.publish.evidence_s, 0.0, 10.0),
        ("publish.evidence_min_s", config.publish.evidence_min_s, LEAST_EVIDENCE, 10.0),
        ("publish.recover_s", config.publish.recover_s, LEAST_RECOVER, 60.0),
        ("stops.rate_hz", config.stops.rate_hz, 0.1, 1000.0),
        ("stops.core_share", config.stops.core_share, 1e-3, 16.0),
        ("stops.ramp_time_s", config.stops.ramp_time_s, 0.0, 10.0),
        ("stops.ramp_deceleration", config.stops.ramp_deceleration, 0.0, 1e3),
        ("stops.ramp_control_s", config.stops.ramp_control_s, 0.0, 10.0),
        ("stops.ramp_off_after_s", config.stops.ramp_off_after_s, 0.0, 10.0),
        ("data_id", config.data_id, 1, 2**32 - 1),
        ("priority", config.priority, 0, 98),  # above are the kernel's own threads
        ("the least of cores", min(config.cores, default=0), 0, 4095),
        ("the greatest of cores", max(config.cores, default=0), 0, 4095),
        ("bus.cycle_s", config.bus.cycle_s if config.bus else 0.0, 0.0, 1.0),
        ("bus.wait_s", config.bus.wait_s if config.bus else 0.0, 0.0, 86400.0),
        *(("payload_kg", x, 0.0, 1e4) for x in config.payload_kg or ()),
        ("signed.least_revision", config.signed.least_revision, 0, 10**6),
        ("record.before_s", config.record.before_s, 0.1, 10.0),
        ("record.file_s", config.record.file_s, 1.0, 86400.0),
        ("record.keep_mb", config.record.keep_mb, 1.0, 1e6),
        ("limits.time_s", config.limits.time_s, 1e-3, math.inf),
        ("limits.angle_rad", config.limits.angle_rad, 1e-6, math.inf),
        ("limits.tcp_m", config.limits.tcp_m, 1e-6, math.inf),
        ("limits.radius_m", config.limits.radius_m, 0.0, 10.0),
        ("limits.override_every_s", config.limits.override_every_s, 0.2, 3600.0),
        # a stop takes time and way: none at all is no worst case
        ("fallback.time_s", config.fallback.time_s, 1e-3, math.inf),
        ("fallback.angle_rad", config.fallback.angle_rad, 1e-6, math.inf),
        ("fallback.tcp_m", config.fallback.tcp_m, 1e-6, math.inf),
    )


def _check_rtde(path: Path, r: Rtde) -> None:
    """Raises `ConfigError` for a torque that no controller has, or without what makes one of a current."""
    if r.torque not in TORQUES:
        raise ConfigError(f"{path}: rtde.torque is {r.torque!r}; expected one of {', '.join(TORQUES)}")
    constants = r.torque_constant
    if len(constants) != (6 if r.torque == "actual_current" else 0) or not all(0.0 < k < 1e6 for k in constants):
        raise ConfigError(
            f"{path}: rtde.torque_constant is {list(constants)} beside {r.torque}; expected six numbers above 0 beside actual_current "
            "[N m/A, link side], and none else"
        )


def _same(a: Path, b: Path) -> bool:
    """Whether both name one file, there or not."""
    try:
        return a.resolve() == b.resolve() or (a.exists() and b.exists() and a.samefile(b))
    except (OSError, RuntimeError):  # a name that is too long, a link to itself: whoever opens it says so
        return False


def _placed(p: Path, config: Config, text: str) -> Config:
    """With file names from where the configuration ``p`` is, and the hash of its ``text``. Raises `ConfigError`."""
    here = p.parent
    zenoh = dataclasses.replace(config.zenoh, file=str(here / config.zenoh.file) if config.zenoh.file else "")
    state = Path(os.environ.get("STATE_DIRECTORY") or here)  # systemd's, see StateDirectory=
    journal = here / config.journal if config.journal else state / f"{p.stem}.latch"
    if not journal.name or os.path.isdir(journal):  # noqa: PTH112 - Path's raises for a name that is too long
        raise ConfigError(f"{p}: journal is {config.journal!r}, a folder; expected the name of a file")
    named = (p.name, config.model, config.keys, config.zenoh.file, *config.signed.keys, *(o.key for o in config.operators))
    if other := next((x for x in named if x and _same(here / x, journal)), ""):
        raise ConfigError(
            f"{p}: journal is {config.journal!r}, and so is {other}; expected a file of its own, for it is written over"
        )
    record = here / config.record.folder if config.record.folder else journal.with_name(f"{p.stem}.record")
    return dataclasses.replace(
        config, model=str(here / config.model), zenoh=zenoh,
        signed=dataclasses.replace(config.signed, keys=tuple(str(here / k) for k in config.signed.keys)),
        operators=tuple(dataclasses.replace(o, key=str(here / o.key)) for o in config.operators),
        sha256=hashlib.sha256(text.encode()).hexdigest(),
        keys=str(here / config.keys) if config.keys else "",
        journal=str(journal), begun=str(here / f".{p.name}.begun"), record=dataclasses.replace(config.record, folder=str(record)),
    )  # fmt: skip


def load_config(path: str | Path) -> Config:
    """Read a configuration; file names in it are relative to it. Raises `ConfigError` with one sentence."""
    p = Path(path)
    try:
        text = p.read_text(encoding="utf-8")
        raw = tomllib.loads(text)
    except FileNotFoundError as e:
        raise ConfigError(f"{p}: no such file; expected a TOML configuration: see deploy/stopset.toml.example") from e
    except (OSError, ValueError, RecursionError) as e:
        raise ConfigError(f"{p} is not readable TOML ({e}); mend it") from e
    config: Config = _build(Config, raw, "")
    if sum(x is not None for x in (config.bus, config.joint_states, config.rtde)) != 1:
        raise ConfigError(f"{p}: expected exactly one of [bus], [joint_states] and [rtde], the arm is heard on one of them")
    if config.rtde is not None:
        _check_rtde(p, config.rtde)
    for name, value, lo, hi in _ranges(config):
        if not lo <= value <= hi:
            raise ConfigError(f"{p}: {name} is {value}; expected {lo:g} to {hi:g}: mend it")
    if not (len(config.warm) == 2 and 0.0 <= config.warm[0] <= config.warm[1] <= 1.0):
        raise ConfigError(f"{p}: warm is {list(config.warm)}; expected [lo, hi] between 0 (cold) and 1 (as warm as identified)")
    if config.payload_kg is not None and config.payload_kg[0] > config.payload_kg[1]:
        raise ConfigError(f"{p}: payload_kg is {list(config.payload_kg)}; expected [least, most]: turn them round")
    if config.stops.ramp_time_s and config.stops.ramp_deceleration:
        raise ConfigError(f"{p}: stops.ramp_time_s and stops.ramp_deceleration are both given; expected one of them")
    if bad := [c for c in config.stops.categories if c not in ("0", "1", "2")]:
        raise ConfigError(f"{p}: stops.categories holds {bad[0]!r}; expected some of 0, 1, 2")
    if not config.stops.categories or len(set(config.stops.categories)) != len(config.stops.categories):
        raise ConfigError(
            f"{p}: stops.categories is {list(config.stops.categories)}; expected at least one of 0, 1, 2, each once: a monitor "
            "that bounds no stop has nothing to be OK about"
        )
    asked = [e for c in config.stops.categories for e in EXPANDED[c]]
    if config.limits.category and config.limits.category not in asked:
        raise ConfigError(f"{p}: limits.category is {config.limits.category!r}; expected one that is bounded: {', '.join(asked)}")
    for plane in config.limits.planes:
        size = math.hypot(*plane.normal) if len(plane.normal) == 3 else math.nan
        if not (1e-6 < size < 1e6 and abs(plane.offset) < 1e6):
            raise ConfigError(
                f"{p}: limits.planes {plane.name!r} has normal {list(plane.normal)}, offset {plane.offset}; expected three numbers, "
                "not all zero, and metres"
            )
    names = [o.name.strip() for o in config.operators]
    if any(not 1 <= len(n) <= 200 or not n.isprintable() for n in names) or len(set(names)) != len(names):
        raise ConfigError(f"{p}: operators are named {names}; expected names of 1 to 200 letters, each once: mend them")
    if raw.get("operators") == []:
        # as good as none to the monitor; whoever wrote it may have meant that nobody clears
        raise ConfigError(
            f"{p}: operators is empty; expected one at least, or no such key, then whoever reaches `reset` clears: say which"
        )
    for part in (config.site, config.cell, config.arm):
        if not part or any(c in part for c in "*/$#? "):
            raise ConfigError(f"{p}: site, cell and arm make up a zenoh key; {part!r} has an empty or special character")
    limits = dataclasses.replace(config.limits, category=config.limits.category or asked[0])
    return _placed(p, dataclasses.replace(config, limits=limits), text)
