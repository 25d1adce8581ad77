# %% [markdown]
# # 2. How far the arm goes when its power is cut
#
# The model of example 1, and the stops among its recordings: each is bounded from the state in which it was asked for.

# %%
import numpy as np

from stopset.artifact import load_model
from stopset.offline.description import load_robot
from stopset.reach.stops import stop
from stopset.recording import read_recordings

model, robot = load_model("arm.model.json"), load_robot("robot.urdf")
found = []
for r in read_recordings("healthy.parquet", robot):
    if r.phase != "stop0":
        continue
    cut = r.stop_requested
    bound = stop(model, r.q[cut], r.dq[cut], "0")
    went = r.q[cut:] - r.q[cut]
    if bound.forward is None:
        print(f"{r.label}: no number, {bound.why}")
        continue
    for k in range(model.n):
        found += [(went[:, k].max(), bound.forward[k]), (-went[:, k].min(), bound.back[k])]
measured, bounded = np.rad2deg(np.array(found).T)
print(f"{len(measured)} directions of recorded stops; {np.sum(measured > bounded)} go beyond their bound")

# %% [markdown]
# Over speed, all joints at once, from the middle of the identified poses. Numbers are upper bounds; one that cannot be proved is none.

# %%
speeds = np.linspace(0.1, 0.9, 9)
bounds = [stop(model, model.domain.q.centre, s * model.domain.dq.hi, "0") for s in speeds]
for s, bound in zip(speeds, bounds, strict=True):
    time_ms, angle_deg = (None, None) if bound.time is None else (bound.time.max() * 1e3, np.rad2deg(bound.forward).max())
    # a bound is rounded up
    print(f"{100 * s:3.0f} % speed:", bound.why or f"{np.ceil(time_ms):.0f} ms, {np.ceil(100 * angle_deg) / 100:.2f} deg")

# %%
import matplotlib.pyplot as plt

figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.4), layout="constrained")
left.plot([0, bounded.max()], [0, bounded.max()], color="#888", linewidth=0.8)
left.scatter(bounded, measured, color="#b3261e", s=10)
left.set(xlabel="bound [deg]", ylabel="recorded [deg]", title="recorded stops lie below the line")
for k, joint in enumerate(model.joints):
    right.plot(100 * speeds, [np.nan if b.forward is None else np.rad2deg(b.forward[k]) for b in bounds], marker="o", label=joint)
right.set(xlabel="speed [%]", ylabel="angle [deg]", title="bound of a STOP 0 over speed")
right.legend()
figure.savefig("2-stop.svg")
