"""The command line as tests run it, in this process."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from skincal.cli.main import main

Run = Callable[..., tuple[int, str, str]]


def run(*arguments: object) -> int:
    """Runs a command; returns its exit status."""
    with pytest.raises(SystemExit) as ended:
        main([*map(str, arguments)])
    return int(ended.value.code or 0)


def captured(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    """Runs a command; returns its exit status, standard output and standard error."""
    status = run(*arguments)
    out, err = capsys.readouterr()
    return status, out, err
