"""The command line as tests run it, in this process."""

from __future__ import annotations

import io
import json
import os
import select
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import typer.main

from skincal.cli.main import app, main

Run = Callable[..., tuple[int, str, str]]
RunJson = Callable[..., dict[str, Any]]


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


@contextmanager
def served(*options: str, folder: Path | None = None) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """Serve a hand in a process of its own; yield it and its address."""
    command = "serve-hand", *options, "--bind", "tcp://127.0.0.1:*", "--json"
    line, pipe = [sys.executable, "-m", "skincal", *command], subprocess.PIPE
    with subprocess.Popen(line, cwd=folder, stdout=pipe, stderr=pipe, text=True) as process:
        try:
            assert process.stdout is not None
            yield process, json.loads(process.stdout.readline())["address"]
        finally:
            process.kill()


class Fork:
    """A verb in a fork of this process, which has most modules already; it is used like ``subprocess.Popen``."""

    def __init__(self, folder: Path, arguments: list[str]) -> None:
        self.returncode: int | None = None
        typer.main.get_command(app)  # built here, and not in every fork
        self._err, err_end = os.pipe()
        self.pid = os.fork()
        if self.pid:
            os.close(err_end)
            return
        status = 70
        try:
            os.setsid()  # a signal to suspend that comes after the last word would leave it waiting for a shell
            os.chdir(folder)
            os.dup2(err_end, 2)
            os.close(err_end)
            sys.stderr, sys.stdout = os.fdopen(2, "w", buffering=1), io.StringIO()
            main(arguments)
        except SystemExit as ended:
            status = ended.code if isinstance(ended.code, int) else 0
        finally:
            sys.stderr.flush()
            os._exit(status)

    def poll(self, options: int = os.WNOHANG) -> int | None:
        if self.returncode is None and (found := os.waitpid(self.pid, options))[0]:
            self.returncode = os.waitstatus_to_exitcode(found[1])
        return self.returncode

    def send_signal(self, number: int) -> None:
        if self.poll() is None:
            os.kill(self.pid, number)

    def communicate(self, timeout: float) -> tuple[str, str]:
        """Return what it wrote, of which standard output is not kept, when it has ended.

        Raises:
            TimeoutExpired: it has not ended in time.
        """
        deadline, said = time.monotonic() + timeout, b""
        while select.select([self._err], [], [], max(0.0, deadline - time.monotonic()))[0]:
            if not (part := os.read(self._err, 1 << 16)):
                os.close(self._err)
                self.poll(0)
                return "", said.decode()
            said += part
        os.kill(self.pid, 9)
        raise subprocess.TimeoutExpired("skincal", timeout)
