"""An error inside is no answer: its own exit code and one sentence; solvers and bad descriptions are spoken of in our words."""

from __future__ import annotations

import importlib
import json
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from monitor_arm import known_model
from nominal_cases import JOINTS, Truth, campaign
from nominal_cases import arm as three_joints
from stopset.artifact import save_model
from stopset.cli.main import DEBUG, DEFECT, FILES, commands, main
from stopset.errors import NotConformant
from stopset.offline.campaign.reading_error import ReadingError
from stopset.offline.conform import monotone_sets, program
from stopset.offline.description import robot_from_text
from stopset.offline.diagnose import diagnose
from stopset.offline.diagnose.evidence.baseline import drive_gain
from stopset.offline.diagnose.thresholds import DRIVES
from stopset.offline.nominal import physical, qp
from stopset.recording import write_recordings
from stopset.sets import Box

SOLVERS = re.compile(r"highs|osqp|clarabel|cvxpy|toppra|simplex|status|infeasible|solver|traceback", re.IGNORECASE)


def own_words(text: str) -> None:
    """One sentence in three parts, none of it a solver's."""
    assert not SOLVERS.search(text), text
    assert "expected" in text and len(text) > 40


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
@pytest.mark.parametrize("words", ["--help", "--version", "history --help", "history MODEL", "stops MODEL"])
def test_an_answer_that_finds_no_room_is_no_defect(words: str, tmp_path: Path) -> None:
    """Standard output on a full disk: 70 before, or a traceback, or for help 0 and nothing said."""
    save_model(known_model(), tmp_path / "arm.model.json")
    command = [sys.executable, "-m", "stopset.cli.main", *words.replace("MODEL", str(tmp_path / "arm.model.json")).split()]
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            command,
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "COLUMNS": "400"},
        )
    assert done.returncode == 2, done.stderr
    assert done.stderr.count("stopset: ") == 1 and "No space left on device" in done.stderr and "expected room" in done.stderr


@pytest.mark.parametrize("command", commands())
def test_an_error_inside_any_command_has_its_own_code(
    command: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    module = importlib.import_module(f"stopset.cli.{FILES.get(command, command.replace('-', '_'))}")

    def fails(args: object) -> int:
        return 1 // int(args is None)

    monkeypatch.setattr(module, "add_arguments", lambda parser: None)
    monkeypatch.setattr(module, "run", fails)
    monkeypatch.delenv(DEBUG, raising=False)
    assert main([command]) == DEFECT not in (0, 1, 2)
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and "Traceback" not in err
    assert err.startswith(f"stopset: {command} failed inside (ZeroDivisionError") and "defect" in err and f"{DEBUG}=1" in err
    monkeypatch.setenv(DEBUG, "1")
    assert main([command]) == DEFECT
    assert "Traceback" in capsys.readouterr().err


def test_the_process_ends_with_that_code(tmp_path: Path) -> None:
    """As a shell sees it, in the middle of a real command: its parser breaks."""
    code = "import stopset.recording, sys\nstopset.recording.read_meta = None\nfrom stopset.cli.main import main\nsys.exit(main(sys.argv[1:]))"
    (tmp_path / "a.csv").write_text("suite,trial,t,q_a,dq_a,tau_a,phase\n0,0,0,0,0,0,open_loop\n")
    env = {k: v for k, v in os.environ.items() if k != DEBUG} | {"PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(
        [sys.executable, "-c", code, "inspect", str(tmp_path / "a.csv")], capture_output=True, text=True, env=env, check=False
    )
    assert done.returncode == 70 and "Traceback" not in done.stderr
    assert "TypeError" in done.stderr and "stopset.offline.inspect.inspection line" in done.stderr


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (PermissionError(13, "Permission denied", "a.parquet"), "a.parquet: Permission denied; expected"),
        (MemoryError(), "out of memory"),
        (ModuleNotFoundError("no", name="plotly"), "needs the package plotly"),
    ],
)
def test_what_the_caller_can_mend_is_no_defect(
    error: Exception, said: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    module = importlib.import_module("stopset.cli.history")

    def fails(args: object) -> int:
        raise error

    monkeypatch.setattr(module, "add_arguments", lambda parser: None)
    monkeypatch.setattr(module, "run", fails)
    assert main(["history"]) == 2
    assert said in capsys.readouterr().err


@pytest.mark.parametrize("status", [1, 2, 3, 4])
def test_a_linear_program_without_answer_is_told_in_our_words(status: int, monkeypatch: pytest.MonkeyPatch) -> None:
    answer = SimpleNamespace(
        status=status, message="(HiGHS Status 15: model_status is Unknown; primal_status is Infeasible)", x=None
    )
    monkeypatch.setattr("scipy.optimize.linprog", lambda *a, **k: answer)
    G, h = np.ones((3, 10)), np.zeros(3)
    with pytest.raises(NotConformant, match="joint a") as e:
        program.cheapest(G, h, np.ones(10), program.Bounds(ReadingError.exact(Box.symmetric(np.ones(2))), 1), "joint a")
    own_words(str(e.value))
    with pytest.raises(NotConformant, match="joint a") as e:
        program.solved(
            np.ones(2), np.eye(2), np.ones(2), [(None, None)] * 2, "joint a", "expected a friction curve that holds: again"
        )
    own_words(str(e.value))


def test_numbers_a_solver_would_refuse_are_told_before() -> None:
    with pytest.raises(NotConformant) as e:
        program.solved(np.ones(2), np.array([[np.inf, 1.0]]), np.ones(1), [(None, None)] * 2, "joint a", "")
    own_words(str(e.value))
    assert monotone_sets.solved is program.solved


def test_link_parameters_that_no_body_has(monkeypatch: pytest.MonkeyPatch) -> None:
    """Limits that contradict each other, a solver that gives up: one kind of sentence."""
    robot = three_joints()
    H, b = np.eye(30), np.zeros(30)
    row = np.zeros((1, 30))
    row[0, 0] = 1.0
    with pytest.raises(NotConformant, match="every limit at once") as e:
        physical.solve_consistent(H, b, row, np.array([-2.0]), np.array([-1.0]), robot.pi)
    own_words(str(e.value))

    class GivesUp:
        def __init__(self, *problem: object) -> None: ...

        def solve(self) -> SimpleNamespace:
            return SimpleNamespace(status="InsufficientProgress", x=[float("nan")] * 30, r_prim=float("nan"), r_dual=float("nan"))

    monkeypatch.setattr(physical.clarabel, "DefaultSolver", GivesUp)
    with pytest.raises(NotConformant, match="did not come to an end") as e:
        physical.solve_consistent(H, b, row, np.array([-np.inf]), np.array([np.inf]), robot.pi)
    own_words(str(e.value))


def test_limits_that_contradict_each_other(capfd: pytest.CaptureFixture[str]) -> None:
    """Nothing of it on the terminal either: the solver prints from C."""
    with pytest.raises(NotConformant) as e:
        qp.solve_qp(np.eye(2), np.ones(2), np.array([[1.0, 0.0]]), np.array([3.0]), np.array([2.0]))
    own_words(str(e.value))
    out, err = capfd.readouterr()
    assert not out and not err


def without_inertia(urdf: str) -> str:
    """The last link a point mass in its own joint: no tensor, no centre."""
    at = urdf.rindex('<link name="l3">')
    end = urdf.index("</link>", at)
    tensor = " ".join(f'{k}="0"' for k in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz"))
    return urdf[:at] + f'<link name="l3"><inertial><mass value="2.5"/><inertia {tensor}/></inertial>' + urdf[end:]


def test_a_last_link_without_inertia_is_diagnosed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    truth = Truth(three_joints())
    recorded = campaign(truth, seconds=6.0, static=12)
    bare = robot_from_text(without_inertia(truth.robot.urdf), truth.robot.datasheet)
    assert not bare.pi[-1, 1:].any()
    assert diagnose(bare, recorded).verdict in ("missing", "none", "unknown")

    write_recordings(tmp_path / "rec.parquet", recorded.meta, recorded)
    (tmp_path / "robot.urdf").write_text(bare.urdf)
    (tmp_path / "robot.json").write_text(json.dumps(dict(bare.datasheet)))
    robot, data, model = str(tmp_path / "robot.urdf"), str(tmp_path / "rec.parquet"), str(tmp_path / "m.json")
    # how wide the sets of a description that wrong come out is not asked here
    assert main(["identify", "--robot", robot, "--data", data, "--out", model, "--accept-wide"]) == 0
    assert main(["diagnose", model, "--data", data, "--effects", "elasticity"]) == 0
    (tmp_path / "robot.urdf").write_text(re.sub(r'<link name="l3">.*?</link>', '<link name="l3"/>', truth.robot.urdf))
    capsys.readouterr()
    assert main(["identify", "--robot", robot, "--data", data, "--out", model]) == 2
    assert f"no mass behind joint {JOINTS[-1]}; expected" in capsys.readouterr().err


def test_a_scale_of_torque_beyond_reason_is_said() -> None:
    """Neither silently 1 nor believed: the description and the identified arm contradict each other."""
    described = three_joints()
    reach = Box.symmetric(np.full(described.n, 2.0))
    for factor in (0.6, 1.0, 1.9):  # all joints agree, so most of it is the drives', the rest the description's
        gain, std, notes = drive_gain(described, described.with_parameters(factor * described.pi), reach)
        assert gain == pytest.approx(1.0 + 0.72 * (factor - 1.0), abs=0.01) and 0.02 < std < 0.04 and not notes
    for factor in (0.3, 2.5, -1.0):
        gain, std, notes = drive_gain(described, described.with_parameters(factor * described.pi), reach)
        assert (gain, std) == (1.0, DRIVES) and len(notes) == 1
        assert f"{factor:.2g} times" in notes[0] and "expected 0.5 to 2" in notes[0] and "URDF" in notes[0]
    flat = replace(described, chain=described.chain._replace(gravity=np.zeros(3)))
    assert drive_gain(flat, flat, reach) == (1.0, DRIVES, ())


def test_joints_that_disagree_speak_against_the_description_not_the_drives() -> None:
    described = three_joints()
    reach = Box.symmetric(np.full(described.n, 2.0))
    pi = 1.15 * described.pi
    _, alike, _ = drive_gain(described, described.with_parameters(pi), reach)
    pi[-1] *= 1.5
    gain, differs, _ = drive_gain(described, described.with_parameters(pi), reach)
    assert 1.0 < gain < 1.3 and 1.2 * alike < differs <= DRIVES
