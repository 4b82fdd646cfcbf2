"""From logs to a bundle: the split, the raster, the calibration, its checkpoints and its record."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from data_prep.cleaning.smooth import SmoothConfig, smooth
from data_prep.log import Log, Source
from narxcal.atmosphere import air_state
from narxcal.calibration.bundle import Bundle, load_bundle, save_bundle
from narxcal.calibration.fuser import FastFuser
from narxcal.lumped.engine import LumpedEngine
from narxcal.lumped.limited import LIMITED, UNLIMITED
from narxcal.support.errors import ConfigError, DataError, ModelError
from narxcal.support.files import to_json
from training import pipeline
from training.config import RunConfig, SplitConfig
from training.dynamics.network import net_of
from training.methods import TrainOptions
from training.pipeline import (
    calibrate,
    calibration_for,
    configured_files,
    free_runs,
    fuser_noise,
    input_reach,
    prepare_logs,
)
from training.records import Split, deviation_record, lag_samples, split_logs

DT_S, TAU_S = 0.1, 1.5
TABLE = {
    "schema": "narxcal.config/1",
    "steady_state": {"inputs": ["TRA_deg", "Mach"], "blend": [], "corrected": False},
    "narx": {
        "outputs": ["N1_pct", "EGT_C"], "schedule": ["Mach"], "hidden": 2, "lag_limits": False,
    },
    "train": {"horizons_s": [5.0, 20.0], "iterations": [3, 4], "threads": 1, "choice_s": 0.0},
    "smooth": {"window": 1},
}  # fmt: skip


def config(**sections):
    return RunConfig.parse({**TABLE, **sections})


def flight(name="a.csv:left", seed=0, samples=1200, dt_s=DT_S, noise=(0.05, 0.5)):
    """Slams every 15 s; both outputs settle on lines over the lever, first-order lags behind."""
    rng = np.random.default_rng(seed)
    hold = round(15.0 / dt_s)
    lever = np.repeat(rng.uniform(10.0, 70.0, samples // hold + 1), hold)[:samples]
    settled = np.column_stack([20.0 + lever, 300.0 + 4.0 * lever])
    outputs = settled.copy()
    decay = np.exp(-dt_s / TAU_S)
    for k in range(1, samples):
        outputs[k] = settled[k] + decay * (outputs[k - 1] - settled[k])
    outputs += rng.normal(size=outputs.shape) * noise
    channels = {"TRA_deg": lever, "Mach": np.full(samples, 0.3) + 1e-3 * rng.random(samples)}
    channels |= {"N1_pct": outputs[:, 0], "EGT_C": outputs[:, 1]}
    file, _, engine = name.partition(":")
    return Log(
        name, dt_s * np.arange(samples), channels, source=Source(file, "sha-" + file, engine)
    )


def split(train=1, validate=0, test=0):
    logs = [flight(f"{seed}.csv:left", seed) for seed in range(train + validate + test)]
    pattern = [f"{seed}.*" for seed in range(len(logs))]
    return split_logs(
        logs,
        SplitConfig.parse(
            {"train": pattern[:train], "validate": pattern[train : train + validate]}
        ),
    )


def named(parts):
    return [[log.name for log in part] for part in (parts.train, parts.validate, parts.test)]


@pytest.fixture(scope="module")
def bundle(tmp_path_factory):
    return calibrate(config(), tmp_path_factory.mktemp("base"), split(2, 1, 1))


@pytest.mark.parametrize(
    ("table", "expected"),
    [
        ({}, [["a:l", "a:r", "b:l"], [], []]),
        ({"train": ["a*"]}, [["a:l", "a:r"], [], ["b:l"]]),
        ({"train": ["*"], "test": ["b*"]}, [["a:l", "a:r"], [], ["b:l"]]),
        ({"train": ["*:l"], "validate": ["b*"]}, [["a:l"], ["b:l"], ["a:r"]]),
        ({"train": ["a:l"], "test": ["b*"]}, [["a:l"], [], ["b:l"]]),
    ],
)
def test_logs_are_sorted_by_their_names(table, expected):
    logs = [flight(name, samples=10) for name in ("a:l", "a:r", "b:l")]
    assert named(split_logs(logs, SplitConfig.parse(table))) == expected


def test_the_libraries_run_one_thread_each_as_in_the_command(monkeypatch):
    def counted(*_args, **_more):
        raise DataError(str({one["num_threads"] for one in threadpool_info()}))

    monkeypatch.setattr(pipeline, "training_data", counted)
    with threadpool_limits(limits=2), pytest.raises(DataError, match=r"^\{1\}$"):
        calibrate(config(), Path(), split())


def test_a_split_without_training_logs_is_refused():
    with pytest.raises(ConfigError) as error:
        split_logs([flight("a:l", samples=10)], SplitConfig(train=("x*",)))
    assert str(error.value) == "no log matches [split] train = ['x*']. Logs are a:l"
    with pytest.raises(ConfigError) as error:
        split_logs([flight("a:l", samples=10)], SplitConfig(test=("*",)))
    assert str(error.value) == (
        "a:l would match [split] train = ['*'], but test or validate came first. "
        "Leave logs for training there"
    )


def test_logs_of_different_sampling_intervals_are_refused(tmp_path):
    logs = [flight("a:l"), flight("b:l", dt_s=0.2)]
    with pytest.raises(DataError) as error:
        calibrate(config(), tmp_path, split_logs(logs, SplitConfig()))
    assert str(error.value) == (
        "expected all logs at one sampling interval, found 0.1 s in a:l, 0.2 s in b:l. "
        "Set raster_hz in [logs]"
    )


def test_an_unseen_flight_is_followed_in_free_run(bundle):
    log = flight("9.csv:left", 9)
    own = calibration_for(bundle.calibration, log)
    error = own.simulate(log.matrix(own.input_names)) - log.matrix(own.output_names)
    n1, egt = np.sqrt((error[1:] ** 2).mean(axis=0))
    assert n1 < 1.0
    assert egt < 4.0


def test_the_bundle_says_where_it_comes_from(bundle):
    meta = json.loads(to_json(bundle.record.to_json()))
    assert RunConfig.parse(meta["configured"]) == config()
    assert meta["split"] == {
        "train": ["0.csv:left", "1.csv:left"],
        "validate": ["2.csv:left"],
        "test": ["3.csv:left"],
    }
    assert meta["data"] == {f"{k}.csv": f"sha-{k}.csv" for k in range(4)}
    assert meta["training"]["status"] == "all steps done"
    (history,) = meta["training"]["history"]
    assert [row["iteration"] for row in history][:3] == [1, 2, 3]
    assert meta["steady_state"]["fitted"]
    assert meta["steady_state"]["rms"]["N1_pct"] < 0.5
    assert {"fuser_noise", "baselines", "seeds", "hardware", "base"} <= set(meta)


def test_the_stored_noise_is_that_of_rows_as_they_are_recorded(bundle):
    """Logs are smoothed for training; a fuser that believed them would follow its sensors."""
    model, log = bundle.calibration, flight(seed=7, samples=4000)
    logs = [smooth(log, SmoothConfig(window=window)) for window in (1, 5)]
    noises = [
        fuser_noise(model, Split((), (each,), ()), free_runs(model, [each]), ()) for each in logs
    ]
    for noise in noises:
        np.testing.assert_allclose(noise.measurement_variance, [0.05**2, 0.5**2], rtol=0.1)
    measured = log.matrix(model.output_names)
    predicted = model.simulate(log.matrix(model.input_names), measured[0])
    fused = FastFuser(noises[1]).run(predicted, measured)
    assert (fused.gated.mean(axis=0) < 0.02).all()
    truth = flight(seed=7, samples=4000, noise=(0.0, 0.0)).matrix(model.output_names)
    wrong = np.sqrt(np.mean((fused.values - truth) ** 2, axis=0))
    assert (wrong < [0.04, 0.4]).all()


def test_a_saved_bundle_simulates_the_same_numbers(bundle, tmp_path):
    save_bundle(tmp_path / "bundle", Bundle(bundle.calibration, bundle.record))
    again = load_bundle(tmp_path / "bundle").calibration
    inputs = flight(seed=9).matrix(again.input_names)
    assert np.array_equal(again.simulate(inputs), bundle.calibration.simulate(inputs))


def test_one_network_per_output_has_a_checkpoint_each(tmp_path):
    apart = config(narx={**TABLE["narx"], "joint": False})
    found = calibrate(apart, tmp_path, split(1), TrainOptions(checkpoints=tmp_path))
    names = {file.name for file in tmp_path.iterdir()}
    assert names == {"checkpoint-N1_pct.safetensors", "checkpoint-EGT_C.safetensors"}
    assert found.calibration.output_names == ("N1_pct", "EGT_C")
    assert len(found.record.training.history) == 2


def test_an_interrupted_training_goes_on_to_the_same_weights(tmp_path):
    seen = []

    def press_ctrl_c(done, total, what):
        seen.append(what.startswith("free-run"))
        if seen[-1] and sum(seen) == 4:
            raise KeyboardInterrupt

    parts = split(1)
    whole = calibrate(config(), tmp_path, parts)
    options = TrainOptions(press_ctrl_c, checkpoints=tmp_path)
    stopped = calibrate(config(), tmp_path, parts, options)
    assert stopped.record.training.status.startswith("interrupted: ")
    resumed = calibrate(config(), tmp_path, parts, TrainOptions(checkpoints=tmp_path, resume=True))
    weights = [net_of(b.calibration.narx).get_theta() for b in (whole, resumed)]
    assert np.array_equal(*weights)


@pytest.mark.parametrize("other", ["configuration", "training log", "validation log"])
def test_a_checkpoint_of_something_else_is_refused(other, tmp_path):
    options = TrainOptions(checkpoints=tmp_path)
    calibrate(config(), tmp_path, split(1, 1), options)
    parts = split(2, 1) if other == "training log" else split(1, 1)
    if other == "validation log":
        parts = split(1)
    changed = config()
    if other == "configuration":
        changed = config(train={**TABLE["train"], "seed": 4})
    file = tmp_path / "checkpoint-joint.safetensors"
    with pytest.raises(ModelError) as error:
        calibrate(changed, tmp_path, parts, TrainOptions(checkpoints=tmp_path, resume=True))
    assert str(error.value) == (
        f"{file}: the checkpoint belongs to a training with another configuration or other data. "
        "Restore them, or train without --resume into another folder"
    )


def test_files_are_read_cleaned_and_completed(tmp_path):
    log = flight(samples=300)
    mach = log["Mach"].copy()
    mach[100:150] = np.nan
    columns = {"time_s": log.time_s, **log.channels, "Mach": mach}
    rows = np.column_stack(list(columns.values()))
    text = [",".join(columns), *(",".join(f"{x:.6g}" for x in row) for row in rows)]
    (tmp_path / "one.csv").write_text("\n".join(text).replace("nan", ""), "utf-8")
    files = configured_files(config(), tmp_path)
    assert files == [tmp_path / "one.csv"]
    (found,) = prepare_logs(config(), files)
    assert np.isfinite(found["Mach"]).all()
    assert found["Mach"][120] == found["Mach"][99]
    held = [entry for entry in found.audit.entries if entry.reason == "held for the model"]
    assert [entry.channel for entry in held] == ["Mach"]
    (coarse,) = prepare_logs(config(), files, dt_s=0.2)
    assert coarse.dt_s == pytest.approx(0.2)


def test_lags_in_front_of_the_network_are_fitted_and_followed(tmp_path):
    parts = split(2, 0, 1)
    bundle = calibrate(config(narx={**TABLE["narx"], "lag": True}), tmp_path, parts)
    model, (log,) = bundle.calibration, parts.test
    assert model.lag is not None
    tau_s = np.exp(model.lag.arrays["parameters"][0, :7] @ [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert tau_s == pytest.approx(TAU_S, rel=0.25)
    measured = log.matrix(model.output_names)
    error = model.simulate(log.matrix(model.input_names), measured[0]) - measured
    assert (np.sqrt(np.mean(error**2, axis=0)) < [0.6, 2.5]).all()


class Line:
    """A steady-state model that reads 0.5 % and 2 K too high, for `with_tail`."""

    input_names, output_names = ("TRA_deg", "Mach"), ("N1_pct", "EGT_C")

    def outputs(self, inputs):
        return np.column_stack([20.5 + inputs[:, 0], 302.0 + 4.0 * inputs[:, 0]])


def with_tail():
    """Lags whose slow part takes 20 s, and a log that follows them exactly."""
    values = {"log_tau": np.log(TAU_S), "slow_share": 0.04, "log_slow_tau": np.log(20.0)}
    free = {"log_up": UNLIMITED, "log_down": UNLIMITED, **values}
    row = [free.get(name, 0.0) for name in LIMITED]
    centre, half = np.array([60.0, 460.0]), np.array([40.0, 160.0])
    scales = {"centre": centre, "half": half, "limit": np.full(2, 1e3)}
    lag = LumpedEngine.of(Line.output_names, {"parameters": np.array([row, row])}, scales)
    log = flight()
    inputs = log.matrix(Line.input_names)
    settled = Line().outputs(inputs) - [0.5, 2.0]
    drive = lag.drive(inputs, Line.input_names, settled)
    outputs = settled - lag.deviations(drive, np.zeros(2), DT_S)
    channels = dict(zip(Line.output_names, outputs.T, strict=True))
    return lag, replace(log, channels={**log.channels, **channels})


def test_a_slow_tail_is_not_taken_for_static_error():
    lag, log = with_tail()
    section = config(narx={**TABLE["narx"], "lag": True})
    left = deviation_record(log, Line(), section, lag).y
    still = np.arange(len(log)) % 150 > 100  # the last 5 s before each move
    assert np.sqrt(np.mean(left[still, 0] ** 2)) < 0.1
    trimmed = lag_samples(log, Line(), section)  # as if nothing were still to come
    known = lag_samples(log, Line(), section, lag)
    assert np.abs(trimmed.ss - known.ss)[still, 0].max() > 0.2


@pytest.mark.parametrize("key", ["lag_heat", "lag_errors"])
def test_a_key_that_is_gone_is_named(key):
    with pytest.raises(ConfigError, match=f"{key} is no key any more: all lags have heat"):
        config(narx={**TABLE["narx"], key: True})


def test_lags_need_an_anchored_network():
    with pytest.raises(ConfigError, match="lag = true needs anchored = true"):
        config(narx={**TABLE["narx"], "lag": True, "anchored": False})


def test_what_a_control_holds_is_a_matter_of_lags():
    with pytest.raises(ConfigError, match="lag_governed = true needs lag = true"):
        config(narx={**TABLE["narx"], "lag": False, "lag_governed": True})


def test_curves_may_go_over_another_channel_than_events_do(tmp_path):
    logs = tuple(
        log.with_channels({"FF_kgph": 50.0 + 3.0 * log["TRA_deg"]}) for log in split(1, 0, 0).train
    )
    section = {"inputs": ["FF_kgph", "Mach"], "driver": "FF_kgph", "blend": [], "corrected": False}
    bundle = calibrate(config(steady_state=section), tmp_path, Split(logs, (), ()))
    assert bundle.calibration.input_names == ("FF_kgph", "Mach")
    assert bundle.calibration.steady.layout.driver == "FF_kgph"


def test_a_driver_of_the_curves_that_is_no_input_is_refused():
    with pytest.raises(
        ConfigError, match=r"\[steady_state\] driver names 'FF_kgph', which is not in"
    ):
        config(steady_state={**TABLE["steady_state"], "driver": "FF_kgph"})


def without(log, name):
    return replace(log, channels={k: v for k, v in log.channels.items() if k != name})


@pytest.mark.parametrize("joint", [True, False])
def test_an_output_that_one_log_lacks_is_learned_from_the_others(joint):
    logs = [flight("a.csv:left", 0), without(flight("b.csv:left", 1), "EGT_C")]
    wanted = config(narx={**TABLE["narx"], "joint": joint, "lag_limits": "auto"})
    bundle = calibrate(wanted, Path(), Split(tuple(logs), (), ()))
    own, judged = bundle.calibration, flight("c.csv:left", 2)
    error = own.simulate(judged.matrix(own.input_names)) - judged.matrix(own.output_names)
    assert np.sqrt(np.mean(error[300:] ** 2, axis=0)) == pytest.approx((0.0, 0.0), abs=3.0)


def test_what_smoothing_took_is_that_of_the_logs_that_record_the_channel():
    usual = [
        smooth(flight(f"{name}.csv", seed), SmoothConfig(window=5))
        for seed, name in enumerate("ab")
    ]
    bundle = calibrate(config(), Path(), Split(tuple(usual), (), ()))
    lacking = Split((usual[0], without(usual[1], "EGT_C")), (), ()).with_outputs(
        ("N1_pct", "EGT_C")
    )
    model = bundle.calibration
    trained = free_runs(model, lacking.train)
    found = fuser_noise(model, lacking, (), trained)
    assert found.measurement_variance[1] >= usual[0].noise["EGT_C"]
    stopped_by = Split(lacking.train, lacking.train[1:], ())
    found = fuser_noise(model, stopped_by, free_runs(model, stopped_by.validate), trained)
    assert found.measurement_variance[1] > 0.0


def test_an_output_that_no_training_log_records_is_refused():
    with pytest.raises(DataError) as caught:
        calibrate(config(), Path(), Split((without(flight(), "EGT_C"),), (), (flight("t.csv"),)))
    assert str(caught.value) == (
        "channel EGT_C: no log to train on has a sample of this output. Take it out of [narx] "
        "outputs, or add logs that hold it to [split] train"
    )


def test_the_stored_configuration_is_the_resolved_one_and_trains_the_same_model(tmp_path, bundle):
    stored = bundle.record.config
    assert "auto" not in (*stored["narx"].values(), *stored["steady_state"].values())
    again = calibrate(RunConfig.parse(stored), tmp_path, split(2, 1, 1))
    u = split(2, 1, 1).test[0].matrix(bundle.calibration.input_names)
    np.testing.assert_array_equal(again.calibration.simulate(u), bundle.calibration.simulate(u))


def test_weights_do_not_depend_on_the_number_of_threads(tmp_path, bundle):
    table = config().train.model_copy(update={"threads": 7})
    again = calibrate(config().model_copy(update={"train": table}), tmp_path, split(2, 1, 1))
    u = split(2, 1, 1).test[0].matrix(bundle.calibration.input_names)
    np.testing.assert_array_equal(again.calibration.simulate(u), bundle.calibration.simulate(u))


def test_inputs_reach_one_width_beyond_the_logs_within_physical_ranges():
    columns = {
        "ALT_ft": np.array([0.0, 8000.0]),
        "Mach": np.array([0.1, 0.4]),
        "X": np.array([1.0, 3.0]),
    }
    log = Log("flight", np.arange(2.0), columns)
    low, high = input_reach([log], ("ALT_ft", "Mach", "X"))
    assert low.tolist() == pytest.approx([-2000.0, 0.0, -1.0])
    # Of the air at least as far as corrected parameters carry, however narrow the logs.
    assert high.tolist() == pytest.approx([18000.0, 0.78, 5.0])
    wide = Log("flight", np.arange(2.0), {**columns, "ALT_ft": np.array([0.0, 30000.0])})
    assert input_reach([wide], ("ALT_ft",))[1].tolist() == [60000.0]


def by_fuel(seed, altitude_ft, samples=3000):
    """Steps of fuel flow at one altitude; speed and temperature follow similarity behind a lag."""
    rng = np.random.default_rng(seed)
    fuel = np.repeat(rng.uniform(200.0, 600.0, samples // 150 + 1), 150)[:samples]
    columns = {
        "FF_kgph": fuel,
        "ALT_ft": altitude_ft + 80.0 * rng.random(samples // 50 + 1).repeat(50)[:samples],
        "Mach": 0.3 + 0.02 * rng.random(samples // 50 + 1).repeat(50)[:samples],
        "dT_C": np.zeros(samples),
    }
    air = air_state(columns["ALT_ft"], columns["Mach"])
    drive = np.log(fuel / (air.delta2 * np.sqrt(air.theta2)) / 400.0)
    settled = np.column_stack([80.0 + 20.0 * drive, 900.0 + 150.0 * drive])
    outputs = settled.copy()
    for k in range(1, samples):
        outputs[k] += np.exp(-DT_S / TAU_S) * (outputs[k - 1] - settled[k])
    scale = np.column_stack([np.sqrt(air.theta2), air.theta2])
    outputs = outputs * scale - np.array([0.0, 273.15]) + rng.normal(size=(samples, 2)) * 0.05
    columns |= {"N1_pct": outputs[:, 0], "EGT_C": outputs[:, 1]}
    name = f"flight_{seed}.csv"
    return Log(name, DT_S * np.arange(samples), columns, source=Source(name, f"sha-{seed}"))


def test_a_flight_above_the_trained_altitudes_is_followed_as_well(tmp_path):
    names = ["FF_kgph", "ALT_ft", "Mach", "dT_C"]
    narx = {"outputs": ["N1_pct", "EGT_C"], "hidden": 2, "lag_limits": False}
    asked = config(steady_state={"inputs": names}, events={"driver": "FF_kgph"}, narx=narx)
    logs = tuple(by_fuel(k, 1500.0) for k in range(2))
    found = calibrate(asked, tmp_path, Split(logs, (), ())).calibration.own_alone()
    errors = []
    for log in (by_fuel(5, 1500.0), by_fuel(5, 2100.0), by_fuel(5, 4000.0)):
        measured = log.matrix(found.output_names)
        free_run = found.simulate(log.matrix(found.input_names), measured[0])
        errors.append(np.sqrt(((free_run - measured) ** 2).mean(axis=0)))
    assert (errors[1] < 1.25 * errors[0]).all()
    assert (errors[2] < 2.0 * errors[0]).all()
