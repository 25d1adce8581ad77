"""What a notebook asks of an answer besides showing it: its numbers as arrays or as a pandas frame, and its picture by one call."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from stopset.artifact import Model
from stopset.errors import NotCovered
from stopset.offline.compare.compare import Comparison
from stopset.offline.diagnose.answer import Diagnosis
from stopset.reach.stops import StopBound
from stopset.recording import Recording

if TYPE_CHECKING:
    import plotly.graph_objects as go

Thing = Model | Comparison | Diagnosis | StopBound | Recording
ByName = dict[str, NDArray[Any]]


def columns(thing: Thing) -> ByName:
    """The numbers of an answer as numpy columns of one length: a row per joint, of a diagnosis per effect, of a recording per sample.

    Names end in the unit; what is not known is nan.
    """
    if isinstance(thing, Model):
        u = thing.powered.U
        return {"joint": np.array(thing.joints), "U_lo_Nm": u.lo, "U_hi_Nm": u.hi} | _figures(thing.joints, thing.errors)
    if isinstance(thing, Comparison):
        return {"joint": np.array(list(thing.figures))} | _figures(tuple(thing.figures), thing.figures)
    if isinstance(thing, Diagnosis):
        words = {
            "effect": [r.effect for r in thing.ranked],
            "joints": ["+".join(r.joints) for r in thing.ranked],
            "unit": [r.unit for r in thing.ranked],
        }
        numbers = {k: [getattr(r, k) for r in thing.ranked] for k in ("score", "error_before", "error_after")}
        return {k: np.array(v, dtype=str) for k, v in words.items()} | {k: _numbers(v) for k, v in numbers.items()}
    if isinstance(thing, StopBound):
        parts = {"time_s": thing.time, "forward_rad": thing.forward, "back_rad": thing.back, "speed_radps": thing.speed}
        return {k: np.asarray(v, dtype=float) for k, v in parts.items() if v is not None}
    n = thing.q.shape[1]
    signals = {"q": (thing.q, "rad"), "dq": (thing.dq, "radps"), "tau": (thing.tau, "Nm"), "temp": (thing.temp, "degC")}
    each = {f"{name}_{k + 1}_{unit}": x[:, k] for name, (x, unit) in signals.items() if x is not None for k in range(n)}
    return {"t_s": thing.t} | each


def frame(thing: Thing) -> Any:
    """The same `columns` as a ``pandas.DataFrame``; raises `NotCovered` where pandas is not installed."""
    try:
        import pandas
    except ImportError as e:
        raise NotCovered("pandas is not installed; expected it for frames: install it, or take `columns` as numpy arrays") from e
    return pandas.DataFrame(columns(thing))


def plot(thing: Model | Comparison | Diagnosis | StopBound) -> go.Figure:
    """The picture of an answer, as its page has it; raises `NotCovered` where there is none.

    Of a model how the errors fell with its revisions, of a comparison the errors over their floor, of a diagnosis the errors before
    and after each effect, of a stop the angle of every joint in either direction.
    """
    from stopset.offline.compare.page import bars
    from stopset.offline.diagnose.page import ranking
    from stopset.offline.revise.page import waterfalls

    if isinstance(thing, Model):
        found = waterfalls(thing)
        if found is None:
            raise NotCovered("nothing was added to this model yet; expected a revision to draw: `add` makes one")
        return found
    if isinstance(thing, Comparison):
        return bars(thing)
    if isinstance(thing, Diagnosis):
        if not thing.ranked:
            raise NotCovered(f"the diagnosis is {thing.verdict!r} and ranks no effect; expected one to draw: read what it says")
        return ranking(thing)
    return _stop(thing)


def _stop(bound: StopBound) -> go.Figure:
    import plotly.graph_objects as go

    if bound.forward is None or bound.back is None:
        raise NotCovered(f"no stop provable: {bound.why or 'nothing is known'}; expected a bound to draw: state what is missing")
    joints = [f"joint {k + 1}" for k in range(len(bound.forward))]
    figure = go.Figure([go.Bar(name="forward", x=joints, y=bound.forward), go.Bar(name="back", x=joints, y=-bound.back)])
    figure.update_layout(title=f"STOP {bound.category}: upper bounds", barmode="relative", yaxis_title="angle to rest [rad]")
    return figure


def _figures(joints: tuple[str, ...], errors: Mapping[str, Mapping[str, Any]]) -> ByName:
    units = {
        "torque_rmse": "Nm", "torque_rmse_floor": "Nm", "velocity_rmse": "radps", "position_rmse": "rad", "position_rmse_floor": "rad",
    }  # fmt: skip
    return {f"{key}_{unit}": _numbers([errors.get(j, {}).get(key) for j in joints]) for key, unit in units.items()}


def _numbers(values: list[float | None]) -> NDArray[np.float64]:
    return np.array([np.nan if v is None else v for v in values], dtype=float)
