# %% [markdown]
# # 1. A model from recordings, and what it predicts
#
# An arm of three joints is simulated here in place of a real one; everything after the first cell is the same for recordings of yours.

# %%
from pathlib import Path

from stopset.offline.description import load_robot
from stopset.recording import read_recordings, write_recordings
from stopset.simulation import prepare

cell = prepare(load_robot("arm.urdf"), hide=["none"], seed=1, plan="short")
write_recordings("healthy.parquet", cell.meta, cell.recordings())
Path("robot.urdf").write_text(cell.robot.urdf)
Path("robot.json").write_text(cell.datasheet)  # what a data sheet says of brakes

# %% [markdown]
# Identified are nominal dynamics, and sets of torques and of measurement errors just large enough that every recording is enclosed.

# %%
from stopset.artifact import save_model
from stopset.offline.identify.pipeline import identify

robot = load_robot("robot.urdf")
model = save_model(identify(robot, ["healthy.parquet"]).model, "arm.model.json")
for joint, lo, hi in zip(model.joints, model.powered.U.lo, model.powered.U.hi, strict=True):
    print(f"{joint}: the torque that the model does not know lies in [{lo:.2f}, {hi:.2f}] N m")

# %% [markdown]
# The tube is all that can be measured at a later time. Each line is a recording, minus what its own torques predict from its first sample.

# %%
import matplotlib.pyplot as plt
import numpy as np

from stopset.reach.flowpipe import deviation_tube
from stopset.reach.predict import predict

tube = deviation_tube(model.abstraction, model.powered)
trials = [r for r in read_recordings("healthy.parquet", robot) if r.phase == "open_loop"]
steps = min(len(tube.ages), *(len(r.t) for r in trials))
inside = True
figure, panels = plt.subplots(1, model.n, figsize=(10, 3), layout="constrained")
for k, (axes, joint) in enumerate(zip(panels, model.joints, strict=True)):
    axes.fill_between(tube.ages[:steps], tube.lo[:steps, k], tube.hi[:steps, k], color="#c9d3dc", label="predicted set")
    for r in trials:
        u = model.input(r.q, r.dq, r.tau, r.temp, 0.0, r.t)[:steps]
        x = predict(model.abstraction, model.powered.dt, np.concatenate([r.q[0], r.dq[0]]), u)
        error = r.q[:steps, k] - x[:, k]
        inside &= bool(np.all((tube.lo[:steps, k] <= error) & (error <= tube.hi[:steps, k])))
        axes.plot(tube.ages[:steps], error, color="#b3261e", linewidth=0.8)
    axes.set(title=joint, xlabel="s ahead", ylabel="rad" if k == 0 else "")
figure.savefig("1-identify.svg")
print("every recording is inside the set that was predicted for it:", inside)
