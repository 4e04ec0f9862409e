"""The generator of the blind test: independent of skincal, physically sound, and readable by it."""

import ast
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from published import FINGER, LAYOUT

from benchmarks.blind import truth
from benchmarks.blind.__main__ import main
from benchmarks.blind.truth.body import draw_body, values
from benchmarks.blind.truth.catalogue import EFFECTS
from benchmarks.blind.truth.chain import counts, read, shown
from benchmarks.blind.truth.contact import SPACING_M, Foundation, Hardening, Layer
from benchmarks.blind.truth.decoys import DECOYS
from benchmarks.blind.truth.half_space import HalfSpace
from benchmarks.blind.truth.images import ContactKind, ImageStore
from benchmarks.blind.truth.outside import OUTSIDE
from benchmarks.blind.truth.protocol import make_plan
from benchmarks.blind.truth.rig import centres_m, on_finger
from benchmarks.blind.truth.session import make_session
from benchmarks.blind.truth.spec import Spec
from benchmarks.blind.truth.strength import Refit
from benchmarks.blind.truth.writing import press_columns, sealed, unsealed
from skincal.dataset import read_dataset
from skincal.effects import EFFECTS as CATALOGUE
from skincal.model import Contacts, Converter, Patch, SensorPose, Skin, SkinParameters, Sphere

FOLDER = Path(truth.__file__).parent
E_PA_PER_M = 3e8


def test_imports_nothing_of_skincal():
    for file in FOLDER.glob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not [name for name in names if name.split(".")[0] == "skincal"], file
    modules = [
        f"benchmarks.blind.truth.{file.stem}" for file in FOLDER.glob("*.py") if file.stem != "__init__"
    ]
    code = (
        f"import sys, {', '.join(modules)}; print([m for m in sys.modules if m.split('.')[0] == 'skincal'])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_has_every_effect_of_the_catalogue():
    assert set(EFFECTS) == set(CATALOGUE)


def test_foundation_agrees_with_skincals_contact():
    arc = np.array([1e-3, 4e-3, -3e-3])
    along = np.array([22.5e-3, 26e-3, 20.5e-3])
    force = np.array([0.3, 1.0, 5.0])
    pose = SensorPose(0.0235, float(np.radians(5.0)), float(np.radians(2.0)))
    patch = Patch.build(FINGER, LAYOUT, pose, resolution_m=0.1e-3)
    skin = Skin(patch, SkinParameters(E_PA_PER_M, 70.0), Converter.none())
    points = on_finger(arc, along)
    expected = 70 * skin.loads(Sphere(0.006), Contacts(points, FINGER.normal_at(points), force))
    centres = centres_m(0.0235, 2.0, 5.0)
    images = ImageStore(Foundation(), 6.0 / E_PA_PER_M).images(ContactKind(0.006), 5.0)
    places = (centres[:, 0] - arc[:, None], centres[:, 1] - along[:, None])
    found = 70 * E_PA_PER_M * images.loads(force[:, None] / E_PA_PER_M, *places)
    assert expected.max() > 40
    np.testing.assert_allclose(found, expected, atol=0.2)


@pytest.mark.parametrize("layer", [Layer(1.5e-3, 0.4), Layer(4e-3, 0.45, coat=0.6)])
def test_layer_gives_way_next_to_the_contact(layer):
    own = layer.fields(0.006, 5.0 / E_PA_PER_M, None)
    foundation = Foundation().fields(0.006, 5.0 / E_PA_PER_M, None)
    assert own.felt.min() >= 0
    for fields in (own, foundation):
        # Nearly all of the force is felt; the cosines take the rest.
        share = fields.felt.sum(axis=(1, 2))[1:] * SPACING_M**2 / fields.root[1:] ** 2
        assert np.all((share > 0.85) & (share < 1.0))
    at = np.sqrt(4.0 / E_PA_PER_M)
    deeper = np.interp(at, own.root, own.depth_m) / np.interp(at, foundation.root, foundation.depth_m)
    assert 0.9 < deeper < 1.6 and abs(deeper - 1) > 0.02


def test_half_space_is_that_of_hertz():
    pytest.importorskip("ContactMechanics", reason="pip install ContactMechanics")
    law, radius = HalfSpace(), 2e-3
    fields = law.fields(radius, 4e-9, None)
    hertz = (4 / 3) * law.depth_m * np.sqrt(radius) * fields.depth_m[8:] ** 1.5
    share = fields.root[8:] ** 2 / hertz
    assert np.all((share > 0.88) & (share < 1.02))  # the finger is curved, and cells are coarse


def test_thin_compressible_layer_is_a_foundation():
    assert Layer(1e-6, 0.3).compliance(np.array([0.0, 1e3]))[0] == 1
    np.testing.assert_allclose(Layer(1e-6, 0.3).compliance(np.array([1e2, 1e3])), 1.0, rtol=1e-3)
    # Half space: 2 (1 - nu²) / (E' k), E' h-free; here by its modulus.
    layer, k = Layer(2e-3, 0.3), 5e4
    shear = 2e-3 * (1 - 0.6) / (2 * (1 - 0.3))
    assert layer.compliance(np.array([k]))[0] == pytest.approx((1 - 0.3) / (shear * k), rel=1e-3)


def test_hardening_without_depth_is_linear():
    depth = np.array([0.0, 1e-4, 1e-3])
    np.testing.assert_allclose(Hardening(1e6).factor(depth), 1.0, rtol=1e-6)
    assert Hardening(1e-3).factor(depth)[-1] == pytest.approx(np.e - 1)


def test_shown_is_the_mean_of_what_is_read():
    rng = np.random.default_rng(0)
    x = np.array([-3.0, 0.0, 0.4, 2.0, 100.3, 254.5, 260.0])
    mean = read(rng, np.broadcast_to(x, (40_000, len(x))), 1.0).mean(axis=0)
    np.testing.assert_allclose(shown(x, 1.0), mean, atol=0.03)


@pytest.mark.parametrize("protocol", ["full", "raster", "static"])
def test_plan(protocol):
    body = draw_body(np.random.default_rng(1), "foundation")
    plan = make_plan(np.random.default_rng(2), protocol, body.depth_m)
    assert len(plan.presses) == (60 if protocol == "static" else 90)
    assert np.all(np.diff(plan.times_s.ravel()) > 0)
    sites = plan.column("site")
    for row, site in enumerate(sites):
        assert plan.cycle[row] == np.count_nonzero(sites[:row] == site)
    if protocol == "full":
        assert plan.cycle.max() == 8 and len(np.unique(sites)) == 26
        assert len(np.unique(plan.column("speed_m_per_s"))) == len(np.unique(plan.column("hold_s"))) == 2
        assert len(np.unique(plan.column("pose"))) == len(np.unique(plan.column("sphere_m"))) == 2


@pytest.fixture(scope="module")
def plain():
    return make_session(Spec("none", 0, 5, "foundation"))


@pytest.mark.parametrize("name", list(EFFECTS))
def test_effect_is_nothing_without_strength_and_grows_with_it(name, plain):
    scene = plain.scene
    effect = EFFECTS[name].draw(np.random.default_rng(3))
    base = counts(scene)
    np.testing.assert_allclose(counts(scene, [replace(effect, strength=1e-9)]), base, atol=1e-3)
    assert np.abs(effect.reported(scene)).max() > 0 or np.abs(counts(scene, [effect]) - base).max() > 0.5


def test_refit_absorbs_the_base_model(plain):
    scene, body = plain.scene, plain.scene.body
    refit = Refit.of(scene)
    off = replace(
        body,
        alpha_deg=body.alpha_deg + 0.4,
        scale_per_n=1.004 * body.scale_per_n,
        elasticity_pa_per_m=1.01 * body.elasticity_pa_per_m,
    )
    moved = scene.touches.moved(0.02e-3, -0.03e-3)
    change = shown(values(off, moved), 1.0) - refit.base
    before = np.sqrt(np.mean(change[refit.rows] ** 2))
    assert before > 0.1
    assert np.sqrt(np.mean(refit.left(change) ** 2)) < 0.06 * before


@pytest.mark.parametrize(
    ("name", "law"), [("hysteresis", "foundation"), ("crosstalk", "foundation"), ("rate", "layer")]
)
def test_strength_is_hit(name, law):
    session = make_session(Spec("one", 1, 5, law, effects=((name, 0.4),)))
    (effect,) = session.label["effects"]
    assert effect["name"] == name
    assert effect["strength_g"] == pytest.approx(0.4, rel=0.03)
    assert session.label["expected"] == "effects"


def test_same_spec_same_session(plain):
    again = make_session(Spec("none", 0, 5, "foundation"))
    np.testing.assert_array_equal(again.reading, plain.reading)
    np.testing.assert_array_equal(again.measured_m, plain.measured_m)
    assert not np.array_equal(make_session(Spec("none", 1, 5, "foundation")).measured_m, plain.measured_m)


def test_label_is_sealed():
    content, digest = sealed({"expected": "effects", "name": "creep"})
    assert b"creep" not in content
    assert unsealed(content, digest)["name"] == "creep"
    with pytest.raises(ValueError, match="SHA-256"):
        unsealed(content, "0" * 64)


@pytest.mark.parametrize("protocol", ["full", "static"])
def test_make_writes_a_dataset_that_skincal_reads(protocol, tmp_path, capsys):
    out = tmp_path / "session"
    given = ["make", "--effect", "gain_drift", "--law", "foundation", "--protocol", protocol, "--open"]
    assert main([*given, "--out", str(out)]) == 0
    dataset = read_dataset(out)
    assert len(dataset.presses) == (60 if protocol == "static" else 90)
    assert (dataset.frames is None) == (protocol == "static")
    label = json.loads((out / "label.json").read_text(encoding="utf-8"))
    assert label["effects"][0]["name"] == "gain_drift"
    with pytest.raises(SystemExit):
        main([*given, "--out", str(out)])
    assert "there already" in capsys.readouterr().err


@pytest.mark.parametrize("kind", list(OUTSIDE))
def test_outside_the_catalogue_is_nothing_without_strength(kind, plain):
    effect = OUTSIDE[kind].draw(np.random.default_rng(3))
    assert effect.name == "not in the catalogue"
    base = counts(plain.scene)
    np.testing.assert_allclose(counts(plain.scene, [replace(effect, strength=1e-9)]), base, atol=1e-3)
    assert np.abs(counts(plain.scene, [effect]) - base).max() > 0.5


def test_outside_is_expected_to_be_unknown():
    label = make_session(Spec("outside", 0, 5, "foundation", outside=("breathing", 0.7))).label
    assert label["expected"] == "unknown" and label["outside"] == "breathing"
    assert label["effects"][0]["strength_g"] == pytest.approx(0.7, rel=0.03)


@pytest.fixture(scope="module")
def undisguised():
    return make_session(Spec("decoy", 0, 5, "foundation"))


@pytest.mark.parametrize("decoy", DECOYS)
def test_decoys_hide_nothing_and_differ_from_a_plain_session(decoy, undisguised):
    plain = undisguised
    session = make_session(Spec("decoy", 0, 5, "foundation", decoy=decoy))
    assert session.label["expected"] == "none"
    ours, theirs = press_columns(session), press_columns(plain)
    differ = [name for name in ours if not np.array_equal(ours[name], theirs[name])]
    if decoy == "shuffled":
        assert {"pose", "cycle", "speed_m_per_s", "temperature_c"} <= set(differ)
        np.testing.assert_array_equal(session.scene.plan.cycle, plain.scene.plan.cycle)
        assert sorted(ours["cycle"]) == sorted(theirs["cycle"])
    if decoy == "positions":
        assert session.scene.body.sigma_m > plain.scene.body.sigma_m
        first = np.array([rows[0] for rows in session.scene.by_press])
        true = np.column_stack([session.scene.touches.arc_m[first], session.scene.touches.along_m[first]])
        assert np.abs(session.measured_m - true).max() < 2e-3
    if decoy == "noisy":
        assert session.label["noise_floor_rmse_counts"]["frame_rmse"] > 1.0
    assert differ


def test_faults():
    dying = make_session(Spec("robust", 0, 5, "foundation", decoy="dying"))
    (effect,) = dying.label["effects"]
    late = dying.scene.line.time_s > 0.7 * dying.scene.length_s
    assert dying.label["expected"] == "effects" and effect["name"] == "dead_taxel"
    for taxel in effect["parameters"]["taxels"]:
        assert dying.reading[late, taxel].max() < 15
    jump = make_session(Spec("robust", 1, 5, "foundation", decoy="jump"))
    rest = jump.scene.line.press < 0
    late = jump.scene.line.time_s > 0.75 * jump.scene.length_s
    rise = jump.reading[rest & late].mean(axis=0) - jump.reading[rest & (jump.scene.line.time_s < 60)].mean(
        axis=0
    )
    assert 3 <= np.count_nonzero(rise > 2) <= 6
    assert jump.label["expected"] == "none" and "baseline_drift" in jump.label["also_fine"]


def test_an_effect_without_a_trace_is_not_expected():
    # Static sessions have one hand pose: an error of the other one does not exist.
    labels = (
        make_session(Spec("poor", n, 5, "foundation", "static", (("contact_offset", 0.5),))).label
        for n in range(8)
    )
    for label in labels:
        (effect,) = label["effects"]
        posed = effect["parameters"]["stretch_per_m"] == (0.0, 0.0)
        assert label["expected"] == ("none" if posed else "effects")
        assert (effect["strength_g"] < 0.05) == posed


def test_a_layer_is_as_stiff_as_its_equivalent_foundation():
    force_m3 = 2.5 / E_PA_PER_M
    alike = ImageStore(Layer(6e-3, 0.46, coat=0.2), 6 / E_PA_PER_M, force_m3).fields(ContactKind(0.006))
    depth = np.interp(np.sqrt(force_m3), alike.root, alike.depth_m)
    assert depth == pytest.approx(Foundation().depths_m(0.006, np.array([force_m3]), None)[0], rel=0.02)
    assert alike.root[-1] ** 2 >= 6 / E_PA_PER_M
