"""The model's effects as the FMU carries them: laws on tape, the same steps that identification and monitor play.

Every number of a law is a parameter of the unit, where the law could be recorded with it apart (`stopset.artifact.taped`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stopset.artifact import Model
from stopset.artifact.taped import RIGID, SIGNALS, Recorded, parameters_of, places, recorded
from stopset.effects import Effect, Fitted, Shape, Term, get
from stopset.effects.memory import affine, whole
from stopset.errors import EffectError
from stopset.fmu.ctext import array
from stopset.ring.tape import SIGNAL

BEYOND = {"dtau": "the rate of a torque"}  # what a recording tells and no input of the unit does


@dataclass(frozen=True, slots=True)
class EffectParameter:
    """One number of one effect, as the FMU's parameter ``name``."""

    name: str
    unit: str
    means: str
    value: float


@dataclass(frozen=True, slots=True)
class Remembered:
    """A state of an effect, as the FMU's variable ``name``; it begins at ``start`` and lies in ``whole`` whatever came before."""

    name: str
    start_name: str
    unit: str
    means: str
    start: float
    whole: tuple[float, float]


@dataclass(frozen=True, slots=True)
class TapedEffect:
    """An active effect: ``torque`` and ``rates`` on tape, ``at`` (joint, partner or -1) of every torque."""

    fitted: Fitted
    effect: Effect
    torque: Recorded
    rates: tuple[Recorded, ...]
    at: tuple[tuple[int, int], ...]

    @property
    def symbols(self) -> list[str]:
        """Of the parameters that can be set."""
        return parameters_of(self.effect, self.fitted.values) if self.torque.parametric else []


def carried(model: Model) -> tuple[TapedEffect, ...]:
    """The effects that the input compensates; raises `EffectError` for one that the FMU cannot carry."""
    out = []
    for f in model.input.effects:
        effect = get(f.effect)
        beyond = [f"{name} ({BEYOND[name]})" for name in effect.needs if name in BEYOND]
        if beyond:
            raise EffectError(
                f"effect {f.label} looks at {', '.join(beyond)}, which an FMU does not know; expected effects of what it does: "
                "export a revision without it"
            )
        if effect.states and (f.joint is None or not affine(effect)):
            raise EffectError(
                f"effect {f.label} remembers {', '.join(x.symbol for x in effect.states)}; an FMU carries one state per effect whose "
                "law and flow are affine in it: export a revision without it"
            )
        rates = tuple(recorded(effect, f.values, k) for k in range(len(effect.states)))
        out.append(TapedEffect(f, effect, recorded(effect, f.values), rates, tuple(places(f, effect, model.joints))))
    return tuple(out)


def remembered(model: Model) -> tuple[Remembered, ...]:
    """What the active effects remember, in the order of the C array."""
    fastest = np.maximum(np.abs(model.domain.dq.lo), np.abs(model.domain.dq.hi))
    limit = model.robot.dq_limit
    fastest = np.where(np.isfinite(limit), np.maximum(limit, fastest), fastest)
    out = []
    for c in carried(model):
        e, f = c.effect, c.fitted
        for x, z in zip(e.states, e.at_start, strict=True):
            ends = whole(e, f.values, float(fastest[c.at[0][0]]))
            name = f"{e.name}_{x.symbol}"
            what = f"{x.means} ({e.name}, {f.joint})"
            out.append(Remembered(f"{name}_{f.joint}", f"{name}_start_{f.joint}", x.unit, what, z, ends))
    return tuple(out)


def effect_parameters(model: Model) -> tuple[EffectParameter, ...]:
    """Every number of every active effect, in the order of the C array."""
    out = []
    for c in carried(model):
        at, symbols = c.fitted.joint or "arm", c.symbols
        every: list[Term | Shape] = [*c.effect.terms, *c.effect.shapes]
        for p in (p for p in every if p.symbol in symbols):
            what = f"{p.means} ({c.effect.name}, {at})"
            out.append(EffectParameter(f"{c.effect.name}_{p.symbol}_{at}", p.unit, what, c.fitted.values[p.symbol]))
    return tuple(out)


@dataclass(frozen=True, slots=True)
class Laws:
    """``c``: the tapes; ``fields``: of the model's C struct, as text; ``sizes``: of its header; ``direction``: whether friction's
    direction matters."""

    c: str
    fields: dict[str, str]
    sizes: dict[str, int]
    direction: bool


def laws_of(model: Model) -> Laws:
    """All tapes of a model, each effect's torque first, then its states' rates."""
    tapes: list[str] = []
    lines: list[str] = []
    numbers: list[float] = []
    laws: list[str] = []
    memory: list[str] = []
    parameter, states, needs, direction = 0, 0, 0, False
    known = remembered(model)

    def tape(r: Recorded, count: int) -> int:
        steps = ", ".join(map(str, r.steps.ravel().tolist()))
        lines.append(f"static const int32_t steps_{len(tapes)}[] = {{{steps}}};")
        tapes.append(f"{{steps_{len(tapes)}, {len(r.steps)}, {len(numbers)}, {count if r.parametric else 0}, {parameter}}}")
        numbers.extend(r.numbers.tolist())
        return len(tapes) - 1

    for c in carried(model):
        count = len(c.symbols)
        direction = direction or any(
            what == SIGNAL and k == SIGNALS.index("given_direction") for what, k, _ in c.torque.steps.tolist()
        )
        for name in c.effect.needs:
            needs |= RIGID.get(name, 0)
        first, torque = len(laws), tape(c.torque, count)
        laws += [f"{{{j}, {other}, {states}, {len(c.rates)}, {torque}}}" for j, other in c.at]
        for r in c.rates:
            memory.append(f"{{{first}, {tape(r, count)}, {array(known[states].whole)}}}")
            states += 1
        parameter += count
    lines.append(f"const StopsetTape stopset_tapes[] = {{{', '.join(tapes) or '{0}'}}};")
    fields = {"place": laws, "memory": memory}
    text = {k: "{" + (", ".join(v) or "{0}") + "}" for k, v in fields.items()}
    return Laws(
        "\n".join(lines) + "\n", {**text, "numbers": array(numbers or [0.0]), "needs": str(needs)},
        {"N_LAWS": len(laws), "N_NUMBERS": len(numbers)}, direction,
    )  # fmt: skip
