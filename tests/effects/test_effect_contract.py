"""Properties of every effect of the registry; a new effect is tested without a change here."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from effect_sessions import (
    BASE,
    LAYOUT,
    SESSION,
    SHORT,
    SKIN,
    VALUES,
    contacts_at,
    rms,
    shuffled,
    skin_with,
    without,
)

from skincal.calibration import EFFECT_NAMES
from skincal.effects import COVARIATES, EFFECTS, Samples, SkinStream, Stage
from skincal.errors import InputError
from skincal.model import FlatPunch, MeshIndenter, Sphere

every_effect = pytest.mark.parametrize("name", EFFECTS)

SUFFIXES = {
    "s": "_s",
    "m": "_m",
    "N": "_n",
    "m/N": "_m_per_n",
    "m/s": "_m_per_s",
    "counts": "_counts",
    "1/counts": "_per_count",
    "counts/s": "_counts_per_s",
    "counts/K": "_counts_per_k",
    "1/s": "_per_s",
    "1/N": "_per_n",
    "1/K": "_per_k",
    "°C": "_c",
    "decades": "",
    "touches": "",
    "-": "",
}


NAMES = (
    "hysteresis creep rate latency first_cycle baseline_drift gain_drift spread crosstalk ghosting saturation "
    "dead_band response_curve stiffening taxel_gain taxel_offset dead_taxel shear force_bias contact_offset "
    "indenter_radius cover"
)
"""Names that files have, and that stay: calibrations and datasets of others use them."""


def test_registry_holds_the_names_of_the_files():
    assert set(EFFECTS) >= set(NAMES.split())
    assert list(EFFECTS) == list(EFFECT_NAMES)
    for name, effect in EFFECTS.items():
        assert effect.name == name
        assert effect.meaning == EFFECT_NAMES[name]


def test_registry_is_in_the_order_of_the_chain():
    stages = [effect.stage for effect in EFFECTS.values()]
    assert stages == sorted(stages)
    assert set(stages) == set(Stage)


@every_effect
def test_parameters_are_described(name: str):
    effect = EFFECTS[name]
    assert effect.source
    assert any(p.role == "strength" for p in effect.parameters)
    assert any(p.typical for p in effect.parameters) or name == "dead_taxel"
    assert len({p.name for p in effect.parameters}) == len(effect.parameters)
    assert set(effect.all_covariates) <= set(COVARIATES)
    for parameter in effect.parameters:
        assert parameter.name.endswith(SUFFIXES[parameter.unit]), parameter.name
        assert parameter.description
        assert parameter.low <= parameter.neutral <= parameter.high
        assert parameter.low < parameter.high
        assert parameter.low <= parameter.neutral + parameter.typical <= parameter.high
        assert np.isfinite([parameter.low, parameter.high]).all()
        assert parameter.scale == "linear" or parameter.low > 0


@every_effect
def test_neutral_is_exactly_the_base_model(name: str):
    neutral = {p.name: p.neutral for p in EFFECTS[name].parameters}
    assert np.array_equal(VALUES, skin_with(name, strength=0.0).values(SESSION))
    assert np.array_equal(VALUES, BASE.with_effects({name: neutral}).values(SESSION))
    assert np.array_equal(VALUES, BASE.with_effects({name: {}}).values(SESSION))


def test_neutral_effects_are_exactly_the_base_model():
    skin = BASE.with_effects({name: {} for name in EFFECTS})
    assert np.array_equal(VALUES, skin.values(without(SESSION, *COVARIATES)))
    assert not skin.has_memory


def test_base_model_is_exactly_the_skin():
    for number, indenter in enumerate(SESSION.indenters):
        rows = np.flatnonzero(SESSION.touching & (SESSION.indenter == number))
        assert np.array_equal(VALUES[rows], SKIN.values(indenter, SESSION.contacts[rows]))
    assert not VALUES[~SESSION.touching].any()


@every_effect
def test_form_does_not_matter_without_strength(name: str):
    forms = {p.name: (p.low + 2 * p.high) / 3 for p in EFFECTS[name].parameters if p.role == "form"}
    assert np.array_equal(VALUES, BASE.with_effects({name: forms}).values(SESSION))


@every_effect
def test_a_faint_effect_changes_little(name: str):
    faint, clear = (rms(skin_with(name, s).values(SESSION) - VALUES) for s in (1e-3, 1.0))
    assert 0 < faint < 0.03 * clear or (name in ("spread", "saturation") and faint < 0.03 * clear)


@every_effect
def test_strength_grows_and_one_is_clearly_visible(name: str):
    touching = SESSION.touching
    sizes = [rms((skin_with(name, s).values(SESSION) - VALUES)[touching]) for s in (0.25, 0.5, 1.0, 1.5, 2.0)]
    assert sizes == sorted(sizes)
    assert len(set(sizes)) == len(sizes)
    assert 0.5 < sizes[2] < 6.0


@every_effect
def test_strengths_stay_in_bounds_and_are_reproducible(name: str):
    effect = EFFECTS[name]
    for strength in (0.1, 1.0, 7.0, 1e3):
        drawn = [effect.at_strength(strength, np.random.default_rng(5), LAYOUT, 3) for _ in range(2)]
        values = [effect.checked(given, LAYOUT.taxels) for given in drawn]
        assert values[0].key == values[1].key
        assert not effect.is_neutral(values[0])
    for bad in (-1.0, np.nan, np.inf):
        with pytest.raises(InputError, match=name):
            effect.at_strength(bad, np.random.default_rng(5), LAYOUT)


def assert_same(values: np.ndarray, others: np.ndarray, what: str = "") -> None:
    """Hold that values are the same but for the last bits.

    With the lowest versions of the libraries (numpy 2.0) the same call, repeated, gives values that differ by some
    1e-15 of the largest, by where its arrays come to lie in memory; with newer ones it does not.
    """
    np.testing.assert_allclose(values, others, rtol=1e-12, atol=1e-12 * np.abs(values).max(), err_msg=what)


@every_effect
@pytest.mark.parametrize("pieces", [1, 17])
def test_sample_by_sample_is_the_session(name: str, pieces: int):
    skin = skin_with(name)
    stream = SkinStream(skin)
    cuts = [slice(k, k + pieces) for k in range(0, len(SHORT), pieces)]
    steps = np.vstack([stream.step(SHORT[cut]) for cut in cuts])
    whole = skin.values(SHORT)
    np.testing.assert_allclose(steps, whole, rtol=0, atol=1e-9)
    stream.reset()
    again = np.vstack([stream.step(SHORT[cut]) for cut in cuts])
    assert_same(steps, again)


def test_forms_with_further_needs_state_them():
    """The needs of a form apply as soon as its parameter leaves the default."""
    given = {"amplitude": 0.4, "cycles": 6.0, "fading_per_n": 0.7, "tail": 0.5}
    skin = BASE.with_effects({"first_cycle": given})
    stream, values = SkinStream(skin), skin.values(SHORT)
    np.testing.assert_allclose(np.vstack([stream.step(SHORT[k : k + 1]) for k in range(len(SHORT))]), values)
    assert skin.effects[0].needs == ("cycle", "met")
    assert rms(skin.values(shuffled(SESSION, "met")) - skin.values(SESSION)) > 1e-3
    without_force = BASE.with_effects({"first_cycle": {**given, "fading_per_n": 0.0}})
    assert without_force.effects[0].needs == ("cycle",)
    assert rms(without_force.values(SHORT) - values) > 1e-3


@every_effect
def test_only_an_effect_with_memory_depends_on_earlier_samples(name: str):
    skin, rows = skin_with(name), np.flatnonzero(SHORT.touching)[::7]
    alone = skin.values(SHORT[rows])
    same = np.allclose(alone, skin.values(SHORT)[rows], rtol=0, atol=1e-9)
    assert same != EFFECTS[name].has_memory
    assert skin.has_memory == EFFECTS[name].has_memory


@every_effect
def test_other_covariates_do_not_matter(name: str):
    skin = skin_with(name)
    needed = [n for a in skin.effects for n in a.effect.needs(a.values)]
    values = skin.values(SESSION)
    for covariate in set(COVARIATES) - set(needed):
        assert_same(values, skin.values(shuffled(SESSION, covariate)), covariate)
        assert_same(values, skin.values(without(SESSION, covariate)), covariate)


def strongly(name: str, parameter: str) -> dict[str, object]:
    """An effect by one of its parameters alone; one that differs from pose to pose, where it can."""
    p = EFFECTS[name].parameter(parameter)
    size = p.typical or 0.2 * (p.high - p.neutral)
    values = [p.neutral + size, p.neutral - 0.5 * size] if p.shape == "per-pose" else p.neutral + size
    return {parameter: values}


PARAMETER_NEEDS = [
    (name, p.name, covariate)
    for name, effect in EFFECTS.items()
    for p in effect.parameters
    if p.role == "strength"
    for covariate in dict.fromkeys([*effect.covariates, *p.needs])
]


@pytest.mark.parametrize(("name", "parameter", "covariate"), PARAMETER_NEEDS)
def test_the_covariates_that_it_states_are_needed(name: str, parameter: str, covariate: str):
    forms = {"rate": {"fade_s": 1.0}}.get(name, {})
    skin = BASE.with_effects({name: {**strongly(name, parameter), **forms}})
    assert rms(skin.values(SESSION) - skin.values(shuffled(SESSION, covariate))) > 1e-3
    with pytest.raises(InputError, match=rf"(?s){name}.*{COVARIATES[covariate].attribute}"):
        skin.values(without(SESSION, covariate))
    abstaining = replace(skin, missing="abstain")
    assert np.array_equal(VALUES, abstaining.values(without(SESSION, covariate)))


MOVES = ("contact_offset", "shear")
"""They move contacts. Samples that share a place are worked out together; which they are shows in the last digit."""


@pytest.mark.parametrize(
    ("name", "parameter", "covariate"),
    # A clock is there for all samples or for none; a phase that is not known counts as loading.
    [needs for needs in PARAMETER_NEEDS if needs[2] not in ("time", "phase")],
)
def test_it_abstains_in_samples_that_lack_a_covariate(name: str, parameter: str, covariate: str):
    held = getattr(SESSION, COVARIATES[covariate].attribute)
    lacking = np.arange(len(SESSION)) % 3 == 0
    holes = held.copy()
    holes[lacking] = -1 if covariate == "pose" else np.nan
    skin = BASE.with_effects({name: strongly(name, parameter)})
    values = skin.values(replace(SESSION, **{COVARIATES[covariate].attribute: holes}))
    if name not in MOVES:
        assert np.array_equal(values[lacking], VALUES[lacking])
        assert np.array_equal(values[~lacking], skin.values(SESSION)[~lacking])
    np.testing.assert_allclose(values[lacking], VALUES[lacking], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(values[~lacking], skin.values(SESSION)[~lacking], rtol=1e-12, atol=1e-12)


@every_effect
def test_no_force_and_no_contact_give_numbers(name: str):
    skin = skin_with(name, strength=2.0)
    still = replace(SHORT, contacts=replace(SHORT.contacts, force_n=np.zeros(len(SHORT))))
    nowhere = replace(
        SHORT,
        contacts=replace(SHORT.contacts, points_m=np.full((len(SHORT), 3), np.nan)),
        touching=np.zeros(len(SHORT), dtype=bool),
    )
    negative = replace(SHORT, contacts=replace(SHORT.contacts, force_n=np.full(len(SHORT), -0.3)))
    for samples in (still, nowhere, negative, SHORT[:0], SHORT[:1]):
        values = skin.values(samples)
        assert values.shape == (len(samples), 16)
        assert np.isfinite(values).all()


@every_effect
def test_a_contact_that_is_not_known_harms_no_other(name: str):
    skin = skin_with(name)
    unknown = np.flatnonzero(SHORT.touching)[5::9]
    points = SHORT.contacts.points_m.copy()
    points[unknown] = np.nan
    values = skin.values(replace(SHORT, contacts=replace(SHORT.contacts, points_m=points)))
    others = np.setdiff1d(np.arange(len(SHORT)), unknown)
    assert np.isnan(values[unknown]).all()
    np.testing.assert_allclose(values[others], skin.values(SHORT[others]), rtol=0, atol=1e-9)


@every_effect
def test_it_acts_under_every_indenter(name: str):
    edges = trimesh.creation.box((0.01, 0.004, 0.004)).apply_translation([0, 0, 0.002])
    for indenter in (FlatPunch(0.003), MeshIndenter(edges.vertices, edges.faces)):
        pressed = replace(SHORT, indenters=(indenter, indenter.resized(0.8)))
        assert rms(skin_with(name).values(pressed) - BASE.values(pressed)) > 0


@every_effect
def test_strong_effects_give_numbers_at_all_forces(name: str):
    force = np.concatenate([[0.0, 1e-9, 1e-3], np.linspace(0.1, 30.0, 20)])
    samples = Samples.of(
        contacts_at(0.0, 0.0, force),
        Sphere(0.006),
        time_s=np.arange(len(force)) * 0.1,
        phase=1,
        speed_m_per_s=0.0,
        cycle=100,
        met_n=30.0,
        pose=7,
        temperature_c=90.0,
        shear_u_n=5.0,
        shear_v_n=-5.0,
    )
    for parameter in EFFECTS[name].parameters:
        for bound in (parameter.low, parameter.high):
            strong = EFFECTS[name].at_strength(1.0, np.random.default_rng(0), LAYOUT) | {
                parameter.name: bound
            }
            assert np.isfinite(BASE.with_effects({name: strong}).values(samples)).all(), (
                parameter.name,
                bound,
            )


@every_effect
def test_later_stages_can_be_done_again_without_the_contact(name: str):
    skin = skin_with(name)
    contacted = BASE.contact(SESSION, points=True)
    if EFFECTS[name].stage <= Stage.CONTACT:
        with pytest.raises(ValueError, match="of others"):
            skin.finish(contacted)
    else:
        assert np.array_equal(skin.finish(contacted), skin.values(SESSION))


@every_effect
def test_given_arrays_are_not_changed(name: str):
    skin = skin_with(name)
    contacted = skin.contact(SHORT, points=True)
    before = contacted.loads_n.copy()
    values = skin.finish(contacted)
    assert np.array_equal(contacted.loads_n, before)
    assert np.array_equal(values, skin.finish(contacted))


@every_effect
def test_what_a_parameter_cannot_be_is_said(name: str):
    effect = EFFECTS[name]
    with pytest.raises(InputError, match=rf"(?s)effect {name}: expected parameters among .*no_such"):
        effect.checked({"no_such": 1.0}, 16)
    with pytest.raises(InputError, match="no_such"):
        effect.parameter("no_such")
    for parameter in effect.parameters:
        assert effect.parameter(parameter.name) is parameter
        place = rf"effect {name}, parameter {parameter.name}: expected"
        for bad in (parameter.high + 1.0, parameter.low - 1.0, np.nan):
            with pytest.raises(InputError, match=rf"{place} .* to "):
                effect.checked({parameter.name: bad}, 16)
        wrong = {"scalar": np.ones(2), "per-taxel": np.ones(5), "per-pose": np.ones((2, 2))}[parameter.shape]
        with pytest.raises(InputError, match=place):
            effect.checked({parameter.name: wrong * parameter.neutral}, 16)
