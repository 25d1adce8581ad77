"""What the columns of another tool's table hold, by their names: which quantity, of which joint.

``q1``, ``position_0``, ``tau_J_3``, ``field.effort2``, ``/joint_states/elbow_joint/velocity``: one word of a name says the quantity, the
others the joint.  What was asked of the arm (desired, target, command) is not what it did, and is passed over.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

from stopset.errors import RecordingError

KINDS = {
    "t": frozenset({"t", "time", "timestamp", "timestamps", "stamp", "times"}),
    "q": frozenset({"q", "pos", "position", "positions", "angle", "angles", "theta"}),
    "dq": frozenset({"dq", "qd", "qdot", "dotq", "vel", "velocity", "velocities", "speed", "speeds", "omega"}),
    "tau": frozenset({"tau", "torque", "torques", "effort", "efforts", "eff", "trq", "moment", "moments"}),
    "i": frozenset({"i", "current", "currents", "curr", "cur"}),
}
NOT_DONE = frozenset(
    {"d", "des", "desired", "target", "cmd", "command", "commanded", "ref", "reference", "goal", "set", "setpoint", "planned"}
)
NOT_OURS = frozenset(
    {"ext", "external", "error", "err", "tcp", "ee", "cartesian", "acc", "acceleration", "ddq", "qdd", "qddot", "ddotq", "jerk"}
)
FILLING = frozenset({"actual", "measured", "meas", "msr", "field", "msg", "state", "states", "joint", "joints", "j", "axis", "a"})
UNITS = frozenset({"deg", "degrees", "rad", "radians", "s", "ms", "us", "ns", "sec", "nm", "n", "m", "amp", "ma"})
KNOWN = frozenset().union(*KINDS.values(), NOT_DONE, NOT_OURS, FILLING, UNITS)
JointWords = tuple[str, ...]  # what is left of a column's words without its quantity's: the joint
SHOWN = 8  # columns of a table in a sentence
DO = "state them, e.g. --columns 't=stamp,q=pos*,dq=vel*,tau=torque*'"


@dataclass(frozen=True, slots=True)
class TableColumns:
    """Columns of a table by what they hold, one of each joint in this order; without speeds or currents none of these."""

    t: str | None
    q: tuple[str, ...]
    dq: tuple[str, ...]
    tau: tuple[str, ...]  # torques, or
    i: tuple[str, ...]  # currents where there are none
    joints: tuple[str, ...]

    def __str__(self) -> str:
        said = [f"t = {self.t}"] if self.t else []
        for kind in ("q", "dq", "tau", "i"):
            if names := getattr(self, kind):
                said.append(f"{kind} = {names[0]}" + (f" .. {names[-1]}" if len(names) > 1 else ""))
        return ", ".join(said)


def words(name: str) -> tuple[str, ...]:
    """The words and numbers of a column's name, small: of dataDotQ_NF_1 data, dotq, nf and 1."""
    found: list[str] = []
    for piece in re.findall(r"[A-Za-z]+|\d+", name):
        rest = [piece] if piece.lower() in KNOWN else re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+", piece)
        while rest:  # letters that make a known word together are one: DotQ is a speed, and no Q
            together = next((k for k in range(len(rest), 1, -1) if "".join(rest[:k]).lower() in KNOWN), 1)
            found.append("".join(rest[:together]).lower())
            rest = rest[together:]
    return tuple(found)


def by_name(names: Sequence[str], joints: Sequence[str] | None) -> TableColumns:
    """The columns of a table with a header, of ``joints`` where they are known. Raises `RecordingError` where names do not tell."""
    found: dict[str, dict[JointWords, str]] = {kind: {} for kind in KINDS}
    for name in names:
        kind, joint = _meaning(name)
        if kind:
            found[kind].setdefault(joint, name)
    stamps = list(found.pop("t").values())
    for columns in found.values():
        columns.pop((), None)  # of no joint
    keys = _joints(found["q"], joints, names)
    picked = {"q": tuple(found["q"][k] for k in keys)}
    counted = _by_number(found["q"]) == picked["q"]
    for kind in ("dq", "tau", "i"):
        if kind == "i" and picked["tau"]:
            picked["i"] = ()  # torques need none
            continue
        of_these = tuple(found[kind][k] for k in keys if k in found[kind])
        picked[kind] = ((_by_number(found[kind]) if counted else None) or of_these) if found[kind] else ()
        if len(picked[kind]) != len(keys) and found[kind]:
            raise RecordingError(
                f"the columns {_few(list(found[kind].values()))} are not one for each of {_few(picked['q'])}; expected as many: {DO}"
            )
    return TableColumns(_time(stamps), **picked, joints=tuple(joints or _called(keys)))


def _meaning(name: str) -> tuple[str, JointWords]:
    """Quantity and joint of a column; no quantity where its name does not say one, or one that is not measured of a joint."""
    said = words(name)
    kinds = [(kind, w) for w in said for kind, known in KINDS.items() if w in known]
    if not kinds or (NOT_DONE | NOT_OURS) & set(said):
        return "", ()
    own = set(words(name.rpartition(".")[2]))
    if own and own <= KINDS["t"]:  # positions.t, of a file whose name says what else it holds
        return "t", ()
    kind, word = next((x for x in kinds if x[0] not in ("t", "i")), kinds[0])
    return kind, tuple(w for w in said if w != word and w not in FILLING | UNITS)


def _joints(q: Mapping[JointWords, str], joints: Sequence[str] | None, names: Sequence[str]) -> list[JointWords]:
    """What the columns of angles call the joints, from base to flange."""
    if not q:
        raise RecordingError(f"no column tells the joints' angles (it has {_few(names)}); expected some: {DO}")
    if joints is not None:
        named = [tuple(w for w in words(j) if w not in FILLING | UNITS) for j in joints]
        ends = [[k for k in q if n and k[-len(n) :] == n] for n in named]
        if all(len(e) == 1 for e in ends) and len({e[0] for e in ends}) == len(ends):
            return [e[0] for e in ends]
        q = _bare(q)
        if len(q) != len(joints):
            raise RecordingError(
                f"{len(q)} columns tell angles ({_few(list(q.values()))}) of {len(joints)} joints ({', '.join(joints)}); expected one of each: {DO}"
            )
    q = _bare(q)
    place = {name: k for k, name in enumerate(_by_number(q) or q.values())}
    return sorted(q, key=lambda k: place[q[k]])


def _bare(columns: Mapping[JointWords, str]) -> Mapping[JointWords, str]:
    """Of several columns of each joint those with its number and no further word, as Position1 beside PositionComputed1; else all."""
    bare: dict[JointWords, str] = {k: name for k, name in columns.items() if len(k) == 1 and k[0].isdigit()}
    return bare if {k[-1:] for k in columns} == set(bare) else columns


def _by_number(columns: Mapping[JointWords, str]) -> tuple[str, ...] | None:
    """Columns by the number that each ends with; None where they are not told by numbers."""
    numbers = [k[-1] for k in columns]
    if len(set(numbers)) < len(numbers) or not all(n.isdigit() for n in numbers):
        return None
    return tuple(columns[k] for k in sorted(columns, key=lambda k: int(k[-1])))


def _called(keys: Sequence[JointWords]) -> tuple[str, ...]:
    """Names of the joints where only the columns tell them, without what all of them begin with."""
    if all(k[-1].isdigit() for k in keys):
        return tuple(f"joint_{n}" for n in range(1, len(keys) + 1))
    same = 0
    while len(keys) > 1 and all(len(k) > same + 1 and k[same] == keys[0][same] for k in keys):
        same += 1
    return tuple("_".join(k[same:]) for k in keys)


def _time(names: Sequence[str]) -> str | None:
    """The sample's own stamp, where it has one beside that of the writing."""
    return next((n for n in names if "stamp" in words(n)), names[0] if names else None)


def asked(names: Sequence[str], text: str, joints: Sequence[str] | None) -> TableColumns:
    """The columns that ``--columns`` states: ``t=NAME,q=PATTERN,..`` of a table with a header, in the table's order.

    Raises `RecordingError`.
    """
    found: dict[str, tuple[str, ...]] = {}
    for part in text.split(","):
        kind, equals, pattern = part.strip().partition("=")
        if kind not in KINDS or not equals:
            raise RecordingError(
                f"--columns {text}: {part!r} is no t=, q=, dq=, tau= or i= with a column's name or pattern; {DO}"
            )
        hit = tuple(n for n in names if fnmatchcase(n, pattern)) or tuple(
            n for n in names if fnmatchcase(n.lower(), pattern.lower())
        )
        if not hit:
            raise RecordingError(
                f"--columns {part}: no such column; expected some of {_few(names)}: give names as they stand there"
            )
        found[kind] = (*found.get(kind, ()), *hit)
    taken = [n for hit in found.values() for n in hit]
    if twice := sorted({n for n in taken if taken.count(n) > 1}):
        raise RecordingError(f"--columns {text} takes {_few(twice)} twice; expected each column once: name them more closely")
    q = found.get("q", ())
    lengths = {kind: len(x) for kind, x in found.items() if kind != "t"}
    if not q or len(set(lengths.values())) > 1 or len(found.get("t", ("t",))) != 1:
        got = ", ".join(f"{len(x)} of {kind}" for kind, x in found.items())
        raise RecordingError(
            f"--columns {text} names {got}; expected one column of t and as many of each other as there are joints: narrow the patterns (? is one "
            "character), e.g. q=position?"
        )
    return _stated(found, len(q), joints)


def in_blocks(width: int, text: str | None, joints: Sequence[str] | None) -> tuple[list[str], TableColumns]:
    """Names made for a table of ``width`` columns without a header, and what they hold: ``--columns t,q,dq,tau``, ``-`` for what is none.

    Raises `RecordingError`.
    """
    blocks = [b.strip() for b in (text or "").split(",")]
    if text is None or set(blocks) - {*KINDS, "-"} or "q" not in blocks:
        raise RecordingError(
            "no header says what its columns hold; state the order of their blocks: --columns t,q,dq,tau (- for a block of others)"
        )
    if joints is None:
        raise RecordingError(
            "no header says how many joints its columns are of; name them: --robot URDF, or --joints A,B,.. from base to flange"
        )
    n = len(joints)
    if width != blocks.count("t") + n * (len(blocks) - blocks.count("t")):
        raise RecordingError(
            f"--columns {text}: {width} columns are not one of t and {len(blocks) - blocks.count('t')} blocks of {n} joints; expected all columns in "
            "their order, - for a block of others"
        )
    made: list[str] = []
    found: dict[str, tuple[str, ...]] = {}
    for place, kind in enumerate(blocks):
        block = ["t"] if kind == "t" else [f"{kind}_{place}_{k}" for k in range(1, n + 1)]
        made += block
        found[kind] = tuple(block)
    found.pop("-", None)
    return made, _stated(found, n, joints)


def _stated(found: dict[str, tuple[str, ...]], n: int, joints: Sequence[str] | None) -> TableColumns:
    if joints is not None and len(joints) != n:
        raise RecordingError(f"--columns states {n} joints, and {len(joints)} are named ({', '.join(joints)}); expected as many")
    named = tuple(joints or (f"joint_{k}" for k in range(1, n + 1)))
    t = found.get("t", (None,))[0]
    return TableColumns(t, found["q"], found.get("dq", ()), found.get("tau", ()), found.get("i", ()), named)


def _few(names: Sequence[str]) -> str:
    return ", ".join(names[:SHOWN]) + (" ..." if len(names) > SHOWN else "")
