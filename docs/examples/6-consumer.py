# %% [markdown]
# # 6. Reading the monitor's messages, and what must not be believed
#
# A consumer beside a PLC, without a bus: messages are packed here, one fault each is made, and the consumer says what it sees. A real monitor's
# messages arrive under `<site>/<cell>/<arm>/stopset/state`.

# %%
from stopset.monitor.consumer import MS, SAYS, Consumer, Expected, Fault
from stopset.monitor.layout import State
from stopset.monitor.packer import Packer

SECOND = 1000 * MS
pack = Packer().pack
wall = 1_800_000_000 * SECOND  # the daemon's clock when the consumer's says 0: they need not agree


def message(seq: int, now: int, nonce: int, **wrong: int) -> bytes:
    good = {"data_id": 1001, "boot_id": 7, "seq": seq, "state": int(State.OK), "valid_for_ms": 100, "nonces": (nonce, 0),
            "t_meas_ns": wall + now - 10 * MS, "t_pub_ns": wall + now, "model_hash": 1, "config_hash": 2}  # fmt: skip
    return pack(good | wrong)


# %% [markdown]
# Six seconds at 50 messages a second. In each second but the first something goes wrong for half of it.

# %%
consumer = Consumer(Expected(data_id=1001, model_hash=1, config_hash=2, keys=None), 200 * MS)
faults = {1: "damaged", 2: "another arm's", 3: "repeated", 4: "silent", 5: "old data"}
nonce, seen, last = 0, [], b""
for tick in range(6 * 50):
    now, second, half = tick * 20 * MS, tick // 50, (tick % 50) < 25
    asked = consumer.challenge(now, 1000 + tick)
    nonce = 1000 + tick if asked else nonce
    wrong = faults.get(second, "") if half else ""
    data = message(tick + 1, now, nonce, **({"data_id": 1002} if wrong == "another arm's" else {}),
                   **({"t_meas_ns": wall + now - SECOND} if wrong == "old data" else {}))  # fmt: skip
    if wrong == "damaged":
        data = data[:40] + bytes([data[40] ^ 1]) + data[41:]
    if wrong == "repeated":
        data = last
    refused = Fault.NONE if wrong == "silent" else consumer.take(data, now + MS)
    last = last if wrong == "repeated" else data
    seen.append((now / SECOND, consumer.state(now + 2 * MS), SAYS[refused] or SAYS[consumer.why], wrong))
for wrong in ("", *faults.values()):
    print(f"{wrong or 'nothing wrong'}:", *sorted({why or "believed" for _, _, why, w in seen if w == wrong}), sep="\n    ")

# %%
import matplotlib.pyplot as plt

figure, axes = plt.subplots(figsize=(9, 2.2), layout="constrained")
for second, wrong in faults.items():
    axes.axvspan(second, second + 0.5, color="#f3d7d5")
    axes.text(second + 0.02, 0.5, wrong, fontsize="small")
axes.step([t for t, *_ in seen], [int(state is State.OK) for _, state, *_ in seen], where="post", color="#1f4e79")
axes.set_yticks([0, 1], ["FAULT", "OK"])
axes.set(xlabel="s", title="what the consumer believes")
figure.savefig("6-consumer.svg")
