"""Time and memory of `stopset identify` on the paper's recordings: under 30 s and 1 GiB is wanted.

python benchmarks/identify_schunk.py [../shared/data/schunk_lwa4p/open_loop.parquet]
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

LIMIT_S, LIMIT_KIB = 30.0, 1024 * 1024


def main() -> int:
    data = Path(sys.argv[1] if len(sys.argv) > 1 else Path(__file__).parents[2] / "shared/data/schunk_lwa4p/open_loop.parquet")
    if not data.exists():
        print(f"{data} is not on this machine; name the recording")
        return 2
    worst = 0
    for options in ([], ["--conform", "all", "--windows", "start", "--margin", "1"]):
        with tempfile.TemporaryDirectory() as folder:
            command = ["identify", "--robot", "lwa4p", "--data", str(data), "--out", f"{folder}/m.json", *options]
            start = time.monotonic()
            child = subprocess.Popen([sys.executable, "-m", "stopset.cli.main", *command], stdout=subprocess.PIPE, text=True)
            assert child.stdout is not None
            text = child.stdout.read()
            _, status, usage = os.wait4(child.pid, 0)
            took = time.monotonic() - start
        widths = next(line for line in text.splitlines() if line.startswith("sum of U widths"))
        print(f"{' '.join(options) or 'defaults'}: {took:.1f} s, {usage.ru_maxrss / 1024:.0f} MiB; {widths.split('(')[0]}")
        worst |= status != 0 or took > LIMIT_S or usage.ru_maxrss > LIMIT_KIB
    return int(worst)


if __name__ == "__main__":
    sys.exit(main())
