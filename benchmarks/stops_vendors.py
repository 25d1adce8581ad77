"""Published stop tables beside our bound for a comparable arm, as a picture.

    python benchmarks/stops_vendors.py docs/pictures/stops-vendors.svg

Left, power off: the angles that the UR5's manual gives for its first three axes (full speed, extension and load, one axis at a
time), and a UR5-like arm whose brake torque is the one with which a nominal simulated stop lasts as long as the manual says: what is
compared is the angle.  The bound takes brakes known within 10 % and what the model leaves open.  Right, a controlled stop: all angles of the
TM5-700's table of category 1, and the bound of a ramp of fixed time that its rows at 33 and 66 % of the speed tell.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from stop_arms import prbt_like, ur5_like

from stop_sampling import DT
from stopset.artifact import Model
from stopset.files import write_text
from stopset.offline.stops.poses import Poses
from stopset.reach.stops import Ramp, StopBounds
from stopset.sets import Box
from stopset.simulation.stop import StoppingArm, simulate_stop
from stopset.types import Array

UR5 = {"J1": (0.31, 0.244), "J2": (0.70, 0.530), "J3": (0.22, 0.164)}  # [rad], [s], manual of the CB3
UR5_SPEED, UR5_LOAD = 3.19, 5.0
TM5_SPEED, SPEEDS = np.pi, (0.33, 0.66, 1.0)
TM5 = {  # [deg] category 1, manual of the TM5-700: for each axis nine rows (load, extension) of three speeds
    "J1": ((9.00, 17.96, 26.55), (8.99, 17.95, 26.34), (8.98, 17.94, 26.76), (9.01, 17.95, 26.75), (8.96, 17.96, 26.46),
           (8.94, 17.90, 26.58), (8.96, 17.92, 26.33), (8.95, 17.92, 26.88), (8.94, 17.86, 26.00)),
    "J2": ((9.29, 18.15, 27.13), (9.17, 18.08, 27.72), (9.30, 18.19, 27.80), (9.23, 18.12, 26.99), (9.29, 18.14, 28.36),
           (9.38, 18.10, 28.53), (9.26, 18.16, 30.98), (9.34, 18.26, 31.10), (9.34, 18.14, 26.45)),
    "J3": ((8.97, 17.91, 26.92), (8.96, 17.94, 23.41), (9.00, 18.02, 28.81), (8.99, 17.97, 26.91), (8.97, 17.98, 27.73),
           (9.08, 18.16, 28.75), (9.12, 18.28, 27.40), (9.28, 18.26, 27.56), (9.34, 18.09, 28.80)),
}  # fmt: skip
WIDTH, HEIGHT, PAD = 470.0, 330.0, 52.0
INK, OURS, THEIRS, GREY = "#263238", "#1565c0", "#b3261e", "#8d99a3"
PIECES, LONGEST, LEAST_TORQUE = 64, 1.5, 1.0


class Compared(NamedTuple):
    """[rad] and [s] of one axis: published, nominal with the same time, bound; ``torque`` [N m] of the brake that takes this time."""

    published: tuple[float, float]
    nominal: tuple[float, float]
    bound: tuple[float, float]
    torque: float


def with_brake(model: Model, joint: int, torque: float) -> Model:
    assert model.brakes is not None
    middle = model.brakes.torque.centre.copy()
    middle[joint] = torque
    return replace(model, brakes=replace(model.brakes, torque=Box.of(0.9 * middle, 1.1 * middle)))


def nominal(model: Model, q: Array, dq: Array, joint: int) -> tuple[float, float]:
    """Angle [rad] and time [s] of a simulated stop of middle parameters; infinite where it does not end."""
    s = StopBounds.of(model, (0.98 * UR5_LOAD, UR5_LOAD)).setting
    assert s is not None
    p = s.plant
    middle = [0.5 * (getattr(p, f"{x}_lo") + getattr(p, f"{x}_hi")) for x in ("coulomb", "viscous", "brake", "delay", "rise")]
    arm = StoppingArm(p.chain, p.pi, p.rotor, *middle)
    qs, vs = simulate_stop(arm, q, dq, DT, int(LONGEST / DT), np.zeros((1, len(q))))
    moves = np.abs(vs[:, joint]) > 1e-3
    last = len(moves) - 1 - int(np.argmax(moves[::-1]))
    return float(np.abs(qs[:, joint] - q[joint]).max()), np.inf if moves[-1] else DT * last


def compared(joint: int, published: tuple[float, float]) -> Compared:
    """One axis of the UR5, in the direction in which it falls."""
    model = ur5_like(rotor_scale=1.0)
    first = StopBounds.of(model, (0.98 * UR5_LOAD, UR5_LOAD)).setting
    assert first is not None
    q = Poses.of(model.robot, model.robot.tip, model.domain.q).worst_for(joint, 1.0, first.plant.pi)
    dq = UR5_SPEED * np.eye(model.n)[joint]
    assert model.brakes is not None
    dq *= max((1.0, -1.0), key=lambda sign: nominal(model, q, sign * dq, joint)[0])
    weak, strong = LEAST_TORQUE, float(model.brakes.torque.hi[joint]) * 4.0
    for _ in range(40):  # the stronger the brake the shorter the stop
        torque = float(np.sqrt(weak * strong))
        late = nominal(with_brake(model, joint, torque), q, dq, joint)[1] > published[1]
        weak, strong = (torque, strong) if late else (weak, torque)
    fitted = with_brake(model, joint, strong)
    b = StopBounds.of(fitted, (0.98 * UR5_LOAD, UR5_LOAD), pieces=PIECES).bound(q, dq)
    found = (np.nan, np.nan) if b.angle is None or b.time is None else (float(b.angle[joint]), float(b.time[joint]))
    return Compared(published, nominal(fitted, q, dq, joint), found, strong)


def ramp_bound(lo: float, hi: float) -> list[float]:
    """[rad] of a ramp of ``lo`` to ``hi`` seconds at `SPEEDS`, from exactly known states."""
    model = prbt_like((0.0, 3.0), top_speed=TM5_SPEED)
    exact = Box.symmetric(np.full(2 * model.n, 1e-12))
    robot = replace(model.robot, torque_limit=np.full(model.n, 1e4), dq_limit=np.full(model.n, TM5_SPEED))
    model = replace(model, robot=robot, sets={"powered": replace(model.powered, V=exact)})
    ramp = replace(Ramp.stated(model.n, time=hi, control=0.0), value=Box.of(np.full(model.n, lo), np.full(model.n, hi)))
    bounds, out = StopBounds.of(model, ramp=ramp), []
    for share in SPEEDS:
        angle = bounds.bound(np.zeros(model.n), share * TM5_SPEED * np.eye(model.n)[0], "1").angle
        assert angle is not None
        out.append(float(angle[0]))
    return out


def ramp_times(columns: tuple[int, ...]) -> tuple[float, float]:
    """[s] least and largest time of a ramp that the published angles at these of `SPEEDS` tell: twice the angle over the speed."""
    times = [2.0 * np.deg2rad(row[c]) / (SPEEDS[c] * TM5_SPEED) for rows in TM5.values() for row in rows for c in columns]
    return float(min(times)), float(max(times))


def text(x: float, y: float, words: str, colour: str = INK, size: int = 12, anchor: str = "start") -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" font-size="{size}" fill="{colour}" text-anchor="{anchor}">{words}</text>'


class Axes(NamedTuple):
    """A plot at ``x0`` [px], from zero to ``right`` and ``top``."""

    x0: float
    right: float
    top: float

    def at(self, x: float, y: float) -> tuple[float, float]:
        return self.x0 + PAD + x / self.right * (WIDTH - PAD - 14), HEIGHT - 44 - y / self.top * (HEIGHT - 104)

    def frame(self, title: str, below: str, beside: str, xs: list[float], ys: list[float]) -> str:
        parts = [text(self.x0 + 14, 20, title, size=14), text(*self.at(0, self.top * 1.045), beside, GREY, 11)]
        for y in ys:
            (a, b), (c, _) = self.at(0, y), self.at(self.right, y)
            parts.append(f'<line x1="{a:.1f}" x2="{c:.1f}" y1="{b:.1f}" y2="{b:.1f}" stroke="#e3e7ea"/>')
            parts.append(text(a - 6, b + 4, f"{y:g}", GREY, 11, "end"))
        for x in xs:
            a, b = self.at(x, 0)
            parts.append(text(a, b + 16, f"{x:g}", GREY, 11, "middle"))
        parts.append(text(*self.at(self.right, -0.115 * self.top), below, GREY, 11, "end"))
        return "".join(parts)

    def dot(self, x: float, y: float, colour: str, *, hollow: bool = False) -> str:
        a, b = self.at(x, y)
        fill = f'fill="white" stroke="{colour}" stroke-width="2"' if hollow else f'fill="{colour}" fill-opacity="0.8"'
        return f'<circle cx="{a:.1f}" cy="{b:.1f}" r="3.8" {fill}/>'

    def line(self, points: list[tuple[float, float]], colour: str, dash: str = "") -> str:
        drawn = " ".join(f"{a:.1f},{b:.1f}" for a, b in (self.at(*p) for p in points))
        return f'<polyline points="{drawn}" fill="none" stroke="{colour}" stroke-width="2" stroke-dasharray="{dash}"/>'


def power_off_panel(rows: dict[str, Compared]) -> str:
    a = Axes(0.0, 900.0, 100.0)
    parts = [
        a.frame(
            "STOP 0: UR5, full speed, extension and load",
            "stop time [ms]",
            "angle [deg]",
            [0, 200, 400, 600, 800],
            [0, 25, 50, 75, 100],
        )
    ]
    for name, row in rows.items():
        x, y, z = [(1e3 * p[1], float(np.rad2deg(p[0]))) for p in (row.published, row.nominal, row.bound)]
        parts += [a.line([x, z], "#cfd8dc", "3 3"), a.dot(*z, OURS), a.dot(*y, OURS, hollow=True), a.dot(*x, THEIRS)]
        parts.append(text(a.at(*x)[0] + 7, a.at(*x)[1] + 13, name))
    return "".join(parts)


def controlled_panel() -> str:
    a = Axes(WIDTH, 110.0, 40.0)
    parts = [
        a.frame("STOP 1: TM5-700, every load and extension", "speed [%]", "angle [deg]", [0, 33, 66, 100], [0, 10, 20, 30, 40])
    ]
    for columns, dash in (((0, 1, 2), ""), ((0, 1), "6 4")):
        bound = np.rad2deg(ramp_bound(*ramp_times(columns)))
        parts.append(a.line([(0.0, 0.0), *zip([100 * s for s in SPEEDS], bound, strict=True)], OURS, dash))
    for shift, rows in zip((-1.6, 0.0, 1.6), TM5.values(), strict=True):
        parts += [a.dot(100 * s + shift, row[k], THEIRS) for row in rows for k, s in enumerate(SPEEDS)]
    return "".join(parts)


def legend() -> str:
    y = HEIGHT + 14
    parts = [f'<circle cx="30" cy="{y - 4}" r="4.5" fill="{THEIRS}"/>', text(40, y, "published")]
    parts += [f'<circle cx="130" cy="{y - 4}" r="4.5" fill="white" stroke="{OURS}" stroke-width="2"/>']
    parts += [
        text(140, y, "simulated, brake torque such that the time agrees"),
        f'<circle cx="440" cy="{y - 4}" r="4.5" fill="{OURS}"/>',
    ]
    parts += [text(450, y, "bound; a line: of a ramp read from all rows, dashed: from the rows at 33 and 66 %")]
    return "".join(parts)


def main() -> None:
    rows = {name: compared(j, said) for j, (name, said) in enumerate(UR5.items())}
    for name, r in rows.items():
        deg = [np.rad2deg(x[0]) for x in (r.published, r.nominal, r.bound)]
        print(
            f"UR5 {name}, STOP 0: published {deg[0]:.1f} deg in {1e3 * r.published[1]:.0f} ms; simulated with {r.torque:.0f} N m "
            f"{deg[1]:.1f} deg in {1e3 * r.nominal[1]:.0f} ms; bound {deg[2]:.1f} deg in {1e3 * r.bound[1]:.0f} ms"
        )
    for columns, words in (((0, 1, 2), "all rows"), ((0, 1), "the rows at 33 and 66 %")):
        bound = np.rad2deg(ramp_bound(*ramp_times(columns)))
        top = np.array([row[2] for axis in TM5.values() for row in axis])
        print(
            f"TM5-700, STOP 1: a ramp of {ramp_times(columns)[0]:.3f} to {ramp_times(columns)[1]:.3f} s, from {words}: bound at full speed "
            f"{bound[2]:.1f} deg, {np.sum(top > bound[2])} of {len(top)} published angles beyond it"
        )
    svg = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {2 * WIDTH:.0f} {HEIGHT + 28:.0f}" font-family="sans-serif">'
        f'<rect width="100%" height="100%" fill="white"/>{power_off_panel(rows)}{controlled_panel()}{legend()}</svg>\n'
    )
    if len(sys.argv) > 1:
        write_text(Path(sys.argv[1]), svg)


if __name__ == "__main__":
    main()
