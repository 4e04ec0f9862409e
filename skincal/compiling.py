"""Whom to tell that the skin model is being compiled: the command line sets it, the model calls it."""

from __future__ import annotations

from collections.abc import Callable

on_compile: Callable[[], None] | None = None
"""Called once in a process before something is compiled, which takes seconds; not where the cache has it."""

NOTE = "skincal: compiling the skin model or the fit, once on this machine (about 15 s)"
