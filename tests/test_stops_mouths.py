"""One state, asked by four mouths: the command's JSON and page, the FMU, the monitor's message. They say the same, in the same words, of models with
and without effects, payloads known as ranges and stops of two categories; only the units of a message round, and upward."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fmu_unit import unit
from stopset.artifact import Model, load_model, save_model
from stopset.cli.main import main
from stopset.effects.base import Fitted
from stopset.fmu import Contents, export
from stopset.fmu.stops import bounds_of
from stopset.monitor.config import Stops
from stopset.monitor.layout import PREFIX, Flag, unpack
from stopset.monitor.packer import Packer
from stopset.monitor.status import Situation, flags_of, stop_fields
from stopset.monitor.stopworker import answer_for, prepare
from stopset.offline.stops.shown import up
from stopset.offline.stops.table import Question, prepared
from stopset.reach.stops import Category, Ramp, StopBound, StopBounds
from stopset.sets import Box
from stopset.types import Array
from test_fmu import HERE
from test_fmu_stops import equals

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from stop_arms import prbt_like

ASKED: tuple[tuple[Category, str], ...] = (("0", "stop"), ("1 guaranteed", "stop1_guaranteed"), ("1", "stop1_nominal"))
SAME = 1e-9  # of a bound, by which a box of one reading is wider
ALIKE = 0.03  # of a bound, for second slopes of all payloads in place of those of some
PAYLOADS = ((0.0, 2.0), (1.0, 1.0), (1.96, 2.0))


def arm(*effects: Fitted) -> Model:
    """The arm with a ramp of its recordings, its range of angles as wide as the joints'."""
    model = prbt_like((0.0, 2.0))
    n, limit = model.n, model.robot.q_limit
    ramp = replace(
        Ramp.stated(n, time=0.3), value=Box.of(np.full(n, 0.28), np.full(n, 0.3)), control=Box.of(np.full(n, 0.01), np.full(n, 0.02)),
        q_error=np.full(n, 2e-3), dq_error=np.full(n, 0.03), settle=0.1, off_after=0.6,
    )  # fmt: skip
    return replace(
        model, effects=(*model.effects, *effects), domain=replace(model.domain, q=Box.of(limit[:, 0], limit[:, 1])),
        provenance={**model.provenance, "stop1_ramp": ramp.as_dict()},
    )  # fmt: skip


SPRUNG = (
    Fitted("spring", "arm_4_joint", {"k": 6.0, "c": 3.0}, {"k": 0.1, "c": 0.1}),
    Fitted("base_tilt", None, {"roll": 0.05, "pitch": -0.03}, {"roll": 1e-3, "pitch": 1e-3}),
)
MODELS: dict[str, Callable[[], Model]] = {"plain": arm, "with effects": lambda: arm(*SPRUNG)}


def drawn(model: Model, rng: np.random.Generator) -> tuple[Array, Array]:
    """A state; in half of them one joint goes towards the end of its range, not far from it."""
    n, limit = model.n, model.robot.q_limit
    q, dq = rng.uniform(-2.0, 2.0, n), rng.uniform(-1.2, 1.2, n) * rng.choice([1.0, 0.3, 0.0], n)
    if rng.random() < 0.5:
        j, side = int(rng.integers(n)), int(rng.integers(2))
        q[j] = limit[j, side] - (2 * side - 1) * rng.uniform(0.005, 0.15)
        dq[j] = (2 * side - 1) * rng.uniform(0.5, 1.2)
    return q, dq


def cells_of_page(html: str) -> list[list[str]]:
    """The rows of its tables."""
    rows = re.findall(r"<tr[^>]*>(.*?)</tr>", html, re.DOTALL)
    return [[re.sub("<[^>]+>", "", x).strip() for x in re.findall(r"<td[^>]*>(.*?)</td>", row, re.DOTALL)] for row in rows]


def message_says(want: StopBound, numbers, category: Category) -> bool:  # type: ignore[no-untyped-def]
    """Whether a packed message holds the bound, each number up by no more than its unit, and the flag of a struck end."""
    said = Situation(True, "", False, False, "", 0.0, 0.0, None, None, True, {category: numbers})
    name = PREFIX[category]
    got = unpack(Packer(None).pack(stop_fields(name, numbers) | {"flags": flags_of(said)}))
    if not want.certified:
        return bool(np.all(np.isinf(np.array(got[f"{name}_time"])))) and not got["flags"] & Flag.END_STOP
    assert want.time is not None and want.forward is not None and want.back is not None and want.tcp is not None
    pairs = (("time", want.time), ("angle_forward", want.forward), ("angle_back", want.back), ("tcp", [want.tcp]))
    for field, exact in pairs:
        found = np.atleast_1d(got[f"{name}_{field}"])[: len(exact)]
        one = np.nextafter(np.asarray(exact, np.float32), np.float32(np.inf)).astype(float)
        if not (np.all(found >= exact) and np.all(found <= np.maximum(one, exact))):
            return False
    return bool(got["flags"] & Flag.END_STOP) == bool(want.end_stops)


def alike(a: StopBound, b: StopBound, share: float) -> bool:
    """Whether two bounds differ by no more than a share."""
    if a.time is None or b.time is None or a.angle is None or b.angle is None:
        return a.time is b.time
    return bool(np.allclose(a.time, b.time, rtol=share) and np.allclose(a.angle, b.angle, rtol=share, atol=1e-6))


def as_the_fmu(law: StopBounds, whole: StopBounds) -> StopBounds:
    """The law of a range of payloads, with what second slopes of inertia and gravity, and loads of gears, come to over all that the model knows:
    of a range that is set in a run the unit has no others. The same where it is all."""
    s, every = law.setting, whole.setting
    assert s is not None and every is not None
    plant = s.plant._replace(curvature=every.plant.curvature)
    setting = replace(s, plant=plant, torques=every.torques.carrying(plant.pi, plant.pi_half))
    return replace(law, setting=setting, parts=setting.parts if law.parts else ())


@pytest.mark.parametrize("name", list(MODELS))
def test_monitor_and_fmu_say_what_the_bound_says(name: str, tmp_path: Path) -> None:
    """Of states as they are: the FMU the same bits, the message rounded up; end stops are told by all or by none."""
    pytest.importorskip("ziglang")
    pytest.importorskip("fmpy")
    path = tmp_path / "m.model.json"
    save_model(MODELS[name](), path)
    model, rng = load_model(path), np.random.default_rng(len(name))
    fmu, struck = export(model, tmp_path / "m.fmu", Contents(3, (str(HERE),), reference=False)), []
    for payload in PAYLOADS:
        law = StopBounds.of(model, payload, fast=True)
        units = as_the_fmu(law, bounds_of(model))
        desk, why = prepare(str(path), payload, Stops(("0", "1")))
        assert desk is not None, why
        with unit(fmu) as u:
            u.set({"payload_lo": payload[0], "payload_hi": payload[1], "payload_mass": payload[1]})
            u.begin()
            for _ in range(6):
                q, dq = drawn(model, rng)
                u.state(model, q, dq)
                for category, stem in ASKED:
                    want, x = units.bound(q, dq, category), np.concatenate([q, dq])
                    said = answer_for(desk, category, x, x).numbers
                    near = law.bound(q, dq, category, *np.full((2, model.n), np.nextafter(0.0, 1.0)))  # the box of one reading
                    assert equals(u, model, want, stem) and message_says(near, said, category)
                    assert alike(want, near, SAME if payload == model.domain.payload else ALIKE)
                    assert u.get(f"{stem}_end_stop") == bool(want.end_stops) and said.end_stops == near.end_stops
                    struck.append(bool(want.end_stops))
    assert 5 < sum(struck) < len(struck) - 5


@pytest.mark.parametrize("name", list(MODELS))
def test_the_command_s_json_and_page_say_what_the_bound_says(name: str, tmp_path: Path) -> None:
    """Its numbers up to the sixth digit, the page's to the fourth; the joints that can strike an end by name."""
    path = tmp_path / "m.model.json"
    save_model(MODELS[name](), path)
    model, rng, struck = load_model(path), np.random.default_rng(3), 0
    for kg in (0.0, 1.0, 2.0):
        law = prepared(model, kg, Question())
        q, dq = drawn(model, rng)
        out, page = tmp_path / "a.json", tmp_path / "a.html"
        asked = [f"--at={','.join(map(repr, q.tolist()))}", f"--speed={','.join(map(repr, dq.tolist()))}"]
        assert main(["stops", str(path), *asked, f"--payload={kg}", f"--json={out}", f"--report={page}"]) in (0, 1)
        rows, html = json.loads(out.read_text()), cells_of_page(page.read_text())
        for category in ("0", "1", "1 guaranteed", "2"):
            want = law.bound(q, dq, category)  # type: ignore[arg-type]
            mine = [r for r in rows if r["category"] == category]
            assert len(mine) == model.n and all(r["certified"] == want.certified for r in mine)
            assert all(r["why"] == want.why and r["end_stops"] == list(want.end_stops) for r in mine)
            struck += bool(want.end_stops)
            if want.time is None or want.angle is None or want.tcp is None:
                continue
            for i, r in enumerate(mine):
                for key, exact in (("time_s", want.time[i]), ("angle_rad", want.angle[i]), ("tcp_m", want.tcp)):
                    assert exact <= r[key] <= exact + 1.0001e-6
                cells = [up(r[k], 4) for k in ("time_s", "angle_rad", "tcp_m")]
                assert any(set(cells) <= set(row) for row in html), cells
    assert struck
