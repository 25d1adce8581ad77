"""Write docs/effects: one page per effect of the catalogue, from the effect itself: law, parameters, curve, residuals.

Run: python benchmarks/effect_pages.py
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from stopset.artifact.inputs import entry
from stopset.effects.base import Effect, Shape, Signals, Term
from stopset.effects.registry import catalogue
from stopset.effects.signals import Samples, arm_signals, paired
from stopset.files import write_text
from stopset.offline.description import robot_from_text
from stopset.types import Array

ROOT = Path(__file__).parents[1]
OUT = ROOT / "docs" / "effects"
DT, SAMPLES, DOTS = 0.004, 6000, 450
SETTLED = 2500  # samples left out of the figures: states start at zero and ring
NOISE, SIZE = 0.3, 2.0  # [N m] torque noise; rms of an effect whose usual size is not known
WIDTH, HEIGHT, PAD = 420.0, 220.0, 48.0
# what the residual is drawn over, by the effect's `look_at`; what is not listed is drawn over the first signal it needs
LOOK: dict[str, tuple[str, Callable[[Signals], Array]]] = {
    "temp * dq": ("(temp - 30 degC) dq [K rad/s]", lambda s: s.temp * s.dq),
    "temp * direction of dq": ("(temp - 30 degC) sign(dq) [K]", lambda s: s.temp * np.sign(s.dq)),
    "place in the session * dq": ("warm dq [rad/s]", lambda s: s.warm * s.dq),
    "abs(load) * direction of dq": ("|load| sign(dq) [N m]", lambda s: abs(s.load) * np.sign(s.dq)),
    "way since the last reversal": ("way since the reversal, with its direction [rad]", lambda s: travel(s.q, s.dq)),
    "acceleration of the link torque": ("second derivative of the link torque [N m/s^2]", lambda s: bend(s.link)),
    "gravity load, joint 1 over q of joint 1": ("q [rad]", lambda s: s.q),
    "gravity load of all joints": ("gravity load [N m]", lambda s: s.load),
}
UNSEEN = " The torque shows nothing of it, here as anywhere: `diagnose` asks an angle that is read behind the gear."
UNITS = {
    "q": "rad",
    "dq": "rad/s",
    "dq_other": "rad/s",
    "ddq_other": "rad/s^2",
    "ddq": "rad/s^2",
    "dtau": "N m/s",
    "stiff": "N m/rad",
    "temp": "K",
}


def travel(q: Array, dq: Array) -> Array:
    """Way since the last reversal [rad], signed by the direction."""
    turn = np.maximum.accumulate(np.where(np.r_[True, np.diff(np.sign(dq)) != 0], np.arange(len(q)), 0))
    return q - q[turn]


def bend(x: Array) -> Array:
    return np.gradient(np.gradient(x, DT), DT)


@cache
def motion() -> tuple[Signals, ...]:
    """Signals of a made-up planar two-joint arm on a multisine, warming from 20 to 45 degC."""
    links = "".join(
        f'<link name="l{k}"><inertial><origin xyz="0.05 0 0.15"/><mass value="4"/>'
        '<inertia ixx="0.05" iyy="0.05" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        f'<joint name="j{k}" type="revolute"><parent link="l{k - 1}"/><child link="l{k}"/><origin xyz="0 0 {0.35 * (k - 1)}"/>'
        '<axis xyz="0 1 0"/><limit lower="-3" upper="3" velocity="3" effort="100"/></joint>'
        for k in (1, 2)
    )
    robot = robot_from_text(f'<robot name="planar"><link name="l0"/>{links}</robot>')
    t = DT * np.arange(SAMPLES)
    a = np.array([[0.9, 0.35, 0.08], [0.7, 0.4, 0.1]])
    w = 2 * np.pi * np.array([[0.11, 0.37, 1.3], [0.17, 0.43, 1.1]])
    p = w * t[:, None, None] + np.array([[0.3, 1.1, 2.0], [1.7, 0.4, 2.9]])
    q, dq, ddq = (a * np.sin(p)).sum(2), (a * w * np.cos(p)).sum(2), -(a * w * w * np.sin(p)).sum(2)
    temp = np.repeat((20 + 25 * t / t[-1])[:, None], 2, axis=1)
    signals = arm_signals(robot, Samples(q, dq, ddq, temp, t=t))
    return paired(tuple(replace(s, warm=t / t[-1]) for s in signals), 0, 1)


def with_memory(effect: Effect, s: Signals) -> Signals:
    """The signals with the effect's states, integrated by Runge-Kutta 4 with the signals held over a step."""
    if not effect.states:
        return s
    fields = {f: getattr(s, f) for f in ("q", "dq", "ddq", "load", "tau", "dtau", "link", "stiff", "inertia", "temp", "warm")}
    out, x = np.zeros((SAMPLES, len(effect.states))), np.zeros(len(effect.states))
    for k in range(SAMPLES):
        out[k] = x
        now = Signals(**{f: float(v[k]) for f, v in fields.items()}, given_direction=float(np.sign(s.dq[k])))

        def rate(y: Array, now: Signals = now) -> Array:
            return np.array(effect.rates(replace(now, memory=tuple(y)), {}))

        a = rate(x)
        b = rate(x + DT / 2 * a)
        c = rate(x + DT / 2 * b)
        x = x + DT / 6 * (a + 2 * b + 2 * c + rate(x + DT * c))
    return replace(s, memory=tuple(out.T))


def values(effect: Effect, s: Signals) -> dict[str, float]:
    """Usual sizes of all parameters; a term without one is chosen so that the effect is `SIZE` rms."""
    out = effect.shape_values({})
    for term, column in zip(effect.terms, effect.columns(s), strict=True):
        rms = float(np.sqrt(np.mean(np.square(column + np.zeros(SAMPLES)))))
        usual = term.typical if np.isfinite(term.typical) else SIZE / max(rms, 1e-9) * (-1.0 if term.hi <= 0 else 1.0)
        out[term.symbol] = float(f"{min(max(usual, term.lo), term.hi):.2g}")
    return out


def telling(effect: Effect, s: Signals) -> tuple[str, Array]:
    """Label and samples of the variable to look at."""
    if effect.look_at == "q folded by one n-th of a turn":
        n = effect.shape_values({})["n"]
        return f"q folded by 1/{n:g} turn [rad]", np.mod(s.q, 2 * np.pi / n)
    if effect.look_at in LOOK:
        label, read = LOOK[effect.look_at]
        return label, read(s)
    name = next((f for f in effect.needs if np.ndim(getattr(s, f)) == 1 and f != "memory"), "dq")
    return f"{name} [{UNITS.get(name, 'N m')}]", getattr(s, name)


def curve(effect: Effect, s: Signals, v: dict[str, float]) -> tuple[str, Array, Array]:
    """The law swept over its one signal, the others at their mean; a law of several or with memory: over 4 s."""
    moving = [f for f in effect.needs if f not in ("temp", "warm")]
    if len(moving) == 1 and moving[0] not in ("tip", "tilt", "memory"):
        f = moving[0]
        x = np.linspace(float(getattr(s, f).min()), float(getattr(s, f).max()), 401)
        swept = replace(Signals(temp=10.0, warm=1.0), **{f: x})  # type: ignore[arg-type]
        return f"{f} [{UNITS.get(f, 'N m')}]", x, effect.torque(swept, v) + np.zeros(401)
    shown = slice(SETTLED, SETTLED + 1000, 3)
    return "t [s]", s.t[shown], (effect.torque(s, v) + np.zeros(SAMPLES))[shown]


def svg(label: str, x: Array, y: Array, dots: bool) -> str:
    """A plot of torque over ``x``: dots or a line, with the axes' ends written out."""
    x0, x1, top = float(x.min()), float(x.max()), 1.1 * max(float(abs(y).max()), 1e-9)
    X = PAD + (x - x0) / max(x1 - x0, 1e-12) * (WIDTH - PAD - 12)
    mid = (HEIGHT - 32) / 2
    Y = mid - y / top * (mid - 8)
    d = "".join(f"M{a:.0f} {b:.0f}h0" for a, b in zip(X, Y, strict=True)) if dots else \
        "M" + "L".join(f"{a:.1f} {b:.1f}" for a, b in zip(X, Y, strict=True))  # fmt: skip
    width, cap = (3, ' stroke-linecap="round" stroke-opacity="0.6"') if dots else (1.6, "")
    text = [(PAD, HEIGHT - 16, "start", f"{x0:.2g}"), (WIDTH - 12, HEIGHT - 16, "end", f"{x1:.2g}"),
            ((PAD + WIDTH) / 2, HEIGHT - 4, "middle", label), (PAD - 4, 16, "end", f"{top:.2g}"),
            (PAD - 4, mid + 4, "end", "0"), (PAD - 4, 2 * mid - 4, "end", f"{-top:.2g}"), (PAD + 6, 14, "start", "torque [N m]")]  # fmt: skip
    words = "".join(f'<text x="{a:.0f}" y="{b:.0f}" text-anchor="{c}">{w}</text>' for a, b, c, w in text)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH:.0f} {HEIGHT:.0f}" width="{WIDTH:.0f}" '
        f'font-family="sans-serif" font-size="11"><rect width="100%" height="100%" fill="#fff"/>'
        f'<path d="M{PAD:.0f} 6V{2 * mid:.0f}H{WIDTH - 12:.0f}M{PAD:.0f} {mid:.0f}H{WIDTH - 12:.0f}" fill="none" stroke="#999"/>'
        f'<path d="{d}" fill="none" stroke="#1f5fa8" stroke-width="{width}"{cap}/>{words}</svg>\n'
    )


def reference(key: str) -> str:
    """The full reference of a key in docs/references.bib; KeyError if it is not there."""
    bib = (ROOT / "docs" / "references.bib").read_text(encoding="utf-8")
    entry = re.search(rf"^@\w+\{{{re.escape(key)},\n(.*?)^\}}", bib, re.MULTILINE | re.DOTALL)
    if entry is None:
        raise KeyError(f"{key} is not in docs/references.bib")
    found = dict(re.findall(r"(\w+) = \{((?:[^{}]|\{[^{}]*\})*)\}", entry[1]))
    where = next((found[k] for k in ("journal", "booktitle", "publisher", "institution") if k in found), "")
    parts = [found.get("author", "").replace(" and ", "; "), found.get("title", ""), where, found.get("year", "")]
    return re.sub(r"\\['\"`^~]|[{}]", "", ". ".join(p for p in parts if p)) + f" (`{key}`)"


def row(p: Term | Shape, value: float | None) -> str:
    usual = "" if value is None else f"{value:.3g}"
    return f"| `{p.symbol}` | {p.unit} | {p.means} | {p.lo:g} to {p.hi:g} | {usual} |"


def page(effect: Effect, v: dict[str, float], labels: tuple[str, str]) -> str:
    law = inspect.cleandoc(effect.law.__doc__ or "").split("Source:")[0].strip()
    memory = f"\n\nStates: {inspect.cleandoc(effect.flow.__doc__ or '')}" if effect.flow else ""
    parameters: list[Term | Shape] = [*effect.terms, *effect.shapes]
    rows = [row(p, v[p.symbol]) for p in parameters] + [row(p, None) for p in effect.states]
    rivals = ", ".join(f"[{r}]({r}.md)" for r in effect.looks_like) or "none known"
    return "\n".join([
        f"# {effect.name}", "", effect.says, "", "## Law", "", law + memory, "",
        "| symbol | unit | meaning | admissible range | drawn with |", "|---|---|---|---|---|", *rows, "",
        f"- Acts on: {effect.scope}", f"- Signals it needs: {', '.join(f'`{n}`' for n in effect.needs)}",
        f"- Enters the model in: {entry(effect)}", f"- Look at: {effect.look_at}", f"- Looks like: {rivals}",
        f"- Telling them apart: {effect.distinguished_by}", f"- Source: {reference(effect.source)}", "",
        "## Curve", "", f"![torque of the law over {labels[0]}]({effect.name}-curve.svg)", "",
        "## How it looks in your residuals", "", f"![residual over {labels[1]}]({effect.name}-residuals.svg)", "",
        f"Simulated: first joint of a made-up two-joint arm on a multisine, torque noise {NOISE:g} N m, a model without this effect."
        + (UNSEEN if effect.role == "play" else ""),
        "",
    ])  # fmt: skip


def build() -> dict[str, str]:
    """All files of docs/effects by name."""
    files, index = {}, []
    for name, effect in catalogue().items():
        if not effect.law.__module__.startswith("stopset."):
            continue  # another package documents its own
        s = with_memory(effect, motion()[0])
        v = values(effect, s)
        label, x, y = curve(effect, s, v)
        over, z = telling(effect, s)
        noise = np.random.default_rng(4).normal(0.0, NOISE, SAMPLES)
        pick = slice(SETTLED, None, (SAMPLES - SETTLED) // DOTS)
        files[f"{name}.md"] = page(effect, v, (label, over))
        files[f"{name}-curve.svg"] = svg(label, x, y, dots=False)
        files[f"{name}-residuals.svg"] = svg(over, z[pick], (effect.torque(s, v) + noise)[pick], dots=True)
        index.append(f"| [{name}]({name}.md) | {effect.says} | {effect.look_at} | {entry(effect)} |")
    head = ["# The effects", "", "Written by `python benchmarks/effect_pages.py` from the effects themselves.", "",
            "| effect | in one sentence | look at | enters |", "|---|---|---|---|"]  # fmt: skip
    files["README.md"] = "\n".join([*head, *index, ""])
    return files


if __name__ == "__main__":
    for file, content in build().items():
        write_text(OUT / file, content)
