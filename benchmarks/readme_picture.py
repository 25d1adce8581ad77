"""Draw the README's picture from the files `stopset demo` leaves: one joint's tube and measurements, before and after.

Run: stopset demo && python benchmarks/readme_picture.py stopset-demo docs/tube.svg
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from stopset.artifact import Model, load_model
from stopset.files import write_text
from stopset.reach.flowpipe import deviation_tube
from stopset.reach.predict import predict
from stopset.recording import Recording, read_recordings
from stopset.types import Array

WIDTH, HEIGHT, PAD = 420.0, 260.0, 46.0
HORIZON = 1.5  # [s] drawn


def curves(model: Model, trials: list[Recording], joint: int) -> tuple[Array, Array, Array, list[Array]]:
    """Ages, lower and upper edge of the set around the mean start's prediction, and each trial minus that prediction."""
    tube = deviation_tube(model.abstraction, model.powered)
    steps = min(len(tube.ages), *(len(r.t) for r in trials), round(HORIZON / model.powered.dt))
    lines = []
    for r in trials:
        u = model.input(r.q, r.dq, r.tau, r.temp, 0.0, r.t)[:steps]
        x = predict(model.abstraction, model.powered.dt, np.concatenate([r.q[0], r.dq[0]]), u)
        lines.append(r.q[:steps, joint] - x[:, joint])
    return tube.ages[:steps], tube.lo[:steps, joint], tube.hi[:steps, joint], lines


def panel(x0: float, title: str, t: Array, lo: Array, hi: Array, lines: list[Array], top: float) -> str:
    """One plot as SVG."""

    def px(time: Array) -> Array:
        return x0 + PAD + time / t[-1] * (WIDTH - PAD - 10)

    def py(value: Array) -> Array:
        return HEIGHT / 2 + 12 - value / top * (HEIGHT / 2 - 34)

    keep = np.unique(np.linspace(0, len(t) - 1, 80).astype(int))
    edge = [*zip(px(t[keep]), py(hi[keep]), strict=True), *zip(px(t[keep])[::-1], py(lo[keep])[::-1], strict=True)]
    parts = [f'<polygon points="{" ".join(f"{a:.1f},{b:.1f}" for a, b in edge)}" fill="#c9d3dc"/>']
    for line in lines:
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(px(t[keep]), py(line[keep]), strict=True))
        parts.append(f'<polyline points="{points}" fill="none" stroke="#b3261e" stroke-width="1"/>')
    parts.append(f'<text x="{x0 + PAD}" y="18" font-size="14">{title}</text>')
    for value in (-top, 0.0, top):
        y = float(py(np.array([value]))[0])
        parts.append(f'<text x="{x0 + PAD - 6}" y="{y + 4:.1f}" font-size="11" text-anchor="end">{value:+.2f}</text>')
        parts.append(f'<line x1="{x0 + PAD}" x2="{x0 + WIDTH - 10}" y1="{y:.1f}" y2="{y:.1f}" stroke="#eee"/>')
    parts.append(f'<text x="{x0 + WIDTH - 10}" y="{HEIGHT - 4}" font-size="11" text-anchor="end">{t[-1]:.1f} s ahead</text>')
    return "".join(parts)


def main() -> None:
    folder, target = Path(sys.argv[1]), Path(sys.argv[2])
    before, after = load_model(folder / "first.model.json"), load_model(folder / "second.model.json")
    added = after.revisions[-1].added
    joint = after.joints.index(added.partition(":")[2])
    trials = [r for r in read_recordings(folder / "changed" / "recording.parquet", after.robot) if r.phase == "open_loop"]
    long = [r for r in trials if len(r.t) * after.powered.dt >= HORIZON][:40]
    drawn = [curves(m, long, joint) for m in (before, after)]
    top = 1.05 * max(float(np.abs(np.concatenate([lo, hi])).max()) for _, lo, hi, _ in drawn)
    titles = ("first model: predicted set and measurements", f"after adding {added.partition(':')[0]}")
    body = "".join(panel(k * WIDTH, title, *data, top) for k, (title, data) in enumerate(zip(titles, drawn, strict=True)))
    label = f"{after.joints[joint]}: position minus prediction [rad]"
    svg = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {2 * WIDTH:.0f} {HEIGHT + 18:.0f}" font-family="sans-serif">'
        f'<rect width="100%" height="100%" fill="white"/>{body}'
        f'<text x="{PAD}" y="{HEIGHT + 12}" font-size="12">{label}; simulated arm, {len(long)} trials</text></svg>\n'
    )
    write_text(target, svg)
    print(f"{target}: {label}")


if __name__ == "__main__":
    main()
