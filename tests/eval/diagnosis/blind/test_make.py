"""Cases as made: their files, what the key says of them, the same bytes again."""

import gzip
import hashlib
import json

import numpy as np
import pytest

from eval.diagnosis.blind import truth
from eval.diagnosis.blind.cases import CATALOGUE, Base, BlindPlan, Case, Dose, draw_cases
from eval.diagnosis.blind.files import open_key, read_cases
from eval.diagnosis.blind.make import (
    budget,
    energy,
    gap_share,
    make_case,
    ranges,
    size_for,
    sized,
)
from eval.diagnosis.blind.outside import CYCLE, DEADBAND, MIMICS, OTHERS, applied
from eval.diagnosis.blind.truth import Content, Specimen
from eval.diagnosis.pairs import read_pairs
from narxcal.support.errors import ConfigError, DataError, ModelError

LAG = next(scale for scale in CATALOGUE if scale.id == "spool_lag")
BIAS = next(scale for scale in CATALOGUE if scale.name == "sensor_bias:EGT_C")
DRIFT = next(scale for scale in CATALOGUE if scale.name == "sensor_drift:EGT_C")
PLAN = BlindPlan(cases=1, flights=2, held_out=1, rate_hz=8.0)


def case(**changes):
    given = {
        "name": "case_001",
        "number": 1,
        "kind": "single",
        "style": "enriched",
        "engine": "business_jet",
        "base": Base(0.2),
        "effects": (LAG,),
        "signs": (1.0,),
        "share": 0.2,
    }
    return Case(**{**given, **changes})


def test_a_case_has_the_logs_of_both_engines(made):
    names = sorted(str(file.relative_to(made)) for file in made.rglob("*") if file.is_file())
    logs = [
        f"case_00{k}/{name}.csv.gz"
        for k in (1, 2, 3)
        for name in (
            "real/flight_0",
            "real/flight_1",
            "real_heldout/flight_2",
            "sim/flight_0",
            "sim/flight_1",
            "sim_heldout/flight_2",
        )
    ]
    assert names == [*logs, "cases.json", "key.json.sealed"]
    pairs = read_pairs(made / "case_001" / "real", made / "case_001" / "sim")
    assert [pair.name for pair in pairs] == ["flight_0", "flight_1"]
    assert set(pairs[0].sim) == {"N1_pct", "N2_pct", "EGT_C", "FF_kgph"}


def test_the_list_tells_nothing_of_what_is_in_them(made):
    text = (made / "cases.json").read_text("utf-8")
    for word in ("kind", "style", "seed", "null", "effect", "single", "lag", "share"):
        assert f'"{word}"' not in text.replace('"style": "both"', "")


def test_the_key_tells_all(made):
    key = open_key(made, "4")
    assert list(key["cases"]) == ["case_001", "case_002", "case_003"]
    for row in key["cases"].values():
        assert row["gap_share"] <= 1.0
        shares = [cause["share"] for cause in row["budget"].values()]
        assert sum(shares) == pytest.approx(1.0)
        channels = [sum(cause["channels"].values()) for cause in row["budget"].values()]
        assert channels == pytest.approx(shares)
        assert len(row["effects"]) == len(row["budget"]) - 4
        assert bool(row["effects"]) == (row["kind"] in ("single", "pair"))
    assert key["plan"]["seed"] == 4


def test_a_case_made_alone_is_the_one_made_with_others(made, plan, tmp_path):
    alone = make_case(tmp_path / "alone", plan, draw_cases(plan)[1])
    assert alone.logs == read_cases(made)["logs"]["case_002"]
    file = made / "case_002" / "sim" / "flight_0.csv.gz"
    assert hashlib.sha256(file.read_bytes()).hexdigest() == alone.logs["sim/flight_0.csv.gz"]


def flown(specimen, content):
    """The true budget on two flights."""
    flights = [specimen.flight(k) for k in (0, 1)]
    simulated = [specimen.simulated(each) for each in flights]
    real = [specimen.both(each, content) for each in flights]
    return budget(specimen, flights, content, simulated, real), simulated, real


def test_an_effect_alone_is_the_whole_budget_but_for_what_the_sensors_add(quick):
    specimen = Specimen(case(effects=(BIAS,), base=Base(0.0)), PLAN)
    found, simulated, real = flown(specimen, Content((Dose(BIAS, 8.0),)))
    spans, bias = ranges(simulated), found["sensor_bias:EGT_C"]
    whole = sum(energy(r, s, spans) for (_, r), s in zip(real, simulated, strict=True)) / 2.0
    errors = [float(np.mean(r["EGT_C"] - t["EGT_C"])) for t, r in real]
    # Half of what it does together with the offsets of the flights is its own.
    expected = (64.0 + 8.0 * np.mean(errors)) / spans["EGT_C"] ** 2 / 4.0  # of four channels
    assert bias["share"] == pytest.approx(expected / whole)
    assert bias["channels"]["N1_pct"] == pytest.approx(0.0, abs=1e-12)
    for name in ("build", "unexplained"):
        assert found[name]["share"] == pytest.approx(0.0, abs=1e-12)
    noise = [sum(np.var(r[n] - t[n]) / spans[n] ** 2 for n in spans) / 4.0 for t, r in real]
    assert found["noise"]["share"] == pytest.approx(np.mean(noise) / whole)


def test_causes_share_what_they_do_together_in_equal_parts(quick):
    """Bias b, drift c and offset o of one channel: a cause and half of its products with others."""
    specimen = Specimen(case(effects=(BIAS, DRIFT), base=Base(0.0)), PLAN)
    doses = (Dose(BIAS, 8.0), Dose(DRIFT, 90.0))
    found, _, real = flown(specimen, Content(doses))
    c = 90.0 * specimen.flight(0).inputs["time_s"] / 3600.0
    o = float(np.mean([np.mean(r["EGT_C"] - t["EGT_C"]) for t, r in real]))
    bias = 64.0 + 8.0 * (c.mean() + o)
    drift = (c**2).mean() + c.mean() * (8.0 + o)
    ratio = found["sensor_bias:EGT_C"]["share"] / found["sensor_drift:EGT_C"]["share"]
    assert ratio == pytest.approx(bias / drift)


def test_a_wrong_simulator_is_build_and_another_structure_is_unexplained(quick):
    specimen = Specimen(case(base=Base(1.5, probe=1.3)), PLAN)
    found, *_ = flown(specimen, Content((Dose(LAG, 0.3),)))
    # Below zero where the build opposes the effect: the gap is smaller than the effect alone.
    assert abs(found["build"]["share"]) > 0.01
    assert found["unexplained"]["share"] == pytest.approx(0.0, abs=1e-12)
    other = Specimen(case(base=Base(1.5, probe=1.3, misfit=True)), PLAN)
    found, *_ = flown(other, Content((Dose(LAG, 0.3),)))
    assert found["unexplained"]["share"] > 1e-4


@pytest.mark.parametrize("engine", ["lumped_n1", "lumped_n2", "lumped_fuel"])
def test_lumped_engines_fly_cases_too(engine, tmp_path):
    made = make_case(tmp_path, PLAN, case(engine=engine))
    assert made.row["engine"] == engine
    assert made.row["gap_share"] > 0.05
    pairs = read_pairs(tmp_path / "case_001" / "real", tmp_path / "case_001" / "sim")
    driver = "FF_kgph" if engine == "lumped_fuel" else "TRA_deg"
    assert pairs[0].driver == driver
    assert len(pairs[0].sim) == (3 if engine == "lumped_fuel" else 4)


def test_inputs_are_the_same_on_both_sides(quick):
    specimen = Specimen(case(), PLAN)
    flight = specimen.flight(0)
    simulated = specimen.simulated(flight)
    _, recorded = specimen.both(flight, Content((Dose(LAG, 0.5),)))
    for name in flight.inputs:
        np.testing.assert_array_equal(simulated[name], recorded[name])
    assert list(simulated) == list(recorded)


@pytest.mark.parametrize("share", [0.03, 0.3, 0.8])
def test_sizes_make_the_share_that_was_asked_for(quick, share):
    specimen = Specimen(case(share=share), PLAN)
    flight = specimen.flight(2)
    simulated = specimen.simulated(flight)
    told = specimen.simulated(flight, sized(specimen, [flight], [simulated]))
    _, recorded = specimen.both(flight, Content())
    spans = ranges([simulated])
    effect, rest = energy(told, simulated, spans), energy(recorded, simulated, spans)
    assert effect / (effect + rest) == pytest.approx(share, rel=0.1)


def test_a_sensor_effect_keeps_its_sign(quick):
    specimen = Specimen(case(effects=(BIAS,), signs=(-1.0,), share=0.5), PLAN)
    flight = specimen.flight(2)
    content = sized(specimen, [flight], [specimen.simulated(flight)])
    assert content.doses[0].parameters["offset"] < 0.0


def test_a_pair_and_something_strange_get_sizes(quick):
    both = Specimen(case(kind="pair", effects=(LAG, BIAS), signs=(1.0, 1.0)), PLAN)
    flight = both.flight(2)
    simulated = both.simulated(flight)
    doses = sized(both, [flight], [simulated]).doses
    spans = ranges([simulated])
    parts = [energy(both.simulated(flight, Content((dose,))), simulated, spans) for dose in doses]
    assert parts[0] == pytest.approx(parts[1], rel=0.3)
    strange = Specimen(case(kind="outside", effects=(), signs=(), strange=CYCLE), PLAN)
    content = sized(strange, [flight], [simulated])
    assert content.strange > 0.0
    assert content.doses == ()
    null = Specimen(case(kind="null", effects=(), signs=(), share=0.0), PLAN)
    assert sized(null, [flight], [simulated]) == Content()


def test_a_perfect_simulator_with_the_effect_takes_all_away(quick):
    specimen = Specimen(case(base=Base(0.0)), PLAN)
    flight, content = specimen.flight(0), Content((Dose(LAG, 0.8),))
    true = specimen.both(flight, content)[0]
    simulated, told = specimen.simulated(flight), specimen.simulated(flight, content)
    assert gap_share([true], [simulated], [told]) == pytest.approx(1.0)
    assert gap_share([simulated], [simulated], [simulated]) == 0.0


def test_known_lags_of_the_instrumentation_are_no_gap(quick):
    specimen = Specimen(case(base=Base(0.0)), PLAN)
    flight = specimen.flight(0)
    simulated, (true, recorded) = specimen.simulated(flight), specimen.both(flight, Content())
    for name in ("N1_pct", "N2_pct", "EGT_C", "FF_kgph"):
        np.testing.assert_allclose(true[name], simulated[name], rtol=1e-12)
    # Their noise, bias and clock are: what is left follows the fuel flow's rate hardly at all.
    rate = np.gradient(simulated["FF_kgph"], flight.dt_s)
    late_s = np.polyfit(rate, recorded["FF_kgph"] - simulated["FF_kgph"], 1)[0]
    assert abs(late_s) < 0.03


def test_of_the_same_build_white_noise_is_all_that_is_recorded_beside(quick):
    specimen = Specimen(case(base=Base(0.0)), PLAN.model_copy(update={"build": "same"}))
    flight = specimen.flight(0)
    simulated, (true, recorded) = specimen.simulated(flight), specimen.both(flight, Content())
    for name, sigma in (("N1_pct", 0.04), ("N2_pct", 0.04), ("EGT_C", 1.0)):
        np.testing.assert_allclose(true[name], simulated[name], rtol=1e-12)
        noise = recorded[name] - simulated[name]
        assert noise.std() == pytest.approx(sigma, rel=0.1)
        assert abs(noise.mean()) < 5.0 * sigma / np.sqrt(len(noise))
        assert abs(np.corrcoef(noise[1:], noise[:-1])[0, 1]) < 0.1


def test_of_the_same_build_no_simulator_is_wrong_and_sizes_go_down_to_the_noise():
    plan = BlindPlan(cases=60, build="same")
    cases = draw_cases(plan)
    assert not any(each.base.differs or each.base.build_pct for each in cases)
    shares = [each.share for each in cases if each.kind != "null"]
    assert min(shares) < 0.25
    assert max(shares) > 0.95
    kinds = [each.kind for each in draw_cases(BlindPlan(cases=60))]
    assert [each.kind for each in cases] == kinds


def test_the_search_for_a_size():
    assert size_for(lambda size: size**2, 0.25, (1.0, 9.0)) == pytest.approx(0.5, rel=0.02)
    assert size_for(lambda size: size**3, 8.0, (1.0, 9.0)) == pytest.approx(2.0, rel=0.05)
    assert size_for(lambda size: 1e-9 * size, 1.0, (1.0, 9.0)) == 9.0
    assert size_for(lambda size: size**2, 1e-9, (1.0, 9.0)) == pytest.approx(0.03)


def test_the_simulator_is_wrong_where_it_should_be(quick):
    right, wrong = (
        Specimen(case(base=base), PLAN) for base in (Base(0.2), Base(0.2, probe=1.3, misfit=True))
    )
    flight = right.flight(0)
    one, two = right.simulated(flight), wrong.simulated(flight)
    assert np.abs(one["EGT_C"] - two["EGT_C"]).max() > 0.1
    np.testing.assert_array_equal(one["N1_pct"], two["N1_pct"])
    # The misfit is in the real engine: its lever has a deadband.
    assert np.abs(right.both(flight, Content())[0]["N1_pct"] - two["N1_pct"]).max() < 1e-9
    assert np.abs(wrong.both(flight, Content())[0]["N1_pct"] - two["N1_pct"]).max() > 0.01


@pytest.mark.parametrize("what", [*MIMICS, *OTHERS], ids=lambda each: each.id)
def test_what_is_strange_changes_something_by_its_size(quick, what):
    flight = Specimen(case(), PLAN).flight(0)
    seen = {**flight.inputs, **truth.VirtualEngine().simulate(flight.inputs, flight.dt_s)}
    small, large = (applied(what, what.on, seen, size) for size in (what.first, what.most))
    changed = [n for n in seen if np.abs(large[n] - seen[n]).max() > 0.0]
    assert changed
    moved = [float(np.mean((each[changed[0]] - seen[changed[0]]) ** 2)) for each in (small, large)]
    assert 0.0 < moved[0] < moved[1]
    other = "input" if what.on == "output" else "output"
    for unchanged in (applied(what, other, seen, 1.0), applied(what, what.on, seen, 0.0)):
        assert all(unchanged[name] is seen[name] for name in seen)


def test_a_deadband_holds_and_jumps_but_leaves_no_play():
    lever = np.array([0.0, 0.5, 1.0, 1.5, 1.4, 0.6, 0.4, 0.0])
    told = applied(DEADBAND, "input", {"TRA_deg": lever}, 0.9)["TRA_deg"]
    np.testing.assert_array_equal(told, [0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0])


def test_an_engine_that_cannot_fly_names_the_case(monkeypatch, quick, tmp_path):
    def broken(*_):
        raise ModelError("has no solution", row=7)

    monkeypatch.setattr(truth.VirtualEngine, "simulate", broken)
    with pytest.raises(ModelError, match=r"case_001, row 7: has no solution. Take another --seed"):
        make_case(tmp_path, PLAN, case())


def test_a_changed_log_a_lost_one_and_a_changed_list_are_noticed(made):
    file = made / "case_001" / "sim" / "flight_0.csv.gz"
    content = file.read_bytes()
    file.write_bytes(gzip.compress(gzip.decompress(content) + b"\n", mtime=0))
    with pytest.raises(DataError, match=r"flight_0.csv.gz: the log was changed since it was made"):
        open_key(made, "4")
    file.unlink()
    with pytest.raises(DataError, match=r"flight_0.csv.gz: the log is gone"):
        read_cases(made)
    file.write_bytes(content)
    assert open_key(made, "4")["cases"]
    document = json.loads((made / "cases.json").read_text("utf-8"))
    document["logs"]["case_001"]["sim/flight_0.csv.gz"] = "0" * 64
    (made / "cases.json").write_text(json.dumps(document), "utf-8")
    with pytest.raises(ConfigError, match="the key does not open"):
        open_key(made, "4")


def test_a_changed_and_a_lost_key_are_noticed(made):
    key = made / "key.json.sealed"
    content = bytearray(key.read_bytes())
    content[-1] ^= 1
    key.write_bytes(bytes(content))
    with pytest.raises(ConfigError, match="the key does not open"):
        open_key(made, "4")
    key.unlink()
    with pytest.raises(DataError, match="there is no key"):
        open_key(made, "4")


def test_a_folder_of_something_else(tmp_path):
    with pytest.raises(DataError, match=r"cases.json: cannot be read: No such file"):
        read_cases(tmp_path)
    (tmp_path / "cases.json").write_text("{", "utf-8")
    with pytest.raises(DataError, match="not JSON"):
        read_cases(tmp_path)
    (tmp_path / "cases.json").write_text("[]", "utf-8")
    with pytest.raises(DataError, match=r"expected schema 'narxcal.blind/1', found"):
        read_cases(tmp_path)
