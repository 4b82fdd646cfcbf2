"""The functions that Python users call give what the commands write."""

import json
import re
import shutil
from html import unescape
from pathlib import Path

import pandas as pd
import pytest
from matplotlib import pyplot as plt

import narxcal as nx
from narxcal import ConfigError, DataError

PAGE = Path(__file__).parents[2] / "docs/python.md"


@pytest.fixture(autouse=True)
def closed():
    yield
    plt.close("all")


@pytest.fixture(scope="module")
def data(project):
    return nx.read(config=project / "tiny.toml")


def test_logs_are_read_by_configuration_or_by_name(project, data):
    assert [log.name for log in data] == ["flight_1.csv", "flight_2.csv", "flight_3.csv"]
    named = nx.read(str(project / "flights/flight_[13].csv"), data.config)
    assert [log.name for log in named] == ["flight_1.csv", "flight_3.csv"]
    assert named["flight_3*"].to_frame().equals(data[2].to_frame())
    assert len(data.plot().axes) == len(data[0].recorded(list(data[0].channels)))
    assert "3 logs as read" in data._repr_html_()
    assert "3 logs as read" in repr(data)
    assert list(data.audit) == ["log", "channel", "action", "reason", "samples"]


def test_prepared_logs_are_those_of_the_command(project, data, narxcal, tmp_path, undrawn):
    found = nx.prepare(project / "tiny.toml")
    done = narxcal("prepare", project / "tiny.toml", "--out", tmp_path / "out")
    assert done.code == 0
    written = pd.read_csv(tmp_path / "out" / "events.csv")
    assert found.events["start_s"].tolist() == pytest.approx(written["start_s"].tolist())
    assert found.events["log"].tolist() == written["log"].tolist()
    ranked = pd.read_csv(tmp_path / "out" / "pearson.csv")
    assert found.ranking["rho"].tolist() == pytest.approx(
        ranked["rho"].tolist(), abs=1e-6, nan_ok=True
    )
    assert len(nx.plot.events(found["flight_2*"]).lines) == 1 + (
        found.events["log"].eq("flight_2.csv").sum()
    )
    assert len(found.plot().axes) == 4
    assert "3 prepared logs" in found._repr_html_()
    assert "3 prepared logs" in repr(found)


def test_an_evaluation_is_that_of_the_command(project, narxcal, tmp_path, undrawn):
    judged = nx.evaluate(project / "run")
    done = narxcal("evaluate", project / "run", "--out", tmp_path / "out")
    document = json.loads((tmp_path / "out" / "evaluate.json").read_text("utf-8"))
    assert done.code == judged.outcome.exit_code
    assert list(judged.cautions) == document["cautions"]
    (log,) = document["logs"]
    for name, row in log["channels"].items():
        assert judged.scores.loc[("flight_3.csv", name), "fit_pct"] == row["fit_pct"]
    assert judged.events["ok"].tolist() == [one["ok"] for one in log["events"]]
    assert len(judged.faults) == len(document["findings"])
    fit = judged.scores.loc[("flight_3.csv", "N1_pct"), "fit_pct"]
    drawn = nx.plot.compare(judged, channel="N1_pct")
    assert drawn.texts[0].get_text() == f"fit {fit:.1f} %"
    again = nx.plot.compare(judged["flight_3*"].log, judged, "N1_pct")
    labels = [line.get_label() for line in again.lines]
    model = again.lines[labels.index("model, free run")].get_ydata()
    assert model == pytest.approx(
        next(one for one in drawn.lines if one.get_label() == "model, free run").get_ydata()
    )
    assert judged.outcome.headline in unescape(judged._repr_html_())
    assert judged.outcome.headline in repr(judged)
    assert len(repr(judged)) < 5000
    assert (
        nx.evaluate(project / "run", project / "flights/flight_1.csv")
        .scores["role"]
        .eq("train")
        .all()
    )


def test_the_page_runs_and_trains_the_model_of_the_command(project, tmp_path, monkeypatch):
    shutil.copytree(project / "flights", tmp_path / "flights")
    shutil.copy(project / "tiny.toml", tmp_path / "mine.toml")
    monkeypatch.chdir(tmp_path)
    found = {}
    for block in re.findall(r"```python\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL):
        exec(block, found)  # noqa: S102 - our own page
    weights = [(folder / "run" / "weights.safetensors") for folder in (project, tmp_path)]
    assert weights[0].read_bytes() == weights[1].read_bytes()
    model, judged = found["model"], found["judged"]
    assert model.scores.index.tolist() == ["N1_pct", "N2_pct", "EGT_C"]
    assert len(model.plot("flight_2*").axes) == len(judged.plot().axes) == 7
    assert isinstance(model.faults, pd.DataFrame)
    assert "rmse" in model._repr_html_()
    assert found["fused"].shape == (3,)


def test_what_is_not_there_is_said(data, project):
    with pytest.raises(ConfigError) as error:
        nx.prepare(list(data.logs))
    assert str(error.value) == (
        "expected recordings or a configuration, found list. "
        'narxcal.read(files, "config.toml") reads recordings'
    )
    with pytest.raises(DataError, match=re.escape("there is no log 'x'. There are 3: flight_1")):
        data["x"]
    with pytest.raises(DataError, match="there is no log 3"):
        data[3]
    with pytest.raises(DataError, match=r"no file matches. Name the logs, or a pattern of them$"):
        nx.read(str(project / "flights/*.mat"), project / "tiny.toml")
