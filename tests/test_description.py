"""How a robot is read: which joints are the arm, what is refused by name, capsules around meshes."""

from __future__ import annotations

import json
import struct
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stopset.artifact.store import _digest
from stopset.cli.main import main
from stopset.errors import ModelFileError, RobotError
from stopset.offline.description import enclose, load_robot, robot_from_text
from stopset.offline.description.enclose import capsule_around, corners_of, distance

pin = pytest.importorskip("pinocchio")

LIMIT = '<limit lower="-2" upper="2" effort="50" velocity="2"/>'


def link(name: str, mass: float, shape: str = "") -> str:
    return (
        f'<link name="{name}"><inertial><origin xyz="0.02 -0.01 0.1" rpy="0.1 0.2 0.3"/><mass value="{mass}"/>'
        f'<inertia ixx="0.03" iyy="0.02" izz="0.01" ixy="0.001" ixz="-0.002" iyz="0.003"/></inertial>{shape}</link>'
    )


def joint(name: str, kind: str, parent: str, child: str, more: str = LIMIT) -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/><origin xyz="0.1 0 0.3" rpy="0.4 0 1.1"/>'
        f'<axis xyz="0 0.6 0.8"/>{more}</joint>'
    )


def collision(shape: str, origin: str = '<origin xyz="0.1 0 -0.2" rpy="0.3 0.1 -0.4"/>') -> str:
    return f"<collision>{origin}<geometry>{shape}</geometry></collision>"


# a turned base, a continuous joint, a camera beside the chain, two fingers
ARM = (
    '<robot name="branches"><link name="world"/>'
    + "".join(link(name, 1.0 + k) for k, name in enumerate(("base", "upper", "lower", "camera", "hand", "left", "right")))
    + joint("mount", "fixed", "world", "base")
    + joint("shoulder", "continuous", "base", "upper")
    + joint("elbow", "revolute", "upper", "lower")
    + joint("bracket", "fixed", "upper", "camera")
    + joint("flange", "fixed", "lower", "hand")
    + joint("finger_1", "prismatic", "hand", "left")
    + joint("finger_2", "revolute", "hand", "right")
    + "</robot>"
)
FINGERS = {"locked": ["finger_1", "finger_2"]}


def serial(*kinds: str, more: str = LIMIT) -> str:
    """An arm of joints j1, j2, ... of these kinds, the last with ``more``."""
    names = ["base", *(f"l{k + 1}" for k in range(len(kinds)))]
    last = len(kinds) - 1
    return (
        '<robot name="arm">'
        + "".join(link(n, 1.0) for n in names)
        + "".join(joint(f"j{k + 1}", kind, names[k], names[k + 1], more if k == last else LIMIT) for k, kind in enumerate(kinds))
        + "</robot>"
    )


# ---- which joints are the arm


def test_what_stands_still_is_lumped_into_what_carries_it() -> None:
    robot = robot_from_text(ARM, FINGERS)
    assert robot.joints == ("shoulder", "elbow")
    assert robot.pi[:, 0] == pytest.approx([2.0 + 4.0, 3.0 + 5.0 + 6.0 + 7.0])  # with its camera; with hand and fingers
    assert np.isinf(robot.q_limit[0]).all() and robot.q_limit[1].tolist() == [-2.0, 2.0]  # one turns on, one has limits
    assert robot.chain.p[0] == pytest.approx(0.1 * np.eye(3)[0] + [0, 0, 0.3] + robot.chain.R[0] @ [0, 0, 0] + mounted())
    assert "finger_1, finger_2" in " ".join(robot.notes)


def mounted() -> np.ndarray:
    """(3,) the second placement of a kind, turned by the first."""
    turn = pin.rpy.rpyToMatrix(0.4, 0.0, 1.1)
    return np.asarray(turn @ [0.1, 0.0, 0.3])


def test_a_part_of_an_arm_by_locked_joints_and_tool_frames_by_name() -> None:
    upper = robot_from_text(ARM, {"locked": ["finger_1", "finger_2", "shoulder"]})
    assert upper.joints == ("elbow",)
    hand = robot_from_text(ARM, {**FINGERS, "tip": "hand"})
    assert hand.tip == pytest.approx([0.1, 0.0, 0.3])
    assert robot_from_text(ARM, {**FINGERS, "tip": "flange"}).tip == pytest.approx(hand.tip)  # the joint's frame is the link's
    namesakes = ARM.replace('joint name="flange"', 'joint name="hand"').replace('joint name="elbow"', 'joint name="lower"')
    for tip in ("hand", "lower"):  # a link and the joint before it
        assert robot_from_text(namesakes, {**FINGERS, "tip": tip}).tip == pytest.approx(
            robot_from_text(ARM, {**FINGERS, "tip": tip}).tip
        )
    camera = robot_from_text(ARM, {"tip": "camera"})
    assert camera.joints == ("shoulder",) and camera.tip == pytest.approx([0.1, 0.0, 0.3])
    assert "elbow, finger_1, finger_2 are beside the chain to camera" in " ".join(camera.notes)
    with pytest.raises(RobotError, match=r"no link or joint 'nowhere'; expected .*hand|left|right"):
        robot_from_text(ARM, {"tip": "nowhere"})
    with pytest.raises(RobotError, match=r"no joint wrist to lock; expected some of shoulder, .*finger_2"):
        robot_from_text(ARM, {"locked": ["wrist"]})


def test_frames_that_no_joint_turns_are_no_arms_to_name() -> None:
    """Two arms on one base, each with a frame at its foot, as drivers of industrial arms have them."""
    foot = '<link name="foot"/>' + joint("foot", "fixed", "base", "foot", "")
    arm = serial("revolute", "revolute").replace("</robot>", foot + "</robot>")
    two = arm.replace("</robot>", link("r1", 1.0) + joint("right", "revolute", "base", "r1", LIMIT) + "</robot>")
    with pytest.raises(RobotError, match=r"branches at base .*one of l2 \(2 joints\), r1 \(1 joints\), or lock"):
        robot_from_text(two)
    with pytest.raises(RobotError, match=r"no revolute joint between its base and .* --tip, e.g. l2 \(2 joints\), r1"):
        robot_from_text(two, {"tip": "foot"})


def test_limits_and_products_of_inertia_that_are_missing() -> None:
    """The parser would take a body without ``ixy`` as nothing, and refuse a joint without limits."""
    text = serial("revolute", "revolute", more='<limit upper="1" effort="3"/>')
    full, bare = robot_from_text(text), robot_from_text(text.replace(' ixy="0.001"', "").replace(LIMIT, ""))
    assert full.q_limit.tolist() == [[-2.0, 2.0], [-np.inf, 1.0]] and full.dq_limit.tolist() == [2.0, np.inf]
    assert bare.q_limit[0].tolist() == [-np.inf, np.inf] and np.isinf(bare.torque_limit[0]) and bare.torque_limit[1] == 3.0
    assert bare.pi[:, 0].tolist() == [1.0, 1.0] and not np.allclose(bare.pi, full.pi)
    assert "no lower, velocity limit; taken as unlimited" in " ".join(full.notes)


def test_a_speed_or_an_effort_of_nothing_is_none_that_was_given() -> None:
    """As a limit it made a table of stops from 0 rad/s."""
    robot = robot_from_text(serial("revolute", "revolute", more='<limit lower="-1" upper="1" effort="0" velocity="0.0"/>'))
    assert robot.dq_limit.tolist() == [2.0, np.inf] and np.isinf(robot.torque_limit[1])
    assert "no velocity, effort limit; taken as unlimited" in " ".join(robot.notes)


# ---- what is no arm is refused by name


@pytest.mark.parametrize(("text", "says"), [
    (serial("revolute", "prismatic", "revolute"), "joint j2 is prismatic; expected joints that turn by themselves: lock .*--lock j2"),
    (serial("revolute", "revolute", "prismatic"), "joint j3 is prismatic"),  # at the end too: its mass moves
    (serial("revolute", "floating"), "joint j2 is floating"),
    (serial("revolute", "planar"), "joint j2 is planar"),
    (serial("revolute", "revolute", more=LIMIT + '<mimic joint="j1"/>'), r"joint j2 follows joint j1 \(mimic\).*--lock j2"),
    (ARM, r"joint finger_1 is prismatic"),
    (serial("revolute", "revolute").replace("</robot>", joint("j3", "revolute", "base", "l2") + "</robot>"),
     "joint j3 closes a loop: link l2 hangs on joint j2 already"),
    (serial("revolute", "revolute").replace("</robot>", joint("j3", "revolute", "l2", "base") + "</robot>"), r"joint j\d is in a loop"),
    (serial("revolute").replace("</robot>", '<link name="loose"/></robot>'), r"2 base links \(base, loose\)"),
    (serial("revolute").replace('child link="l1"', 'child link="l9"'), "joint j1 names link l9, which is not there"),
    (serial("fixed", "fixed"), "has no revolute joint"),
    (serial("revolute").replace('mass value="1.0"', 'mass value="-1.0"'), "mass -1.0 is negative"),
    # these the parser behind pinocchio takes as zero, and tells the terminal
    (serial("revolute").replace('mass value="1.0"', 'mass value="heavy"'), r"pinocchio: Inertial: mass \[heavy\] is not a float"),
    (serial("revolute").replace('mass value="1.0"', 'mass value="nan"'), r"pinocchio: Inertial: mass \[nan\] is not a float"),
    (serial("revolute").replace('effort="50"', 'effort="much"'), r"pinocchio: joint \[j1\]: effort value \(much\) is not a valid float"),
    (serial("revolute").replace("0 0.6 0.8", "0 a 0.8"), "pinocchio: Malformed axis element for joint .j1."),
    (serial("revolute", "hinge"), "joint j2 is hinge"),
])  # fmt: skip
def test_what_is_no_arm_is_refused_by_name(text: str, says: str, capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(RobotError, match=says):
        robot_from_text(text)
    assert capfd.readouterr() == ("", ""), "the sentence is all that is said"


@pytest.mark.parametrize(
    ("sheet", "says"),
    [
        ({"gravity": [0, 0, -1]}, "gravity is .*expected three numbers"),
        ({"gravity": [0, 0, -981]}, "gravity is"),
        ({"gravity": "down"}, "gravity is"),
        ({"joints": []}, "joints is .*expected an object"),
        ({"brake_torque_nominal_Nm": 12000, "torque_limit_Nm": 20}, "brake_torque_nominal_Nm is 12000 .*in N m"),
        ({"brake_tolerance": 10}, "brake_tolerance is 10; expected a share below 1"),
        ({"brake_tolerance": 1.0}, "brake_tolerance"),
        ({"brake_delay_s": [15, 60]}, "brake_delay_s is .*in seconds"),
        ({"brake_delay_s": [0.1, float("inf")]}, "brake_delay_s"),
        ({"brake_rise_s": ["0.1", 0.2]}, "brake_rise_s"),
        ({"brake_rise_s": [0.2, 0.1]}, "brake_rise_s"),
    ],
)
def test_a_data_sheet_in_other_units_is_refused(sheet: dict[str, object], says: str) -> None:
    """In g, N mm, % or ms a stop would be bounded as if the arm weighed nothing or its brakes held a thousand times as much."""
    of_arm = {"gravity", "joints"} & set(sheet)
    with pytest.raises(RobotError, match=says):
        robot_from_text(ARM, {**FINGERS, **(sheet if of_arm else {"joints": {"shoulder": sheet}})})


def test_a_data_sheet_as_makers_print_them_is_taken() -> None:
    row = {
        "brake_torque_nominal_Nm": 44,
        "torque_limit_Nm": 20,
        "brake_tolerance": 0.3,
        "brake_delay_s": [0, 0.1],
        "brake_rise_s": [0.0, 0.03],
    }
    robot = robot_from_text(ARM, {**FINGERS, "joints": {"shoulder": row}, "gravity": [0, -6.9, -6.9]})
    assert robot.drives[0].brake_torque == 44.0 and robot.drives[0].brake_delay == (0.0, 0.1)
    assert np.all(robot_from_text(ARM, {**FINGERS, "gravity": [0, 0, 0]}).chain.gravity == 0.0)


def test_what_is_locked_or_beside_a_named_tip_is_not_refused() -> None:
    slides, follows = serial("revolute", "prismatic"), serial("revolute", "revolute", more=LIMIT + '<mimic joint="j1"/>')
    for text in (slides, follows):
        assert robot_from_text(text, {"locked": ["j2"]}).joints == robot_from_text(text, {"tip": "l1"}).joints == ("j1",)


def test_without_pinocchio_one_sentence_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pinocchio", None)
    with pytest.raises(RobotError, match=r"pinocchio is not installed.*pip install"):
        load_robot("lwa4p")


# ---- what a link occupies


def stl(path: Path, corners: np.ndarray) -> None:
    """A binary STL of triangles between neighbouring ``corners`` (m, 3)."""
    triangles = [(corners[k], corners[k - 1], corners[k - 2]) for k in range(len(corners))]
    rows = [struct.pack("<12fH", *np.zeros(3), *np.ravel(t), 0) for t in triangles]
    path.write_bytes(b"\0" * 80 + struct.pack("<I", len(rows)) + b"".join(rows))


def cloud(seed: int) -> np.ndarray:
    """(m, 3) corners of an elongated, crooked body."""
    rng = np.random.default_rng(seed)
    along = rng.uniform(0, 0.5, 300)
    bent = np.column_stack([0.05 * np.sin(4 * along), 0 * along, along]) + rng.uniform(-0.04, 0.04, (300, 3))
    return np.asarray(bent @ np.linalg.qr(rng.normal(size=(3, 3)))[0])


def meshed(tmp_path: Path, mesh: str) -> Path:
    """An arm whose two links have the mesh file ``mesh``, the last a box, too, on a flange that is fixed to it."""
    shape = collision(f'<mesh filename="{mesh}" scale="1 2 1"/>')
    names = (
        link("base", 1.0),
        link("a", 1.0, shape),
        link("b", 1.0, shape),
        link("c", 1.0, collision('<box size="0.1 0.2 0.3"/>')),
    )
    text = '<robot name="meshed">' + "".join(names) + joint("j1", "revolute", "base", "a")
    text += joint("j2", "revolute", "a", "b") + joint("f", "fixed", "b", "c") + "</robot>"
    (tmp_path / "urdf").mkdir(exist_ok=True)
    path = tmp_path / "urdf" / "robot.urdf"
    path.write_text(text)
    return path


@pytest.mark.parametrize("named", ["package://{here}/meshes/link.stl", "../meshes/link.stl", "file://{root}/meshes/link.stl"])
def test_every_vertex_is_in_its_links_capsule(tmp_path: Path, named: str) -> None:
    (tmp_path / "meshes").mkdir()
    stl(tmp_path / "meshes" / "link.stl", cloud(1))
    robot = load_robot(meshed(tmp_path, named.format(here=tmp_path.name, root=tmp_path)))
    assert robot.arm.bare == () and not any("collision geometry" in note for note in robot.notes)
    turn, place = pin.rpy.rpyToMatrix(0.3, 0.1, -0.4), np.array([0.1, 0.0, -0.2])
    body = cloud(1).astype(np.float32) * [1.0, 2.0, 1.0] @ turn.T + place
    first, last = robot.arm.capsules
    assert distance(body, first[:6]).max() <= first[6]
    box = enclose._box(np.array([0.05, 0.1, 0.15])) @ turn.T + place
    fixed = box @ pin.rpy.rpyToMatrix(0.4, 0.0, 1.1).T + [0.1, 0.0, 0.3]
    for points in (body, fixed, robot.tip[None]):
        assert distance(points, last[:6]).max() <= last[6]
    # and not by being huge: less than twice as wide as the body is at its narrowest
    narrow = np.linalg.svd(body - body.mean(axis=0))[2][2]
    assert first[6] < 2 * np.ptp(body @ narrow)
    # the radius is what holds them: a thousandth less lets a corner out
    assert distance(body, first[:6]).max() > 0.999 * first[6]


def test_a_link_of_which_a_mesh_is_not_here_is_said_to_be_a_line(tmp_path: Path) -> None:
    """The box on the flange alone would be less than the link: then none of it is taken as known."""
    robot = load_robot(meshed(tmp_path, "package://elsewhere/link.stl"))
    assert robot.arm.bare == ("j1", "j2")
    said = " ".join(robot.notes)
    assert (
        "no collision geometry behind any joint (e.g. package://elsewhere/link.stl is not here)" in said
        and "line between joints" in said
    )
    assert robot.arm.capsules[0].tolist() == [0, 0, 0, *robot.chain.p[1], 0] and robot.arm.capsules[1].tolist() == [
        0,
        0,
        0,
        *robot.tip,
        0,
    ]


@pytest.mark.parametrize("shape", ["box", "sphere", "cylinder", "capsule"])
def test_shapes_are_within_the_hull_that_stands_for_them(shape: str) -> None:
    """By support: in every direction the corners reach as far as the shape, and no more than 1 % farther."""
    import coal

    made = {"sphere": coal.Sphere(0.1), "cylinder": coal.Cylinder(0.1, 0.5), "capsule": coal.Capsule(0.1, 0.5)}
    corners = corners_of(made.get(shape, coal.Box(0.1, 0.2, 0.3)))
    assert corners is not None
    u = np.random.default_rng(2).normal(size=(2000, 3))
    u /= np.linalg.norm(u, axis=1)[:, None]
    flat, up = np.hypot(u[:, 0], u[:, 1]), np.abs(u[:, 2])
    reach = {"sphere": 0.1 + 0 * up, "cylinder": 0.1 * flat + 0.25 * up, "capsule": 0.1 + 0.25 * up}
    want = reach.get(shape, np.abs(u) @ [0.05, 0.1, 0.15])
    have = (u @ corners.T).max(axis=1)
    assert np.all(have >= want - 1e-12) and np.all(have <= 1.01 * want + 1e-12)
    capsule = capsule_around(corners)
    assert distance(corners, capsule[:6]).max() <= capsule[6]
    assert corners_of(coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)) is None, "no capsule around what has no end"


def test_flat_and_single_points_have_capsules() -> None:
    flat = np.column_stack([np.random.default_rng(3).uniform(size=(20, 2)), np.zeros(20)])
    for points in (flat, flat[:1], np.repeat(flat[:1], 5, axis=0)):
        capsule = capsule_around(points)
        assert np.isfinite(capsule).all() and distance(points, capsule[:6]).max() <= capsule[6]


# ---- the model file holds the arm


def test_the_model_file_holds_the_arm_and_nobody_reads_its_urdf(planar: tuple[Path, object, object], tmp_path: Path) -> None:
    from stopset.artifact import load_model, save_model

    model = load_model(planar[0] / "m.model.json")
    strange = replace(model, robot=replace(model.robot, urdf="<not read>"))
    save_model(strange, tmp_path / "m.json")
    again = load_model(tmp_path / "m.json")
    for name in ("R", "p", "axis", "pi", "q_limit", "dq_limit", "effort", "tip", "capsules"):
        assert np.array_equal(getattr(again.robot.arm, name), getattr(model.robot.arm, name)), name
    assert np.array_equal(again.robot.as_described.pi, model.robot.arm.pi) and again.robot.urdf == "<not read>"


def test_an_older_file_is_refused_by_the_monitor_and_renewed(
    planar: tuple[Path, object, object], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from stopset.artifact import load_model

    body = json.loads((planar[0] / "m.model.json").read_text())
    del body["robot"]["arm"]
    body["schema"] = 4
    body["sha256"] = _digest(body)
    old = tmp_path / "old.json"
    old.write_text(json.dumps(body))
    with pytest.raises(ModelFileError, match=r"has schema 4, .*expected schema 5 .*stopset renew .*old.json --out"):
        load_model(old)
    assert main(["history", str(old)]) == 0  # the offline part reads it as it is
    assert main(["renew", str(old), "--out", str(tmp_path / "new.json")]) == 0 and "renewed" in capsys.readouterr().out
    new, was = load_model(tmp_path / "new.json"), load_model(planar[0] / "m.model.json")
    assert np.array_equal(new.robot.chain.R, was.robot.chain.R) and np.array_equal(new.robot.pi, was.robot.pi)
