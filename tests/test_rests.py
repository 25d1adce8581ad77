"""Which bounds of U come from a joint that stands is said: of a heavy arm half of U was the friction that held it before it began to move."""

from __future__ import annotations

import numpy as np
import pytest

from stopset.artifact.model import ActiveBound
from stopset.offline.identify.rests import at_rest
from stopset.recording import Recording

JOINTS = ("turn", "lift")


def _trial() -> Recording:
    """Both stand for a second; then the first one moves."""
    t = np.arange(0.0, 4.0, 0.01)
    dq = np.column_stack([np.where(t < 1.0, 0.0, np.sin(2.0 * (t - 1.0))), np.zeros_like(t)])
    q = np.cumsum(dq, axis=0) * 0.01
    return Recording("closed_loop", 0, 0, 0, t, q, dq, np.zeros_like(q))


@pytest.mark.parametrize(
    ("start", "age", "bound", "said"),
    [
        (0.1, 0.5, "U[turn].lo", True),
        (0.1, 3.0, "U[turn].lo", False),  # most of that time it moves
        (1.5, 0.5, "U[turn].hi", False),
        (1.5, 0.5, "U[lift].hi", True),
        (0.1, 0.5, "X0[q_turn].lo", False),
    ],
)
def test_bounds_that_a_standing_joint_fixes_are_told(start: float, age: float, bound: str, said: bool) -> None:
    r = _trial()
    found = at_rest([ActiveBound(bound, r.label, start, age, "q_turn")], [r], JOINTS)
    assert bool(found) is said
    if said:
        assert f"U of {bound[2:6]} ({bound[-2:]}) is fixed where the joint stands" in found[0]


def test_of_trials_that_were_not_retained_nothing_is_said() -> None:
    assert at_rest([ActiveBound("U[turn].lo", "closed_loop suite 9 trial 9", 0.1, 0.5, "q_turn")], [_trial()], JOINTS) == []
