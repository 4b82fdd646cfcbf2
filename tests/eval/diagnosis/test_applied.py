"""Found effects are added to any simulated log, on its own raster."""

import json
from dataclasses import replace

import numpy as np
import pytest

from eval.diagnosis.applied import (
    EMULATED,
    INPUTS,
    OUTPUTS,
    SHIFTED,
    FoundEffects,
    read_effects,
    signals_to_json,
)
from eval.diagnosis.simulators import open_simulator
from narxcal.effects.operators import delay, lag, play
from narxcal.support.errors import ConfigError, DataError, ModelError
from tests.narxcal import fmu_source


@pytest.fixture
def signals(make_data):
    return make_data(flights=1).flights.signals


def test_a_sensor_effect_acts_on_the_raster_of_the_log(signals, fly, log_of, probe):
    sim = fly(3, rate_hz=32.0)
    found = FoundEffects({"sensor_lag:EGT_C": {"tau_s": 1.0}}, signals, None)
    outputs = found.added_to(log_of(sim))
    # The effect takes the channel for straight lines between samples, the probe for steps.
    np.testing.assert_allclose(outputs["EGT_C"], probe(sim)["EGT_C"], atol=6.0)
    np.testing.assert_array_equal(outputs["N1_pct"], sim["N1_pct"])


def test_an_input_that_never_changed_may_be_missing(signals, fly, log_of):
    bare = fly(3)
    del bare["dT_C"], bare["Mach"]
    delay = FoundEffects({"throttle_delay": {"delay_s": 0.5}}, signals, None)
    assert np.ptp(delay.added_to(log_of(bare))["N1_pct"] - bare["N1_pct"]) > 1.0
    told = []

    def listen(log):
        told.extend(log.channels)
        return simulate(log)

    delay.run_again(log_of(bare), listen)
    assert not {"dT_C", "Mach"} & set(told)
    inside = FoundEffects({"spool_lag": {"factor": 1.5}}, signals, Halving())
    with pytest.raises(DataError, match="channel Mach: the flights that were diagnosed have it"):
        inside.added_to(log_of(bare))


@pytest.mark.parametrize("rate_hz", [4.0, 5.0, 12.0, 33.0])
def test_logs_may_be_at_any_rate(signals, fly, log_of, rate_hz):
    sim = log_of(fly(3, rate_hz=rate_hz))
    found = FoundEffects({"throttle_delay": {"delay_s": 0.5}}, signals, None)
    n1, moved = sim["N1_pct"], found.added_to(sim)["N1_pct"]
    late = np.interp(sim.time_s - 0.5, sim.time_s, n1)
    assert np.sqrt(np.mean((moved - late) ** 2)) < 0.2 * np.sqrt(np.mean((n1 - late) ** 2))


def test_no_effect_changes_nothing(signals, fly, log_of):
    sim = fly(3)
    outputs = FoundEffects({}, signals, None).added_to(log_of(sim))
    np.testing.assert_array_equal(outputs["EGT_C"], sim["EGT_C"])


def test_a_hole_in_what_the_simulator_says_stays_a_hole_and_spoils_nothing_else(
    signals, fly, log_of
):
    """A lag that hears NaN once would say NaN to the end of the log."""
    whole, holed = fly(3), fly(3)
    hole = slice(100, 140)
    # Bridged on a straight line in both logs, so that all else has to be the same.
    line = np.linspace(whole["EGT_C"][99], whole["EGT_C"][140], 42)[1:-1]
    whole["EGT_C"][hole], holed["EGT_C"][hole] = line, np.nan
    for name in ("sensor_lag:EGT_C", "throttle_delay"):
        values = {name: {"tau_s": 1.0} if ":" in name else {"delay_s": 0.5}}
        found = FoundEffects(values, signals, None)
        expected, got = found.added_to(log_of(whole)), found.added_to(log_of(holed))
        again = found.run_again(log_of(fly(3)), lambda _: {n: holed[n] for n in signals.outputs})
        for made in (got, again):
            assert np.isnan(made["EGT_C"][hole]).all()
            assert np.isfinite(np.delete(made["EGT_C"], hole)).all()
        known = np.isfinite(got["EGT_C"])
        np.testing.assert_allclose(got["EGT_C"][known], expected["EGT_C"][known])


def test_an_output_of_which_the_simulator_says_nothing_is_refused(signals, fly, log_of):
    mute = fly(3)
    mute["EGT_C"][:] = np.nan
    with pytest.raises(DataError) as caught:
        FoundEffects({"throttle_delay": {"delay_s": 0.5}}, signals, None).added_to(log_of(mute))
    assert str(caught.value) == (
        "flight, channel EGT_C: no simulated sample is known. Simulate the flight anew, or leave "
        "the log out"
    )


def test_logs_that_do_not_fit_are_refused(signals, fly, log_of):
    found = FoundEffects({"throttle_delay": {"delay_s": 0.5}}, signals, object())
    bare = fly(3)
    del bare["NAI"]
    with pytest.raises(
        DataError, match=r"channel NAI: the flights that were diagnosed have it, .* It has TRA_deg"
    ):
        found.added_to(log_of(bare))


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("{", "not JSON"),
        ("[]", "expected schema 'narxcal.gap/2', found None"),
        ('{"schema": "narxcal.evaluate/1"}', "found 'narxcal.evaluate/1'. Name the gap.json"),
        (
            '{"schema": "narxcal.gap/1"}',
            (
                "expected schema 'narxcal.gap/2', found 'narxcal.gap/1'. Name the gap.json that "
                "narxcal diagnose wrote, or diagnose again"
            ),
        ),
        ('{"schema": "narxcal.gap/2"}', "a part is missing or damaged: KeyError: 'quality'"),
        (
            '{"schema": "narxcal.gap/2", "quality": {"signals": {"inputs": []}}}',
            "a part is missing or damaged: KeyError: 'outputs'. Name the gap.json",
        ),
        (
            (
                '{"schema": "narxcal.gap/2", "quality": {"signals": {"inputs": [], "outputs": [], '
                '"dt_s": 1.0, "driver": 0, "low": [], "high": [], "lever": [0.0]}}}'
            ),
            "a part is missing or damaged: TypeError",
        ),
        (
            '{"schema": "narxcal.gap/2", "effects": ["sensor_lag"]}',
            "a part is missing or damaged: AttributeError",
        ),
    ],
)
def test_what_is_no_diagnosis_is_refused(tmp_path, text, problem):
    file = tmp_path / "gap.json"
    with pytest.raises(ConfigError, match="cannot be read"):
        read_effects(file)
    file.write_text(text, "utf-8")
    with pytest.raises(ConfigError, match=problem):
        read_effects(file)


def test_what_diagnose_stored_comes_back(tmp_path, signals):
    stored = {
        "schema": "narxcal.gap/2",
        "verdict": {"effects": ["sensor_lag:EGT_C"]},
        "effects": [
            {"id": "sensor_lag", "channel": "EGT_C", "parameters": {"tau_s": {"value": 1.5}}}
        ],
        "quality": {"signals": signals_to_json(signals)},
    }
    (tmp_path / "gap.json").write_text(json.dumps(stored), "utf-8")
    found = read_effects(tmp_path / "gap.json")
    assert found.values == {"sensor_lag:EGT_C": {"tau_s": 1.5}}
    assert found.signals.active == signals.active
    np.testing.assert_array_equal(found.signals.high, signals.high)
    assert found.emulator is None
    assert read_effects(tmp_path).values == found.values


def test_of_two_flights_of_one_name_no_window_is_known(tmp_path, signals):
    """One was diagnosed, the other held out: nobody can say which of them is meant."""

    def window(log, start_s, *, held_out):
        times = {"log_start_s": 10.0, "start_s": start_s, "end_s": start_s + 5.0}
        return {"log": log, **times, "held_out": held_out}

    spells = [window("f1", 20.0, held_out=False), window("f1", 70.0, held_out=True)]
    spells.append(window("f2", 30.0, held_out=True))
    load = {"id": "unlogged_switch", "parameters": {}, "windows": spells}
    stored = {
        "schema": "narxcal.gap/2",
        "verdict": {"effects": ["unlogged_switch"]},
        "effects": [load],
        "quality": {
            "signals": signals_to_json(signals),
            "flights": ["f0", "f1"],
            "held_out": ["f1", "f2"],
        },
    }
    (tmp_path / "gap.json").write_text(json.dumps(stored), "utf-8")
    found = read_effects(tmp_path)
    assert found.windows == {"f2": ((20.0, 25.0),)}
    assert [found.load_known(name) for name in ("f0", "f1", "f2", "f3")] == [
        True,
        False,
        True,
        False,
    ]


def simulate(log):
    """A simulator that can be run again: N1 with a lag, the others at once."""
    lever = log["TRA_deg"] / 70.0
    lagged = lag(lever[None], np.array([1.5]), log.dt_s)[0]
    found = {"N1_pct": 25.0 + 75.0 * lagged, "N2_pct": 55.0 + 45.0 * lever}
    return {**found, "EGT_C": 400.0 + 350.0 * lever, "FN_kN": 30.0 * lagged}


def test_a_simulator_that_can_be_run_again_is_told_what_arrives(signals, fly, log_of):
    log = log_of(fly(3, rate_hz=5.0))  # any rate will do where no emulator is asked
    found = FoundEffects({"throttle_backlash": {"width_deg": 4.0}}, signals, None)
    arrives = play(log["TRA_deg"][None], np.array([4.0]))[0]
    expected = simulate(log.with_channels({"TRA_deg": arrives}))
    outputs = found.run_again(log, simulate)
    for name, values in expected.items():
        np.testing.assert_array_equal(outputs[name], values)
    assert np.ptp(outputs["FN_kN"] - simulate(log)["FN_kN"]) > 0.5


def test_what_is_recorded_of_the_outputs_is_not_told(signals, fly, log_of):
    told = []

    def listen(log):
        told.extend(log.channels)
        return simulate(log)

    FoundEffects({}, signals, None).run_again(log_of(fly(3)), listen)
    assert "N1_pct" not in told
    assert {"TRA_deg", "ALT_ft", "NAI"} <= set(told)


def test_readings_are_changed_behind_the_simulator(signals, fly, log_of):
    log = log_of(fly(3, rate_hz=32.0))
    values = {"throttle_delay": {"delay_s": 0.5}, "time_skew:EGT_C": {"skew_s": 0.3125}}
    outputs = FoundEffects(values, signals, None).run_again(log, simulate)
    late = delay(log["TRA_deg"][None], np.array([0.5]), log.dt_s)[0]
    expected = simulate(log.with_channels({"TRA_deg": late}))
    skewed = delay(expected["EGT_C"][None], np.array([0.3125]), log.dt_s)[0]
    np.testing.assert_array_equal(outputs["N1_pct"], expected["N1_pct"])
    np.testing.assert_allclose(outputs["EGT_C"], skewed, rtol=1e-9)


class Halving:
    """An emulator in which any other pace is 3 more, and which notes what it is told."""

    told = None

    def run(self, _flights, told, pace=None, _shift=None):
        self.told = told
        changed = 0.0 if pace is None or pace.fan_up[0] == 1.0 else 3.0
        return np.zeros((*told.shape[:2], 3)) + changed


def test_only_what_changes_the_pace_is_asked_of_the_emulator(signals, fly, log_of):
    log = log_of(fly(3, rate_hz=16.0))
    values = {"throttle_bias": {"bias_deg": 3.0}, "spool_lag": {"factor": 1.5}}
    emulator = Halving()
    outputs = FoundEffects(values, signals, emulator).run_again(log, simulate)
    expected = simulate(log.with_channels({"TRA_deg": log["TRA_deg"] + 3.0}))
    np.testing.assert_allclose(outputs["N1_pct"], expected["N1_pct"] + 3.0)
    lever = emulator.told[0, :, signals.u("TRA_deg")]
    assert lever.max() == pytest.approx(log["TRA_deg"].max() + 3.0)  # of the engine as it is told


class Losing:
    """An emulator in which heat that metal takes is 3 less."""

    def run(self, _flights, told, pace=None, _shift=None):
        lost = np.zeros(len(told)) if pace is None else np.where(pace.loss > 0.0, 3.0, 0.0)
        return np.zeros((*told.shape[:2], 3)) - lost[:, None, None]


def test_what_an_effect_does_to_pace_and_to_readings_is_added_once_each(signals, fly, log_of):
    log = log_of(fly(3, rate_hz=16.0))
    shares = {"tau_s": 20.0, "rise_s": 0.0, "share_EGT_C": -0.4}
    dry, soaked = (
        FoundEffects({"heat_soak": {**shares, "loss": loss}}, signals, Losing()).run_again(
            log, simulate
        )
        for loss in (0.0, 5.0)
    )
    np.testing.assert_allclose(soaked["N1_pct"], dry["N1_pct"] - 3.0)
    assert np.abs(dry["EGT_C"] - simulate(log)["EGT_C"]).max() > 20.0
    np.testing.assert_allclose(
        soaked["EGT_C"], dry["EGT_C"] - 3.0, atol=4.0
    )  # shares go with power


class Settling:
    """An emulator that is at once where it settles."""

    def run(self, _flights, told, _pace=None, shift=None):
        return np.zeros((*told.shape[:2], 3)) + (0.0 if shift is None else shift.settled)


def test_where_an_effect_makes_it_settle_is_the_emulators_all_of_it(signals, fly, log_of):
    log = log_of(fly(3, rate_hz=16.0))
    log = log.with_channels({"Approach": np.ones(len(log))})
    names = (*signals.inputs, "Approach")
    known = replace(signals, inputs=names, active=(*signals.active, "Approach"))
    sizes = {"meets": 0.5, "idle_N1_pct": 2.0, "idle_N2_pct": 1.0, "idle_EGT_C": 8.0}
    found = FoundEffects({"idle_schedule": sizes}, known, Settling())
    assert found.ways(again=True) == {"idle_schedule": EMULATED}
    outputs, low = found.run_again(log, simulate), known.lever[0]
    lever = (log["TRA_deg"] - low) / (known.lever[1] - low)
    floor = np.maximum(0.0, 1.0 - lever / 0.5)
    assert floor.max() > 0.5
    as_it_is = simulate(log)
    still = np.abs(np.gradient(lever)) < 1e-6
    for name, size in (("N1_pct", 2.0), ("N2_pct", 1.0), ("EGT_C", 8.0)):
        np.testing.assert_allclose(
            (outputs[name] - as_it_is[name])[still], size * floor[still], atol=0.05 * size
        )


def test_a_pace_needs_the_stored_emulator(signals, fly, log_of):
    found = FoundEffects({"spool_lag": {"factor": 1.5}}, signals, None)
    with pytest.raises(ConfigError, match="'spool_lag' acts inside the engine: it needs an emul"):
        found.run_again(log_of(fly(3)), simulate)


def test_a_simulator_without_the_output_is_refused(signals, fly, log_of):
    found = FoundEffects({"throttle_bias": {"bias_deg": 1.0}}, signals, None)
    with pytest.raises(
        ModelError, match=r"channel N2_pct: the simulator does not give it, .* It gives N1_pct"
    ):
        found.run_again(log_of(fly(3)), lambda log: {"N1_pct": log["TRA_deg"]})


def test_it_is_told_how_each_effect_is_applied(signals):
    values = {
        "throttle_bias": {"bias_deg": 1.0},
        "throttle_delay": {"delay_s": 0.2},
        "spool_lag": {"factor": 1.5},
        "sensor_lag:EGT_C": {"tau_s": 1.2},
    }
    found = FoundEffects(values, signals, None)
    assert list(found.ways(again=True).values()) == [INPUTS, INPUTS, EMULATED, OUTPUTS]
    assert list(found.ways(again=False).values()) == [EMULATED, SHIFTED, EMULATED, OUTPUTS]


def test_an_fmu_is_run_again_with_the_effect_on_its_inputs(tmp_path, signals, fly, log_of):
    pytest.importorskip("fmpy", reason="FMUs need the extra `fmu`")
    fmu = open_simulator(str(fmu_source.build(tmp_path / "engine.fmu", 2))).how
    log = log_of(fly(0, 60.0))
    one = signals_of_n1(signals)
    found = FoundEffects({"throttle_backlash": {"width_deg": 6.0}}, one, None)
    outputs = found.run_again(log, fmu)
    arrives = play(log["TRA_deg"][None], np.array([6.0]))[0]
    np.testing.assert_allclose(
        outputs["N1_pct"][20:], fmu(log.with_channels({"TRA_deg": arrives}))["N1_pct"][20:]
    )
    # The play holds the lever back by half of its width: 3 deg are 2.7 % of N1.
    late = np.abs(outputs["N1_pct"] - fmu(log)["N1_pct"])[20:]
    assert np.median(late) == pytest.approx(2.7, abs=0.05)


def signals_of_n1(signals):
    column = [signals.outputs.index("N1_pct")]
    low, high = signals.low[column], signals.high[column]
    return replace(signals, outputs=("N1_pct",), low=low, high=high)
