"""`narxcal fleet` in one process: what is in the dataset, how it grows, what it refuses."""

import math
import re
import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from fsspec.implementations.memory import MemoryFileSystem

from eval.fleets.fleet import Fleet, load_fleet
from eval.fleets.fleet_rows import TABLES, batch_means
from eval.judging.log_evaluation import assess_log
from eval.run_logs import evaluation_logs, run_config
from narxcal.calibration.bundle import load_bundle, save_bundle
from narxcal.cli import main
from narxcal.support.addresses import Folder
from narxcal.support.csv_text import log_csv
from narxcal.support.parallel import WorkerDied
from tests.eval.conftest import lag_bundle, lag_log

CONFIG = 'schema = "narxcal.fleet/1"\nflights = "{flights}"\nrun = "{run}"\nbatch = 2\n'
FLIGHTS = {"N1": 3, "N2": 2, "_3": 1}


def content(seed, duration_s=60.0, offset=(0.0, 0.0)):
    """A flight of the lag engine with a noise of its own."""
    log = lag_log(duration_s=duration_s, offset=offset)
    noise = np.random.default_rng(seed).normal(0.0, 0.02, len(log))
    channels = {**log.channels, "N1_pct": log["N1_pct"] + noise}
    return log_csv({"time_s": log.time_s, **channels}).encode()


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Three tails with six flights in four batches, their configuration and their dataset F."""
    folder = tmp_path_factory.mktemp("fleet")
    save_bundle(folder / "run", lag_bundle())
    for tail, flights in FLIGHTS.items():
        (folder / "flights" / tail).mkdir(parents=True)
        for number in range(flights):
            data = content(seed=len(tail) + 10 * number + ord(tail[-1]))
            (folder / "flights" / tail / f"f{number}.csv").write_bytes(data)
    (folder / "fleet.toml").write_text(CONFIG.format(flights="flights", run="run"), "utf-8")
    grow = ["fleet", str(folder / "fleet.toml"), "--out", str(folder / "F"), "--jobs", "1"]
    assert main([*grow, "--quiet"]) == 0
    return folder


@pytest.fixture
def fleet(made, tmp_path):
    return Path(shutil.copytree(made, tmp_path, dirs_exist_ok=True))


@pytest.fixture
def grow(fleet, capsys):
    """Run the command in this process: exit code, stdout and stderr."""

    def run(out="F", *more, config="fleet.toml"):
        place = out if "://" in out else fleet / out
        arguments = ["fleet", fleet / config, "--out", place, "--jobs", 1, *more]
        code = main([str(part) for part in arguments])
        shown = capsys.readouterr()
        return SimpleNamespace(code=code, out=shown.out, err=shown.err)

    return run


def parts(folder):
    """Every file of a dataset, by its name."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def test_each_log_is_there_once_with_the_figures_of_evaluate(fleet):
    logs = pd.read_parquet(fleet / "F" / "logs")
    assert sorted(logs["file"]) == sorted(
        f"{tail}/f{number}.csv" for tail, flights in FLIGHTS.items() for number in range(flights)
    )
    assert set(logs["status"]) == {"good"}
    bundle = load_bundle(fleet / "run")
    (log,) = evaluation_logs(bundle, [fleet / "flights/N2/f1.csv"])
    one = assess_log(bundle, log, run_config(bundle)[1])
    scores = pd.read_parquet(fleet / "F" / "scores")
    own = scores[scores["file"] == "N2/f1.csv"].set_index("channel")
    for name, found in one.scores.items():
        assert own.loc[name, "rmse"] == found.rmse
        assert own.loc[name, "static_bias"] == found.static_bias
    events = pd.read_parquet(fleet / "F" / "events")
    own = events[events["file"] == "N2/f1.csv"]
    assert own["ok"].tolist() == [each.verdict.ok for each in one.assessments]
    assert own["Tt_model_s"].dropna().tolist() == [
        each.verdict.Tt.model_s for each in one.assessments if each.verdict.Tt
    ]


def test_a_reader_of_parquet_finds_the_rows_of_a_tail_in_its_folder(fleet):
    assert set(pd.read_parquet(fleet / "F" / "trims" / "%5F3")["tail"]) == {"_3"}
    for table, columns in TABLES.items():
        found = pd.read_parquet(fleet / "F" / table)
        assert found.columns.tolist() == list(columns)
        assert set(found["tail"]) <= set(FLIGHTS)


def test_a_log_that_fails_is_a_row_and_the_others_are_evaluated(fleet, grow):
    (fleet / "flights/N1/bad.csv").write_text("height,speed\n1,2\n", "utf-8")
    (fleet / "flights/N2/none.csv").touch()
    found = grow()
    assert found.code == 0
    logs = pd.read_parquet(fleet / "F" / "logs").set_index("file")
    failed = logs[logs["status"] == "failed"]
    assert failed["reason"].to_dict() == {
        "N1/bad.csv": (
            "column 'time_s' is missing. The file has height, speed. "
            "Or map the columns under [logs.columns]"
        ),
        "N2/none.csv": "the file is empty. Expected a header line and data rows",
    }
    assert failed["size"].to_dict() == {"N1/bad.csv": 17, "N2/none.csv": 0}
    assert (logs["status"] == "good").sum() == sum(FLIGHTS.values())
    assert "narxcal: warning: N2/none.csv: the file is empty. Expected" in found.err


def test_a_log_of_which_workers_die_is_a_row(fleet, grow, monkeypatch):
    """Of a batch in which they die each file is tried alone."""

    def dying(work, items, *_, **__):
        for item in items:  # files to be listed, then batches
            if any(file.name == "N1/f0.csv" for file in getattr(item, "files", ())):
                raise WorkerDied(item, "4 workers died with the same work")
            yield work(item)

    whole = pd.read_parquet(fleet / "F" / "logs").set_index("file")
    monkeypatch.setattr("eval.fleets.fleet.in_processes", dying)
    assert grow("G").code == 0
    logs = pd.read_parquet(fleet / "G" / "logs").set_index("file")
    row = logs.loc["N1/f0.csv"]
    assert (row["status"], row["reason"]) == ("failed", "4 workers died with the same work")
    others = logs.drop("N1/f0.csv"), whole.drop("N1/f0.csv")
    pd.testing.assert_frame_equal(*others, check_dtype=False)


def test_the_same_bytes_count_once(fleet, grow):
    original = (fleet / "flights/N1/f0.csv").read_bytes()
    (fleet / "flights/N2/copy.csv").write_bytes(original)
    found = grow()
    logs = pd.read_parquet(fleet / "F" / "logs").set_index("file")
    assert logs.loc["N2/copy.csv", "status"] == "duplicate"
    reason = "the same bytes as N1/f0.csv, which counts"
    assert logs.loc["N2/copy.csv", "reason"] == reason
    assert found.err == f"narxcal: warning: N2/copy.csv: {reason}\n"
    assert "N2/copy.csv" not in set(pd.read_parquet(fleet / "F" / "scores")["file"])


def test_the_same_samples_in_other_bytes_are_reported(fleet, grow):
    table = pd.read_csv(fleet / "flights/N1/f0.csv", dtype=str)
    table[table.columns[::-1]].to_csv(fleet / "flights/N2/turned.csv", index=False)
    assert grow().err == (
        "narxcal: warning: N1/f0.csv and N2/turned.csv hold the same samples in other bytes; "
        "both count\n"
    )


def test_memory_in_and_out_gives_the_same_bytes(fleet, grow):
    MemoryFileSystem.store.clear()
    for path in (fleet / "flights").rglob("*.csv"):
        name = path.relative_to(fleet / "flights").as_posix()
        Folder("memory://far").write(name, path.read_bytes())
    for path in (fleet / "run").iterdir():
        Folder("memory://runs/a").write(path.name, path.read_bytes())
    text = CONFIG.format(flights="memory://far", run="memory://runs/a")
    (fleet / "far.toml").write_text(text, "utf-8")
    assert grow("memory://fleet", config="far.toml").code == 0
    names = Folder("memory://fleet").sizes(["**"])
    assert {name: Folder("memory://fleet").read(name) for name in names} == parts(fleet / "F")


def test_later_flights_form_later_batches_and_touch_nothing(fleet, grow):
    before = parts(fleet / "F")
    (fleet / "flights/N1/a.csv").write_bytes(content(seed=99))
    said = grow().out
    assert "6 of 7 files are in" in said
    after = parts(fleet / "F")
    changed = {name for name in after if after[name] != before.get(name)}
    assert changed == {"worklist.parquet", *(f"{table}/N1/00002.parquet" for table in TABLES)}


@pytest.mark.parametrize("batches", [0, 1, 3])
def test_interrupted_anywhere_and_gone_on_with_is_the_same_dataset(fleet, grow, batches):
    stopped = Fleet(Folder(str(fleet / "G")), load_fleet(fleet / "fleet.toml"))
    left = stopped.batches(stopped.list_files())
    written = iter(range(batches))

    def stop(*_):
        if next(written, None) is None:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stopped.grow(left, stop)
    grow("G")
    assert parts(fleet / "G") == parts(fleet / "F")


def test_a_batch_whose_last_table_is_missing_is_computed_anew(fleet, grow):
    whole = parts(fleet / "F")
    (fleet / "F/logs/N1/00000.parquet").unlink()
    (fleet / "F/events/N1/00000.parquet").write_bytes(b"")
    grow()
    assert parts(fleet / "F") == whole


def test_one_run_per_tail(fleet, grow):
    for tail in FLIGHTS:
        save_bundle(fleet / "runs" / tail, lag_bundle((2.5, 0.8) if tail == "N2" else (1.5, 0.8)))
    text = CONFIG.format(flights="flights", run="runs/{tail}")
    (fleet / "tails.toml").write_text(text, "utf-8")
    assert grow("G", config="tails.toml").code == 0
    scores = pd.read_parquet(fleet / "G" / "scores")
    n1 = scores[scores["channel"] == "N1_pct"].groupby("tail")["rmse"].min()
    assert n1["N2"] > 20.0 * n1["N1"]


def test_the_offset_at_a_power_level_is_found_with_its_error(fleet, grow):
    true = 0.7
    for number in range(12):
        data = content(50 + number, duration_s=400.0, offset=(true, 0.0))
        (fleet / f"flights/N1/long{number}.csv").write_bytes(data)
    grow()
    trims = pd.read_parquet(fleet / "F" / "trims")
    own = trims[trims["file"].str.contains("long") & (trims["channel"] == "N1_pct")]
    known = own.dropna(subset="standard_error")
    assert len(known) > 20
    z = (known["offset"] - true) / known["standard_error"]
    assert abs(z.median()) < 1.0  # of two to seven minutes, so that tails are heavy
    assert abs(known["offset"] - true).max() < 0.05  # of what is not quite settled


def test_batch_means_of_equal_counts_are_the_mean_and_its_standard_error():
    means = np.random.default_rng(1).normal(size=9)
    offset, error = batch_means(means, np.full(9, 7))
    assert offset == pytest.approx(means.mean())
    assert error == pytest.approx(means.std(ddof=1) / 3.0)
    assert math.isnan(batch_means(means[:1], np.array([5]))[1])


# --- what is refused ---


def refused(found, message):
    assert found.code == 2
    assert found.err == f"narxcal: error: {message}\n"


def nowhere(fleet):
    (fleet / "none").mkdir()
    (fleet / "fleet.toml").write_text(CONFIG.format(flights="none", run="run"), "utf-8")


def other_run(fleet):
    save_bundle(fleet / "run", lag_bundle((2.0, 0.8)), replace=True)


def other_version(fleet):
    document = fleet / "F" / "fleet.json"
    text = re.sub('"narxcal": ".*?"', '"narxcal": "0.0.7"', document.read_text("utf-8"), count=1)
    document.write_text(text, "utf-8")


def grown(fleet):
    with (fleet / "flights/N1/f0.csv").open("ab") as file:
        file.write(b"\n")


def loose(fleet):
    (fleet / "flights/loose.csv").touch()


def unlisted(fleet):
    (fleet / "F/worklist.parquet").unlink()


def damaged(fleet):
    (fleet / "F/worklist.parquet").write_bytes(b"PAR1 no more")


OTHER = "the results of N1 are of the run with sha256 {1}, this one has {2}"
GROWN = "{0}/flights/N1/f0.csv: it had {3} bytes when it was listed, now {4}"
LOOSE = "loose.csv: its name does not match tail = '([^/]+)/[^/]+$'"
VERSION = "{0}/F: the results are of narxcal 0.0.7, this is narxcal 0.1.0"
NONE = "{0}/none: no file matches **/*.csv or **/*.csv.gz"
RESTORE = "Restore it, or choose another --out"


@pytest.mark.parametrize(
    ("change", "problem", "hint"),
    [
        (nowhere, NONE, "Set flights and files"),
        (loose, LOOSE, "Correct the latter"),
        (other_run, f"{{0}}/F: {OTHER}", "Choose another --out, or that run"),
        (other_version, VERSION, "Choose another --out, or that version"),
        (grown, GROWN, "Restore it, or evaluate the fleet into another --out"),
        (damaged, "{0}/F/worklist.parquet: the Parquet file is damaged", RESTORE),
        (unlisted, "{0}/F: the work list is missing", RESTORE),
    ],
)
def test_what_is_not_gone_on_with(fleet, grow, change, problem, hint):
    flight = fleet / "flights/N1/f0.csv"
    was, size = load_bundle(fleet / "run").sha256[:12], flight.stat().st_size
    before = parts(fleet / "F" / "logs")
    change(fleet)
    now = load_bundle(fleet / "run").sha256[:12]
    message = problem.format(fleet, was, now, size, flight.stat().st_size)
    refused(grow(), f"{message}. {hint}")
    assert parts(fleet / "F" / "logs") == before


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        ("batch = 0", "'batch': Input should be greater than or equal to 1, found 0"),
        ("tail = '['", "'tail': expected a regular expression"),
        ("tail = 'N'", "'tail': expected a regular expression with a group: the tail"),
    ],
)
def test_a_bad_configuration(fleet, grow, line, problem):
    text = CONFIG.format(flights="flights", run="run").replace("batch = 2", line)
    (fleet / "fleet.toml").write_text(text, "utf-8")
    found = grow()
    assert found.code == 2
    assert found.err.startswith(f"narxcal: error: {fleet / 'fleet.toml'}: ")
    assert problem in found.err


def test_a_flight_that_changes_between_list_and_evaluation_is_a_row(fleet, grow):
    found = Fleet(Folder(str(fleet / "G")), load_fleet(fleet / "fleet.toml"))
    batches = found.batches(found.list_files())
    file = fleet / "flights/N1/f0.csv"
    file.write_bytes(file.read_bytes().replace(b"0.3,", b"0.4,", 1))
    found.grow(batches)
    logs = pd.read_parquet(fleet / "G/logs").set_index("file")
    assert logs.loc["N1/f0.csv", "reason"].startswith("the file changed: sha256 was ")


def test_other_content_is_left_alone(fleet, grow):
    (fleet / "G").mkdir()
    (fleet / "G" / "letter.txt").write_text("dear", "utf-8")
    refused(grow("G"), f"{fleet / 'G'}: the folder holds other content. Choose another --out")
    assert parts(fleet / "G") == {"letter.txt": b"dear"}


def test_an_address_of_an_unknown_kind(fleet, grow):
    found = grow("carrier-pigeon://loft")
    refused(
        found,
        "carrier-pigeon://loft: expected a path or an address of abfs, az, gcs, gs, memory, s3, "
        "s3a, sftp, found carrier-pigeon://. "
        "Name a folder, or an address such as s3://BUCKET/FOLDER",
    )


def test_a_run_that_is_none(fleet, grow):
    (fleet / "fleet.toml").write_text(CONFIG.format(flights="flights", run="no"), "utf-8")
    found = grow("G")
    assert found.code == 2
    assert str(fleet / "no") in found.err
    assert not (fleet / "G").exists()
