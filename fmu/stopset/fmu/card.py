"""The unit's model card, ``documentation/index.html``: what its bounds hold for, and on what they rest."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

import numpy as np

from stopset.artifact import Model
from stopset.fmu.description import NOTICE
from stopset.fmu.stops import bounds_of, stop_refusal
from stopset.fmu.variables import StopCategory
from stopset.reach.stops.ramp import ramp_of
from stopset.reach.stops.types import Category
from stopset.reach.stops.words import REST, ramp_assumptions
from stopset.sets import Box

READ_FIRST = (
    "Read the output <code>covered</code> first: where it is false, q_lo to dq_hi mean nothing. A stop bound stands where its "
    "<code>..._certified</code> is true; where nothing is proved it is NaN."
)
STYLE = (
    "body{font:16px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem}"
    "th,td{text-align:left;padding:0 1.5rem .2rem 0}p,li{overflow-wrap:anywhere}"
)
RAMPS: tuple[Category, ...] = ("1", "1 guaranteed", "2")  # of the kinds that follow a STOP 0


def card(model: Model, kinds: Sequence[StopCategory]) -> str:
    """The page of a model and the ``kinds`` of stop that its unit has outputs of."""
    s, a, torque = model.powered, model.abstraction, model.effort.replace("_", " ")
    named = ", ".join(str(e.label) for e in model.effects) or "none"
    said = [
        f"Model file SHA-256 {model.sha256 or 'not saved'}, revision {len(model.revisions)}.",
        f"Model {a.kind}, identified from {torque}, steps of {s.dt:g} s, predictions up to {s.horizon:g} s ahead.",
        f"Effects: {named}.",
    ]
    body = [
        f"<h1>{escape(model.robot.name)}</h1><p><strong>{NOTICE}</strong></p><p>{READ_FIRST}</p>",
        *(f"<p>{escape(x)}</p>" for x in said),
        f"<h2>Guarantee</h2><p>{escape(model.guarantee.text)}</p>",
        f"<h2>Domain</h2>{_domain(model)}",
        f"<h2>Stop bounds</h2>{_stops(model, kinds)}",
    ]
    head = f"<head><meta charset='utf-8'><title>{escape(model.robot.name)}: stopset FMU</title><style>{STYLE}</style></head>"
    return f"<!DOCTYPE html><html lang='en'>{head}<body>{''.join(body)}</body></html>\n"


def _domain(model: Model) -> str:
    """Where the model was identified: outside, nothing is covered."""
    d = model.domain
    columns = [("angle [rad]", d.q), ("speed [rad/s]", d.dq), ("input torque [N m]", d.u)]
    if d.temp is not None:
        columns.append(("temperature [degC]", d.temp))
    rows = [[joint, *(_range(box, k) for _, box in columns)] for k, joint in enumerate(model.joints)]
    lines = ["".join(f"<td>{escape(x)}</td>" for x in row) for row in rows]
    head = "".join(f"<th>{escape(x)}</th>" for x in ["joint", *(name for name, _ in columns)])
    load = f"<p>Payload {d.payload[0]:g} to {d.payload[1]:g} kg on top of what the model's last link holds.</p>"
    return f"<table><tr>{head}</tr>{''.join(f'<tr>{x}</tr>' for x in lines)}</table>{load}"


def _range(box: Box, k: int) -> str:
    lo, hi = float(box.lo[k]), float(box.hi[k])
    return f"{lo:.4g} to {hi:.4g}" if np.isfinite([lo, hi]).all() else "any"


def _stops(model: Model, kinds: Sequence[StopCategory]) -> str:
    """Which stops are bounded, and under which assumptions; or why none is."""
    refusal = stop_refusal(model)
    if refusal:
        return f"<p>No stop is bounded: {escape(refusal)}.</p>"
    setting, ramp = bounds_of(model).setting, ramp_of(model)
    assert setting is not None
    parts = [f"<p>Of {escape(', of '.join(c.what for c in kinds))}. All of them assume:</p>{_list(setting.assumptions)}"]
    rests = [[REST], *(ramp_assumptions(ramp, kind) for kind in RAMPS if ramp is not None)]
    parts += [f"<p>{escape(c.what[0].upper() + c.what[1:])}:</p>{_list(x)}" for c, x in zip(kinds, rests, strict=False)]
    return "".join(parts)


def _list(lines: Iterable[str]) -> str:
    return f"<ul>{''.join(f'<li>{escape(x)}</li>' for x in lines)}</ul>"
