"""Files of foreign formats are read in the process of the tests, which starts no other one for each."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from skincal.imports import bag_source, source_table


def read_here(read: Callable[..., Any], path: Path, *arguments: Any) -> Any:
    """Read as ``apart`` does, and send what it sends."""
    read, path, arguments = pickle.loads(pickle.dumps((read, path, arguments)))
    return pickle.loads(pickle.dumps(read(path, *arguments)))


@pytest.fixture
def in_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """For tests of what is read; ``test_apart.py`` tests the other process."""
    for module in (bag_source, source_table):
        monkeypatch.setattr(module, "apart", read_here)
