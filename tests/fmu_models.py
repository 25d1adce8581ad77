"""Models for the FMU's tests, built in code: numbers of the order of the paper's arm, none of them measured."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stopset.artifact import Abstraction, Domain, Guarantee, Model, UncertaintySets
from stopset.effects import Fitted
from stopset.offline.description import robot_from_text
from stopset.sets import Box

J = np.array([1.9, 12.4, 1.9, 1.8, 0.55, 0.43])
V = np.array([12.6, 30.8, 8.5, 8.1, 3.5, 4.0])


def arm_urdf(n: int) -> str:
    """A made-up arm of ``n`` joints about changing axes."""
    links = ["<link name='base'/>"]
    for i in range(n):
        axis = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "0 0 1", "1 0 0")[i]
        mass = 5.0 - 0.6 * i
        links.append(
            f"<link name='l{i + 1}'><inertial><origin xyz='0.01 0.02 {0.1 + 0.01 * i}'/><mass value='{mass}'/>"
            f"<inertia ixx='0.02' iyy='0.03' izz='0.01' ixy='0.001' ixz='0.002' iyz='0'/></inertial></link>"
            f"<joint name='axis_{i + 1}' type='revolute'><parent link='{'base' if i == 0 else f'l{i}'}'/>"
            f"<child link='l{i + 1}'/><origin xyz='0 {0.02 * i} {0.3 if i else 0.1}' rpy='0.1 {0.2 * i} 0'/>"
            f"<axis xyz='{axis}'/><limit lower='-3' upper='3' velocity='1.5' effort='100'/></joint>"
        )
    links.append(
        f"<link name='flange'/><joint name='tip' type='fixed'><parent link='l{n}'/><child link='flange'/>"
        "<origin xyz='0 0 0.1'/></joint>"
    )
    return f"<robot name='test arm'>{''.join(links)}</robot>"


def arm_model(
    n: int = 6, *, coupled: bool = False, cubic: float = 0.0, effort: str = "compensated_torque",
    effects: Sequence[Fitted] = (), horizon: float = 10.0, conform: str = "all", offset: bool = False,
) -> Model:  # fmt: skip
    """Model 1 of a made-up arm."""
    robot = robot_from_text(arm_urdf(n))
    inertia, viscous = np.resize(J, n), np.resize(V, n)
    Minv = np.diag(1.0 / inertia)
    if coupled:
        rng = np.random.default_rng(3)
        mix = rng.normal(size=(n, n))
        Minv = np.linalg.inv(np.diag(inertia) + 0.08 * (mix @ mix.T))
    table = viscous[:, None]
    if cubic:
        table = np.column_stack([viscous, np.zeros(n), cubic * viscous])
    U = np.linspace(0.5, 1.5, n)
    sets = UncertaintySets(
        X0=Box.symmetric(np.concatenate([np.full(n, 1e-3), np.full(n, 5e-3)])),
        U=Box.of(-U, 1.5 * U),
        V=Box.symmetric(np.concatenate([np.full(n, 2e-4), np.full(n, 4e-3)])),
        dt=0.01,
        horizon=horizon,
        conform=conform,
    )
    domain = Domain(
        q=Box.symmetric(np.full(n, 3.0)),
        dq=Box.symmetric(np.full(n, 1.5)),
        u=Box.symmetric(np.full(n, 80.0)),
        temp=Box.of(np.full(n, 15.0), np.full(n, 55.0)),
        payload=(0.0, 2.0),
    )
    shift = np.linspace(-0.3, 0.3, n) if offset else np.zeros(0)
    return Model(
        robot=robot, rotor=np.zeros(n), effort=effort, effects=tuple(effects),
        abstraction=Abstraction(1, table.shape[1], Minv, table, offset=shift), sets={"powered": sets}, domain=domain,
        guarantee=Guarantee(0, 0, 1.0, 0.95, "a made-up model: no motions held out"),
    )  # fmt: skip
