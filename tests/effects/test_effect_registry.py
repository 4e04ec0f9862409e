"""The registry: effects that come along, and those of other packages."""

from __future__ import annotations

import subprocess
import sys
from importlib import invalidate_caches
from pathlib import Path

import numpy as np
import pytest
from effects.effect_sessions import BASE, FINGER, contacts_at

from skincal.effects import EFFECTS, Effect, EffectSkin, Samples, effect
from skincal.effects.registry import GROUP, Registry
from skincal.errors import InputError
from skincal.model import Sphere

MODULE = '''
from skincal.effects import EffectParameter, SignalEffect, Stage, start


class Inversion(SignalEffect):
    """Values are less by a part of their square."""

    name = "{name}"
    stage = Stage.CONVERTER
    meaning = "large values read too small"
    parameters = (EffectParameter("part_per_count", "1/counts", 0.0, 0.0, 0.01, "of the square", typical=1e-3),)
    asks = ("forces",)
    source = "made for tests"

    def starts(self, scene):
        return (start({{"part_per_count": 0.1 / scene.top_counts}}),)

    def apply(self, signal, samples, values, setting):
        return signal - values.number("part_per_count") * signal**2


class NoEffect:
    def __repr__(self):
        raise OSError


class Nameless(Inversion):
    name = None


class Exits(Inversion):
    def __init__(self):
        raise SystemExit(0)


class Textless(Inversion):
    def __init__(self):
        class TextlessError(Exception):
            def __str__(self):
                raise OSError

        raise TextlessError
'''


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Installs a package with an entry point into a folder of the path."""

    def install(target: str = "lab_effects:Inversion", name: str = "inversion") -> Path:
        (tmp_path / "lab_effects.py").write_text(MODULE.format(name=name), encoding="utf-8")
        info = tmp_path / "lab_effects-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text("Metadata-Version: 2.1\nName: lab-effects\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(f"[{GROUP}]\ninversion = {target}\n")
        invalidate_caches()
        return tmp_path

    monkeypatch.syspath_prepend(str(tmp_path))
    yield install
    sys.modules.pop("lab_effects", None)


def test_a_lab_adds_an_effect_of_its_own(lab):
    lab()
    found = Registry()
    assert set(found) == set(EFFECTS) | {"inversion"}
    stages = [one.stage for one in found.values()]
    assert stages == sorted(stages)
    assert isinstance(found["inversion"], Effect)


def test_an_added_effect_is_in_the_chain(lab, monkeypatch: pytest.MonkeyPatch):
    lab()
    monkeypatch.setattr(EFFECTS, "_effects", Registry()._effects)
    samples = Samples.of(contacts_at([0.0, 1e-3], [0.0, 0.0], [2.0, 3.0]), Sphere(0.006), press=[0, 1])
    plain = BASE.values(samples)
    skin = EffectSkin.of(BASE.skin, FINGER, {"inversion": {"part_per_count": 1e-3}})
    np.testing.assert_allclose(skin.values(samples), plain - 1e-3 * plain**2)
    assert effect("inversion").at_strength(2.0, np.random.default_rng(0), BASE.skin.patch.layout)


@pytest.mark.parametrize(
    ("target", "name", "words"),
    [
        ("lab_effects:NoEffect", "inversion", "a subclass of skincal.effects.Effect"),
        ("lab_effects:Nameless", "inversion", "with its name and stage"),
        ("lab_effects:Exits", "inversion", "got SystemExit: 0"),
        ("lab_effects:Textless", "inversion", "TextlessError: an error whose text cannot be read"),
        ("lab_effects:Missing", "inversion", "AttributeError"),
        ("lab_effects:Inversion", "creep", 'a second effect named "creep"'),
    ],
)
def test_a_broken_entry_point_says_which_package(lab, target: str, name: str, words: str):
    lab(target, name)
    with pytest.raises(InputError) as told:
        len(Registry())
    assert words in str(told.value)
    assert "entry point inversion in skincal.effects of package lab-effects" in str(told.value)


def test_the_command_line_knows_it(lab):
    """A process of its own: the module of the package imports skincal.effects while the registry loads."""
    code = f"import sys; sys.path.insert(0, {str(lab())!r}); from skincal.calibration.parts import EFFECT_NAMES as n"
    done = subprocess.run(
        [sys.executable, "-c", f"{code}; print(n['inversion'])"], capture_output=True, text=True, check=False
    )
    assert done.stdout.strip() == "large values read too small", done.stderr


def test_no_other_module_quotes_the_name_of_an_effect():
    """Examples of commands and codes of findings apart: what a module needs to know, the effect declares."""
    package = Path(__file__).parents[2] / "skincal"
    allowed = {
        ("cli/demo.py", "hysteresis"),  # what the demo hides
        ("cli/collect.py", "hysteresis"),  # an example
        ("fitting/fit_findings.py", "dead_taxel"),  # the code of a finding of the fit
        ("calibration/parts.py", "dead_taxel"),
    }
    plain = {"shear", "rate", "spread", "cover"}  # a covariate, and words
    found = set()
    for file in package.rglob("*.py"):
        place = file.relative_to(package).as_posix()
        if place.startswith("effects/"):
            continue
        text = file.read_text(encoding="utf-8")
        found |= {
            (place, n)
            for n in set(EFFECTS) - plain
            if f'"{n}"' in text or f'"{n}=' in text or f" {n}=" in text
        }
    assert found <= allowed, found - allowed
