"""Of several effects that are added at once the one that is refused takes no other one with it."""

from __future__ import annotations

from pathlib import Path

import pytest

from stopset.offline.campaign.source import campaign_of
from stopset.offline.description import load_robot
from stopset.offline.identify.pipeline import Settings, identified
from stopset.offline.revise.revise import add

ELBOW = "quadratic_load:elbow_joint"


@pytest.mark.shared
def test_a_law_that_is_refused_refuses_no_other(shared_data) -> None:  # type: ignore[no-untyped-def]
    """R-1513: of a UR10e with a load all that was named was refused, the load too, for one law of the elbow whose own the model keeps."""
    folder: Path = shared_data("ur10e")
    robot = load_robot(folder / "robot.urdf")
    campaign = campaign_of(robot, [folder / "payload_b.parquet"])
    model = identified(robot, campaign, Settings()).model
    done = add(model, ["payload", ELBOW], campaign)
    why = {j.name: j.why for j in done.judged}
    assert why["payload"] == "" and "the model has load_coulomb:elbow_joint there already" in why[ELBOW]
    assert done.model is not None and not done.helps
    labels = {f.label for f in done.model.effects}
    assert "payload" in labels and "load_coulomb:elbow_joint" in labels and ELBOW not in labels
    assert done.after["sum_U_width"] <= done.before["sum_U_width"]
