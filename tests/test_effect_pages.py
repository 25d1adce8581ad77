"""The pages in docs/effects are what the effects say now."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

from stopset.effects.registry import catalogue

ROOT = Path(__file__).parents[1]
PAGES = ROOT / "docs" / "effects"
LARGEST = 15_000  # bytes of a figure
ZERO = 94.0  # height of the zero line in a figure [px]


@pytest.fixture(scope="module")
def built() -> dict[str, str]:
    spec = importlib.util.spec_from_file_location("effect_pages", ROOT / "benchmarks" / "effect_pages.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    files: dict[str, str] = module.build()
    return files


def test_the_pages_are_up_to_date(built: dict[str, str]) -> None:
    assert {p.name for p in PAGES.iterdir()} == set(built)
    stale = [f for f, text in built.items() if f.endswith(".md") and (PAGES / f).read_text(encoding="utf-8") != text]
    assert not stale, f"{stale} differ from the effects; run python benchmarks/effect_pages.py"


@pytest.mark.parametrize("name", [n for n, e in catalogue().items() if e.law.__module__.startswith("stopset.")])
def test_every_effect_has_a_page_with_two_small_figures(name: str) -> None:
    text = (PAGES / f"{name}.md").read_text(encoding="utf-8")
    for figure in (f"{name}-curve.svg", f"{name}-residuals.svg"):
        drawn = (PAGES / figure).read_bytes()
        assert figure in text and len(drawn) < LARGEST and b"nan" not in drawn
        line = drawn.split(b'<path d="')[2].split(b'"')[0]
        heights = [float(part.split()[1].removesuffix(b"h0")) for part in line.strip(b"M").replace(b"M", b"L").split(b"L")]
        assert max(abs(h - ZERO) for h in heights) > 5, f"{figure}: the effect was drawn with value zero"
