# %% [markdown]
# # 4. What is missing, and does adding it help?

# %%
from stopset.artifact import load_model, save_model
from stopset.offline.campaign.source import campaign_of
from stopset.offline.diagnose import diagnose_model
from stopset.offline.revise.revise import add
from stopset.recording import read_recordings

model = load_model("arm.model.json")
robot = model.robot.as_described
diagnosis, measured_against = diagnose_model(model, read_recordings("altered.parquet", robot))
print(diagnosis.verdict, measured_against)
for r in diagnosis.ranked:
    print(f"{r.effect} at {', '.join(r.joints)}: held-out error {r.error_before:.2f} -> {r.error_after:.2f} {r.unit}")

# %% [markdown]
# Added, everything is identified anew; kept is what lowers the error on recordings that were held out.

# %%
named = [f"{r.effect}:{'+'.join(r.joints)}" for r in diagnosis.ranked]
revised = add(model, named, campaign_of(robot, ["altered.parquet"]))
for j in revised.judged:
    print(f"{j.name}: {'helps' if j.helps else 'refused'} {j.why}".rstrip())
if revised.model is not None:
    save_model(revised.model, "arm2.model.json")

# %%
import matplotlib.pyplot as plt

shown = {"held_out_torque_rmse": "torque error, held out [N m]", "held_out_position_rmse": "position error, held out [rad]",
         "sum_U_width": "width of the torque sets [N m]"}  # fmt: skip
figure, panels = plt.subplots(1, len(shown), figsize=(9, 3), layout="constrained")
for axes, key in zip(panels, shown, strict=True):
    axes.bar(["before", "after"], [revised.before[key], revised.after[key]], color=["#b3261e", "#2e7d4f"])
    axes.set_title(shown[key], fontsize="medium")
figure.savefig("4-diagnose.svg")
