# %% [markdown]
# # 3. Something changes: does the model still hold?
#
# The same arm later. A spring that nobody told of pulls at one joint.

# %%
from stopset.artifact import load_model
from stopset.offline.compare.compare import compare
from stopset.offline.compare.verdict import verdict
from stopset.offline.description import load_robot
from stopset.recording import write_recordings
from stopset.simulation import prepare

cell = prepare(load_robot("arm.urdf"), hide=["spring:bend"], seed=1, plan="short")
write_recordings("altered.parquet", cell.meta, cell.recordings())
model = load_model("arm.model.json")
before, after = compare(model, ["healthy.parquet"]), compare(model, ["altered.parquet"])
for found in (before, after):
    print(verdict(found).text, end="\n\n")

# %%
import matplotlib.pyplot as plt
import numpy as np

figure, axes = plt.subplots(figsize=(6, 3.2), layout="constrained")
place = np.arange(model.n)
for shift, found, label in ((-0.2, before, "healthy"), (0.2, after, "altered")):
    axes.bar(place + shift, [found.figures[j]["torque_rmse"] for j in model.joints], 0.4, label=label)
axes.set_xticks(place, model.joints)
axes.set(ylabel="torque error [N m]", title="what the model lacks, RMS")
axes.legend()
figure.savefig("3-compare.svg")
