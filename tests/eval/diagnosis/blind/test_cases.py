"""What is drawn: shares of the kinds, styles, wrong simulators; no two alike in effect."""

from collections import Counter

import pytest

from eval.diagnosis.blind.cases import BINS, CATALOGUE, BlindPlan, Dose, draw_cases
from eval.diagnosis.blind.lumped import KINDS, applies
from eval.diagnosis.blind.outside import MIMICS
from narxcal.effects.library import LIBRARY, RARE
from narxcal.effects.library import effect as library_effect
from narxcal.flight_test.scenario import PARAMETERS
from narxcal.support.errors import ConfigError


@pytest.mark.parametrize("count", [10, 60, 237])
@pytest.mark.parametrize("seed", [0, 1])
def test_the_shares_are_kept(count, seed):
    cases = draw_cases(BlindPlan(cases=count, seed=seed))
    kinds = Counter(case.kind for case in cases)
    assert sum(kinds.values()) == count
    assert kinds["null"] >= 0.2 * count
    assert kinds["outside"] >= 0.15 * count
    assert kinds["pair"] >= 0.15 * count
    mimics = sum(case.strange in MIMICS for case in cases)
    assert abs(2 * mimics - kinds["outside"]) <= 1
    assert sum(case.base.differs for case in cases) >= count / 3
    styles = Counter(case.style for case in cases)
    assert min(styles.values()) >= 0.35 * count


def test_nulls_have_scatter_and_another_structure():
    for case in draw_cases(BlindPlan(cases=60)):
        if case.kind == "null":
            assert case.base.misfit
            assert case.base.build_pct > 0.0
            assert (case.effects, case.strange, case.share) == ((), None, 0.0)


def test_singles_cover_the_catalogue_in_all_sizes():
    cases = [c for c in draw_cases(BlindPlan(cases=420)) if c.kind == "single"]
    found = Counter(case.effects[0].name for case in cases)
    assert set(found) == {scale.name for scale in CATALOGUE}
    sizes = Counter(sum(case.share >= low for low, _ in BINS) for case in cases)
    assert set(sizes) == {1, 2, 3, 4}
    assert min(sizes.values()) > 0.15 * len(cases)
    both = Counter((c.effects[0].name, c.style) for c in cases)
    assert len(both) > 1.7 * len(CATALOGUE)


def test_every_effect_of_the_library_is_in_the_catalogue():
    assert {scale.id for scale in CATALOGUE} == set(LIBRARY) - {kind.id for kind in RARE}
    for scale in CATALOGUE:
        assert library_effect(scale.name).family == scale.family


@pytest.mark.parametrize("scale", CATALOGUE, ids=lambda scale: scale.name)
@pytest.mark.parametrize("share", [0.03, 0.1, 1.0, None])
def test_every_size_is_one_that_can_be_flown(scale, share):
    size = scale.most if share is None else share * scale.first
    for sign in (1.0, -1.0) if scale.signed else (1.0,):
        dose = Dose(scale, sign * size)
        for name, value in dose.parameters.items():
            _, low, high, _ = PARAMETERS[scale.id][name]
            assert low <= value <= high
        if dose.on_sensor:
            assert dose.fault("single_aisle").channel == scale.channel
        else:
            windows = ((1.0, 2.0),)
            expected = windows if scale.id == "unlogged_switch" else ()
            assert dose.unmodelled(windows).windows == expected


def test_pairs_are_of_two_families():
    pairs = [c for c in draw_cases(BlindPlan(cases=200)) if c.kind == "pair"]
    assert all(c.effects[0].family != c.effects[1].family for c in pairs)


def test_one_style_and_one_seed():
    assert {c.style for c in draw_cases(BlindPlan(cases=20, style="line"))} == {"line"}
    plan = BlindPlan(cases=30, seed=9)
    assert draw_cases(plan) == draw_cases(plan)
    other = draw_cases(BlindPlan(cases=30, seed=10))
    assert [c.share for c in draw_cases(plan)] != [c.share for c in other]


def test_every_third_case_flies_a_lumped_engine():
    engines = [c.engine for c in draw_cases(BlindPlan(cases=120))]
    lumped = [name for name in engines if name in KINDS]
    assert 0.25 * len(engines) <= len(lumped) <= 0.42 * len(engines)
    assert set(lumped) == set(KINDS)
    for wanted in ("lumped", "virtual"):
        found = {c.engine for c in draw_cases(BlindPlan(cases=40, engine=wanted))}
        assert all((name in KINDS) == (wanted == "lumped") for name in found)


def test_no_engine_flies_an_effect_that_it_has_no_place_for():
    for each in draw_cases(BlindPlan(cases=200, engine="lumped")):
        assert all(applies(effect.id, each.engine) for effect in each.effects)


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("cases", 0, "greater than or equal to 1"),
        ("duration_s", 60.0, "greater than or equal to 480"),
        ("rate_hz", 4.0, "greater than or equal to 5"),
        ("style", "wild", "'line', 'enriched' or 'both'"),
        ("held_out", 0, "greater than or equal to 1"),
    ],
)
def test_plans_that_cannot_be(key, value, words):
    with pytest.raises(ConfigError, match=f"key '{key}': .*{words}"):
        BlindPlan.parse({key: value})
