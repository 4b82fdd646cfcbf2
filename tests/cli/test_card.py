"""`narxcal card`: a page and a document of a tiny run, its limits kept, what is refused."""

import json
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest

from eval.cards.card import Wanted, calibration_card
from eval.cards.information import Experiment, of_training
from narxcal.calibration.bundle import load_bundle
from narxcal.flight_test.moves import Limits, course
from narxcal.flight_test.plan import FlightPlan, plan_flight

pytestmark = pytest.mark.slow  # the run takes half a minute to train

LIMITS = """\
schema = "narxcal.limits/1"
altitude_ft = [2000, 8000]
mach = [0.3, 0.4]
climb_ft_min = 2500
lever = [10, 75]
lever_per_s = 60
settle_s = 10
hold_s = 5
altitudes = 2
"""


@pytest.fixture(scope="module")
def limits(tmp_path_factory):
    """Write limits, the table above with `more` below it."""

    def write(more="", base=LIMITS):
        file = tmp_path_factory.mktemp("limits") / "LIMITS.toml"
        file.write_text(base + more, "utf-8")
        return file

    return write


@pytest.fixture(scope="module")
def bundle(project):
    return load_bundle(project / "run")


def test_a_card_is_a_page_and_a_document(narxcal, project, limits, tmp_path, sound_page):
    page = tmp_path / "card.html"
    ended = narxcal("card", project / "run", "--aircraft", limits(), "--minutes", "8",
                    "--out", page, "--json")  # fmt: skip
    assert ended.code == 0, ended.err
    found = json.loads(ended.out)
    assert found == json.loads(page.with_suffix(".json").read_text("utf-8"))
    assert found["schema"] == "narxcal.card/1"
    assert found["minutes"] <= 8.0
    sound_page(page.read_text("utf-8"))
    for number, step in enumerate(found["steps"], 1):
        assert 2000.0 <= step["altitude_ft"] <= 8000.0
        positions = [position for _, position in step["corners"]]
        assert min(positions) >= 10.0 - 1e-9
        assert max(positions) <= 75.0 + 1e-9
        assert f">{number}<" in page.read_text("utf-8")
    text = page.read_text("utf-8")
    assert text.count("\N{BALLOT BOX}") == len(found["steps"])
    assert re.search(r"<td[^>]*>\d+ °, 10 s</td>", text)  # a whole degree, and its unit
    assert re.search(r"EGT \d+[05] °C to \d+[05] °C", text)
    assert sum(step["share"] for step in found["steps"]) == pytest.approx(1.0)
    assert all(row["after"] <= row["before"] * (1 + 1e-9) for row in found["expected"])
    assert found["information_nats"] > 0.0


def test_a_limit_of_an_output_is_kept_with_the_interval_of_the_run(bundle, limits):
    free = calibration_card(bundle, Wanted(Limits.read(limits()), 8.0))
    most = max(step.high[2] for step in free.steps) - 20.0
    kept = calibration_card(
        bundle, Wanted(Limits.read(limits(f"[highest]\nEGT_C = {most}\n")), 8.0)
    )
    assert kept.steps
    assert all(step.high[2] <= most for step in kept.steps)


def test_each_criterion_serves_its_own_end(bundle, limits):
    wanted = [Wanted(Limits.read(limits()), 6.0, name) for name in ("D", "I")]
    by_d, by_i = (calibration_card(bundle, one).facts for one in wanted)
    assert by_i["predictive_variance"]["after"] <= 1.02 * by_d["predictive_variance"]["after"]
    assert by_d["information_nats"] >= 0.98 * by_i["information_nats"]


def test_slopes_are_those_of_the_free_run(bundle, limits):
    """Against central differences of the lags' share of the free run."""
    experiment = Experiment(bundle, Limits.read(limits()), "TRA_deg")
    own, lag = bundle.calibration, bundle.calibration.lag
    inputs = np.tile([10.0, 3000.0, 0.3, 0.0, 0.0, 0.0], (60, 1))
    inputs[10:, 0] = 70.0
    drive = lag.drive(inputs, own.input_names, own.settled(inputs))
    names, unit, slopes = experiment.parameters
    found = slopes(inputs)
    share = own.members.rest(3)
    for k in range(0, len(names), 17):
        at = lag.parameter_names.index(names[k])
        step, runs = 1e-5 * unit[k], []
        for sign in (1.0, -1.0):
            theta = lag.theta.copy()
            theta[at] += sign * step
            runs.append(replace(lag, theta=theta).deviations(drive, np.zeros(3), own.dt_s))
        expected = -share * (runs[0] - runs[1]) / 2e-5
        np.testing.assert_allclose(found[..., k], expected, rtol=2e-3, atol=2e-4)


@pytest.fixture
def refused(narxcal, project, limits, tmp_path):
    """What the command says of limits with `more` below them, or of other ones."""

    def say(*options, **table):
        page = tmp_path / "card.html"
        ended = narxcal("card", project / "run", "--aircraft", limits(**table), "--out", page,
                        *options)  # fmt: skip
        assert ended.code == 2
        assert not page.exists()
        return ended.err.removeprefix("narxcal: error: ")

    return say


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (
            "[highest]\nITT_C = 700\n",
            "[highest] names 'ITT_C', which is none of its channels. They",
        ),
        (
            "[inputs]\nECS = 1\n",
            "[inputs] names 'ECS', which is none of its channels. They are WOW",
        ),
        (
            "[highest]\nEGT_C = 100\n",
            "limits that admit no move: the gentlest of 52 may reach EGT_C ",
        ),
        (
            'switches = ["ECS"]\n',
            "switches names 'ECS', which is none of its channels. They are WOW",
        ),
    ],
)
def test_limits_that_do_not_fit_the_run_are_refused(refused, more, words):
    assert refused(more=more).startswith(words)


def test_too_little_time_is_an_error(refused):
    long = LIMITS.replace("settle_s = 10", "settle_s = 100")
    assert refused("--minutes", "1", base=long) == (
        "limits that admit no move: the shortest takes 1.7 minutes, found 1. "
        "Give more minutes, or shorten settle_s and hold_s\n"
    )


def test_a_run_whose_training_logs_are_elsewhere_says_so(refused, tmp_path):
    (tmp_path / "empty").mkdir()
    assert "flight_*.csv" in refused("--data", tmp_path / "empty")


def test_the_flown_card_tells_what_was_expected(bundle, limits):
    wanted = Wanted(Limits.read(limits()), 6.0)
    card = calibration_card(bundle, wanted)
    experiment = Experiment(bundle, wanted.limits, "TRA_deg")
    path = course(wanted.limits, [one.move for one in card.steps], bundle.calibration.dt_s)
    inputs = np.zeros((len(path["lever"]), 6))
    inputs[:, 0], inputs[:, 1], inputs[:, 2] = path["lever"], path["ALT_ft"], path["Mach"]
    before = np.eye(len(experiment.unit)) + of_training(experiment, None)
    after = before + experiment.information_of(inputs).information
    nats = 0.5 * (np.linalg.slogdet(after)[1] - np.linalg.slogdet(before)[1])
    assert card.facts["information_nats"] == pytest.approx(nats)


def test_twenty_minutes_tell_more_than_an_hour_in_line_or_as_long_of_the_enriched_profile(bundle):
    """The profile has the same envelope; what both tell is measured over the whole flight."""
    air = {"altitude_ft": (2000.0, 40_000.0), "mach": (0.3, 0.75), "climb_ft_min": 4000.0}
    lever = {"lever": (0.0, 85.0), "lever_per_s": 120.0, "settle_s": 10.0, "hold_s": 8.0}
    limits = Limits.parse({"schema": "narxcal.limits/1", **air, **lever})
    card = calibration_card(bundle, Wanted(limits, 20.0))
    experiment, own = Experiment(bundle, limits, "TRA_deg"), bundle.calibration
    before = np.eye(len(experiment.unit)) + of_training(experiment, None)

    def nats(style, minutes, seed):
        plan = FlightPlan(style=style, duration_s=60.0 * minutes, rate_hz=1.0 / own.dt_s)
        flown = plan_flight(plan, seed)["left"]
        inputs = np.stack([flown[name] for name in own.input_names], axis=1)
        after = np.linalg.slogdet(before + experiment.information_of(inputs).information)[1]
        return 0.5 * (after - np.linalg.slogdet(before)[1])

    found = card.facts["information_nats"]
    assert found > nats("line", 60.0, 11)
    assert found > nats("enriched", 20.0, 11)


@pytest.fixture
def verdict(diagnosed, tmp_path):
    """A copy of the diagnosis, of flights whose probe lags, with another verdict."""

    def write(**changed):
        copy = tmp_path / "gap"
        shutil.copytree(diagnosed, copy)
        document = json.loads((copy / "gap.json").read_text("utf-8"))
        document["verdict"] |= changed
        (copy / "gap.json").write_text(json.dumps(document), "utf-8")
        return copy

    return write


def test_moves_tell_a_slow_probe_from_an_offset(narxcal, verdict, limits, tmp_path, sound_page):
    gap = verdict(kind="ambiguous", ambiguous_with=["sensor_bias:EGT_C"])
    page = tmp_path / "card.html"
    chances = []
    for minutes in ("2", "8"):
        ended = narxcal("card", gap, "--aircraft", limits(), "--minutes", minutes, "--out", page,
                        "--overwrite", "--json")  # fmt: skip
        assert ended.code == 0, ended.err
        found = json.loads(ended.out)
        assert found["purpose"] == "diagnosis"
        assert found["minutes"] <= float(minutes)
        [row] = found["expected"]
        assert row["of"] == "sensor_lag:EGT_C or sensor_bias:EGT_C"
        chances.append(row["after"])
    assert 0.5 < chances[0] <= chances[1] <= 1.0
    assert chances[1] > 0.95
    assert any(step["name"] != "level" for step in found["steps"])
    sound_page(page.read_text("utf-8"))


def test_a_card_of_an_undetermined_diagnosis_shows_whether_anything_acts_and_can_be_flown(
    narxcal, verdict, limits, tmp_path
):
    gap = verdict(kind="unknown", effects=[], none=0.3)
    page, flights = tmp_path / "card.html", tmp_path / "flights"
    ended = narxcal("card", gap, "--aircraft", limits(), "--minutes", "4", "--out", page, "--json")
    assert ended.code == 0, ended.err
    card = json.loads(ended.out)
    chances = {row["of"]: row["after"] for row in card["expected"]}
    assert chances["sensor_lag:EGT_C or no effect"] > 0.9
    ended = narxcal("fly", "demo", "--flights", "1", "--card", page.with_suffix(".json"),
                    "--out", flights, "--json")  # fmt: skip
    assert ended.code == 0, ended.err
    log = json.loads(ended.out)["logs"][0]
    assert log["duration_s"] / 60.0 == pytest.approx(card["minutes"], rel=0.2)
    assert 2000.0 <= log["alt_ft"][0] <= log["alt_ft"][1] <= 8000.0


def test_moves_with_a_switch_tell_its_bleed_from_deterioration(
    narxcal, slow_probe, limits, tmp_path
):
    for seed in range(3):
        _, sim = slow_probe(seed, 200.0, stay_s=20.0)
        sim = sim.assign(NAI=(sim["time_s"] // 50.0 % 2.0).astype(int))
        real = sim.assign(EGT_C=sim["EGT_C"] + 20.0 * sim["NAI"])
        for kind, table in (("sim", sim), ("real", real)):
            (tmp_path / kind).mkdir(exist_ok=True)
            table.to_csv(tmp_path / kind / f"f{seed}.csv", index=False)
    where = ["--real", tmp_path / "real", "--sim", tmp_path / "sim", "--out", tmp_path / "gap"]
    assert narxcal("diagnose", *where).code == 0
    file = tmp_path / "gap" / "gap.json"
    document = json.loads(file.read_text("utf-8"))
    document["verdict"] |= {"kind": "ambiguous", "effects": ["bleed_extraction"],
                            "ambiguous_with": ["deterioration"]}  # fmt: skip
    file.write_text(json.dumps(document), "utf-8")
    found = []
    for more in ("", 'switches = ["NAI"]\n'):
        ended = narxcal("card", file, "--aircraft", limits(more=more), "--minutes", "4", "--out",
                        tmp_path / "card.html", "--overwrite", "--json")  # fmt: skip
        assert ended.code == 0, ended.err
        found.append(json.loads(ended.out))
    assert {step["switch"] for step in found[0]["steps"]} == {""}
    assert {step["switch"] for step in found[1]["steps"]} >= {"NAI"}
    assert found[0]["expected"][0]["after"] < found[1]["expected"][0]["after"]
    assert ", NAI on" in (tmp_path / "card.html").read_text("utf-8")


def test_a_decided_diagnosis_needs_no_card(narxcal, diagnosed, limits, tmp_path):
    ended = narxcal("card", diagnosed / "gap.json", "--aircraft", limits(), "--out",
                    tmp_path / "card.html")  # fmt: skip
    assert ended.code == 2
    assert ended.err == (
        f"narxcal: error: {diagnosed / 'gap.json'}: the diagnosis leaves nothing open that a "
        "flight could separate: it found sensor_lag:EGT_C. A card is for an ambiguous or "
        "undetermined diagnosis, or for a run\n"
    )
