"""The model card: what a safety engineer reads before a revision is released, and the lines to sign."""

from __future__ import annotations

from stopset.artifact import Model
from stopset.offline.report.page import Page
from stopset.sets import Box

ROOM = "\u00a0" * 30  # to write in
# what no recording can tell; answered by hand
BY_HAND = (
    "The cell stays within the domain above: angles, speeds, payloads, temperatures",
    "Brakes were tested on (date), and by whom",
    "Stop distances were measured at the poses of the stop table (ISO 10218-1), and none is longer than its bound",
    "Every consumer treats each state other than OK, silence included, as unsafe",
    "The risk assessment does not rest on this monitor alone",
)


def card(out: Page, model: Model) -> None:
    """What the model is for, where it holds, what it was seen to do, what it assumes; put below what ``out`` already says."""
    d, s = model.domain, model.powered
    out.heading("What it is for, and what not")
    out.points(
        [
            "Bounds of where this arm can still go if it were stopped now, and whether it still behaves as recorded.",
            "For this one arm, with its load, tool and mounting of the day it was recorded; not for another of the same type.",
            "Not a safety function: no PL, no SIL. A stop, a protective field or a distance may not depend on it alone.",
        ]
    )
    out.heading("Where it holds")
    out.table(
        ["joint", "q [rad]", "dq [rad/s]", "u [N m]", "temperature [°C]"],
        [[j, *(_range(b, k) for b in (d.q, d.dq, d.u, d.temp))] for k, j in enumerate(model.joints)],
        f"Hull of what was recorded, payload {d.payload[0]:g} to {d.payload[1]:g} kg on top of what the arm carried; outside: not covered",
    )
    out.heading("What was seen of it")
    out.text(model.guarantee.text)
    head = ["joint", "torque error [N m]", "floor [N m]", "position error [rad]", "speed error [rad/s]", "U [N m]"]
    keys = ("torque_rmse", "torque_rmse_floor", "position_rmse", "velocity_rmse")
    out.table(
        head,
        [[j, *(model.errors.get(j, {}).get(k) for k in keys), _range(s.U, k)] for k, j in enumerate(model.joints)],
        f"Of its own recordings; floor: what repetitions of the same torques differ by; sets with margin {s.margin:.2f}",
    )
    out.heading("What it consists of")
    out.table(
        ["effect", "at", "numbers, with one standard deviation"],
        [
            [e.effect, e.joint or "the arm", ", ".join(_value(e.values[k], e.std.get(k), k) for k in e.values)]
            for e in model.effects
        ],
        f"Rigid body, friction and effects, simplified to model {model.abstraction.kind} of order {model.abstraction.order}",
    )
    if model.brakes is None:
        out.text("No brakes are known: no stop by brakes is provable with this model.")
    else:
        b = model.brakes
        out.table(
            ["joint", "torque [N m]", "delay [s]", "rise [s]"],
            [[j, *(_range(x, k) for x in (b.torque, b.delay, b.rise))] for k, j in enumerate(model.joints)],
            f"Brakes ({b.source})",
        )
    if model.notes:
        out.heading("What identification noted")
        out.points(model.notes)
    out.heading("Released by")
    out.table(["to be confirmed by hand", "yes, no, where it is written"], [[x, ROOM] for x in BY_HAND])
    out.table(
        ["role", "name", "date", "signature"],
        [[role, ROOM, ROOM, ROOM] for role in ("identified by", "checked by", "released by")],
    )


def _range(box: Box | None, k: int) -> str:
    return "–" if box is None else f"{box.lo[k]:.4g} to {box.hi[k]:.4g}"


def _value(value: float, std: float | None, name: str) -> str:
    return f"{name} {value:.4g}" + (f" ± {std:.2g}" if std else "")
