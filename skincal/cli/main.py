"""The entry point: the verbs in the order of the work, and errors as a few lines and an exit status."""

from __future__ import annotations

import atexit
import errno
import io
import logging
import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

import typer

from skincal import progress
from skincal.cli import (
    audit,
    collect,
    dataset,
    demo,
    deploy,
    diagnose,
    export_dr,
    fit,
    hand,
    imports,
    predict,
    rescale,
    train,
)
from skincal.cli import eval as evaluation
from skincal.cli.interrupt import Ended, interruptible, is_interrupt
from skincal.cli.options import example
from skincal.cli.terminal import json_alone, say
from skincal.errors import SkincalError, input_error, quoted, text_of
from skincal.version import __version__

app = typer.Typer(
    name="skincal",
    help="Calibrate the simulation of a tactile skin against the real one, and know how far to trust it.",
    no_args_is_help=True,
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
"""The class of a usage error. Newer versions of typer carry their own copy of click, so click's class is not it."""


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")] = False,
) -> None:
    """Accept the options that stand before the verb."""
    _refuse_settings_here()


def _refuse_settings_here() -> None:
    """Refuse to run where numba's settings lie: they say where it loads compiled code from, and may come with data."""
    file = Path(".numba_config.yaml")
    try:
        here = Path.cwd()
        found = file.exists()
    except FileNotFoundError:
        fix = "Change to another."
        raise input_error("the working folder", "one that exists", "a removed one", fix) from None
    except PermissionError:  # nobody can load anything from it
        return
    if found:
        fix = "Remove it, or run from another folder."
        got = f"{file}, from which numba takes where compiled code is loaded from"
        raise input_error(str(here), "a working folder without settings of numba", got, fix)


# A verb imports what it needs when it runs, so that help is fast.
app.add_typer(dataset.app, name="dataset")
app.add_typer(imports.app, name="import")
app.add_typer(hand.app, name="hand")
# Typer would cut a line made of a docstring in the list of verbs.
for verb, function, epilog, line in (
    ("collect", collect.collect, collect.EPILOG, "Press the skin with the hand's own indenter."),
    ("fit", fit.fit, fit.EPILOG, "Fit pose, elasticity and scale to the presses of a dataset."),
    ("predict", predict.predict, predict.EPILOG, "Write a dataset as a calibration predicts it."),
    ("audit", audit.audit, audit.EPILOG, "Show which effects presses can reveal, and how weak."),
    ("diagnose", diagnose.diagnose, diagnose.EPILOG, "Find what the model lacks, name it and add it."),
    ("export-dr", export_dr.export_dr, export_dr.EPILOG, "Write the ranges to train a policy over."),
    ("train", train.train, train.EPILOG, "Train a policy with soft actor-critic."),
    ("eval", evaluation.evaluate, evaluation.EPILOG, "Compare policies, evaluated as published."),
    ("deploy", deploy.deploy, deploy.EPILOG, "Run a policy on a hand, through its driver."),
    ("rescale", rescale.rescale, rescale.EPILOG, "Find how much sensitivity a skin has lost by wear."),
    ("serve-hand", hand.serve_hand, hand.SERVE_EPILOG, "Serve a hand to another computer or program."),
    ("demo", demo.demo, demo.EPILOG, "Show the main job on a simulated hand."),
):
    app.command(verb, epilog=epilog, short_help=line)(function)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and exit: 0 done, 1 the work failed, 2 the input is wrong, 130 interrupted."""
    _open_closed_streams()
    # What is written can be read and removed again: a umask may not take the owner's own rights.
    os.umask(os.umask(0o077) & 0o077)
    # Verbs only write figures: no other backend of Matplotlib, which may be missing or any module, is loaded.
    os.environ["MPLBACKEND"] = "agg"
    to_its_end = arguments is None
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    if "OMP_NUM_THREADS" not in os.environ:
        # Multi-threaded linear algebra rounds differently from the single thread of worker processes, so that results
        # would depend on the process. These variables take effect only before numpy is imported.
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Worker processes import the installed modules first, not those of the working folder.
    os.environ.setdefault("PYTHONSAFEPATH", "1")
    debug = "--debug" in arguments
    # `--debug` is accepted anywhere, so that it can be appended to a command that failed.
    arguments = [a for a in arguments if a != "--debug"]
    _write_any_text()
    logging.getLogger("skincal").handlers[:] = [_LogMessages()]
    progress.on_compile = lambda: say(progress.NOTE)
    try:
        with json_alone("--json" in arguments), interruptible():
            status = app(args=arguments, prog_name="skincal", standalone_mode=False)
        if status == 130:  # typer's status for Ctrl-C; a verb with more to say raises Ended
            say("skincal: interrupted")
    except typer.Abort:
        status = 130
    except USAGE_ERROR as error:
        error.message = error.message.replace("Value error, ", "")  # pydantic's word, which typer passes on
        error.show()
        status = 2
    except Ended:
        raise
    except (
        BaseException
    ) as error:  # SystemExit, CancelledError and others of a driver's library are no Exception
        if debug and not isinstance(error, MemoryError):
            raise
        status = _report(error)
    if to_its_end and "--json" in arguments:
        atexit.register(_hush)
    sys.exit(status if isinstance(status, int) else 0)


def _hush() -> None:
    """Keep what a driver or a library prints at the end of the process from standard output."""
    with suppress(OSError, ValueError):
        sys.stdout.flush()
        os.dup2(2, 1)


class _LogMessages(logging.Handler):
    """Handler that prints the library's log messages on standard error."""

    def emit(self, record: logging.LogRecord) -> None:
        say(f"skincal: {record.getMessage()}")


def _open_closed_streams() -> None:
    """Lead a standard stream that is closed nowhere: the next file that is opened would take its place."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            nowhere = os.open(os.devnull, os.O_RDWR)
            if nowhere != number:
                os.dup2(nowhere, number)
                os.close(nowhere)
            setattr(sys, name, os.fdopen(number, "w" if number else "r", encoding="utf-8", closefd=False))


def _write_any_text() -> None:
    """Escape characters that the terminal cannot show, instead of failing."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


MOST_LINES = 12
"""Most lines of an error that are shown; a file may have a mistake in every line. Checking verbs show all."""

_NO_ROOM = {
    errno.ENOSPC: " Free some space and run again; nothing was left half-written.",
    errno.EDQUOT: " Free some space and run again; nothing was left half-written.",
    errno.EFBIG: " Raise the limit on the size of files (ulimit -f); nothing was left half-written.",
}


def _lines(error: SkincalError) -> list[str]:
    """Return the lines of an error, which may be of a class of a driver's own that cannot be shown."""
    try:
        return str(error).splitlines() or [quoted(error)]
    except Exception:
        return [quoted(error)]


def _report(error: BaseException) -> int:
    """Print an error in a few lines; return the exit status."""
    match error:
        case SkincalError():
            lines = _lines(error)
            if len(lines) > MOST_LINES:
                lines[MOST_LINES - 1 :] = [
                    f"… and {len(lines) - MOST_LINES + 1} more; --debug shows all of them"
                ]
            say("skincal: error: " + "\n".join(lines))
            return error.exit_status
        case BrokenPipeError() | SystemExit(__context__=BrokenPipeError()):  # typer turns one into the other
            # The reader (head, less) is gone; nothing more can be written, not even at interpreter exit.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        case OSError():
            hint = "" if error.errno is None else _NO_ROOM.get(error.errno, "")
            say(f"skincal: error: {error.filename or 'a file'}: {error.strerror or str(error)}.{hint}")
        case UnicodeEncodeError():  # only file names can hold bytes that are not text
            expected = "expected names of files and folders in UTF-8; got other bytes. Rename it."
            say(f"skincal: error: {error.object}: {expected}")
            return 2
        case _ if is_interrupt(error):
            say("skincal: interrupted")
            return 130
        case ImportError() if not (error.name or "").startswith("skincal"):
            say(
                f"skincal: error: a library cannot be loaded: {text_of(error)}. Install skincal again; if it names "
                "memory or a segment, raise the limit on it (ulimit -v)."
            )
        case MemoryError():
            say("skincal: error: out of memory; use a coarser grid or fewer presses")
        case _:
            say(
                f"skincal: internal error: {quoted(error)}\n"
                "This is a bug in skincal, not your mistake. Run again with --debug to see where, and report it."
            )
    return 1


if __name__ == "__main__":
    main()
