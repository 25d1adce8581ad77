"""Rubbish that is led by what it covers, for one parser of the monitor: ``python benchmarks/monitor_fuzz_guided.py "db3" [--seconds 45]``.

Needs atheris (``pip install atheris``). The parsers and what they are fed with first are those of `monitor_fuzz`; half of the changes are
its own, half the fuzzer's. Prints every foreign exception once, with the input that did it, and goes on.
"""

from __future__ import annotations

import argparse
import logging
import os
import random
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import atheris

sys.path.insert(0, str(Path(__file__).resolve().parent))
with atheris.instrument_imports(include=["stopset", "tomllib", "configparser", "canopen", "mcap"]):
    import monitor_fuzz

from stopset.errors import StopsetError

LONGEST = 200_000  # bytes of an input


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parser", help="a name of monitor_fuzz, such as MCAP")
    parser.add_argument("--seconds", type=float, default=45.0)
    args = parser.parse_args()
    logging.disable()
    folder = Path(tempfile.mkdtemp())
    seeds, parse = monitor_fuzz.good_inputs(folder)[args.parser], monitor_fuzz.parsers(folder)[args.parser]
    (folder / "corpus").mkdir()
    for k, seed in enumerate(seeds):
        (folder / "corpus" / str(k)).write_bytes(seed)
    found, end = Counter[str](), time.monotonic() + args.seconds

    def one(data: bytes) -> None:
        kind = "taken"
        try:
            parse(data)
        except StopsetError:
            kind = "refused"
        except Exception as e:  # noqa: BLE001 - what is looked for
            kind = f"FOREIGN {type(e).__name__}"
            if kind not in found:
                print(f"{args.parser}: {kind}: {str(e)[:120]}  by  {data[:120]!r}", flush=True)
        found[kind] += 1
        if time.monotonic() > end:
            print(f"{args.parser}: {sum(found.values())} inputs: {dict(found)}", flush=True)
            os._exit(int(any("FOREIGN" in k for k in found)))

    def change(data: bytes, most: int, seed: int) -> bytes:
        rng = random.Random(seed)
        if rng.random() < 0.5:
            return monitor_fuzz.spoilt(rng, [data, *seeds])[:most]
        return bytes(atheris.Mutate(data, most))

    words = [sys.argv[0], str(folder / "corpus"), f"-max_len={LONGEST}", "-rss_limit_mb=0", "-timeout=60", "-verbosity=0"]
    atheris.Setup(words, one, custom_mutator=change)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
