"""`narxcal blind`: make, run, score as a person types them, and what they refuse."""

import json
from dataclasses import dataclass
from types import SimpleNamespace

import pytest

from eval.diagnosis.blind import run, truth
from narxcal.flight_test.signals import first_order
from narxcal.turbofan.engine import INPUT_NAMES


class Body(SimpleNamespace):
    def _replace(self, **changes):
        return Body(**{**vars(self), **changes})


@dataclass
class Fit:
    body: Body


class LagEngine:
    """One lag, whatever is unmodelled: fast enough to fly in a test."""

    input_names = INPUT_NAMES

    def __init__(self, name="", build=None, unmodelled=()):
        self.words = (name, build)
        self.settings = Fit(Body(probe_tau_s=0.7))
        self.more = sum(abs(v) for effect in unmodelled for v in effect.parameters.values())

    def simulate(self, inputs, dt_s):
        power = first_order(inputs["TRA_deg"] / 85.0, 1.2 * (1.0 + 0.05 * self.more), dt_s)
        return {
            "N1_pct": 25.0 + 70.0 * power,
            "N2_pct": 55.0 + 40.0 * power,
            "EGT_C": 400.0 + 350.0 * first_order(power, self.settings.body.probe_tau_s, dt_s),
            "FF_kgph": 100.0 + 400.0 * power,
        }


@pytest.fixture
def cases(narxcal, monkeypatch, tmp_path):
    monkeypatch.setattr(truth, "VirtualEngine", LagEngine)
    done = make(narxcal, tmp_path / "cases")
    assert (done.code, done.err) == (0, "")
    return tmp_path / "cases"


def make(narxcal, out, *more):
    words = ("--cases", 2, "--flights", 1, "--held-out", 1, "--rate", 8, "--seed", 3, "--jobs", 1)
    return narxcal("blind", "make", "--out", out, *words, *more)


def answered(request):
    name = request.real.parent.name
    document = {
        "schema": "narxcal.gap/2",
        "verdict": {"kind": "none", "effects": [], "ambiguous_with": [], "reason": name},
        "effects": [{"id": "spool_lag", "probability": 0.02}],
        "where": [],
        "shrink": {"predicted": {"value": 0.0, "low": 0.0, "high": 0.0}, "realised": 0.0},
    }
    return SimpleNamespace(document=document)


def test_make_run_score(narxcal, cases, monkeypatch, tmp_path):
    monkeypatch.setattr(run, "diagnose_folders", answered)
    answers = tmp_path / "answers"
    done = narxcal("blind", "run", cases, "--out", answers, "--jobs", 1)
    assert (done.code, done.err) == (0, "")
    assert "answered  2" in done.out
    scored = narxcal("blind", "score", cases, answers, "--secret", "3")
    assert (scored.code, scored.err) == (0, "")
    assert "nulls claimed" in scored.out
    assert max(map(len, scored.out.splitlines()[:-1])) <= 80
    assert "Case by case" in (answers / "score.html").read_text("utf-8")
    document = json.loads((answers / "score.json").read_text("utf-8"))
    assert document["schema"] == "narxcal.blind_score/2"
    # A score beside the answers does not keep a run from going on.
    again = narxcal("blind", "run", cases, "--out", answers, "--jobs", 1, "--json")
    assert json.loads(again.out)["resumed"] == 2


def test_a_score_over_two_seeds_and_where_it_is_put(narxcal, cases, monkeypatch, tmp_path):
    monkeypatch.setattr(run, "diagnose_folders", answered)
    assert make(narxcal, tmp_path / "more", "--secret", "word").code == 0
    for name in ("cases", "more"):
        words = ("--out", tmp_path / f"answers_{name}", "--jobs", 1)
        assert narxcal("blind", "run", tmp_path / name, *words).code == 0
    also = ("--also", tmp_path / "more", tmp_path / "answers_more", "--out", tmp_path / "score")
    words = ("blind", "score", cases, tmp_path / "answers_cases", *also, "--secret", "3")
    shut = narxcal(*words)
    assert shut.code == 2
    assert "more/key.json.sealed: the key does not open" in shut.err
    assert not (tmp_path / "score").exists()
    done = narxcal(*words, "--secret", "word")
    assert (done.code, done.err) == (0, "")
    assert "0 of 4" in done.out
    assert max(map(len, done.out.splitlines()[:-1])) <= 80
    document = json.loads((tmp_path / "score" / "score.json").read_text("utf-8"))
    assert list(document["by_folder"]) == ["cases", "more"]
    assert not (tmp_path / "answers_cases" / "score.json").exists()
    # The score of before is replaced, anything else is not.
    assert narxcal(*words, "--secret", "word").code == 0
    (tmp_path / "score" / "thesis.txt").touch()
    assert "holds other content ('thesis.txt')" in narxcal(*words, "--secret", "word").err


def test_json_before_and_behind_the_action(narxcal, cases, tmp_path):
    for words in (("--json", "make"), ("make", "--json")):
        done = narxcal(
            "blind", *words, "--out", tmp_path / "again", "--cases", 1, "--flights", 1,
            "--held-out", 1, "--rate", 8, "--jobs", 1, "--secret", "x",
        )  # fmt: skip
        document = json.loads(done.out)
        assert document["schema"] == "narxcal.blind/1"
        assert document["out"] == str(tmp_path / "again")


def test_a_secret_that_is_given_is_not_the_seed(narxcal, cases, tmp_path):
    own = make(narxcal, tmp_path / "own", "--secret", "word")
    assert "The secret is the seed" not in own.out
    assert "Sealed key:" in own.out
    key = "key.json.sealed"
    assert (tmp_path / "own" / key).read_bytes() != (cases / key).read_bytes()


def test_earlier_cases_are_replaced_and_other_content_is_not(narxcal, cases, tmp_path):
    before = (cases / "cases.json").read_bytes()
    assert make(narxcal, cases).code == 0
    assert (cases / "cases.json").read_bytes() == before
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").touch()
    done = make(narxcal, tmp_path / "mine")
    assert done.code == 2
    assert "holds other content ('thesis.txt') and is not overwritten" in done.err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("make",), "the following arguments are required: --out"),
        (("make", "--out", "o", "--duration", "100"), "error: --duration: Input should be greater"),
        (("make", "--out", "o", "--rate", "1000"), "error: --rate: Input should be less than"),
        (("make", "--out", "o", "--held-out", "90"), "error: --held-out: Input should be less"),
        (("make", "--out", "o", "--style", "wild"), "invalid choice: 'wild'"),
        (("make", "--out", "o", "--jobs", "0"), "expected a whole number of 1 or more, found 0"),
        (("make", "--out", "o", "--engine", "steam"), "invalid choice: 'steam'"),
        (("make", "--out", "o", "--sim-logs", "l"), "l: the folder of the logs does not exist"),
        (("run", "nowhere", "--out", "o"), "cases.json: cannot be read: No such file"),
        (("run", "c", "--out", "o", "--timeout", "0"), "expected more than 0 s, found 0"),
        (("run", "c", "--out", "o", "--timeout", "long"), "expected more than 0 s, found long"),
        (("score", "c", "a"), "the following arguments are required: --secret"),
        (("score", "c", "a", "--secret", "1"), "answers.json: cannot be read: No such file"),
        ((), "the following arguments are required: ACTION"),
    ],
)
def test_what_it_refuses(narxcal, tmp_path, monkeypatch, words, said):
    monkeypatch.chdir(tmp_path)
    done = narxcal("blind", *words)
    assert done.code == 2
    assert said in done.err
    assert len(done.err.splitlines()) == 1
    assert not (tmp_path / "o").exists()


def test_altered_flights_are_made_from_a_configuration(narxcal, tmp_path):
    log = "time_s,FF_kgph,N1_pct,N2_pct,EGT_C\n" + "".join(
        f"{k / 10},{300 + k},{50 + k / 10},80,500\n" for k in range(100)
    )
    (tmp_path / "flight_1.csv").write_text(log, "utf-8")
    (tmp_path / "flights.toml").write_text(CONFIG, "utf-8")
    words = ("--altered", tmp_path / "flights.toml", "--cases", 8)
    done = narxcal("blind", "make", "--out", tmp_path / "o", *words)
    assert (done.code, done.err) == (0, "")
    assert len(list((tmp_path / "o").glob("case_*/real/flight_1.csv.gz"))) == 8
    refused = narxcal("blind", "run", tmp_path / "o", "--out", tmp_path / "a")
    assert refused.code == 2
    assert "Name the simulator by --sim: a run identified on other flights" in refused.err


CONFIG = """
schema = "narxcal.config/1"
[logs]
files = ["flight_*.csv"]
[split]
train = ["*"]
"""


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--sim-logs", "l"), "--sim-logs and --altered exclude each other. Give one of them"),
        (("--build", "same"), "--build same is for simulated flights. Leave out --altered"),
    ],
)
def test_recorded_flights_have_an_engine_of_their_own(narxcal, tmp_path, words, said):
    done = narxcal("blind", "make", "--out", tmp_path / "o", "--altered", "c.toml", *words)
    assert done.code == 2
    assert said in done.err
    assert not (tmp_path / "o").exists()


@pytest.mark.slow
def test_end_to_end_with_the_diagnosis_itself(narxcal, cases, tmp_path):
    answers = tmp_path / "answers"
    done = narxcal("blind", "run", cases, "--out", answers, "--jobs", 1, "--json")
    ends = json.loads(done.out)["ends"]
    assert sum(ends.values()) == 2
    assert "error" not in ends
    scored = narxcal("blind", "score", cases, answers, "--secret", "3", "--json")
    document = json.loads(scored.out)
    assert len(document["outcomes"]) == 2
    assert {row["verdict"] for row in document["outcomes"]} <= {
        "none", "effects", "ambiguous", "unknown", "failed"
    }  # fmt: skip
