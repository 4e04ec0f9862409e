"""Closes the environments of a test."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from making import made


@pytest.fixture(autouse=True)
def closed() -> Iterator[None]:
    yield
    while made:
        made.pop().close()
