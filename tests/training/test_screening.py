"""What is masked and what is reported: nothing of sound logs, and each fault of logs with one."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.signal import lfilter

from data_prep.cleaning.plausibility import checked
from data_prep.log import Log, Source
from data_prep.prepare import prepare
from data_prep.reading import read_logs
from narxcal.atmosphere import KELVIN
from narxcal.support.errors import ModelError
from training.config import load_config
from training.pipeline import configured_files
from training.screening.masking import cross_screen
from training.screening.redundancy import Bank, agreement
from training.screening.redundancy_fit import Pool, robust_weights
from training.screening.screen import screened

DT_S = 0.2
ROWS = 6000  # twenty minutes
CHANNELS = ("N1_pct", "N2_pct", "EGT_C", "FF_kgph")
DRAW = np.random.default_rng(11)


def lagged(x, tau_s):
    a = np.exp(-DT_S / tau_s)
    return x[0] + lfilter([1.0 - a], [1.0, -a], x - x[0])


@cache
def engine(seed, climb_ft=0.0):
    """Fuel in steps; both spools and the temperature follow with lags of their own, plus noise."""
    draw = np.random.default_rng(seed)
    steps = np.repeat(draw.uniform(0.2, 1.0, ROWS // 150), 150)
    fuel = lagged(steps, 1.0)
    core = lagged(fuel, 2.0)
    fan = lagged(core, 1.0)
    alt = np.interp(np.arange(ROWS), [0, 2000, 4000, ROWS], [1000.0, 9000.0, 9000.0, 2000.0])
    alt += climb_ft
    noise = draw.standard_normal((4, ROWS))
    delta = (1.0 - 6.8756e-6 * alt) ** 5.2559
    channels = {
        "N1_pct": 25.0 + 70.0 * fan**0.7 + 0.1 * noise[0],
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
    return Pool.of([engine(seed) for seed in range(4)]).bank((*CHANNELS, "ALT_ft", "Mach"))


def with_fault(channel, change, seed=21):
    log = engine(seed)
    return checked(replace(log.with_channels({channel: change(log[channel])}), findings=()))


def examined(bank, log):
    return screened(bank, [log])[0].findings


def test_it_finds_nothing_in_sound_logs(bank):
    assert all(examined(bank, engine(seed)) == () for seed in range(30, 40))


def test_it_survives_json(bank):
    stored = Bank.from_json(json.loads(json.dumps(bank.to_json())))
    log = with_fault("EGT_C", lambda x: x + KELVIN)
    assert [one.row() for one in examined(stored, log)] == [
        one.row() for one in examined(bank, log)
    ]


def test_a_bank_without_a_part_is_refused(bank):
    stored = {name: value for name, value in bank.to_json().items() if name != "level"}
    with pytest.raises(ModelError, match=r"^the part 'redundancy' has no 'level'"):
        Bank.from_json(stored)


def test_it_takes_the_engine_channels_and_needs_two(bank):
    assert bank.channels == bank.used == CHANNELS
    assert bank.logs == 4
    log = engine(1)
    single = Log("flight", log.time_s, {"N1_pct": log["N1_pct"], "ALT_ft": log["ALT_ft"]})
    assert Pool.of([single]).bank(("N1_pct", "ALT_ft")) is None


def test_a_channel_that_the_model_does_not_use_is_not_reported():
    bank = Pool.of([engine(seed) for seed in range(3)]).bank(("N1_pct", "N2_pct", "EGT_C"))
    assert examined(bank, with_fault("FF_kgph", lambda x: 1.5 * x)) == ()


NOISE = DRAW.standard_normal(ROWS)


@pytest.mark.parametrize(
    ("channel", "kind", "change"),
    [
        ("EGT_C", "unit", lambda x: x + KELVIN),
        ("EGT_C", "unit", lambda x: 1.8 * x + 32.0),
        ("FF_kgph", "unit", lambda x: x / 0.45359237),
        ("N1_pct", "scale", lambda x: 1.12 * x),
        ("FF_kgph", "stuck", lambda _x: 150.0 + 3.0 * NOISE),
        ("N2_pct", "late", lambda x: np.r_[np.full(10, x[0]), x[:-10]]),
        ("N1_pct", "held", lambda x: x[np.arange(ROWS) // 25 * 25]),
        ("EGT_C", "noise", lambda x: x + 40.0 * NOISE),
        ("EGT_C", "noise", lambda x: 10.0 * np.round(0.1 * x)),
    ],
)
def test_what_the_whole_log_disagrees_in_is_named_and_not_masked(bank, channel, kind, change):
    [log] = screened(bank, [with_fault(channel, change)])
    assert (channel, kind) in [(each.channel, each.kind) for each in log.findings]
    assert not any(each.local for each in log.findings if each.kind == kind)
    assert np.isfinite(log.without_faults()[channel]).mean() > 0.9


@pytest.mark.parametrize("seed", [40, 41])
def test_a_flight_above_all_training_logs_is_not_one_in_another_unit(bank, seed):
    assert examined(bank, engine(seed, climb_ft=20000.0)) == ()


def test_exchanged_channels_are_named(bank):
    log = engine(22)
    exchanged = log.with_channels({"N1_pct": log["N2_pct"], "N2_pct": log["N1_pct"]})
    [found] = examined(bank, exchanged)
    assert (found.kind, found.channels) == ("exchanged", ("N1_pct", "N2_pct"))


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_stretched_time_is_said_of_both_engines_of_a_file_and_masks_nothing(bank, factor):
    pair = []
    for seed, side in ((23, "left"), (24, "right")):
        log = engine(seed)
        time_s = np.arange(0.0, factor * log.time_s[-1], DT_S)
        channels = {
            name: np.interp(time_s / factor, log.time_s, values)
            for name, values in log.channels.items()
        }
        pair.append(Log(f"f:{side}", time_s, channels, source=Source("f", "", side)))
    for log in screened(bank, pair):
        assert "stretched" in {each.kind for each in log.findings}
        assert not any(each.masks for each in log.findings if each.channel == "time_s")


@pytest.mark.parametrize(
    ("kind", "within_s", "change"),
    [
        ("stuck", 12.0, lambda _x, rows: 300.0 + 3.0 * NOISE[rows]),
        ("scale", 12.0, lambda x, _rows: 1.5 * x),
        ("bias", 12.0, lambda x, _rows: x + 120.0),
        ("noise", 30.0, lambda x, rows: x + 15.0 * NOISE[rows]),  # by minutes
    ],
)
def test_a_stretch_is_masked_where_it_is_and_the_rest_is_kept(bank, kind, within_s, change):
    log, rows = engine(24), slice(2500, 4000)
    fuel = log["FF_kgph"].copy()
    fuel[rows] = change(fuel[rows], rows)
    [found] = screened(bank, [log.with_channels({"FF_kgph": fuel})])
    assert {(one.channel, one.kind) for one in found.findings} == {("FF_kgph", kind)}
    after = found.without_faults()
    lost = np.flatnonzero(~np.isfinite(after["FF_kgph"])) * DT_S
    assert lost[0] == pytest.approx(500.0, abs=within_s)
    assert lost[-1] == pytest.approx(800.0, abs=within_s)
    assert after.audit.masked() == {"FF_kgph": {f"fault: {kind}": len(lost)}}
    assert all(np.isfinite(after[name]).all() for name in ("N1_pct", "N2_pct", "EGT_C"))
    assert all(one.start_s < one.end_s for one in found.findings)


def test_what_both_engines_of_a_file_show_is_no_fault_of_one(bank):
    pair = []
    for seed, side in ((31, "left"), (31, "right")):
        log = engine(seed)
        rich = log["FF_kgph"] + np.where(np.arange(ROWS) > 4000, 150.0, 0.0)
        pair.append(
            replace(
                log.with_channels({"FF_kgph": rich}), name=f"f:{side}", source=Source("f", "", side)
            )
        )
    assert not any(one.local for log in screened(bank, pair) for one in log.findings)
    alone = screened(bank, pair[:1])[0]
    assert [(one.channel, one.local) for one in alone.findings] == [("FF_kgph", True)]


def pair(seed, hotter):
    """Both engines of a flight, whose EGT wanders with what is not recorded, by `hotter` K."""
    wander = 12.0 * np.sin(np.arange(ROWS) * DT_S / 90.0 + seed)
    found = []
    for k, side in enumerate(("left", "right")):
        log = engine(seed)
        channels = {
            name: log[name] + 2e-3 * np.ptp(log[name]) * np.roll(NOISE, 100 * seed + 10 * k + i)
            for i, name in enumerate(CHANNELS)
        }
        channels["EGT_C"] += wander + hotter[k]
        source = Source(f"{seed}.csv", f"sha-{seed}", side)
        found.append(replace(log.with_channels(channels), name=f"{seed}:{side}", source=source))
    return found


def test_a_slow_drift_shows_against_the_other_engine_of_the_flight():
    none = np.zeros(ROWS)
    bank = Pool.of([log for seed in range(4) for log in pair(seed, (none, none))]).bank(CHANNELS)
    drift = np.zeros(ROWS)
    drift[2000:4400] = np.linspace(0.0, 40.0, 2400)
    assert [one.findings for one in screened(bank, pair(34, (none, none)))] == [(), ()]
    left, right = screened(bank, pair(33, (drift, none)))
    assert {(one.channel, one.kind) for one in left.findings} == {("EGT_C", "drift")}
    assert right.findings == ()


def test_of_two_measured_channels_neither_is_masked():
    def two(seed):
        log = engine(seed)
        names = ("N1_pct", "EGT_C", "ALT_ft", "Mach", "dT_C")
        return replace(log, channels={name: log[name] for name in names})

    bank = Pool.of([two(seed) for seed in range(4)]).bank(("N1_pct", "EGT_C"))
    log = two(26)
    hot = log["EGT_C"] + np.where(np.arange(ROWS) > 3000, 200.0, 0.0)
    [found] = screened(bank, [log.with_channels({"EGT_C": hot})])
    assert found.without_faults() is found


def flights(*seeds):
    return [replace(engine(seed), source=Source(f"{seed}.csv", f"sha-{seed}")) for seed in seeds]


@pytest.mark.parametrize("count", [2, 3])
def test_training_logs_are_masked_by_what_they_show_against_themselves(count):
    logs = flights(1, 2, 3)[:count]
    names = (*CHANNELS, "ALT_ft", "Mach", "dT_C")
    sound, bank = cross_screen(logs, names)
    assert (bank.logs, [log.findings for log in sound]) == (count, count * [()])
    fuel = logs[0]["FF_kgph"].copy()
    fuel[:1500] = 1.6 * fuel[:1500] + 40.0
    found, _ = cross_screen([logs[0].with_channels({"FF_kgph": fuel}), *logs[1:]], names)
    lost = np.flatnonzero(~np.isfinite(found[0].without_faults()["FF_kgph"])) * DT_S
    assert lost[0] == pytest.approx(0.0, abs=12.0)
    assert lost[-1] == pytest.approx(300.0, abs=12.0)
    assert all(log.without_faults() is log for log in found[1:])


@pytest.mark.slow
def test_of_two_engines_of_one_real_flight_neither_is_masked():
    """The only bank for each is that of the other, which knows one build and one day."""
    config, base = load_config("citation2")
    if not (base / config.logs.folder).is_dir():
        pytest.skip("needs the flights in ../shared/data")
    files = [each for each in configured_files(config, base) if "flight1" in each.name]
    logs = [one.log for one in prepare(read_logs(files, config.logs), config)]
    found, _ = cross_screen(logs, (*config.narx.outputs, *config.steady_state.inputs))
    assert len(found) == 2
    assert all(log.without_faults() is log for log in found)


def slow_model(pool, target, source, kept):
    """The weighted ridge regression of one pair on all rows of the logs that are kept."""
    designs = [one.design for one in pool.parts]
    centre, spread = pool.scaling.centre[target], pool.scaling.spread[target]
    phi = np.concatenate([one.phi[source] for one in designs])
    y = np.concatenate([(one.air.x[target] - centre) / spread for one in designs])
    own = np.concatenate([np.full(len(one.air.mach), k in kept) for k, one in enumerate(designs)])
    weight = robust_weights(phi, y)[own]
    rows, ends = weight[:, None] * phi[own], weight * y[own]
    ridge = np.diag(np.sqrt(1e-4 * np.sum(rows**2, axis=0)))
    return np.linalg.lstsq(np.vstack([rows, ridge]), np.r_[ends, np.zeros(len(ridge))])[0]


def test_leaving_logs_out_of_a_pool_is_fitting_to_the_others():
    pool = Pool.of([engine(seed) for seed in range(4)])
    bank = pool.bank(CHANNELS, without=[1])
    for target, source in (("EGT_C", "FF_kgph"), ("N1_pct", "N2_pct")):
        slow = slow_model(pool, target, source, {0, 2, 3})
        np.testing.assert_allclose(bank.models[target][source], slow, rtol=1e-6, atol=1e-8)


def test_verdicts_on_a_log_left_out_of_a_pool_are_those_of_learning_anew():
    logs = [engine(seed) for seed in range(4)]
    logs[2] = logs[2].with_channels({"N1_pct": 1.12 * logs[2]["N1_pct"]})
    quick = examined(Pool.of(logs).bank(CHANNELS, without=[2]), logs[2])
    slow = examined(Pool.of([logs[k] for k in (0, 1, 3)]).bank(CHANNELS), logs[2])
    assert [(one.kind, one.channel) for one in quick] == [(one.kind, one.channel) for one in slow]
    assert [one.size for one in quick] == pytest.approx([one.size for one in slow], rel=0.1)


def test_agreement_is_what_the_sources_have_in_common():
    parts = [[2.0, -1.0, 1.0, 3.0], [5.0, 5.0, 2.0, np.nan], [np.nan, np.nan, 90.0, np.nan]]
    np.testing.assert_array_equal(agreement(np.array(parts)), [2.0, 0.0, 2.0, np.nan])
    assert agreement([np.array([5.0])]) == 5.0
