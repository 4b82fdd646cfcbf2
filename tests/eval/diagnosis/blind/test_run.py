"""Running the cases: without the key, on from where it stopped, never longer than allowed."""

import ctypes
import json
import shutil
import signal
import time
from contextlib import suppress
from types import SimpleNamespace

import numpy as np
import pytest
from numba import njit

from eval.diagnosis.blind import run
from eval.diagnosis.blind.make import make_cases, write_key
from eval.diagnosis.blind.run import Judge, Limits, read_answer, run_cases
from eval.diagnosis.blind.score import CaseSet, score_answers
from eval.diagnosis.diagnose import Request
from narxcal.support.errors import ConfigError, DataError
from narxcal.support.interrupt import safe_interrupt


@pytest.fixture
def asked(monkeypatch, answer):
    """Answer at once, and keep what was asked."""
    seen = []

    def diagnose(request):
        seen.append(request)
        return SimpleNamespace(document=answer(left=float("nan")))

    monkeypatch.setattr(run, "diagnose_folders", diagnose)
    return seen


def test_every_case_gets_an_answer_and_nobody_needs_the_key(made, asked, tmp_path):
    (made / "key.json.sealed").unlink()
    seen = []
    summary = run_cases(made, tmp_path / "out", progress=lambda *row: seen.append(row))
    assert summary["ends"] == {"answered": 3}
    assert [row[:2] for row in seen] == [(1, 3), (2, 3), (3, 3)]
    answer = read_answer(tmp_path / "out", "case_002")
    assert answer["verdict"]["kind"] == "effects"
    assert answer["seconds"] >= 0.0
    assert answer["left"] is None
    first = asked[0]
    assert (first.real, first.sim) == (made / "case_001" / "real", str(made / "case_001" / "sim"))
    assert first.held_real == made / "case_001" / "real_heldout"
    assert first.held_sim == str(made / "case_001" / "sim_heldout")


def test_altered_flights_need_a_simulator_to_be_judged_by(made, asked, tmp_path):
    for side in ("sim", "sim_heldout"):
        for file in (made / "case_001" / side).iterdir():
            file.unlink()
        (made / "case_001" / side).rmdir()
    document = json.loads((made / "cases.json").read_text("utf-8"))
    logs = document["logs"]["case_001"]
    document["logs"] = {"case_001": {n: logs[n] for n in logs if n.startswith("real/")}}
    (made / "cases.json").write_text(json.dumps(document), "utf-8")
    with pytest.raises(ConfigError, match=r"recorded flights alone. Name the simulator by --sim"):
        run_cases(made, tmp_path / "out")
    run_cases(made, tmp_path / "out", judge=Judge("RUN"))
    assert asked == [Request(made / "case_001" / "real", "RUN")]


def test_several_folders_are_scored_together_each_under_its_own_secret(
    quick, plan, made, asked, tmp_path
):
    other, out, theirs = tmp_path / "other", tmp_path / "out", tmp_path / "theirs"
    other.mkdir()
    plan = plan.model_copy(update={"cases": 1, "seed": 5})
    write_key(other, plan, "five", make_cases(other, plan))
    run_cases(made, out)
    run_cases(other, theirs)
    sets = [CaseSet(made, out), CaseSet(other, theirs)]
    one, more = (score_answers([each], ["4", "five"]) for each in sets)
    both = score_answers(sets, ["4", "five"])
    assert both["outcomes"][0]["case"] == "cases/case_001"
    assert [row["case"] for row in both["outcomes"][3:]] == ["other/case_001"]
    assert (both["plans"]["cases"]["seed"], both["plans"]["other"]["seed"]) == (4, 5)
    expected = {"cases": one["table"], "other": more["table"]}
    assert json.dumps(both["by_folder"]) == json.dumps(expected)  # nothing of nothing is NaN
    for first, second, together in zip(one["table"], more["table"], both["table"], strict=True):
        if "of" in together:
            assert together["of"] == first["of"] + second["of"]
            assert together["hits"] == first["hits"] + second["hits"]
    for secrets in (["4"], ["five"]):
        shut = "cases" if secrets == ["five"] else "other"
        with pytest.raises(ConfigError, match=rf"{shut}/key.json.sealed: the key does not open"):
            score_answers(sets, secrets)


def test_folders_of_one_name_are_told_apart_and_none_counts_twice(made, asked, tmp_path):
    sets = [CaseSet(tmp_path / name / "L", tmp_path / f"answers_{name}") for name in "ab"]
    for folder, answers in sets:
        shutil.copytree(made, folder)
        run_cases(folder, answers)
    found = score_answers(sets, ["4"])
    assert list(found["by_folder"]) == [str(each.folder) for each in sets]
    again = sets[0]._replace(folder=sets[0].folder / ".." / "L")
    with pytest.raises(ConfigError, match=r"L: these cases are given twice. Give each once"):
        score_answers([*sets, again], ["4"])


def test_it_goes_on_where_it_was_cut_short(made, asked, tmp_path):
    out = tmp_path / "out"
    run_cases(made, out)
    (out / "case_003" / "gap.json").unlink()
    kept = (out / "case_001" / "gap.json").read_bytes()
    summary = run_cases(made, out)
    assert len(asked) == 4
    assert summary["resumed"] == 2
    assert (out / "case_001" / "gap.json").read_bytes() == kept


def test_what_takes_too_long_is_stopped_and_counted(made, monkeypatch, tmp_path):
    monkeypatch.setattr(run, "diagnose_folders", lambda _: time.sleep(30.0))
    began = time.perf_counter()
    summary = run_cases(made, tmp_path / "out", Limits(1, 0.05))
    assert time.perf_counter() - began < 10.0
    assert summary["ends"] == {"timeout": 3}
    failed = read_answer(tmp_path / "out", "case_001")
    assert failed["reason"] == "was stopped after 0.05 s"
    assert "verdict" not in failed


send = getattr(ctypes.CDLL(None), "raise")
send.argtypes, send.restype = [ctypes.c_int], ctypes.c_int


@njit
def signalled(values, number):
    """What a compiled loop hands over when a signal has arrived meanwhile."""
    send(number)
    return 2.0 * values, values


def test_a_ctrl_c_that_c_code_drops_is_no_refused_case(made, monkeypatch, tmp_path):
    def diagnose(_):
        with suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        raise DataError("the rows cannot be parsed")

    monkeypatch.setattr(run, "diagnose_folders", diagnose)
    out = tmp_path / "out"
    with pytest.raises(KeyboardInterrupt):
        run_cases(made, out)
    assert not list(out.glob("case_*/*"))


@pytest.mark.parametrize("number", [signal.SIGALRM, signal.SIGINT])
def test_a_signal_that_falls_into_compiled_code_is_no_error_of_the_case(
    made, monkeypatch, tmp_path, number
):
    def diagnose(_):
        signalled(np.ones(3), int(number))
        while True:
            time.sleep(0.001)

    monkeypatch.setattr(run, "diagnose_folders", diagnose)
    out = tmp_path / "out"
    if number == signal.SIGALRM:
        assert run_cases(made, out, Limits(1, 60.0))["ends"] == {"timeout": 3}
        return
    with safe_interrupt(), pytest.raises(KeyboardInterrupt):
        run_cases(made, out)
    assert not list(out.glob("case_*/*"))


def test_where_nothing_can_be_stopped_late_is_late(made, monkeypatch, answer, tmp_path):
    def slow(_):
        time.sleep(0.05)
        return SimpleNamespace(document=answer())

    monkeypatch.setattr(run, "diagnose_folders", slow)
    monkeypatch.delattr(run.signal, "setitimer")
    summary = run_cases(made, tmp_path / "out", Limits(1, 0.01))
    assert summary["ends"] == {"timeout": 3}
    assert "took 0 s of 0.01 s" in read_answer(tmp_path / "out", "case_001")["reason"]


@pytest.mark.parametrize(
    "end",
    [
        (DataError("too little excitation"), "refused", "too little excitation"),
        (ZeroDivisionError("oh"), "error", "ZeroDivisionError: oh"),
    ],
)
def test_a_case_that_breaks_does_not_end_the_others(made, monkeypatch, tmp_path, end):
    error, kind, reason = end

    def broken(_):
        raise error

    monkeypatch.setattr(run, "diagnose_folders", broken)
    summary = run_cases(made, tmp_path / "out")
    assert summary["ends"] == {kind: 3}
    assert read_answer(tmp_path / "out", "case_003")["reason"] == reason


def test_a_folder_of_something_else_is_not_written_to(made, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "mine.txt").write_text("mine", "utf-8")
    with pytest.raises(ConfigError, match="holds other content and is not written to"):
        run_cases(made, out)
    (out / "answers.json").write_text('{"schema": "other"}', "utf-8")
    with pytest.raises(ConfigError, match="holds other content"):
        run_cases(made, out)


def test_scoring_opens_the_key(made, asked, tmp_path):
    out = tmp_path / "out"
    with pytest.raises(DataError, match=r"answers.json: cannot be read"):
        score_answers([CaseSet(made, out)], ["4"])
    run_cases(made, out)
    with pytest.raises(ConfigError, match="the key does not open"):
        score_answers([CaseSet(made, out)], ["5", "6"])
    document = score_answers([CaseSet(made, out)], ["4"])
    assert len(document["outcomes"]) == 3
    json.dumps(document)
    (out / "case_002" / "gap.json").unlink()
    with pytest.raises(DataError, match=r"case_002: the case has no answer yet. Go on with"):
        score_answers([CaseSet(made, out)], ["4"])
