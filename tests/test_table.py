"""Tables as other tools write them: columns found by their names, stated, or refused in a sentence."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from stopset.cli.main import main
from stopset.errors import RecordingError
from stopset.recording import read_meta, read_recordings
from stopset.recording.column_names import by_name
from stopset.recording.table import Stated, read_table
from synthetic import urdf

N, RATE = 300, 250.0
T = 3.0 + np.arange(N) / RATE
Q = np.sin(np.outer(T, [0.7, 1.1, 1.3]))
DQ = np.cos(np.outer(T, [0.7, 1.1, 1.3])) * [0.7, 1.1, 1.3]
TAU = 5.0 * Q + DQ
ALL = np.column_stack([T, Q, DQ, TAU])


def text(path: Path, names: list[str], mark: str = ",", table: np.ndarray = ALL, before: str = "") -> Path:
    rows = [mark.join(f"{x:.12g}" for x in row) for row in table]
    path.write_text(before + "\n".join([*([mark.join(names)] if names else []), *rows]) + "\n")
    return path


def numbered(q: str, dq: str, tau: str, first: int = 1, t: str = "t") -> list[str]:
    return [t, *(f"{stem.replace('#', str(k))}" for stem in (q, dq, tau) for k in range(first, first + 3))]


WRITTEN = {
    "plain": numbered("q#", "dq#", "tau#"),
    "from nought": numbered("pos_#", "vel_#", "effort_#", 0, "timestamp"),
    "brackets": numbered("position[#]", "velocity[#]", "torque[#]", 0, "time"),
    "numbers within": numbered("joint_#_pos", "joint_#_vel", "joint_#_torque", 1, "Time [s]"),
    "a message": numbered("field.position#", "field.velocity#", "field.effort#", 0, "field.header.stamp"),
    "axes": numbered("q_A#", "qdot_A#", "tauMeasured_A#"),
    "libfranka": numbered("q_#", "dq_#", "tau_J_#", 0),
    "humps": numbered("dataQ_#", "dataDotQ_NF_#", "dataTau_#", 1, "dataTimeStamp"),
    "by name": ["t", *(f"/joint_states/{j}/{k}" for k in ("position", "velocity", "effort") for j in ("hip", "knee", "toe"))],
}


@pytest.mark.parametrize("names", WRITTEN.values(), ids=WRITTEN)
@pytest.mark.parametrize("mark", [",", ";", "\t", " "])
def test_columns_are_found_by_their_names(names: list[str], mark: str, tmp_path: Path) -> None:
    if mark == " ":
        names = [n.replace(" ", "_") for n in names]
    out = tmp_path / "rec.parquet"
    assert main(["import", str(text(tmp_path / "a.csv", names, mark)), "--out", str(out), "--quiet"]) == 0
    (r,) = read_recordings(out)
    assert (
        r.t == pytest.approx(T - T[0], abs=1e-9)
        and r.q == pytest.approx(Q)
        and r.dq == pytest.approx(DQ)
        and r.tau == pytest.approx(TAU)
    )
    assert read_meta(out).joints == (("hip", "knee", "toe") if "/" in names[1] else ("joint_1", "joint_2", "joint_3"))


def test_of_columns_of_one_name_the_first_counts(tmp_path: Path) -> None:
    out, names = tmp_path / "rec.parquet", [*WRITTEN["plain"], *numbered("q#", "dq#", "tau#")[1:]]
    path = text(tmp_path / "a.csv", names, table=np.column_stack([ALL, 9 * ALL[:, 1:]]))
    assert main(["import", str(path), "--out", str(out)]) == 0
    assert read_recordings(out).trials[0].tau == pytest.approx(TAU)


def test_what_was_asked_of_the_arm_is_not_what_it_did(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    names = [*numbered("q_d_#", "dq_d_#", "tau_ext_#", 0), *numbered("q_#", "dq_#", "tau_J_#", 0)[1:], "mode"]
    table = np.column_stack([T, 9 * Q, 9 * DQ, 9 * TAU, Q, DQ, TAU, np.ones(N)])
    out = tmp_path / "rec.parquet"
    assert main(["import", str(text(tmp_path / "a.csv", names, table=table)), "--out", str(out)]) == 0
    (r,) = read_recordings(out)
    assert r.q == pytest.approx(Q) and r.tau == pytest.approx(TAU)
    said = capsys.readouterr().out
    assert "q = q_0 .. q_2" in said and "10 other columns" in said


def test_accelerations_and_other_kinds_of_a_quantity_are_passed_over(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of Position1 and PositionComputed1 the first is the joint's; without it, and of torques that differ, nobody knows which."""
    names = [
        *numbered("PositionComputed#", "VelocityComputed#", "TorqueSmooth#", t="Time"),
        *numbered("Position#", "Velocity#", "Torque#")[1:],
        *(f"DDotQ{k}" for k in (1, 2, 3)),
        *(f"{x}Cur{k}" for k in (1, 2, 3) for x in ("Phase", "Bus")),
    ]
    table = np.column_stack([T, 9 * Q, 9 * DQ, 9 * TAU, Q, DQ, TAU, 7 * Q, np.ones((N, 6))])
    path, out = text(tmp_path / "a.csv", names, table=table), tmp_path / "rec.parquet"
    robot = tmp_path / "arm.urdf"
    robot.write_text(urdf(("joint_1", "joint_2", "joint_3")))
    for options in ([], ["--robot", str(robot)], ["--columns", "t=time,q=position?,dq=velocity?,tau=torque?"]):
        assert main(["import", str(path), "--out", str(out), *options]) == 0
        (r,) = read_recordings(out)
        assert r.q == pytest.approx(Q) and r.dq == pytest.approx(DQ) and r.tau == pytest.approx(TAU)
    said = capsys.readouterr().out
    assert "q = Position1 .. Position3" in said and "tau = Torque1 .. Torque3 of" in said
    how = ["--columns", "t=Time,q=pos*,dq=vel*,tau=torque?"]
    assert main(["import", str(path), "--out", str(out), *how]) == 2
    assert "names 1 of t, 6 of q, 6 of dq, 3 of tau" in (said := capsys.readouterr().err) and "q=position?" in said


def test_the_rate_is_that_of_the_stamps(tmp_path: Path) -> None:
    """Stamps in whole milliseconds, most 10 ms apart and some 11: the rate that is written down is no finding of `stopset inspect`."""
    out = tmp_path / "rec.parquet"
    t = np.cumsum(np.r_[0.0, np.resize([0.010, 0.010, 0.011], N - 1)])
    t[200:] += 0.05  # a gap counts for nothing
    table = np.column_stack([np.round(t, 3), ALL[:, 1:]])
    assert main(["import", str(text(tmp_path / "a.csv", WRITTEN["plain"], table=table)), "--out", str(out)]) == 0
    assert read_meta(out).rate_hz == pytest.approx(3 / 0.031, rel=1e-3)


def test_joints_are_those_of_the_chain_that_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of a robot with two arms on a column: what the refusal asks for is an option of this command."""
    robot, out = tmp_path / "two.urdf", tmp_path / "rec.parquet"
    arms = urdf(("waist", "hip", "knee", "toe")).replace("</robot>", "")
    for name in ("left", "right"):
        arms += (
            f'<link name="{name}"/><joint name="to_{name}" type="revolute"><parent link="l4"/><child link="{name}"/>'
            '<axis xyz="0 1 0"/><limit lower="-3" upper="3" velocity="3" effort="100"/></joint>'
        )
    robot.write_text(arms + "</robot>")
    path = text(tmp_path / "a.csv", WRITTEN["plain"])
    how = ["import", str(path), "--out", str(out), "--robot", str(robot)]
    assert main(how) == 2 and "--tip" in capsys.readouterr().err
    assert main([*how[:4], "--tip", "l4"]) == 2 and "--robot" in capsys.readouterr().err
    assert main([*how, "--tip", "l4", "--lock", "waist"]) == 0
    assert read_meta(out).joints == ("hip", "knee", "toe")


def test_joints_are_those_of_the_robot_whatever_the_order(tmp_path: Path) -> None:
    """Columns by number are its joints from base to flange; by name they are sorted, and a gripper's are left."""
    robot, out, joints = tmp_path / "arm.urdf", tmp_path / "rec.parquet", ("hip", "knee_joint", "toe")
    robot.write_text(urdf(joints))
    table = np.column_stack([T, *(x[:, i] for x in (Q, DQ, TAU) for i in (2, 0, 1)), T, T, T])
    by_number = ["t", *(f"{k}{i + 1}" for k in ("q", "dq", "tau") for i in (2, 0, 1)), "x", "y", "z"]
    by_names = [
        "t",
        *(f"{k}_{joints[i]}" for k in ("pos", "vel", "eff") for i in (2, 0, 1)),
        "pos_finger",
        "vel_finger",
        "eff_finger",
    ]
    for names in (by_number, by_names):
        assert main(["import", str(text(tmp_path / "a.csv", names, table=table)), "--out", str(out), "--robot", str(robot)]) == 0
        (r,) = read_recordings(out)
        assert read_meta(out).joints == joints and r.q == pytest.approx(Q) and r.tau == pytest.approx(TAU)


@pytest.mark.parametrize(("scale", "unit"), [(1.0, "s"), (1e3, "ms"), (1e6, "us"), (1e9, "ns")])
@pytest.mark.parametrize("rate", [50.0, 250.0, 1000.0])
def test_the_unit_of_time_is_told_by_its_steps(
    scale: float, unit: str, rate: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    at = np.arange(N) / rate
    stamps = np.round(scale * (1000.0 + at)) if unit != "s" else at
    out = tmp_path / "rec.parquet"
    assert (
        main(
            [
                "import",
                str(text(tmp_path / "a.csv", WRITTEN["plain"], table=np.column_stack([stamps, Q, DQ, TAU]))),
                "--out",
                str(out),
            ]
        )
        == 0
    )
    (r,) = read_recordings(out)
    assert f"time in {unit}" in capsys.readouterr().out and r.t == pytest.approx(at, abs=1e-6)


def test_degrees_are_converted_where_they_are_told_and_refused_where_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "rec.parquet"
    table = np.column_stack([T, np.degrees(Q), np.degrees(DQ), TAU])
    path = text(tmp_path / "a.csv", WRITTEN["plain"], table=table)
    assert main(["import", str(path), "--out", str(out)]) == 2 and "--degrees" in capsys.readouterr().err and not out.exists()
    assert main(["import", str(path), "--out", str(out), "--degrees"]) == 0
    assert read_recordings(out).trials[0].dq == pytest.approx(DQ)
    named = [n.replace("q", "q_deg_") if n[0] == "q" else n for n in WRITTEN["plain"]]
    assert main(["import", str(text(tmp_path / "b.csv", named, table=table)), "--out", str(out)]) == 0
    assert read_recordings(out).trials[0].q == pytest.approx(Q)
    mixed = [n.replace("dq", "vel_rad_s_").replace("q", "q_deg_") for n in WRITTEN["plain"]]
    table[:, 4:7] = DQ
    assert main(["import", str(text(tmp_path / "c.csv", mixed, table=table)), "--out", str(out)]) == 0
    assert read_recordings(out).trials[0].dq == pytest.approx(DQ) and read_recordings(out).trials[0].q == pytest.approx(Q)


def test_a_table_without_a_header_has_its_columns_stated(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "rec.parquet"
    path, joints = text(tmp_path / "a.txt", [], " ", np.column_stack([ALL, TAU])), ["--joints", "hip,knee,toe"]
    for options, word in (
        (joints, "--columns"),
        (["--columns", "t,q,dq,tau"], "--joints"),  # thirteen columns may be three blocks of four joints
        ([*joints, "--columns", "t,q,dq,tau"], "13 columns"),
        ([*joints, "--columns", "t,dq,tau,-"], "--columns"),
    ):
        assert main(["import", str(path), "--out", str(out), *options]) == 2 and word in capsys.readouterr().err
    assert not out.exists()
    assert main(["import", str(path), "--out", str(out), "--columns", "t,q,dq,tau,-", *joints]) == 0
    assert read_recordings(out).trials[0].tau == pytest.approx(TAU)
    bare, how = text(tmp_path / "b.txt", [], " ", np.column_stack([Q, TAU])), ["--columns", "q,tau", *joints]
    assert main(["import", str(bare), "--out", str(out), *how]) == 2 and "--cycle" in capsys.readouterr().err
    assert main(["import", str(bare), "--out", str(out), *how, "--cycle", "0.004"]) == 0
    (r,) = read_recordings(out)
    assert read_meta(out).velocity == "derived" and read_meta(out).clock == "assumed" and r.t == pytest.approx(T - T[0])
    assert r.dq[1:-1] == pytest.approx(DQ[1:-1], abs=1e-4)


def test_a_header_may_be_a_remark(tmp_path: Path) -> None:
    names = numbered("field.position#", "field.velocity#", "field.effort#", 0, "field.header.stamp")
    table = np.column_stack([1e9 * T, ALL])
    path = text(tmp_path / "echo.csv", [], table=table, before="%" + ",".join(["time", *names]) + "\n")
    out = tmp_path / "rec.parquet"
    assert main(["import", str(path), "--out", str(out)]) == 0
    assert read_recordings(out).trials[0].q == pytest.approx(Q)


def test_arrays_of_numpy_and_of_matlab_are_tables(tmp_path: Path) -> None:
    out = tmp_path / "rec.parquet"
    np.savez(tmp_path / "a.npz", t=T, q=Q, dq=DQ, tau=TAU, name=np.array(["x"]))
    savemat(
        tmp_path / "a.mat",
        {"log": {"time": T[:, None], "pos": Q.T, "vel": DQ.T, "torque": TAU.T}, "note": "x"},
        do_compression=True,
    )
    for name in ("a.npz", "a.mat"):
        assert main(["import", str(tmp_path / name), "--out", str(out)]) == 0
        (r,) = read_recordings(out)
        assert r.q == pytest.approx(Q) and r.tau == pytest.approx(TAU) and r.t == pytest.approx(T - T[0])
        out.unlink()


def test_quantities_in_files_of_their_own_stand_beside_each_other(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Angles counted from nought and torques from one, neither with stamps; text without a header is called after its file."""
    out = tmp_path / "rec.parquet"
    q = text(tmp_path / "q.csv", [f"q{k}" for k in range(3)], table=Q)
    tau = text(tmp_path / "tau.csv", [f"tau{k}" for k in (1, 2, 3)], table=TAU)
    how = ["--beside", "--cycle", "0.004", "--out", str(out)]
    assert main(["import", str(q), str(tau), *how]) == 0
    (r,) = read_recordings(out)
    assert r.q == pytest.approx(Q) and r.tau == pytest.approx(TAU)
    bare = [
        text(tmp_path / f"{stem}{k + 1}.txt", [], table=x[:, k : k + 1])
        for stem, x in (("angle", Q), ("torque", TAU))
        for k in range(3)
    ]
    assert main(["import", *map(str, bare), *how]) == 0
    (r,) = read_recordings(out)
    assert r.q == pytest.approx(Q) and r.tau == pytest.approx(TAU)
    text(tmp_path / "tau.csv", [f"tau{k}" for k in (1, 2, 3)], table=TAU[:-1])
    capsys.readouterr()
    assert main(["import", str(q), str(tau), *how]) == 2 and "299 and 300 rows" in capsys.readouterr().err
    (tmp_path / "log.asc").write_text("x")
    assert main(["import", str(q), str(tmp_path / "log.asc"), *how]) == 2


def test_files_beside_each_other_of_an_arm_of_which_a_joint_stands(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Each file with stamps and joints of its own, also of a lift that the arm's description locks; each name says its file's quantity."""
    joints = ["arm_1_joint", "arm_2_joint", "arm_3_joint"]
    paths = [
        text(
            tmp_path / f"arm_{what}.csv",
            ["t", f"- torso_lift_joint_{what}", *(f"- {j}_{what}" for j in joints)],
            table=np.column_stack([T, 0.0 * T, x]),
        )
        for what, x in (("position", Q), ("velocity", DQ), ("effort", TAU))
    ]
    out = tmp_path / "rec.parquet"
    assert main(["import", *map(str, paths), "--beside", "--joints", ",".join(joints), "--out", str(out)]) == 0
    found = read_recordings(out)
    (r,) = found.trials
    assert found.meta.joints == tuple(joints) and "t = arm_position.t" in capsys.readouterr().out
    assert (
        r.q == pytest.approx(Q) and r.dq == pytest.approx(DQ) and r.tau == pytest.approx(TAU) and r.t == pytest.approx(T - T[0])
    )


def test_a_matlab_file_that_unpacks_to_too_much_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    savemat(tmp_path / "a.mat", {"t": np.zeros(2 * 10**7), "q": np.zeros((3, 10))}, do_compression=True)
    assert main(["import", str(tmp_path / "a.mat"), "--out", str(tmp_path / "r.parquet")]) == 2
    assert "unpacks to more than" in capsys.readouterr().err


def test_currents_become_torques_by_stated_constants(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, out = text(tmp_path / "a.csv", numbered("q#", "dq#", "motor_current_#")), tmp_path / "rec.parquet"
    assert (
        main(["import", str(path), "--out", str(out)]) == 2
        and "--torque-constant" in capsys.readouterr().err
        and not out.exists()
    )
    assert main(["import", str(path), "--out", str(out), "--torque-constant", "10,-11,12"]) == 0
    assert read_recordings(out).trials[0].tau == pytest.approx(TAU * [10, -11, 12]), "a current may count against its joint"


def test_constants_of_what_is_taken_for_torques_are_not_passed_over(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, out = text(tmp_path / "a.csv", numbered("q#", "dq#", "effort#")), tmp_path / "rec.parquet"
    how = ["import", str(path), "--out", str(out), "--torque-constant", "10,11,12"]
    assert main(how) == 2 and "effort1 .. effort3 are taken for torques" in capsys.readouterr().err and not out.exists()
    assert main([*how, "--columns", "t=t,q=q?,dq=dq?,i=effort?"]) == 0
    assert read_recordings(out).trials[0].tau == pytest.approx(TAU * [10, 11, 12])


@pytest.mark.parametrize(
    ("spoil", "options", "word"),
    [
        (lambda t: t.replace("tau2", "other"), [], "tau"),
        (lambda t: t.replace("q1", "x1").replace("q2", "x2").replace("q3", "x3"), [], "no column tells"),
        (lambda t: t.replace("q3", "y"), [], "--columns"),
        (lambda t: t.replace(t.splitlines()[9], t.splitlines()[9].rsplit(",", 3)[0]), [], "cut off"),
        (lambda t: t.replace(",0.", ",nonsense", 1), [], "expected"),
        (lambda t: "\n".join(t.splitlines()[:5]), [], "at least"),
        (lambda t: "", [], "no row"),
        (lambda t: "# nothing\n", [], "no row"),
        (lambda t: t, ["--columns", "q=q*"], "--columns"),
        (lambda t: t, ["--columns", "x=q*"], "--columns"),
        (lambda t: t, ["--columns", "q=none*,tau=tau*"], "no such column"),
        (lambda t: t, ["--joints", "a,b"], "2 joints"),
        (lambda t: t, ["--joints", "a,b,a"], "twice"),
        (lambda t: t, ["--columns", "t=t,q=tau*,tau=tau*"], "twice"),
        (lambda t: t, ["--cycle", "7"], "0.0001"),
    ],
)
def test_what_is_no_table_ends_in_one_sentence(
    spoil: Callable[[str], str], options: list[str], word: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = text(tmp_path / "a.csv", WRITTEN["plain"])
    path.write_text(spoil(path.read_text()))
    assert main(["import", str(path), "--out", str(tmp_path / "rec.parquet"), "--quiet", *options]) == 2
    said = capsys.readouterr().err.strip()
    assert word in said and "\n" not in said and ("a.csv" in said or options), said
    assert not (tmp_path / "rec.parquet").exists()


@pytest.mark.parametrize("mark", [",", ";", " "])
@pytest.mark.parametrize("named", [True, False])
def test_a_last_row_that_is_cut_off_is_left_out_and_told(
    mark: str, named: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As where a logger was killed: all rows before it are whole."""
    path, out = text(tmp_path / "a.txt", WRITTEN["plain"] if named else [], mark), tmp_path / "rec.parquet"
    path.write_text(path.read_text().rsplit(mark, 3)[0])
    how = [] if named else ["--columns", "t,q,dq,tau", "--joints", "hip,knee,toe"]
    assert main(["import", str(path), "--out", str(out), *how]) == 0
    assert "the last row is cut off and left out" in capsys.readouterr().out
    assert read_recordings(out).trials[0].tau == pytest.approx(TAU[:-1])


def test_what_other_columns_hold_refuses_no_table(tmp_path: Path) -> None:
    """A column that nobody asked for is whole numbers for long, then a word or the smallest of numbers."""
    rows = 30_000
    table = np.column_stack([np.arange(rows) / RATE, np.resize(ALL[:, 1:], (rows, 9)), np.zeros(rows)])
    path, out = text(tmp_path / "a.csv", [*WRITTEN["plain"], "mode"], table=table), tmp_path / "rec.parquet"
    for last in ("2.45926e-319", "stopped"):
        path.write_text(path.read_text().rstrip().rpartition(",")[0] + f",{last}\n")
        assert main(["import", str(path), "--out", str(out)]) == 0
        assert len(read_recordings(out).trials[0].t) == rows


@pytest.mark.parametrize("name", ["a.npz", "a.mat", "a.parquet", "a.txt"])
def test_rubbish_is_no_table(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / name).write_bytes(b"\x00\x01PK" + bytes(range(256)) * 4)
    assert main(["import", str(tmp_path / name), "--out", str(tmp_path / "r.parquet"), "--quiet"]) == 2
    said = capsys.readouterr().err.strip()
    assert name in said and "\n" not in said


@pytest.mark.parametrize("name", ["a.csv", "b.txt", "a.npz", "a.mat"])
def test_damaged_tables_end_in_a_declared_error_or_in_a_recording(name: str, tmp_path: Path) -> None:
    """Bytes changed, cut and written twice: never anything but a `RecordingError`."""
    text(tmp_path / "a.csv", WRITTEN["plain"])
    text(tmp_path / "b.txt", WRITTEN["plain"], " ")
    np.savez_compressed(tmp_path / "a.npz", t=T, q=Q, dq=DQ, tau=TAU)
    savemat(tmp_path / "a.mat", {"t": T, "q": Q, "dq": DQ, "tau": TAU}, do_compression=True)
    whole, rng, refused = (tmp_path / name).read_bytes(), np.random.default_rng(7), 0
    for _ in range(300):
        data = bytearray(whole)
        for at in rng.integers(0, len(data), rng.integers(1, 6)):
            data[at] = rng.integers(0, 256)
        a, b = sorted(rng.integers(0, len(data), 2).tolist())
        data = [data, data[:a], data[:a] + data[b:], data[:b] + data[a:]][rng.integers(0, 4)]
        (tmp_path / f"spoilt{name[1:]}").write_bytes(data)
        try:
            read_table([tmp_path / f"spoilt{name[1:]}"], Stated(), "motor_torque", 0)
        except RecordingError:
            refused += 1
    assert refused > 100


def test_one_quantity_of_two_kinds_is_asked_back() -> None:
    with pytest.raises(RecordingError, match="--columns"):
        by_name(["t", "q_raw_1", "q_filtered_1", "q_raw_2", "q_filtered_2", "tau_1", "tau_2"], None)


def test_a_recording_of_another_tool_is_told_how_it_becomes_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["inspect", str(text(tmp_path / "a.csv", WRITTEN["plain"]))]) in (1, 2)
    seen = capsys.readouterr()
    assert "stopset import a.csv" in seen.out + seen.err
