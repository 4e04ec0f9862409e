"""The template of the documentation is a driver that keeps the contract, found as a person would name it."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.remote_cost import Clock
from skincal.hand.contract import ContractOptions
from skincal.hand.contract_checks import run_contract
from skincal.hand.registry import create_driver, driver_options

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture(autouse=True)
def in_docs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(DOCS))


def test_the_template_keeps_the_contract(monkeypatch: pytest.MonkeyPatch) -> None:
    import my_hand

    clock = Clock()
    monkeypatch.setattr(my_hand, "time", clock)
    options = ContractOptions(clock=clock.monotonic)
    report = run_contract("my_hand", lambda: create_driver("my_hand:MyHand", rate_hz="100"), options)
    assert [(r.name, r.got) for r in report.results if r.status != "passed"] == []


def test_its_options_have_help() -> None:
    assert all(option.text for option in driver_options("my_hand:MyHand"))
    assert create_driver("my_hand:MyHand", rate_hz="250").period_s == 0.004


def test_the_page_shows_it() -> None:
    page = (DOCS / "own_hand.md").read_text(encoding="utf-8")
    assert "```{literalinclude} my_hand.py" in page
