"""The monitor's input ``u``: the same map as the identification's, and how far what is not known exactly can move it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from stopset.artifact import Model
from stopset.artifact.inputs import InputMap
from stopset.artifact.taped import Pinned, places, taped
from stopset.core.library import check, ffi, given, lib, view
from stopset.effects.registry import get
from stopset.monitor.carried import Carried
from stopset.monitor.unseen import refuse_unseen
from stopset.types import Array

if TYPE_CHECKING:
    from stopset.monitor.sample import Quantum


@dataclass(frozen=True, slots=True)
class Inputs:
    """``u`` (n,) [N m] of a sample, and ``du`` (n,): how much rounding, an unknown place in the session and unknown states of
    effects with memory can have changed it.  Samples are taken one after another; `forget` where they are no longer one motion."""

    map: InputMap
    quantum: Quantum
    warm: tuple[float, float]
    plain: bool  # u = tau - offset: q, dq and the place in the session do not enter
    carried: Carried
    struct: Any
    held: Any  # what the struct points at

    @classmethod
    def of(cls, model: Model, quantum: Quantum, warm: tuple[float, float]) -> Inputs:
        """Raises `NotCovered` for effects with a memory that cannot be carried, see `Carried`, or that look at what is not seen.

        ``warm``: between which places of the session (0 first trial of the identification, 1 last) the arm is now.
        """
        taken_off = model.input
        refuse_unseen(taken_off.effects)
        plain = taken_off.plain
        uses_warm = any("warm" in get(f.effect).needs for f in taken_off.effects)
        carried, between = Carried.of(model), warm if uses_warm else (warm[0], warm[0])
        struct, held = _struct(taken_off, quantum, between, plain=plain, carried=carried, dt=model.powered.dt)
        return cls(taken_off, quantum, between, plain, carried, struct, held)

    def forget(self) -> None:
        """The next sample does not follow the last one."""
        self.carried.forget()

    def __call__(self, q: Array, dq: Array, tau: Array, temp: Array | None) -> tuple[Array, Array]:
        """See the class; all arguments (n,). Friction turns round at standstill, so rounding is tried both ways."""
        n = self.map.robot.n
        if any(x.shape != (n,) for x in (q, dq, tau, tau if temp is None else temp)):
            raise ValueError(f"a sample of {len(q)} positions, {len(dq)} speeds, {len(tau)} torques for {n} joints")
        u, du = np.empty(n), np.empty(n)
        held = {"q": given(q), "dq": given(dq), "tau": given(tau)} | ({} if temp is None else {"temp": given(temp)})
        here = ffi.new("StopsetSamples *", {name: view(x) for name, x in held.items()})
        check(lib.stopset_sample_input(self.struct, here, view(self.carried.ends), view(u), view(du)))
        return u, du


def _struct(
    m: InputMap, quantum: Quantum, warm: tuple[float, float], *, plain: bool, carried: Carried, dt: float
) -> tuple[Any, Any]:
    """``StopsetMonitor``, and what it points at.

    The laws are linear in the place in the session, so its two ends are the extremes.
    """
    tape, pinned = taped(m), Pinned([])
    first, law = {}, 0  # place of each effect's first law
    for k, f in enumerate(m.effects):
        first[k] = law
        law += len(places(f, get(f.effect), m.robot.joints))
    rates = ffi.new(
        "StopsetCarried[]", [(first[s.place], pinned.program(s.effect, s.fitted.values, rate=0)) for s in carried.states] or 1
    )
    ends = sorted(set(warm))
    rounding = [pinned.array(x) for x in (quantum.q, quantum.dq, quantum.tau)]
    struct = ffi.new("StopsetMonitor *", (
        tape.struct, *rounding, [ends[0], ends[-1]], len(ends), int(plain), dt, len(carried.states), rates,
    ))  # fmt: skip
    return struct, (tape, pinned, rates)
