"""Cases onto the logs of a simulator that cannot be run again: only the content is added."""

import numpy as np
import pandas as pd
import pytest

from eval.diagnosis.blind.cases import OFFSETS, BlindPlan, draw_cases
from eval.diagnosis.blind.files import open_key
from eval.diagnosis.blind.make import write_key
from eval.diagnosis.blind.sim_logs import (
    SHIFTS,
    LogSpecimen,
    make_log_cases,
    offer_of,
    switches_of,
)
from eval.diagnosis.blind.truth import NOTHING, Flight
from eval.diagnosis.pairs import read_folder
from narxcal.effects.library import name_of
from narxcal.flight_test.signals import first_order
from narxcal.support.errors import DataError

PLAN = BlindPlan(cases=5, flights=3, held_out=2, seed=3)


def channels(number, days=True):
    random = np.random.default_rng(number)
    time_s = np.arange(0.0, 600.0, 0.125)
    lever = np.where((time_s // 40.0) % 2, 60.0, 15.0) + 5.0 * np.sin(time_s / (60.0 + number))
    power = first_order(lever / 85.0, 1.5, 0.125)
    return {
        "time_s": time_s,
        "TRA_deg": lever,
        "ALT_ft": 5000.0 + 10.0 * time_s,
        "Mach": 0.4 + 0.0 * time_s,
        "dT_C": (random.uniform(-10.0, 10.0) if days else 3.0) + 0.0 * time_s,
        "NAI": (time_s > 300.0) * 1.0,
        "N1_pct": 25.0 + 75.0 * power,
        "N2_pct": 55.0 + 45.0 * power,
        "EGT_C": 400.0 + 350.0 * first_order(power, 0.7, 0.125),
    }


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    given = tmp_path_factory.mktemp("given")
    for number in range(6):
        folder = given / "case_X" / ("sim" if number < 4 else "sim_heldout")
        folder.mkdir(parents=True, exist_ok=True)
        pd.DataFrame(channels(number)).to_csv(folder / f"flight_{number}.csv", index=False)
    return given


@pytest.fixture(scope="module")
def cases(logs, tmp_path_factory):
    folder = tmp_path_factory.mktemp("cases")
    write_key(folder, PLAN, "3", make_log_cases(folder, PLAN, logs))
    return folder


def test_the_simulator_is_given_as_it_was_and_the_inputs_too(cases, logs):
    given = {f.stem: pd.read_csv(f) for f in logs.rglob("*.csv")}
    for name, row in open_key(cases, "3")["cases"].items():
        assert (row["style"], row["engine"]) == ("maker", "maker")
        files = sorted((cases / name).glob("sim*/*"))
        assert len(files) == 5
        for file in files:
            sim = pd.read_csv(file)
            real = pd.read_csv(str(file).replace("/sim", "/real"))
            assert any(np.allclose(sim, each) for each in given.values())
            for channel in ("time_s", "TRA_deg", "ALT_ft", "NAI"):
                np.testing.assert_array_equal(sim[channel], real[channel])
            assert np.abs(real["N1_pct"] - sim["N1_pct"]).max() > 0.01


def test_the_key_says_what_and_where(cases):
    rows = list(open_key(cases, "3")["cases"].values())
    assert {row["kind"] for row in rows} == {"null", "single", "pair", "outside"}
    for row in rows:
        assert sum(cause["share"] for cause in row["budget"].values()) == pytest.approx(1.0)
        assert {name_of(effect) for effect in row["effects"]} <= {*row["budget"]}
        assert row["base"]["misfit"] or row["kind"] != "null"


def test_too_few_flights(logs, tmp_path):
    plan = PLAN.model_copy(update={"flights": 5})
    with pytest.raises(DataError, match="there are 6 simulated flights, and a case needs 7"):
        next(make_log_cases(tmp_path, plan, logs))


def test_effects_that_these_logs_cannot_hold_are_left_out(tmp_path):
    folder = tmp_path / "given"
    folder.mkdir()
    for number in range(5):
        table = pd.DataFrame(channels(number, days=False)).drop(columns="NAI")
        table.to_csv(folder / f"flight_{number}.csv", index=False)
    plan = PLAN.model_copy(update={"cases": 40})
    drawn = draw_cases(plan, offer_of(list(read_folder(folder).values())))
    names = {effect.id for each in drawn for effect in each.effects}
    assert names >= {"heat_soak", "deterioration", "throttle_delay", "sensor_lag"}
    assert not names & {"bleed_extraction", "temperature_effect", "spool_lag", "flowmeter_dynamics"}


@pytest.mark.parametrize("effect", SHIFTS)
def test_shifts_are_proportional_to_their_size(effect):
    given = channels(1)
    flight, power = Flight(0, given, ((100.0, 160.0),)), (given["N1_pct"] - 25.0) / 75.0
    small, large = (SHIFTS[effect](flight, power, size) for size in (0.01, 0.02))
    for name in set(small) & set(given):
        np.testing.assert_allclose(large[name], 2.0 * small[name], rtol=1e-9, atol=1e-12)
        assert np.abs(small[name]).max() > 0.0


def test_a_hidden_load_acts_in_its_windows_and_a_bleed_with_its_switch():
    given = channels(1)
    flight, power = Flight(0, given, ((100.0, 160.0),)), (given["N1_pct"] - 25.0) / 75.0
    assert switches_of(given) == ("NAI",)
    time_s = given["time_s"]
    for effect, on in (
        ("unlogged_switch", (time_s >= 100.0) & (time_s < 160.0)),
        ("bleed_extraction", time_s > 300.0),
    ):
        hotter = SHIFTS[effect](flight, power, 0.02)["EGT_C"]
        first = np.argmax(on)
        assert np.all(hotter[:first] == 0.0)
        assert hotter[on][80:].min() > 5.0


def test_offsets_are_most_of_their_gap():
    for case in draw_cases(BlindPlan(cases=120)):
        if any(effect.id in OFFSETS for effect in case.effects):
            assert case.share >= 0.9


def test_of_the_same_build_noise_alone_is_added(logs):
    plan = PLAN.model_copy(update={"build": "same"})
    flights = [log for part in ("sim", "sim_heldout") for log in folder_logs(logs, part)]
    for case in draw_cases(plan, offer_of(flights)):
        assert not case.base.differs
        specimen = LogSpecimen(case._replace(kind="null", effects=(), strange=None), plan, flights)
        flight = specimen.flight(0)
        simulated, recorded = specimen.simulated(flight), specimen.both(flight, NOTHING)[1]
        noise = recorded["EGT_C"] - simulated["EGT_C"]
        assert noise.std() == pytest.approx(1.0, rel=0.1)
        assert abs(noise.mean()) < 0.1


def folder_logs(logs, part):
    return read_folder(logs / "case_X" / part).values()
