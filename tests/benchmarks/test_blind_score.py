"""The score of the blind test, on diagnoses that are made up."""

import numpy as np
import pytest

from benchmarks.blind.figures import figures
from benchmarks.blind.held import as_table, held
from benchmarks.blind.markdown import as_markdown
from benchmarks.blind.measures import summary
from benchmarks.blind.outcome import Outcome, OutcomeError
from benchmarks.blind.suites import CLASS_OF, specs


def _label(spec):
    names = [name for name, _ in spec.effects] + (["not in the catalogue"] if spec.outside else [])
    strengths = [g for _, g in spec.effects] + ([spec.outside[1]] if spec.outside else [])
    if spec.decoy == "dying":
        names, strengths = ["dead_taxel"], [1.0]
    return {
        "session": spec.name,
        "suite": spec.suite,
        "contact_law": spec.law,
        "protocol": spec.protocol,
        "decoy": spec.decoy,
        "outside": spec.outside[0] if spec.outside else None,
        "also_fine": ["baseline_drift", "unknown"] if spec.decoy == "jump" else [],
        "expected": "unknown" if spec.outside else "effects" if names else "none",
        "effects": [{"name": n, "strength_g": g} for n, g in zip(names, strengths, strict=True)],
    }


def _said(verdict, names=(), sets=None, closed=None, unexplained=False, cannot_see=()):
    sets = sets or [[name] for name in names]
    effects = [{"name": n, "consistent_with": s, "p_value": 0.01} for n, s in zip(names, sets, strict=True)]
    gap = {"heldout_rmse_before": 3.0, "heldout_rmse_after": 2.0, "noise_floor_rmse": 1.9, "closed": closed}
    return {
        "verdict": verdict,
        "effects": effects,
        "unexplained": unexplained,
        "cannot_see": cannot_see,
        "gap": gap,
    }


def _all(answer):
    labels = [
        _label(spec)
        for suite in ("none", "decoy", "one", "two", "outside", "poor", "robust")
        for spec in specs(suite, 0)
    ]
    return [Outcome.of(label, answer(label), 10.0, 20.0) for label in labels]


def _perfect(label):
    if label["expected"] != "effects":
        return _said(label["expected"])
    return _said("effects", [e["name"] for e in label["effects"]], closed=0.97)


def test_a_perfect_diagnosis_reaches_everything():
    suites = summary(_all(_perfect), [])
    one = suites["one"]
    checks = [suites[s]["false_alarms"] for s in ("none", "decoy")]
    checks += [
        one[k] for k in ("right_class_strong", "right_class_weak", "truth_in_set_where_named", "set_size")
    ]
    checks += [
        one["exact_name_where_it_can_be_told"],
        *(one["gap_closed"][k] for k in ("median", "percentile_10")),
    ]
    checks += [suites["two"][k] for k in ("both", "at_least_one", "spurious_third")]
    checks += [suites["outside"][k] for k in ("unknown", "confidently_wrong")]
    checks += [suites["poor"]["abstains_or_names_the_class"]]
    assert all(check["reached"] for check in checks)
    assert suites["robust"]["as_expected"]["share"] == 1
    assert all(row == {name: 12} for name, row in one["confusion"].items())
    assert one["gap_closed"]["of"] == 12 * len(CLASS_OF)
    assert suites["seconds"]["wall_median"] == 10
    text = as_markdown(suites)
    assert "**no**" not in text
    assert "| two effects | both | 100 % (60 of 60) | 94 to 100 % | ≥ 80 % | yes |" in text


def test_a_silent_diagnosis_finds_nothing_and_alarms_nobody():
    suites = summary(_all(lambda label: _said("none")), [])
    assert suites["none"]["false_alarms"]["hits"] == 0
    assert suites["one"]["right_class_strong"]["share"] == 0 and suites["one"]["set_size"]["value"] is None
    assert suites["two"]["at_least_one"]["reached"] is False
    assert suites["outside"]["unknown"]["share"] == 0 and suites["outside"]["confidently_wrong"]["share"] == 0
    assert suites["poor"]["abstains_or_names_the_class"]["share"] == 1
    assert suites["one"]["gap_closed"] == {"of": 0}
    assert {row["none"] for row in suites["one"]["confusion"].values()} == {12}
    as_markdown(suites)


def test_a_constant_diagnosis_is_confidently_wrong():
    suites = summary(_all(lambda label: _said("effects", ["creep"])), [])
    assert suites["none"]["false_alarms"]["share"] == suites["outside"]["confidently_wrong"]["share"] == 1
    assert suites["one"]["exact_name_of_all"]["hits"] == 12
    memory = sum(kind == "memory" for kind in CLASS_OF.values())
    strong = suites["one"]["right_class_strong"]
    assert strong["hits"] == memory * 8 and strong["of"] == len(CLASS_OF) * 8
    assert suites["one"]["right_class_weak"]["of"] == len(CLASS_OF) * 4
    assert suites["two"]["both"]["share"] == 0
    assert suites["poor"]["abstains_or_names_the_class"]["reached"] is False


def test_sets_count_for_the_truth_but_not_for_the_name():
    def answer(label):
        name = label["effects"][0]["name"] if label["effects"] else None
        return _said("effects", ["rate"], [["rate", name]]) if label["suite"] == "one" else _said("none")

    one = summary(_all(answer), [])["one"]
    assert one["truth_in_set_where_named"]["share"] == 1
    # Where the set has one name only, the effect is the rate.
    assert one["exact_name_where_it_can_be_told"]["of"] == 12
    assert one["set_size"]["value"] == pytest.approx(2 - 1 / len(CLASS_OF)) and not one["set_size"]["reached"]


def test_what_cannot_be_seen_is_not_asked_by_name():
    def answer(label):
        return _said("effects", ["creep"], cannot_see=["ghosting"])

    one = summary([o for o in _all(answer) if o.label["suite"] == "one"], [])["one"]
    assert one["exact_name_where_it_can_be_told"]["of"] == 12 * (len(CLASS_OF) - 1)
    assert one["cannot_see_though_hidden"]["hits"] == 12


def test_two_effects_and_a_third():
    label = {
        **_label(specs("two", 0)[0]),
        "effects": [{"name": n, "strength_g": 0.6} for n in ("creep", "spread")],
    }
    said = [
        _said("effects", ["creep", "spread"], closed=0.9),
        _said("effects", ["hysteresis"], [["hysteresis", "creep"]]),
        _said("effects", ["creep", "spread", "shear"], closed=0.9),
        _said("unknown"),
    ]
    two = summary([Outcome.of(label, answer) for answer in said], [])["two"]
    assert [two[k]["hits"] for k in ("both", "at_least_one", "spurious_third", "any_wrong_name")] == [
        2,
        3,
        1,
        1,
    ]
    assert two["gap_closed"]["of"] == 2


def test_failed_sessions_count_as_wrong():
    labels = [_label(spec) for spec in specs("one", 0)[:10]]
    outcomes = [Outcome.of(label, _perfect(label)) for label in labels[:6]]
    one = summary(outcomes, labels[6:])["one"]
    assert (one["sessions"], one["failed"]) == (10, 4)
    strong = [label["effects"][0]["strength_g"] >= 0.4 for label in labels]
    assert one["right_class_strong"]["of"] == sum(strong)
    assert one["right_class_strong"]["hits"] == sum(strong[:6])


def test_gap_of_positions_is_the_shrink_of_the_slack():
    label = _label(next(spec for spec in specs("one", 0) if spec.effects[0][0] == "contact_offset"))
    said = _said("effects", ["contact_offset"])
    said["gap"] |= {"slack_rms_before_m": 1e-3, "slack_rms_after_m": 0.5e-3}
    gap = summary([Outcome.of(label, said)], [])["one"]["gap_closed"]
    assert gap["median"]["value"] == pytest.approx(0.75)


def test_gap_is_tabled_by_strength_and_contact_law():
    """Weak effects close half, strong ones all; on layers a fifth less. What positions leave is not among them."""

    def answer(label):
        g = label["effects"][0]["strength_g"] if label["suite"] == "one" else 0.0
        closed = (1.0 if g >= 0.4 else 0.5) - (0.2 if label["contact_law"] == "layer" else 0.0)
        return _perfect(label) | {"gap": {"closed": closed}}

    one = summary(_all(answer), [])["one"]
    assert (
        one["gap_closed"]["of"] == len(CLASS_OF) * 12
        and one["gap_closed_strong"]["of"] == (len(CLASS_OF) - 1) * 8
    )
    assert sum(entry["all"]["of"] for entry in one["gap_by_strength"]) == (len(CLASS_OF) - 1) * 12
    for entry in one["gap_by_strength"]:
        weak = entry["g"][0] < 0.39
        for law, gap in entry["by_law"].items():
            expected = (0.5 if weak else 1.0) - (0.2 if law == "layer" else 0.0)
            assert gap["median"]["value"] == gap["percentile_10"]["value"] == pytest.approx(expected)
    assert one["gap_closed_strong"]["percentile_10"]["value"] == pytest.approx(0.8)
    text = as_markdown(summary(_all(answer), []))
    assert "| the same at g ≥ 0.4, without `contact_offset` | 0.80 |" in text


def test_pictures_show_every_session_once():
    """The numbers in the squares are the counts of sessions; bins of the power curve without a session are left out."""
    suites = summary(_all(lambda label: _said("effects", ["creep"])), [])
    drawn = figures(suites)
    cells = [text for text in drawn["confusion"].axes[0].texts if text.get_text()]
    assert len(cells) == len(CLASS_OF) and sum(int(text.get_text()) for text in cells) == 12 * len(CLASS_OF)
    assert [label.get_text() for label in drawn["confusion"].axes[0].get_xticklabels()][-1] != "none"
    ticks = [label.get_text() for label in drawn["power"].axes[0].get_xticklabels()]
    assert len(ticks) == 6 and sum(int(tick.split("\n")[1].split()[0]) for tick in ticks) == 12 * len(
        CLASS_OF
    )
    assert figures({"none": suites["none"]}) == {}


def test_power_grows_with_strength():
    def answer(label):
        seen = label["suite"] == "one" and label["effects"][0]["strength_g"] > 0.5
        return _perfect(label) if seen else _said("none")

    bins = summary(_all(answer), [])["one"]["power"]
    detected = [entry["detected"]["share"] for entry in bins]
    assert detected == sorted(detected) and detected[0] == 0 and detected[-1] == 1
    assert np.all(np.diff([entry["mean_g"] for entry in bins]) > 0)


def test_a_jump_may_be_called_more_than_one_thing():
    label = _label(next(spec for spec in specs("robust", 0) if spec.decoy == "jump"))

    def share(said):
        return summary([Outcome.of(label, said)], [])["robust"]["as_expected"]["share"]

    assert share(_said("none")) == share(_said("unknown")) == share(_said("effects", ["baseline_drift"])) == 1
    assert share(_said("effects", ["creep"])) == 0


@pytest.mark.parametrize("said", [{}, {"verdict": "maybe"}, {"verdict": "effects", "effects": []}])
def test_what_is_not_as_the_contract_has_it_is_reported(said):
    with pytest.raises(OutcomeError, match="none-000"):
        Outcome.of(_label(specs("none", 0)[0]), said)


def test_false_alarms_of_null_sessions_are_counted():
    by_number = [
        [],
        [[]],
        [[{"p_value": 0.01}, {"p_value": 0.5}]],
        [[{"p_value": 0.02}], [{"p_value": 0.001}]],
    ]

    def answer(label):
        number = int(label["session"].rsplit("-", 1)[1])
        return {**_said("none"), "candidates": by_number[number % 4]}

    quiet = summary([o for o in _all(answer) if o.label["suite"] == "none"], [])["none"]
    assert quiet["scores"]["hits"] == 25 and quiet["scores"]["of"] == 100


def test_truth_that_intervals_hold_is_counted_where_it_is_one():
    truth = {"y_m": 0.02, "elasticity_pa_per_m": 4e8}
    outcomes = []
    for number, (law, low) in enumerate([("linear foundation", 3e8), ("elastic layer", 5e8)]):
        label = _label(specs("one", 0)[number])
        label |= {"contact_law": law, "truth": truth, "truth_as_the_positions_tell_it": {"y_m": 0.021}}
        ends = {"y_m": [0.0208, 0.0205, 0.0215], "elasticity_pa_per_m": [5.2e8, low, 6e8]}
        outcomes.append(Outcome.of(label, _perfect(label), calibrated=ends))
    wrong = _label(specs("one", 0)[2]) | {"truth": truth, "contact_law": "elastic layer"}
    wrong["truth_as_the_positions_tell_it"] = {"y_m": 0.022}
    other = next(n for n in CLASS_OF if n != wrong["effects"][0]["name"])
    outcomes.append(Outcome.of(wrong, _said("effects", [other]), calibrated=ends))
    found = held(outcomes)
    assert [(found[k]["y_m"]["hits"], found[k]["y_m"]["of"]) for k in ("all", "right names")] == [
        (2, 3),
        (2, 2),
    ]
    stiff = found["all"]["elasticity_pa_per_m"]
    assert (stiff["hits"], stiff["of"]) == (1, 1)
    assert stiff["median half width"] == pytest.approx(1.5 / 5.2)
    assert "| right names | y_m | 2 of 2 |" in as_table(found)
