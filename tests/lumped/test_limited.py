"""The lags: a slow twin, closed forms, an exact equilibrium, and what must not matter."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from narxcal.atmosphere import air_state
from narxcal.lumped.engine import LumpedEngine
from narxcal.lumped.limited import LIMITED as PARAMETERS
from narxcal.lumped.limited import UNLIMITED
from narxcal.lumped.states import ROWS
from narxcal.narx.network import AT_START
from narxcal.support.errors import ModelError

NAMES, INPUTS = ("N1_pct", "N2_pct", "EGT_C"), ("ALT_ft", "Mach", "dT_C")
DT_S = 0.1


def lags(names=NAMES, limit=100.0, **values):
    """Lags of 1 s without a meter's lag or a slow part, but for `values`."""
    parameters = np.zeros((len(names), len(PARAMETERS)))
    parameters[:, PARAMETERS.index("log_slow_tau")] = 1.5
    for name in ("log_up", "log_down"):
        parameters[:, PARAMETERS.index(name)] = UNLIMITED
    for name, value in values.items():
        parameters[:, PARAMETERS.index(name)] = value
    kept = {"N1_pct": (60.0, 30.0), "N2_pct": (75.0, 20.0), "EGT_C": (500.0, 150.0)}
    centre, half = np.array([kept[name] for name in names]).T
    scales = {"centre": centre, "half": half, "limit": np.full(len(names), limit)}
    return LumpedEngine.of(names, {"parameters": parameters}, scales)


def part(model, columns):
    """An engine of some of the outputs."""
    scales = {name: getattr(model, name)[columns] for name in ("centre", "half", "limit")}
    names = tuple(model.output_names[column] for column in columns)
    return LumpedEngine.of(names, {"parameters": model.arrays["parameters"][columns]}, scales)


def wild(seed, names=NAMES):
    """Lags and a log of steady-state values, both drawn."""
    rng = np.random.default_rng(seed)
    model = lags(names, limit=rng.uniform(5.0, 60.0))
    model.arrays["parameters"][:] = rng.normal(scale=0.5, size=model.arrays["parameters"].shape)
    ss = model.centre + model.half * np.repeat(rng.uniform(-1.2, 1.2, (8, len(names))), 15, axis=0)
    inputs = rng.uniform([0.0, 0.0, -10.0], [35000.0, 0.8, 10.0], (8, 3))
    return model, np.repeat(inputs, 15, axis=0), ss


def slowly(model, inputs, ss, start):
    """The module's equations, one by one, for outputs N1, N2 and EGT in this order."""
    air = air_state(*inputs.T)
    root, thin = np.sqrt(air.theta2), np.log(np.sqrt(air.theta2) / air.delta2)
    scaled = (ss / root[:, None] - model.centre) / model.half
    settling = np.clip(scaled, -1.5, 1.5)
    # All start in the casing, for the model knows of it.
    fast, soaks, casings = [np.zeros(3)], [np.zeros(3)], [start]
    for k in range(1, len(ss)):
        new, soak, casing = np.zeros(3), np.zeros(3), np.zeros(3)
        speeds = np.clip(scaled[k - 1] - fast[-1] / (root[k] * model.half), -1.5, 1.5)
        for o in (1, 0, 2):
            p = dict(zip(PARAMETERS, model.arrays["parameters"][o], strict=True))
            q = 1 if o == 2 else o  # the EGT goes by the core
            w, v, other = settling[k, q], speeds[q], speeds[0 if o == 1 else 1]
            terms = np.array([1.0, thin[k], v, w, v * v, v * w, w * w])
            log_tau = terms @ model.arrays["parameters"][o, :7] + p["hot"] * math.log(root[k])
            tau = math.exp(np.clip(log_tau, -2.5, 3.0))
            if o != 2:
                way = "up" if w > v else "down"
                of = {
                    "air": thin[k], "speed": v, "speed_speed": v * v, "hot": math.log(root[k]),
                    "other": other, "speed_other": v * other, "other_other": other * other,
                }  # fmt: skip
                most = p[f"log_{way}"] + sum(p[f"{way}_{name}"] * x for name, x in of.items())
                tau = math.hypot(tau, (w - v) / math.exp(np.clip(most, -5.0, UNLIMITED)))
            a, step = math.exp(-DT_S / tau), ss[k, o] - ss[k - 1, o]
            drawn = (tau - p["lead_s"]) * step / DT_S
            if o != 1:
                core = new[1] + soak[1] + casing[1]
                before = fast[-1][1] + soaks[-1][1] + casings[-1][1]
                rate = (ss[k, 1] - core - ss[k - 1, 1] + before) / DT_S
                strength = p["rate_air"] * thin[k] + p["rate_speed"] * speeds[1]
                drawn += core * (p["core"] + p["core_speed"] * (speeds[1] + settling[k, 1]))
                drawn += p["rate"] * math.exp(np.clip(strength, -3.0, 3.0)) * rate
            log_slow = p["log_slow_tau"] - p["heat_rate"] * w + p["heat_air"] * thin[k]
            b = math.exp(-DT_S / math.exp(np.clip(log_slow, 0.0, 4.0)))
            was, now = np.exp(p["heat_speed"] * settling[[k - 1, k], q])
            soak[o] = b * (now / was * soaks[-1][o] + now * p["slow_share"] * step)
            drawn -= p["heat"] * tau * (soak[o] - soaks[-1][o]) / DT_S
            b = math.exp(-DT_S / math.exp(np.clip(p["log_casing_tau"], 2.0, 5.0)))
            casing[o] = b * (casings[-1][o] + p["casing_share"] * step)
            heat = soak[o] + casing[o]
            followed = a * fast[-1][o] + (1 - a) * drawn
            new[o] = np.clip(followed + heat, -model.limit[o], model.limit[o]) - heat
        fast.append(new)
        soaks.append(soak)
        casings.append(casing)
    return np.array(fast) + np.array(soaks) + np.array(casings)


@pytest.mark.slow
@given(seed=st.integers(0, 200))
def test_the_kernel_is_the_equations(seed):
    model, inputs, ss = wild(seed)
    start = np.random.default_rng(seed).normal(size=3)
    expected = slowly(model, inputs, ss, start)
    got = model.deviations(model.drive(inputs, INPUTS, ss), start, DT_S)
    np.testing.assert_allclose(got, expected, rtol=1e-9, atol=1e-9)


def test_a_constant_time_constant_decays_by_the_textbook():
    model, ss = lags(log_tau=math.log(0.7)), np.full((60, 3), 70.0)
    drive = model.drive(np.zeros((60, 3)), INPUTS, ss)
    got = model.deviations(drive, np.array([3.0, -2.0, 40.0]), DT_S)
    decay = np.exp(-DT_S * np.arange(60) / 0.7)
    np.testing.assert_allclose(got, decay[:, None] * [3.0, -2.0, 40.0], rtol=1e-12)


@pytest.mark.parametrize(("lead_s", "behind"), [(0.0, 2.0), (0.5, 1.0), (1.0, 0.0)])
def test_behind_a_ramp_by_the_time_constant_less_the_lag_of_the_meter(lead_s, behind):
    ss = np.repeat(20.0 + 2.0 * DT_S * np.arange(200)[:, None], 3, axis=1)
    model = lags(lead_s=lead_s)
    got = model.deviations(model.drive(np.zeros((200, 3)), INPUTS, ss), np.zeros(3), DT_S)
    np.testing.assert_allclose(got[-1], behind, atol=1e-6)


def test_thin_air_slows_a_spool_by_root_theta_over_delta():
    low = np.zeros((40, 3))
    high = np.tile([35000.0, 0.0, 0.0], (40, 1))
    air = air_state(35000.0)
    slower = float(np.sqrt(air.theta2) / air.delta2)
    model, ss = lags(air=1.0), np.full((40, 3), 70.0)
    once, thin = (
        model.deviations(model.drive(inputs, INPUTS, ss), np.ones(3), DT_S)
        for inputs in (low, high)
    )
    np.testing.assert_allclose(np.log(once[1:]) / np.log(thin[1:]), slower, rtol=1e-9)


@given(seed=st.integers(0, 200))
def test_it_stays_bounded_and_comes_to_rest_whatever_the_parameters(seed):
    model, inputs, ss = wild(seed)
    moving = model.deviations(model.drive(inputs, INPUTS, ss), np.zeros(3), DT_S)
    assert (np.abs(moving) <= model.limit * (1.0 + 1e-12)).all()
    still = np.full((6000, 3), 70.0)
    drive = model.drive(np.tile(inputs[:1], (6000, 1)), INPUTS, still)
    assert np.abs(model.deviations(drive, 0.5 * model.limit, DT_S)[-1]).max() < 1e-3


@given(seed=st.integers(0, 50))
def test_the_order_of_the_outputs_does_not_matter(seed):
    model, inputs, ss = wild(seed)
    order = np.array([2, 0, 1])
    mixed = part(model, order)
    start = np.array([1.0, -2.0, 30.0])
    expected = model.deviations(model.drive(inputs, INPUTS, ss), start, DT_S)
    drive = mixed.drive(inputs, INPUTS, ss[:, order])
    np.testing.assert_allclose(
        mixed.deviations(drive, start[order], DT_S), expected[:, order], rtol=1e-12
    )


@pytest.mark.parametrize(("coupled", "kept"), [(True, [0, 1]), (False, [1])])
def test_a_temperature_acts_on_no_spool_and_a_fan_on_the_core_by_its_limits_alone(coupled, kept):
    model, inputs, ss = wild(3)
    if not coupled:
        coupling = [k for k, name in enumerate(PARAMETERS) if name.endswith("_other")]
        model.arrays["parameters"][1, coupling] = 0.0
    alone = part(model, np.array(kept))
    both = model.deviations(model.drive(inputs, INPUTS, ss), np.zeros(3), DT_S)
    drive = alone.drive(inputs, INPUTS, ss[:, kept])
    spools = alone.deviations(drive, np.zeros(len(kept)), DT_S)
    np.testing.assert_allclose(spools, both[:, kept], rtol=1e-12)


def test_windows_end_to_end_are_windows_alone():
    model, inputs, ss = wild(5)
    drive = model.drive(inputs, INPUTS, ss)
    begins = np.array([0, 40, 90])
    parts = np.random.default_rng(0).normal(size=(3, ROWS, 3))
    found, last_states = model.run(drive, (begins, parts), DT_S)
    for k, (first, last) in enumerate(zip(begins, [40, 90, 120], strict=True)):
        rows = slice(first, last)
        alone, states = model.run(drive.rows(rows), (AT_START, parts[k : k + 1]), DT_S)
        np.testing.assert_array_equal(found[rows], alone)
    np.testing.assert_array_equal(states, last_states)


def test_measured_deviations_make_it_a_one_step_prediction():
    model, inputs, ss = wild(7)
    drive = model.drive(inputs, INPUTS, ss)
    measured = np.random.default_rng(1).normal(size=ss.shape)
    got = model.deviations(drive, measured[0], DT_S, measured)
    state = model.start(measured[0])
    for k in range(1, len(ss)):
        state[0] = measured[k - 1] - state[1] - state[2]
        two = drive.rows(slice(k - 1, k + 1))
        one, state = model.run(two, (AT_START, state[None]), DT_S)
        np.testing.assert_allclose(got[k], one[1], rtol=1e-9, atol=1e-12)
    unknown, start = np.full_like(measured, np.nan), measured[0]
    np.testing.assert_array_equal(
        model.deviations(drive, start, DT_S, unknown), model.deviations(drive, start, DT_S)
    )


def test_missing_air_is_that_of_sea_level():
    model = lags()
    drive = model.drive(np.full((3, 1), 40.0), ("TRA_deg",), np.full((3, 3), 70.0))
    np.testing.assert_allclose(drive.per_unit, np.tile(1.0 / model.half, (3, 1)))
    assert drive.air.shape == (3, 3)
    np.testing.assert_allclose(drive.air, 0.0, atol=1e-12)


def test_an_engine_without_a_speed_goes_by_its_first_output():
    model = lags(("EGT_C",), speed=0.5)
    ss = np.full((30, 1), 500.0)
    drive = model.drive(np.zeros((30, 3)), INPUTS, ss)
    assert model.core == 0
    assert np.abs(model.deviations(drive, np.array([50.0]), DT_S)[-1]) < 5.0


def test_it_comes_back_from_json_and_arrays_as_it_was():
    model, inputs, ss = wild(9)
    again = LumpedEngine.from_arrays(*model.to_arrays())
    drive = model.drive(inputs, INPUTS, ss)
    np.testing.assert_array_equal(
        again.deviations(drive, np.ones(3), DT_S), model.deviations(drive, np.ones(3), DT_S)
    )


@pytest.mark.parametrize("found", [None, np.zeros(2)])
def test_a_lost_or_misshapen_array_is_named(found):
    meta, arrays = lags().to_arrays()
    arrays = {name: value for name, value in arrays.items() if name != "half"}
    arrays |= {} if found is None else {"half": found}
    shape = "None" if found is None else r"\(2,\)"
    with pytest.raises(
        ModelError, match=rf"lag array 'half' has to be of shape \(3,\), found {shape}"
    ):
        LumpedEngine.from_arrays(meta, arrays)


def test_a_limited_spool_moves_no_faster_than_its_control_lets_it():
    ss = np.where(np.arange(300)[:, None] < 5, 40.0, 80.0) * np.ones(3)
    model = lags(log_tau=math.log(0.2), log_up=math.log(0.25))
    got = ss - model.deviations(model.drive(np.zeros((300, 3)), INPUTS, ss), np.zeros(3), DT_S)
    rate = np.diff(got[:, 0]) / DT_S
    # A quarter of the half range in a second, and at half way that is all there is.
    assert rate.max() < 0.25 * 30.0 * 1.01
    assert rate[np.argmin(np.abs(got[:, 0] - 60.0))] == pytest.approx(7.5, rel=0.03)
    assert got[-1, 0] == pytest.approx(80.0, abs=1e-3)
    down = lags(log_tau=math.log(0.2), log_down=math.log(0.25))
    free = ss - down.deviations(down.drive(np.zeros((300, 3)), INPUTS, ss), np.zeros(3), DT_S)
    assert np.diff(free[:, 0]).max() / DT_S > 60.0


def test_a_hot_day_slows_a_limited_spool_by_its_own_power_of_theta():
    ss = np.where(np.arange(80)[:, None] < 5, 60.0, 90.0) * np.ones(3)
    values = {"log_tau": math.log(0.2), "log_up": math.log(0.5)}
    cold, hot = np.zeros((80, 3)), np.tile([0.0, 0.0, 30.0], (80, 1))
    root = math.sqrt(1.0 + 30.0 / 288.15)
    rates = []
    for power, inputs in ((0.0, hot), (-2.0, hot), (-2.0, cold)):
        model = lags(**values, up_hot=power)
        # The same corrected move, so that nothing differs but the day.
        target = ss * (root if inputs is hot else 1.0)
        deviation = model.deviations(model.drive(inputs, INPUTS, target), np.zeros(3), DT_S)
        speed = (target - deviation)[:, 1] / (root if inputs is hot else 1.0)
        rates.append(np.diff(speed)[np.argmin(np.abs(speed - 70.0))])
    assert rates[1] / rates[0] == pytest.approx(root**-2.0, rel=0.02)
    assert rates[2] == pytest.approx(rates[0], rel=0.02)


def test_a_temperature_answers_to_the_acceleration_of_the_core():
    ss = np.repeat(60.0 + 3.0 * DT_S * np.arange(200)[:, None], 3, axis=1)
    plain, hot = lags(), lags()
    hot.arrays["parameters"][2, PARAMETERS.index("rate")] = -5.0
    runs = [
        m.deviations(m.drive(np.zeros((200, 3)), INPUTS, ss), np.zeros(3), DT_S)
        for m in (plain, hot)
    ]
    np.testing.assert_allclose(runs[1][:, :2], runs[0][:, :2])
    # The core follows the ramp at its 3 % per second, and the temperature is above by 5 times that.
    assert runs[0][-1, 2] - runs[1][-1, 2] == pytest.approx(15.0, rel=1e-3)


def test_a_fan_that_is_still_slow_holds_the_core_back():
    ss = np.where(np.arange(80)[:, None] < 5, 60.0, 90.0) * np.ones(3)
    ss[:, 0] = 60.0
    times = []
    for fan in (40.0, 80.0):
        ss[:, 0] = fan
        model = lags(log_tau=math.log(0.2), log_up=math.log(0.5), up_other=1.0)
        model.arrays["parameters"][0] = lags().arrays["parameters"][0]
        deviation = model.deviations(model.drive(np.zeros((80, 3)), INPUTS, ss), np.zeros(3), DT_S)
        rate = np.diff(ss[:, 1] - deviation[:, 1]) / DT_S
        times.append(rate[np.argmin(np.abs((ss - deviation)[:, 1] - 70.0))])
    # The limit goes by exp(u), and 40 % of fan speed are 4/3 of u.
    assert times[1] / times[0] == pytest.approx(math.exp(4.0 / 3.0), rel=0.08)


def test_a_fan_draws_near_as_a_parabola_of_the_core_says():
    core, curved = 1.2, 0.4
    model = lags(log_tau=-2.5)
    for name, value in (("core", core), ("core_speed", curved)):
        model.arrays["parameters"][0, PARAMETERS.index(name)] = value
    model.arrays["parameters"][1, PARAMETERS.index("log_tau")] = 2.0
    ss = np.where(np.arange(120)[:, None] < 5, 65.0, 90.0) * np.ones(3)
    deviation = model.deviations(model.drive(np.zeros((120, 3)), INPUTS, ss), np.zeros(3), DT_S)
    v, w = ((ss - deviation)[100, 1] - 75.0) / 20.0, (90.0 - 75.0) / 20.0
    expected = 20.0 * (core * (w - v) + curved * (w * w - v * v))
    assert deviation[100, 0] == pytest.approx(expected, rel=0.02)


def test_a_start_at_rest_is_the_casings_heat_where_the_model_knows_of_it():
    model = lags()
    model.arrays["parameters"][2, PARAMETERS.index("casing_share")] = 0.05
    model.arrays["parameters"][2, PARAMETERS.index("log_casing_tau")] = math.log(60.0)
    drive = model.drive(np.zeros((601, 3)), INPUTS, np.full((601, 3), 70.0))
    got = model.deviations(drive, np.array([1.0, 1.0, 20.0]), DT_S)
    assert got[600, 2] == pytest.approx(20.0 * math.exp(-1.0))
    assert np.abs(got[600, :2]).max() < 1e-9


def test_the_metal_keeps_a_share_of_each_step_and_gives_it_up_in_its_own_time():
    model = lags(log_tau=-2.5, slow_share=0.1, log_slow_tau=math.log(5.0))
    model.arrays["parameters"][2, PARAMETERS.index("casing_share")] = 0.05
    model.arrays["parameters"][2, PARAMETERS.index("log_casing_tau")] = math.log(90.0)
    ss = np.where(np.arange(400)[:, None] < 5, 500.0, 600.0) * np.ones(3)
    got = model.deviations(model.drive(np.zeros((400, 3)), INPUTS, ss), np.zeros(3), DT_S)
    since = DT_S * (np.arange(100, 400) - 4)
    expected = 10.0 * np.exp(-since / 5.0) + 5.0 * np.exp(-since / 90.0)
    np.testing.assert_allclose(got[100:, 2], expected, rtol=1e-6)


def after_a_step(low, high, heat=1.0):
    """Deviations (400, 3) after a step of all outputs between scaled values, and its size."""
    values = {"slow_share": 0.1, "log_slow_tau": math.log(6.0), "log_tau": math.log(0.3)}
    model = lags(limit=1e3, **values, heat=heat, heat_speed=-0.5, heat_rate=0.4)
    scaled = np.where(np.arange(400)[:, None] < 5, low, high)
    ss = model.centre + model.half * scaled
    drive = model.drive(np.zeros((400, 3)), INPUTS, ss)
    return model.deviations(drive, np.zeros(3), DT_S), model.half * (high - low)


@pytest.mark.parametrize(("low", "high"), [(0.5, -1.0), (-1.0, 0.5)])
def test_heat_counts_the_more_and_goes_the_slower_the_less_power_there_is(low, high):
    got, size = after_a_step(low, high)
    since, tau_s = DT_S * (np.arange(100, 400) - 4), 6.0 * math.exp(-0.4 * high)
    soak = 0.1 * math.exp(-0.5 * high) * np.exp(-since / tau_s)
    # A spool of 0.3 s is behind what falls with tau_s by one part in tau_s / 0.3 - 1.
    np.testing.assert_allclose(
        got[100:] / size, np.repeat(soak[:, None] / (1.0 - 0.3 / tau_s), 3, axis=1), rtol=0.02
    )


def test_heat_moves_a_spool_and_does_not_show_at_once():
    driven, size = after_a_step(0.5, -1.0)
    shown, _ = after_a_step(0.5, -1.0, heat=0.0)
    assert (np.abs(driven[5]) < np.abs(size)).all()
    assert (np.abs(shown[5] / driven[5]) > 1.05).all()
