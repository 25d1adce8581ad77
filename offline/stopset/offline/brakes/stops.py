"""Recorded stops into the model: brakes and the regime STOP 0, the ramp of STOP 1, and what held-out stops say of them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stopset.artifact import Guarantee, Model
from stopset.errors import NotCovered, RecordingError
from stopset.offline.brakes.controlled import fit_ramp
from stopset.offline.brakes.judge import guarantee_line, judge_stop0, judge_stop1
from stopset.offline.brakes.power_off import LEAST, fit_brakes, widened
from stopset.reach.stops.ramp import KEY, Ramp
from stopset.recording import Recording, SuiteKey
from stopset.sets import Box

HELD = 3  # every third stop of a suite is held out
FEW = 8  # a suite with fewer stops than this is counted apart in the guarantee: it shows its variation incompletely
REST = 15  # samples at the end of a stop that tell the noise


@dataclass(frozen=True, slots=True)
class StopFit:
    """What the recorded stops tell; None where a phase was not recorded or cannot tell.

    ``model``: the model with brakes and the regime 'stop0' (2n,) (n,) sets; ``ramp``: of STOP 1; ``stop0``, ``stop1``: what the
    held-out stops say of them; ``noise``: (2n,) measurement error of (q, dq), from the arm at rest after its stops.
    """

    model: Model
    ramp: Ramp | None
    noise: Box | None
    stop0: Guarantee | None
    stop1: Guarantee | None
    notes: tuple[str, ...]


def with_stops(model: Model, fit: StopFit) -> Model:
    """The model with the identified brakes, STOP 0 sets and ramp; the guarantee lines go into its notes."""
    provenance = dict(model.provenance)
    if fit.ramp is not None:
        provenance[KEY] = fit.ramp.as_dict()
    lines = [g.text for g in (fit.stop0, fit.stop1) if g is not None]
    known = fit.model
    return replace(
        model, brakes=known.brakes, sets=known.sets, inertia_std=known.inertia_std, provenance=provenance,
        notes=(*model.notes, *fit.notes, *lines),
    )  # fmt: skip


def identify_stops(model: Model, recordings: Iterable[Recording]) -> StopFit:
    """Brakes from stop0 and the ramp from stop1 recordings, every third stop held out.

    Recordings of other phases are ignored.  Raises `RecordingError` if stops carry no ``stop_trigger``.
    """
    stops: dict[str, list[Recording]] = {"stop0": [], "stop1": []}
    for r in recordings:
        if r.phase in stops:
            if r.stop_requested is None:
                raise RecordingError(
                    f"{r.label} has no stop_trigger that turns true; expected the moment of the stop request: record it or "
                    f"leave the file out"
                )
            stops[r.phase].append(r)
    notes: list[str] = []
    parts = {phase: divide(rows) for phase, rows in stops.items()}
    noise = rest_noise([r for train, _ in parts.values() for r in train], model.n)
    if noise is None:
        if any(stops.values()):
            count = sum(len(train) for train, _ in parts.values())
            notes.append(
                f"{count} recorded stops to identify from, too few of them until the arm rests; expected at least {LEAST}: record more, longer"
            )
        return StopFit(sheet_held(model, stops["stop0"], notes), None, None, None, None, tuple(notes))
    model, stop0 = _power_off(model, stops["stop0"], noise, notes) if stops["stop0"] else (model, None)
    requests = [r for train, _ in parts.values() for r in train]
    ramp, stop1 = _controlled(stops["stop1"], requests, noise, notes) if stops["stop1"] else (None, None)
    return StopFit(model, ramp, noise, stop0, stop1, tuple(notes))


def _power_off(model: Model, stops: Sequence[Recording], noise: Box, notes: list[str]) -> tuple[Model, Guarantee | None]:
    train, held = divide(stops)
    before, model = model, _regime(model, noise)
    try:
        known = fit_brakes(shown(model), train, noise, notes) if _enough(train, "stop0", notes) else None
    except NotCovered as e:
        notes.append(f"no brakes from {len(train)} recorded stops: {e}")
        return before, None
    if known is None:
        return sheet_held(before, stops, notes), None
    regular, few = (judge_stop0(known, part) for part in _by_suite_size(held, stops))
    line = guarantee_line("STOP 0", regular, few, len(train))
    if regular.outside or few.outside:
        known, line = fit_brakes(shown(model), stops, noise, notes) or widened(known, stops, notes), _of_all(line, stops)
    return known, line


def _regime(model: Model, noise: Box) -> Model:
    """With sets of the regime STOP 0 to begin with: of the powered arm, the drives giving nothing, and the ``noise`` (2n,) of readings."""
    return replace(model, sets={**model.sets, "stop0": replace(model.powered, X0=noise, V=noise, active=(), zonotope=None)})


def sheet_held(model: Model, stops: Sequence[Recording], notes: list[str]) -> Model:
    """``model`` with a data sheet's brakes, which hold what was recorded, too, however little that is: torques and sets grow until every one
    of the power-off ``stops`` is inside its bound. Readings err as those of the powered arm, or as those at the stops' ends if that is more.

    Raises `RecordingError` where no growth encloses them.
    """
    if not stops or model.brakes is None:
        return model
    V, at_rest, said = model.powered.V, rest_noise(stops, model.n, least=1), list[str]()
    noise = np.max([np.abs(V.lo), np.abs(V.hi), *([] if at_rest is None else [at_rest.radius])], axis=0)
    try:
        wide = widened(_regime(model, Box.symmetric(noise)), stops, said)
    except NotCovered:  # by an effect of the model: there is no bound to leave
        return model
    grown = wide.brakes is not model.brakes
    left = "some left" if grown else "none left"
    notes += [f"{len(stops)} recorded power-off stops were held against the data sheet's brakes: {left} its bound", *said]
    return wide if grown else model


def _of_all(line: Guarantee, stops: Sequence[Recording]) -> Guarantee:
    """The guarantee where a held-out stop refuted what it was held out for: what is published encloses it, too."""
    return replace(line, text=f"{line.text}; as one did, the bounds are now those of all {len(stops)} stops, each inside its own")


def shown(model: Model) -> Model:
    """``model`` of which recorded stops show what its inertia is wrong by: brakes and sets identified from them hold that at a stop's own
    decelerations. Rotors that no torque showed stay unknown."""
    return model if model.inertia_std is None else replace(model, inertia_std=np.zeros(model.n))


def _controlled(
    stops: Sequence[Recording], requests: Sequence[Recording], noise: Box, notes: list[str]
) -> tuple[Ramp | None, Guarantee | None]:
    train, held = divide(stops)
    if not _enough(train, "stop1", notes):
        return None, None
    ramp = fit_ramp(train, requests, noise, notes)
    regular, few = (judge_stop1(ramp, noise, part) for part in _by_suite_size(held, stops))
    line = guarantee_line("STOP 1", regular, few, len(train))
    if regular.outside or few.outside:
        ramp, line = fit_ramp(stops, [*requests, *held], noise, notes), _of_all(line, stops)
    return ramp, line


def _enough(train: Sequence[Recording], phase: str, notes: list[str]) -> bool:
    if len(train) >= LEAST:
        return True
    notes.append(f"{len(train)} {phase} recordings to identify from are too few; expected at least {LEAST}: record more stops")
    return False


def divide(stops: Sequence[Recording]) -> tuple[list[Recording], list[Recording]]:
    """Training and held-out stops, every third of each suite held out."""
    train: list[Recording] = []
    held: list[Recording] = []
    for rows in _suites(stops).values():
        for k, r in enumerate(rows):
            (held if k % HELD == HELD - 1 else train).append(r)
    return train, held


def _suites(stops: Sequence[Recording]) -> dict[SuiteKey, list[Recording]]:
    out: dict[SuiteKey, list[Recording]] = {}
    for r in stops:
        out.setdefault(r.suite_key, []).append(r)
    return out


def _by_suite_size(held: Sequence[Recording], stops: Sequence[Recording]) -> tuple[list[Recording], list[Recording]]:
    """Held-out stops from suites of many and of few stops; all count as of many where every suite has few."""
    few = {s for s, rows in _suites(stops).items() if len(rows) < FEW}
    if len(few) == len(_suites(stops)):
        return list(held), []
    return [r for r in held if r.suite_key not in few], [r for r in held if r.suite_key in few]


def rest_noise(stops: Sequence[Recording], n: int, least: int = LEAST) -> Box | None:
    """Largest deviations of angle and speed while the arm rests at the end of its stops, half as much again; None of fewer than ``least``."""
    angle, speed = np.zeros(n), np.zeros(n)
    seen = 0
    for r in stops:
        tail = slice(len(r.t) - REST, len(r.t))
        if len(r.t) < 3 * REST or np.any(np.abs(np.mean(r.dq[tail], axis=0)) > 0.01):
            continue
        angle = np.maximum(angle, np.abs(r.q[tail] - np.mean(r.q[tail], axis=0)).max(axis=0))
        speed = np.maximum(speed, np.abs(r.dq[tail]).max(axis=0))
        seen += 1
    if seen < least:
        return None
    return Box.symmetric(np.concatenate([1.5 * np.maximum(angle, 1e-5), 1.5 * np.maximum(speed, 1e-4)]))


__all__ = ["StopFit", "divide", "identify_stops", "rest_noise", "sheet_held", "with_stops"]
