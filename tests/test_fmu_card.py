"""The unit's model card says what its bounds hold for, and on what they rest."""

from __future__ import annotations

import io
import zipfile
from dataclasses import replace
from html.parser import HTMLParser
from typing import Any

import pytest

from fmu_models import arm_model
from stopset.artifact import Model
from stopset.fmu import Contents
from stopset.fmu.export import archive
from stopset.fmu.stops import bounds_of
from stopset.reach.stops.ramp import KEY, ramp_of
from stopset.reach.stops.words import ramp_assumptions
from test_fmu_stops import braked, ramped

pytest.importorskip("fmpy")


class Page(HTMLParser):
    """Its texts, and the tags that are open at its end."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.texts: list[str] = []
        self.open: list[str] = []
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: Any) -> None:
        if tag != "meta":
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.texts.append(data)


def page_of(model: Model) -> Page:
    with zipfile.ZipFile(io.BytesIO(archive(model, Contents(3, source_only=True, reference=False)))) as z:
        return Page(z.read("documentation/index.html").decode())


def test_the_card_names_domain_assumptions_and_kinds_of_stop() -> None:
    model = braked(8.0, 3)
    model = replace(model, provenance={**model.provenance, KEY: ramped(3).as_dict()})
    page, setting, ramp = page_of(model), bounds_of(model).setting, ramp_of(model)
    assert setting is not None and ramp is not None
    assert not page.open
    assert not any("e-3" in x for x in setting.assumptions), "what rounding makes of zero is zero in words"
    assert set(setting.assumptions) <= set(page.texts) and any(x.startswith("brakes (") for x in page.texts)
    for kind in ("1", "1 guaranteed", "2"):
        assert set(ramp_assumptions(ramp, kind)) <= set(page.texts)
    assert {
        "A STOP 0:",
        "A STOP 1 whose ramp may fail:",
        "-3 to 3",
        "15 to 55",
        "Payload 0 to 2 kg on top of what the model's last link holds.",
    } <= set(page.texts)


def test_the_card_says_why_no_stop_is_bounded_and_takes_a_name_for_a_name() -> None:
    model = arm_model(2)
    page = page_of(replace(model, robot=replace(model.robot, name="<b>arm & arm")))
    assert "<b>arm & arm" in page.texts and not page.open
    assert any(x.startswith("No stop is bounded: ") and "brakes" in x for x in page.texts)
