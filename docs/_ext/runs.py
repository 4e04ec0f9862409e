"""Directives that run what they show: commands of a shell, lines of Python, and the pictures they leave behind.

All runs of a page share one temporary folder, in which ``data`` is the project's. A run with an exit status other
than the one that is expected ends the build.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import ClassVar

from docutils import nodes
from docutils.parsers.rst import directives
from docutils.parsers.rst.directives.images import Figure
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.errors import ExtensionError
from sphinx.util.docutils import SphinxDirective

ROOT = Path(__file__).parent.parent.parent
MADE = Path("_build", "made")
TIMEOUT_S = 300
COLUMNS = 92

# Made before the build splits into processes, which would leave their own behind.
_all = tempfile.TemporaryDirectory(prefix="skincal-docs-")


def _folder(docname: str) -> Path:
    return Path(_all.name, docname.replace("/", "-"))


def folder(docname: str) -> Path:
    """The temporary folder of a page."""
    own = _folder(docname)
    if not own.exists():
        own.mkdir()
        (own / "data").symlink_to(ROOT / "data")
    return own


def run(command: list[str], docname: str, status: int) -> str:
    """What a command writes to standard output and standard error, in the page's folder."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = os.environ | {"PATH": path, "COLUMNS": str(COLUMNS), "TERM": "dumb", "NO_COLOR": "1"}
    done = subprocess.run(
        command,
        cwd=folder(docname),
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        stdin=subprocess.DEVNULL,
        text=True,
        timeout=TIMEOUT_S,
        check=False,
    )
    if done.returncode != status:
        raise ExtensionError(
            f"{docname}: expected exit status {status} of {' '.join(command)}; got {done.returncode}:\n{done.stdout}"
        )
    return "\n".join(
        line.rstrip() for line in done.stdout.replace(folder(docname).as_posix() + "/", "").splitlines()
    )


class Console(SphinxDirective):
    """``{console}``: runs each line in a shell and shows the commands with what they print."""

    has_content = True
    option_spec: ClassVar = {"status": int, "quiet": directives.flag, "lines": int}

    def run(self) -> list[nodes.Node]:
        """The session as a literal block; ``lines`` shortens what each command prints."""
        shown = []
        for line in self.content:
            shown.append(f"$ {line}")
            if not self.config.runs_enabled or not line.strip():
                continue
            text = run(
                ["bash", "-o", "pipefail", "-c", line], self.env.docname, self.options.get("status", 0)
            ).splitlines()
            most = self.options.get("lines", len(text))
            shown += [] if "quiet" in self.options else text[:most] + ["…"] * (len(text) > most)
        block = nodes.literal_block("\n".join(shown), "\n".join(shown), language="console")
        return [block]


class Python(SphinxDirective):
    """``{run-python}``: runs lines of Python and shows them with what they print."""

    has_content = True

    def run(self) -> list[nodes.Node]:
        """The code, and below it what it printed."""
        code = "\n".join(self.content)
        found: list[nodes.Node] = [nodes.literal_block(code, code, language="python")]
        if self.config.runs_enabled:
            text = run([sys.executable, "-c", code], self.env.docname, 0)
            found += [nodes.literal_block(text, text, language="text")] if text else []
        return found


class Made(Figure):
    """``{made}``: a picture that the page's commands have made, as a figure; the content is its caption."""

    def run(self) -> list[nodes.Node]:
        """The figure; its file is copied from the page's folder."""
        document = self.state.document
        env: BuildEnvironment = document.settings.env
        if not env.config.runs_enabled:
            return []
        made = folder(env.docname) / self.arguments[0]
        if not made.is_file():
            raise ExtensionError(
                f"{env.docname}: expected the picture {self.arguments[0]}; no command made it"
            )
        kept = MADE / env.docname.replace("/", "-") / made.name
        (Path(env.srcdir) / kept).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(made, Path(env.srcdir) / kept)
        self.arguments[0] = "/" + kept.as_posix()
        return super().run()


def forget(_app: Sphinx, _env: BuildEnvironment, docname: str) -> None:
    """A page that is read again starts with an empty folder."""
    shutil.rmtree(_folder(docname), ignore_errors=True)


def clean(_app: Sphinx, _error: Exception | None) -> None:
    """Removes the folders."""
    _all.cleanup()


def setup(app: Sphinx) -> dict[str, bool]:
    """Registers the directives."""
    app.add_config_value("runs_enabled", True, "env")
    app.add_directive("console", Console)
    app.add_directive("run-python", Python)
    app.add_directive("made", Made)
    app.connect("env-purge-doc", forget)
    app.connect("build-finished", clean)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
