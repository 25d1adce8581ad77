# %% [markdown]
# # 5. A stop table: speed, extension, load
#
# The shape of ISO 10218-1: each axis alone, at a third, two thirds and all of its speed. The model is that of example 4; its few recordings
# have not seen the poses that a table asks for, so nothing is certified there: what is beyond them is computed on request, and marked.

# %%
from stopset.artifact import load_model
from stopset.offline.stops.table import Question, stop_table
from stopset.reach.stops.start import Extrapolation

model = load_model("arm2.model.json")
table = stop_table(model, Question(categories=("0",), extrapolate=Extrapolation(state=True)))
for kind in ("certified", "extrapolated", "answered"):
    print(f"{kind}: {sum(bool(getattr(row, kind)) for row in table.rows)} of {len(table.rows)} rows")
print("the first that is not certified:", next(row.extrapolated or row.why for row in table.rows if not row.certified))

# %%
import matplotlib.pyplot as plt

figure, panels = plt.subplots(1, model.n, figsize=(10, 3), layout="constrained", sharey=True)
for axes, joint in zip(panels, model.joints, strict=True):
    for extension in sorted({row.extension_percent for row in table.rows}):
        rows = [r for r in table.rows if r.joint == joint and r.extension_percent == extension and r.answered]
        worst = {r.speed_percent: max(x.far_m for x in rows if x.speed_percent == r.speed_percent) for r in rows}
        axes.plot(sorted(worst), [1e3 * worst[s] for s in sorted(worst)], marker="o", label=f"{extension:.0f} % extension")
    axes.set(title=joint, xlabel="speed [%]", ylabel="distance [mm]" if joint == model.joints[0] else "")
panels[0].legend(fontsize="small")
figure.savefig("5-table.svg")
