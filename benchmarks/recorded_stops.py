"""Recorded stops against the brakes and ramps identified from others: certified, violated, and how far the bound exceeds them.

    python benchmarks/recorded_stops.py FOLDER [SET ...] [--left-out | --floor | --related] [--json FILE]

FOLDER holds sets, each with ``recording.parquet`` (phases stop0, stop1), ``robot.urdf`` and ``robot.json``. Every third stop of a
suite is held out; only these are counted.  One line per set and category: held-out stops, those with a certified bound, those that
leave it at any sample, those it does not apply to, and the median of bound over measured angle and time.  With ``--left-out`` every
stop in turn is left out and the others identify: all of suites with few stops, each tenth power-off stop of the others.  (There the
sets are not widened to enclose the training stops, as it would take hours; that makes them no wider than they would be.)  With ``--floor``
all stops identify, the one that is judged too, and intervals are the hulls of what was seen: how tight a bound of independent intervals
could be at best, whatever rule makes them from however many stops like these.  ``--related``: power off alone, beside that floor the
farthest of the bounds that have one stop's own delays, rises and torques each: what no set that keeps together what goes together can
be tighter than; and both for the stop of each suite that went farthest, once more.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from unittest.mock import patch

import numpy as np

from stopset.artifact import Brakes, Model
from stopset.offline.brakes import bands, divide, judge_stop1
from stopset.offline.brakes.controlled import KINDS, fit_all, ramp_from
from stopset.offline.brakes.data_sheet import assumed_brakes
from stopset.offline.brakes.judge import StopVerdict, first_outside, stop0_tubes, stop1_tube
from stopset.offline.brakes.power_off import Seen, _table, brakes_from, guessed_brakes, look, without_strays
from stopset.offline.brakes.stops import rest_noise
from stopset.offline.description import load_robot
from stopset.offline.identify.pipeline import identify
from stopset.reach.stops.ramp import Ramp, ramp_of, ramp_time
from stopset.reach.stops.setting import Setting, setting_of
from stopset.reach.stops.tube import Tube
from stopset.reach.stops.tubes import stopped_after
from stopset.recording import Recording, read_recordings
from stopset.sets import Box

EACH = 4  # of many stops of a suite that are asked what related sets would give
MANY = 10  # stops of a suite from which on only each tenth is left out
STILL = 0.015  # [rad/s] a measured joint slower than this has stopped


@dataclass(frozen=True)
class Row:
    """One set and category."""

    name: str
    category: str
    held: int
    certified: int
    violated: int
    uncovered: int
    angle: float  # median of bound over measured, joint that went farthest
    time: float
    outside: tuple[tuple[str, int, float], ...]


def exceeds(tubes: Sequence[Tube], r: Recording, rests: float | None = None) -> tuple[float, float]:
    """Bound over measured: angle of the joint that went farthest, time until the last joint stopped (``rests`` [s], default the tubes')."""
    k = r.stop_requested
    assert k is not None
    travel = np.abs(r.q[k:] - r.q[k]).max(axis=0)
    i = int(np.argmax(travel))
    far = max(max(float(t.d_hi[:, i].max()), -float(t.d_lo[:, i].min())) for t in tubes)
    moving = np.flatnonzero((np.abs(r.dq[k:]) > STILL).any(axis=1))
    lasted = float(r.t[k + min(int(moving[-1]) + 1, len(r.t) - 1 - k)] - r.t[k]) if len(moving) else np.nan
    return far / float(travel[i]), (max(float(stopped_after(t).max()) for t in tubes) if rests is None else rests) / lasted


def rest_of(ramp: Ramp, noise: Box, r: Recording) -> float:
    """[s] time to rest of a controlled stop from the state measured at its request; nan where the ramp does not tell."""
    k, n = r.stop_requested, r.dq.shape[1]
    assert k is not None
    rest = ramp_time(ramp, r.dq[k] - noise.hi[n:], r.dq[k] - noise.lo[n:])
    return np.nan if rest is None else float(rest.max())


def rows_of(name: str, model: Model, recordings: Sequence[Recording]) -> list[Row]:
    """What the held-out stops of one set say."""
    setting, ramp = setting_of(model), ramp_of(model)
    out = []
    held = divide([r for r in recordings if r.phase == "stop0"])[1]
    if setting is not None and "stop0" in model.sets and held:
        known = [(r, t) for r, t in ((r, stop0_tubes(setting, r)) for r in held) if t is not None]
        left = [(r.label, *x) for r, x in ((r, first_outside(t, r, setting.noise)) for r, t in known) if x is not None]
        out.append(_row(name, "STOP 0", StopVerdict(len(held), len(known), tuple(left)), [exceeds(t, r) for r, t in known]))
    held = divide([r for r in recordings if r.phase == "stop1"])[1]
    if setting is not None and ramp is not None and held:
        ratios = [exceeds([stop1_tube(ramp, setting.noise, r)], r, rest_of(ramp, setting.noise, r)) for r in held]
        out.append(_row(name, "STOP 1", judge_stop1(ramp, setting.noise, held), ratios))
    return out


def left_out(name: str, model: Model, recordings: Sequence[Recording], floor: bool = False) -> list[Row]:
    """What each stop says of brakes and ramp identified from all others; ``floor``: from all, and held to what was seen alone."""
    stops = [r for r in recordings if r.phase in ("stop0", "stop1")]
    noise = rest_noise(stops, model.n)
    assert noise is not None
    model = replace(model, brakes=assumed_brakes(model.robot))
    model = replace(model, sets={**model.sets, "stop0": replace(model.powered, X0=noise, V=noise, active=())})
    out = int(not floor)  # how many stops in turn are left out
    with patch.object(bands, "RISK", 1.0) if floor else nullcontext():
        return [_left_out_stop0(name, model, stops, noise, out), _left_out_stop1(name, stops, noise, out)]


def _left_out_stop0(name: str, model: Model, stops: Sequence[Recording], noise: Box, out: int) -> Row:
    mine = [r for r in stops if r.phase == "stop0"]
    wide = model.brakes or guessed_brakes(model, mine, noise)
    seen = look(model, wide, mine, noise)
    tried, known, left, ratios = 0, 0, [], []
    for k, r in enumerate(mine):
        if sum(x.suite == r.suite for x in mine) > MANY and k % 10:
            continue
        tried += 1
        found = brakes_from(model, wide, [*seen[:k], *seen[k + out :]], noise, [])
        setting = setting_of(found) if found is not None else None
        tubes = stop0_tubes(setting, r) if setting is not None else None
        if setting is None or tubes is None:
            continue
        known += 1
        outside = first_outside(tubes, r, setting.noise)
        left += [] if outside is None else [(r.label, *outside)]
        ratios.append(exceeds(tubes, r))
    return _row(name, "STOP 0", StopVerdict(tried, known, tuple(left)), ratios)


def related(name: str, model: Model, recordings: Sequence[Recording]) -> list[Row]:
    """Power-off stops: the floor of intervals, that of related sets, and both of each suite's farthest stop alone."""
    stops = [r for r in recordings if r.phase in ("stop0", "stop1")]
    mine, noise = [r for r in stops if r.phase == "stop0"], rest_noise(stops, model.n)
    assert noise is not None
    model = replace(model, brakes=assumed_brakes(model.robot))
    model = replace(model, sets={**model.sets, "stop0": replace(model.powered, X0=noise, V=noise, active=())})
    wide = model.brakes or guessed_brakes(model, mine, noise)
    seen = look(model, wide, mine, noise)
    with patch.object(bands, "RISK", 1.0):
        found = brakes_from(model, wide, seen, noise, [])
    whole = setting_of(found) if found is not None else None
    assert whole is not None and found is not None and found.brakes is not None
    hulls, points = {}, {}
    for k, r in enumerate(mine):
        if sum(x.suite == r.suite for x in mine) > MANY and k % EACH:
            continue
        tubes, each = stop0_tubes(whole, r), [stop0_tubes(p, r) for p in own_settings(whole, found.brakes, seen)]
        if tubes is not None and all(x is not None for x in each):
            hulls[k], points[k] = exceeds(tubes, r), exceeds([t for x in each if x is not None for t in x], r)
    last = {}
    for k in hulls:
        last.setdefault(mine[k].suite_key, []).append(k)
    far = [max(v, key=lambda k: _travel(mine[k])) for v in last.values() if len(v) > 1]
    kinds = (("intervals", hulls), ("related", points))
    rows = [_row(name, f"STOP 0, {kind}", StopVerdict(len(x), len(x), ()), list(x.values())) for kind, x in kinds]
    return rows + [_row(name, f"farthest, {kind}", StopVerdict(len(far), len(far), ()), [x[k] for k in far]) for kind, x in kinds]


def own_settings(setting: Setting, brakes: Brakes, seen: Sequence[Seen]) -> list[Setting]:
    """The arm with the brakes of each stop that told when they engaged; what it did not tell as the others' medians."""
    delays, rises, torques = (_table(seen, x) for x in ("delay", "rise", "torque"))
    lag = np.zeros(delays.shape[1]) if brakes.lag is None else brakes.lag
    delays = without_strays(delays, lag, [])
    rise, torque = np.nanmedian(rises), np.array([np.nanmedian(x) if np.isfinite(x).any() else np.nan for x in torques.T])
    torque = np.where(np.isfinite(torque), torque, brakes.torque.centre)
    out = []
    for d, r, b in zip(delays, rises, torques, strict=True):
        if np.isfinite(d).any():
            d = np.maximum(np.where(np.isfinite(d), d, np.nanmedian(d - lag) + lag), 0.0)
            r, b = np.where(np.isfinite(r), r, rise), np.where(np.isfinite(b), b, torque)
            at = {"delay_lo": d, "delay_hi": d, "rise_lo": r, "rise_hi": r, "brake_lo": b, "brake_hi": b}
            out.append(replace(setting, plant=setting.plant._replace(**at), delay_spread=None, lag=None))
    return out


def _travel(r: Recording) -> float:
    """[rad] of the joint that went farthest since the request."""
    k = r.stop_requested
    assert k is not None
    return float(np.abs(r.q[k:] - r.q[k]).max())


def _left_out_stop1(name: str, stops: Sequence[Recording], noise: Box, out: int) -> Row:
    mine = [r for r in stops if r.phase == "stop1"]
    fits = {kind: fit_all(kind, mine) for kind in KINDS}
    verdicts, ratios = [], []
    for k, r in enumerate(mine):
        others = {kind: [*f[:k], *f[k + out :]] for kind, f in fits.items()}
        ramp = ramp_from(others, [*mine[:k], *mine[k + out :]], [x for x in stops if x is not r or not out], noise, [])
        verdicts.append(judge_stop1(ramp, noise, [r]))
        ratios.append(exceeds([stop1_tube(ramp, noise, r)], r, rest_of(ramp, noise, r)))
    certified, uncovered = sum(v.certified for v in verdicts), tuple(x for v in verdicts for x in v.uncovered)
    return _row(
        name, "STOP 1", StopVerdict(len(mine), certified, tuple(x for v in verdicts for x in v.outside), uncovered), ratios
    )


def _row(name: str, category: str, v: StopVerdict, ratios: Sequence[tuple[float, float]]) -> Row:
    angle, time = np.nanmedian(ratios, axis=0) if ratios else (np.nan, np.nan)
    return Row(name, category, v.stops, v.certified, len(v.outside), len(v.uncovered), float(angle), float(time), v.outside)


def main() -> None:
    args = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    args.add_argument("folder", type=Path)
    args.add_argument("sets", nargs="*", help="names of sets, default all")
    how = args.add_mutually_exclusive_group()
    how.add_argument("--left-out", action="store_true", help="leave out every stop in turn")
    how.add_argument("--floor", action="store_true", help="leave none out, and widen nothing: what no rule goes below")
    how.add_argument(
        "--related", action="store_true", help="power off: what sets of each stop's own numbers could give, beside intervals"
    )
    args.add_argument("--json", type=Path)
    given = args.parse_args()
    if not given.folder.is_dir():
        args.error(f"{given.folder} is no folder; expected one with a folder for each set")
    ways = ((given.left_out, left_out), (given.floor, partial(left_out, floor=True)), (given.related, related), (True, rows_of))
    ask = next(way for chosen, way in ways if chosen)
    rows: list[Row] = []
    print(f"{'set':<6} {'':<19} {'held':>4} {'certified':>9} {'violated':>8} {'uncovered':>9} {'angle':>6} {'time':>6}")
    for folder in sorted(p for p in given.folder.iterdir() if (p / "recording.parquet").is_file()):
        if given.sets and folder.name not in given.sets:
            continue
        robot = load_robot(folder / "robot.urdf")
        data = [folder / "recording.parquet"]
        model = identify(robot, data).model
        stops = [r for r in read_recordings(data, robot) if r.phase in ("stop0", "stop1")]
        for row in ask(folder.name, model, stops):
            rows.append(row)
            print(
                f"{row.name:<6} {row.category:<19} {row.held:>4} {row.certified:>9} {row.violated:>8} {row.uncovered:>9} "
                f"{row.angle:>6.2f} {row.time:>6.2f}  {'; '.join(f'{x[0]}: joint {x[1] + 1} at {x[2]:.3f} s' for x in row.outside)}",
                flush=True,
            )
    for category in ("STOP 0", "STOP 1"):
        mine = [r for r in rows if r.category == category]
        if mine:
            print(
                f"{category}: {sum(r.certified for r in mine)} of {sum(r.held for r in mine)} stops not identified from certified, "
                f"{sum(r.violated for r in mine)} violated, {sum(r.uncovered for r in mine)} not covered; median over sets of bound "
                f"over measured: angle {np.nanmedian([r.angle for r in mine]):.2f}, time {np.nanmedian([r.time for r in mine]):.2f}"
            )
    if given.json:
        given.json.write_text(json.dumps([asdict(r) for r in rows], indent=1))


if __name__ == "__main__":
    main()
