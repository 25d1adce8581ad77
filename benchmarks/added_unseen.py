"""What the numbers of a diagnosis do to the torque error on motions not seen, without the sets: quick beside `real_robots.py`.

    python benchmarks/added_unseen.py FOLDER...

FOLDER: ``robot.urdf`` and recordings, divided as in `real_robots.py`.  The fitted part is identified and diagnosed; then its nominal model is
fitted again with the numbers of each effect that is named given, and of all together, and with those of each law that `identify` chose itself;
at joints of which these say nothing its laws stay, as with `add`.  A star: the model has it already, with these numbers.  No gate of `add`
is asked and no set identified.  Printed: error [N m] at the effect's joints and, summed, of the whole arm, on what was not fitted.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from real_robots import divided, ours

from stopset.artifact import Model
from stopset.effects.base import Fitted
from stopset.errors import StopsetError
from stopset.offline.abstraction.nominal_part import fit_nominal
from stopset.offline.campaign.run import Run
from stopset.offline.campaign.settings import Settings, settings_of
from stopset.offline.campaign.source import Campaign
from stopset.offline.campaign.survey import survey
from stopset.offline.description import load_robot
from stopset.offline.diagnose import diagnose_model
from stopset.offline.diagnose.as_added import retained_elsewhere
from stopset.offline.identify.pipeline import identified
from stopset.offline.nominal.low_pass import recorded_low_pass
from stopset.recording import Recording, Recordings, read_recordings


def fitted_again(model: Model, fit: Recordings, known: Sequence[Fitted]) -> Model:
    """``model`` with the nominal part of ``fit`` in which the numbers ``known`` are given."""
    robot, seen = model.robot.as_described, survey(lambda: iter(fit.trials))
    trials = tuple(r for r in fit.trials if r.suite_key not in seen.held_out)
    learnt = replace(seen, sample=tuple(r for r in seen.sample if r.suite_key not in seen.held_out))
    learnt = replace(learnt, low_pass=recorded_low_pass(robot, learnt.sample))
    chosen = tuple(model.provenance.get("chosen", ()))
    given = {f.label for f in known}
    new = [f for f in known if f.label not in chosen]
    around = retained_elsewhere(settings_of(model), [x for x in chosen if x not in given], new, robot)
    settings = replace(around, effects=tuple(f.label for f in known))
    part = fit_nominal(Run(robot, fit.meta, lambda: iter(trials), learnt, settings), tuple(known))
    return replace(model, robot=part.robot, rotor=part.rotor, effects=part.effects, abstraction=part.abstraction)


def asked(folder: Path) -> None:
    """One robot: every line as it is known."""
    robot = load_robot(folder / "robot.urdf")
    recordings = read_recordings(sorted(folder.glob("*.parquet")), robot)
    parts = divided(recordings)
    fit, test = (tuple(replace(r, suite=k, trial=0, phase="closed_loop") for k, r in enumerate(p)) for p in parts)
    data = replace(recordings, meta=replace(recordings.meta, joints=robot.joints), trials=fit)
    model = identified(robot, Campaign(data.meta, lambda: iter(data.trials)), Settings()).model
    found = diagnose_model(model, data)[0]
    named = [r.fitted for r in found.ranked]
    own = [f for f in model.effects if f.label in model.provenance.get("chosen", ())]
    before = fitted_again(model, data, ())
    print(f"{folder.name}: {found.verdict} {[f.label for f in named]}; all of {sum(ours(before, test)):.3f} N m", flush=True)
    has = {f.label for f in own}
    new = [f for f in named if f.label not in has]
    each = [(f"{f.label}{'*' * (f.label in has)}", [f]) for f in named]
    for name, known in [
        ("all that is named", named),
        ("all that the model has not", new),
        *each,
        *((f"own {f.label}", [f]) for f in own),
    ]:
        said(name, known, (before, fitted_again(model, data, known)), test)


def said(name: str, known: Sequence[Fitted], models: tuple[Model, Model], test: Sequence[Recording]) -> None:
    """The errors without and with what is ``known``."""
    joints = [j for j in models[0].joints if any(j in f.joints for f in known)] or list(models[0].joints)
    at = [models[0].joints.index(j) for j in joints]
    a, b = (ours(m, test) for m in models)
    there = ", ".join(f"{models[0].joints[k]} {a[k]:.3f} to {b[k]:.3f}" for k in at)
    print(f"  {name}: {there}; all {a.sum():.3f} to {b.sum():.3f}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="+")
    for folder in parser.parse_args().folder:
        try:
            asked(folder)
        except StopsetError as e:
            parser.error(str(e))


if __name__ == "__main__":
    main()
