"""Consumers believe only what a living daemon of the right arm says now; the one in C does what the one in Python does."""

from __future__ import annotations

import ctypes
import hmac
import random
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from allocation_counter import COUNTER
from float32 import outward
from monitor_process import compiled, environment
from state_messages import pack
from stopset.monitor.authentication import Key, KeyFileError, Keys, load_keys
from stopset.monitor.consumer import CHALLENGE_EVERY, MS, PROOF_LIFE, Consumer, Expected, Fault
from stopset.monitor.layout import LENGTH, State, unpack

KEY = Key(3, bytes(range(32)))
EXPECTED = Expected(7, 0xAA, 0xBB, Keys.of(KEY))
AHEAD = 10**15  # [ns] how far the daemon's clock is from the consumer's: they need not know
WATCHDOG = 50 * MS


def message(now: int, seq: int, *, key: Key | None = KEY, age: int = 5 * MS, **more: Any) -> bytes:
    """What the daemon makes at ``now`` of the consumer's clock."""
    values = {
        "data_id": 7, "model_hash": 0xAA, "config_hash": 0xBB, "boot_id": 1, "seq": seq, "state": int(State.OK), "valid_for_ms": 30,
        "t_pub_ns": now + AHEAD, "t_meas_ns": now + AHEAD - age, **more,
    }  # fmt: skip
    return pack(values, key)


def proven(now: int = 1000 * MS) -> Consumer:
    """A consumer that has heard the answer to its challenge at ``now``, as message 10, 1 ms after asking."""
    c = Consumer(EXPECTED, WATCHDOG)
    nonce = c.challenge(now - MS, 0x1234)
    assert nonce is not None
    assert c.take(message(now, 10, nonces=(0, 0x1234)), now) is Fault.NONE
    return c


T = 1000 * MS


def test_a_good_message_is_believed_as_long_as_its_data_are_valid() -> None:
    c = proven()
    assert c.state(T) is State.OK
    assert c.state(T + 23 * MS) is State.OK, "5 ms old when it came, and up to 1 ms underway"
    assert c.state(T + 26 * MS) is State.FAULT and c.why is Fault.STALE
    assert c.state(T + 51 * MS) is State.FAULT and c.why is Fault.SILENT


FAULTS: dict[str, tuple[Callable[[bytes], bytes], Fault]] = {
    "corruption": (lambda d: d[:100] + bytes([d[100] ^ 4]) + d[101:], Fault.UNREADABLE),
    "a bit of the code": (lambda d: d[:600] + bytes([d[600] ^ 1]) + d[601:], Fault.UNREADABLE),
    "cut": (lambda d: d[:-1], Fault.UNREADABLE),
    "nothing": (lambda d: b"", Fault.UNREADABLE),
    "repetition": (lambda d: message(T + MS, 10), Fault.REPEATED),
    "incorrect sequence": (lambda d: message(T + MS, 9), Fault.REPEATED),
    "insertion": (lambda d: message(T + MS, 500, boot_id=2), Fault.UNPROVEN),
    "insertion of another life with the answer": (lambda d: message(T + MS, 5, boot_id=2, nonces=(0x1234,)), Fault.UNPROVEN),
    "addressing": (lambda d: message(T + MS, 11, data_id=8), Fault.FOREIGN),
    "masquerade without key": (lambda d: message(T + MS, 11, key=None), Fault.FORGED),
    "masquerade with another key": (lambda d: message(T + MS, 11, key=Key(3, bytes(32))), Fault.FORGED),
    "masquerade with an unknown key": (lambda d: message(T + MS, 11, key=Key(4, KEY.secret)), Fault.FORGED),
    "another model": (lambda d: message(T + MS, 11, model_hash=1), Fault.OTHER_MODEL),
    "another configuration": (lambda d: message(T + MS, 11, config_hash=1), Fault.OTHER_CONFIG),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_of_the_way_are_found(fault: str) -> None:
    """The eight of IEC 61784-3 (loss and delay below), each counted as silence."""
    spoil, refusal = FAULTS[fault]
    c = proven()
    before = c.arrived
    assert c.take(spoil(message(T + MS, 11)), T + MS) is refusal
    assert c.refused[refusal] == 1 and c.arrived == before
    assert c.take(message(T + 2 * MS, 11), T + 2 * MS) is Fault.NONE, "and the good ones go on"


def test_loss_is_counted_and_delay_is_stale() -> None:
    c = proven()
    c.take(message(T + 4 * MS, 14), T + 4 * MS)
    assert c.lost == 3
    c.take(message(T + 5 * MS, 15), T + 45 * MS)  # underway for 40 ms
    assert c.state(T + 45 * MS) is State.FAULT and c.why is Fault.STALE
    hour = 3_600_000 * MS
    late = Consumer(EXPECTED, WATCHDOG)
    for k in range(100):  # yesterday's stream, in its rhythm: nobody answers
        late.challenge(T + hour + 10 * k * MS, 50 + k)
        late.take(message(T + 10 * k * MS, k), T + hour + 10 * k * MS)
        assert late.state(T + hour + 10 * k * MS) is State.FAULT
    assert late.why is Fault.UNPROVEN


def test_a_restarted_daemon_is_believed_when_it_answers_and_the_old_one_is_gone() -> None:
    c = proven()
    later = T + 60 * MS
    assert c.take(message(later, 0, boot_id=2), later) is Fault.UNPROVEN
    assert c.challenge(T + CHALLENGE_EVERY, 99) is not None
    at = T + CHALLENGE_EVERY + 2 * MS
    assert c.take(message(at, 20, boot_id=2, nonces=(99,)), at) is Fault.NONE and c.state(at) is State.OK
    assert c.take(message(at, 11), at + MS) is Fault.UNPROVEN, "the life before has ended"


def test_two_monitors_of_one_data_id_are_not_believed_but_a_recorded_one_beside_is_nobody() -> None:
    """Two arms that were given the same configuration: nobody can tell which of them an OK is of."""
    c = proven()
    assert c.take(message(T + MS, 400, boot_id=2, nonces=(0x99,)), T + MS) is Fault.UNPROVEN and c.state(T + MS) is State.OK
    assert c.take(message(T + 2 * MS, 5, boot_id=2, nonces=(0x1234,)), T + 2 * MS) is Fault.UNPROVEN
    c.take(message(T + 3 * MS, 11), T + 3 * MS)
    assert c.state(T + 3 * MS) is State.FAULT and c.why is Fault.UNPROVEN
    nonce = c.challenge(T + CHALLENGE_EVERY, 77)
    assert nonce is not None
    both, last = [(1, 12), (2, 6)], T + CHALLENGE_EVERY + 10 * MS
    for boot, seq in both[::-1]:  # the other answers first
        c.take(message(last, seq, boot_id=boot, nonces=(77,)), last)
        assert c.state(last) is State.FAULT
    for k in range(1, 200):  # it was switched off
        at = last + 10 * k * MS
        if c.challenge(at, 100 + k) is not None:
            asked = 100 + k
        c.take(message(at, 12 + k, nonces=(asked,) if k > 25 else ()), at)
        assert (c.state(at) is State.OK) == (at - last > PROOF_LIFE), k


def test_proof_of_life_runs_out() -> None:
    c = proven()
    for k in range(1, 150):
        now = T + 10 * k * MS
        c.take(message(now, 10 + k), now)
        assert (c.state(now) is State.OK) == (now - T <= PROOF_LIFE), k
    assert c.why is Fault.UNPROVEN


@pytest.mark.parametrize(
    ("jump", "refusal"), [(3600, Fault.UNPROVEN), (0.2, Fault.UNPROVEN), (-3600, Fault.STALE), (-0.2, Fault.STALE)]
)
def test_a_clock_that_was_set_is_no_fresh_data(jump: float, refusal: Fault) -> None:
    """The daemon's clock jumps by ``jump`` [s]; what it stamps is not believed until it has answered anew."""
    c, by = proven(), int(jump * 1e9)
    now = T + 10 * MS
    c.take(message(now, 11, t_pub_ns=now + AHEAD + by, t_meas_ns=now + AHEAD + by - 5 * MS), now)
    assert c.state(now) is State.FAULT and c.why is refusal
    asked = T + CHALLENGE_EVERY
    assert c.challenge(asked, 77) is not None
    at = asked + 2 * MS
    c.take(message(at, 12, t_pub_ns=at + AHEAD + by, t_meas_ns=at + AHEAD + by - 5 * MS, nonces=(77,)), at)
    assert c.state(at) is State.OK


def test_a_clock_set_by_less_than_messages_are_under_way_makes_no_old_data_young() -> None:
    """Nothing in a message shows it: none is stamped later than now. The daemon says that its clock was set by not being OK."""
    c, jump = proven(), 20 * MS
    now = T + 4 * MS
    c.take(message(now, 11), now)
    for seq, state in ((12, State.UNKNOWN), (13, State.OK)):  # each 28 ms under way, with data that were 5 ms old
        made, now = now, now + 28 * MS
        stamps = {"t_pub_ns": made + AHEAD + jump, "t_meas_ns": made + AHEAD + jump - 5 * MS}
        assert c.take(message(made, seq, state=int(state), **stamps), now) is Fault.NONE
    assert c.state(now) is State.FAULT and c.why is Fault.UNPROVEN
    made = T + CHALLENGE_EVERY
    assert c.challenge(made, 77) is not None
    now = made + 28 * MS
    c.take(message(made, 14, t_pub_ns=made + AHEAD + jump, t_meas_ns=made + AHEAD + jump - 5 * MS, nonces=(77,)), now)
    assert c.state(now) is State.FAULT and c.why is Fault.STALE, "33 ms old, not 13"


def test_after_a_silence_it_is_asked_anew() -> None:
    """What the daemon has said of its clock may be among the messages that were lost."""
    c = proven()
    now = T + WATCHDOG + MS
    c.take(message(now, 60), now)
    assert c.state(now) is State.FAULT and c.why is Fault.UNPROVEN
    assert c.challenge(T + CHALLENGE_EVERY, 77) is not None
    c.take(message(T + CHALLENGE_EVERY, 100, nonces=(77,)), T + CHALLENGE_EVERY)
    assert c.state(T + CHALLENGE_EVERY) is State.OK


def test_the_clocks_may_drift() -> None:
    """100 ppm apart for a minute: never a doubt, and never younger than true."""
    c, rng = proven(), random.Random(1)
    seq = 10
    nonce = 0
    for k in range(1, 3000):
        now = T + 20 * k * MS
        if (asked := c.challenge(now, k)) is not None:
            nonce = int.from_bytes(asked, "little")
        underway = rng.randrange(200_000)
        seq += 1
        made = now + AHEAD + (now - T) // 10_000
        c.take(message(now, seq, t_pub_ns=made, t_meas_ns=made - 5 * MS, nonces=(nonce,)), now + underway)
        assert c.state(now + underway) is State.OK
        assert c._hi + c._drift(now) >= AHEAD + (now - T) // 10_000


LINUX_PPM = 500  # by which it lets a clock be faster or slower, to bring it nearer


@pytest.mark.parametrize("ppm", [2 * LINUX_PPM, -2 * LINUX_PPM])
def test_clocks_at_the_limit_of_their_drift_make_no_data_younger(ppm: int) -> None:
    """Both clocks are being brought nearer to the time, one faster, one slower. While an answer is under way they part too: data were younger
    than true by that, 10 us at 20 ms."""
    c, rng, nonce, last = proven(), random.Random(2), 0, T
    for k in range(1, 3000):
        now = T + 20 * k * MS
        if (asked := c.challenge(now, k)) is not None:
            nonce = int.from_bytes(asked, "little")
        made = now + AHEAD + (now - T) * ppm // 1_000_000
        last = max(last, now + rng.randrange(20 * MS))
        c.take(message(now, 10 + k, t_pub_ns=made, t_meas_ns=made - 5 * MS, nonces=(nonce,)), last)
        ahead = AHEAD + (last - T) * ppm // 1_000_000
        assert c._lo - c._drift(last) <= ahead <= c._hi + c._drift(last)


def test_every_state_but_ok_and_degraded_passes_and_nonsense_is_fault() -> None:
    for code in range(256):
        c = proven()
        c.take(message(T + MS, 11, state=code), T + MS)
        said = c.state(T + 40 * MS)
        if code in (State.OK, State.DEGRADED):
            assert said is State.FAULT and c.why is Fault.STALE
        elif code in [s for s in State if s is not State.NEVER_SENT]:
            assert said is State(code)
        else:
            assert said is State.FAULT and c.why is Fault.NO_SUCH_STATE


def test_a_consumers_clock_goes_on_while_the_machine_sleeps() -> None:
    """Messages that waited in a socket for a machine to wake would be as young as when it fell asleep."""
    if shutil.which("unshare") is None or not hasattr(time, "CLOCK_BOOTTIME"):
        pytest.skip("needs Linux' time namespaces")
    slept = ["unshare", "--time", "--boottime", "3600", "--fork"]
    ask = "import time\nfrom stopset.monitor.clock import own_ns\nprint(own_ns() - time.monotonic_ns())"
    done = subprocess.run([*slept, sys.executable, "-c", ask], env=environment(), capture_output=True, text=True)
    if done.returncode:
        pytest.skip(f"no time namespace may be made here: {done.stderr}")
    assert int(done.stdout) > 3590 * 10**9


# ---- keys -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [1, 20, 32, 64, 65])
def test_a_code_is_that_of_hmac_whatever_was_signed_before(size: int) -> None:
    """The key is taken in once: no message may leave a trace in it."""
    key, rng = Key(1, bytes(range(size))), random.Random(size)
    for _ in range(50):
        data = rng.randbytes(rng.randrange(700))
        assert key.code(memoryview(data)) == hmac.digest(key.secret, data, "sha256")[:16]


def test_keys_change_without_a_gap(tmp_path: Path) -> None:
    """RFC 4231's second case says that it is HMAC-SHA256; the order of a rotation is that of the guide."""
    code = Key(1, b"Jefe").code(b"what do ya want for nothing?")
    assert code.hex() == "5bdcc146bf60754e6a042426089575c7"
    path = tmp_path / "arm.keys"
    path.write_text(f"2 {'22' * 32}  # new\n3 {KEY.secret.hex()}\n")
    path.chmod(0o600)
    both = load_keys(path)
    assert both.first.key_id == 2 and "22" not in repr(both.first)
    c = Consumer(Expected(7, 0xAA, 0xBB, both), WATCHDOG)
    c.challenge(T, 5)
    assert c.take(message(T, 1, nonces=(5,)), T) is Fault.NONE
    assert c.take(message(T + MS, 2, key=both.first), T + MS) is Fault.NONE


@pytest.mark.parametrize(
    ("text", "mode", "word"),
    [
        ("", 0o600, "holds 0 keys"),
        ("1 abc", 0o600, "line 1"),
        (f"0 {'11' * 32}", 0o600, "line 1"),
        (f"1 {'zz' * 32}", 0o600, "line 1"),
        (f"1 {'11' * 32}\n1 {'22' * 32}", 0o600, "different numbers"),
        (f"99999999999999999999 {'11' * 32}", 0o600, "line 1"),
        (f"1 {'11' * 32}", 0o644, "mode 644"),
    ],
)
def test_bad_key_files_get_one_sentence(text: str, mode: int, word: str, tmp_path: Path) -> None:
    path = tmp_path / "k"
    path.write_text(text)
    path.chmod(mode)
    with pytest.raises(KeyFileError, match=word):
        load_keys(path)


# ---- the same in C --------------------------------------------------------------------------------------------------

GLUE = """
#include "stopset_consumer.h"
static stopset_key key;
static stopset_consumer c;
void start(const uint8_t *secret) {
  memset(&c, 0, sizeof c);
  key.key_id = 3;
  memcpy(key.secret, secret, 32);
  c.expect = (stopset_expected){7, 0xAA, 0xBB, &key, 1, 50000000};
}
uint64_t challenge(int64_t now, uint64_t random) { return stopset_challenge(&c, now, random); }
int take(const uint8_t *data, size_t n, int64_t now) { return stopset_take(&c, data, n, now); }
int state(int64_t now) { return stopset_now(&c, now); }
int why(void) { return c.why; }
uint64_t lost(void) { return c.lost; }
float tcp(void) { return c.last.stop0_tcp; }
"""


@pytest.fixture(scope="module")
def twin(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    folder = tmp_path_factory.mktemp("c")
    (folder / "glue.c").write_text(GLUE)
    library = ctypes.CDLL(str(compiled(folder, folder / "glue.c", words=("-shared", "-fPIC"))))
    library.challenge.restype = library.lost.restype = ctypes.c_uint64
    library.tcp.restype = ctypes.c_float
    library.challenge.argtypes = [ctypes.c_int64, ctypes.c_uint64]
    library.take.argtypes = [ctypes.c_char_p, ctypes.c_size_t, ctypes.c_int64]
    library.state.argtypes = [ctypes.c_int64]
    return library


def test_c_reads_the_numbers(twin: ctypes.CDLL) -> None:
    twin.start(KEY.secret)
    assert twin.challenge(T, 5) == 5
    data = message(T, 1, nonces=(5,), stop0_tcp=0.0123)
    assert twin.take(data, LENGTH, T) == 0 and twin.state(T) == State.OK
    assert np.float32(twin.tcp()) == outward(0.0123, "up") and unpack(data)["key_id"] == 3


@settings(max_examples=150, deadline=None)
@given(st.integers(0, 2**32), st.integers(1, 60))
def test_c_and_python_agree_on_every_step(twin: ctypes.CDLL, seed: int, steps: int) -> None:
    """Random lives of a consumer: messages good, spoilt, late, repeated, of other lives, clocks that jump."""
    rng = random.Random(seed)
    c, now, seq, jump, boot, nonce = Consumer(EXPECTED, WATCHDOG), T, 0, 0, 1, 0
    twin.start(KEY.secret)
    for _ in range(steps):
        now += rng.choice([MS, 4 * MS, 10 * MS, 60 * MS, 300 * MS])
        fresh = rng.getrandbits(64)
        asked = c.challenge(now, fresh)
        assert twin.challenge(now, fresh) == (int.from_bytes(asked, "little") if asked else 0)
        nonce = int.from_bytes(asked, "little") if asked else nonce
        if rng.random() < 0.05:
            jump += rng.choice([-3600, -1, 1, 3600]) * 10**9
        if rng.random() < 0.05:
            boot, seq = boot + 1, 0
        seq += rng.choice([1, 1, 1, 1, 0, 2, -1, 2**31])
        stamp = now + AHEAD + jump - rng.choice([0, MS, 40 * MS])
        data = message(
            now, seq & 0xFFFFFFFF, key=rng.choice([KEY] * 8 + [None, Key(3, bytes(32))]), boot_id=rng.choice([boot] * 9 + [99]), t_pub_ns=stamp,
            t_meas_ns=stamp - rng.choice([5, 20, 35]) * MS, nonces=(nonce,) if rng.random() < 0.8 else (),
            state=rng.choice([State.OK] * 5 + [State.DEGRADED, State.VIOLATION, 0x2A, 0]), data_id=rng.choice([7] * 9 + [8]),
            model_hash=rng.choice([0xAA] * 9 + [1]), config_hash=rng.choice([0xBB] * 9 + [1]),
        )  # fmt: skip
        if rng.random() < 0.1:
            at = rng.randrange(LENGTH)
            data = data[:at] + bytes([data[at] ^ (1 << rng.randrange(8))]) + data[at + 1 :]
        data = data[: rng.choice([LENGTH] * 20 + [LENGTH - 1, 0])]
        arrived = now + rng.choice([0, 100_000, 30 * MS])
        assert twin.take(data, len(data), arrived) == c.take(data, arrived)
        look = arrived + rng.choice([0, 10 * MS, 60 * MS])
        assert (twin.state(look), twin.why(), twin.lost()) == (c.state(look), c.why, c.lost)


def test_who_speaks_otherwise_than_is_expected_is_told_as_that() -> None:
    """A monitor whose configuration was edited beneath it: "no answer to my challenge", or silence, sent nobody to the right place."""
    c = Consumer(EXPECTED, WATCHDOG)
    c.take(message(T, 1, config_hash=1), T)
    assert c.state(T) is State.FAULT and c.why is Fault.OTHER_CONFIG
    assert c.state(T + 51 * MS) is State.FAULT and c.why is Fault.NO_MESSAGE
    c = proven()
    c.take(message(T + 60 * MS, 11, model_hash=1), T + 60 * MS)
    assert c.state(T + 61 * MS) is State.FAULT and c.why is Fault.OTHER_MODEL
    assert c.state(T + 120 * MS) is State.FAULT and c.why is Fault.SILENT


CODES = """
import ctypes
from stopset.monitor.authentication import Key
from stopset.monitor.layout import LENGTH
key, data, taken = Key(1, bytes(32)), bytearray(LENGTH - 20), ctypes.CDLL(None).allocations_of_this_thread
for _ in range(100):
    key.code(data)
before = taken()
for _ in range(1000):
    key.code(data)
print(taken() - before)
"""


def test_a_code_takes_no_memory_of_the_system(tmp_path: Path) -> None:
    """It took 15 pieces for every message."""
    source = tmp_path / "counter.c"
    source.write_text(COUNTER)
    counter = compiled(tmp_path, source, words=("-shared", "-fPIC", "-ftls-model=initial-exec"))
    out = subprocess.run(
        [sys.executable, "-c", CODES],
        env={**environment(), "LD_PRELOAD": str(counter)},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    assert int(out.stdout) < 100
