"""What is installed by default: locked versions that fit pyproject.toml, each with its hashes."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[1]
pytestmark = pytest.mark.skipif(not (ROOT / "locks").is_dir(), reason="only in a checkout")
ON = {"python_version": "3.11", "sys_platform": "linux"}


def required(extra: str) -> list[Requirement]:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    listed = project["dependencies"] + project["optional-dependencies"][extra]
    found = [Requirement(text) for text in listed]
    inner = [name for one in found if one.name == "skincal" for name in one.extras]
    return [one for one in found if one.name != "skincal"] + [one for name in inner for one in required(name)]


def locked(name: str) -> dict[str, str]:
    """Version by name, of entries that have a hash."""
    entries = re.split(r"\n(?=\w)", (ROOT / "locks" / f"{name}.txt").read_text())
    entries = [entry for entry in entries if not entry.startswith("#") or "==" in entry]
    assert all("--hash=sha256:" in entry for entry in entries)
    pins = (re.search(r"^([\w.-]+)(?:\[.*?\])?==([^\s;+]+)", entry, re.MULTILINE) for entry in entries)
    return {canonicalize_name(pin[1]): pin[2] for pin in pins if pin}


@pytest.mark.parametrize("extra", ["policy", "test", "lint", "docs"])
def test_the_lock_fits_the_requirements(extra: str) -> None:
    pins = locked(extra) | locked("torch")
    for one in required(extra):
        if one.marker is None or one.marker.evaluate(ON):
            assert one.specifier.contains(pins[canonicalize_name(one.name)]), one
    if extra in ("policy", "test"):
        unreleased = [
            name for name, pin in pins.items() if "nightly" in name or re.search(r"(a|b|rc|dev)\d", pin)
        ]
        assert not unreleased
