"""The bank of pair models: what it says of sound logs, and of logs with one fault."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from data_prep.log import Log, Source
from data_prep.plausibility import checked
from narxcal.atmosphere import KELVIN
from narxcal.support.errors import ModelError
from training.masking import masked
from training.redundancy import Bank, learn
from training.screening import examine, screened

DT_S = 0.2
ROWS = 6000  # twenty minutes
CHANNELS = ("N1_pct", "N2_pct", "EGT_C", "FF_kgph")
DRAW = np.random.default_rng(11)


def lagged(x, tau_s):
    a = np.exp(-DT_S / tau_s)
    return x[0] + lfilter([1.0 - a], [1.0, -a], x - x[0])


def engine(seed, level=1.0):
    """Fuel in steps; both spools and the temperature follow with lags of their own, plus noise."""
    draw = np.random.default_rng(seed)
    steps = np.repeat(draw.uniform(0.2, 1.0, ROWS // 150), 150)
    fuel = lagged(steps, 1.0)
    core = lagged(fuel, 2.0)
    fan = lagged(core, 1.0)
    alt = np.interp(np.arange(ROWS), [0, 2000, 4000, ROWS], [1000.0, 9000.0, 9000.0, 2000.0])
    noise = draw.standard_normal((4, ROWS))
    delta = (1.0 - 6.8756e-6 * alt) ** 5.2559
    channels = {
        "N1_pct": level * (25.0 + 70.0 * fan**0.7) + 0.1 * noise[0],
        "N2_pct": 45.0 + 50.0 * core**0.6 + 0.1 * noise[1],
        "EGT_C": 350.0 + 250.0 * lagged(fuel, 4.0) + 60.0 * (fuel - core) + noise[2],
        "FF_kgph": 400.0 * fuel * delta + noise[3],
        "ALT_ft": alt,
        "Mach": np.full(ROWS, 0.3) + 1e-5 * noise[0],
        "dT_C": np.zeros(ROWS),
    }
    return checked(Log(f"flight {seed}", DT_S * np.arange(ROWS), channels))


@pytest.fixture(scope="module")
def bank():
    return learn([engine(seed) for seed in range(4)], (*CHANNELS, "ALT_ft", "Mach"))


def with_fault(channel, change, seed=21):
    log = engine(seed)
    return checked(replace(log.with_channels({channel: change(log[channel])}), faults=()))


def test_it_finds_nothing_in_sound_logs(bank):
    assert all(examine(bank, engine(seed)) == () for seed in range(30, 40))


def test_it_survives_json(bank):
    stored = Bank.from_json(json.loads(json.dumps(bank.to_json())))
    log = with_fault("EGT_C", lambda x: x + KELVIN)
    assert examine(stored, log) == examine(bank, log)


def test_a_bank_without_a_part_is_refused(bank):
    stored = {name: value for name, value in bank.to_json().items() if name != "sigma"}
    with pytest.raises(ModelError, match=r"^the part 'redundancy' has no 'sigma'"):
        Bank.from_json(stored)


def test_it_takes_the_engine_channels_and_needs_two(bank):
    assert bank.channels == bank.used == CHANNELS
    assert bank.logs == 4
    log = engine(1)
    single = Log("flight", log.time_s, {"N1_pct": log["N1_pct"], "ALT_ft": log["ALT_ft"]})
    assert learn([single], ("N1_pct", "ALT_ft")) is None


def test_a_channel_that_the_model_does_not_use_is_not_reported():
    bank = learn([engine(seed) for seed in range(3)], ("N1_pct", "N2_pct", "EGT_C"))
    assert examine(bank, with_fault("FF_kgph", lambda x: 1.5 * x)) == ()


NOISE = DRAW.standard_normal(ROWS)


@pytest.mark.parametrize(
    ("channel", "kind", "change"),
    [
        ("EGT_C", "unit", lambda x: x + KELVIN),
        ("EGT_C", "unit", lambda x: 1.8 * x + 32.0),
        ("FF_kgph", "unit", lambda x: x / 0.45359237),
        ("N1_pct", "scale", lambda x: 1.08 * x),
        ("EGT_C", "drift", lambda x: x + np.linspace(0.0, 200.0, ROWS)),
        ("FF_kgph", "dead", lambda _x: 150.0 + 3.0 * NOISE),
        ("N2_pct", "dead", lambda _x: 70.0 + 0.5 * NOISE),
        ("FF_kgph", "late", lambda x: np.r_[np.full(15, x[0]), x[:-15]]),
        ("N2_pct", "late", lambda x: np.r_[np.full(10, x[0]), x[:-10]]),
        ("N1_pct", "held", lambda x: x[np.arange(ROWS) // 25 * 25]),
        ("EGT_C", "noise", lambda x: x + 40.0 * NOISE),
    ],
)
def test_it_names_channel_and_kind_of_a_fault(bank, channel, kind, change):
    log = with_fault(channel, change)
    assert [(each.channel, each.kind) for each in examine(bank, log)] == [(channel, kind)]


def test_it_finds_exchanged_channels(bank):
    log = engine(22)
    exchanged = log.with_channels({"N1_pct": log["N2_pct"], "N2_pct": log["N1_pct"]})
    [fault] = examine(bank, exchanged)
    assert (fault.kind, fault.channels) == ("swapped", ("N1_pct", "N2_pct"))


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_it_finds_stretched_time_stamps(bank, factor):
    log = engine(23)
    time_s = np.arange(0.0, factor * log.time_s[-1], DT_S)
    channels = {
        name: np.interp(time_s / factor, log.time_s, values)
        for name, values in log.channels.items()
    }
    [fault] = examine(bank, Log("flight", time_s, channels))
    assert (fault.kind, fault.channel) == ("scale", "time_s")


def test_a_dead_part_is_found_where_it_is(bank):
    log = engine(24)
    rows = slice(2500, 4000)
    dead = log["FF_kgph"].copy()
    dead[rows] = 300.0 + 3.0 * NOISE[rows]
    [fault] = examine(bank, log.with_channels({"FF_kgph": dead}))
    assert (fault.channel, fault.kind) == ("FF_kgph", "dead")
    assert fault.from_s == pytest.approx(500.0, abs=20.0)
    assert fault.to_s == pytest.approx(800.0, abs=20.0)


def test_what_is_found_is_masked_and_counted(bank):
    [log] = screened(bank, [with_fault("EGT_C", lambda x: x + KELVIN)])
    after = masked(log)
    assert np.isnan(after["EGT_C"]).all()
    assert np.isfinite(after["FF_kgph"]).all()
    assert after.audit.masked() == {"EGT_C": {"fault: unit": ROWS}}


def test_without_a_bank_nothing_is_added():
    log = engine(25)
    assert screened(None, [log]) == [log]


def test_a_channel_exchanged_between_two_engines_is_named_in_both(bank):
    pair = [
        replace(engine(seed), name=f"flight:{side}", source=Source("flight", "", side))
        for seed, side in ((31, "left"), (32, "right"))
    ]
    fuel = [log["FF_kgph"] for log in reversed(pair)]
    exchanged = [
        log.with_channels({"FF_kgph": values}) for log, values in zip(pair, fuel, strict=True)
    ]
    found = screened(bank, exchanged)
    assert [[(one.kind, one.channel) for one in log.faults] for log in found] == [
        [("swapped", "FF_kgph")],
        [("swapped", "FF_kgph")],
    ]
    assert all(log.faults == () for log in screened(bank, pair))
