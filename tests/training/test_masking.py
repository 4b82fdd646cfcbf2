"""What is learned of logs with faults: masks of one log among several, and what is left out."""

from dataclasses import replace

import numpy as np
import pytest

from data_prep.log import Fault, Source
from data_prep.plausibility import checked
from narxcal.atmosphere import KELVIN
from narxcal.support.errors import DataError
from tests.training.test_redundancy import DT_S, NOISE, ROWS, engine
from training.config import RunConfig
from training.masking import by_each_other, learnable, masked
from training.pipeline import calibrate
from training.records import Split

INPUTS = ("FF_kgph", "ALT_ft", "Mach", "dT_C")
OUTPUTS = ("N1_pct", "N2_pct", "EGT_C")
CONFIG = RunConfig.parse(
    {
        "schema": "narxcal.config/1",
        "events": {"driver": "FF_kgph", "condition": ""},
        "steady_state": {
            "inputs": list(INPUTS), "driver": "FF_kgph", "blend": ["Mach"], "switches": [],
        },
        "narx": {"outputs": list(OUTPUTS), "hidden": 2, "lag_limits": False},
        "train": {"horizons_s": [5.0], "iterations": [3], "threads": 1, "choice_s": 0.0},
        "smooth": {"window": 1},
    }
)  # fmt: skip
KINDS = {
    "unit": ("EGT_C", lambda x: x + KELVIN),
    "scale": ("N1_pct", lambda x: 1.15 * x),
    "bias": ("EGT_C", lambda x: x + 150.0),
    "drift": ("FF_kgph", lambda x: x * np.linspace(1.0, 1.6, ROWS)),
    "stuck": ("N2_pct", lambda x: np.r_[x[:3000], np.full(ROWS - 3000, x[3000])]),
    "dead": ("FF_kgph", lambda _x: 150.0 + 3.0 * NOISE),
    "noise": ("EGT_C", lambda x: x + 40.0 * NOISE),
    "late": ("FF_kgph", lambda x: np.r_[np.full(25, x[0]), x[:-25]]),
    "held": ("N1_pct", lambda x: x[np.arange(ROWS) // 25 * 25]),
}


def flight(seed):
    return replace(engine(seed), source=Source(f"{seed}.csv", f"sha-{seed}"))


def spoilt(seed, channel, change):
    log = flight(seed)
    return checked(replace(log.with_channels({channel: change(log[channel])}), faults=()))


@pytest.fixture(scope="module")
def sound():
    return [flight(seed) for seed in (1, 2, 3)]


def test_sound_logs_are_not_masked(sound):
    assert all(log.faults == () for log in by_each_other(sound, (*OUTPUTS, *INPUTS)))


@pytest.mark.parametrize("kind", KINDS)
def test_the_one_log_of_three_that_is_at_fault_is_masked_and_no_other(sound, kind):
    channel, change = KINDS[kind]
    found = by_each_other([spoilt(1, channel, change), *sound[1:]], (*OUTPUTS, *INPUTS))
    named = {"stuck": {"stuck", "dead"}}.get(kind, {kind})
    assert {each.kind for each in found[0].faults if each.channel == channel} & named
    assert not np.isfinite(masked(found[0])[channel]).all()
    assert all(log.faults == () for log in found[1:])


@pytest.mark.parametrize("kind", ["scale", "bias", "late"])
def test_of_two_logs_that_contradict_each_other_none_is_masked(sound, kind):
    logs = [spoilt(1, *KINDS[kind]), sound[1]]
    found = by_each_other(logs, (*OUTPUTS, *INPUTS))
    assert all(each.confidence == 0.5 for log in found for each in log.faults)
    assert [masked(log) for log in found] == found


@pytest.mark.parametrize("kind", ["stuck", "dead", "noise", "held"])
def test_what_a_log_shows_by_itself_is_masked_of_two_as_well(sound, kind):
    channel, change = KINDS[kind]
    found = by_each_other([spoilt(1, channel, change), sound[1]], (*OUTPUTS, *INPUTS))
    assert not np.isfinite(masked(found[0])[channel]).all()
    assert masked(found[1]) is found[1]


def rmse(bundle, log):
    own = bundle.calibration
    measured = log.matrix(own.output_names)
    error = own.simulate(log.matrix(own.input_names), measured[0]) - measured
    return np.sqrt(np.mean(error**2, axis=0))


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_model_is_as_good_as_without_the_log_at_fault(sound, kind, tmp_path):
    bad, judged = spoilt(1, *KINDS[kind]), flight(9)
    without, found = (
        calibrate(CONFIG, tmp_path, Split(tuple(logs), (), ()))
        for logs in (sound[1:], [bad, *sound[1:]])
    )
    assert (rmse(found, judged) < 1.3 * rmse(without, judged)).all()
    assert found.record.screening["faults"][0]["log"] == bad.name


def test_an_input_that_is_lost_for_long_divides_the_log(sound):
    log = sound[0]
    fuel = log["FF_kgph"].copy()
    fuel[2000:2600] = np.nan
    fuel[4000:4005] = np.nan
    found = learnable(Split((log.with_channels({"FF_kgph": fuel}), *sound[1:]), (), ()), CONFIG)
    first, second, *others = found.split.train
    assert (len(first), len(second)) == (2000, ROWS - 2600)
    assert [len(each) for each in others] == [ROWS, ROWS]
    assert np.isfinite(second["FF_kgph"]).all()
    assert found.row()["logs"][0]["left_out_rows"] == 600


def test_masked_samples_are_counted_by_log_and_channel(sound):
    fault = Fault("flight 1", "EGT_C", ("EGT_C",), "dead", 100.0, 199.9, 0.99, "")
    log = replace(sound[0], faults=(fault,))
    row = learnable(Split((log, *sound[1:]), (), ()), CONFIG, screen=False).row()
    assert row["faults"] == [fault.row()]
    assert [each["masked"] for each in row["logs"]] == [{"EGT_C": round(100.0 / DT_S)}, {}, {}]


def test_a_unit_that_is_wrong_in_all_logs_is_an_error_that_says_what_to_set():
    logs = tuple(spoilt(seed, "EGT_C", lambda x: x + 600.0) for seed in (1, 2))
    logs = tuple(
        replace(log, faults=(Fault(log.name, "EGT_C", ("EGT_C",), "unit", 0.0, 1e9, 0.999,
                                   "looks like kelvin: median 1100 degC"),))
        for log in logs
    )  # fmt: skip
    with pytest.raises(DataError) as caught:
        learnable(Split(logs, (), ()), CONFIG)
    assert str(caught.value) == (
        "channel EGT_C: it is at fault in every training log, first in flight 1 (unit: looks like "
        "kelvin: median 1100 degC). Set its unit under [logs.columns]"
    )


def test_a_log_whose_input_is_at_fault_throughout_is_left_out(sound):
    bad = spoilt(1, *KINDS["dead"])
    found = learnable(Split((bad, *sound[1:]), (), ()), CONFIG)
    assert [log.name for log in found.split.train] == ["flight 2", "flight 3"]
    assert found.row()["logs"][0]["left_out_rows"] == ROWS


def test_logs_that_are_all_at_fault_are_refused():
    bad = [
        replace(flight(seed), faults=(Fault(f"flight {seed}", "Mach", ("Mach",), "stuck", 0.0, 1e9,
                                            0.999, "stays at 0"),))
        for seed in (1, 2)
    ]  # fmt: skip
    with pytest.raises(DataError, match="channel Mach: it is at fault in every training log"):
        learnable(Split(tuple(bad), (), ()), CONFIG)
