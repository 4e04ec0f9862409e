"""Collects the verbs, and turns errors into a few lines and an exit status."""

from __future__ import annotations

import errno
import io
import logging
import os
import sys
from collections.abc import Sequence
from typing import Annotated, Any

import typer

from skincal import compiling
from skincal.cli import verbs
from skincal.cli.common import example, say
from skincal.cli.interrupt import interruptible
from skincal.errors import SkincalError
from skincal.version import __version__

app = typer.Typer(
    name="skincal",
    help="Calibrate the simulation of a tactile skin against the real one, and know how far to trust it.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    # Plain help: boxes and colours take as long to import as all the rest of it.
    rich_markup_mode=None,
    epilog=example("skincal fit data/paper-like --out cal"),
)


def _version(value: bool) -> None:
    if value:
        typer.echo(f"skincal {__version__}")
        raise typer.Exit()


USAGE_ERROR: Any = typer.BadParameter.__bases__[0]
"""A wrong command line. Newer versions of typer carry their own copy of click, so click's class is not it."""


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")] = False,
) -> None:
    """Options that stand before the verb."""


verbs.register(app)


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs the command line and exits: 0 done, 1 the work failed, 2 the input is wrong, 130 interrupted."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    if "OMP_NUM_THREADS" not in os.environ:
        # Several threads of linear algebra round otherwise than the one that worker processes have: results would
        # depend on which process they came from. It counts as long as nothing has imported numpy.
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Worker processes look for modules where they are installed, not first in the folder that somebody works in.
    os.environ.setdefault("PYTHONSAFEPATH", "1")
    debug = "--debug" in arguments
    # `--debug` is taken wherever it stands, so that it can be added at the end of a command that failed.
    arguments = [a for a in arguments if a != "--debug"]
    _write_any_text()
    logging.getLogger("skincal").handlers[:] = [_Said()]
    compiling.on_compile = lambda: say(compiling.NOTE)
    try:
        with interruptible():
            status = app(args=arguments, prog_name="skincal", standalone_mode=False)
        if status == 130:  # what typer makes of Ctrl-C; a verb that has said more about it raises SystemExit
            say("skincal: interrupted")
    except typer.Abort:
        status = 130
    except USAGE_ERROR as error:
        error.show()
        status = 2
    except (SkincalError, OSError) as error:
        if debug:
            raise
        status = _report(error)
    except UnicodeEncodeError as error:  # names of files are all that may hold bytes that are no text
        if debug:
            raise
        say(
            f"skincal: error: {error.object}: expected names of files and folders in UTF-8; got other bytes. "
            "Rename it."
        )
        status = 2
    except KeyboardInterrupt:
        if debug:
            raise
        say("skincal: interrupted")
        status = 130
    except MemoryError:
        say("skincal: error: out of memory; use a coarser grid or fewer presses")
        status = 1
    except Exception as error:
        if debug:
            raise
        say(
            f"skincal: internal error: {type(error).__name__}: {error}\n"
            "This is a fault of skincal, not of yours. Run again with --debug to see where, and report it."
        )
        status = 1
    sys.exit(status if isinstance(status, int) else 0)


class _Said(logging.Handler):
    """Says what the library logs."""

    def emit(self, record: logging.LogRecord) -> None:
        say(f"skincal: {record.getMessage()}")


def _write_any_text() -> None:
    """A letter that the terminal cannot show is written as its number; it is no reason to fail."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


MOST_LINES = 12
"""Lines of an error that are shown, for a file with a mistake in every line; a verb that checks shows all."""

_NO_ROOM = {
    errno.ENOSPC: " Free some space and run again; nothing was left half-written.",
    errno.EDQUOT: " Free some space and run again; nothing was left half-written.",
    errno.EFBIG: " Raise the limit on the size of files (ulimit -f); nothing was left half-written.",
}


def _report(error: SkincalError | OSError) -> int:
    if isinstance(error, SkincalError):
        lines = str(error).splitlines()
        if len(lines) > MOST_LINES:
            more = f"… and {len(lines) - MOST_LINES + 1} more; --debug shows all of them"
            lines[MOST_LINES - 1 :] = [more]
        say("skincal: error: " + "\n".join(lines))
        return error.exit_status
    if isinstance(error, BrokenPipeError):
        # The reader (head, less) went away; nothing more can be written, not even at interpreter exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    place = error.filename or "a file"
    reason = error.strerror or str(error)
    hint = "" if error.errno is None else _NO_ROOM.get(error.errno, "")
    say(f"skincal: error: {place}: {reason}.{hint}")
    return 1


if __name__ == "__main__":
    main()
