"""`narxcal watch`: values of flights, alarms in words, page and JSON, what is refused."""

import json
import re
import shlex
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from markupsafe import escape

from eval.fleets.drift import Change
from eval.fleets.fleet import SCHEMA
from eval.fleets.watch import Key, _Cells, _excess, _natural, cause, watch
from narxcal.cli import main
from narxcal.support.addresses import Folder
from tests.eval.drawn_fleet import HOURS, SPREADS, Case, draw, judged


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """Folder of a drawn dataset, by scenario and size."""
    made = {}

    def of(scenario="engine change", size=10.0, tails=4, flights=16):
        key = scenario, size, tails, flights
        if key not in made:
            made[key] = tmp_path_factory.mktemp("fleet") / "F"
            draw(Case(scenario, size, 5, tails, flights), Folder(str(made[key])))
        return made[key]

    return of


@pytest.fixture(scope="module")
def seen(drawn):
    """What is found in it."""
    made = {}

    def of(*case):
        if case not in made:
            made[case] = watch(Folder(str(drawn(*case))))
        return made[case]

    return of


@pytest.fixture
def narxcal(capsys):
    """Run the command in this process: exit code, stdout and stderr."""

    def run(*arguments):
        code = main(["watch", *(str(part) for part in arguments)])
        shown = capsys.readouterr()
        return SimpleNamespace(code=code, out=shown.out, err=shown.err)

    return run


def cells(rng, flights, own, by_level, spread=0.2):
    """Cells of flights that each hold other levels, with an excess of 0.3."""
    rows = []
    for k in range(flights):
        for level in np.flatnonzero(rng.random(len(by_level)) < 0.5):
            count = int(rng.integers(1, 10))
            error = rng.normal(0.0, np.hypot(0.3, spread / count**0.5))
            rows.append((k, str(level), count, own[k] + by_level[level] + error))
    return pd.DataFrame(rows, columns=["number", "stratum", "count", "mean"])


def test_values_of_flights_are_found_whatever_levels_they_hold():
    rng = np.random.default_rng(1)
    z = []
    for _ in range(20):
        own, by_level = rng.normal(0.0, 1.0, 30), rng.normal(0.0, 20.0, 10)
        found = _Cells.of(cells(rng, 30, own, by_level), 0.2**2)
        excess = _excess([found])
        values, errors = found.of_flights(excess)
        away = values - own[found.flights]
        z.append((away - away.mean()) / errors)
    assert np.std(np.concatenate(z)) == pytest.approx(1.0, abs=0.1)


def test_a_level_that_one_flight_alone_holds_says_little_of_it():
    table = pd.DataFrame({
        "number": [0, 0, 1, 1, 2], "stratum": ["a", "b", "a", "b", "c"], "count": 9,
        "mean": [1.0, 5.0, 1.1, 5.1, 40.0],
    })  # fmt: skip
    _, errors = _Cells.of(table, 0.09).of_flights(0.07)
    assert errors[:2] == pytest.approx(np.full(2, np.sqrt(0.08 / 2.0)), rel=0.05)
    assert errors[2] > 10.0  # of the scatter of levels


def test_numbers_in_names_count_by_value():
    names = ["f10.csv", "f9.csv", "f9b.csv", "2.csv", "f.csv"]
    assert sorted(names, key=_natural) == ["2.csv", "f9.csv", "f9b.csv", "f10.csv", "f.csv"]


def test_an_exchanged_engine_is_one_alarm_with_all_that_changed(seen):
    found = seen()
    assert judged(Case("engine change", 10.0, 5, 4, 16), found) == (4, 4, 0)
    (alarm,) = found.alarms
    assert (alarm.tail, alarm.kind, alarm.engines) == ("T00", "step", ("right",))
    assert {key.what for key, _ in alarm.changes} == {
        "offset of N1", "offset of N2", "offset of EGT", "Ti error of N1",
    }  # fmt: skip
    assert alarm.first <= "0008.csv" <= alarm.last
    size = {key.channel: one for key, one in alarm.changes if key.quantity == "offset"}
    for name, spread in SPREADS.items():
        assert abs(size[name].size - 10.0 * spread) < 4.0 * size[name].error
    assert found.outcome.exit_code == 1


def test_both_engines_at_once_are_what_they_share(seen):
    (alarm,) = seen("shared meter", 6.0).alarms
    assert alarm.engines == ("left", "right")
    assert alarm.cause.startswith("several engines at once: what they share, such as air data")


def test_a_fleet_without_a_change_passes(seen):
    found = seen("wear", 0.0)
    assert (found.alarms, found.outcome.exit_code) == ((), 0)
    assert found.hours["T01"][-1] == pytest.approx(16 * HOURS)


def changes(**sizes):
    return [
        (Key("T", "left", *name.split("__")), Change("step", 5, 5, 5, size))
        for name, size in sizes.items()
    ]


@pytest.mark.parametrize(
    ("sizes", "says"),
    [
        ({"EGT_C__offset": 9.0, "N2_pct__offset": -1.0}, "gas path: deterioration"),
        ({"EGT_C__offset": -9.0, "N2_pct__offset": 1.0}, "a wash, repair or exchanged engine"),
        ({"EGT_C__offset": 9.0, "FF_kgph__offset": 4.0}, "gas path: deterioration"),
        ({"EGT_C__offset": 9.0}, "EGT alone: its sensor or meter"),
        ({"EGT_C__offset": 9.0, "EGT_C__lag": 0.3}, "EGT alone: its sensor or meter"),
        ({"N1_pct__offset": 1.0, "N2_pct__offset": 1.0, "EGT_C__offset": 9.0}, "the input (lever"),
        ({"EGT_C__lag": 1.0, "EGT_C__Ti": 1.0}, "the sensor of EGT became slower or faster"),
        ({"N1_pct__Tt": 1.0, "N2_pct__Tt": 1.0}, "rotors, fuel valve or control"),
        ({"N1_pct__offset": 1.0, "N2_pct__offset": -1.0}, "undetermined"),
    ],
)
def test_the_pattern_of_what_moved_says_what_it_may_be(sizes, says):
    assert says in cause(changes(**sizes), 2)
    assert cause(changes(**sizes), 2) in cause(changes(**sizes), 1)
    assert "of a tail with one engine" in cause(changes(**sizes), 1)


def test_a_declared_channel_has_the_unit_of_its_name():
    keys = [Key("T", "left", "NP_pct", quantity) for quantity in ("offset", "Ti")]
    assert [(key.what, key.unit) for key in keys] == [
        ("offset of NP", "%"),
        ("Ti error of NP", "s"),
    ]


HOSTILE = "<b>$x$ & T00"  # a tail that HTML, mathematical text and a shell would each read


def test_page_and_document(drawn, narxcal, tmp_path, monkeypatch):
    monkeypatch.setattr("eval.report.watch_page.MOST_DRAWN", 1)
    renamed = rewritten(drawn(), tmp_path, lambda _, table: table.replace("T00", HOSTILE)).address
    (tmp_path / "fleet.toml").write_text(FLEET.replace('"run"', '"runs/{tail}"'), "utf-8")
    page = tmp_path / "watch.html"
    done = narxcal(renamed, "--out", page, "--config", tmp_path / "fleet.toml", "--json")
    assert done.code == 1
    html = page.read_text("utf-8")
    assert f"{escape(HOSTILE)} right: step at" in html
    assert f"{escape(HOSTILE)} right</text>" in html  # of the map
    assert HOSTILE not in html
    command = f"--sim {shlex.quote(f'{tmp_path}/runs/{HOSTILE}')} --out gap-after"
    assert str(escape(command)) in html
    assert re.search(r"src=|href=\"(?!#|data:)", html) is None  # self-contained
    document = json.loads((tmp_path / "watch.json").read_text("utf-8"))
    assert document == json.loads(done.out)
    assert (document["schema"], document["ok"]) == ("narxcal.watch/1", False)
    assert document["headline"] == "1 alarm in 4 tails, 96.0 flight hours"
    assert len(document["series"]) == 4 * 2 * 4
    assert document["alarms"][0]["changes"][0]["adjusted"] < 0.05


def rewritten(folder, tmp_path, change):
    """A copy of a dataset whose tables are what `change(name, table)` makes of them."""
    for path in folder.rglob("*"):
        target = tmp_path / "G" / path.relative_to(folder)
        target.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix == ".parquet":
            name = path.relative_to(folder).parts[0]
            if (table := change(name, pd.read_parquet(path))) is not None:
                table.to_parquet(target)
        elif path.is_file():
            target.write_bytes(path.read_bytes())
    return Folder(str(tmp_path / "G"))


def test_engines_by_the_names_of_files(drawn, seen, tmp_path):
    def apart(name, table):
        if "log" not in table:
            return table
        sides = table["engine"].map({"left": "_L.csv", "right": "_R.csv"})
        files = table["file"].str.removesuffix(".csv") + sides
        return table.assign(file=files, log=files, engine="")

    dataset = rewritten(drawn("shared meter", 6.0), tmp_path, apart)
    (alarm,) = watch(dataset, "_([LR])").alarms
    (other,) = seen("shared meter", 6.0).alarms
    assert (alarm.engines, alarm.first, alarm.last) == (("L", "R"), other.first, other.last)
    assert alarm.after[:2] == (f"{alarm.after[0][:4]}_L.csv", f"{alarm.after[0][:4]}_R.csv")


def test_what_cannot_be_judged_is_said(drawn, tmp_path):
    def less(name, table):
        if name == "trims":
            return table.iloc[:0]
        if name == "logs" and table["tail"].eq("T01").any():
            return table[table["file"] == "0000.csv"]
        if name == "worklist.parquet":
            return pd.concat([table, table.assign(batch=1)])
        return table

    found = watch(rewritten(drawn(), tmp_path, less))
    assert found.remarks == (
        "4 of the listed batches are not evaluated yet: go on with narxcal fleet",
        "nothing can be said of tails with fewer than 3 judged flights: T01 (1 flight)",
        "no engine has 3 flights with: offset, lag, Tt",
    )
    assert {one.key.quantity for one in found.effects} == {"Ti"}
    assert "T01" not in {one.key.tail for one in found.effects}
    assert replace(found, alarms=()).outcome.passed is None  # not green
    assert found.outcome.headline.endswith("; 1 tail cannot be judged")


def test_a_fleet_of_single_flights_is_not_assessed(drawn, narxcal, tmp_path):
    def first(_, table):
        return table[table["file"] == "0000.csv"] if "file" in table else table

    one = rewritten(drawn(), tmp_path, first)
    done = narxcal(one.address, "--out", tmp_path / "p.html")
    assert done.code == 1
    assert "nothing can be judged: 4 tails, 6.0 flight hours" in done.out
    assert "T00 (1 flight), T01 (1 flight)" in done.err


# --- from flights to alarms ---

FLY = """\
schema = "narxcal.fly/1"
name = "{name}"
flights = {flights}
seed = {seed}
engines = {engines}
outputs = ["N1_pct", "N2_pct", "EGT_C"]
[plan]
duration_s = 480.0
rate_hz = 5.0
[sensors]
preset = "fdr"
"""
SHIFT = """
[[effects]]
id = "sensor_bias"
channel = "EGT_C"
parameters = { offset = 25.0 }
flights = [7, 8, 9, 10, 11, 12]
engines = ["left"]
"""
WEAR = """
[[effects]]
id = "deterioration"
parameters = {{ hpc_efficiency_pct = {hpc:.1f}, hpt_efficiency_pct = {hpt:.1f} }}
flights = [{flight}]
engines = ["right"]
"""
RUN = """\
schema = "narxcal.config/1"
name = "chain"
[logs]
folder = "train"
files = ["flight_*.csv"]
[split]
train = ["flight_0[1-3]*"]
test = ["flight_04*"]
[narx]
outputs = ["N1_pct", "N2_pct", "EGT_C"]
lag_limits = false
[train]
iterations = [3, 3]
threads = 1
choice_s = 0.0
"""
FLEET = """\
schema = "narxcal.fleet/1"
flights = "flights"
files = ["*/*.csv"]
run = "run"
"""


@pytest.mark.slow
def test_a_shifted_sensor_and_a_worn_engine_are_found_from_their_flights(tmp_path, narxcal):
    wear = "".join(WEAR.format(hpc=0.4 * k, hpt=0.2 * k, flight=k + 1) for k in range(1, 12))
    sides = '["left", "right"]'
    fly(tmp_path, "train", FLY.format(name="train", flights=4, seed=5, engines='["left"]'))
    for seed, (tail, effects) in enumerate([("A", SHIFT), ("B", wear)]):
        text = FLY.format(name=tail, flights=12, seed=165 + seed, engines=sides) + effects
        fly(tmp_path, f"flights/{tail}", text)
    (tmp_path / "run.toml").write_text(RUN, "utf-8")
    (tmp_path / "fleet.toml").write_text(FLEET, "utf-8")
    assert main(["train", str(tmp_path / "run.toml"), "--out", str(tmp_path / "run")]) == 0
    fleet = ["fleet", str(tmp_path / "fleet.toml"), "--out", str(tmp_path / "F"), "--jobs", "1"]
    assert main(fleet) == 0
    page = tmp_path / "page.html"
    options = ("--engine", "_(left|right)", "--config", tmp_path / "fleet.toml")
    assert narxcal(tmp_path / "F", "--out", page, *options).code == 1
    document = json.loads(page.with_suffix(".json").read_text("utf-8"))
    alarms = {one["tail"]: one for one in document["alarms"]}
    assert sorted(alarms) == ["A", "B"]
    assert {one["engine"] for one in alarms["A"]["changes"]} == {"left"}
    assert alarms["A"]["kind"] == "step"
    assert alarms["A"]["first"] <= "A/flight_07.csv" <= alarms["A"]["last"]
    assert alarms["A"]["cause"].startswith("EGT alone: its sensor or meter")
    shift = alarms["A"]["changes"][0]
    assert abs(shift["size"] - 25.0) < 3.0 * shift["error"]
    assert {one["engine"] for one in alarms["B"]["changes"]} == {"right"}
    assert alarms["B"]["kind"] == "trend"
    assert "gas path: deterioration" in alarms["B"]["cause"]
    assert f"narxcal diagnose --real after --sim {tmp_path}/run --out gap-after" in (
        page.read_text("utf-8")
    )


def fly(folder, name, scenario):
    file = folder / f"{name.replace('/', '-')}.toml"
    file.write_text(scenario, "utf-8")
    out = folder / name
    out.parent.mkdir(exist_ok=True)
    assert main(["fly", str(file), "--out", str(out), "--jobs", "1", "--quiet"]) == 0


# --- what is refused ---


def refused(done, message):
    assert done.code == 2
    assert done.err == f"narxcal: error: {message}\n"


HELP = ". See narxcal watch --help"
HINT = "Name the folder that narxcal fleet wrote"


GAP = '{"schema": "narxcal.gap/2"}'
EMPTY = '{"schema": "narxcal.fleet-dataset/1", "runs": {}, "versions": {}}'


@pytest.mark.parametrize(
    ("document", "message"),
    [
        (None, f": there is no fleet.json. {HINT}"),
        (GAP, f"/fleet.json: expected the schema {SCHEMA}, found narxcal.gap/2. {HINT}"),
        (EMPTY, ": no batch of logs is evaluated yet. Go on with narxcal fleet first"),
    ],
)
def test_a_folder_that_is_no_dataset(narxcal, tmp_path, document, message):
    (tmp_path / "F").mkdir()
    if document:
        (tmp_path / "F/fleet.json").write_text(document, "utf-8")
    page = tmp_path / "page.html"
    refused(narxcal(tmp_path / "F", "--out", page), f"{tmp_path}/F{message}")
    assert not page.exists()


def failed(name, table):
    return table.assign(status="failed") if name == "logs" else table


MISSING = "the table trims is missing. Restore it, or remove the table logs: all is then computed"
NONE = "the dataset has no evaluated log. Its table logs says why; evaluate some with narxcal fleet"


@pytest.mark.parametrize(
    ("change", "message"),
    [(lambda name, table: None if name == "trims" else table, f"{MISSING} anew"), (failed, NONE)],
)
def test_a_dataset_without_what_is_judged(drawn, narxcal, tmp_path, change, message):
    dataset = rewritten(drawn(), tmp_path, change)
    done = narxcal(dataset.address, "--out", tmp_path / "page.html")
    refused(done, f"{dataset.address}: {message}")


def test_an_installation_without_the_extra(drawn, narxcal, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "statsmodels.tsa.statespace.kalman_smoother", None)
    refused(
        narxcal(drawn(), "--out", tmp_path / "page.html"),
        "the watch needs statsmodels. Install it with: pip install 'narxcal[fleet]'",
    )


PATTERN = "argument --engine: expected a regular expression"
SHUT = f"{PATTERN}: missing ), unterminated subpattern at position 0{HELP}"


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        (("--out", "a.pdf"), "the page is a .html file, and --out names a.pdf. Name it a.html"),
        (("--out", "p.html", "--engine", "L"), f"{PATTERN} with a group: the engine{HELP}"),
        (("--out", "p.html", "--engine", "("), SHUT),
    ],
)
def test_a_bad_command_line(narxcal, options, problem):
    refused(narxcal("F", *options), problem)
