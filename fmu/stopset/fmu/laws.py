"""The model's effects as C: each law is evaluated once over C text and becomes a line of the FMU."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stopset.artifact import Model
from stopset.artifact.inputs import compensated
from stopset.effects import REFERENCE_TEMPERATURE, Effect, Fitted, Shape, Signals, Term, get
from stopset.effects.memory import affine
from stopset.errors import EffectError
from stopset.ring import CText

# what a law may look at in the FMU; the rest needs accelerations
AVAILABLE = {"q", "dq", "temp", "warm", "load", "tau", "link", "coriolis", "tilt", "stiff", "dq_other", "memory", "none"}


@dataclass(frozen=True, slots=True)
class EffectParameter:
    """One number of one effect, as the FMU's parameter ``name``."""

    name: str
    unit: str
    means: str
    value: float


def parameters_of(effect: Effect) -> list[Term | Shape]:
    """Terms, then shapes."""
    return [*effect.terms, *effect.shapes]


def active_effects(model: Model) -> list[tuple[Fitted, Effect]]:
    """The effects that the input compensates; raises `EffectError` for one whose law the FMU cannot evaluate."""
    out = []
    for f in compensated(model.effects, model.abstraction):
        effect = get(f.effect)
        beyond = sorted(set(effect.needs) - AVAILABLE)
        if beyond:
            raise EffectError(
                f"effect {f.label} looks at {', '.join(beyond)}, which an FMU input does not carry; "
                f"expected effects of {', '.join(sorted(AVAILABLE - {'none'}))}: export a revision without it"
            )
        if effect.states and (f.joint is None or not affine(effect)):
            raise EffectError(
                f"effect {f.label} remembers {', '.join(x.symbol for x in effect.states)}; an FMU carries one state per effect whose "
                "law and flow are affine in it: export a revision without it"
            )
        out.append((f, effect))
    return out


@dataclass(frozen=True, slots=True)
class Remembered:
    """A state of an effect, as the FMU's variable ``name``; it begins at ``start``."""

    name: str
    start_name: str
    unit: str
    means: str
    start: float


def remembered(model: Model) -> tuple[Remembered, ...]:
    """What the active effects remember, in the order of the C array."""
    return tuple(
        Remembered(
            f"{e.name}_{x.symbol}_{f.joint}", f"{e.name}_{x.symbol}_start_{f.joint}", x.unit, f"{x.means} ({e.name}, {f.joint})", z
        )
        for f, e in active_effects(model)
        for x, z in zip(e.states, e.at_start, strict=True)
    )  # fmt: skip


def effect_parameters(model: Model) -> tuple[EffectParameter, ...]:
    """Every term and shape of every active effect, in the order of the C array."""
    out = []
    for f, effect in active_effects(model):
        at = f.joint or "arm"
        for p in parameters_of(effect):
            what = f"{p.means} ({effect.name}, {at})"
            out.append(EffectParameter(f"{effect.name}_{p.symbol}_{at}", p.unit, what, f.values[p.symbol]))
    return tuple(out)


def _signals(j: int) -> Signals:
    """The C names of what a law looks at, for joint ``j``."""

    def text(name: str) -> CText:
        return CText(f"{name}[{j}]")

    return Signals(
        q=text("q"), dq=text("dq"), way=text("way"), load=text("load"), tau=text("bias"), link=text("bias"),
        temp=CText(f"(s->r[VR_TEMP + {j}] - {REFERENCE_TEMPERATURE!r})"), warm=CText("s->r[VR_WARM]"),
        tilt=(CText(f"roll[{j}]"), CText(f"pitch[{j}]")), stiff=text("stiff"), coriolis=CText(f"(bias[{j}] - load[{j}])"),
    )  # fmt: skip


def _joints(f: Fitted, effect: Effect, joints: Sequence[str]) -> list[tuple[int, Signals]]:
    if f.joint is None or effect.scope == "arm":
        return [(j, _signals(j)) for j in range(len(joints))]
    if effect.scope == "pair":
        names = f.joint.split("+")
        i = joints.index(names[0])
        k = joints.index(names[1]) if len(names) > 1 else min(i + 1, len(joints) - 1)
        a, b = _signals(i), _signals(k)
        return [(i, replace(a, dq_other=b.dq)), (k, replace(b, dq_other=a.dq))]
    j = joints.index(f.joint)
    return [(j, _signals(j))]


@dataclass(frozen=True, slots=True)
class Laws:
    """The C functions of all effects, and what they use."""

    c: str
    effects: bool
    direction: bool
    load: bool


def effect_laws(model: Model) -> Laws:
    """``stopset_effects`` of the C core, the torque of all active effects at a state, and ``stopset_memory_rates``."""
    torques: list[str] = []
    rates: list[str] = []
    at = 0
    for f, effect in active_effects(model):
        symbols = [p.symbol for p in parameters_of(effect)]
        values = {symbol: CText(f"s->r[VR_EFFECT + {at + k}]") for k, symbol in enumerate(symbols)}
        at += len(symbols)
        for j, signals in _joints(f, effect, model.joints):
            if effect.states:
                signals = replace(signals, memory=(CText(f"memory[{len(rates)}]"),))
            torques.append(f"    tau[{j}] += {effect.torque(signals, values)}; /* {f.label} */")
            rates += [f"    rate[{len(rates)}] = {r}; /* {f.label} */" for r in effect.rates(signals, values)]
    torque, rate = "\n".join(torques), "\n".join(rates)
    start = "    for (int i = 0; i < NJ; i++) tau[i] = 0.0;"
    c = _function(model, "stopset_effects", "double tau[NJ]", torque, start)
    c += _function(model, "stopset_memory_rates", "double *rate", rate, "    (void)rate;")
    body = torque + rate
    return Laws(c, bool(torques), "way[" in body, "load[" in body)


def _function(model: Model, name: str, out: str, body: str, start: str) -> str:
    """A C function with the lines ``body``, and before them what they use of the rigid body."""
    gx, gy, gz = model.robot.chain.gravity
    before = []
    if any(word in body for word in ("bias[", "roll[", "stiff[")):
        before.append("    double pi[NJ][10];\n    stopset_loaded_links(s, pi);")
    if "bias[" in body:
        before.append("    double bias[NJ];\n    stopset_bias_torque(pi, stopset_model.gravity, q, dq, bias);")
    if "roll[" in body:
        # a base rolled by +a sees gravity rolled by -a, see stopset.effects.signals
        roll, pitch = -np.array([0.0, -gz, gy]), -np.array([gz, 0.0, -gx])
        for axis, g in (("roll", roll), ("pitch", pitch)):
            numbers = ", ".join(repr(float(x)) for x in g)
            before.append(
                f"    static const double {axis}_direction[3] = {{{numbers}}};\n    double {axis}[NJ];\n"
                f"    stopset_gravity_torque(pi, {axis}_direction, q, {axis});"
            )
    if "stiff[" in body:
        before.append("    double stiff[NJ];\n    stopset_stiffness(pi, q, stiff);")
    unused = "    (void)s; (void)q; (void)dq; (void)way; (void)load; (void)memory;"
    pad = " " * len(f"void {name}(")
    head = (
        f"void {name}(const StopsetState *s, const double q[NJ], const double dq[NJ], const double way[NJ],\n"
        f"{pad}const double load[NJ], const double *memory, {out}) {{\n"
    )
    return head + "\n".join([*before, unused, start, *([body] if body else [])]) + "\n}\n"
