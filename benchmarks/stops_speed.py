"""How fast stop bounds are: a box for the monitor, a state, the first call; beside one simulated stop.

    python benchmarks/stops_speed.py [--ramps | --working | --ranges | --alike | --energy [MODEL ...]]

CPU time of this process, so that other work on the machine counts less; medians.
"""

from __future__ import annotations

import argparse
import hashlib
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from stop_arms import prbt_like, ur5_like
from stop_arms_wide import arms

from stop_certificate import certify
from stop_sampling import DT
from stop_tubes import tube_of
from stopset.artifact import load_model
from stopset.core.library import lib
from stopset.reach.stops import StopBounds
from stopset.reach.stops.compiled import CompiledStops
from stopset.reach.stops.parts import ALL_PARTS
from stopset.reach.stops.ramp import Ramp
from stopset.reach.stops.start import Start
from stopset.reach.stops.tube import OK, Stride, march
from stopset.reach.stops.tubes import (
    FAST_ALIKE_KNOTS,
    FAST_ENERGY_KNOTS,
    FAST_KNOTS,
    FAST_WINDOWS,
    KNOTS,
    Region,
    expected_stop,
    march_box,
)
from stopset.reach.stops.types import Category
from stopset.reach.stops.windows import windows
from stopset.sets import Box
from stopset.simulation.stop import StoppingArm, simulate_stop, simulate_stops
from stopset.types import Array

BESIDE = 48  # stops simulated together


def median_us(f: Callable[[], object], count: int) -> float:
    f()
    spent = []
    for _ in range(count):
        start = time.process_time_ns()
        f()
        spent.append(time.process_time_ns() - start)
    return float(np.median(spent)) / 1e3


def cold_ms(bounds: StopBounds, top: float, count: int) -> Array:
    """[ms] of certificates for states that have nothing to do with each other, as after a jump or a lost cycle."""
    rng, box, spent = np.random.default_rng(3), (np.full(6, 0.01), np.full(6, 0.05)), []
    for _ in range(count):
        q, dq = rng.uniform(-2.3, 2.3, 6), rng.uniform(-top, top, 6)
        start = time.process_time_ns()
        certify(bounds, q, dq, *box)
        spent.append((time.process_time_ns() - start) / 1e6)
    return np.array(spent)


def wider(bounds: StopBounds, top: float, count: int) -> float:
    """Median over unrelated states: largest angle of the fast loop's tube over that of a table's."""
    s, rng, ratio = bounds.setting, np.random.default_rng(4), []
    assert s is not None
    r, v = s.noise.radius[:6] + 0.01, s.noise.radius[6:] + 0.05
    for _ in range(count):
        q, dq = rng.uniform(-2.3, 2.3, 6), rng.uniform(-top, top, 6)
        few, many = (tube_of(s, q, dq, r, v, knots=k) for k in (FAST_KNOTS, KNOTS))
        if few.end == many.end == OK:
            ratio.append(max(few.d_hi.max(), -few.d_lo.min()) / max(many.d_hi.max(), -many.d_lo.min()))
    return float(np.median(ratio))


def boxes(states: int = 12) -> None:
    """Boxes of the monitor on each arm of `stop_arms_wide` with its load, by the core alone."""
    print(f"boxes of +-0.01 rad and +-0.05 rad/s by the core, rated load, {states} states: median [ms], worst [ms], with a bound")
    for name, (model, top) in arms().items():
        rated, n, rng = model.domain.payload[1], model.n, np.random.default_rng(1)
        setting = StopBounds.of(model, (0.98 * rated, rated)).setting
        assert setting is not None
        core, spent, found = CompiledStops.of(setting), [], 0
        for _ in range(states):
            q, dq = rng.uniform(-np.pi, np.pi, n), rng.uniform(-1.0, 1.0, n) * top
            start = time.thread_time_ns()
            found += core.bound(q, dq, "0", np.full(n, 0.01), np.full(n, 0.05)) is not None
            spent.append((time.thread_time_ns() - start) / 1e6)
        print(f"  {name}, {rated:.3g} kg: {np.median(spent):.2f}, {max(spent):.2f}, {found} of {states}")


def ramps(states: int = 12) -> None:
    """STOP 0, and STOP 1 that may fail: power taken after a time (SS1-t), or when the ramp is left (SS1-r)."""
    print(
        f"by the core, payload from nothing to the rated one, {states} measured states: STOP 0, SS1-t and SS1-r that may fail: median [ms], "
        "worst [ms]; a hash of all bounds"
    )
    kinds: tuple[tuple[Category, float | None, bool], ...] = (
        ("0", 0.4, False),
        ("1 guaranteed", 0.4, False),
        ("1 guaranteed", None, True),
    )
    every = 0.0
    for name, (model, top) in arms().items():
        n, told, bits = model.n, [], hashlib.sha256()
        setting = StopBounds.of(model, model.domain.payload).setting
        assert setting is not None
        about = Ramp(
            "time", Box.of(np.full(n, 0.25), np.full(n, 0.3)), Box.of(np.full(n, 0.004), np.full(n, 0.01)), np.full(n, 0.01), np.full(n, 0.05),
        )  # fmt: skip
        for category, after, monitored in kinds:
            core, rng, spent = (
                CompiledStops.of(setting, replace(about, off_after=after, monitored=monitored)),
                np.random.default_rng(1),
                [],
            )
            for _ in range(states):
                q, dq = rng.uniform(-np.pi, np.pi, n), rng.uniform(-1.0, 1.0, n) * top
                start = time.thread_time_ns()
                found = core.bound(q, dq, category)
                spent.append((time.thread_time_ns() - start) / 1e6)
                bits.update(
                    b"none"
                    if found is None
                    else np.concatenate([found.time, found.forward, found.back, found.speed, found.tool]).tobytes()
                )
            told.append(f"{np.median(spent):.2f}, {max(spent):.2f}")
            every += sum(spent)
        print(f"  {name}, 0 to {model.domain.payload[1]:.3g} kg: {'; '.join(told)}; {bits.hexdigest()[:12]}", flush=True)
    print(f"  all of them: {every / 1e3:.2f} s")


def working(states: int = 100) -> None:
    """STOP 1 that works, of boxes that move at up to half of full speed, any payload: where the drives surely have the torque."""
    print(
        f"STOP 1 that works, ramp 0.35 s, boxes of +-0.05 rad and +-5 % of full speed, any payload, {states} states: median [ms], with a bound"
    )
    for name, (model, top) in arms().items():
        n, ramp, rng, spent, found = model.n, Ramp.stated(model.n, time=0.35), np.random.default_rng(1), [], 0
        setting = StopBounds.of(model, model.domain.payload, ramp=ramp).setting
        assert setting is not None
        core = CompiledStops.of(setting, ramp)
        for _ in range(states):
            q, dq = rng.uniform(-2.0, 2.0, n), 0.5 * rng.uniform(-1.0, 1.0, n) * top
            start = time.thread_time_ns()
            found += core.bound(q, dq, "1", np.full(n, 0.05), np.full(n, 0.05 * top)) is not None
            spent.append((time.thread_time_ns() - start) / 1e6)
        print(f"  {name}, 0 to {model.domain.payload[1]:.3g} kg: {np.median(spent):.2f}, {found} of {states}", flush=True)


def ranges(states: int = 60) -> None:
    """Ranges of payloads in two parts beside all of them at once, measured states that the kinetic energy has to bound."""
    print(
        f"payloads in two parts over all at once, {states} states: median of the largest angle and of the tool's way, times the processor time"
    )
    for name, (model, top) in arms().items():
        rated, n = model.domain.payload[1], model.n
        for least in (0.0, 0.5, 0.75, 0.95, 0.98):
            setting = StopBounds.of(model, (least * rated, rated)).setting
            assert setting is not None
            loop = StopBounds.of(model, (least * rated, rated), fast=True)
            coarse = replace(setting, payload=(0.0, rated))  # steps of a range, however narrow it is
            whole = replace(loop, setting=coarse, parts=())
            parts = replace(whole, parts=coarse.parts)
            rng, ratios, spent = np.random.default_rng(5), [], np.zeros(2)
            for _ in range(states):
                q, dq, took, found = rng.uniform(-np.pi, np.pi, n), rng.uniform(-1.0, 1.0, n) * top, [], []
                q = np.clip(q, *(0.98 * model.robot.q_limit.T))
                for bounds in (parts, whole):
                    start = time.thread_time_ns()
                    found.append(bounds.bound(q, dq))
                    took.append(time.thread_time_ns() - start)
                a, b = found
                if a.angle is None or b.angle is None or a.tcp is None or b.tcp is None or took[0] < 1.5 * took[1]:
                    continue
                spent += took
                ratios.append([a.angle.max() / b.angle.max(), a.tcp / b.tcp])
            if len(ratios) >= 10:
                angle, tool = np.median(ratios, axis=0)
                which = f"{name}, {least * rated:.3g} to {rated:.3g} kg, {len(ratios)} states"
                print(f"  {which}: {angle:.2f}, {tool:.2f}; {spent[0] / spent[1]:.1f}", flush=True)


def alike(states: int = 40) -> None:
    """Payloads known to 2 %: one tube of finer steps beside all of them and two parts of them, where the kinetic energy has to bound."""
    print(
        f"payloads from 98 to 100 % of the rated one, {2 * states} states, half of them boxes of +-0.01 rad and +-0.05 rad/s: one tube of finer "
        "steps over all and two parts: median, 95 of 100 and largest of angle; time; tool's way, and how many of all are beyond 1.05; "
        "times the processor time"
    )
    every, spent = [], np.zeros(2)
    for name, (model, top) in arms().items():
        rated, n, rng, ratios, took = model.domain.payload[1], model.n, np.random.default_rng(5), [], np.zeros(2)
        setting = StopBounds.of(model, (0.98 * rated, rated)).setting
        assert setting is not None
        fine, parts = CompiledStops.of(setting), CompiledStops.of(setting)
        assert fine.struct.ranged == lib.STOPSET_ALIKE_PAYLOADS
        parts.struct.ranged = lib.STOPSET_SOME_PAYLOADS
        for k in range(2 * states):
            q, dq = rng.uniform(-np.pi, np.pi, n), rng.uniform(-1.0, 1.0, n) * top
            box = (np.full(n, 0.01), np.full(n, 0.05)) if k % 2 else (None, None)
            found, each = [], np.zeros(2)
            for i, core in enumerate((fine, parts)):
                start = time.thread_time_ns()
                found.append(core.bound(q, dq, "0", *box))
                each[i] = time.thread_time_ns() - start
            a, b = found
            if a is None or b is None or np.array_equal(a.time, b.time):
                continue
            took += each
            angle = max(a.forward.max(), a.back.max()) / max(b.forward.max(), b.back.max())
            ratios.append([angle, a.time.max() / b.time.max(), a.tool[0] / b.tool[0]])
        if len(ratios) >= 10:
            print(
                f"  {name}, {rated:.3g} kg, {len(ratios)} of {2 * states}: {spread_of(np.array(ratios))}; {took[0] / took[1]:.2f}",
                flush=True,
            )
        every += ratios
        spent += took
    print(f"  all, {len(every)}: {spread_of(np.array(every))}; {spent[0] / spent[1]:.2f}")


def spread_of(ratios: Array) -> str:
    """Of each column: median, 95 of 100, largest, share beyond 1.05."""
    columns = [(*np.percentile(x, [50, 95, 100]), np.mean(x > 1.05)) for x in ratios.T]
    return "; ".join(f"{a:.2f}, {b:.2f}, {c:.2f} ({d:.1%})" for a, b, c, d in columns)


def energy(files: list[str], states: int = 60) -> None:
    """What of a bound is the kinetic energy's tube that bounds it, in the region that holds it: what is left if nothing else were tried."""
    print(
        f"STOP 0 by the core, {states} measured states: of those that the kinetic energy bounds, median [ms] of the bound; of its tubes alone"
    )
    cases = [(name, model, (0.98 * model.domain.payload[1], model.domain.payload[1])) for name, (model, _) in arms().items()]
    cases += [(Path(f).name, load_model(f), None) for f in files]
    for name, model, payload in cases:
        loop, rng, d = StopBounds.of(model, payload, fast=True), np.random.default_rng(5), model.domain
        loop = replace(loop, parts=())
        s, whole, alone = loop.setting, [], []
        assert s is not None
        within = np.clip(np.array([d.q.lo, d.q.hi]), -np.pi, np.pi).clip(*model.robot.q_limit.T)
        knots = FAST_ENERGY_KNOTS if s.payloads == lib.STOPSET_SOME_PAYLOADS else FAST_ALIKE_KNOTS
        for _ in range(states):
            q, dq = rng.uniform(*within), rng.uniform(d.dq.lo, d.dq.hi)
            if loop.bound(q, dq).layer != "energy":
                continue
            start = Start(
                q + s.start.centre[: s.model.n],
                dq + s.start.centre[s.model.n :],
                s.start.radius[: s.model.n],
                s.start.radius[s.model.n :],
            )
            region = Region.first(s, start.fastest, expected_stop(s.plant, start.q, start.fastest))
            plants = windows(s.plant, s.delay_spread, s.lag, FAST_WINDOWS)
            tubes = [march_box(s, p, start, energetic=True, knots=knots, region=region) for p in plants]
            if not all(t.end == OK for t in tubes):
                continue
            begin = time.thread_time_ns()
            loop.bound(q, dq)
            middle = time.thread_time_ns()
            for p in plants:  # in the region that is known by now
                march_box(s, p, start, energetic=True, knots=knots, region=region)
            whole.append((middle - begin) / 1e6)
            alone.append((time.thread_time_ns() - middle) / 1e6)
        if len(whole) >= 10:
            print(f"  {name}, {len(whole)} states: {np.median(whole):.2f}; {np.median(alone):.2f}", flush=True)


FRESH = """
import time; a = time.perf_counter()
import numpy as np; from stop_arms import prbt_like; from stopset.reach.stops import StopBounds
from stopset.reach.stops.compiled import CompiledStops
b = time.perf_counter(); bounds = StopBounds.of(prbt_like(), (0.0, 0.25))
c = time.perf_counter(); bounds.bound(np.full(6, 0.3), np.full(6, 0.5))
d = time.perf_counter(); bounds.bound(np.full(6, -0.3), np.full(6, 0.6))
e = time.perf_counter(); print(b - a, c - b, d - c, e - d)
"""


def fresh_process() -> list[float]:
    """[s] of imports, of preparing a model, of the first bound and of the second in a new process, best of three."""
    runs = [
        subprocess.run(
            [sys.executable, "-c", FRESH], cwd=Path(__file__).parent, capture_output=True, text=True, check=True
        ).stdout
        for _ in range(3)
    ]
    return np.min([[float(x) for x in r.split()] for r in runs], axis=0).tolist()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--ramps", action="store_true", help="STOP 1 that may fail")
    which.add_argument("--working", action="store_true", help="STOP 1 that works")
    which.add_argument("--ranges", action="store_true", help="ranges of payloads in two parts beside all of them at once")
    which.add_argument(
        "--alike", action="store_true", help="payloads known to 2 %% in one tube of finer steps beside two parts of them"
    )
    which.add_argument("--energy", nargs="*", metavar="MODEL", help="the kinetic energy's tubes alone, of these models too")
    args = parser.parse_args()
    if args.energy is not None:
        if missing := [x for x in args.energy if not Path(x).is_file()]:
            parser.error(f"no model file {missing[0]}; expected what `stopset identify` made")
        energy(args.energy)
    if args.ramps:
        ramps()
    if args.working:
        working()
    if args.ranges:
        ranges()
    if args.alike:
        alike()
    if args.ramps or args.working or args.ranges or args.alike or args.energy is not None:
        return
    bounds = StopBounds.of(prbt_like(), (0.0, 0.25))
    q = np.array([0.1, 0.5, 0.3, -0.4, 0.2, 0.1])
    dq = np.array([1.0, 0.8, -0.7, 0.3, 0.5, -1.0])
    bounds.bound(q, dq)
    start = time.perf_counter()
    StopBounds.of(prbt_like(), (0.0, 0.25)).bound(q, dq)
    again = time.perf_counter() - start
    s = bounds.setting
    assert s is not None
    box = np.full(6, 0.01), np.full(6, 0.05)
    certificate = certify(bounds, q, dq, *box)
    assert certificate is not None
    lasts = expected_stop(s.plant, q, np.abs(dq))
    r, v = s.noise.radius[:6] + box[0], s.noise.radius[6:] + box[1]
    steps = len(certificate.tube.t) - 1
    core = CompiledStops.of(s)
    monitored = median_us(lambda: core.bound(q, dq, "0", *box), 200)
    whole = median_us(lambda: bounds.bound(q, dq), 200)
    certifier = median_us(lambda: certify(bounds, q, dq, *box), 200)
    fine = median_us(
        lambda: march(s.plant, Box(q - r, q + r), Box(dq - v, dq + v), Stride(lasts / KNOTS.stop, 6 * KNOTS.stop), ALL_PARTS), 200
    )
    p, none = s.plant, np.zeros((1, 6))
    length = int(np.ceil(certificate.tube.t[-1] / DT))
    simulated = median_us(
        lambda: simulate_stop(
            StoppingArm(p.chain, p.pi, p.rotor, p.coulomb_lo, p.viscous_lo, p.brake_lo, p.delay_hi, p.rise_hi),
            q,
            dq,
            DT,
            length,
            none,
        ),
        100,
    )
    many = StoppingArm(
        p.chain, *(np.repeat(x[None], BESIDE, axis=0) for x in (p.pi, p.rotor, p.coulomb_lo, p.viscous_lo, p.brake_lo, p.delay_hi, p.rise_hi))
    )  # fmt: skip
    starts = np.repeat([[q], [dq]], BESIDE, axis=1)
    beside = median_us(lambda: simulate_stops(many, *starts, DT, length, np.zeros((BESIDE, 1, 6))), 20) / BESIDE
    print(
        f"box of the monitor, +-{box[0][0]:g} rad, +-{box[1][0]:g} rad/s, by the core with the tool's way: {monitored / 1e3:.2f} ms ({steps} steps)"
    )
    print(
        f"  one nonlinear simulation at {DT * 1e3:g} ms: {simulated:.0f} us ({beside:.0f} us each of {BESIDE} together), so a box is worth "
        f"{monitored / simulated:.1f} simulated stops ({monitored / beside:.1f})"
    )
    print(
        f"its tube alone, from Python: {certifier / 1e3:.2f} ms, "
        f"with the steps of tables {fine / 1e3:.2f} ms; angles {wider(bounds, 1.26, 100) - 1:.1%} wider"
    )
    print(f"whole bound with TCP and links: {whole / 1e3:.2f} ms")
    cold = cold_ms(bounds, 1.26, 200)
    print(
        f"that tube for 200 unrelated states: median {np.median(cold):.2f} ms, worst "
        f"{cold.max():.2f} ms (it never uses an earlier cycle)"
    )
    strong = StopBounds.of(ur5_like(), (4.75, 5.0))
    live = replace(strong, fast=True)
    rng, hard, loop, wide = np.random.default_rng(77), [], [], []
    while len(hard) < 20:
        x, y = rng.uniform(-2.3, 2.3, 6), rng.uniform(-2.0, 2.0, 6)
        begin = time.process_time_ns()
        exact = strong.bound(x, y)
        middle = time.process_time_ns()
        coarse = live.bound(x, y)
        if exact.layer == coarse.layer == "energy":
            hard.append((middle - begin) / 1e6)
            loop.append((time.process_time_ns() - middle) / 1e6)
            assert exact.angle is not None and coarse.angle is not None
            wide.append(coarse.angle.max() / exact.angle.max())
    print(
        f"whole bound where the kinetic energy has to help (UR5-like, a quarter of the rotors, 5 kg): median {np.median(hard):.0f} ms, "
        f"in the monitor's steps {np.median(loop):.0f} ms, at most {max(loop):.0f} ms, angle {np.median(wide):.2f} times as large"
    )
    loop = replace(bounds, fast=True)
    from_python, alone = median_us(lambda: loop.bound(q, dq), 200), median_us(lambda: core.bound(q, dq), 200)
    print(
        f"one bound in the monitor's steps: by the core with the tool's way {alone:.0f} us, all that Python tells of it {from_python:.0f} us"
    )
    boxes()
    ramps()
    print(f"a new model's first bound {again * 1e3:.0f} ms")
    imports, preparing, first, second = fresh_process()
    print(
        f"fresh process: imports {imports * 1e3:.0f} ms, model {preparing * 1e3:.0f} ms, first bound {first * 1e3:.0f} ms, "
        f"second bound {second * 1e3:.1f} ms"
    )


if __name__ == "__main__":
    main()
