"""What [steady_state] leaves to "auto" is chosen by what the logs say, and by nothing else."""

import numpy as np
import pytest

from data_prep.log import Log, Source
from narxcal.atmosphere import air_state
from narxcal.support.errors import ConfigError, DataError
from training.config import RunConfig
from training.steady.steady_choice import chosen_layout, steady_state

HOLD = 40  # samples, 1 s apart
NAMES = ("N1_pct", "EGT_C")


def flight(number, engine, switches=()):
    """A staircase of lever, altitude and Mach, all drawn; outputs settle at once."""
    rng = np.random.default_rng(number)

    def stairs(low, high):
        return np.repeat(rng.uniform(low, high, 60), HOLD)

    channels = {
        "TRA_deg": stairs(0, 80),
        "ALT_ft": stairs(0, 35000),
        "Mach": stairs(0.1, 0.8),
        "dT_C": np.full(60 * HOLD, rng.uniform(-20, 20)),
    }
    for name in switches:
        channels[name] = np.repeat((rng.random(60) < 0.4) * 1.0, HOLD)
    outputs = engine(channels)
    noise = rng.normal(0.0, 0.05, (2, 60 * HOLD))
    measured = {name: outputs[k] + noise[k] for k, name in enumerate(NAMES)}
    time = np.arange(60.0 * HOLD)
    return Log(f"{number}", time, {**channels, **measured}, source=Source(f"{number}.csv"))


def as_asked(channels):
    """A control that holds the speed that the lever asks for, whatever the air."""
    x = channels["TRA_deg"] / 80
    return 25 + 70 * x**0.9 + 2 * channels["Mach"], 400 + 300 * x


def similar(channels):
    """An engine that follows the similarity laws."""
    air = air_state(channels["ALT_ft"], channels["Mach"], channels["dT_C"])
    n1, egt = as_asked({**channels, "Mach": channels["Mach"] * 5})
    return n1 * np.sqrt(air.theta2), (egt + 273.15) * air.theta2 - 273.15


def bled(channels):
    n1, egt = similar(channels)
    return n1 - 1.5 * channels["NAI"], egt + 15 * channels["NAI"]


def config(**section):
    table = {"steady_state": section, "narx": {"outputs": list(NAMES)}}
    return RunConfig.parse(table)


def logs(engine, switches=(), count=3):
    return [flight(number, engine, switches) for number in range(count)]


@pytest.mark.parametrize(("engine", "corrected"), [(as_asked, False), (similar, True)])
def test_similarity_laws_are_used_where_the_engine_follows_them(engine, corrected):
    assert chosen_layout(config(), logs(engine)).corrected is corrected


def test_a_switch_that_shifts_outputs_becomes_an_input_and_one_that_does_not_stays_away():
    flights = logs(bled, ("ECS", "NAI"))
    model, quality = steady_state(config(), None, flights)
    assert model.layout.switches == ("NAI",)
    assert model.input_names == ("TRA_deg", "ALT_ft", "Mach", "dT_C", "NAI")
    assert quality.rms["EGT_C"] < 3.0
    at = np.array([[40.0, 0.0, 0.3, 0.0, 0.0], [40.0, 0.0, 0.3, 0.0, 1.0]])
    off, on = model.outputs(at)
    np.testing.assert_allclose(on - off, [-1.5, 15.0], atol=0.4, rtol=0.1)


@pytest.mark.parametrize(("driver", "used"), [("TRA_deg", ("Approach",)), ("FF_kgph", ())])
def test_an_idle_switch_is_one_of_the_lever_and_not_of_the_fuel(driver, used):
    def other_idle(channels):
        return bled({**channels, "NAI": channels["Approach"]})

    flights = logs(other_idle, ("Approach",))
    air = [air_state(log["ALT_ft"], log["Mach"], log["dT_C"]) for log in flights]
    fuel = [
        np.exp(0.02 * log["TRA_deg"]) * 100.0 * each.delta2 * np.sqrt(each.theta2)
        for log, each in zip(flights, air, strict=True)
    ]
    flights = [
        log.with_channels({"FF_kgph": each}) for log, each in zip(flights, fuel, strict=True)
    ]
    asked = config(inputs=[driver, "ALT_ft", "Mach", "dT_C"], driver=driver)
    assert chosen_layout(asked, flights).switches == used


def test_a_switch_that_is_on_for_seconds_is_used_where_left_out_recordings_say_so():
    flights = logs(bled, ("NAI",))
    for number, log in enumerate(flights):
        on = np.zeros(len(log))
        on[(20 + number) * HOLD :][:HOLD] = 1.0
        change = {"N1_pct": -1.5, "EGT_C": 15.0}
        moved = {name: log[name] + by * (on - log["NAI"]) for name, by in change.items()}
        flights[number] = log.with_channels({"NAI": on, **moved})
    assert chosen_layout(config(), flights).switches == ("NAI",)


def test_switches_that_hide_each_other_are_used_together():
    def hidden(channels):
        n1, egt = similar(channels)
        both = channels["NAI"] - channels["WAI"]
        return n1 + 3 * both, egt + 30 * both

    flights = []
    for log in logs(similar, ("NAI",)):
        other = log["NAI"].copy()
        for stair in range(0, 60, 30):  # elsewhere they go together
            rows = slice(stair * HOLD, (stair + 1) * HOLD)
            other[rows] = 1.0 - other[rows]
        channels = {**log.channels, "WAI": other}
        outputs = dict(zip(NAMES, hidden(channels), strict=True))
        flights.append(log.with_channels({"WAI": other, **outputs}))
    assert chosen_layout(config(), flights).switches == ("NAI", "WAI")


def with_own_exponents(channels):
    """Exponents of theta and delta as engines have them, not those of similarity."""
    air = air_state(channels["ALT_ft"], channels["Mach"], channels["dT_C"])
    n1, egt = as_asked({**channels, "Mach": 0.0})
    n1 = n1 * air.theta2**0.42 * air.delta2**-0.01
    return n1, (egt + 273.15) * air.theta2**0.8 - 273.15


def test_exponents_of_the_air_are_fitted_and_stay_away_where_similarity_is_exact():
    high = flight(9, with_own_exponents)
    above = high.with_channels({"ALT_ft": high["ALT_ft"] * 0.1 + 33000.0})
    truth = np.column_stack(with_own_exponents(above.channels))
    left = {}
    for exponents in ("auto", []):
        asked = config(exponents=exponents)
        model, _ = steady_state(asked, None, logs(with_own_exponents))
        assert model.layout.exponents == (("theta", "delta") if exponents else ())
        error = model.outputs(above.matrix(model.input_names)) - truth
        left[bool(exponents)] = np.sqrt((error**2).mean(axis=0))
    assert (left[True] < 0.7 * left[False]).all()
    model, _ = steady_state(config(), None, logs(similar))
    assert np.abs(model.air_lines[:, 0, 0]).max(initial=0.0) < 1.0  # % per unit of ln ratio


@pytest.mark.parametrize(
    ("inputs", "blend"),
    [
        (["TRA_deg", "ALT_ft", "Mach", "dT_C"], ("Mach",)),
        (["TRA_deg", "ALT_ft", "dT_C"], ("ALT_ft",)),
        (["TRA_deg", "Mach"], ("Mach",)),
    ],
)
def test_curves_are_usually_blended_over_mach_or_over_altitude_without_it(inputs, blend):
    assert chosen_layout(config(inputs=inputs), logs(similar)).blend == blend


def test_curves_are_not_blended_between_corners_close_together():
    """Pressure altitude drifts by some hundred feet; a fault of a sensor drifts along."""
    near = []
    for log in logs(similar):
        drift = np.linspace(0.0, 1.0, len(log))
        still = {"ALT_ft": 1500.0 + 200.0 * drift, "Mach": np.full(len(log), 0.3)}
        outputs = dict(zip(NAMES, similar({**log.channels, **still}), strict=True))
        outputs["EGT_C"] = outputs["EGT_C"] + 20.0 * drift
        near.append(log.with_channels({**still, **outputs}))
    assert chosen_layout(config(), near).blend == ()


def test_air_that_is_not_recorded_is_said_to_be_assumed():
    layout = chosen_layout(config(inputs=["TRA_deg", "ALT_ft"]), logs(similar))
    assert (layout.corrected, layout.assumed) == (True, ("Mach", "dT_C"))
    assert chosen_layout(config(), logs(similar)).assumed == ()


def test_one_recording_is_judged_on_stretches_of_itself():
    layout = chosen_layout(config(), logs(bled, ("NAI",), count=1))
    assert (layout.corrected, layout.switches) == (True, ("NAI",))


def test_a_switch_that_one_flight_does_not_record_is_not_used():
    flights = [flight(0, similar), flight(1, bled, ("NAI",))]
    assert chosen_layout(config(), flights).switches == ()


def test_what_is_configured_is_not_asked_of_the_logs():
    asked = {"corrected": False, "blend": ["ALT_ft"], "switches": ["ECS"], "exponents": []}
    layout = chosen_layout(config(**asked), logs(bled, ("ECS", "NAI")))
    assert (layout.corrected, layout.blend, layout.switches) == (False, ("ALT_ft",), ("ECS",))
    assert layout.input_names[-1] == "ECS"


def test_corrected_parameters_are_no_choice_without_altitude():
    asked = config(inputs=["TRA_deg", "Mach"], switches=[])
    assert chosen_layout(asked, logs(as_asked)).corrected is False


def test_logs_of_too_few_samples_are_refused_with_what_to_do():
    moving = {"N1_pct": np.linspace(20.0, 100.0, 10)}
    short = [log.part(0, 10).with_channels(moving) for log in logs(similar)[:2]]
    with pytest.raises(DataError) as caught:
        steady_state(config(), None, short)
    assert str(caught.value) == (
        "channel TRA_deg: expected at least 50 samples to fit curves to, found 20. Add logs, or "
        "set [steady_state] kind to table, callable or fmu"
    )


@pytest.mark.parametrize("pushes_s", [(2.0, 4.5), (20.0, 30.0)])
def test_a_level_that_is_nowhere_settled_comes_from_the_motion(pushes_s):
    """One lag of 1.2 s behind a line; short pushes settle at rest alone, long ones everywhere."""
    rng, dt_s, lever, y = np.random.default_rng(0), 0.5, [], 20.0
    while len(lever) < 1100:
        push, rest = (round(t / dt_s) for t in (rng.uniform(*pushes_s), rng.choice([5.0, 30.0])))
        lever += [float(rng.choice([10, 20, 35, 50, 70]))] * push + [0.0] * rest
    speed = np.empty(len(lever))
    for k, at in enumerate(lever):
        y += (20.0 + 0.9 * at - y) * (1.0 - np.exp(-dt_s / 1.2))
        speed[k] = y
    channels = {
        "TRA_deg": np.array(lever),
        "N1_pct": speed + rng.normal(0.0, 0.2, len(lever)),
        **{name: np.zeros(len(lever)) for name in ("ALT_ft", "Mach", "dT_C")},
    }
    log = Log("moving", dt_s * np.arange(len(lever)), channels)
    section = {"narx": {"outputs": ["N1_pct"]}, "events": {"driver": "TRA_deg"}}
    found = RunConfig.parse({**section, "steady_state": {"corrected": False, "blend": []}})
    model, quality = steady_state(found, None, [log])
    at = np.array([[lever, 0.0, 0.0, 0.0] for lever in (0.0, 20.0, 50.0, 70.0)])
    np.testing.assert_allclose(model.outputs(at)[:, 0], 20.0 + 0.9 * at[:, 0], atol=1.0)
    assert (quality.coverage < 1.0 / 3.0) == (pushes_s[0] < 10.0)


def test_what_is_no_switch_is_refused():
    with pytest.raises(ConfigError, match="'Mach' is no switch; switches are WOW, Approach, ECS"):
        config(switches=["Mach"])


def test_a_temperature_may_turn_where_speeds_may_not():
    def turbojet(channels):
        x = channels["TRA_deg"] / 80
        return 33 + 67 * x, 560 - 300 * x + 350 * x**2

    model, _ = steady_state(config(corrected=False, blend=[]), None, logs(turbojet))
    lever = np.linspace(5, 75, 15)
    n1, egt = model.outputs(np.column_stack([lever, *np.zeros((3, 15))])).T
    assert (np.diff(n1) > 0).all()
    np.testing.assert_allclose(egt, 560 - 300 * lever / 80 + 350 * (lever / 80) ** 2, atol=4)
