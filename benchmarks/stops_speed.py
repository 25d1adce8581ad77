"""How fast stop bounds are: the online bound, the certifier, the first call; as ratios to plain numpy and to the simulation.

    python benchmarks/stops_speed.py

CPU time of this process, so that other work on the machine counts less; medians.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from stop_arms import prbt_like

from stopset.offline.stops.sampling import DT
from stopset.reach.stops import Certificate, StopBounds
from stopset.reach.stops.local import ALL_PARTS
from stopset.reach.stops.tube import march
from stopset.reach.stops.tubes import expected_stop
from stopset.simulation.stop import simulate_stop

Array = NDArray[np.float64]


def median_us(f: Callable[[], object], count: int) -> float:
    f()
    spent = []
    for _ in range(count):
        start = time.process_time_ns()
        f()
        spent.append(time.process_time_ns() - start)
    return float(np.median(spent)) / 1e3


def plain_numpy(c: Certificate, dq: Array) -> tuple[Array, Array]:
    """The same comparison for the upper curves alone, as array operations: cumulative sums and running minima."""
    h = c.tube.t[1]
    rate = np.where(np.isfinite(c.tube.forward_hi), c.tube.forward_hi, 0.0)
    Z = np.vstack([dq + c.dq_noise, dq + c.dq_noise + h * np.cumsum(rate, axis=0)])
    U = Z - np.minimum(0.0, np.minimum.accumulate(Z, axis=0))
    return U, np.cumsum(0.5 * h * (U[1:] + U[:-1]), axis=0)


def main() -> None:
    start = time.perf_counter()
    bounds = StopBounds.of(prbt_like(), (0.0, 0.25))
    q = np.array([0.1, 0.5, 0.3, -0.4, 0.2, 0.1])
    dq = np.array([1.0, 0.8, -0.7, 0.3, 0.5, -1.0])
    bounds.bound(q, dq)
    first = time.perf_counter() - start
    start = time.perf_counter()
    StopBounds.of(prbt_like(), (0.0, 0.25)).bound(q, dq)
    again = time.perf_counter() - start
    s = bounds.setting
    assert s is not None
    box = np.full(6, 0.01), np.full(6, 0.05)
    certificate = bounds.certify(q, dq, *box)
    assert certificate is not None
    lasts = expected_stop(s.plant, q, np.abs(dq))
    r, v = s.noise.radius[:6] + box[0], s.noise.radius[6:] + box[1]
    steps = len(certificate.tube.t) - 1
    online = median_us(lambda: certificate.bound(q, dq), 2000)
    whole = median_us(lambda: bounds.bound(q, dq), 200)
    certifier = median_us(lambda: bounds.certify(q, dq, *box), 200)
    coarse = median_us(lambda: march(s.plant, q - r, q + r, dq - v, dq + v, lasts / 100, 600, ALL_PARTS), 200)
    numpy_ = median_us(lambda: plain_numpy(certificate, dq), 500)
    p, none = s.plant, np.zeros((1, 6))
    length = int(np.ceil(certificate.tube.t[-1] / DT))
    simulated = median_us(
        lambda: simulate_stop(
            p.chain, p.pi, p.rotor, p.coulomb_lo, p.viscous_lo, p.brake_lo, p.delay_hi, p.rise_hi, q, dq, DT, length, none
        ),
        100,
    )
    print(f"online bound, 6 joints x {steps} steps: {online:.0f} us ({online * 200 / steps:.0f} us per 200 steps)")
    print(f"  plain numpy, upper curves alone: {numpy_:.0f} us, {numpy_ / online:.1f} times as long")
    print(f"  one nonlinear simulation at {DT * 1e3:g} ms: {simulated:.0f} us, {simulated / online:.1f} times as long")
    print(
        f"certifier on a box of +-{box[0][0]:g} rad, +-{box[1][0]:g} rad/s: {certifier / 1e3:.2f} ms, coarse {coarse / 1e3:.2f} ms"
    )
    print(f"whole bound with TCP and links: {whole / 1e3:.2f} ms")
    print(f"first bound in this process {first * 1e3:.0f} ms (kernels from cache), a new model's first {again * 1e3:.0f} ms")


if __name__ == "__main__":
    main()
