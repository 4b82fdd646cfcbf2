"""A flight streamed through model and fuser gives what the batch gives, and survives bad logs."""

import csv
import gzip
import itertools
import signal
import threading
import time
import tracemalloc
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.io import savemat

from data_prep.config import LogsConfig
from data_prep.log import Finding
from data_prep.reading import read_logs
from data_prep.sources.stream import GridStream
from eval.replay import Clock, ReplayModel, ReplayOptions, replay
from narxcal.calibration.fuser import KalmanFuser
from narxcal.calibration.noise import NoiseModel, estimate_noise
from narxcal.calibration.run_record import RunRecord
from narxcal.support.errors import ConfigError, DataError, ModelError

DT = 0.1


class Settled:
    """Steady state of the fake engine: both speeds are straight lines in lever and Mach."""

    input_names = ("TRA_deg", "Mach")
    output_names = ("N1_pct", "N2_pct")

    def outputs(self, inputs):
        return np.stack(
            [20.0 + inputs[..., 0] + 5.0 * inputs[..., 1], 50.0 + 0.5 * inputs[..., 0]], axis=-1
        )

    def inside(self, inputs):
        return np.isfinite(inputs).all(axis=-1) & (inputs[..., 0] <= 60.0)


class FirstOrder:
    """Stands in for `DynamicCalibration`: the outputs follow the steady state with a lag."""

    input_names = ("Mach", "TRA_deg")
    output_names = Settled.output_names
    dt_s = DT
    steady = Settled()
    rate = 0.2
    interval = None

    def _settled(self, inputs):
        return self.steady.outputs(inputs[..., ::-1])

    def for_engine(self, engine, **_):
        assert isinstance(engine, str)
        return FirstOrder()

    def reset(self, inputs):
        self.y = self._settled(inputs)
        return self.y

    def step(self, inputs):
        self.y = self.y + self.rate * (self._settled(inputs) - self.y)
        return self.y

    def extend(self, inputs):
        return np.array([self.step(row) for row in inputs])

    def simulate(self, inputs):
        return np.array([self.reset(inputs[0]), *map(self.step, inputs[1:])])


# Most tests compare with a fuser of the same stored noise, which live rows are fused by.
STORED = ReplayOptions(follow=True, idle_s=0.01)


def noise_model():
    ones = np.ones(2)
    return NoiseModel(DT, 0.99 * ones, 0.01 * ones, 0.1 * ones, 0.5 * ones, 0.04 * ones, ones)


MODEL = ReplayModel(FirstOrder(), noise=noise_model())


def flight(time_s=None, seed=0, samples=600):
    """Columns of a clean log: lever steps, and outputs that lag, are off by 1 and noisy."""
    rng = np.random.default_rng(seed)
    time_s = np.round(np.arange(samples) * DT, 10) + 5.0 if time_s is None else time_s
    lever = 20.0 + 30.0 * (np.floor(time_s / 7.0) % 2)
    mach = 0.3 + 0.001 * time_s
    model = FirstOrder()
    truth = model.simulate(np.column_stack([mach, lever])) + 1.0
    measured = truth + 0.2 * rng.normal(size=truth.shape)
    return {
        "time_s": time_s,
        "TRA_deg": lever,
        "Mach": mach,
        "N1_pct": measured[:, 0],
        "N2_pct": measured[:, 1],
    }


def write(path, columns, header=None):
    rows = zip(*(np.asarray(values).tolist() for values in columns.values()), strict=True)
    cells = [",".join("" if np.isnan(value) else repr(value) for value in row) for row in rows]
    text = "\n".join([",".join(header or columns), *cells]) + "\n"
    path.write_text(text, encoding="utf-8")
    return path


def read(path):
    with path.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    number = {
        name: np.array([float(row[name] or "nan") for row in rows])
        for name in rows[0]
        if name != "engine"
    }
    return number, [row.get("engine") for row in rows]


@pytest.fixture
def replayed(tmp_path):
    """Writes a log of some columns and replays it: summary, columns of the output, and log."""

    def run(columns, model=MODEL, options=STORED, clock=None):
        log = write(tmp_path / "log.csv", columns)
        summary = replay(model, log, tmp_path / "out.csv", options, clock)
        return summary, read(tmp_path / "out.csv")[0], log

    return run


def batch(log, config=None):
    """Whole log, free run over it and measured outputs, as the batch has them."""
    [whole] = read_logs(log, config)
    predicted = FirstOrder().simulate(whole.matrix(FirstOrder.input_names))
    return whole, predicted, whole.matrix(FirstOrder.output_names)


def test_prediction_and_fused_value_are_those_of_the_batch_without_a_shift(tmp_path, replayed):
    summary, found, log = replayed(flight())
    whole, predicted, measured = batch(log)
    fused = KalmanFuser(noise_model()).run(predicted, measured)
    np.testing.assert_allclose(found["time_s"], whole.time_s, atol=1e-9)
    for i, name in enumerate(FirstOrder.output_names):
        np.testing.assert_allclose(found[f"{name}_free_run"], predicted[:, i], rtol=1e-9)
        np.testing.assert_allclose(found[f"{name}_fused"], fused.values[:, i], rtol=1e-9)
        np.testing.assert_allclose(
            found[f"{name}_innovation"], fused.innovations[:, i], rtol=1e-6, atol=1e-8
        )
        half = 1.6448536 * np.sqrt(fused.variances[:, i])  # the normal distribution's 90 %
        for way, end in ((-1.0, "low"), (1.0, "high")):
            np.testing.assert_allclose(
                found[f"{name}_fused_{end}"], fused.values[:, i] + way * half, rtol=1e-8
            )
    # A lever step shows in the prediction at the very sample that has it.
    at = int(np.flatnonzero(np.diff(whole["TRA_deg"]) > 1.0)[0]) + 1
    moved = np.abs(np.diff(found["N1_pct_free_run"]))
    assert moved[at - 1] > 5.0
    assert moved[at - 2] < 0.1
    assert summary.rows == len(whole) == 600
    assert not np.any([found["gap"], found["held"]])
    assert found["inside_envelope"].all()
    assert sorted(file.name for file in tmp_path.iterdir()) == ["log.csv", "out.csv"]


class Interval(FirstOrder):
    """The same with an interval that is as wide as the engine is far from steady state."""

    interval = "there"

    def for_engine(self, engine, **_):
        assert isinstance(engine, str)
        return Interval()

    def half_width(self, inputs, outputs, share):
        return share * np.abs(self._settled(inputs) - outputs)


def test_the_interval_stands_around_the_prediction_in_any_pieces(replayed):
    columns = flight()
    columns["TRA_deg"][300:340] = np.nan  # longer than an input is held
    model = ReplayModel(Interval(), noise=noise_model())
    _, found, _ = replayed(columns, model, replace(STORED, interval=0.8))
    for name in FirstOrder.output_names:
        middle = 0.5 * (found[f"{name}_free_run_low"] + found[f"{name}_free_run_high"])
        np.testing.assert_allclose(middle, found[f"{name}_free_run"], rtol=1e-8)
        middle = 0.5 * (found[f"{name}_fused_low"] + found[f"{name}_fused_high"])
        np.testing.assert_allclose(middle, found[f"{name}_fused"], rtol=1e-8)
    blank = np.isnan(found["N1_pct_free_run"])
    assert blank.any()
    np.testing.assert_array_equal(np.isnan(found["N1_pct_free_run_low"]), blank)
    assert np.nanmax(found["N1_pct_free_run_high"] - found["N1_pct_free_run_low"]) > 20.0
    assert "N1_pct_free_run_low" not in replayed(columns)[1]


@pytest.mark.parametrize("rate", [4.0, 10.0, 13.7, 50.0])
def test_rows_between_raster_points_are_laid_on_the_model_raster_like_a_batch(replayed, rate):
    time_s = np.round(np.arange(int(60 * rate)) / rate, 6)
    config = LogsConfig(raster_hz=10.0)
    _, found, log = replayed(flight(time_s), replace(MODEL, logs=config))
    np.testing.assert_allclose(found["N1_pct_free_run"], batch(log, config)[1][:, 0], rtol=1e-6)


def test_realtime_sample_by_sample_gives_the_same_rows_at_their_times(replayed):
    columns = flight(samples=80)
    now, slept = itertools.count(0.0, 1e-4), []
    clock = Clock(now=lambda: next(now) + sum(slept), sleep=slept.append)
    _, whole, _ = replayed(columns)
    _, live, _ = replayed(columns, MODEL, ReplayOptions(realtime=True), clock)
    for name in whole:
        np.testing.assert_allclose(live[name], whole[name], rtol=1e-9, err_msg=name)
    assert sum(slept) == pytest.approx(79 * DT, abs=0.05)


def test_several_engines_come_interleaved_and_one_can_be_picked(tmp_path):
    left, right = flight(seed=1), flight(seed=2)
    right["TRA_deg"] = right["TRA_deg"] + 3.0
    columns = {"time_s": left["time_s"], "Mach": left["Mach"]}
    for prefix, each in (("lh", left), ("rh", right)):
        columns |= {f"{prefix}_{n}": each[n] for n in ("TRA_deg", "N1_pct", "N2_pct")}
    log = write(tmp_path / "log.csv", columns)
    mapped = {n: {"column": "{engine}_" + n} for n in ("TRA_deg", "N1_pct", "N2_pct")}
    mapped |= {n: {"column": n} for n in ("time_s", "Mach")}
    config = LogsConfig.parse({"engines": {"left": "lh", "right": "rh"}, "columns": mapped})
    model = ReplayModel(FirstOrder(), config, noise=noise_model())
    summary = replay(model, log, tmp_path / "both.csv", STORED)
    both, engines = read(tmp_path / "both.csv")
    assert summary.engines == ("left", "right")
    assert engines[:4] == ["left", "right", "left", "right"]
    assert (np.diff(both["time_s"]) >= 0.0).all()
    for i, engine in enumerate(("left", "right")):
        replay(model, log, tmp_path / "one.csv", replace(STORED, engine=engine))
        one, none = read(tmp_path / "one.csv")
        assert none[0] is None
        for name in one:
            np.testing.assert_array_equal(one[name], both[name][i::2])
    with pytest.raises(ConfigError) as error:
        replay(model, log, tmp_path / "x.csv", ReplayOptions(engine="centre"))
    assert str(error.value) == f"{log}: unknown engine 'centre'. Its engines: left, right"


def test_a_gap_restarts_the_model_settled_and_is_flagged_once(replayed):
    keep, config = np.r_[0:250, 330:600], LogsConfig(raster_hz=10.0)
    columns = {name: values[keep] for name, values in flight().items()}
    summary, found, log = replayed(columns, replace(MODEL, logs=config))
    assert np.flatnonzero(found["gap"]).tolist() == [250]
    assert summary.restarts == {"": 1}
    predicted = FirstOrder().simulate(read_logs(log, config)[1].matrix(FirstOrder.input_names))
    np.testing.assert_allclose(found["N1_pct_free_run"][250:], predicted[:, 0], rtol=1e-9)


def test_a_missing_input_is_held_up_to_the_limit_then_the_model_pauses(replayed):
    columns = flight()
    columns["TRA_deg"][100:110] = np.nan  # 1 s, of which all is held
    columns["TRA_deg"][300:350] = np.nan  # 5 s, of which 2 s are held
    columns["N2_pct"][400:] = np.nan
    summary, found, _ = replayed(columns)
    assert np.flatnonzero(found["held"]).tolist() == [*range(100, 110), *range(300, 320)]
    assert np.flatnonzero(found["gap"]).tolist() == list(range(320, 351))
    blank = np.isnan(found["N1_pct_free_run"])
    assert np.flatnonzero(blank).tolist() == list(range(320, 350))
    np.testing.assert_array_equal(blank, np.isnan(found["N1_pct_fused"]))
    assert np.isnan(found["N2_pct_innovation"][400:]).all()
    assert np.isfinite(found["N2_pct_fused"][400:]).all()
    assert summary.held == {"": {"TRA_deg": 30}}
    assert summary.restarts == {"": 1}


def test_samples_outside_the_envelope_are_flagged_and_counted(replayed):
    columns = flight()
    columns["TRA_deg"][500:520] = 70.0
    summary, found, _ = replayed(columns)
    assert np.flatnonzero(found["inside_envelope"] == 0.0).tolist() == list(range(500, 520))
    assert summary.outside == {"": 20}


def test_a_faulty_output_is_not_fused_and_flagged(replayed):
    fault = Finding("bias", "N1_pct", 20.0, 30.0, 40.0, "%", 0.99, "+40 %", log="log.csv")
    model = replace(MODEL, findings=(fault,))
    columns = flight()
    rows = (columns["time_s"] >= 20.0) & (columns["time_s"] <= 30.0)
    columns["N1_pct"][rows] += 40.0
    summary, found, _ = replayed(columns, model)
    np.testing.assert_array_equal(found["N1_pct_valid"] == 0.0, rows)
    assert found["N2_pct_valid"].all()
    assert np.isnan(found["N1_pct_innovation"][rows]).all()
    assert np.abs(found["N1_pct_fused"] - found["N1_pct_free_run"])[rows].max() < 3.0
    assert summary.to_dict()["findings"] == [fault.row()]
    assert summary.cautions[0] == "log.csv: N1_pct bias, t+0:20.0 to t+0:30.0: +40 %"


def test_a_faulty_input_is_held_and_then_pauses_the_model(replayed):
    fault = Finding("stuck", "Mach", 20.0, 30.0, 0.3, "-", 0.99, "stays at 0.3", log="log.csv")
    _, found, _ = replayed(flight(), replace(MODEL, findings=(fault,)))
    inside = (found["time_s"] >= 20.0) & (found["time_s"] <= 30.0)
    assert (found["N1_pct_valid"][inside] == 0.0).all()
    assert np.isnan(found["N1_pct_free_run"][inside & (found["time_s"] > 22.5)]).all()
    assert found["N1_pct_valid"][~inside].all()


def test_a_physically_impossible_value_is_not_fused(replayed):
    columns = flight()
    columns["N1_pct"] *= 160.0
    _, found, _ = replayed(columns)
    np.testing.assert_allclose(found["N1_pct_fused"], found["N1_pct_free_run"])
    assert not found["N1_pct_valid"].any()


def test_an_output_the_log_lacks_is_predicted_and_not_fused(replayed):
    columns = flight()
    del columns["N2_pct"]
    for options in (STORED, ReplayOptions()):
        summary, found, _ = replayed(columns, MODEL, options)
        np.testing.assert_array_equal(found["N2_pct_fused"], found["N2_pct_free_run"])
        assert np.isfinite(found["N1_pct_fused_low"]).all()
    assert np.isnan(found["N2_pct_fused_low"]).all()
    assert summary.unfused == {"": ("N2_pct",)}


@pytest.mark.parametrize("warmup_s", [20.0, 300.0])
def test_noise_is_estimated_from_the_start_of_the_log_where_none_is_stored(
    replayed, monkeypatch, warmup_s
):
    monkeypatch.setattr("eval.replay._WARMUP_S", warmup_s)
    _, found, log = replayed(flight(), ReplayModel(FirstOrder()), ReplayOptions())
    _, predicted, measured = batch(log)
    assert len(found["time_s"]) == 600
    if warmup_s > 60.0:
        fused = KalmanFuser(estimate_noise(measured, predicted, DT)).run(predicted, measured)
        np.testing.assert_allclose(found["N1_pct_fused"], fused.values[:, 0], rtol=1e-8)


def test_the_sensors_noise_is_the_logs_own_and_the_models_is_the_bundles(replayed):
    stored = replace(noise_model(), measurement_variance=np.full(2, 1e-6))
    model = replace(MODEL, noise=stored)
    _, found, log = replayed(flight(), model, ReplayOptions())
    _, predicted, measured = batch(log)
    own = estimate_noise(measured, predicted, DT).measurement_variance
    np.testing.assert_allclose(own, 0.04, rtol=0.15)
    fused = KalmanFuser(replace(stored, measurement_variance=own)).run(predicted, measured)
    np.testing.assert_allclose(found["N1_pct_fused"], fused.values[:, 0], rtol=1e-8)
    _, live, _ = replayed(flight(), model)  # rows are not kept back for it
    fused = KalmanFuser(stored).run(predicted, measured)
    np.testing.assert_allclose(live["N1_pct_fused"], fused.values[:, 0], rtol=1e-6)


def test_a_truncated_last_line_is_left_out_and_reported(tmp_path):
    log = write(tmp_path / "log.csv", flight())
    whole = log.read_text(encoding="utf-8")
    log.write_text(whole[:-30], encoding="utf-8")
    summary = replay(MODEL, log, tmp_path / "out.csv", STORED)
    assert summary.truncated
    assert summary.rows == 599
    log.write_text(whole[:-1], encoding="utf-8")  # only the line's end is missing
    summary = replay(MODEL, log, tmp_path / "out.csv", STORED)
    assert not summary.truncated
    assert summary.rows == 600


def test_stamps_in_minutes_that_are_read_as_seconds_are_said(replayed):
    table = flight()
    assert not [text for text in replayed(table)[0].cautions if "stamps" in text]
    summary, _, _ = replayed({**table, "time_s": table["time_s"] / 60.0})
    (said,) = [text for text in summary.cautions if "stamps" in text]
    assert said.startswith(f"{summary.read} rows of the log are {summary.log_s:.3g} s")


def test_a_compressed_log_and_a_broken_off_one_are_replayed(tmp_path):
    log = write(tmp_path / "log.csv", flight(samples=3000))
    packed = gzip.compress(log.read_bytes())
    zipped = tmp_path / "log.csv.gz"
    zipped.write_bytes(packed)
    assert replay(MODEL, zipped, tmp_path / "out.csv").rows == 3000
    zipped.write_bytes(packed[: len(packed) // 2])
    summary = replay(MODEL, zipped, tmp_path / "out.csv")
    assert summary.truncated
    assert 1000 < summary.rows < 2000


def test_a_growing_file_is_followed_until_it_stands_still(tmp_path):
    log = write(tmp_path / "log.csv", flight(samples=300))
    text = log.read_text(encoding="utf-8")
    log.write_text(text[:4000], encoding="utf-8")

    def grow():
        for start in range(4000, len(text), 1777):  # in the middle of lines
            with log.open("a", encoding="utf-8") as file:
                file.write(text[start : start + 1777])
            time.sleep(0.02)

    writer = threading.Thread(target=grow)
    writer.start()
    options = ReplayOptions(follow=True, idle_s=0.5)
    summary = replay(MODEL, log, tmp_path / "live.csv", options)
    writer.join()
    replay(MODEL, log, tmp_path / "batch.csv", STORED)
    assert summary.rows == 300
    live, batch = read(tmp_path / "live.csv")[0], read(tmp_path / "batch.csv")[0]
    for name in batch:
        np.testing.assert_allclose(live[name], batch[name], rtol=1e-8, err_msg=name)


def test_interrupting_a_follow_ends_it_well_and_any_other_replay_leaves_nothing(tmp_path):
    log = write(tmp_path / "log.csv", flight(samples=300))

    def interrupt(seconds):
        signal.raise_signal(signal.SIGINT)

    clock = Clock(sleep=interrupt)
    replay(MODEL, log, tmp_path / "live.csv", ReplayOptions(follow=True), clock)
    assert len(read(tmp_path / "live.csv")[0]["time_s"]) == 300
    with pytest.raises(KeyboardInterrupt):
        replay(MODEL, log, tmp_path / "out.csv", ReplayOptions(realtime=True), clock)
    assert sorted(each.name for each in tmp_path.iterdir()) == ["live.csv", "log.csv"]


@pytest.mark.slow
def test_memory_does_not_grow_with_the_log(tmp_path):
    peaks = []
    for samples in (8_500, 17_000):
        log = write(tmp_path / "log.csv", flight(samples=samples))
        tracemalloc.start()
        replay(MODEL, log, tmp_path / "out.csv", STORED)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.2 * peaks[0]


def test_a_missing_input_column_is_named(replayed, tmp_path):
    columns = flight()
    del columns["Mach"]
    with pytest.raises(DataError) as error:
        replayed(columns)
    assert str(error.value) == (
        f"{tmp_path / 'log.csv'}, channel Mach: the model needs this input, and the log neither "
        "has nor implies it. The log has TRA_deg, N1_pct, N2_pct"
    )
    assert not list(tmp_path.glob("out*"))


@pytest.mark.parametrize("ending", ["parquet", "mat"])
def test_other_formats_are_replayed_as_csv_is_but_not_followed(tmp_path, ending):
    columns = flight()
    write(tmp_path / "log.csv", columns)
    log = tmp_path / f"log.{ending}"
    if ending == "mat":
        savemat(log, {name: values[:, None] for name, values in columns.items()})
    else:
        pa = pytest.importorskip("pyarrow", reason="the extra 'parquet' is not installed")
        parquet = pytest.importorskip("pyarrow.parquet", reason="as before")
        parquet.write_table(pa.table(columns), log)
    for source in ("csv", ending):
        replay(MODEL, tmp_path / f"log.{source}", tmp_path / f"of_{source}.csv")
    same = (tmp_path / "of_csv.csv").read_bytes() == (tmp_path / f"of_{ending}.csv").read_bytes()
    assert same
    with pytest.raises(DataError) as error:
        replay(MODEL, log, tmp_path / "out.csv", ReplayOptions(follow=True))
    kind = {"parquet": "Parquet file", "mat": "file of arrays"}[ending]
    assert str(error.value) == f"{log}: a {kind} cannot be followed. Write it as CSV first"


def test_text_in_a_number_is_refused_with_its_row_however_far_down(tmp_path):
    log = write(tmp_path / "log.csv", flight(samples=6000))
    lines = log.read_text(encoding="utf-8").splitlines()
    lines[5001] = lines[5001].replace(lines[5001].split(",")[1], "full")
    log.write_text("\n".join(lines) + "\n", encoding="utf-8")
    with pytest.raises(DataError) as error:
        replay(MODEL, log, tmp_path / "out.csv", STORED)
    assert error.value.row == 5001
    assert error.value.channel == "TRA_deg"
    assert "expected a number, found 'full'" in str(error.value)


def test_time_going_back_is_refused_with_its_row_however_far_down(replayed, tmp_path):
    columns = flight(samples=6000)
    columns["time_s"][5000:] -= 400.0
    with pytest.raises(DataError) as error:
        replayed(columns)
    assert str(error.value) == (
        f"{tmp_path / 'log.csv'}, channel time_s, row 5001: time goes back from 504.9 s to 105 s. "
        "It holds more than one recording: split the file there, or name the column that tells "
        "them apart in [logs] instances"
    )


@pytest.mark.parametrize("samples", [0, 1])
def test_a_log_with_less_than_two_samples_is_refused(replayed, samples):
    with pytest.raises(DataError, match=r": expected samples at two or more times$"):
        replayed({name: values[:samples] for name, values in flight().items()})


@pytest.mark.parametrize("options", [ReplayOptions(), STORED])
def test_a_lone_wrong_stamp_costs_its_row_and_no_more(replayed, options):
    columns = flight()
    columns["time_s"][300] += 5000.0
    summary, _, _ = replayed(columns, MODEL, options)
    assert (summary.rows, summary.dropped, summary.restarts) == (600, 1, {"": 0})


def test_live_rows_can_be_read_while_they_come_and_belong_to_one_replay(tmp_path):
    log, out = write(tmp_path / "log.csv", flight(samples=60)), tmp_path / "out.csv"
    part, seen = tmp_path / "out.csv.part", []

    def wait(_):
        if not seen:
            seen.append(part.read_text(encoding="utf-8").count("\n"))
            with pytest.raises(ConfigError) as error:
                replay(MODEL, log, out, ReplayOptions(realtime=True))
            assert str(error.value) == (
                f"{part}: the file exists. Another command writes it, or one was killed: remove "
                "it, or choose another name"
            )

    replay(MODEL, log, out, ReplayOptions(realtime=True), Clock(sleep=wait))
    assert seen[0] >= 1
    assert out.read_text(encoding="utf-8").count("\n") == 61
    assert not part.exists()


def test_an_output_that_cannot_be_written_is_refused(tmp_path):
    log = write(tmp_path / "log.csv", flight())
    with pytest.raises(ConfigError) as error:
        replay(MODEL, log, log / "out.csv")
    assert str(error.value) == (
        f"{log / 'out.csv'}: cannot write: File exists. Nothing was changed; choose another place"
    )


def test_a_bundle_without_its_noise_model_whole_is_refused():
    config = {"logs": {"raster_hz": 10.0}, "fuser": {"relock_s": 3.0}}
    record = RunRecord(config=config, fuser_noise={"dt_s": 0.1})
    trained = SimpleNamespace(calibration=FirstOrder(), record=record)
    with pytest.raises(ModelError, match="the fuser's noise model lacks retention, process"):
        ReplayModel.of(trained)
    trained.record = record.having(fuser_noise=None)
    model = ReplayModel.of(trained)
    assert model.logs.raster_hz == 10.0
    assert model.fuser.relock_s == 3.0
    assert model.noise is None


def thinned(columns, every, names=None):
    """A log in which `names`, or all channels, are recorded at each `every`-th sample only."""
    if names is None:
        return {name: values[::every] for name, values in columns.items()}
    seldom = np.arange(len(columns["time_s"])) % every > 0
    return {
        name: np.where(seldom & (name in names), np.nan, values) for name, values in columns.items()
    }


def test_a_channel_slower_than_the_raster_is_fused_where_it_was_measured(replayed):
    summary, found, log = replayed(thinned(flight(), 10, {"N2_pct"}))
    whole, predicted, measured = batch(log)
    assert np.isfinite(measured[:-9]).all()  # a log holds the line between measurements, too
    measured[np.arange(len(measured)) % 10 > 0, 1] = np.nan
    np.testing.assert_array_equal(whole.measured(FirstOrder.output_names), measured)
    fused = KalmanFuser(noise_model()).run(predicted, measured)
    np.testing.assert_allclose(found["N2_pct_fused"], fused.values[:, 1], rtol=1e-9)
    assert np.isfinite(found["N2_pct_innovation"]).sum() == 60
    assert np.isfinite(found["N1_pct_innovation"]).sum() == 600
    assert summary.slow == {"": {"N2_pct": pytest.approx(1.0)}}
    (said,) = summary.cautions
    assert said == (
        "sampled more coarsely than the model's grid are N2_pct about every 1 s: outputs are fused "
        "only where they were measured, inputs are interpolated between"
    )
    assert summary.to_dict()["cautions"] == summary.cautions


def test_slow_rows_off_the_raster_are_each_fused_once_and_hardly_refused(replayed):
    columns = thinned(flight(samples=3000), 10)
    columns["time_s"] = columns["time_s"] + np.random.default_rng(1).uniform(-0.04, 0.04, 300)
    config = LogsConfig(raster_hz=10.0)
    # Errors of a real model go on in one direction: steps of the raster say little of a second.
    timid = replace(noise_model(), process_variance=np.full(2, 1e-6), transient_gain=np.zeros(2))
    model = ReplayModel(FirstOrder(), config, noise=timid)
    summary, found, _ = replayed(columns, model, ReplayOptions())
    assert np.isfinite(found["N1_pct_innovation"]).sum() in {299, 300}
    assert sum(summary.gated[""].values()) <= 3
    assert set(summary.slow[""]) == {"TRA_deg", "Mach", "N1_pct", "N2_pct"}
    (said,) = summary.cautions
    assert "TRA_deg about every 1 s" in said
    assert "Mach" not in said  # the air changes slowly


def test_in_blocks_slow_channels_are_drawn_where_a_whole_file_says(tmp_path):
    columns = thinned(flight(samples=900), 7, {"N1_pct"})
    [whole] = read_logs(write(tmp_path / "log.csv", columns))
    stream = GridStream(LogsConfig(), DT, 5.0)
    pieces = []
    for start in range(0, 900, 50):
        block = {name: values[start : start + 50] for name, values in columns.items()}
        pieces += stream.push(block)
    pieces += stream.push({}, last=True)
    joined = np.concatenate([piece.interpolated["N1_pct"] for piece in pieces])
    np.testing.assert_array_equal(joined, whole.interpolated["N1_pct"])
    assert set(whole.interpolated) == {"N1_pct"}
