"""The page of the documentation that lists every verb is made of the program itself."""

import importlib.util
from pathlib import Path

import pytest
import typer

from skincal.cli.main import app

SOURCE = Path(__file__).parents[2] / "docs" / "_ext" / "verbs.py"


@pytest.mark.skipif(not SOURCE.exists(), reason="the documentation's source is not here")
def test_every_verb_on_the_page_has_its_examples():
    pytest.importorskip("sphinx")
    spec = importlib.util.spec_from_file_location("reference_of_verbs", SOURCE)
    assert spec is not None and spec.loader is not None
    page = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(page)
    listed = list(page.verbs(typer.main.get_command(app)))
    assert len(listed) > 10
    for name, command in listed:
        assert any(line.startswith("$ skincal ") for line in page.described(name, command)), name
