"""A little rubbish for every parser at every run; the benchmark gives them a million inputs each."""

from __future__ import annotations

import logging
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))

import monitor_fuzz

MEMORY, FILES = 1500, 60


@pytest.mark.parametrize("seed", [0])
def test_rubbish_is_refused_with_a_declared_error(seed: int, tmp_path: Path) -> None:
    seeds = monitor_fuzz.good_inputs(tmp_path)
    logging.disable()
    try:
        for name, parse in monitor_fuzz.parsers(tmp_path).items():
            parse(seeds[name][0])  # the good one is taken
            inputs = (
                FILES if seeds[name][0] and name in ("MCAP", "BLF", "EDS", "ASC", "TRC", "candump", "db3", "model") else MEMORY
            )
            found = monitor_fuzz.fuzz(name, parse, seeds[name], inputs, seed)
            assert not [kind for kind in found if "FOREIGN" in kind], (name, found)
            assert inputs == FILES or found["taken"], f"{name}: some changes do no harm"
    finally:
        logging.disable(logging.NOTSET)
