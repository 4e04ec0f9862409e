"""Every effect has its page, and what the pages show was measured of all of them."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from skincal.effects import EFFECTS

PAGES = Path(__file__).parents[2] / "docs" / "effects"


RESULT = Path(__file__).parents[2] / "benchmarks" / "results" / "effects_seen.json"


def test_pages_show_every_effect():
    sessions = json.loads(RESULT.read_text("utf-8"))["sessions"]
    assert set(sessions) == {"paper_static", "paper_with_frames", "full"}
    for session in sessions.values():
        assert list(session["effects"]) == list(EFFECTS)
        for name, one in session["effects"].items():
            assert one["visible"] != bool(one["reason"])
            assert one["consistent_with"][0] == name


def test_the_index_lists_every_page():
    listed = re.search(
        r"```\{toctree\}\n:hidden:\n\n(.*?)\n```", (PAGES / "index.md").read_text("utf-8"), re.S
    )
    assert sorted(listed[1].split()) == sorted(EFFECTS)


@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_has_a_page_that_says_what_it_is_confused_with(name: str):
    page = (PAGES / f"{name}.md").read_text("utf-8")
    for directive in ("effect", "signature", "seen"):
        assert f"```{{{directive}}} {name}\n```" in page
    for heading in ("What identifies it", "What it is confused with"):
        text = page.partition(f"## {heading}\n")[2].partition("\n##")[0]
        assert len(text.split()) > 6
    others = set(re.findall(r"`([a-z_]+)`", page)) & set(EFFECTS)
    assert others - {name}, "no effect that it is confused with"
