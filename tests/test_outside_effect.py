"""An effect that an installed package registers: through every command, as real as it gets, and everywhere the same numbers."""

from __future__ import annotations

import json
import os
import re
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmu_unit import unit
from monitor_process import Ear, environment, free_port, running, stopset, write_config
from stopset.artifact import Model, load_model
from stopset.cli.main import main
from stopset.effects import catalogue, registry
from stopset.effects.base import Fitted
from stopset.fmu.build import native
from stopset.fmu.stops import bounds_of
from stopset.monitor.sample import Quantum, Sample
from stopset.monitor.verdict import Conformance
from stopset.monitor.watch import Watch
from stopset.reach.stops import StopBounds
from stopset.recording import Recording, read_recordings, write_recordings
from stopset.types import Array
from test_fmu_stops import equals
from test_hidden_effects import ARM

pytest.importorskip("fmpy")
pytest.importorskip("ziglang")
pytestmark = [pytest.mark.slow, pytest.mark.skipif(native() is None, reason="no FMU binaries for this platform")]

NAME, JOINT, TRUE = "folding_bellows", "lift", 9.0
# drag that grows with the square of the angle: of no form that the catalogue has
PACKAGE = """
from stopset.effects import Effect, Term

EFFECT = Effect(
    name="folding_bellows",
    says="Bellows around the joint resist the more the further they are folded.",
    look_at="q^2 dq",
    terms=(Term("k", "N m s/rad^3", "drag per squared angle", 0.0, 1e3),),
    law=lambda s, shape: (s.q * s.q * s.dq,),
    needs=("q", "dq"),
    enters="compensation",
    source="own",
    looks_like=("viscous",),
    distinguished_by="Take the bellows off.",
)
"""


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The folder that it is installed in; processes find it by their path."""
    folder = tmp_path_factory.mktemp("site-packages")
    (folder / "my_bellows.py").write_text(PACKAGE)
    info = folder / "my_bellows-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: my_bellows\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[stopset.effects]\n{NAME} = my_bellows:EFFECT\n")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder))
        registry.catalogue.cache_clear()
        yield folder
    sys.modules.pop("my_bellows", None)
    registry.catalogue.cache_clear()


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory, package: Path) -> Path:
    """A simulated arm whose shoulder wears such bellows, its recordings, and a model that knows nothing of them.

    The torque that the drives give for the same motion is known; how the arm would stop is not, so no stop is recorded.
    """
    folder = tmp_path_factory.mktemp("cell")
    (folder / "three.urdf").write_text(ARM)
    words = ["--robot", str(folder / "three.urdf"), "--hide", "none", "--plan", "short", "--seed", "3", "--out", str(folder)]
    assert main(["simulate", *words]) == 0
    found = read_recordings(folder / "recording.parquet")
    at = found.meta.joints.index(JOINT)

    def worn(r: Recording) -> Recording:
        tau = r.tau.copy()
        tau[:, at] += TRUE * r.q[:, at] ** 2 * r.dq[:, at]  # what the drive must give for the same motion
        return replace(r, tau=tau)

    write_recordings(folder / "worn.parquet", found.meta, [worn(r) for r in found.trials if not r.phase.startswith("stop")])
    assert main(["identify", *robot(folder), *data(folder), "--out", str(folder / "plain.model.json"), "--accept-wide"]) == 0
    return folder


def robot(folder: Path) -> list[str]:
    return ["--robot", str(folder / "robot.urdf")]


def data(folder: Path) -> list[str]:
    return ["--data", str(folder / "worn.parquet")]


def fitted(model: Model) -> Fitted:
    (found,) = [f for f in model.effects if f.effect == NAME]
    assert found.joint == JOINT
    return found


@pytest.fixture(scope="module")
def revised(cell: Path) -> Model:
    """The model with the effect added, from its file."""
    out = cell / "revised.model.json"
    assert main(["add", str(cell / "plain.model.json"), NAME, "--joint", JOINT, *data(cell), "--out", str(out)]) == 0
    return load_model(out)


def test_diagnose_names_it_with_the_numbers_that_add_and_identify_give_it(cell: Path, revised: Model) -> None:
    assert NAME in catalogue()
    assert main(["diagnose", str(cell / "plain.model.json"), *data(cell), "--json", str(cell / "diagnosis.json")]) == 0
    said = json.loads((cell / "diagnosis.json").read_text())
    first = said["ranked_effects"][0]
    assert said["verdict"] == "missing" and (first["effect"], first["joint"]) == (NAME, JOINT)
    asked = cell / "asked.model.json"
    words = ["identify", *robot(cell), *data(cell), "--effects", f"{NAME}:{JOINT}", "--out", str(asked), "--accept-wide"]
    assert main(words) == 0
    named = first["parameters"]["k"]["value"]
    assert named == pytest.approx(TRUE, rel=0.1)
    for model in (revised, load_model(asked)):
        assert fitted(model).values["k"] == pytest.approx(named, rel=1e-6)


def test_its_stops_are_bounded_by_its_own_law(cell: Path, revised: Model) -> None:
    """The command says what Python says; without the package no stop is bounded, and the effect is named."""
    q, dq = moving(revised)
    words = [
        "stops",
        str(cell / "revised.model.json"),
        "--at",
        listed(q),
        "--speed",
        listed(dq),
        "--category",
        "0",
        "--payload",
        "0",
    ]
    assert main([*words, "--json", str(cell / "stops.json")]) == 0
    times = np.array([r["time_s"] for r in json.loads((cell / "stops.json").read_text())])
    want = StopBounds.of(revised).bound(q, dq)
    assert want.certified and want.angle is not None and want.time is not None
    assert np.all((times >= want.time) & (times <= want.time + 1e-6))
    blind = StopBounds.of(replace(revised, effects=tuple(f for f in revised.effects if f.effect != NAME))).bound(q, dq)
    assert blind.angle is not None and not np.array_equal(blind.angle, want.angle)
    process = stopset(*words)  # without the package on its path
    _, err = process.communicate(timeout=120)
    assert process.returncode != 0 and NAME in err


def listed(x: Array) -> str:
    return ",".join(map(repr, x.tolist()))


def moving(model: Model) -> tuple[Array, Array]:
    """A state well inside what the model saw, its worn joint bent."""
    d = model.domain
    q = d.q.centre + 0.3 * d.q.radius
    dq = 0.4 * np.minimum(np.abs(d.dq.lo), np.abs(d.dq.hi))
    return q, dq


def test_monitor_and_unit_say_of_every_sample_what_the_model_says(cell: Path, revised: Model, package: Path) -> None:
    """The daemon over zenoh, the unit through an importer, and the same verdicts; the stops of the unit to the last bit."""
    out = cell / "arm.fmu"
    assert main(["export-fmu", str(cell / "revised.model.json"), "--out", str(out), "--platform", str(native())]) == 0
    assert main(["check-fmu", str(out)]) == 0
    trial = [r for r in read_recordings(cell / "worn.parquet").trials if r.phase == "open_loop"][-1]
    watch, verdicts = Watch(revised, Quantum.none(revised.n), None, (0.0, 1.0)), []
    codes = {Conformance.UNKNOWN: 0, Conformance.CONFORMANT: 1, Conformance.VIOLATION: 2}
    bounds, certified = bounds_of(revised), 0
    with unit(out) as u:
        u.set(
            {f"{x}_start_{j}": v for x in ("q", "dq") for j, v in zip(revised.joints, getattr(trial, x)[0].tolist(), strict=True)}
        )
        for k, t in enumerate(trial.t):
            temp = None if trial.temp is None else trial.temp[k]
            u.state(revised, trial.q[k], trial.dq[k])
            given = {"tau": trial.tau[k]} | ({} if temp is None else {"temp": temp})
            u.set({f"{x}_{j}": v for x, row in given.items() for j, v in zip(revised.joints, row.tolist(), strict=True)})
            if k == 0:
                u.begin()
            if k % 50 == 0:
                want = bounds.bound(trial.q[k], trial.dq[k])
                certified += want.certified
                assert equals(u, revised, want), (k, want)
            u.step(float(revised.powered.dt))
            said = watch.step(Sample(k, float(t), trial.q[k], trial.dq[k], trial.tau[k], temp))
            verdicts.append(said.conformance)
            assert u.get("verdict") == codes[said.conformance] or k == 0, (k, said)
    assert certified > 3 and Conformance.VIOLATION not in verdicts
    write_recordings(cell / "one.parquet", read_recordings(cell / "worn.parquet").meta, [trial])
    counts = watched(cell, "revised", package)
    if sum(counts.values()) == len(verdicts):  # a machine that stood still has dropped samples, and counted them
        assert counts["CONFORMANT"] == verdicts.count(Conformance.CONFORMANT)
    assert counts["VIOLATION"] == 0 < counts["CONFORMANT"]


def watched(cell: Path, name: str, package: Path) -> dict[str, int]:
    """What the monitor of a model counted of the recording played to it."""
    port, path = free_port(), os.pathsep.join([environment()["PYTHONPATH"], str(package)])
    source = f'[joint_states]\nkey = "js"\ncycle_s = {load_model(cell / f"{name}.model.json").powered.dt!r}'
    config = write_config(cell, cell / f"{name}.model.json", source, port)
    with running("monitor", "--config", str(config), PYTHONPATH=path), Ear(port) as ear:
        replay = stopset("replay", str(cell / "one.parquet"), "--to", f"zenoh:tcp/127.0.0.1:{port}", "--key", "js")
        out, err = replay.communicate(timeout=600)
        assert replay.returncode == 0, err
        sent = int(re.match(r"(\d+) samples", out).group(1))  # type: ignore[union-attr]
        ear.wait(lambda: ear.twins and ear.twins[-1]["samples"] == sent, 20.0)
        twins: list[dict[str, Any]] = ear.twins
        assert twins, ear.events
        return dict(twins[-1]["verdicts"])
