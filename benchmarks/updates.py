"""How far an update lies from identifying from all recordings, by what was kept: signals or sums.

    python benchmarks/updates.py ROBOT RECORDING

The recording is cut in two, once by repetition (even, odd trials) and once by suite (first, second half); a model is
identified from the first part and updated with the second, and held against the model of both.
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

from stopset.artifact import Model, model_text, save_model
from stopset.offline.description import load_robot
from stopset.offline.identify.pipeline import Keep, identify
from stopset.offline.update.update import load_state, save_state, update
from stopset.robot import Robot

KINDS: tuple[Keep, ...] = ("sums", "signals")


def body(model: Model) -> dict[str, object]:
    """The model file but its history."""
    return {k: x for k, x in json.loads(model_text(model)).items() if k not in ("sha256", "revisions")}


def updated(robot: Robot, old: Path, new: Path, how: Keep, folder: Path) -> tuple[Model, float]:
    """The model of ``old`` with ``new`` added, and the state's size [kB]."""
    found = identify(robot, [old], keep=how)
    model, state = save_model(found.model, folder / "m.json"), folder / "m.state"
    assert found.retained is not None
    save_state(state, found.retained, model)
    return update(model, load_state(state, model), [new]).model, state.stat().st_size / 1e3


def row(name: str, model: Model, whole: Model, size: float) -> str:
    own, all_ = (np.diag(np.linalg.inv(m.abstraction.Minv)) for m in (model, whole))
    same = "yes" if body(model) == body(whole) else "no"
    return (
        f"| {name} | {size:.0f} | {np.max(np.abs(own / all_ - 1.0)):.1%} | "
        f"{model.powered.U.width.sum():.2f} | {whole.powered.U.width.sum():.2f} | {same} |"
    )


def main() -> None:
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    robot, table = load_robot(sys.argv[1]), pq.read_table(sys.argv[2])
    suite, trial = table["suite"].to_numpy(), table["trial"].to_numpy()
    print("| cut, kept | state [kB] | inertia off by at most | sum of U widths [N m] | of all recordings | same file |")
    print("|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for cut, first in (("even, odd trials", trial % 2 == 0), ("half of the suites", suite < np.median(np.unique(suite)))):
            old, new = folder / "old.parquet", folder / "new.parquet"
            pq.write_table(table.filter(first), old)
            pq.write_table(table.filter(~first), new)
            whole = identify(robot, [old, new]).model
            for how in KINDS:
                model, size = updated(robot, old, new, how, folder)
                print(row(f"{cut}, {how}", model, whole, size), flush=True)


if __name__ == "__main__":
    main()
